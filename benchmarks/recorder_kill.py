"""
Kill the recorder with SIGKILL at random moments under load; repair; tell what is missing.

Each run records at a random speed between one and four times that of a drone, 16 to 65 MB/s,
with one of the compressions, in one file or split. Exits 1 when a file is not readable after
`recover`, a message is not as it was written, one is missing before another, or one is missing
that came more than `flush_interval_s` before the kill. The bound needs a processor that is free
for the writer in that time: other load on the machine shows.
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path
import shutil
import signal
import subprocess
import sys
import time

from dlsc_qbs_ros.config import RecorderConfig
from dlsc_qbs_ros.io.recordings.bag import read_bag
from dlsc_qbs_ros.io.recordings.recording import Recording
from dlsc_qbs_ros.io.recordings.recovery import recover
import numpy as np
from recorder_traffic import announce, drone, number_of, play

CASES = (RecorderConfig(), RecorderConfig(compression='lz4'), RecorderConfig(compression='zstd'),
         RecorderConfig(max_bytes=20_000_000), RecorderConfig(sync_interval_s=0.05))
MAX_MESSAGES = 100_000


def record(directory: Path, case: int, speed: float) -> None:
    """Record until killed; note in a mapped file, which outlives that, when messages went in."""
    accepted_ns = np.memmap(directory.with_suffix('.accepted'), np.int64, 'w+',
                            shape=(MAX_MESSAGES,))
    streams = drone()
    recording = Recording(directory, CASES[case])
    announce(recording, streams)
    for stream, number, time_ns in play(streams, 60.0, speed):
        if not recording.write(stream.topic, stream.message(number), time_ns, time_ns):
            raise SystemExit('a message was refused')
        accepted_ns[number] = time.monotonic_ns()


def killed(directory: Path, case: int, speed: float, seconds: float) -> int:
    """Record in a process of its own and kill that; return when, on the monotonic clock."""
    process = subprocess.Popen(
        [sys.executable, __file__, '--record', str(directory), str(case), str(speed)])
    while not (directory / 'metadata.yaml').exists() and process.poll() is None:
        time.sleep(0.01)
    time.sleep(seconds)
    killed_ns = time.monotonic_ns()
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    return killed_ns


def missing(directory: Path, killed_ns: int) -> tuple[int, int, float]:
    """Repair; return the messages accepted, those missing, and the age of the oldest in s."""
    list(recover(directory))
    numbers = [number_of(message.data) for message in read_bag(directory)]
    if None in numbers:
        raise SystemExit(f'{directory}: a message is not what was written')
    accepted_ns = np.fromfile(directory.with_suffix('.accepted'), np.int64)
    n_accepted = int((accepted_ns > 0).sum())
    n_read = len(numbers)
    if sorted(numbers) != list(range(n_read)):
        raise SystemExit(f'{directory}: a message is missing before another')
    age_s = (killed_ns - accepted_ns[n_read]) * 1e-9 if n_read < n_accepted else 0.0
    return n_accepted, max(n_accepted - n_read, 0), age_s


def main() -> int:
    """Run the trials and print a line for each."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--trials', type=int, default=50)
    parser.add_argument('--seed', type=int, default=0)
    parser.add_argument('--out', type=Path, default=Path('bench_output/recorder_kill'))
    parser.add_argument('--record', nargs=3, help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.record:
        record(Path(args.record[0]), int(args.record[1]), float(args.record[2]))
        return 0
    rng = np.random.default_rng(args.seed)
    ages_s = []
    for trial in range(args.trials):
        shutil.rmtree(args.out, ignore_errors=True)
        args.out.mkdir(parents=True)
        case, speed = trial % len(CASES), rng.uniform(1.0, 4.0)
        directory = args.out / 'flight'
        killed_ns = killed(directory, case, speed, rng.uniform(0.05, 1.5))
        n_accepted, n_missing, age_s = missing(directory, killed_ns)
        ages_s.append(age_s)
        print(f'{trial:3}: case {case}, {speed:4.1f} times a drone: {n_accepted} accepted, '
              f'{n_missing} missing, the oldest {1e3 * age_s:.0f} ms before the kill', flush=True)
    shutil.rmtree(args.out)
    bound_s = RecorderConfig().flush_interval_s
    print(f'load average {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores')
    print(f'{args.trials} kills: all readable, none corrupt; oldest missing message '
          f'{1e3 * max(ages_s):.0f} ms old (median {1e3 * np.median(ages_s):.0f} ms, '
          f'bound {1e3 * bound_s:.0f} ms)')
    return int(max(ages_s) > bound_s)


if __name__ == '__main__':
    sys.exit(main())
