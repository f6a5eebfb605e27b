"""Asking an autopilot for odometry, until it comes."""

from __future__ import annotations

from typing import Iterator

from .framing import dialect

PERIOD_S = 0.5
# What is asked for, one stage more each time that nothing has come of the one before: ODOMETRY;
# its parts; and last the streams that old autopilots know instead of single messages.
_INTERVALS = (
    (dialect.MAVLINK_MSG_ID_ODOMETRY,),
    (dialect.MAVLINK_MSG_ID_LOCAL_POSITION_NED, dialect.MAVLINK_MSG_ID_ATTITUDE_QUATERNION))
_STREAMS = (dialect.MAV_DATA_STREAM_POSITION, dialect.MAV_DATA_STREAM_EXTRA1)
# Times that a request is repeated while odometry comes, as before, but nothing answers it.
_MAX_UNANSWERED = 5


class RateRequests:
    """
    Says what to ask for, twice a second, while odometry is missing or requests go unanswered.

    Autopilots forget what they were asked when they reboot, and may not hear it on a bad link.
    """

    def __init__(self, rate_hz: float):
        self._rate_hz = rate_hz
        self._working_stage = 0
        self.renew()

    def renew(self) -> None:
        """Ask again, for all that it took before, and forget the answers."""
        self._stage = self._working_stage - 1
        self._n_asked = 0
        self._is_granted = self._is_refused = False

    def answered(self, message: dialect.MAVLink_command_ack_message) -> None:
        """Take the autopilot's word on a command."""
        if message.command == dialect.MAV_CMD_SET_MESSAGE_INTERVAL:
            is_granted = message.result == dialect.MAV_RESULT_ACCEPTED
            self._is_granted |= is_granted
            self._is_refused |= not is_granted

    def due(self, target: tuple[int, int], is_fresh: bool) -> Iterator[dialect.MAVLink_message]:
        """Yield what to send now to the (system, component), which has been heard of late."""
        if is_fresh:
            self._working_stage = max(self._stage, 0)
        if is_fresh and (self._is_granted or self._n_asked >= _MAX_UNANSWERED):
            return
        if self._n_asked == 0 or self._is_refused or not is_fresh:
            self._stage = min(self._stage + 1, len(_INTERVALS))
        self._is_refused = False
        self._n_asked += 1
        for ids in _INTERVALS[:self._stage + 1]:
            for message_id in ids:
                yield self._interval(target, message_id)
        if self._stage == len(_INTERVALS):
            for stream in _STREAMS:
                yield dialect.MAVLink_request_data_stream_message(
                    *target, stream, round(self._rate_hz), 1)

    def _interval(self, target: tuple[int, int], message_id: int
                  ) -> dialect.MAVLink_command_long_message:
        return dialect.MAVLink_command_long_message(
            *target, dialect.MAV_CMD_SET_MESSAGE_INTERVAL, 0, message_id, 1e6 / self._rate_hz,
            0, 0, 0, 0, 0)
