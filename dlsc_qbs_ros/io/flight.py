"""Recorded flights: frames, odometry and ground truth out of any ROS 2 recording."""

from __future__ import annotations

from collections import Counter
import heapq
import logging
from operator import itemgetter
from pathlib import Path
from typing import Callable, Iterator, Mapping

from .recordings.bag import bag_topics, read_bag
from .recordings.mcap_file import BagMessage
from ..config import MavlinkConfig
from ..core.types import Frame, GroundTruthSample, RawOdometry
from ..errors import DlscQbsError, RecordingError

GROUND_TRUTH_TOPIC = '/ground_truth'
_IMAGE_TYPES = ('sensor_msgs/msg/Image', 'sensor_msgs/msg/CompressedImage')
_ODOMETRY_TYPES = ('nav_msgs/msg/Odometry',)
_POSE_TYPES = ('geometry_msgs/msg/PoseStamped', 'geometry_msgs/msg/PoseWithCovarianceStamped',
               'nav_msgs/msg/Odometry')

_log = logging.getLogger(__name__)


def read_flight(path: Path, image_topic: str | None = None, odom_topic: str | None = None,
                ground_truth_topic: str | None = None, refused: Counter | None = None,
                tlog: Path | None = None, mavlink: MavlinkConfig = MavlinkConfig()
                ) -> Iterator[Frame | RawOdometry | GroundTruthSample]:
    """
    Read the events of a flight in the order in which they were recorded.

    Parameters
    ----------
    path : Path
        An MCAP file or a rosbag2 folder.
    image_topic, odom_topic : str, optional
        Left out: the only topic of a fitting type.
    ground_truth_topic : str, optional
        Left out: `/ground_truth`, and none where the flight has no such topic.
    refused : Counter, optional
        Counts the messages that were refused, by topic.
    tlog : Path, optional
        A recording of a MAVLink link, on the same clock, that odometry is taken from instead of
        a topic.
    mavlink : MavlinkConfig
        Which autopilot's, of those in it.

    Raises
    ------
    RecordingError
        When a recording cannot be read or holds no odometry, or a topic is missing, of the wrong
        type or not the only one.

    """
    refused = Counter() if refused is None else refused
    converters = _converters(
        path, bag_topics(path), image_topic, odom_topic, ground_truth_topic, tlog is None)
    events = _recorded(path, converters, refused)
    if tlog is not None:
        events = heapq.merge(events, _logged(tlog, mavlink, refused), key=itemgetter(0))
    for _, event in events:
        yield event


def _recorded(path: Path, converters: Mapping[str, Callable], refused: Counter
              ) -> Iterator[tuple[int, Frame | RawOdometry | GroundTruthSample]]:
    for message in read_bag(path, converters):
        try:
            yield message.log_time_ns, converters[message.topic](message)
        except DlscQbsError as error:
            if not refused[message.topic]:
                _log.warning('%s: %s: refused: %s', path, message.topic, error)
            refused[message.topic] += 1


def _logged(tlog: Path, mavlink: MavlinkConfig, refused: Counter
            ) -> Iterator[tuple[int, RawOdometry]]:
    from .mavlink.tlog import TlogOdometry  # only here: flights without one need no pymavlink
    odometry, raw = TlogOdometry(tlog, mavlink), None
    for raw in odometry:
        yield raw.sample.stamp_ns, raw
    if raw is None:
        raise RecordingError(f'{tlog}: holds no odometry of an autopilot')
    refused.update({f'{tlog.name} ({cause})': n for cause, n in odometry.counts.items()})


def _converters(path: Path, topics: Mapping[str, str], image_topic: str | None,
                odom_topic: str | None, ground_truth_topic: str | None, has_odometry: bool
                ) -> dict[str, Callable]:
    from ..ros import conversions, image_conversions  # messages belong to ros; only used here
    from ..ros.serialization import deserialize

    truth = ground_truth_topic
    if truth is None and topics.get(GROUND_TRUTH_TOPIC) in _POSE_TYPES:
        truth = GROUND_TRUTH_TOPIC
    chosen = {
        _only(path, topics, image_topic, _IMAGE_TYPES, truth): image_conversions.frame_from_msg}
    if has_odometry:
        odom = _only(path, topics, odom_topic, _ODOMETRY_TYPES, truth)
        chosen[odom] = conversions.odometry_from_msg
    if truth is not None:
        chosen[_only(path, topics, truth, _POSE_TYPES)] = conversions.pose_stamped_from_msg

    def converter(convert):
        def converted(message: BagMessage):
            return convert(deserialize(message.data, message.type_name))
        return converted
    return {topic: converter(convert) for topic, convert in chosen.items()}


def _only(path: Path, topics: Mapping[str, str], wanted: str | None, types: tuple[str, ...],
          taken: str | None = None) -> str:
    """Return the wanted topic if it is of a fitting type, or the only one but the taken."""
    fitting = sorted(
        topic for topic, name in topics.items() if name in types and topic != taken)
    if wanted is None:
        if len(fitting) == 1:
            return fitting[0]
        raise RecordingError(f'{path}: expected one topic of {" or ".join(types)}; '
                             f'found {", ".join(fitting) or "none"}')
    if wanted not in topics:
        raise RecordingError(
            f'{path}: no topic {wanted!r}; it has {", ".join(sorted(topics)) or "none"}')
    if topics[wanted] not in types:
        raise RecordingError(
            f'{path}: topic {wanted!r} is {topics[wanted]}; expected {" or ".join(types)}')
    if wanted == taken:
        raise RecordingError(f'{path}: topic {wanted!r} is the ground truth; expected another')
    return wanted
