"""The link to an autopilot: one thread reads it and opens it again when it fails."""

from __future__ import annotations

from collections import Counter
from contextlib import closing
import logging
from select import poll, POLLIN
from threading import Event, Lock, Thread
import time
from typing import Callable

from .companion import Companion
from .connection import Connection, connector
from .framing import dialect
from ...config import MavlinkConfig
from ...core.types import RawOdometry

# Short enough that odometry is back within a second of the line.
BACK_OFF_S = (0.05, 0.4)
# A stream that stands still so long is opened again; datagrams need not be.
SILENT_S = 3.0
MAX_WAIT_S = 0.1

_logger = logging.getLogger(__name__)


class MavlinkLink:
    """
    Odometry from an autopilot; `deliver` is called on the thread that reads the line.

    Parameters
    ----------
    config : MavlinkConfig
        The section `mavlink`.
    now_ns : callable
        The clock that images are stamped with.

    Raises
    ------
    ConfigError
        When the connection is none, or the key file cannot be used.

    """

    def __init__(self, config: MavlinkConfig, now_ns: Callable[[], int] = time.time_ns):
        self._address = config.connection
        self._connect = connector(config.connection)
        self._companion = Companion(config, now_ns)
        self._counts: Counter[str] = Counter()
        self._connection: Connection | None = None
        self._failure = 'not opened yet'
        # Of the companion and of what is sent: others ask and send from their own threads.
        self._lock = Lock()
        self._stopping = Event()

    def start(self, deliver: Callable[[RawOdometry], None]) -> None:
        """Begin to deliver."""
        self._deliver = deliver
        self._stopping.clear()
        self._thread = Thread(target=self._run, name='mavlink', daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Stop delivering; nothing comes after this returns."""
        self._stopping.set()
        self._thread.join()
        self._companion.save()

    def send(self, message: dialect.MAVLink_message) -> None:
        """Send a message of another thread, or drop it while there is no connection."""
        with self._lock:
            if self._connection is not None:
                try:
                    self._connection.send(self._companion.pack(message))
                except OSError:
                    self._counts['mavlink_unsent'] += 1

    def diagnostics(self) -> Counter[str]:
        """Return what was amiss, by cause."""
        with self._lock:
            return self._counts + self._companion.counts()

    def state(self) -> dict[str, object]:
        """Return words and figures on the link, the autopilot and its clock."""
        with self._lock:
            return {'mavlink_link': self._condition(), **self._companion.state()}

    def why_silent(self) -> str:
        """Return in plain words why no odometry comes."""
        with self._lock:
            return self._condition()

    def _condition(self) -> str:
        if self._connection is None:
            return f'no connection to {self._address}: {self._failure}'
        return self._companion.condition(time.monotonic())

    def _count(self, cause: str) -> int:
        with self._lock:
            self._counts[cause] += 1
            return self._counts[cause]

    def _run(self) -> None:
        """Open the line and serve it, again and again, until stopped."""
        back_off_s = BACK_OFF_S[0]
        while not self._stopping.is_set():
            opened_s = time.monotonic()
            try:
                with closing(self._connect()) as connection:
                    self._serve(connection)
            except OSError as error:
                self._failure = str(error)
            except Exception:  # nobody else would see it, and the next bytes may be better
                self._failure = 'internal error'
                if self._count('mavlink_failures') == 1:
                    _logger.exception('the MAVLink link failed')
            if self._companion.heard_s >= opened_s:
                back_off_s = BACK_OFF_S[0]
            self._stopping.wait(back_off_s)
            back_off_s = min(2 * back_off_s, BACK_OFF_S[1])

    def _serve(self, connection: Connection) -> None:
        poller = poll()
        poller.register(connection, POLLIN)
        opened_s = time.monotonic()
        with self._lock:
            self._companion.connected(connection.datagrams)
            self._connection = connection
        try:
            while not self._stopping.is_set():
                if poller.poll(MAX_WAIT_S * 1000):
                    self._receive(connection)
                now_s = time.monotonic()
                with self._lock:
                    for packet in self._companion.outgoing(now_s):
                        connection.send(packet)
                self._companion.save_in_time(now_s)
                heard_s = max(self._companion.heard_s, opened_s)
                if not connection.datagrams and now_s - heard_s > SILENT_S:
                    raise ConnectionError(f'silent for {SILENT_S:g} s')
        except OSError:
            self._count('mavlink_disconnects')
            raise
        finally:
            with self._lock:
                self._connection = None

    def _receive(self, connection: Connection) -> None:
        data = connection.receive()
        now_s = time.monotonic()
        with self._lock:
            odometry = self._companion.receive(data, now_s)
        if self._companion.heard_s == now_s:
            connection.accept_sender()
        for raw in odometry:
            self._deliver(raw)
