"""A node starts or says in one line why not, and ends in peace whenever it is told to."""

import signal

from diagnostic_msgs.msg import DiagnosticArray
import pytest

NODES = ['encoder_node', 'ratslam_node', 'recorder_node']


@pytest.fixture
def running(start, observer):
    """Give a function that starts a node and waits until it reports."""
    def start_node(module, *ros_args):
        reports = observer.collect(DiagnosticArray, '/diagnostics')
        process = start(f'nodes.{module}', '--ros-args', *ros_args)
        observer.spin_until(lambda: reports or not process.is_running())
        assert process.is_running(), process.text()
        return process
    return start_node


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize('module', NODES)
def test_a_signal_ends_a_node_in_peace(running, module, number):
    process = running(module)
    assert process.stop(number) == 0
    assert 'Traceback' not in process.text()


def test_a_second_signal_does_not_disturb_the_end(running):
    process = running('recorder_node')
    process.send(signal.SIGINT)
    assert process.stop(signal.SIGINT) == 0
    assert 'Traceback' not in process.text()


def test_a_node_reports_under_a_clock_that_stands_still(running):
    assert running('encoder_node', '-p', 'use_sim_time:=true').stop() == 0


@pytest.mark.parametrize('module', NODES)
@pytest.mark.parametrize('assignment, error', [
    ('view.widht:=20', "error: unknown parameter 'view.widht' (value 20)\n"),
    ('view.width:=1', 'error: view.width = 1: expected a value in [4, 4096]\n')])
def test_a_wrong_parameter_is_one_line_and_exit_code_1(start, module, assignment, error):
    process = start(f'nodes.{module}', '--ros-args', '-p', assignment)
    assert process.wait() == 1
    assert process.text() == error


@pytest.mark.parametrize('module', NODES)
def test_help_tells_how_parameters_are_given_and_starts_nothing(start, module):
    process = start(f'nodes.{module}', '--help')
    assert process.wait() == 0
    assert '--ros-args -p section.name:=value --params-file FILE' in ' '.join(
        process.text().split())


def test_an_argument_outside_of_the_ros_arguments_is_refused(start):
    process = start('nodes.encoder_node', '--params-file', 'x', '--ros-args', '-r', 'a:=b')
    assert process.wait() == 2
    assert 'unrecognized arguments: --params-file x' in process.text()


@pytest.mark.parametrize('arguments, error', [
    (['-p', 'use_sim_time:=3'], "error: Trying to set parameter 'use_sim_time' to '3'"),
    (['--params-file', 'nothing.yaml'], 'nothing.yaml'),
    (['--no-such-option'], 'no-such-option'),
    (['-p', 'qos_overrides./image.subscription.reliability:=perfect'], 'perfect')])
def test_wrong_ros_arguments_are_an_error_without_traceback(start, arguments, error):
    process = start('nodes.encoder_node', '--ros-args', *arguments)
    assert process.wait() == 1
    assert error in process.text().splitlines()[-1]
    assert 'Traceback' not in process.text()
