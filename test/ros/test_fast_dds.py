"""A node gets on with Fast DDS: with what a killed process leaves, and with our profiles."""

from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PROFILES = sorted((ROOT / 'config').glob('fastdds_*.xml'))


def ports(process):
    """Return the locks of shared memory ports that a process holds open."""
    opened = {path.readlink() for path in Path(f'/proc/{process.pid}/fd').iterdir()}
    return {path.name for path in opened if path.match('/dev/shm/fastrtps_port*_el')}


def test_a_node_receives_at_no_port_of_one_that_was_killed_before(start, observer):
    encoder = start('nodes.encoder_node')
    observer.spin_until(lambda: observer.node.count_publishers('/code'))
    its_ports = ports(encoder)
    if not its_ports:
        pytest.skip('Fast DDS has no shared memory here')
    encoder.kill()
    ratslam = start('nodes.ratslam_node')
    observer.spin_until(lambda: observer.node.count_publishers('/pose'))
    assert len(ports(ratslam)) == len(its_ports)
    assert not ports(ratslam) & its_ports


@pytest.mark.parametrize('path', PROFILES, ids=lambda path: path.name)
def test_fast_dds_reads_a_profile_without_complaint(start, monkeypatch, path):
    monkeypatch.setenv('FASTRTPS_DEFAULT_PROFILES_FILE', str(path))
    process = start('nodes.encoder_node', '--ros-args', '-p', 'view.width:=1')
    assert process.wait() == 1
    assert process.text() == 'error: view.width = 1: expected a value in [4, 4096]\n'
