"""Nodes live the life of managed nodes: each step is taken, taken back whole, or refused."""

from contextlib import contextmanager
import gc
import os
from pathlib import Path
import threading

from dlsc_qbs_ros.config import Config
from dlsc_qbs_ros.errors import ConfigError, RecordingError
from dlsc_qbs_ros.io.recordings.recording import Recording
from dlsc_qbs_ros.nodes.encoder_node import EncoderNode
from dlsc_qbs_ros.nodes.ratslam_node import RatSlamNode
from dlsc_qbs_ros.nodes.recorder_node import RecorderNode
from dlsc_qbs_ros.pipeline.encoder import Encoder
from dlsc_qbs_ros.pipeline.ratslam import RatSlam
from dlsc_qbs_ros.ros.managed_node import ENTITIES, ManagedNode
import pytest
import rclpy
from rclpy.lifecycle import TransitionCallbackReturn
from rclpy.parameter import Parameter
from std_msgs.msg import String

SUCCESS, FAILURE, ERROR = (TransitionCallbackReturn.SUCCESS, TransitionCallbackReturn.FAILURE,
                           TransitionCallbackReturn.ERROR)


def _ignore(*_):
    """Do nothing."""


class Worker(ManagedNode):
    """A node that notes its steps, and fails where it is told to."""

    def __init__(self, **options):
        self.steps, self.errors = [], {}
        super().__init__('worker', ('view', 'ratslam'), **options)

    def _step(self, name):
        self.steps.append(name)
        if name in self.errors:
            raise self.errors[name]

    def configure(self, config, undo):
        self.config = config
        self.heavy = [0] * 100
        self.create_publisher(String, 'out', 1)
        undo.callback(self._step, 'clean up')
        self._step('configure')

    def activate(self, undo):
        self.create_subscription(String, 'in', _ignore, 1)
        self.create_timer(60.0, _ignore)
        undo.callback(self._step, 'deactivate')
        self._step('activate')

    def reconfigure(self, config):
        self.config = config


@contextmanager
def ros(*ros_args):
    rclpy.init(args=['--ros-args', *ros_args],
               signal_handler_options=rclpy.signals.SignalHandlerOptions.NO)
    try:
        yield
    finally:
        rclpy.shutdown()


@pytest.fixture
def worker(domain_id):
    with ros():
        worker = Worker()
        yield worker
        worker.errors.clear()
        worker.destroy_node()


def held(node):
    """Return what a node holds: entities, attributes and threads."""
    return ({kind: len(list(getattr(node, f'{kind}s'))) for kind in (*ENTITIES, 'waitable')},
            set(vars(node)), threading.active_count())


def open_files(folder):
    """Return the files under a folder that this process holds open."""
    return [path for path in map(os.path.realpath, Path('/proc/self/fd').iterdir())
            if path.startswith(str(folder))]


def test_a_step_back_gives_back_what_the_step_made(worker):
    unconfigured = held(worker)
    assert worker.trigger_configure() == SUCCESS
    inactive = held(worker)
    assert worker.trigger_activate() == SUCCESS
    assert held(worker)[0]['subscription'] == inactive[0]['subscription'] + 1
    assert worker.trigger_deactivate() == SUCCESS
    assert held(worker) == inactive
    assert worker.trigger_cleanup() == SUCCESS
    assert held(worker) == unconfigured
    assert worker.steps == ['configure', 'activate', 'deactivate', 'clean up']


@pytest.mark.parametrize('error, result', [
    (ConfigError('no such thing'), FAILURE), (ZeroDivisionError(), ERROR)])
def test_a_step_that_fails_half_way_leaves_nothing_and_may_be_tried_again(worker, error, result):
    unconfigured = held(worker)
    worker.errors['configure'] = error
    assert worker.trigger_configure() == result
    assert held(worker) == unconfigured
    assert worker.steps == ['configure', 'clean up']
    worker.errors.clear()
    assert worker.trigger_configure() == SUCCESS


def test_a_node_that_cannot_be_activated_stays_configured(worker):
    worker.trigger_configure()
    inactive = held(worker)
    worker.errors['activate'] = ConfigError('no such thing')
    assert worker.trigger_activate() == FAILURE
    assert held(worker) == inactive
    worker.errors.clear()
    assert worker.trigger_activate() == SUCCESS


@pytest.mark.parametrize('step', ['deactivate', 'clean up'])
def test_what_goes_wrong_over_the_end_is_raised_and_all_is_given_back(worker, step):
    before = held(worker)
    worker.start()
    worker.errors[step] = RecordingError('the disk is full')
    with pytest.raises(RecordingError, match='the disk is full'):
        worker.destroy_node()
    assert held(worker)[1] == before[1]
    assert worker.steps[-2:] == ['deactivate', 'clean up']


@pytest.mark.parametrize('before', [(), ('configure',), ('configure', 'activate')])
def test_a_node_shut_down_has_given_everything_back(worker, before):
    unconfigured = held(worker)
    for step in (*before, 'shutdown'):
        assert getattr(worker, f'trigger_{step}')() == SUCCESS
    assert held(worker) == unconfigured
    assert worker.steps == [*before, *['deactivate', 'clean up'][2 - len(before):]]


def test_autostart_raises_what_hinders_it(worker):
    worker.errors['configure'] = ConfigError('no such thing')
    with pytest.raises(ConfigError, match='no such thing'):
        worker.start()


def test_a_live_parameter_changes_in_flight_and_others_are_refused_with_the_reason(worker):
    worker.start()
    accepted, refused = worker.set_parameters(
        [Parameter('ratslam.threshold', value=0.7), Parameter('view.width', value=20)])
    assert accepted.successful
    assert worker.config == Config().override({'ratslam.threshold': 0.7})
    assert refused.reason == (
        'view.width cannot change while the node is configured: codes made with another could '
        'not be compared; deactivate and clean up first')
    worker.trigger_deactivate(), worker.trigger_cleanup()
    refused, = worker.set_parameters([Parameter('view.width', value=20)])
    assert refused.successful
    worker.trigger_configure()
    assert worker.config == Config().override({'ratslam.threshold': 0.7, 'view.width': 20})


def test_parameters_set_together_change_together_or_not_at_all(worker):
    worker.start()
    result = worker.set_parameters_atomically(
        [Parameter('ratslam.threshold', value=0.7), Parameter('ratslam.backend', value='new')])
    assert result.reason == "ratslam.backend = 'new': expected one of sequences, published"
    assert worker.config == Config()


def test_a_map_is_saved_by_itself_in_the_next_life_too_whatever_was_set_in_this_one(domain_id):
    with ros('-p', 'ratslam.autosave_s:=60.0'):
        node = RatSlamNode()
        node.start()

        def periods_s():
            return sorted(timer.timer_period_ns / 1e9 for timer in node.timers
                          if not timer.is_canceled())
        assert 60.0 in periods_s()
        for period_s in (60.0, 0.0, 30.0):
            node.set_parameters([Parameter('ratslam.autosave_s', value=period_s)])
        before = periods_s()
        assert 30.0 in before and 60.0 not in before
        assert node.trigger_deactivate() == node.trigger_activate() == SUCCESS
        assert periods_s() == before
        node.destroy_node()


@pytest.mark.parametrize('node_class, worker_class', [
    (EncoderNode, Encoder), (RatSlamNode, RatSlam), (RecorderNode, Recording)])
def test_twenty_lives_leave_nothing_behind(domain_id, tmp_path, node_class, worker_class):
    def workers():
        return [item for item in gc.get_objects() if isinstance(item, worker_class)]

    elsewhere = workers()  # of other tests in this process
    with ros('-p', 'autostart:=false'):
        node = node_class()
        counts = []
        for life in range(20):
            if node_class is RecorderNode:
                node.set_parameters([Parameter('recorder.output', value=f'{tmp_path}/{life}')])
            for trigger in (node.trigger_configure, node.trigger_activate,
                            node.trigger_deactivate, node.trigger_cleanup):
                assert trigger() == SUCCESS
            gc.collect()
            counts.append(held(node))
        # Where a topic was made once, its quality of service stays declared.
        assert all(count == counts[1] for count in counts[1:])
        assert not open_files(tmp_path)
        assert all(any(item is other for other in elsewhere) for item in workers())
        node.destroy_node()
