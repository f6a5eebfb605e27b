"""Profiles of topics from a file in rosbag2's words, put in place of what was adapted."""

from dlsc_qbs_ros.errors import ConfigError
from dlsc_qbs_ros.ros.qos import qos_to_words
from dlsc_qbs_ros.ros.qos_overrides import load_qos_overrides, overridden
import pytest
from rclpy.duration import Duration
from rclpy.qos import (
    DurabilityPolicy, HistoryPolicy, LivelinessPolicy, QoSProfile, ReliabilityPolicy)
import yaml

PROFILE = QoSProfile(
    depth=7, history=HistoryPolicy.KEEP_LAST, reliability=ReliabilityPolicy.BEST_EFFORT,
    durability=DurabilityPolicy.TRANSIENT_LOCAL, liveliness=LivelinessPolicy.AUTOMATIC,
    deadline=Duration(seconds=1, nanoseconds=5), lifespan=Duration(seconds=2),
    liveliness_lease_duration=Duration(seconds=3), avoid_ros_namespace_conventions=True)


@pytest.fixture
def write(tmp_path):
    """Give a function that writes a document or text into a file and returns its path."""
    def write_file(document):
        path = tmp_path / 'overrides.yaml'
        path.write_text(document if isinstance(document, str) else yaml.safe_dump(document))
        return path
    return write_file


def test_a_profile_in_rosbag2s_words_comes_back_as_it_was(write):
    words = {**qos_to_words(PROFILE), 'history': 'keep_last', 'depth': 7}
    values = load_qos_overrides(write({'/a': words}))
    assert overridden(QoSProfile(depth=1), values['/a']) == PROFILE


def test_what_the_file_does_not_name_stays_as_it_was_adapted(write):
    values = load_qos_overrides(write({'/a': {'reliability': 'best_effort'}}))
    qos = QoSProfile(depth=3, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    assert overridden(qos, values['/a']) == QoSProfile(
        depth=3, durability=DurabilityPolicy.TRANSIENT_LOCAL,
        reliability=ReliabilityPolicy.BEST_EFFORT)
    assert qos.reliability == ReliabilityPolicy.RELIABLE


@pytest.mark.parametrize('document, error', [
    ('a: [', 'not a readable YAML file'),
    ('[]', r'expected profiles by topic, found \[\]'),
    ({'a': {}}, 'expected the profile of a /topic, found a'),
    ({'/a': 'reliable'}, 'expected the profile of a /topic, found /a: reliable'),
    ({'/a': {'reliability': 'perfect'}},
     "/a: reliability = 'perfect': expected one of system_default, reliable, best_effort"),
    ({'/a': {'depth': -1}}, '/a: depth = -1: expected int'),
    ({'/a': {'depth': True}}, '/a: depth = True: expected int'),
    ({'/a': {'deadline': 5}}, '/a: deadline = 5: expected {sec: …, nsec: …}'),
    ({'/a': {'speed': 5}}, '/a: speed: no such policy; expected one of history, reliability')])
def test_what_is_no_profile_is_refused_by_name(write, document, error):
    with pytest.raises(ConfigError, match=error):
        load_qos_overrides(write(document))


def test_a_file_that_is_not_there_is_refused(tmp_path):
    with pytest.raises(ConfigError, match='nothing.yaml: not a readable YAML file'):
        load_qos_overrides(tmp_path / 'nothing.yaml')
