"""Recordings of a MAVLink link: each packet behind the time it came, as ground stations write."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from threading import Event, Lock, Thread
import time
from typing import Callable, Iterator

from .framing import may_go_on, next_start, Packet, PacketReader
from .receiver import Receiver
from ...config import MavlinkConfig
from ...core.types import RawOdometry
from ...errors import RecordingError

# A record is the UNIX time in microseconds, big-endian, and the packet.
_TIME_LENGTH = 8
# A damaged time is one farther than this from the one before and from the one behind it.
_MAX_STEP_US = 86_400_000_000


class TlogPackets:
    """
    The packets of a recording, each with its time of arrival in nanoseconds.

    What is no record is searched through byte by byte for the next one; each such stretch counts
    as corrupt.
    """

    def __init__(self, path: Path):
        try:
            self._data = Path(path).read_bytes()
        except OSError as error:
            raise RecordingError(f'{path}: {error.strerror}') from error
        self.corrupt = 0

    def __iter__(self) -> Iterator[tuple[int, Packet]]:
        reader, data = PacketReader(), self._data
        at, last_us, is_lost = 0, None, False
        while at + _TIME_LENGTH < len(data):
            time_us = _time_us(data, at)
            packet = reader.read(data, at + _TIME_LENGTH)
            end = at + _TIME_LENGTH + len(packet.data) if packet else at
            if packet is not None and last_us is not None and not _is_near(time_us, last_us) and (
                    packet.message is None or not _is_near(time_us, _time_us(data, end))):
                packet = None
            if packet is not None and packet.message is not None:
                yield time_us * 1000, packet
                at, last_us, is_lost = end, time_us, False
                continue
            if packet is not None and may_go_on(data, end + _TIME_LENGTH):
                yield time_us * 1000, packet  # unchecked: good ones may stand in what it claims
            else:
                self.corrupt += not is_lost
            at, is_lost = next_start(data, at + 1 + _TIME_LENGTH) - _TIME_LENGTH, True


def _time_us(data: bytes, at: int) -> int:
    return int.from_bytes(data[at:at + _TIME_LENGTH], 'big')


def _is_near(time_us: int, other_us: int) -> bool:
    return abs(time_us - other_us) < _MAX_STEP_US


class TlogOdometry:
    """The odometry of a recording; `counts` holds, at its end, what was refused by cause."""

    def __init__(self, path: Path, config: MavlinkConfig = MavlinkConfig()):
        self._packets = TlogPackets(path)
        self._receiver = Receiver(config)

    def __iter__(self) -> Iterator[RawOdometry]:
        for arrival_ns, packet in self._packets:
            yield from self._receiver.take(packet, arrival_ns)

    @property
    def counts(self) -> Counter[str]:
        """Return what was refused so far, by cause."""
        return self._receiver.counts() + Counter(mavlink_corrupt=self._packets.corrupt)


class TlogPlayer:
    """A recording in place of a link: its odometry, in the time that it took."""

    def __init__(self, config: MavlinkConfig):
        self._odometry = TlogOdometry(Path(config.connection), config)
        self._lock = Lock()  # of the odometry: diagnostics come from another thread
        self._stopping = Event()
        self._is_playing = False

    def start(self, deliver: Callable[[RawOdometry], None]) -> None:
        """Begin at the beginning."""
        self._stopping.clear()
        self._is_playing = True
        self._thread = Thread(target=self._play, args=(deliver,), name='tlog', daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Stop; nothing comes after this returns."""
        self._stopping.set()
        self._thread.join()

    def send(self, message) -> None:
        """Do nothing: nobody hears it."""

    def diagnostics(self) -> Counter[str]:
        """Return what was amiss, by cause."""
        with self._lock:
            return self._odometry.counts

    def state(self) -> dict[str, object]:
        """Return words and figures on the recording."""
        return {'mavlink_link': self.why_silent()}

    def why_silent(self) -> str:
        """Return in plain words why no odometry comes."""
        return 'a pause in the recording' if self._is_playing else 'the recording has ended'

    def _play(self, deliver: Callable[[RawOdometry], None]) -> None:
        due_s, last_ns = time.monotonic(), None
        odometry = iter(self._odometry)
        while (raw := self._next(odometry)) is not None:
            step_ns = 0 if last_ns is None else raw.sample.stamp_ns - last_ns
            last_ns = raw.sample.stamp_ns
            if abs(step_ns) < _MAX_STEP_US * 1000:  # else the clock was set: nobody waits for it
                due_s += step_ns * 1e-9
            if self._stopping.wait(max(0.0, due_s - time.monotonic())):
                return
            deliver(raw)
        self._is_playing = False

    def _next(self, odometry: Iterator[RawOdometry]) -> RawOdometry | None:
        with self._lock:
            return next(odometry, None)
