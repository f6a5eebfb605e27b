"""
Every parameter of the package, declared once.

A dataclass field here is a ROS parameter (`section.name`), a key of a YAML profile and a key of
`--set` on the command line; its default, unit, range and meaning stand beside it and nowhere else.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, fields, replace
import math
from pathlib import Path
from typing import Any, Iterator, Mapping

import yaml

from .errors import ConfigError


def parameter(default, meaning: str, *, unit: str = '', bounds: tuple = (), choices: tuple = ()):
    """Declare one parameter: inclusive `bounds` for numbers, `choices` for words."""
    return field(default=default, metadata={
        'meaning': meaning, 'unit': unit, 'bounds': bounds, 'choices': choices})


class Section:
    """A group of parameters; values are checked, and integers widened, on construction."""

    def __post_init__(self):
        for spec in fields(self):
            value = _checked(f'{type(self).name}.{spec.name}', getattr(self, spec.name), spec)
            object.__setattr__(self, spec.name, value)


def _checked(name: str, value: Any, spec) -> Any:
    """Return the value as the field's own type, or raise ConfigError with value and bound."""
    wanted = type(spec.default)
    if wanted is float and isinstance(value, int) and not isinstance(value, bool):
        value = float(value)
    if wanted is tuple and isinstance(value, list):
        value = tuple(value)
    if type(value) is not wanted:
        raise ConfigError(f'{name} = {value!r}: expected {wanted.__name__}')
    if wanted is tuple and not all(isinstance(item, str) for item in value):
        raise ConfigError(f'{name} = {list(value)!r}: expected a list of strings')
    choices, bounds = spec.metadata['choices'], spec.metadata['bounds']
    if choices and value not in choices:
        raise ConfigError(f'{name} = {value!r}: expected one of {", ".join(choices)}')
    if wanted is float and not math.isfinite(value):
        raise ConfigError(f'{name} = {value}: expected a finite number')
    if bounds and not bounds[0] <= value <= bounds[1]:
        raise ConfigError(f'{name} = {value}: expected a value in [{bounds[0]}, {bounds[1]}]')
    return value


@dataclass(frozen=True)
class ImageConfig(Section):
    """How images reach the encoder."""

    name = 'image'

    compressed: bool = parameter(
        False, 'subscribe to sensor_msgs/CompressedImage instead of sensor_msgs/Image')


@dataclass(frozen=True)
class ViewConfig(Section):
    """The view: the cropped, resized grey image that a code is made of."""

    name = 'view'

    width: int = parameter(43, 'width of the view', unit='px', bounds=(4, 4096))
    height: int = parameter(32, 'height of the view', unit='px', bounds=(4, 4096))
    crop_top: float = parameter(0.0, 'share of rows cut off at the top', bounds=(0.0, 0.9))
    crop_bottom: float = parameter(0.0, 'share of rows cut off at the bottom', bounds=(0.0, 0.9))
    crop_left: float = parameter(0.0, 'share of columns cut off at the left', bounds=(0.0, 0.9))
    crop_right: float = parameter(0.0, 'share of columns cut off at the right', bounds=(0.0, 0.9))
    standardise: bool = parameter(
        True, 'give every view zero mean and the same deviation; else pixels in [0, 1]')

    def __post_init__(self):
        super().__post_init__()
        for a, b in (('crop_top', 'crop_bottom'), ('crop_left', 'crop_right')):
            total = getattr(self, a) + getattr(self, b)
            if total > 0.9:
                raise ConfigError(f'view.{a} + view.{b} = {total:g}: expected at most 0.9')


@dataclass(frozen=True)
class EncoderConfig(Section):
    """DLSC-QBS (Algorithm 1) with the paper's SLAM parameters."""

    name = 'encoder'

    input: str = parameter(
        'patches', 'what is coded: the whole view as one vector, as in the paper, or all its '
        'small patches, pooled', choices=('image', 'patches'))
    mode: str = parameter(
        'epochs', 'epochs: converged codes under a dictionary held for an epoch; '
        'paper: the codes of Algorithm 1 as they come', choices=('epochs', 'paper'))
    protection: bool = parameter(
        True, 'go back to the last snapshot when learning runs away; may be off in paper mode')
    gate: bool = parameter(True, 'learn only while the Quadratic Bayesian Surprise is positive')
    n_atoms: int = parameter(64, 'atoms M of the dictionary', bounds=(1, 4096))
    eta_c: float = parameter(5e-3, 'coding rate', bounds=(1e-9, 10.0))
    eta_d: float = parameter(1.4e-3, 'learning rate', bounds=(0.0, 10.0))
    lambda_1: float = parameter(0.2, 'weight of the l1 norm', bounds=(0.0, 100.0))
    n_coding: int = parameter(10, 'coding iterations N_c per frame', bounds=(1, 10000))
    n_learning: int = parameter(1, 'learning iterations N_d per frame', bounds=(0, 1000))
    sigma_w: float = parameter(
        0.01, 'deviation of the initial dictionary at 346x260 inputs', bounds=(1e-6, 10.0))
    gate_window: int = parameter(
        5, 'width of the moving average over the surprise', unit='frames', bounds=(1, 1000))
    epoch_change: float = parameter(
        0.25, 'relative change of the dictionary that starts a new epoch; so does a lack of room '
        'for more inputs learned from', bounds=(1e-3, 10.0))
    seed: int = parameter(0, 'seed of the initial dictionary', bounds=(0, 2**31 - 1))

    def __post_init__(self):
        super().__post_init__()
        if not self.protection and self.mode != 'paper':
            raise ConfigError(f'encoder.protection = False: expected True in mode {self.mode!r}')


@dataclass(frozen=True)
class PatchesConfig(Section):
    """What is different for patches: atoms of length 1, codes from zero, step 1 / lambda_max."""

    name = 'patches'

    size: int = parameter(5, 'edge of a patch', unit='px', bounds=(2, 32))
    n_learned: int = parameter(
        128, 'random patches of a frame that are learned from', bounds=(1, 100000))
    eta_d: float = parameter(5.0, 'learning rate, in place of encoder.eta_d', bounds=(0.0, 100.0))
    cells_x: int = parameter(5, 'cells along the width that codes are pooled into',
                             bounds=(1, 64))
    cells_y: int = parameter(4, 'cells along the height', bounds=(1, 64))


@dataclass(frozen=True)
class OdometryConfig(Section):
    """Where odometry comes from and what is believed of it."""

    name = 'odometry'

    source: str = parameter('nav_msgs', 'the odometry source', choices=('nav_msgs',))
    use_twist: bool = parameter(
        False, 'integrate the recorded twist instead of differencing poses')
    max_gap_s: float = parameter(
        2.0, 'with use_twist, a longer silence starts a new segment', unit='s',
        bounds=(0.01, 3600.0))
    max_speed_m_s: float = parameter(
        50.0, 'a faster step is a jump and starts a new segment', unit='m/s',
        bounds=(0.1, 1000.0))
    translation_drift: float = parameter(
        0.03, 'deviation of the distance flown, per metre', unit='m/m', bounds=(0.0, 1.0))
    yaw_bias_rad_s: float = parameter(
        0.012, 'deviation of a constant error of the yaw rate', unit='rad/s', bounds=(0.0, 1.0))
    yaw_noise: float = parameter(
        0.03, 'deviation of the heading after one second of random walk', unit='rad/sqrt(s)',
        bounds=(0.0, 1.0))


@dataclass(frozen=True)
class RatSlamConfig(Section):
    """When a place is an old one, and what follows from it."""

    name = 'ratslam'

    sample_period_s: float = parameter(
        0.1, 'time between the codes that are used', unit='s', bounds=(0.001, 60.0))
    max_wait_s: float = parameter(
        0.2, 'longest wait for a late code, view, dictionary or odometry', unit='s',
        bounds=(0.0, 60.0))
    map_frame: str = parameter('map', 'frame_id of the map')
    publish_tf: bool = parameter(True, 'publish map to odom on /tf')
    keyframe_distance_m: float = parameter(
        0.25, 'distance after which a view is compared or stored', unit='m', bounds=(0.001, 1e3))
    keyframe_angle_rad: float = parameter(
        0.2, 'turn after which a view is compared or stored', unit='rad', bounds=(0.001, 6.3))
    backend: str = parameter(
        'sequences', 'sequences: runs of views within the drift of the odometry make closures, '
        'the map is solved; published: RatSLAM as published, single views and its relaxation',
        choices=('sequences', 'published'))
    threshold: float = parameter(
        0.8, 'similarity mu from which a run of views is an old place', bounds=(-1.0, 1.0))
    tracking_threshold: float = parameter(
        0.6, 'the same while the old place is where odometry expects it', bounds=(-1.0, 1.0))
    tracking_distance_m: float = parameter(
        1.0, 'largest correction that counts as tracking', unit='m', bounds=(0.0, 1e3))
    sequence_length: int = parameter(
        14, 'views in a row that are compared as one', unit='views', bounds=(1, 200))
    min_age_s: float = parameter(
        10.0, 'age of an experience before it can be met again', unit='s', bounds=(0.0, 1e5))
    min_path_m: float = parameter(
        3.0, 'path flown before an experience can be met again', unit='m', bounds=(0.0, 1e5))
    gate_sigmas: float = parameter(
        3.0, 'deviations of the odometry within which an old place must lie', bounds=(0.1, 100.0))
    match_position_sigma_m: float = parameter(
        0.3, 'deviation of the position at which a view is met again', unit='m',
        bounds=(0.001, 100.0))
    match_yaw_sigma_rad: float = parameter(
        0.1, 'deviation of the heading at which a view is met again', unit='rad',
        bounds=(0.001, 6.3))
    relaxation_steps: int = parameter(
        100, 'steps of the relaxation per experience event', bounds=(0, 10000))


@dataclass(frozen=True)
class PoseCellsConfig(Section):
    """The continuous attractor network."""

    name = 'pose_cells'

    size_xy: int = parameter(21, 'cells along x and y', bounds=(8, 200))
    cell_size_m: float = parameter(1.0, 'edge of a cell', unit='m', bounds=(0.001, 1e3))
    injection: float = parameter(
        0.3, 'activity that a fresh view injects', bounds=(0.0, 100.0))
    active_decay: float = parameter(
        1.0, 'what a view loses of its power at each match', bounds=(0.0, 100.0))
    restore: float = parameter(
        0.05, 'what a view regains of its power per step', bounds=(0.0, 100.0))
    link_distance: float = parameter(
        2.0, 'distance in cells below which two experiences are one', unit='cells',
        bounds=(0.1, 100.0))


@dataclass(frozen=True)
class RecorderConfig(Section):
    """What the recorder writes."""

    name = 'recorder'

    topics: tuple = parameter((), 'topics to record; none and no regex: all topics')
    regex: str = parameter('', 'record topics whose whole name this expression matches')
    output: str = parameter('', 'folder of the recording; empty: recording_<date>')


@dataclass(frozen=True)
class Config:
    """All sections; what `--set`, YAML profiles and ROS parameters override."""

    image: ImageConfig = ImageConfig()
    view: ViewConfig = ViewConfig()
    encoder: EncoderConfig = EncoderConfig()
    patches: PatchesConfig = PatchesConfig()
    odometry: OdometryConfig = OdometryConfig()
    ratslam: RatSlamConfig = RatSlamConfig()
    pose_cells: PoseCellsConfig = PoseCellsConfig()
    recorder: RecorderConfig = RecorderConfig()

    def override(self, values: Mapping[str, Any]) -> Config:
        """Return this configuration with `section.name` keys replaced; refuse unknown keys."""
        changes: dict[str, dict[str, Any]] = {}
        for key, value in values.items():
            section, _, name = key.partition('.')
            if key not in PARAMETERS:
                raise ConfigError(f'unknown parameter {key!r} (value {value!r})')
            changes.setdefault(section, {})[name] = value
        return replace(self, **{
            section: replace(getattr(self, section), **names)
            for section, names in changes.items()})

    def flat(self) -> dict[str, Any]:
        """Return every parameter as `section.name`: value."""
        return {f'{section}.{name}': value
                for section, names in asdict(self).items() for name, value in names.items()}


def _parameters() -> Iterator[tuple[str, Any]]:
    for section in fields(Config):
        for spec in fields(section.default):
            yield f'{section.name}.{spec.name}', spec


PARAMETERS = dict(_parameters())


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
    """Whether a parameter is one that rclpy declares on every node."""
    return key in ('use_sim_time', 'start_type_description_service') or key.startswith(
        'qos_overrides.')


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
