"""
Every parameter of the package, declared once.

A dataclass field here is a ROS parameter (`section.name`), a key of a YAML profile and a key of
`--set` on the command line; its default, unit, range and meaning stand beside it and nowhere else.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields, replace
from typing import Any, Iterator, Mapping

from .declaration import parameter, Section
from .errors import ConfigError


@dataclass(frozen=True)
class ImageConfig(Section):
    """How images reach the encoder."""

    name = 'image'
    fixed_by = 'the subscription is made with it'

    compressed: bool = parameter(
        False, 'subscribe to sensor_msgs/CompressedImage instead of sensor_msgs/Image')


@dataclass(frozen=True)
class ViewConfig(Section):
    """The view: the cropped, resized grey image that a code is made of."""

    name = 'view'
    fixed_by = 'codes made with another could not be compared'

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
    fixed_by = 'codes made with another could not be compared'

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
    fixed_by = 'codes made with another could not be compared'

    size: int = parameter(5, 'edge of a patch', unit='px', bounds=(2, 32))
    n_learned: int = parameter(
        128, 'random patches of a frame that are learned from', bounds=(1, 100000))
    eta_d: float = parameter(
        5.0, 'learning rate, in place of encoder.eta_d: four times that at first, soon this',
        bounds=(0.0, 100.0))
    cells_x: int = parameter(5, 'cells along the width that codes are pooled into',
                             bounds=(1, 64))
    cells_y: int = parameter(4, 'cells along the height', bounds=(1, 64))


@dataclass(frozen=True)
class OdometryConfig(Section):
    """Where odometry comes from and what is believed of it."""

    name = 'odometry'
    fixed_by = 'the source is opened with it'

    source: str = parameter(
        'nav_msgs', 'the odometry source: a topic, or the link to an autopilot',
        choices=('nav_msgs', 'mavlink'))
    use_twist: bool = parameter(
        False, 'integrate the recorded twist instead of differencing poses')
    max_gap_s: float = parameter(
        2.0, 'with use_twist, a longer silence starts a new segment', unit='s',
        bounds=(0.01, 3600.0), live=True)
    max_speed_m_s: float = parameter(
        50.0, 'a faster step is a jump and starts a new segment', unit='m/s',
        bounds=(0.1, 1000.0), live=True)
    translation_drift: float = parameter(
        0.03, 'deviation of the distance flown, per metre, and of its scale; 0: none', unit='m/m',
        bounds=(0.0, 1.0), live=True)
    yaw_bias_rad_s: float = parameter(
        0.012, 'deviation of a constant error of the yaw rate, before closures tell it; 0: none',
        unit='rad/s', bounds=(0.0, 1.0), live=True)
    yaw_noise: float = parameter(
        0.03, 'deviation of the heading after one second of random walk', unit='rad/sqrt(s)',
        bounds=(0.0, 1.0), live=True)
    visual_gyro: bool = parameter(
        True, 'take out the error of the yaw rate that views tell, of a camera that looks ahead',
        live=True)


@dataclass(frozen=True)
class MavlinkConfig(Section):
    """The link to the autopilot, where odometry comes from it."""

    name = 'mavlink'
    fixed_by = 'the link is opened with it'

    connection: str = parameter(
        'udpin:0.0.0.0:14540', 'udpin:HOST:PORT, udpout:HOST:PORT, tcp:HOST:PORT, '
        '/dev/DEVICE:BAUD or a recording, FILE.tlog')
    system: int = parameter(
        0, 'system id of the autopilot; 0: the first that is heard', bounds=(0, 255))
    component: int = parameter(
        1, 'component id of the autopilot; 0: the first that is heard', bounds=(0, 255))
    rate_hz: float = parameter(
        30.0, 'rate at which odometry is asked for', unit='Hz', bounds=(4.0, 1000.0))
    key_file: str = parameter(
        '', 'key to sign with: 32 bytes, 64 hex digits or a passphrase; empty: unsigned')
    vision_output: bool = parameter(
        False, 'send the pose in the map back to the autopilot, as ODOMETRY in LOCAL_FRD')
    vision_rate_hz: float = parameter(
        10.0, 'rate of these poses, within that of odometry', unit='Hz', bounds=(4.0, 100.0))


@dataclass(frozen=True)
class RatSlamConfig(Section):
    """When a place is an old one, and what follows from it."""

    name = 'ratslam'
    fixed_by = 'the map is built with it'

    sample_period_s: float = parameter(
        0.1, 'time between the codes that are used', unit='s', bounds=(0.001, 60.0), live=True)
    max_wait_s: float = parameter(
        0.2, 'longest wait for a late code, view, dictionary or odometry', unit='s',
        bounds=(0.0, 60.0), live=True)
    map_frame: str = parameter('map', 'frame_id of the map')
    map_file: str = parameter(
        '', 'file that the map is saved to and loaded from, at the start if it is there; empty: '
        'none', live=True)
    mode: str = parameter(
        'mapping', 'what the node starts with: mapping, going on in map_file where it is there; '
        'localization: in map_file, which stays as it is', choices=('mapping', 'localization'))
    autosave_s: float = parameter(
        0.0, 'time between saves of a map that grows, beside the one at the end; 0: none',
        unit='s', bounds=(0.0, 86400.0), live=True)
    publish_tf: bool = parameter(True, 'publish map to odom on /tf', live=True)
    keyframe_distance_m: float = parameter(
        0.25, 'distance after which a view is compared or stored', unit='m', bounds=(0.001, 1e3),
        live=True)
    keyframe_angle_rad: float = parameter(
        0.2, 'turn after which a view is compared or stored', unit='rad', bounds=(0.001, 6.3),
        live=True)
    backend: str = parameter(
        'sequences', 'sequences: runs of views within the drift of the odometry make closures, '
        'the map is solved; published: RatSLAM as published, single views and its relaxation',
        choices=('sequences', 'published'))
    threshold: float = parameter(
        0.8, 'similarity mu from which a run of views is an old place; one of four needs more',
        bounds=(-1.0, 1.0), live=True)
    tracking_threshold: float = parameter(
        0.6, 'the same while the old place is where odometry expects it', bounds=(-1.0, 1.0),
        live=True)
    tracking_distance_m: float = parameter(
        1.0, 'largest correction that counts as tracking', unit='m', bounds=(0.0, 1e3), live=True)
    sequence_length: int = parameter(
        14, 'views in a row that are compared as one', unit='views', bounds=(1, 200))
    min_age_s: float = parameter(
        10.0, 'age of an experience, in motion, before it can be met again', unit='s',
        bounds=(0.0, 1e5), live=True)
    min_path_m: float = parameter(
        3.0, 'path flown before an experience can be met again', unit='m', bounds=(0.0, 1e5),
        live=True)
    gate_sigmas: float = parameter(
        3.0, 'deviations of the odometry within which an old place must lie', bounds=(0.1, 100.0),
        live=True)
    match_position_sigma_m: float = parameter(
        0.3, 'deviation of the position at which a view is met again', unit='m',
        bounds=(0.001, 100.0), live=True)
    match_yaw_sigma_rad: float = parameter(
        0.1, 'deviation of the heading at which a view is met again', unit='rad',
        bounds=(0.001, 6.3), live=True)
    relaxation_steps: int = parameter(
        100, 'most steps of the relaxation per experience event', bounds=(0, 10000), live=True)


@dataclass(frozen=True)
class PoseCellsConfig(Section):
    """The continuous attractor network."""

    name = 'pose_cells'
    fixed_by = 'the network is built with it'

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
    fixed_by = 'the recording is opened with it'

    topics: tuple = parameter((), 'topics to record; none and no regex: all topics')
    regex: str = parameter('', 'record topics whose whole name this expression matches')
    exclude_regex: str = parameter('', 'never topics whose whole name this expression matches')
    exclude_topics: tuple = parameter((), 'topics never to record')
    include_hidden_topics: bool = parameter(
        False, 'without a choice, record those with a name that starts with _ too')
    qos_profile_overrides_path: str = parameter(
        '', "YAML file of profiles, topic by topic, as rosbag2's, in place of the adapted ones")
    start_paused: bool = parameter(False, 'record nothing before ~/resume is called')
    output: str = parameter('', 'folder of the recording; empty: recording_<date>')
    flush_interval_s: float = parameter(
        0.1, 'a message is in the file, safe from a crash of this process, after so long',
        unit='s', bounds=(0.001, 60.0))
    sync_interval_s: float = parameter(
        1.0, 'what was written is on the medium, safe from a power cut, after so long; '
        '0: when the system sees fit', unit='s', bounds=(0.0, 3600.0))
    max_bytes: int = parameter(
        0, 'size at which the next file begins; 0: never', unit='bytes', bounds=(0, 2**62))
    max_duration_s: float = parameter(
        0.0, 'duration at which the next file begins; 0: never', unit='s', bounds=(0.0, 1e6))
    max_files: int = parameter(
        0, 'files that are kept, the oldest is deleted; 0: all', bounds=(0, 1000000))
    compression: str = parameter(
        'none', 'how chunks are compressed inside the file', choices=('none', 'lz4', 'zstd'))
    min_free_bytes: int = parameter(
        2**28, 'room on the disk at which the recording ends, whole; 0: when a write fails',
        unit='bytes', bounds=(0, 2**62))
    queue_bytes: int = parameter(
        2**27, 'messages that may wait for the disk; more are refused and counted',
        unit='bytes', bounds=(1, 2**62))
    snapshot_s: float = parameter(
        0.0, 'keep the last messages in memory and write them on request only; '
        '0: write all messages', unit='s', bounds=(0.0, 1e6))
    snapshot_bytes: int = parameter(
        2**28, 'room for them; more are forgotten, the oldest first', unit='bytes',
        bounds=(1, 2**62))
    attachments: tuple = parameter(
        (), 'files, such as calibrations, that are put into each file of the recording')


@dataclass(frozen=True)
class Config:
    """All sections; what `--set`, YAML profiles and ROS parameters override."""

    image: ImageConfig = ImageConfig()
    view: ViewConfig = ViewConfig()
    encoder: EncoderConfig = EncoderConfig()
    patches: PatchesConfig = PatchesConfig()
    odometry: OdometryConfig = OdometryConfig()
    mavlink: MavlinkConfig = MavlinkConfig()
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

    def retuned(self, values: Mapping[str, Any]) -> Config:
        """Return this configuration with `live` parameters replaced; refuse to change others."""
        changed = self.override(values)
        before, after = self.flat(), changed.flat()
        for key in values:
            if after[key] != before[key] and not PARAMETERS[key].metadata['live']:
                why = getattr(self, key.partition('.')[0]).fixed_by
                raise ConfigError(f'{key} cannot change while the node is configured: {why}; '
                                  'deactivate and clean up first')
        return changed

    def flat(self) -> dict[str, Any]:
        """Return every parameter as `section.name`: value."""
        return {f'{section}.{name}': value
                for section, names in asdict(self).items() for name, value in names.items()}


def _parameters() -> Iterator[tuple[str, Any]]:
    for section in fields(Config):
        for spec in fields(section.default):
            yield f'{section.name}.{spec.name}', spec


PARAMETERS = dict(_parameters())
