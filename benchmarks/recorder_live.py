"""
What the recorder loses, and what it costs, beside publishers on the same machine.

This process publishes as a drone would, best effort: an image, the code of each, odometry. A
recorder of its own process records. What was sent is held against what the recording holds.
Exits 1 when something is missing.
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path
import resource
import signal
import subprocess
import sys
import tempfile
import time
from typing import NamedTuple

from dlsc_qbs_ros.ros.image_conversions import image_to_msg
from dlsc_qbs_ros.ros.serialization import serialize
from nav_msgs.msg import Odometry
import numpy as np
import rclpy
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Image
import yaml

CODE_LENGTH = 2560  # 128 atoms in 5 x 4 cells
PROFILE = Path(__file__).parents[1] / 'config' / 'fastdds_shared_memory.xml'
SENSOR = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
PATIENCE_S = 30.0
SETTLE_S = 1.0


class Stream(NamedTuple):
    """One message, published over and over."""

    topic: str
    rate_hz: float
    message: Image | Odometry


def streams(width: int, height: int, rate_hz: float) -> list[Stream]:
    """Return what a drone with such a camera publishes."""
    rng = np.random.default_rng(0)
    image = rng.integers(0, 256, (height, width, 3), dtype=np.uint8)
    code = rng.normal(size=(1, CODE_LENGTH)).astype(np.float32)
    return [Stream('/camera/image_raw', rate_hz, image_to_msg(0, image, 'rgb8', 'camera')),
            Stream('/code', rate_hz, image_to_msg(0, code, '32FC1', 'dictionary_0')),
            Stream('/odom', 200.0, Odometry())]


def publish(node: Node, flown: list[Stream], seconds: float) -> dict[str, int]:
    """Publish each stream at its rate, once somebody listens; return how many messages of each."""
    publishers = [node.create_publisher(type(s.message), s.topic, SENSOR) for s in flown]
    payloads = [serialize(s.message) for s in flown]
    until_s = time.monotonic() + PATIENCE_S
    while not all(publisher.get_subscription_count() for publisher in publishers):
        if time.monotonic() > until_s:
            sys.exit('no recorder subscribes')
        time.sleep(0.05)
    time.sleep(SETTLE_S)
    started_s = time.monotonic()
    sent = [0] * len(flown)
    while True:
        due_s = [started_s + n / s.rate_hz for n, s in zip(sent, flown)]
        k = due_s.index(min(due_s))
        if due_s[k] > started_s + seconds:
            return {s.topic: n for s, n in zip(flown, sent)}
        time.sleep(max(due_s[k] - time.monotonic(), 0.0))
        publishers[k].publish(payloads[k])
        sent[k] += 1


def run(flown: list[Stream], seconds: float, output: Path) -> tuple[dict[str, int], float]:
    """Record what is published; return how many of each topic were sent, and CPU seconds."""
    rclpy.init()
    recorder = subprocess.Popen(
        [sys.executable, '-m', 'dlsc_qbs_ros.nodes.recorder_node', '-o', output,
         *(s.topic for s in flown)])
    try:
        sent = publish(rclpy.create_node('load'), flown, seconds)
        time.sleep(SETTLE_S)
    finally:
        recorder.send_signal(signal.SIGINT)
        recorder.wait()
        rclpy.try_shutdown()
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return sent, usage.ru_utime + usage.ru_stime


def recorded(output: Path) -> dict[str, int]:
    """Return how many messages of each topic a recording holds."""
    information = yaml.safe_load((output / 'metadata.yaml').read_text())
    return {topic['topic_metadata']['name']: topic['message_count'] for topic in
            information['rosbag2_bagfile_information']['topics_with_message_count']}


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--width', type=int, default=346)
    parser.add_argument('--height', type=int, default=260)
    parser.add_argument('--rate', type=float, default=60.0, help='of the camera')
    parser.add_argument('--seconds', type=float, default=20.0)
    parser.add_argument('--shared-memory', action='store_true', help=f'with {PROFILE.name}')
    options = parser.parse_args()
    os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    if options.shared_memory:
        os.environ['FASTRTPS_DEFAULT_PROFILES_FILE'] = str(PROFILE)
    with tempfile.TemporaryDirectory() as folder:
        output = Path(folder, 'recording')
        flown = streams(options.width, options.height, options.rate)
        sent, cpu_s = run(flown, options.seconds, output)
        found = recorded(output)
    print(f'{"topic":20s} {"sent":>8s} {"recorded":>9s} {"missing":>8s}')
    for topic, n in sent.items():
        print(f'{topic:20s} {n:8d} {found.get(topic, 0):9d} {n - found.get(topic, 0):8d}')
    print(f'{100 * cpu_s / options.seconds:.1f} % of a core')
    return int(found != sent)


if __name__ == '__main__':
    sys.exit(main())
