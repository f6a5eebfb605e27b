"""A node gets on with what a killed process leaves of Fast DDS."""

from pathlib import Path

import pytest


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
