"""A simulated autopilot: the odometry of a flight over MAVLink, as an autopilot sends it."""

from __future__ import annotations

from collections import Counter
from contextlib import suppress
import select
import time
from typing import Callable, Iterable, Iterator, Mapping

from .autopilot_messages import Encoder
from .connection import open_connection
from .framing import dialect, Framer
from ...core.types import RawOdometry
from ...errors import ConfigError

SYSTEM, COMPONENT = 1, dialect.MAV_COMP_ID_AUTOPILOT1
HEARTBEAT_NS = 1_000_000_000
LISTEN_S = 0.1
# What the old request for a whole stream asks for, of what may be sent here.
STREAMS = {
    dialect.MAV_DATA_STREAM_POSITION: ('LOCAL_POSITION_NED',),
    dialect.MAV_DATA_STREAM_EXTRA1: ('ATTITUDE',),
}
IDS = {message.msgname: number for number, message in dialect.mavlink_map.items()}


class Autopilot:
    """
    Flies, in real time, the odometry it is given, and talks to one companion.

    As ArduPilot's, its rates are zero until somebody asks: by MAV_CMD_SET_MESSAGE_INTERVAL or by
    REQUEST_DATA_STREAM, both within the rate of the odometry. Its time is that since it was made.
    A context manager.

    Parameters
    ----------
    address : str
        Of the link; see `open_connection`.
    encoders : mapping of str to Encoder
        What it can send; see `autopilot_messages`.

    Raises
    ------
    ConfigError
        When the address is none, or cannot be opened.

    """

    def __init__(self, address: str, encoders: Mapping[str, Encoder]):
        try:
            self._connection = open_connection(address)
        except OSError as error:
            raise ConfigError(f'{address}: cannot be opened: {error}') from error
        self._framer = Framer(self._connection.datagrams)
        self._sender = dialect.MAVLink(None, SYSTEM, COMPONENT)
        self._encoders = {IDS[name]: encoder for name, encoder in encoders.items()}
        # Per message asked for: its interval, and when it is due next; at first, at once.
        self._intervals_ns: dict[int, int] = {}
        self._due_ns: dict[int, int] = {}
        self._boot_ns = time.monotonic_ns()
        self._next_heartbeat_ns = 0
        self._answers: dict[str, Callable] = {
            'TIMESYNC': self._tell_time, 'COMMAND_LONG': self._obey,
            'REQUEST_DATA_STREAM': self._stream}
        self.sent: Counter[str] = Counter()
        self.received: Counter[str] = Counter()

    def __enter__(self) -> Autopilot:
        return self

    def __exit__(self, *_) -> None:
        self._connection.close()

    @property
    def time_ns(self) -> int:
        """Return the time since boot."""
        return time.monotonic_ns() - self._boot_ns

    def fly(self, odometry: Iterable[RawOdometry], start_ns: int | None = None) -> None:
        """Send the odometry as time passes; it starts at a time since the epoch, or now."""
        take_off_ns = self.time_ns + (0 if start_ns is None else start_ns - time.time_ns())
        first_ns = None
        for raw in odometry:
            first_ns = raw.sample.stamp_ns if first_ns is None else first_ns
            stamp_ns = take_off_ns + raw.sample.stamp_ns - first_ns
            self.serve_until(stamp_ns)
            for number, interval_ns in self._intervals_ns.items():
                if (late_ns := stamp_ns - self._due_ns.setdefault(number, stamp_ns)) >= 0:
                    self._due_ns[number] = stamp_ns + interval_ns - late_ns % interval_ns
                    self._send(self._encoders[number](raw, stamp_ns))

    def serve_until(self, stamp_ns: int) -> None:
        """Send heartbeats and answer what comes, until a time since boot."""
        while True:
            now_ns = self.time_ns
            if now_ns >= self._next_heartbeat_ns:
                self._next_heartbeat_ns = now_ns + HEARTBEAT_NS
                self._send(dialect.MAVLink_heartbeat_message(
                    dialect.MAV_TYPE_QUADROTOR, dialect.MAV_AUTOPILOT_ARDUPILOTMEGA, 0, 0,
                    dialect.MAV_STATE_ACTIVE, 3))
            wait_s = min(max(stamp_ns - now_ns, 0) * 1e-9, LISTEN_S)
            for message in self._receive(wait_s):
                self.received[message.get_type()] += 1
                self._answers.get(message.get_type(), _ignore)(message)
            if now_ns >= stamp_ns:
                return

    def _receive(self, wait_s: float) -> Iterator[dialect.MAVLink_message]:
        """Wait until something has come; yield all of it that is for this system."""
        while select.select([self._connection], [], [], wait_s)[0]:
            wait_s = 0.0
            data = self._connection.receive()
            self._connection.accept_sender()
            for message in (packet.message for packet in self._framer.feed(data)):
                if message and getattr(message, 'target_system', SYSTEM) in (0, SYSTEM):
                    yield message

    def _send(self, message: dialect.MAVLink_message) -> None:
        self.sent[message.get_type()] += 1
        with suppress(OSError):  # nobody there for now: lost, as over the air
            self._connection.send(message.pack(self._sender))
        self._sender.seq = (self._sender.seq + 1) % 256

    def _tell_time(self, request: dialect.MAVLink_timesync_message) -> None:
        if request.tc1 == 0:
            self._send(dialect.MAVLink_timesync_message(self.time_ns, request.ts1))

    def _obey(self, command: dialect.MAVLink_command_long_message) -> None:
        result = dialect.MAV_RESULT_UNSUPPORTED
        if command.command == dialect.MAV_CMD_SET_MESSAGE_INTERVAL:
            result = dialect.MAV_RESULT_DENIED
            if int(command.param1) in self._encoders:
                self._set_interval(int(command.param1), int(command.param2 * 1e3))
                result = dialect.MAV_RESULT_ACCEPTED
        self._send(dialect.MAVLink_command_ack_message(command.command, result))

    def _stream(self, request: dialect.MAVLink_request_data_stream_message) -> None:
        rate_hz = request.req_message_rate if request.start_stop else 0
        for name in STREAMS.get(request.req_stream_id, ()):
            if IDS[name] in self._encoders:
                self._set_interval(IDS[name], int(1e9 / rate_hz) if rate_hz else 0)

    def _set_interval(self, number: int, interval_ns: int) -> None:
        """Send a message so often from now on; not at all where the interval is not positive."""
        self._intervals_ns.pop(number, None)
        self._due_ns.pop(number, None)
        if interval_ns > 0:
            self._intervals_ns[number] = interval_ns


def _ignore(message: dialect.MAVLink_message) -> None:
    """Take no notice."""
