"""What a recorder makes of the topics it finds."""

from types import SimpleNamespace
from unittest.mock import Mock

from dlsc_qbs_ros.nodes import recorder_topics
from dlsc_qbs_ros.nodes.recorder_topics import RecorderTopics
import pytest
from rclpy.qos import QoSProfile

STRING, NUMBER = 'std_msgs/msg/String', 'std_msgs/msg/Int32'


class Graph:
    """A graph in which `offered` are the types of the publishers of /a."""

    def __init__(self):
        self.offered = []
        self.node, self.recording = Mock(), Mock()
        self.node.get_topic_names_and_types.side_effect = lambda: [
            ('/a', sorted({STRING, *self.offered}))]  # somebody listens to it as to a string
        self.node.get_publishers_info_by_topic.side_effect = lambda topic: [
            SimpleNamespace(topic_type=kind, qos_profile=QoSProfile(depth=1))
            for kind in self.offered]
        self.topics = RecorderTopics(self.node, self.recording, ['/a'], {})

    def discover(self, *offered):
        self.offered[:] = offered
        for _ in range(3):
            self.topics.discover()

    def errors(self):
        return [call.args[0] for call in self.node.get_logger().error.call_args_list]

    def announced(self):
        return [call.args[:2] for call in self.recording.add_topic.call_args_list]


@pytest.fixture
def graph(monkeypatch):
    class Topic:
        def __init__(self, node, topic, type_name, overrides):
            self.type_name, self._listened_to = type_name, None

        def is_changed(self, offers):
            return self._listened_to != len(offers)

        def listen(self, offers):
            self._listened_to = len(offers)
    monkeypatch.setattr(recorder_topics, 'RecordedTopic', Topic)
    return Graph()


def test_another_type_on_a_topic_that_is_recorded_is_told_once(graph):
    graph.discover(STRING)
    assert graph.topics.refused == {}
    graph.discover(NUMBER)  # the first has gone, another takes its place
    assert graph.topics.refused == {f'/a of {NUMBER}': f'it is recorded as {STRING}'}
    assert graph.errors() == [f'/a of {NUMBER} is not recorded: it is recorded as {STRING}']
    graph.discover(STRING, STRING, NUMBER)  # and the first comes back, and one more
    assert graph.announced() == [('/a', STRING)] * 2
    assert len(graph.errors()) == 1


def test_a_topic_of_two_types_is_refused_until_one_is_gone(graph):
    graph.discover(STRING, NUMBER)
    reason = f'it has 2 types, {NUMBER}, {STRING}; expected 1'
    assert graph.topics.refused == {'/a': reason}
    assert graph.errors() == [f'/a is not recorded: {reason}']
    assert graph.announced() == []
    graph.discover()
    assert graph.topics.refused == {'/a': reason}
    graph.discover(NUMBER)
    assert graph.topics.refused == {}
    assert graph.announced() == [('/a', NUMBER)]


def test_a_subscriber_of_another_type_is_no_publisher(graph):
    graph.discover(NUMBER)
    assert graph.announced() == [('/a', NUMBER)]
