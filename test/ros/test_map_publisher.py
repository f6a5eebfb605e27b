"""The map goes out when it changed, to whom it may concern, the more rarely the larger it is."""

from types import SimpleNamespace

from dlsc_qbs_ros.core.experience_map import ExperienceMap
from dlsc_qbs_ros.core.types import Pose2
from dlsc_qbs_ros.nodes import map_publisher
from dlsc_qbs_ros.nodes.map_publisher import MapPublisher
from dlsc_qbs_ros.ros.serialization import deserialize
import pytest

PATH, MARKERS = 'path', 'experience_map'


class Publisher:
    """Keeps what is published and is heard by as many as it is told."""

    def __init__(self, heard_by):
        self.heard_by, self.sent = heard_by, []
        self.publish = self.sent.append

    def get_subscription_count(self):
        return self.heard_by

    def wait_for_all_acked(self, timeout):
        return True


class Stand:
    """A publisher of maps, its topics and its clock, heard by one subscriber of each topic."""

    def __init__(self, monkeypatch, n_experiences=4):
        self.topics = {PATH: Publisher(1), MARKERS: Publisher(1)}
        self.now_s = 0.0
        monkeypatch.setattr(map_publisher, 'create_publisher',
                            lambda node, kind, topic, qos: self.topics[topic])
        monkeypatch.setattr(map_publisher.time, 'monotonic', lambda: self.now_s)
        self.mapper = SimpleNamespace(map=ExperienceMap(), odometry=None)
        for k in range(n_experiences):
            self.mapper.map.add_experience(Pose2(k, 0.0, 0.0))
        self.publisher = MapPublisher(None)

    def publish(self):
        """Give an occasion to publish; return how often each topic has been sent so far."""
        self.publisher.publish(self.mapper, 'map')
        return [len(topic.sent) for topic in self.topics.values()]


@pytest.fixture
def stand(monkeypatch):
    return Stand(monkeypatch)


def test_a_map_goes_out_once_for_each_change(stand):
    assert stand.publish() == [0, 0]
    stand.publisher.map_updated(7)
    assert [stand.publish(), stand.publish()] == [[1, 1], [1, 1]]
    stand.now_s += 1.0
    stand.publisher.map_updated(8)
    assert stand.publish() == [2, 2]
    path = deserialize(stand.topics[PATH].sent[-1], 'nav_msgs/msg/Path')
    assert (path.header.stamp.nanosec, len(path.poses)) == (8, 4)


def test_a_large_map_goes_out_the_more_rarely(monkeypatch):
    stand = Stand(monkeypatch, 4000)
    wait_s = 4000 * MapPublisher.PER_EXPERIENCE_S
    sent = []
    for stand.now_s in (0.0, 0.5 * wait_s, 0.99 * wait_s, wait_s):
        stand.publisher.map_updated(1)
        sent.append(stand.publish())
    assert sent == [[1, 1], [1, 1], [1, 1], [2, 2]]


def test_nobody_listening_costs_nothing_and_whoever_comes_has_the_map_at_once(stand):
    for topic in stand.topics.values():
        topic.heard_by = 0
    stand.publisher.map_updated(1)
    assert stand.publish() == [0, 0]
    stand.topics[MARKERS].heard_by = 1
    assert [stand.publish(), stand.publish()] == [[0, 1], [0, 1]]
    for stand.topics[MARKERS].heard_by in (2, 1, 2):
        sent = stand.publish()
    assert sent == [0, 3]


def test_the_last_map_goes_out_whoever_listens(stand):
    stand.publisher.publish_last(stand.mapper, 'map')
    assert stand.publish() == [0, 0]
    for topic in stand.topics.values():
        topic.heard_by = 0
    stand.publisher.map_updated(1)
    stand.publisher.publish_last(stand.mapper, 'map')
    assert [len(topic.sent) for topic in stand.topics.values()] == [1, 1]


def test_another_map_is_shown_at_once_and_so_is_an_empty_one(stand):
    stand.publisher.map_updated(1)
    assert stand.publish() == [1, 1]
    loaded = ExperienceMap()
    for k in range(3):
        loaded.add_experience(Pose2(k, 0.0, 0.0))
    stand.mapper = SimpleNamespace(map=loaded, odometry=SimpleNamespace(stamp_ns=9))
    assert [stand.publish(), stand.publish()] == [[2, 2], [2, 2]]
    path = deserialize(stand.topics[PATH].sent[-1], 'nav_msgs/msg/Path')
    assert (path.header.stamp.nanosec, len(path.poses)) == (9, 3)
    stand.mapper = SimpleNamespace(map=ExperienceMap(), odometry=None)
    assert [stand.publish(), stand.publish()] == [[3, 3], [3, 3]]
    assert not deserialize(stand.topics[PATH].sent[-1], 'nav_msgs/msg/Path').poses
