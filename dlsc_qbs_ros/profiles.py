"""Parameters as text: ROS parameter files, and `section.name=value` of the command line."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Mapping

import yaml

from .config import Config, PARAMETERS
from .errors import ConfigError


def to_yaml(config: Config) -> str:
    """Return a configuration as a ROS parameter file, which `load_profile` reads."""
    tree: dict[str, dict[str, Any]] = {}
    for key, value in config.flat().items():
        section, _, name = key.partition('.')
        if value != ():  # ROS parameter files know no empty list
            tree.setdefault(section, {})[name] = value
    return yaml.safe_dump({'/**': {'ros__parameters': tree}}, sort_keys=False)


def parse_assignment(text: str) -> tuple[str, Any]:
    """Parse `section.name=value` of the command line; the value is YAML."""
    key, equals, value = text.partition('=')
    if not equals:
        raise ConfigError(f'{text!r}: expected section.name=value')
    try:
        return key.strip(), _from_yaml(key.strip(), yaml.safe_load(value))
    except (yaml.YAMLError, ValueError) as error:  # ValueError: a date like 2024-13-01
        raise ConfigError(f'{text!r}: {value!r} is not YAML') from error


def load_profile(path: Path) -> dict[str, Any]:
    """Read a ROS parameter file and return its `section.name`: value pairs, all nodes merged."""
    try:
        document = yaml.safe_load(Path(path).read_text())
    except (OSError, ValueError, yaml.YAMLError) as error:
        raise ConfigError(f'{path}: not a readable YAML file: {error}') from error
    values: dict[str, Any] = {}
    for node, content in _mapping(path, document).items():
        parameters = _mapping(path, content).get('ros__parameters')
        if parameters is None:
            raise ConfigError(f'{path}: {node!r} holds no ros__parameters')
        values.update(_flatten(_mapping(path, parameters)))
    return {key: _from_yaml(key, value) for key, value in values.items()
            if not is_ros_parameter(key)}


def is_ros_parameter(key: str) -> bool:
    """Whether a parameter is one that every node has, beside those of the package's sections."""
    return key in ('autostart', 'use_sim_time', 'start_type_description_service'
                   ) or key.startswith('qos_overrides.')


def _mapping(path, value) -> Mapping:
    if not isinstance(value, Mapping):
        raise ConfigError(f'{path}: expected a mapping, found {value!r}')
    return value


def _flatten(tree: Mapping, prefix: str = '') -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for key, value in tree.items():
        if isinstance(value, Mapping):
            flat.update(_flatten(value, f'{prefix}{key}.'))
        else:
            flat[f'{prefix}{key}'] = value
    return flat


def _from_yaml(key: str, value: Any) -> Any:
    """YAML 1.1 reads 1e-3 as a string: turn it into a number where one is wanted."""
    spec = PARAMETERS.get(key)
    if spec is not None and type(spec.default) is float and isinstance(value, str):
        try:
            return float(value)
        except ValueError:
            return value
    return value
