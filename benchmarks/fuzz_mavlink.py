"""
Feed the MAVLink source mutated packets, good ones between them, and see what comes out.

Damaged packets have bytes flipped, lost and added, are cut or run together, as bad lines do it;
forged ones have other contents and a checksum that holds. Both also meet a source with a key,
which must let nothing of them pass. Exits 1 when a sample was not finite or out of order, a good
packet was not counted, or memory grew; an exception of the source ends it at once.
"""

from __future__ import annotations

import argparse
from dataclasses import asdict, dataclass
from itertools import product
from math import isfinite
import os
from pathlib import Path
import random
import sys
import tempfile
import time
from typing import Callable

from dlsc_qbs_ros.config import MavlinkConfig, OdometryConfig
from dlsc_qbs_ros.core.types import OdometrySample
from dlsc_qbs_ros.io.mavlink.companion import Companion
from dlsc_qbs_ros.io.mavlink.framing import dialect
from dlsc_qbs_ros.pipeline.odometry import OdometryNormaliser
from mavlink_mutations import damaged, forged, heartbeat, MESSAGES, odometry

KEY = bytes(range(32))
SIGNING_TIMESTAMP = 2 ** 46
START_NS = 1_700_000_000_000_000_000
STEP_NS = 5_000_000
MUTATED_PER_GOOD = 4
HEARTBEAT_EVERY = 50
MAX_GROWTH_MB = 4.0
# One damaged packet in 65,536 has a checksum that holds, and may hide a good one behind it.
CHANCE = 1 / 20_000
WAYS = tuple(product((damaged, forged), (False, True), (True, False)))


@dataclass
class Result:
    """What went in, what came out, and by how much memory grew after the first tenth."""

    signed: bool
    mutated: int = 0
    good: int = 0
    good_odometry: int = 0
    counted: int = 0
    samples: int = 0
    unsound: int = 0
    grown_mb: float = 0.0

    @property
    def is_sound(self) -> bool:
        """Whether all that is promised held, but for `CHANCE`."""
        by_chance = CHANCE * self.mutated
        nothing_else = self.counted <= self.good and self.samples <= self.good_odometry
        return (self.unsound == 0 and self.grown_mb < MAX_GROWTH_MB
                and self.counted >= self.good - by_chance
                and (nothing_else or not self.signed))


class Source:
    """All of the source but its line and its thread, at a time that the fuzzer tells."""

    def __init__(self, key_file: Path | None, datagrams: bool):
        self.now_ns = 0
        self._companion = Companion(
            MavlinkConfig(key_file=str(key_file or '')), lambda: START_NS + self.now_ns)
        self._companion.connected(datagrams)
        self._normaliser = OdometryNormaliser(OdometryConfig())

    def feed(self, data: bytes) -> list[OdometrySample]:
        """Return the samples that these bytes complete."""
        samples = map(self._normaliser.accept, self._companion.receive(data, self.now_ns * 1e-9))
        return [sample for sample in samples if sample is not None]

    def talk(self) -> None:
        """Let it say what is due."""
        for _ in self._companion.outgoing(self.now_ns * 1e-9):
            pass

    @property
    def counted(self) -> int:
        """Return how many packets it has believed."""
        return self._companion.state()['mavlink_packets']


class Peer:
    """An autopilot, and somebody who damages or forges what it might have said."""

    def __init__(self, seed: int, mutate: Callable, signing: bool):
        self._rng, self._mutate = random.Random(seed), mutate
        self._sender, self._forger = (dialect.MAVLink(None, 1, 1) for _ in range(2))
        if signing:
            self._sender.signing.secret_key = KEY
            self._sender.signing.sign_outgoing = True
            self._sender.signing.timestamp = SIGNING_TIMESTAMP

    def good(self, message: dialect.MAVLink_message) -> bytes:
        """Return the next packet."""
        packet = message.pack(self._sender)
        self._sender.seq = (self._sender.seq + 1) % 256
        return packet

    def mutated(self, boot_ns: int) -> bytes:
        """Return any message of that time, mutated."""
        message = self._rng.choice(MESSAGES)(boot_ns)
        self._forger.seq = self._rng.randrange(256)
        return self._mutate(
            bytearray(message.pack(self._forger)), message.crc_extra, self._rng)


def fuzz(n: int, seed: int, mutate: Callable, key_file: Path | None = None,
         datagrams: bool = True) -> Result:
    """Feed `n` mutated packets and a quarter as many good ones."""
    source, result = Source(key_file, datagrams), Result(key_file is not None)
    peer = Peer(seed, mutate, key_file is not None)
    last, began_mb = None, 0.0
    while result.mutated < n:
        source.now_ns += STEP_NS
        is_heartbeat = result.good % HEARTBEAT_EVERY == 0
        good = peer.good((heartbeat if is_heartbeat else odometry)(source.now_ns))
        mutated = [peer.mutated(source.now_ns) for _ in range(MUTATED_PER_GOOD)]
        for data in (good, *mutated):
            for sample in source.feed(data):
                result.samples += 1
                result.unsound += not _is_sound(last, sample)
                last = sample
        source.talk()
        result.good += 1
        result.good_odometry += not is_heartbeat
        result.mutated += len(mutated)
        if began_mb == 0.0 and result.mutated >= n // 10:
            began_mb = resident_mb()
    source.feed(bytes(600))  # a stream waits for the end of what claims to be a packet
    result.counted = source.counted
    result.grown_mb = resident_mb() - began_mb
    return result


def write_key(path: Path) -> Path:
    """Write the key to a file that only its owner can read."""
    path.write_bytes(KEY)
    path.chmod(0o600)
    return path


def resident_mb() -> float:
    """Return the memory of this process that is in RAM."""
    pages = int(Path('/proc/self/statm').read_text().split()[1])
    return pages * os.sysconf('SC_PAGE_SIZE') * 1e-6


def main() -> int:
    """Fuzz in every way in turn; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[1])
    parser.add_argument('--packets', type=int, default=1_000_000, help='to mutate, in all')
    parser.add_argument('--seed', type=int, default=0)
    args = parser.parse_args()
    is_sound = True
    with tempfile.TemporaryDirectory() as folder:
        for k, (mutate, signed, datagrams) in enumerate(WAYS):
            began_s = time.perf_counter()
            key_file = write_key(Path(folder, str(k))) if signed else None
            result = fuzz(-(-args.packets // len(WAYS)), args.seed, mutate, key_file, datagrams)
            is_sound &= result.is_sound
            print(f'{mutate.__name__}, {"datagrams" if datagrams else "stream"}: '
                  f'{asdict(result)}, {time.perf_counter() - began_s:.1f} s')
    print('sound' if is_sound else 'NOT SOUND')
    return 0 if is_sound else 1


def _is_sound(last: OdometrySample | None, sample: OdometrySample) -> bool:
    """Whether a sample is finite, and after the one before it unless that was another segment."""
    values = (*sample.pose, sample.z_m, sample.roll_rad, sample.pitch_rad)
    is_after = last is None or sample.stamp_ns > last.stamp_ns or sample.segment != last.segment
    return all(map(isfinite, values)) and is_after and -2**63 <= sample.stamp_ns < 2**63


if __name__ == '__main__':
    sys.exit(main())
