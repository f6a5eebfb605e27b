"""The life of a map on live nodes: saved, loaded, localised in, survived, one for each drone."""

from dataclasses import replace
from math import inf
import threading
import time
from unittest.mock import Mock

from diagnostic_msgs.msg import DiagnosticArray
from dlsc_qbs_ros.core.geometry import compose
from dlsc_qbs_ros.core.types import Code, Dictionary, OdometrySample, Pose2, View
from dlsc_qbs_ros.io.map_file import read_map, write_map
from dlsc_qbs_ros.nodes import map_services
from dlsc_qbs_ros.nodes.map_services import MapServices
from dlsc_qbs_ros.nodes.ratslam_node import RatSlamNode
from dlsc_qbs_ros.pipeline.map_state import shaping
from dlsc_qbs_ros.pipeline.ratslam import RatSlam
from dlsc_qbs_ros.pipeline.runner import encode
from dlsc_qbs_ros.profiles import to_yaml
from dlsc_qbs_ros.ros.conversions import (
    code_to_msg, dictionary_to_msg, odometry_to_msg, view_to_msg)
from geometry_msgs.msg import PoseWithCovarianceStamped
from loop_flight import CONFIG, events, LAP_S
from nav_msgs.msg import Odometry, Path
import numpy as np
import pytest
from rclpy.qos import DurabilityPolicy
from sensor_msgs.msg import Image
from std_srvs.srv import SetBool, Trigger

ELSEWHERE = Pose2(30.0, -5.0, 2.0)
PATIENT = CONFIG.override({'ratslam.max_wait_s': 30.0})
TO_MSG = {Dictionary: ('dictionary', dictionary_to_msg), View: ('view', view_to_msg),
          Code: ('code', code_to_msg), OdometrySample: (
              'odom', lambda sample: odometry_to_msg(sample, 0.0, 0.0, 'odom', 'base_link'))}


def encoded(seconds, world=0):
    """Return what reaches ratslam in a flight, with every third sample of its odometry."""
    made = encode(events(seconds, world), CONFIG).events
    odometry = [event for event in made if isinstance(event, OdometrySample)]
    spared = {event.stamp_ns for event in odometry} - {
        event.stamp_ns for event in odometry[::3]}
    return [event for event in made
            if not (isinstance(event, OdometrySample) and event.stamp_ns in spared)]


@pytest.fixture(scope='module')
def flight():
    """Give a flight of a lap and a third."""
    return encoded(4 / 3 * LAP_S)


@pytest.fixture(scope='module')
def next_day(flight):
    """Give the same flight 1000 s later, its odometry in another frame."""
    return [replace(event, stamp_ns=event.stamp_ns + 10**12, **(
        {'dictionary_ns': event.dictionary_ns + 10**12} if isinstance(event, Code) else
        {'pose': compose(ELSEWHERE, event.pose)} if isinstance(event, OdometrySample) else {}))
        for event in flight]


@pytest.fixture(scope='module')
def n_experiences(flight):
    """Give the size of the map that the pipeline makes of the flight."""
    return len(flown(flight).mapper.map)


def flown(flight):
    ratslam = RatSlam(CONFIG)
    for event in flight:
        {Dictionary: ratslam.add_dictionary, View: ratslam.add_view, Code: ratslam.add_code,
         OdometrySample: ratslam.add_odometry}[type(event)](event)
        ratslam.advance(0.0)
    ratslam.advance(inf)
    return ratslam


class Drone:
    """A ratslam node, what it hears and what it says, in a namespace."""

    def __init__(self, start, observer, tmp_path, *ros_args, namespace=''):
        self.observer, self.name = observer, f'{namespace}/ratslam'
        self.poses = observer.collect(PoseWithCovarianceStamped, f'{namespace}/pose')
        self.reports = observer.collect(DiagnosticArray, '/diagnostics')
        latched = {'durability': DurabilityPolicy.TRANSIENT_LOCAL}
        self.publishers = {
            topic: observer.advertise(msg_type, f'{namespace}/{topic}', **options)
            for topic, msg_type, options in (
                ('odom', Odometry, {}), ('code', Image, {}), ('view', Image, {}),
                ('dictionary', Image, latched))}
        profile = tmp_path / 'drone.yaml'
        profile.write_text(to_yaml(PATIENT))
        self.process = start(
            'nodes.ratslam_node', '--ros-args', '--params-file', profile,
            '-r', f'__ns:={namespace or "/"}', *(argument for setting in (
                'reliability:=reliable', 'history:=keep_last', 'depth:=10000')
                for argument in ('-p', f'qos_overrides.{namespace}/odom.subscription.{setting}')),
            *ros_args)
        observer.spin_until(lambda: all(
            publisher.get_subscription_count() for publisher in self.publishers.values()))
        # Heard on one topic, a node knows who listens to the others; they must know of it, too.
        self.values()
        observer.spin_until(lambda: observer.node.count_publishers(f'{namespace}/pose'))

    def fly(self, flight):
        """Send a flight, no faster than its poses come."""
        due = len(self.poses)
        for event in flight:
            self.send(event)
            due += isinstance(event, OdometrySample)
            # The newest wait for a code yet to come.
            self.observer.spin_until(lambda: len(self.poses) > due - 10)

    def send(self, event):
        topic, to_msg = TO_MSG[type(event)]
        self.publishers[topic].publish(to_msg(event))

    def call(self, service, **fields):
        srv_type = SetBool if fields else Trigger
        return self.observer.call(srv_type, f'{self.name}/{service}', **fields)

    def values(self):
        """Return the next report's message and values."""
        self.reports.clear()
        mine = []
        self.observer.spin_until(lambda: mine.extend(
            report.status[0] for report in self.reports
            if report.status[0].name == self.name) or mine)
        return mine[-1].message, {value.key: value.value for value in mine[-1].values}


def position(msg):
    return msg.pose.pose.position.x, msg.pose.pose.position.y


def in_file(path):
    return ['-p', f'ratslam.map_file:={path}']


def test_a_map_is_saved_and_the_next_node_is_localised_in_it_and_leaves_it_as_it_is(
        start, observer, tmp_path, flight, next_day, n_experiences):
    path = tmp_path / 'hall.map'
    first = Drone(start, observer, tmp_path, *in_file(path))
    first.fly(flight)
    response = first.call('save_map')
    assert (response.success, response.message) == (True, str(path))
    assert first.process.stop() == 0
    before = path.read_bytes()
    assert n_experiences - 1 <= len(read_map(path)[1]['experience_poses']) <= n_experiences

    second = Drone(start, observer, tmp_path, *in_file(path), '-p',
                   'ratslam.mode:=localization')
    assert 'experiences' in second.process.text()
    second.poses.clear()
    second.fly(next_day)
    covariance = [msg.pose.covariance[0] for msg in second.poses]
    assert covariance[0] == 1e6  # nobody knows
    assert covariance[-1] < 1.0
    message, values = second.values()
    assert values['localised'] == 'True'
    assert int(values['experiences']) in (n_experiences - 1, n_experiences)
    assert second.call('save_map').success
    assert path.read_bytes() == before

    assert second.call('set_localization_mode', data=False).message == 'mapping'
    assert second.call('save_map').success
    assert path.read_bytes() != before
    assert second.process.stop() == 0


def test_after_kill_9_a_node_comes_back_in_the_map_it_saved_by_itself(
        start, observer, tmp_path, flight):
    path = tmp_path / 'hall.map'
    arguments = [*in_file(path), '-p', 'ratslam.autosave_s:=0.05']
    first = Drone(start, observer, tmp_path, *arguments)
    half = len(flight) // 2
    first.fly(flight[:half])
    observer.spin_until(path.exists)
    last = position(first.poses[-1])
    first.process.kill()
    saved_ns = int(read_map(path)[1]['odometry_stamp_ns'][0])
    assert saved_ns > flight[0].stamp_ns

    again = Drone(start, observer, tmp_path, *arguments)
    n = len(again.poses)
    again.fly(flight[half:])
    message, values = again.values()
    assert values['localised'] == 'True'
    assert position(again.poses[n]) == pytest.approx(last, abs=1.0)
    assert max(msg.pose.covariance[0] for msg in again.poses) < 4.0
    assert again.process.stop() == 0
    assert len(np.unique(read_map(path)[1]['visit_flown'][:, 2])) == 1


def test_what_grew_since_it_was_saved_is_saved_before_the_map_is_kept_and_nothing_before_it_is(
        start, observer, tmp_path, flight):
    path = tmp_path / 'hall.map'
    drone = Drone(start, observer, tmp_path, *in_file(path), '-p', 'ratslam.autosave_s:=0.1')
    assert drone.call('pause').success
    drone.fly(flight[:150])
    assert int(drone.values()[1]['codes_used']) > 0
    assert observer.set_parameters('ratslam', ratslam__autosave_s=3600.0) == ''
    assert drone.call('resume').success
    drone.fly(flight[150:300])
    n = int(drone.values()[1]['experiences'])
    assert not path.exists()
    assert drone.call('set_localization_mode', data=True).success
    assert drone.process.stop() == 0
    assert len(read_map(path)[1]['experience_poses']) >= n > 0
    assert 'map not saved' not in drone.process.text()


@pytest.fixture
def keeper(flight):
    """Give a function that keeps a map in a file: its services, and what its timer calls."""
    def keep(path):
        node = Mock()
        services = MapServices(node, flown(flight), CONFIG.override(
            {'ratslam.map_file': str(path), 'ratslam.autosave_s': 3600.0}))
        return services, node.create_timer.call_args.args[1], node.get_logger().error
    return keep


def until_called(mock):
    until_s = time.monotonic() + 30.0
    while not mock.called and time.monotonic() < until_s:
        time.sleep(0.001)
    return str(mock.call_args)


def test_a_map_that_could_not_be_saved_is_saved_in_the_end(keeper, tmp_path):
    path = tmp_path / 'none' / 'hall.map'
    services, autosave, error = keeper(path)
    autosave()
    assert 'No such file or directory' in until_called(error)
    path.parent.mkdir()
    services.stop()
    assert path.exists()


def test_a_map_that_was_saved_as_it_is_is_not_saved_again(keeper, tmp_path, monkeypatch):
    path = tmp_path / 'hall.map'
    services, autosave, error = keeper(path)
    write = Mock(side_effect=write_map)
    monkeypatch.setattr(map_services, 'write_map', write)
    autosave()
    services.stop()
    assert (write.call_count, error.called) == (1, False)


def test_no_map_but_its_own_is_written_over_unasked(keeper, tmp_path):
    hall, yesterday = tmp_path / 'hall.map', tmp_path / 'yesterday.map'
    yesterday.write_bytes(b'yesterday')
    services, autosave, error = keeper(hall)
    services.reconfigure(CONFIG.override(
        {'ratslam.map_file': str(yesterday), 'ratslam.autosave_s': 3600.0}))
    autosave()
    assert f'{yesterday} holds another: call save_map or load_map' in until_called(error)
    services.stop()
    assert yesterday.read_bytes() == b'yesterday'


def test_what_was_flown_is_not_saved_over_the_map_that_is_being_loaded(
        keeper, tmp_path, monkeypatch):
    services, autosave, error = keeper(tmp_path / 'hall.map')
    write, may_read = Mock(side_effect=write_map), threading.Event()
    monkeypatch.setattr(map_services, 'write_map', write)
    monkeypatch.setattr(map_services, 'read_map', lambda path: may_read.wait() and read_map(path))
    autosave()
    services._worker.submit(int).result()
    services._ratslam.counts['codes_used'] += 1
    loading = services._load_map()
    loading.send(None)
    autosave()
    may_read.set()
    services._worker.submit(int).result()
    with pytest.raises(StopIteration):
        loading.send(None)
    services.stop()
    assert (write.call_count, error.called) == (1, False)


@pytest.fixture
def slow_reader(spinning, observer, tmp_path, monkeypatch, flight):
    """Give an event: only then, or when it ends, a node reads a map."""
    path, may_read, stop = tmp_path / 'hall.map', threading.Event(), MapServices.stop
    write_map(path, shaping(PATIENT), flown(flight).state())
    monkeypatch.setattr(map_services, 'read_map', lambda path: may_read.wait() and read_map(path))
    monkeypatch.setattr(MapServices, 'stop', lambda self: (may_read.set(), stop(self)))
    (tmp_path / 'drone.yaml').write_text(to_yaml(PATIENT))
    spinning(RatSlamNode, '--params-file', tmp_path / 'drone.yaml')
    assert observer.set_parameters('ratslam', ratslam__map_file=str(path)) == ''
    return may_read


def load(observer):
    """Ask for the map and do not wait for it."""
    client = observer.node.create_client(Trigger, 'ratslam/load_map')
    observer.spin_until(client.service_is_ready)
    return client.call_async(Trigger.Request())


def test_while_a_map_is_read_poses_go_on_and_then_it_is_shown_at_once(
        slow_reader, observer, flight, n_experiences):
    odometry = observer.advertise(Odometry, 'odom')
    poses = observer.collect(PoseWithCovarianceStamped, 'pose')
    paths = observer.collect(Path, 'path', depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    observer.spin_until(odometry.get_subscription_count)
    observer.spin_until(lambda: observer.node.count_publishers('pose'))
    answer = load(observer)
    samples = (event for event in flight if isinstance(event, OdometrySample))

    def are_coming():
        odometry.publish(TO_MSG[OdometrySample][1](next(samples)))
        return len(poses) > 5
    observer.spin_until(are_coming)
    assert not answer.done()
    assert paths == []
    slow_reader.set()
    observer.spin_until(answer.done)
    assert f'{n_experiences} experiences' in answer.result().message
    observer.spin_until(lambda: paths)
    assert len(paths[-1].poses) == n_experiences
    assert observer.call(Trigger, 'ratslam/reset').success
    observer.spin_until(lambda: not paths[-1].poses)


def test_a_map_that_is_read_when_its_node_is_cleaned_up_is_let_go(slow_reader, observer):
    load(observer)
    assert observer.transition('ratslam', 'deactivate')
    assert observer.transition('ratslam', 'cleanup')
    assert observer.transition('ratslam', 'configure')
    assert observer.call(Trigger, 'ratslam/pause').success


def test_what_cannot_be_done_is_refused_in_words_and_the_map_goes_on(
        start, observer, tmp_path, flight):
    (tmp_path / 'photo.map').write_bytes(b'\xff\xd8\xff')
    drone = Drone(start, observer, tmp_path)
    for service, said in (('save_map', 'ratslam.map_file is empty'),
                          ('load_map', 'ratslam.map_file is empty')):
        response = drone.call(service)
        assert not response.success and said in response.message
    response = drone.call('set_localization_mode', data=True)
    assert not response.success and 'there is no map yet' in response.message
    drone.fly(flight[:150])
    _, before = drone.values()
    for path, said in (('photo.map', 'cut, damaged or no map'), ('none.map', 'no such file'),
                       ('n' * 300, 'File name too long')):
        path = str(tmp_path / path)
        assert observer.set_parameters('ratslam', ratslam__map_file=path) == ''
        response = drone.call('load_map')
        assert not response.success
        assert path in response.message and said in response.message
    _, after = drone.values()
    assert after['experiences'] == before['experiences'] != '0'
    assert drone.call('pause').message == 'paused'
    drone.fly(flight[150:300])
    _, paused = drone.values()
    assert paused['experiences'] == before['experiences']
    assert drone.call('resume').message == 'mapping'
    assert drone.call('set_localization_mode', data=True).success
    refused = drone.call('reset')
    assert not refused.success and 'the map stays as it is' in refused.message
    assert drone.values()[1]['experiences'] == before['experiences']
    assert drone.call('set_localization_mode', data=False).success
    assert drone.call('reset').success
    assert drone.values()[1]['experiences'] == '0'
    assert drone.process.stop() == 0


def test_the_initial_pose_is_honoured(start, observer, tmp_path, flight):
    drone = Drone(start, observer, tmp_path)
    told = observer.advertise(PoseWithCovarianceStamped, 'initialpose')
    observer.spin_until(told.get_subscription_count)
    drone.fly(flight[:200])
    msg = PoseWithCovarianceStamped()
    msg.header.frame_id = 'odom'
    msg.pose.pose.orientation.w = 1.0
    msg.pose.pose.position.x = 7.0
    msg.pose.covariance[0] = msg.pose.covariance[7] = 0.25
    told.publish(msg)
    observer.spin_until(lambda: 'initialpose refused' in drone.process.text())
    msg.header.frame_id = 'map'
    told.publish(msg)
    sent = iter(flight[200:])

    def is_there():
        drone.send(next(sent))
        return np.hypot(*np.subtract(position(drone.poses[-1]), (7.0, 0.0))) < 2.0
    observer.spin_until(is_there)
    assert 0.2 < drone.poses[-1].pose.covariance[0] < 1.0


@pytest.mark.parametrize('arguments, said', [
    (['-p', 'ratslam.mode:=localization'], 'is no file to be localised in'),
    (['-p', 'ratslam.mode:=lost'], 'expected one of mapping, localization'),
    (in_file('README.md'), 'cut, damaged or no map')])
def test_a_node_without_the_map_it_needs_does_not_start(start, tmp_path, arguments, said):
    (tmp_path / 'README.md').write_text('no map')
    process = start('nodes.ratslam_node', '--ros-args', *arguments)
    assert process.wait() == 1
    assert said in process.text()
    assert 'Traceback' not in process.text()


def test_two_drones_in_two_namespaces_do_not_disturb_each_other(start, observer, tmp_path):
    flights = {'/a': encoded(5.0), '/b': encoded(7.0, world=5)}
    drones = {name: Drone(start, observer, tmp_path, *in_file(tmp_path / f'{name[1:]}.map'),
                          namespace=name) for name in flights}
    for name, drone in drones.items():
        drone.fly(flights[name])
    for name, drone in drones.items():
        assert drone.call('save_map').success
        alone = flown(flights[name]).mapper.map.poses
        saved = read_map(tmp_path / f'{name[1:]}.map')[1]['experience_poses']
        assert len(alone) - 1 <= len(saved) <= len(alone)
        np.testing.assert_allclose(saved[:5], alone[:5], atol=0.1)
        assert drone.call('reset' if name == '/a' else 'pause').success
    assert drones['/a'].values()[1]['experiences'] == '0'
    assert drones['/b'].values()[1]['experiences'] != '0'
    assert drones['/b'].process.stop() == drones['/a'].process.stop() == 0
