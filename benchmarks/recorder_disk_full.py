"""
Fill the disk under load: a small tmpfs, with and without the free-space guard, and a size limit.

Exits 1 when a file is not whole and indexed, holds another number of messages than the recorder
says, or a message offered is not accounted for. The tmpfs needs Linux user namespaces, or root.
"""

from __future__ import annotations

import argparse
from pathlib import Path
import resource
import subprocess
import sys
import tempfile

from dlsc_qbs_ros.config import RecorderConfig
from dlsc_qbs_ros.errors import RecordingError
from dlsc_qbs_ros.io.recordings.mcap_repair import is_cut
from dlsc_qbs_ros.io.recordings.recording import Recording
from mcap.reader import make_reader
from recorder_traffic import announce, drone, number_of, play

MB = 2**20
DISK_MB = 64


def record(directory: Path, config: RecorderConfig) -> None:
    """Record until the disk is full and a bit longer; print what became of it."""
    streams = drone()
    recording = Recording(directory, config)
    announce(recording, streams)
    n_offered = n_taken = n_after = 0
    for stream, number, time_ns in play(streams, 60.0, speed=6.0):
        n_taken += recording.write(stream.topic, stream.message(number), time_ns, time_ns)
        n_offered += 1
        n_after += recording.status().state == 'stopped'
        if n_after == 500:
            break
    try:
        recording.close()
        error = 'NO ERROR'
    except RecordingError as failure:
        error = str(failure)
    status = recording.status()
    path, = directory.glob('*.mcap')
    with open(path, 'rb') as stream:
        numbers = [number_of(message.data) for _, _, message in
                   make_reader(stream, validate_crcs=True).iter_messages()]
    is_true = (not is_cut(path) and None not in numbers and len(numbers) == status.total.written
               and sum(status.total) == n_offered)
    print(f'  {error}\n  {n_offered} offered = {status.total}; of {n_taken} taken, {len(numbers)} '
          f'are in the file, {path.stat().st_size / MB:.1f} MiB, '
          f'{"whole and indexed" if is_true else "NOT AS IT SHOULD BE"}', flush=True)
    raise SystemExit(not is_true or error == 'NO ERROR')


def main() -> int:
    """Fill the disk in three ways."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--record', nargs=3, help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.record:
        directory, min_free, limit = args.record
        if int(limit):
            resource.setrlimit(resource.RLIMIT_FSIZE, (int(limit), int(limit)))
        record(Path(directory), RecorderConfig(min_free_bytes=int(min_free)))
    failed = 0
    for name, min_free, limit in (('the guard, at 24 MiB', 24 * MB, 0), ('no guard', 0, 0),
                                  ('a limit of 32 MiB per file', 0, 32 * MB)):
        print(f'{DISK_MB} MiB of disk, {name}:', flush=True)
        with tempfile.TemporaryDirectory() as folder:
            command = (f'mount -t tmpfs -o size={DISK_MB}m none {folder} && exec {sys.executable} '
                       f'{__file__} --record {folder}/flight {min_free} {limit}')
            failed += subprocess.run(
                ['unshare', '--map-root-user', '--mount', 'sh', '-c', command]).returncode != 0
    return int(failed > 0)


if __name__ == '__main__':
    sys.exit(main())
