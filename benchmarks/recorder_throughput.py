"""What the writing side of the recorder costs: CPU at a drone's rates, and the most it can do."""

from __future__ import annotations

import argparse
import os
from pathlib import Path
import shutil
import sys
import time

from dlsc_qbs_ros.config import RecorderConfig
from dlsc_qbs_ros.io.recordings.recording import Recording
from recorder_traffic import announce, drone, image, play, Stream


def at_rate(out: Path, streams: list[Stream], seconds: float, config: RecorderConfig) -> int:
    """Record in time, print the CPU beyond what making the messages takes; return the losses."""
    def cpu_s(write) -> tuple[float, int]:
        before, n_refused = os.times(), 0
        for stream, number, time_ns in play(streams, seconds):
            n_refused += not write(stream.topic, stream.message(number), time_ns, time_ns)
        after = os.times()
        return after.user + after.system - before.user - before.system, n_refused

    idle_s, _ = cpu_s(lambda *_: True)
    recording = Recording(out, config)
    announce(recording, streams)
    busy_s, n_refused = cpu_s(recording.write)
    recording.close()
    status = recording.status()
    print(f'  {status.total.written} messages, {status.written_bytes / seconds / 1e6:.0f} MB/s: '
          f'{100 * (busy_s - idle_s) / seconds:.1f} % of a core, {n_refused} lost', flush=True)
    return n_refused


def flat_out(out: Path, n_messages: int, config: RecorderConfig) -> None:
    """Record as fast as the queue takes it; print the rate up to the last byte written."""
    # Different ones, or what repeats within a chunk would be compressed away.
    streams = [image(260, 346, 60.0, seed) for seed in range(16)]
    messages = [stream.message(0) for stream in streams]
    start_s, cpu = time.monotonic(), time.process_time()
    recording = Recording(out, config)
    announce(recording, streams[:1])
    k = 0
    while k < n_messages:
        if recording.write(streams[0].topic, messages[k % len(messages)], k, k):
            k += 1
        else:
            time.sleep(0.01)
    recording.close()
    seconds, cpu = time.monotonic() - start_s, time.process_time() - cpu
    print(f'  {config.compression}: {n_messages * len(messages[0]) / seconds / 1e6:.0f} MB/s, '
          f'{cpu / seconds:.2f} cores', flush=True)


def main() -> int:
    """Measure; exit 1 when anything was lost at a drone's rates."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--seconds', type=float, default=10.0)
    parser.add_argument('--out', type=Path, default=Path('bench_output/recorder_throughput'))
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    flight, n_lost = args.out / 'flight', 0
    for name, streams in (('346x260 rgb8 at 60 Hz, odometry, codes', drone()),
                          ('1280x720 rgb8 at 30 Hz, odometry, codes', drone(720, 1280, 30.0))):
        for compression in ('none', 'lz4'):
            print(f'{name}, compression {compression}:', flush=True)
            n_lost += at_rate(flight, streams, args.seconds, RecorderConfig(
                compression=compression))
            shutil.rmtree(flight)
    print('flat out, 346x260 rgb8:', flush=True)
    for compression in ('none', 'lz4', 'zstd'):
        flat_out(flight, 4000, RecorderConfig(compression=compression, sync_interval_s=0.0))
        shutil.rmtree(flight)
    return int(n_lost > 0)


if __name__ == '__main__':
    sys.exit(main())
