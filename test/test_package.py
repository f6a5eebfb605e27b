"""What a user installs: declared dependencies, profiles, launch files and executables."""

import ast
from importlib.util import find_spec
import os
from pathlib import Path
import shlex
import shutil
import subprocess
import sys
from xml.etree import ElementTree

import pytest
import yaml

from dlsc_qbs_ros.cli import demo
from dlsc_qbs_ros.config import Config, PARAMETERS
from dlsc_qbs_ros.core import kernel
from dlsc_qbs_ros.profiles import is_ros_parameter, load_profile

ROOT = Path(__file__).parent.parent
PROFILES = sorted((ROOT / 'config').glob('*.yaml'))
LAUNCH_FILES = sorted((ROOT / 'launch').glob('*.launch.py'))
BIN = ROOT / 'install' / 'dlsc_qbs_ros' / 'lib' / 'dlsc_qbs_ros'
TOOLS = ('simulate', 'replay', 'recover', 'evaluate', 'reproduce', 'reproduce_encoder',
         'convert_vgg11', 'train_latentslam')
NODES = ('encoder', 'ratslam', 'recorder')

# The rosdep key of an imported module, where the two names differ.
ROSDEP_KEYS = {
    'ament_flake8': 'ament_flake8', 'ament_pep257': 'ament_pep257',
    'cv2': 'python3-opencv', 'lz4': 'mcap-ros2-support', 'matplotlib': 'python3-matplotlib',
    'mcap': 'mcap-ros2-support',
    'mcap_ros2': 'mcap-ros2-support', 'numpy': 'python3-numpy', 'pytest': 'python3-pytest',
    'pymavlink': 'python3-pymavlink-pip', 'rosbags': 'python3-rosbags-pip',
    'serial': 'python3-serial', 'tqdm': 'python3-tqdm', 'yaml': 'python3-yaml',
    'zstandard': 'mcap-ros2-support',  # mcap needs it and lz4
}


def imported(folder):
    """Return the third-party modules that the Python files under the folder import."""
    nodes = [node for path in (ROOT / folder).rglob('*.py')
             for node in ast.walk(ast.parse(path.read_text()))]
    names = {alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names}
    names |= {node.module for node in nodes if isinstance(node, ast.ImportFrom) if not node.level}
    local = {'dlsc_qbs_ros', *(path.stem for path in (ROOT / 'test').rglob('*.py'))}
    return {name.partition('.')[0] for name in names} - sys.stdlib_module_names - local


def dependencies(*kinds):
    package = ElementTree.parse(ROOT / 'package.xml').getroot()
    return {element.text for kind in kinds for element in package.iter(kind)}


@pytest.mark.parametrize('folder', ['dlsc_qbs_ros', 'launch'])
def test_package_xml_names_the_rosdep_key_of_every_import(folder):
    keys = {ROSDEP_KEYS.get(name, name) for name in imported(folder)}
    assert keys <= dependencies('depend', 'exec_depend')


def test_package_xml_names_what_the_tests_import_as_well():
    keys = {ROSDEP_KEYS.get(name, name) for name in imported('test')}
    assert keys <= dependencies('depend', 'exec_depend', 'test_depend')


def test_package_xml_and_setup_cfg_tell_the_same_version():
    version = ElementTree.parse(ROOT / 'package.xml').getroot().findtext('version')
    assert f'\nversion = {version}\n' in (ROOT / 'setup.cfg').read_text()
    assert f'\n{version} (' in (ROOT / 'CHANGELOG.rst').read_text()


@pytest.mark.parametrize('path', PROFILES, ids=lambda path: path.name)
def test_a_profile_overrides_known_parameters_with_other_values(path):
    profile = load_profile(path)
    changed = Config().override(profile).flat()
    assert profile
    assert not [key for key in profile if changed[key] == PARAMETERS[key].default]


@pytest.mark.parametrize('path', PROFILES, ids=lambda path: path.name)
def test_a_profile_holds_nothing_that_only_looks_like_a_ros_parameter(path):
    tree = yaml.safe_load(path.read_text())['/**']['ros__parameters']
    sections = {key.partition('.')[0] for key in PARAMETERS}
    assert all(key in sections or is_ros_parameter(key) or is_ros_parameter(f'{key}.')
               for key in tree)


def test_fast_dds_profile_gives_images_room_in_shared_memory():
    tree = ElementTree.parse(ROOT / 'config' / 'fastdds_shared_memory.xml')
    space = '{http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles}'
    assert [int(tree.find(f'.//{space}{name}').text) for name in (
        'segment_size', 'maxMessageSize')] == [32 * 2**20, 4 * 2**20]


def test_fast_dds_announces_a_process_from_another_thread():
    space = '{http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles}'
    for path in (ROOT / 'config').glob('fastdds_*.xml'):
        controller = ElementTree.parse(path).find(f'.//{space}throughputController')
        assert [int(value.text) for value in controller] == [2_000_000_000, 1]


@pytest.mark.parametrize('path', LAUNCH_FILES, ids=lambda path: path.name)
def test_a_launch_file_describes_itself(path):
    namespace = {'__name__': 'launch_file'}
    code = compile(path.read_text(), path.name, 'exec')
    if find_spec('launch_ros') is None:
        pytest.skip('launch_ros is not installed: compiled only')
    exec(code, namespace)
    assert namespace['generate_launch_description']().entities


def environment():
    """Return nothing, or the sourced ROS 2 the package was built in."""
    return dict(os.environ) if 'ROS_DISTRO' in os.environ else {}


def run(home, name, *arguments):
    pytest.importorskip('rclpy')
    if not BIN.is_dir():
        pytest.fail(f'{BIN} is missing: run `make build` first')
    return subprocess.run(
        [BIN / name, *arguments], env=environment(), cwd=home, timeout=60,
        stdin=subprocess.DEVNULL, capture_output=True, text=True)


@pytest.mark.parametrize('name', TOOLS)
def test_an_installed_tool_explains_itself_in_an_empty_environment(name, tmp_path):
    done = run(tmp_path, name, '--help')
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith(f'usage: {name}')


@pytest.mark.parametrize('name', NODES)
def test_an_installed_node_starts_in_an_empty_environment_and_checks_its_parameters(
        name, tmp_path):
    done = run(tmp_path, name, '--ros-args', '-p', 'odometry.max_gap_s:=-1.0')
    assert done.returncode != 0
    assert 'odometry.max_gap_s' in done.stderr
    assert 'Traceback' not in done.stderr


def test_the_demo_without_a_build_says_what_to_do(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert demo.main(['--out', 'demo_output']) == 1
    assert capsys.readouterr().err == (
        'demo: install/dlsc_qbs_ros is missing: run `make build` first\n')


# The compiled kernel

COMPILER = os.environ.get('CC', 'cc')


def built(folder, compiler, left_behind=b''):
    """Build a copy of the package with setup.py; return the process and the kernel's path."""
    for name in ('setup.py', 'setup.cfg'):
        shutil.copy(ROOT / name, folder)
    core = Path('dlsc_qbs_ros', 'core')
    shutil.copytree(ROOT / core, folder / core, ignore=shutil.ignore_patterns('*.so'))
    (folder / core.parent / '__init__.py').touch()
    if left_behind:
        (folder / core / '_kernel.so').write_bytes(left_behind)
    done = subprocess.run(
        [sys.executable, 'setup.py', 'build_py', '--build-lib', 'out'], cwd=folder,
        env={**os.environ, 'CC': compiler}, timeout=120, capture_output=True, text=True)
    return done, folder / 'out' / core / '_kernel.so'


def test_a_build_compiles_a_kernel_that_loads(tmp_path, monkeypatch):
    if shutil.which(shlex.split(COMPILER)[0]) is None:
        pytest.skip(f'there is no compiler {COMPILER!r}')
    done, library = built(tmp_path, f'{COMPILER} -Wall -Wextra -Werror')
    assert done.returncode == 0, done.stderr
    assert 'without its compiled kernel' not in done.stdout, done.stderr
    monkeypatch.setattr(kernel, 'SOURCE', library.with_suffix('.c'))
    assert kernel._load() is not None


@pytest.mark.parametrize('compiler', ['/nowhere/cc', 'false', f'{sys.executable} -c exit(3)'])
def test_a_build_without_a_compiler_goes_without_the_kernel_and_says_so(compiler, tmp_path):
    done, library = built(tmp_path, compiler)
    assert done.returncode == 0, done.stderr
    assert 'the package goes without its compiled kernel' in done.stdout
    assert library.with_name('kernel.py').is_file()
    assert not library.exists()


def test_a_kernel_that_an_earlier_build_left_behind_is_not_packed(tmp_path):
    done, library = built(tmp_path, '/nowhere/cc', left_behind=b'of another version')
    assert done.returncode == 0, done.stderr
    assert not library.exists()
