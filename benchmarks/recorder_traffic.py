"""What a drone sends to the recorder: images, odometry at 200 Hz and codes at 20 Hz."""

from __future__ import annotations

import struct
import time
from typing import Iterator, NamedTuple
import zlib

from dlsc_qbs_ros.io.recordings.recording import Recording
from dlsc_qbs_ros.ros.serialization import serialize
from nav_msgs.msg import Odometry
import numpy as np
from sensor_msgs.msg import Image

_TRAILER = struct.Struct('<II')  # number and checksum


class Stream(NamedTuple):
    """A topic whose messages end in their number among all and a checksum."""

    topic: str
    type_name: str
    rate_hz: float
    content: bytes

    def message(self, number: int) -> bytes:
        """Return a serialised message."""
        return self.content + _TRAILER.pack(number, zlib.crc32(self.content, number))


def number_of(data: bytes) -> int | None:
    """Return the number of a message, or None when it is not as it was written."""
    number, checksum = _TRAILER.unpack(data[-_TRAILER.size:])
    return number if checksum == zlib.crc32(data[:-_TRAILER.size], number) else None


def image(height: int, width: int, rate_hz: float, seed: int = 0) -> Stream:
    """Return a stream of noise in colour, which no compression makes smaller."""
    data = np.random.default_rng(seed).integers(0, 256, height * width * 3, dtype=np.uint8)
    msg = Image(height=height, width=width, encoding='rgb8', step=3 * width, data=data.tobytes())
    return Stream('/camera/image_raw', 'sensor_msgs/msg/Image', rate_hz,
                  serialize(msg)[:-_TRAILER.size])


def drone(height: int = 260, width: int = 346, rate_hz: float = 60.0) -> list[Stream]:
    """Return all streams of a drone with such a camera, 346x260 rgb8 at 60 Hz if not said."""
    code = Image(height=1, width=1280, encoding='32FC1', step=5120, data=bytes(5120))
    return [image(height, width, rate_hz),
            Stream('/odom', 'nav_msgs/msg/Odometry', 200.0,
                   serialize(Odometry())[:-_TRAILER.size]),
            Stream('/code', 'sensor_msgs/msg/Image', 20.0, serialize(code)[:-_TRAILER.size])]


def announce(recording: Recording, streams: list[Stream]) -> None:
    """Add the topics of the streams."""
    for stream in streams:
        recording.add_topic(stream.topic, stream.type_name)


def play(streams: list[Stream], seconds: float, speed: float = 1.0
         ) -> Iterator[tuple[Stream, int, int]]:
    """Yield (stream, number, due time) when each message is due, in time or at `speed`."""
    due = sorted((k / stream.rate_hz, i) for i, stream in enumerate(streams)
                 for k in range(int(seconds * stream.rate_hz)))
    start_s, start_ns = time.monotonic(), time.time_ns()
    for number, (due_s, i) in enumerate(due):
        wait_s = start_s + due_s / speed - time.monotonic()
        if wait_s > 0:
            time.sleep(wait_s)
        yield streams[i], number, start_ns + round(due_s / speed * 1e9)
