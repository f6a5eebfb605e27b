"""Core types survive the way into a message, over the wire and back; bad messages do not pass."""

from math import inf, nan

from diagnostic_msgs.msg import DiagnosticStatus
from dlsc_qbs_ros.core.types import (
    Code, Dictionary, GroundTruthSample, IDENTITY, OdometrySample, Pose2, PoseEstimate, View)
from dlsc_qbs_ros.errors import ImageError, OdometryError, RecordingError
from dlsc_qbs_ros.ros import conversions, map_conversions
from dlsc_qbs_ros.ros.serialization import (
    begins_with_header, deserialize, header_stamp_ns, message_type, serialize, type_name,
    with_header_stamp)
from dlsc_qbs_ros.ros.stamps import ns_to_stamp, stamp_to_ns
from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import Odometry
import numpy as np
import pytest
from sensor_msgs.msg import Image
from visualization_msgs.msg import Marker

STAMP_NS = 1_700_000_000_123_456_789
SAMPLE = OdometrySample(STAMP_NS, Pose2(1.5, -2.25, 2.5), 3.0, 0.1, -0.2)


def over_the_wire(msg):
    return deserialize(serialize(msg), type_name(msg))


def assert_same_sample(a, b):
    assert (a.stamp_ns, a.segment) == (b.stamp_ns, b.segment)
    assert (*a.pose, a.z_m, a.roll_rad, a.pitch_rad) == pytest.approx(
        (*b.pose, b.z_m, b.roll_rad, b.pitch_rad), abs=1e-12)


@pytest.mark.parametrize('stamp_ns', [0, 1, 999_999_999, 1_000_000_000, STAMP_NS])
def test_stamps_come_back_to_the_nanosecond(stamp_ns):
    assert stamp_to_ns(ns_to_stamp(stamp_ns)) == stamp_ns


def test_odometry_comes_back():
    msg = over_the_wire(conversions.odometry_to_msg(SAMPLE, 1.25, -0.5, 'odom', 'base_link'))
    assert (msg.header.frame_id, msg.child_frame_id) == ('odom', 'base_link')
    raw = conversions.odometry_from_msg(msg)
    assert_same_sample(raw.sample, SAMPLE)
    assert (raw.forward_m_s, raw.left_m_s, raw.yaw_rate_rad_s) == (1.25, 0.0, -0.5)


def test_a_quaternion_need_not_have_length_one():
    msg = conversions.odometry_to_msg(SAMPLE, 0.0, 0.0, 'odom', 'base_link')
    for axis in 'xyzw':
        setattr(msg.pose.pose.orientation, axis, 3 * getattr(msg.pose.pose.orientation, axis))
    assert_same_sample(conversions.odometry_from_msg(msg).sample, SAMPLE)


@pytest.mark.parametrize('value', [nan, inf, -inf])
@pytest.mark.parametrize('part, field', [
    *(('position', axis) for axis in 'xyz'), *(('orientation', axis) for axis in 'xyzw')])
def test_odometry_that_is_not_finite_is_refused(part, field, value):
    msg = conversions.odometry_to_msg(SAMPLE, 0.0, 0.0, 'odom', 'base_link')
    setattr(getattr(msg.pose.pose, part), field, value)
    with pytest.raises(OdometryError, match=str(value)):
        conversions.odometry_from_msg(msg)


@pytest.mark.parametrize('axis', 'xyz')
def test_odometry_from_beyond_the_world_is_refused(axis):
    msg = conversions.odometry_to_msg(SAMPLE, 0.0, 0.0, 'odom', 'base_link')
    setattr(msg.pose.pose.position, axis, -1.1e8)
    with pytest.raises(OdometryError, match=r'-110000000.0.*: expected .* none beyond 1e\+08'):
        conversions.odometry_from_msg(msg)


def test_a_quaternion_of_zeros_is_refused():
    msg = Odometry()
    msg.pose.pose.orientation.w = 0.0
    with pytest.raises(OdometryError, match=r'quaternion \(0.0, 0.0, 0.0, 0.0\)'):
        conversions.odometry_from_msg(msg)


def test_ground_truth_comes_back():
    sample = GroundTruthSample(STAMP_NS, Pose2(1.0, 2.0, -3.0))
    msg = over_the_wire(conversions.pose_stamped_to_msg(sample, 'world'))
    assert msg.header.frame_id == 'world'
    back = conversions.pose_stamped_from_msg(msg)
    assert back.stamp_ns == STAMP_NS
    assert back.pose == pytest.approx(sample.pose, abs=1e-12)


@pytest.mark.parametrize('msg_type', [PoseWithCovarianceStamped, Odometry])
def test_ground_truth_may_be_of_other_pose_types(msg_type):
    msg = msg_type()
    msg.header.stamp = ns_to_stamp(STAMP_NS)
    msg.pose.pose.position.y = 4.0
    assert conversions.pose_stamped_from_msg(msg) == GroundTruthSample(
        STAMP_NS, Pose2(0.0, 4.0, 0.0))


def test_an_estimate_keeps_height_and_tilt_of_its_odometry():
    estimate = PoseEstimate(
        STAMP_NS, Pose2(5.0, 6.0, 0.7), SAMPLE, IDENTITY, IDENTITY, 0.5, 0.1)
    msg = over_the_wire(conversions.pose_to_msg(estimate, 'map'))
    assert (msg.header.frame_id, stamp_to_ns(msg.header.stamp)) == ('map', STAMP_NS)
    as_odometry = Odometry(header=msg.header, pose=msg.pose)
    assert_same_sample(
        conversions.odometry_from_msg(as_odometry).sample,
        OdometrySample(STAMP_NS, Pose2(5.0, 6.0, 0.7), 3.0, 0.1, -0.2))
    covariance = msg.pose.covariance.reshape(6, 6)
    unmeasured = conversions.UNMEASURED_VARIANCE
    np.testing.assert_allclose(
        covariance, np.diag([0.25, 0.25, unmeasured, unmeasured, unmeasured, 0.01]))


@pytest.mark.parametrize('dictionary_ns', [None, 0, STAMP_NS - 5])
def test_a_code_comes_back_with_the_name_of_its_dictionary(dictionary_ns):
    code = Code(STAMP_NS, np.float32([0.5, -1e-30, 3e30]), dictionary_ns)
    msg = over_the_wire(conversions.code_to_msg(code))
    assert (msg.encoding, msg.height, msg.width) == ('32FC1', 1, 3)
    back = conversions.code_from_msg(msg)
    assert (back.stamp_ns, back.dictionary_ns) == (STAMP_NS, dictionary_ns)
    assert back.values.dtype == np.float32
    np.testing.assert_array_equal(back.values, code.values)


def test_a_dictionary_comes_back():
    atoms = np.random.default_rng(0).normal(size=(4, 7)).astype(np.float32)
    msg = over_the_wire(conversions.dictionary_to_msg(Dictionary(STAMP_NS, atoms)))
    assert (msg.encoding, msg.height, msg.width) == ('32FC1', 4, 7)
    back = conversions.dictionary_from_msg(msg)
    assert back.stamp_ns == STAMP_NS == stamp_to_ns(msg.header.stamp)
    np.testing.assert_array_equal(back.atoms, atoms)


def test_a_code_names_the_dictionary_as_the_dictionary_does():
    code = conversions.code_to_msg(Code(STAMP_NS + 9, np.zeros(2, np.float32), STAMP_NS))
    dictionary = conversions.dictionary_to_msg(
        Dictionary(STAMP_NS, np.zeros((2, 3), np.float32)))
    assert code.header.frame_id == dictionary.header.frame_id


def test_a_view_comes_back():
    pixels = np.random.default_rng(0).integers(0, 256, (5, 7), dtype=np.uint8)
    back = conversions.view_from_msg(over_the_wire(conversions.view_to_msg(View(3, pixels))))
    assert back.stamp_ns == 3
    np.testing.assert_array_equal(back.pixels, pixels)


def test_floats_of_the_other_byte_order_are_read():
    msg = conversions.code_to_msg(Code(0, np.float32([1.5, -2.0]), None))
    msg.data = msg.data[3::-1] + msg.data[:3:-1]
    msg.is_bigendian = 1 - msg.is_bigendian
    np.testing.assert_array_equal(conversions.code_from_msg(msg).values, [1.5, -2.0])


@pytest.mark.parametrize('changes, error', [
    ({'encoding': 'mono8'}, "1×3 image of 'mono8'"),
    ({'step': 11}, 'with step 11: expected packed 32FC1'),
    ({'width': 0, 'step': 0}, '1×0 image'),
    ({'height': 2}, '12 bytes of data: expected 24'),
    ({'frame_id': 'camera'}, "frame_id 'camera': expected dictionary_<nanoseconds>"),
    ({'frame_id': 'dictionary_' + 5000 * '1'}, 'expected dictionary_<nanoseconds>'),
    ({'frame_id': 'dictionary_\u0661'}, 'expected dictionary_<nanoseconds>'),
    ({'values': [1.0, nan, 0.0]}, 'not finite'),
])
def test_a_malformed_code_is_refused(changes, error):
    values = np.float32(changes.pop('values', [1.0, 2.0, 3.0]))
    msg = conversions.code_to_msg(Code(0, values, 0))
    msg.header.frame_id = changes.pop('frame_id', msg.header.frame_id)
    for field, value in changes.items():
        setattr(msg, field, value)
    with pytest.raises(ImageError, match=error):
        conversions.code_from_msg(msg)


def test_a_dictionary_is_no_code():
    msg = conversions.dictionary_to_msg(Dictionary(0, np.zeros((2, 3), np.float32)))
    with pytest.raises(ImageError, match='code of 2 rows: expected 1'):
        conversions.code_from_msg(msg)


def test_a_colour_image_is_no_view():
    with pytest.raises(ImageError, match="view with encoding 'rgb8': expected mono8"):
        conversions.view_from_msg(Image(encoding='rgb8'))


def mapped(cdr):
    """Return the message in CDR, which is as long as rclpy makes it."""
    msg = deserialize(cdr, 'nav_msgs/msg/Path' if b'links' not in cdr
                      else 'visualization_msgs/msg/MarkerArray')
    assert len(serialize(msg)) == len(cdr)
    return msg


@pytest.mark.parametrize('frame_id', ['map', 'drone_1/map', ''])
@pytest.mark.parametrize('n', [0, 1, 2, 5])
def test_a_path_holds_every_experience(n, frame_id):
    experiences = np.array([[0.0, 1.0, 0.5], [2.0, 3.0, -3.0], [4.0, 1 / 3, 0.0]] * 2)[:n]
    msg = mapped(map_conversions.path_to_cdr(STAMP_NS, experiences, frame_id))
    headers = [msg.header, *(pose.header for pose in msg.poses)]
    assert {(header.frame_id, stamp_to_ns(header.stamp)) for header in headers} == {
        (frame_id, STAMP_NS)}
    poses = [conversions.pose_stamped_from_msg(pose).pose for pose in msg.poses]
    np.testing.assert_allclose(np.reshape(poses, (-1, 3)), experiences, atol=1e-12)


@pytest.mark.parametrize('frame_id', ['map', 'drone_1/map', ''])
def test_the_map_is_drawn_with_exact_points(frame_id):
    experiences = np.array([[0.1, 1.0, 0.5], [2.0, 1 / 3, -3.0], [4.0, 5.0, 0.0]])
    links, closures = np.array([[0, 1], [1, 2]]), np.array([[2, 0]])
    msg = mapped(map_conversions.experience_map_to_cdr(
        STAMP_NS, experiences, links, closures, frame_id))
    markers = {marker.ns: marker for marker in msg.markers}
    points = {name: [(point.x, point.y) for point in marker.points]
              for name, marker in markers.items()}
    a, b, c = map(tuple, experiences[:, :2])
    assert points == {'experiences': [a, b, c], 'links': [a, b, b, c], 'closures': [c, a]}
    assert [markers[name].type for name in ('experiences', 'links', 'closures')] == [
        Marker.SPHERE_LIST, Marker.LINE_LIST, Marker.LINE_LIST]
    assert {(m.header.frame_id, stamp_to_ns(m.header.stamp)) for m in msg.markers} == {
        (frame_id, STAMP_NS)}


def test_a_map_without_closures_draws_none():
    msg = mapped(map_conversions.experience_map_to_cdr(
        0, np.zeros((1, 3)), np.empty((0, 2), int), np.empty((0, 2), int), 'map'))
    assert [marker.action for marker in msg.markers] == [
        Marker.ADD, Marker.DELETE, Marker.DELETE]


def test_diagnostics_tell_their_values_as_text():
    msg = over_the_wire(conversions.diagnostics_to_msg(
        STAMP_NS, '/encoder', DiagnosticStatus.WARN, 'no images', {'rate_hz': 1 / 3, 'lost': 2}))
    status, = msg.status
    assert (status.level, status.name, status.message) == (
        DiagnosticStatus.WARN, '/encoder', 'no images')
    assert {value.key: value.value for value in status.values} == {
        'rate_hz': '0.333333', 'lost': '2'}


def test_the_stamp_of_a_serialised_message_is_read_without_the_rest():
    assert header_stamp_ns(serialize(conversions.view_to_msg(
        View(STAMP_NS, np.zeros((2, 2), np.uint8))))) == STAMP_NS


@pytest.mark.parametrize('stamp_ns', [0, 1, STAMP_NS, 2**31 * 1_000_000_000 - 1])
def test_a_stamp_is_changed_and_nothing_else(stamp_ns):
    msg = conversions.view_to_msg(View(STAMP_NS, np.zeros((2, 2), np.uint8)), 'camera')
    data = with_header_stamp(serialize(msg), stamp_ns)
    msg.header.stamp = ns_to_stamp(stamp_ns)
    assert data == serialize(msg)


def test_a_stamp_of_big_endian_data_is_changed():
    data = bytes([0, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0, 2, 7])
    assert header_stamp_ns(data) == 1_000_000_002
    assert with_header_stamp(data, 3_000_000_004) == bytes([0, 0, 0, 0, 0, 0, 0, 3, 0, 0, 0, 4, 7])


@pytest.mark.parametrize('function', [header_stamp_ns, lambda data: with_header_stamp(data, 1)])
def test_data_too_short_for_a_stamp_is_refused(function):
    with pytest.raises(RecordingError, match='11 bytes hold no header'):
        function(bytes(11))


@pytest.mark.parametrize('name, expected', [
    ('nav_msgs/msg/Odometry', True), ('rosgraph_msgs/msg/Clock', False),
    ('std_msgs/msg/Header', False), ('std_msgs/msg/Empty', False)])
def test_which_types_begin_with_a_header(name, expected):
    assert begins_with_header(name) is expected


def test_a_type_is_found_by_its_name_and_named_by_itself():
    assert message_type('nav_msgs/msg/Odometry') is Odometry
    assert type_name(Odometry) == type_name(Odometry()) == 'nav_msgs/msg/Odometry'


@pytest.mark.parametrize('name', [
    'nav_msgs/msg/Odometer', 'no_such_msgs/msg/Odometry', 'nav_msgs/srv/GetMap', 'Odometry', ''])
def test_a_type_that_is_not_installed_is_refused_by_name(name):
    with pytest.raises(RecordingError, match=f"message type '{name}' is not installed"):
        message_type(name)


@pytest.mark.parametrize('length', [0, 4, 100])
def test_cut_data_is_refused(length):
    data = serialize(Odometry())[:length]
    with pytest.raises(RecordingError, match=f'{length} bytes cannot be read as nav_msgs'):
        deserialize(data, 'nav_msgs/msg/Odometry')
