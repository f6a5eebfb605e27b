"""What bytes to and from an autopilot travel over: UDP, TCP or a serial line."""

from __future__ import annotations

from functools import partial
import re
import socket
from typing import Callable, Protocol

from ...errors import ConfigError

WRITE_TIMEOUT_S = 0.2
CONNECT_TIMEOUT_S = 0.5
_MAX_DATAGRAM = 65535
_NETWORK = re.compile(
    r'(?P<kind>udpin|udpout|tcp):(\[(?P<six>[^\]]+)\]|(?P<host>[^:\[\]]+)):(?P<port>\d{1,5})',
    re.ASCII)
_SERIAL = re.compile(r'(/.+):([1-9]\d{2,7})', re.ASCII)


class Connection(Protocol):
    """An open line; what fails on it raises OSError."""

    datagrams: bool

    def fileno(self) -> int:
        """Return the descriptor to wait on."""

    def receive(self) -> bytes:
        """Return what is there, one datagram at most; raise ConnectionError at the end."""

    def accept_sender(self) -> None:
        """Send to where the bytes received last came from, from now on."""

    def send(self, data: bytes) -> None:
        """Send one packet."""

    def close(self) -> None:
        """Give the line back."""


def connector(address: str) -> Callable[[], Connection]:
    """
    Return what opens udpin:HOST:PORT, udpout:HOST:PORT, tcp:HOST:PORT or /dev/DEVICE:BAUD.

    It raises OSError when that cannot be opened just now.

    Raises
    ------
    ConfigError
        When the address is none of these, or a serial line and pyserial is not installed.

    """
    serial = _SERIAL.fullmatch(address)
    if serial:
        return partial(_Serial, _pyserial(address), serial[1], int(serial[2]))
    network = _NETWORK.fullmatch(address)
    if not network or not 0 < int(network['port']) < 65536:
        raise ConfigError(f'mavlink.connection = {address!r}: expected udpin:HOST:PORT, '
                          'udpout:HOST:PORT, tcp:HOST:PORT, /dev/DEVICE:BAUD or FILE.tlog')
    kind = {'udpin': _UdpServer, 'udpout': _UdpClient, 'tcp': _Tcp}[network['kind']]
    return partial(kind, network['six'] or network['host'], int(network['port']))


def open_connection(address: str) -> Connection:
    """Open a connection now; raise as `connector` and what it returns do."""
    return connector(address)()


def _pyserial(address: str):
    try:
        import serial
    except ImportError as error:
        raise ConfigError(f'mavlink.connection = {address!r}: a serial line needs pyserial, '
                          'which is not installed') from error
    return serial


class _Socket:
    def __init__(self, bound: socket.socket):
        self._socket = bound
        self._socket.settimeout(WRITE_TIMEOUT_S)

    def fileno(self) -> int:
        return self._socket.fileno()

    def accept_sender(self) -> None:
        pass

    def close(self) -> None:
        self._socket.close()


class _Udp(_Socket):
    datagrams = True
    _peer: tuple | None = None

    def receive(self) -> bytes:
        data, self._sender = self._socket.recvfrom(_MAX_DATAGRAM)
        return data

    def send(self, data: bytes) -> None:
        if self._peer is not None:
            self._socket.sendto(data, self._peer)


class _UdpServer(_Udp):
    """Listens; knows where to answer once a sender has been accepted."""

    def __init__(self, host: str, port: int):
        family, address = _resolve(host, port)
        bound = socket.socket(family, socket.SOCK_DGRAM)
        try:
            bound.bind(address)
        except OSError:
            bound.close()
            raise
        super().__init__(bound)

    def accept_sender(self) -> None:
        self._peer = self._sender


class _UdpClient(_Udp):
    """
    Speaks first.

    The socket is not connected, so that a peer which is not up yet is no error but silence.
    """

    def __init__(self, host: str, port: int):
        family, self._peer = _resolve(host, port)
        super().__init__(socket.socket(family, socket.SOCK_DGRAM))


class _Tcp(_Socket):
    datagrams = False

    def __init__(self, host: str, port: int):
        super().__init__(socket.create_connection((host, port), CONNECT_TIMEOUT_S))
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._socket.setblocking(False)

    def receive(self) -> bytes:
        data = self._socket.recv(_MAX_DATAGRAM)
        if not data:
            raise ConnectionError('closed by the other side')
        return data

    def send(self, data: bytes) -> None:
        # Where there is no room, seconds wait for the other side already: nobody waits with them.
        if self._socket.send(data) < len(data):
            self._socket.shutdown(socket.SHUT_RDWR)  # half a packet would spoil the next
            raise BlockingIOError('the other side does not read')


class _Serial:
    datagrams = False

    def __init__(self, pyserial, device: str, baud: int):
        try:
            self._port = pyserial.Serial(
                device, baud, timeout=0, write_timeout=WRITE_TIMEOUT_S, exclusive=True)
        except ValueError as error:  # a rate that this line does not know
            raise OSError(str(error)) from error

    def fileno(self) -> int:
        return self._port.fileno()

    def receive(self) -> bytes:
        return self._port.read(_MAX_DATAGRAM)

    def accept_sender(self) -> None:
        pass

    def send(self, data: bytes) -> None:
        self._port.write(data)

    def close(self) -> None:
        self._port.close()


def _resolve(host: str, port: int) -> tuple[int, tuple]:
    family, _, _, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
    return family, address
