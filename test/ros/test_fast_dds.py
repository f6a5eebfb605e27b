"""A node gets on with Fast DDS: with what a killed process leaves, and with our profiles."""

from contextlib import ExitStack
from fcntl import flock, LOCK_EX, LOCK_NB
from pathlib import Path
import subprocess
import sys

from dlsc_qbs_ros.ros import stale_ports
from dlsc_qbs_ros.ros.stale_ports import stale_ports_avoided
import pytest

ROOT = Path(__file__).parents[2]
PROFILES = sorted((ROOT / 'config').glob('fastdds_*.xml'))

MADE_MEANWHILE = """
from contextlib import contextmanager
from pathlib import Path
import rclpy
from dlsc_qbs_ros.nodes.encoder_node import EncoderNode
from dlsc_qbs_ros.ros import managed_node

@contextmanager
def watched():
    print(n_ports())
    yield
    print(n_ports())

def n_ports():
    opened = [path.readlink() for path in Path('/proc/self/fd').iterdir() if path.is_symlink()]
    return sum(path.match('/dev/shm/fastrtps_port*_el') for path in opened)

managed_node.stale_ports_avoided = watched
rclpy.init()
node = EncoderNode()
print(n_ports())
"""


def is_taken(lock):
    """Return whether Fast DDS takes the port with this lock for in use."""
    with lock.open() as file:
        try:
            flock(file, LOCK_EX | LOCK_NB)
        except BlockingIOError:
            return True
    return False


def test_ports_of_killed_processes_are_in_use_meanwhile_for_all_who_start(tmp_path, monkeypatch):
    monkeypatch.setattr(stale_ports, 'SHARED_MEMORY', tmp_path)
    stale, used, other = (tmp_path / name for name in (
        'fastrtps_port7411_el', 'fastrtps_port7413_el', 'fastrtps_port7411'))
    for path in (stale, used, other):
        path.touch()
    with used.open() as file:
        flock(file, LOCK_EX)
        first_to_start = ExitStack()
        first_to_start.enter_context(stale_ports_avoided())
        with stale_ports_avoided():
            first_to_start.close()
            assert [is_taken(path) for path in (stale, used, other)] == [True, True, False]
        assert [is_taken(path) for path in (stale, used, other)] == [False, True, False]
    assert not is_taken(used)


def test_no_shared_memory_is_no_harm(tmp_path, monkeypatch):
    monkeypatch.setattr(stale_ports, 'SHARED_MEMORY', tmp_path / 'none')
    with stale_ports_avoided():
        pass


def test_a_node_takes_its_ports_meanwhile(domain_id):
    before, after, at_last = subprocess.run(
        [sys.executable, '-c', MADE_MEANWHILE], cwd=ROOT, capture_output=True, text=True,
        timeout=60, check=True).stdout.split()
    if at_last == '0':
        pytest.skip('Fast DDS has no shared memory here')
    assert (before, after) == ('0', at_last)


@pytest.mark.parametrize('path', PROFILES, ids=lambda path: path.name)
def test_fast_dds_reads_a_profile_without_complaint(start, monkeypatch, path):
    monkeypatch.setenv('FASTRTPS_DEFAULT_PROFILES_FILE', str(path))
    process = start('nodes.encoder_node', '--ros-args', '-p', 'view.width:=1')
    assert process.wait() == 1
    assert process.text() == 'error: view.width = 1: expected a value in [4, 4096]\n'
