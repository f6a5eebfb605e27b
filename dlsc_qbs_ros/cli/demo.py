"""One simulated flight through the three live nodes, recorded, and measured by evaluate."""

from __future__ import annotations

import argparse
from collections import Counter
from contextlib import contextmanager, ExitStack
import json
import os
from pathlib import Path
import random
import shutil
import signal
import socket
import subprocess
import sys
import time
from typing import Iterator, NamedTuple, Sequence

import numpy as np
import yaml

from .common import run_tool
from ..errors import DlscQbsError
from ..evaluation.alignment import align
from ..evaluation.association import associate
from ..evaluation.metrics import mae_l
from ..io.recordings.bag import read_bag

INSTALLED = Path('install', 'dlsc_qbs_ros')
PROFILE = INSTALLED / 'share' / 'dlsc_qbs_ros' / 'config' / 'replay.yaml'
NODES = ('recorder', 'encoder', 'ratslam')
FLIGHT_S = 150
FLIGHT = ('--flight', 1, '--seed', 0, '--seconds', FLIGHT_S)
RATE = 5
ODOMETRY_RATE_HZ = 50.0
# Over a link everything flies in real time, once all are up.
START_UP_S = 15
TOOL_TIMEOUT_S = 240
STOP_TIMEOUT_S = 20


def main(argv: Sequence[str] | None = None) -> int:
    """Run the demonstration; print expected errors as one line and return the exit code."""
    parser = argparse.ArgumentParser(prog='demo', description=__doc__)
    parser.add_argument('--out', metavar='DIR', type=Path, required=True)
    parser.add_argument('--odometry', choices=('nav_msgs', 'mavlink'), default='nav_msgs',
                        help='how it comes: on a topic, at five times the speed, or over UDP '
                        'from a simulated autopilot, in real time (default: %(default)s)')
    options = parser.parse_args(argv)
    return run_tool('demo', lambda _: _demonstrate(options.out, options.odometry), options)


def _demonstrate(out: Path, odometry: str) -> None:
    if not INSTALLED.is_dir():
        raise DlscQbsError(f'{INSTALLED} is missing: run `make build` first')
    for number in (signal.SIGINT, signal.SIGTERM):  # both unwind, and leave no node behind
        signal.signal(number, signal.default_int_handler)
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir(parents=True)
    flight, recording = out / 'flight1', out / 'recording'
    os.environ.update(
        ROS_DOMAIN_ID=str(_unused_domain()), ROS_AUTOMATIC_DISCOVERY_RANGE='LOCALHOST')

    _say(f'1/4 simulating {FLIGHT_S} s of flight between a wall and shelves that look alike')
    _run_tool('simulate', *FLIGHT, '--encoding', 'mono8', '--out', flight)
    link = f'127.0.0.1:{_unused_port()}' if odometry == 'mavlink' else None
    with ExitStack() as stack:
        nodes = {name: stack.enter_context(_node(out, name, recording, link)) for name in NODES}
        if link is None:
            _say(f'2/4 playing it {RATE} times as fast through encoder, ratslam and recorder')
            _run_tool('replay', flight, '--rate', RATE)
        else:
            _say('2/4 flying it through encoder, ratslam and recorder, with the odometry of a '
                 f'simulated autopilot on udp:{link}')
            _fly(out, flight, link)
        _say('3/4 evaluating the same flight without ROS, while the nodes finish')
        _run_tool('evaluate', flight, '--config', PROFILE, '--out', out)
        _say('4/4 stopping the nodes and closing the recording')
        for name in reversed(NODES):
            _stop(name, nodes[name])
    print(_summary(out, flight, recording))


def _fly(out: Path, flight: Path, link: str) -> None:
    """Play the images as if they were taken now, while an autopilot flies the same flight."""
    start_at = ('--start-at', time.time() + START_UP_S)
    autopilot = ('simulate', *FLIGHT, '--mavlink', f'udpout:{link}', *start_at)
    with _process(out / 'autopilot.log', *autopilot) as process:
        _run_tool('replay', flight, *start_at, '--topics', '/camera/image_raw', '/ground_truth')
        _await_end('the autopilot', process)


def _say(text: str) -> None:
    print(f'== {text}', flush=True)  # in order with what the tools print


def _unused_domain() -> int:
    """Return a ROS domain whose first discovery port nobody on this machine holds."""
    for domain in random.sample(range(1, 101), 100):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            try:
                probe.bind(('', 7400 + 250 * domain + 10))
            except OSError:
                continue
        return domain
    raise DlscQbsError('every ROS domain from 1 to 100 is in use on this machine')


def _unused_port() -> int:
    """Return a UDP port that nobody on this machine holds."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(('127.0.0.1', 0))
        return probe.getsockname()[1]


def _command(name: str, *arguments: object) -> list[str]:
    return [str(INSTALLED / 'lib' / 'dlsc_qbs_ros' / name), *map(str, arguments)]


def _run_tool(name: str, *arguments: object) -> None:
    """Run a tool to its end, in bounded time."""
    try:
        subprocess.run(_command(name, *arguments), check=True, stdin=subprocess.DEVNULL,
                       timeout=TOOL_TIMEOUT_S)
    except subprocess.CalledProcessError as error:
        raise DlscQbsError(f'{name} failed with exit code {error.returncode}') from error
    except subprocess.TimeoutExpired as error:
        raise DlscQbsError(f'{name} did not end within {TOOL_TIMEOUT_S} s') from error


def _node(out: Path, name: str, recording: Path, link: str | None):
    """Start a node; `link` is where it listens for an autopilot, if it does."""
    if name == 'recorder':
        # On the flight's clock it would wait for the first tick and miss what comes with it.
        parameters = [f'recorder.output:={recording}']
    elif link is None:
        parameters = ['use_sim_time:=true']
    else:
        parameters = ['odometry.source:=mavlink', f'mavlink.connection:=udpin:{link}',
                      f'mavlink.rate_hz:={ODOMETRY_RATE_HZ}']
    return _process(
        out / f'{name}.log', name, '--ros-args', '-r', 'image:=/camera/image_raw',
        '-r', 'odom:=/odom', '--params-file', PROFILE,
        *(part for parameter in parameters for part in ('-p', parameter)))


@contextmanager
def _process(log: Path, name: str, *arguments: object) -> Iterator[subprocess.Popen]:
    """Start a process that writes its log beside the results; leave none behind."""
    with open(log, 'w') as stream:
        process = subprocess.Popen(_command(name, *arguments), stdin=subprocess.DEVNULL,
                                   stdout=stream, stderr=subprocess.STDOUT)
    try:
        yield process
    finally:
        if process.poll() is None:
            process.terminate()
            try:
                process.wait(STOP_TIMEOUT_S)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


def _stop(name: str, process: subprocess.Popen) -> None:
    """End a node as Ctrl-C would; it must have lived until now and end well."""
    if process.poll() is not None:
        raise DlscQbsError(f'{name} died early with exit code {process.returncode}: see its log')
    process.send_signal(signal.SIGINT)
    _await_end(name, process)


def _await_end(name: str, process: subprocess.Popen) -> None:
    """Wait for a process to end by itself, soon and well."""
    try:
        code = process.wait(STOP_TIMEOUT_S)
    except subprocess.TimeoutExpired as error:
        raise DlscQbsError(f'{name} did not stop within {STOP_TIMEOUT_S} s') from error
    if code != 0:
        raise DlscQbsError(f'{name} ended with exit code {code}: see its log')


def _summary(out: Path, flight: Path, recording: Path) -> str:
    """Say what was done, what was measured and what to look at."""
    flown, recorded = _message_counts(flight), _message_counts(recording)
    images, codes, poses = flown['/camera/image_raw'], recorded['/code'], recorded['/pose']
    if not codes or not poses:
        raise DlscQbsError(f'{recording} holds {codes} codes and {poses} poses: see the node logs')
    row = json.loads((out / 'metrics.json').read_text())['rows'][0]
    live = _live_result(recording)
    picture, = out.glob('*.png')
    return (
        f'\nDone: {FLIGHT_S} s of simulated flight went through the live nodes:\n'
        f'  of {images} images the recording holds {codes} codes and {poses} poses, '
        f'{sum(recorded.values())} messages in all.\n'
        f'Measured: live, {live.closures} loop closures among {live.experiences} experiences and '
        f'MAE_L {live.mae_l:.2f} m over all poses;\n'
        f'  evaluated, {row["closures"]} among {row["experiences"]}, MAE_L {row["mae_l"]:.2f} m '
        f'at the codes, MAE_M {row["mae_m"]:.2f} m; odometry alone '
        f'{row["odometry_mae_l"]:.2f} m, {row["odometry_mae_m"]:.2f} m.\n'
        f'Look at: {picture} (estimate, odometry, truth, closures),\n  {out / "metrics.json"}, '
        f'and {recording} in Foxglove or with `ros2 bag info`.')


class LiveResult(NamedTuple):
    """What the live nodes left in the recording: the error of all poses, the last map."""

    mae_l: float
    experiences: int
    closures: int


def _live_result(recording: Path) -> LiveResult:
    from ..ros.conversions import pose_stamped_from_msg
    from ..ros.serialization import deserialize
    stamps_ns, poses, truth, markers = [], [], [], []
    for message in read_bag(recording, ('/pose', '/ground_truth', '/experience_map')):
        msg = deserialize(message.data, message.type_name)
        if message.topic == '/experience_map':
            markers = msg.markers
            continue
        sample = pose_stamped_from_msg(msg)
        if message.topic == '/ground_truth':
            truth.append(sample)
        else:
            stamps_ns.append(sample.stamp_ns)
            poses.append(sample.pose[:2])
    truth_m = associate(np.array(stamps_ns), truth)[:, :2]
    used = np.isfinite(truth_m).all(axis=1)
    truth_m, poses_m = truth_m[used], np.array(poses)[used]
    experiences, _, closures = (len(marker.points) for marker in markers)
    return LiveResult(
        mae_l(poses_m, align(truth_m, poses_m).apply(truth_m)), experiences, closures // 2)


def _message_counts(recording: Path) -> Counter[str]:
    """Return the number of messages per topic that a rosbag2 recording declares."""
    document = yaml.safe_load((recording / 'metadata.yaml').read_text())
    topics = document['rosbag2_bagfile_information']['topics_with_message_count']
    return Counter({topic['topic_metadata']['name']: topic['message_count'] for topic in topics})


if __name__ == '__main__':
    sys.exit(main())
