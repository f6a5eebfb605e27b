"""What a recorder makes of the topics it finds."""

from types import SimpleNamespace
from unittest.mock import Mock

from dlsc_qbs_ros.nodes import recorder_topics
from dlsc_qbs_ros.nodes.recorder_topics import RecorderTopics
from rclpy.qos import QoSProfile

STRING, NUMBER = 'std_msgs/msg/String', 'std_msgs/msg/Int32'


def test_another_type_on_a_topic_that_is_recorded_is_told_once(monkeypatch):
    offered = [STRING]
    node, recording = Mock(), Mock()
    node.get_topic_names_and_types.side_effect = lambda: [('/a', sorted(set(offered)))]
    node.get_publishers_info_by_topic.side_effect = lambda topic: [
        SimpleNamespace(topic_type=kind, qos_profile=QoSProfile(depth=1)) for kind in offered]
    monkeypatch.setattr(recorder_topics, 'RecordedTopic',
                        lambda node, topic, kind, overrides: Mock(type_name=kind))
    topics = RecorderTopics(node, recording, ['/a'], {})
    topics.discover()
    assert topics.refused == {}
    offered[:] = [NUMBER]  # the first has gone, another takes its place
    for _ in range(3):
        topics.discover()
    assert topics.refused == {f'/a of {NUMBER}': f'it is recorded as {STRING}'}
    node.get_logger().error.assert_called_once_with(
        f'/a of {NUMBER} is not recorded: it is recorded as {STRING}')
    offered[:] = [STRING, NUMBER]  # and the first comes back
    topics.discover()
    assert [call.args[:2] for call in recording.add_topic.call_args_list] == [('/a', STRING)] * 2
