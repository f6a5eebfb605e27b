"""What RViz and Foxglove are told to show is what the nodes publish, type, frame and offer."""

import json
from pathlib import Path
import re

from dlsc_qbs_ros.config import Config
from dlsc_qbs_ros.ros.serialization import message_type
import pytest
from rclpy.qos import (
    DurabilityPolicy, qos_check_compatible, QoSCompatibility, QoSProfile, ReliabilityPolicy)
import yaml

CONFIG = Path(__file__).parents[2] / 'config'
SHOWN_BY_RVIZ = {
    'MarkerArray': 'visualization_msgs/msg/MarkerArray', 'Path': 'nav_msgs/msg/Path',
    'PoseWithCovariance': 'geometry_msgs/msg/PoseWithCovarianceStamped',
    'Odometry': 'nav_msgs/msg/Odometry', 'Image': 'sensor_msgs/msg/Image',
    'SetInitialPose': 'geometry_msgs/msg/PoseWithCovarianceStamped'}
SHOWN_BY_FOXGLOVE = {
    '3D': {*SHOWN_BY_RVIZ.values()} - {'sensor_msgs/msg/Image'},
    'Image': {'sensor_msgs/msg/Image'},
    'Plot': {'geometry_msgs/msg/PoseWithCovarianceStamped', 'sensor_msgs/msg/JointState'},
    'DiagnosticSummary': {'diagnostic_msgs/msg/DiagnosticArray'}}


@pytest.fixture
def rviz():
    return yaml.safe_load((CONFIG / 'slam.rviz').read_text())['Visualization Manager']


@pytest.fixture
def foxglove():
    return json.loads((CONFIG / 'slam_foxglove.json').read_text())


@pytest.fixture
def topics(start, observer):
    """Give topic -> type of the live nodes, fed by a camera."""
    start('nodes.encoder_node', '--ros-args', '-r', 'image:=/camera/image_raw')
    start('nodes.ratslam_node')
    awaited = {'/camera/image_raw', '/view', '/learning', '/dictionary_image', '/diagnostics',
               '/experience_map', '/path', '/pose', '/odom', '/initialpose'}

    def names():
        return {name: types[0] for name, types in observer.node.get_topic_names_and_types()}
    observer.spin_until(lambda: awaited <= names().keys())
    return names()


def panels(node):
    """Yield the panels that a layout of Foxglove is made of."""
    if isinstance(node, str):
        yield node
    else:
        yield from (panel for side in ('first', 'second') for panel in panels(node[side]))


def foxglove_topics(name, panel):
    yield from panel.get('topics', ())
    yield from filter(None, [panel.get('topicToRender'),
                             panel.get('imageMode', {}).get('imageTopic')])
    if name.startswith('3D!'):
        yield panel['publish']['poseEstimateTopic']
    yield from (series['value'].partition('.')[0] for series in panel.get('paths', ()))


def test_rviz_shows_what_there_is(rviz, topics, observer):
    shown = [(item['Class'].partition('/')[2], item['Topic'])
             for item in rviz['Displays'] + rviz['Tools'] if 'Topic' in item]
    assert len(shown) > 5
    for kind, topic in shown:
        assert topics[topic['Value']] == SHOWN_BY_RVIZ[kind]
        wanted = QoSProfile(
            depth=topic['Depth'],
            reliability=ReliabilityPolicy[topic['Reliability Policy'].upper().replace(' ', '_')],
            durability=DurabilityPolicy[topic['Durability Policy'].upper().replace(' ', '_')])
        for publisher in observer.node.get_publishers_info_by_topic(topic['Value']):
            assert qos_check_compatible(
                publisher.qos_profile, wanted)[0] != QoSCompatibility.ERROR, topic['Value']


def test_foxglove_shows_what_there_is(foxglove, topics):
    for name, panel in foxglove['configById'].items():
        for topic in foxglove_topics(name, panel):
            assert topics[topic] in SHOWN_BY_FOXGLOVE[name.partition('!')[0]]
        for series in panel.get('paths', ()):
            topic, *path = series['value'].split('.')
            value = message_type(topics[topic])()
            for field in path:
                value = getattr(value, re.sub(r'\[\d+\]$', '', field))


def test_every_panel_of_foxglove_has_its_place_and_its_settings(foxglove):
    assert sorted(panels(foxglove['layout'])) == sorted(foxglove['configById'])


def test_both_look_on_from_the_map(rviz, foxglove):
    frame = Config().ratslam.map_frame
    assert rviz['Global Options']['Fixed Frame'] == frame
    assert rviz['Views']['Current']['Target Frame'] == frame
    assert foxglove['configById']['3D!map']['followTf'] == frame
