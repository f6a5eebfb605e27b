"""What tests of the live graph share: a ROS domain, processes, and a node to look on with."""

from importlib.util import find_spec
import os
from pathlib import Path
import signal
import subprocess
import sys
import tempfile
import threading
import time
from types import SimpleNamespace

import pytest

ROOT = Path(__file__).parents[2]
sys.path.append(str(ROOT / 'test'))  # helpers of tests with and without ROS
collect_ignore_glob = [] if find_spec('rclpy') else ['*']

os.environ['ROS_PYTHON_CHECK_FIELDS'] = '1'  # read when a message package is imported
os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'

TIMEOUT_S = 30.0
STOP_TIMEOUT_S = 2.0


@pytest.fixture
def domain_id(monkeypatch):
    """Give a ROS domain that no other test, of this run or another, uses meanwhile."""
    import fcntl
    for domain in range(1, 101):  # above, its ports are those that connections are given
        lock = open(Path(tempfile.gettempdir(), f'ros_domain_{domain}.lock'), 'w')
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            lock.close()
            continue
        monkeypatch.setenv('ROS_DOMAIN_ID', str(domain))
        yield domain
        lock.close()
        return
    pytest.fail('every ROS domain from 1 to 100 is in use')


class Process:
    """A module of the package as a process of its own; what it prints lies in `text()`."""

    def __init__(self, module, *args, directory):
        self._log = directory / f'{module}_{time.monotonic_ns()}.log'
        paths = [str(ROOT), *filter(None, [os.environ.get('PYTHONPATH')])]
        with open(self._log, 'wb') as log:
            self._popen = subprocess.Popen(
                [sys.executable, '-m', f'dlsc_qbs_ros.{module}', *map(str, args)],
                cwd=directory, stdin=subprocess.DEVNULL, stdout=log, stderr=subprocess.STDOUT,
                env={**os.environ, 'PYTHONPATH': os.pathsep.join(paths),
                     'ROS_LOG_DIR': str(directory)})

    def text(self):
        return self._log.read_text()

    def is_running(self):
        return self._popen.poll() is None

    def wait(self, timeout_s=TIMEOUT_S):
        """Return the exit code."""
        return self._popen.wait(timeout_s)

    def send(self, number):
        self._popen.send_signal(number)

    def stop(self, number=signal.SIGINT):
        """Send a signal; return the exit code, which must come in time."""
        self.send(number)
        return self.wait(STOP_TIMEOUT_S)

    def kill(self):
        self._popen.kill()
        self._popen.wait()


@pytest.fixture
def start(domain_id, tmp_path):
    """Give a function that starts `module` with arguments, on the test's own domain."""
    processes = []

    def start_process(module, *args):
        processes.append(Process(module, *args, directory=tmp_path))
        return processes[-1]
    yield start_process
    for process in processes:
        process.kill()


class Observer:
    """A node of the test's own."""

    def __init__(self, domain):
        import rclpy
        from rclpy.executors import SingleThreadedExecutor
        self._context = rclpy.Context()
        rclpy.init(context=self._context, domain_id=domain,
                   signal_handler_options=rclpy.signals.SignalHandlerOptions.NO)
        self.node = rclpy.create_node('observer', context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)

    def collect(self, msg_type, topic, **qos):
        """Subscribe; return the list that messages are put into."""
        from rclpy.qos import QoSProfile
        messages = []
        self.node.create_subscription(
            msg_type, topic, messages.append, QoSProfile(**{'depth': 1000, **qos}))
        return messages

    def advertise(self, msg_type, topic, **qos):
        from rclpy.qos import QoSProfile
        return self.node.create_publisher(msg_type, topic, QoSProfile(**{'depth': 1000, **qos}))

    def call(self, srv_type, service, **fields):
        """Call a service; return its response."""
        client = self.node.create_client(srv_type, service)
        self.spin_until(client.service_is_ready)
        future = client.call_async(srv_type.Request(**fields))
        self.spin_until(future.done)
        self.node.destroy_client(client)
        return future.result()

    def transition(self, node, label):
        """Ask a managed node for a step of its life; return whether it was taken."""
        from lifecycle_msgs.msg import Transition
        from lifecycle_msgs.srv import ChangeState
        return self.call(
            ChangeState, f'{node}/change_state', transition=Transition(label=label)).success

    def set_parameters(self, node, **values):
        """Set parameters of a node, `section__name`, together; return why not, or nothing."""
        from rcl_interfaces.srv import SetParametersAtomically
        from rclpy.parameter import Parameter
        return self.call(
            SetParametersAtomically, f'{node}/set_parameters_atomically', parameters=[
                Parameter(name.replace('__', '.'), value=value).to_parameter_msg()
                for name, value in values.items()]).result.reason

    def spin_until(self, condition, timeout_s=TIMEOUT_S):
        """Run callbacks until the condition holds; fail when it never does."""
        until_s = time.monotonic() + timeout_s
        while not condition():
            assert time.monotonic() < until_s, 'waited in vain'
            self._executor.spin_once(timeout_sec=0.02)

    def close(self):
        self._executor.shutdown()
        self.node.destroy_node()
        self._context.try_shutdown()


@pytest.fixture
def observer(domain_id):
    """Give an `Observer` on the test's own domain."""
    observer = Observer(domain_id)
    yield observer
    observer.close()


@pytest.fixture
def spinning(domain_id):
    """Give a function that makes a managed node, with ROS arguments, and spins it beside."""
    from dlsc_qbs_ros.ros.runtime import spin
    import rclpy
    stop, threads, errors = SimpleNamespace(received=False), [], []

    def run(node):
        try:
            spin(node, stop)
        except Exception as error:
            errors.append(error)

    def start_spinning(node_class, *ros_args):
        rclpy.init(args=['--ros-args', *map(str, ros_args)], domain_id=domain_id,
                   signal_handler_options=rclpy.signals.SignalHandlerOptions.NO)
        node = node_class()
        threads.append(threading.Thread(target=run, args=(node,), daemon=True))
        threads[-1].start()
        return node
    yield start_spinning
    stop.received = True
    for thread in threads:
        thread.join(TIMEOUT_S)
    are_ended = not any(thread.is_alive() for thread in threads)
    rclpy.shutdown()
    assert (are_ended, errors) == (True, [])
