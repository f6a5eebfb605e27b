"""
A flight through the three live nodes, of which some are killed by SIGKILL and restarted at once.

Plays the camera and odometry of a simulated flight in real time, waiting for nobody, once without
a disturbance and once with kills at random moments of random nodes. The ratslam node saves its
map and comes back in it. All use config/fastdds_shared_memory.xml: in the little shared memory
that a camera has by default, images on their way to a killed encoder may leave no room for others
for many seconds. Prints MAE_L of the poses that went out, MAE_M of the map file that was left, and
where poses were missing; exits 1 when the map can't be gone on in or MAE_L is more than 20 % above
that of the undisturbed flight.
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path
import signal
import subprocess
import sys
import tempfile
import time

from dlsc_qbs_ros.config import Config
from dlsc_qbs_ros.core.types import GroundTruthSample
from dlsc_qbs_ros.evaluation.alignment import align
from dlsc_qbs_ros.evaluation.association import associate
from dlsc_qbs_ros.evaluation.metrics import mae_l, mae_m
from dlsc_qbs_ros.io.flight import read_flight
from dlsc_qbs_ros.io.map_file import read_map
from dlsc_qbs_ros.io.recordings.bag import read_bag
from dlsc_qbs_ros.pipeline.map_state import check, refuse_other
from dlsc_qbs_ros.ros.serialization import message_type
from dlsc_qbs_ros.ros.stamps import stamp_to_ns
from geometry_msgs.msg import PoseWithCovarianceStamped
import numpy as np
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile

TOPICS = ('/camera/image_raw', '/odom')
NODES = ('encoder', 'ratslam', 'recorder')
AUTOSAVE_S = 1.0
PROFILE = Path(__file__).parents[1] / 'config' / 'fastdds_shared_memory.xml'
MAX_RATIO = 1.2


class Nodes:
    """The three nodes as processes, in a folder of their own."""

    def __init__(self, folder: Path):
        self._arguments = {
            'encoder': ['-r', 'image:=/camera/image_raw'],
            'ratslam': ['-p', f'ratslam.map_file:={folder}/flight.map',
                        '-p', f'ratslam.autosave_s:={AUTOSAVE_S}'],
            'recorder': ['-p', 'recorder.topics:=[/pose]']}
        self._folder = folder
        self._processes = {name: self._start(name) for name in NODES}

    def _start(self, name: str) -> subprocess.Popen:
        with open(self._folder / f'{name}.log', 'ab') as log:
            return subprocess.Popen(
                [sys.executable, '-m', f'dlsc_qbs_ros.nodes.{name}_node', '--ros-args',
                 *self._arguments[name]], cwd=self._folder, stdout=log, stderr=log)

    def kill(self, name: str) -> None:
        """End a node by SIGKILL and start it again."""
        self._processes[name].kill()
        self._processes[name].wait()
        self._processes[name] = self._start(name)

    def stop(self) -> list[int]:
        """End all nodes in peace; return their exit codes."""
        for process in self._processes.values():
            process.send_signal(signal.SIGINT)
        return [process.wait(20.0) for process in self._processes.values()]


def fly(flight: Path, folder: Path, kills: list[tuple[float, str]], seconds: float
        ) -> dict[int, tuple[float, float]]:
    """Play a flight through the nodes; return stamp -> (x, y) of the poses that came out."""
    poses: dict[int, tuple[float, float]] = {}
    node = rclpy.create_node('flight')
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    node.create_subscription(
        PoseWithCovarianceStamped, '/pose', lambda msg: poses.update({stamp_to_ns(
            msg.header.stamp): (msg.pose.pose.position.x, msg.pose.pose.position.y)}), 1000)
    nodes = Nodes(folder)
    publishers: dict[str, object] = {}
    for message in read_bag(flight, TOPICS):
        if message.topic not in publishers:
            publishers[message.topic] = node.create_publisher(
                message_type(message.type_name), message.topic, QoSProfile(depth=100))
        if len(publishers) == len(TOPICS):
            break
    while not all(publisher.get_subscription_count() for publisher in publishers.values()):
        executor.spin_once(timeout_sec=0.05)
    kills, started_s, first_ns = [*kills], time.monotonic(), None
    for message in read_bag(flight, TOPICS):
        first_ns = message.log_time_ns if first_ns is None else first_ns
        due_s = (message.log_time_ns - first_ns) * 1e-9
        if due_s > seconds:
            break
        while (left_s := started_s + due_s - time.monotonic()) > 0.0:
            executor.spin_once(timeout_sec=left_s)
        if kills and due_s >= kills[0][0]:
            print('  {:6.1f} s: {}'.format(*kills[0]), flush=True)
            nodes.kill(kills.pop(0)[1])
        publishers[message.topic].publish(message.data)
    until_s = time.monotonic() + 3.0
    while time.monotonic() < until_s:
        executor.spin_once(timeout_sec=0.1)
    codes = nodes.stop()
    if any(codes):
        raise SystemExit('\n'.join((folder / f'{name}.log').read_text() for name in NODES))
    executor.shutdown()
    node.destroy_node()
    return poses


def judge(poses: dict[int, tuple[float, float]], truth: list[GroundTruthSample], path: Path
          ) -> float:
    """Print how good poses and map are; return MAE_L. A map that is not sound raises MapError."""
    stamps_ns = np.array(sorted(poses))
    estimate_m = np.array([poses[stamp] for stamp in stamps_ns.tolist()])
    truth_m = associate(stamps_ns, truth)[:, :2]
    is_known = np.isfinite(truth_m).all(axis=1)
    alignment = align(truth_m[is_known], estimate_m[is_known])
    error_m = mae_l(estimate_m[is_known], alignment.apply(truth_m[is_known]))
    config, arrays = read_map(path)
    refuse_other(config, Config())
    check(arrays, Config())
    all_m = alignment.apply(np.array([sample.pose[:2] for sample in truth]))
    gaps_s = np.diff(stamps_ns) * 1e-9
    print(f'  MAE_L {error_m:.3f} m over {is_known.sum()} poses, MAE_M of the map\'s '
          f'{len(arrays["experience_poses"])} experiences '
          f'{mae_m(arrays["experience_poses"][:, :2], all_m):.3f} m, '
          f'{len(np.unique(arrays["visit_flown"][:, 2]))} segments; without a pose for '
          f'{gaps_s[gaps_s > 0.5].sum():.1f} s, at most {gaps_s.max():.1f} s on end')
    return error_m


def main() -> int:
    """Fly undisturbed, then with kills; return 1 when that did too much harm."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('flight', type=Path)
    parser.add_argument('--kills', type=int, default=20)
    parser.add_argument('--seed', type=int, default=0)
    parser.add_argument('--seconds', type=float, help='play no more than that')
    args = parser.parse_args()
    truth = [event for event in read_flight(args.flight) if isinstance(event, GroundTruthSample)]
    seconds = args.seconds or (truth[-1].stamp_ns - truth[0].stamp_ns) * 1e-9
    rng = np.random.default_rng(args.seed)
    kills = [(time_s, str(rng.choice(NODES)))
             for time_s in np.sort(rng.uniform(2.0, seconds - 2.0, args.kills)).tolist()]
    os.environ.setdefault('FASTRTPS_DEFAULT_PROFILES_FILE', str(PROFILE))
    rclpy.init()
    errors_m = []
    for name, its_kills in (('undisturbed', []), (f'{args.kills} kills', kills)):
        print(f'{name}:')
        with tempfile.TemporaryDirectory() as folder:
            poses = fly(args.flight, Path(folder), its_kills, seconds)
            errors_m.append(judge(poses, truth, Path(folder, 'flight.map')))
    rclpy.shutdown()
    print(f'MAE_L {errors_m[1] / errors_m[0]:.2f} of the undisturbed flight\'s')
    return int(errors_m[1] > MAX_RATIO * errors_m[0])


if __name__ == '__main__':
    sys.exit(main())
