"""The rooms of the package and the doors between them, as the imports of every module tell."""

import ast
from pathlib import Path
import sys

import pytest

PACKAGE = Path(__file__).parent.parent / 'dlsc_qbs_ros'
MODULES = sorted(path for path in PACKAGE.rglob('*.py') if path.name != '__init__.py')

# Importer -> imported; a name with a dot opens that one module only.
EVERYONE = {'config', 'profiles', 'errors'}
ARROWS = {
    'config': {'declaration', 'errors'},
    'declaration': {'errors'},
    'profiles': {'config', 'errors'},
    'errors': set(),
    'core': {'core'},
    'pipeline': {'pipeline', 'core'},
    'baselines': {'baselines', 'core'},
    'io': {'io', 'core'},
    'sim': {'sim', 'core'},
    'evaluation': {'evaluation', 'core'},
    'ros': {'ros', 'core', 'declaration'},
    'nodes': {'nodes', 'ros', 'pipeline', 'io', 'core.types'},
    'cli': {'cli', 'pipeline', 'io', 'sim', 'evaluation', 'baselines', 'core.types'},
}
# Opened only where it is used, inside a function: tools and files then work without ROS.
LATE_ARROWS = {'io': {'ros'}, 'cli': {'ros', 'nodes'}}
ROS_ROOMS = {'nodes', 'ros'}
ROS_TOOLS = {'cli/replay.py'}  # the command line of a node: nothing to do without ROS


def room_of(path):
    return path.relative_to(PACKAGE).parts[0].removesuffix('.py')


def imports_of(path):
    """Yield (absolute module name, inside a function) of every import in the file."""
    package = ('dlsc_qbs_ros', *path.relative_to(PACKAGE).parent.parts)

    def walk(node, late):
        for child in ast.iter_child_nodes(node):
            if isinstance(child, ast.Import):
                yield from ((alias.name, late) for alias in child.names)
            elif isinstance(child, ast.ImportFrom):
                base = package[:len(package) - child.level + 1] if child.level else ()
                module = '.'.join([*base, *filter(None, [child.module])])
                yield from (
                    (f'{module}.{alias.name}' if base else module, late) for alias in child.names)
            else:
                function = isinstance(child, (ast.FunctionDef, ast.AsyncFunctionDef))
                yield from walk(child, late or function)

    yield from walk(ast.parse(path.read_text()), False)


def is_ros(module):
    top = module.partition('.')[0]
    return top.endswith(('_msgs', '_interfaces')) or top.startswith(('rcl', 'tf2_', 'rosidl'))


def is_open(target, rooms):
    return any(f'{target}.'.startswith(f'{room}.') for room in rooms)


def named(paths):
    return [pytest.param(path, id=str(path.relative_to(PACKAGE))) for path in paths]


@pytest.mark.parametrize('path', named(MODULES))
def test_a_module_imports_only_from_the_rooms_open_to_its_own(path):
    room = room_of(path)
    is_ros_tool = path.relative_to(PACKAGE).as_posix() in ROS_TOOLS
    for module, late in imports_of(path):
        top, _, target = module.partition('.')
        if top == 'dlsc_qbs_ros':
            rooms = ARROWS[room] | EVERYONE
            if late or is_ros_tool:
                rooms = rooms | LATE_ARROWS.get(room, set())
            assert is_open(target, rooms), f'{room} may not import {module}'


@pytest.mark.parametrize(
    'path', named(path for path in MODULES if room_of(path) not in ROS_ROOMS))
def test_only_nodes_and_ros_import_ros(path):
    assert not [module for module, _ in imports_of(path) if is_ros(module)]


@pytest.mark.parametrize('path', named(path for path in MODULES if room_of(path) == 'core'))
def test_core_needs_nothing_but_numpy(path):
    tops = {module.partition('.')[0] for module, _ in imports_of(path)}
    assert tops <= {'dlsc_qbs_ros', 'numpy'} | sys.stdlib_module_names


def test_every_folder_of_the_package_has_its_arrows():
    folders = {path.name for path in PACKAGE.iterdir() if (path / '__init__.py').exists()}
    assert folders <= set(ARROWS)


@pytest.mark.parametrize('source, found', [
    ('from ..core import types', ('dlsc_qbs_ros.core.types', False)),
    ('from .frames import View', ('dlsc_qbs_ros.io.frames.View', False)),
    ('import rclpy.node', ('rclpy.node', False)),
    ('def f():\n    from nav_msgs.msg import Odometry', ('nav_msgs.msg', True)),
    ('if x:\n    from ..sim.world import World', ('dlsc_qbs_ros.sim.world.World', False)),
])
def test_imports_are_found_wherever_they_stand(source, found, tmp_path, monkeypatch):
    monkeypatch.setattr(sys.modules[__name__], 'PACKAGE', tmp_path)
    (tmp_path / 'io').mkdir()
    path = tmp_path / 'io' / 'module.py'
    path.write_text(source)
    assert list(imports_of(path)) == [found]
