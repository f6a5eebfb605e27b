"""
The link talks with an autopilot that is not made of pymavlink: one made of node-mavlink.

It runs where node is and NODE_PATH leads to that package (npm install node-mavlink).
"""

from contextlib import contextmanager
import json
from pathlib import Path
from queue import Queue
import shutil
import subprocess
import time

from dlsc_qbs_ros.config import MavlinkConfig
from dlsc_qbs_ros.core.types import IDENTITY, OdometrySample, Pose2, PoseEstimate
from dlsc_qbs_ros.io.mavlink.link import MavlinkLink
from dlsc_qbs_ros.io.mavlink.vision import vision_message
from mavlink_peer import free_port, wait_until
import pytest

PEER = Path(__file__).with_name('node_mavlink_peer.js')
NODE = shutil.which('node')
KEY = 'a passphrase'
TIMEOUT_S = 20.0


def has_peer():
    return NODE is not None and subprocess.run(
        [NODE, '-e', 'require("node-mavlink")'], capture_output=True).returncode == 0


pytestmark = pytest.mark.skipif(
    not has_peer(), reason='no node, or no node-mavlink where NODE_PATH leads')


@contextmanager
def link_and_peer(tmp_path, key='', peers_key=''):
    """Give a link that is fed by a peer, a queue of its odometry, and the lines of the peer."""
    port = free_port()
    (tmp_path / 'key').write_text(key)
    (tmp_path / 'key').chmod(0o600)
    link = MavlinkLink(MavlinkConfig(
        connection=f'udpin:127.0.0.1:{port}', rate_hz=50.0,
        key_file=str(tmp_path / 'key') if key else ''))
    odometry = Queue()
    link.start(odometry.put)
    peer = subprocess.Popen([NODE, PEER, str(port), peers_key], text=True,
                            stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    try:
        yield link, odometry, peer.stdout
    finally:
        link.stop()
        peer.communicate(timeout=TIMEOUT_S)


@pytest.mark.parametrize('key', ['', KEY])
def test_odometry_comes_and_poses_go(tmp_path, key):
    before_ns = time.time_ns()
    with link_and_peer(tmp_path, key, key) as (link, odometry, lines):
        samples = [odometry.get(timeout=TIMEOUT_S) for _ in range(20)]
        wait_until(lambda: link.state()['time_source'] == 'timesync')
        stamp_ns = time.time_ns()
        link.send(vision_message(PoseEstimate(
            stamp_ns, Pose2(1.5, -2.5, 0.0), OdometrySample(stamp_ns, IDENTITY, z_m=3.0),
            IDENTITY, IDENTITY, 0.5, 0.25), 7, 0.5))
        answer = json.loads(lines.readline())
    assert not {name: count for name, count in link.diagnostics().items() if count}
    for raw in samples:
        pose = raw.sample.pose
        assert (pose.x_m, pose.y_m, raw.sample.z_m) == (2.0, 1.0, 3.0)
        assert pose.yaw_rad == pytest.approx(0.0, abs=1e-6)
        assert raw.forward_m_s == 4.0
        assert before_ns < raw.sample.stamp_ns < stamp_ns
    assert answer['timeUsec'] == stamp_ns // 1000
    assert (answer['x'], answer['y'], answer['z']) == (1.5, 2.5, -3.0)
    assert answer['q'] == [1, 0, 0, 0]
    assert [answer['poseCovariance'][k] for k in (0, 6, 11, 15, 18, 20)] == [0.25] * 3 + [
        0.0625] * 3
    assert (answer['frameId'], answer['childFrameId']) == (20, 12)
    assert (answer['resetCounter'], answer['quality']) == (7, 100)


@pytest.mark.parametrize('peers_key', ['', 'another passphrase'])
def test_who_signs_with_no_key_or_another_is_not_heard(tmp_path, peers_key):
    with link_and_peer(tmp_path, KEY, peers_key) as (link, odometry, _):
        wait_until(lambda: sum(link.diagnostics().values()) > 2)
        assert odometry.empty()
        assert link.state()['mavlink_autopilot'] == 'none'
