"""Bytes → checked MAVLink packets, and what was lost between them."""

from __future__ import annotations

from typing import Iterator, NamedTuple

from pymavlink.dialects.v20 import ardupilotmega as dialect

_V1, _V2 = dialect.PROTOCOL_MARKER_V1, dialect.PROTOCOL_MARKER_V2
MARKERS = (_V1, _V2)
_HEADER_AND_CHECKSUM = {_V1: 8, _V2: 12}
SIGNATURE_LENGTH = 13


class Packet(NamedTuple):
    """
    One packet whose checksum holds, and its message.

    `message` is None where the dialect does not know it: its checksum cannot be told then.
    """

    data: bytes
    sequence: int
    system: int
    component: int
    message: dialect.MAVLink_message | None

    @property
    def is_signed(self) -> bool:
        """Whether the packet carries a signature."""
        return self.data[0] == _V2 and bool(self.data[2] & dialect.MAVLINK_IFLAG_SIGNED)


class PacketReader:
    """Reads the packet that starts at a place in a buffer."""

    def __init__(self):
        self._decoder = dialect.MAVLink(None)

    def claimed_length(self, data: bytes, at: int) -> int:
        """Return how long the packet claims to be, 0 where none starts; a cut header is long."""
        minimum = _HEADER_AND_CHECKSUM.get(data[at], 0)
        if not minimum or at + minimum > len(data):
            return minimum
        flags = data[at + 2] if data[at] == _V2 else 0
        if flags & ~dialect.MAVLINK_IFLAG_SIGNED:
            return 0  # a format of the future: the protocol says to drop it
        return minimum + data[at + 1] + SIGNATURE_LENGTH * flags

    def read(self, data: bytes, at: int) -> Packet | None:
        """Return the packet, or None where it is cut or its checksum does not hold."""
        length = self.claimed_length(data, at)
        if not length or at + length > len(data):
            return None
        frame = bytes(data[at:at + length])
        try:
            message = self._decoder.decode(bytearray(frame))
        except dialect.MAVError:
            return None
        known = message if message.get_msgId() >= 0 else None
        if frame[0] == _V2:
            return Packet(frame, *frame[4:7], known)
        # Only the new format may be longer than what is known of it, so this one passed by chance.
        is_too_long = known is not None and frame[1] > known.unpacker.size
        return None if is_too_long else Packet(frame, *frame[2:5], known)


class Framer:
    """
    Finds the packets in datagrams or in a stream of bytes; what is none counts as corrupt.

    pymavlink's own parser skips the whole length that a bad packet claims, and with it the good
    ones behind a false start: here the search goes on one byte later. In a datagram nothing is
    waited for: a packet cut short by its end is bad, and the next datagram starts afresh.
    """

    def __init__(self, datagrams: bool):
        self._datagrams = datagrams
        self._reader = PacketReader()
        self._rest = b''
        self.corrupt = 0

    def feed(self, data: bytes) -> Iterator[Packet]:
        """Yield the packets that are whole by now; count each run of bytes that are none."""
        data, self._rest = self._rest + data, b''
        at, is_lost = 0, False
        while at < len(data):
            end = at + self._reader.claimed_length(data, at)
            if end > len(data) and not self._datagrams:
                self._rest = data[at:]
                return
            packet = self._reader.read(data, at)
            if packet is not None and packet.message is not None:
                yield packet
                at, is_lost = end, False
                continue
            if packet is not None and may_go_on(data, end):
                yield packet  # unchecked: good ones may stand in what it claims
            elif not is_lost:
                self.corrupt += 1
            at, is_lost = next_start(data, at + 1), True


class SequenceCounter:
    """
    Losses of one sender at a time, whose packets are numbered from 0 to 255 and round again.

    A step of more than 128 is no loss but a late packet, which was counted as lost before.
    """

    def __init__(self):
        self.lost = 0
        self.reordered = 0
        self._last: int | None = None

    def restart(self) -> None:
        """Take in that the next packet is of another sender."""
        self._last = None

    def observe(self, packet: Packet) -> None:
        """Take the number of the next packet; an unknown one's only where it is expected."""
        step = 1 if self._last is None else (packet.sequence - self._last) % 256
        if packet.message is None and step != 1:
            return
        if step > 128:
            self.reordered += 1
            self.lost = max(0, self.lost - 1)
            return
        self.lost += max(0, step - 1)
        self._last = packet.sequence


def next_start(data: bytes, at: int) -> int:
    """Return where, from here on, a packet may start, or the end of the data."""
    starts = [data.find(marker, at) for marker in MARKERS]
    return min((start for start in starts if start >= 0), default=len(data))


def may_go_on(data: bytes, at: int) -> bool:
    """Tell whether what ends here goes on with a packet, or is the last."""
    return at >= len(data) or data[at] in MARKERS
