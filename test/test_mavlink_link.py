"""The link over real lines: UDP both ways, TCP, a serial line; lost and found again."""

from contextlib import closing, contextmanager, suppress
from functools import partial
import os
import socket
import sys
from threading import Event, Thread
import time

from dlsc_qbs_ros.config import MavlinkConfig
from dlsc_qbs_ros.errors import ConfigError
from dlsc_qbs_ros.io.mavlink import link as mavlink
from dlsc_qbs_ros.io.mavlink.connection import connector
from dlsc_qbs_ros.io.mavlink.link import MavlinkLink
from mavlink_peer import dialect, free_port, heartbeat, odometry, Peer, TIMEOUT_S, wait_until
import pytest

PERIOD_S = 0.02
BOOT_S = time.monotonic() - 100.0


class Autopilot:
    """Sends a heartbeat and odometry at 50 Hz from a thread of its own and keeps what it hears."""

    def __init__(self, send, receive):
        self.peer, self.heard = Peer(), []
        self._send, self._receive = send, receive
        self._stopping = Event()
        self._parser = dialect.MAVLink(None)
        self._parser.robust_parsing = True
        self._thread = Thread(target=self._fly)
        self._thread.start()

    def _fly(self):
        with suppress(OSError):
            while not self._stopping.wait(PERIOD_S):
                for message in (heartbeat(), odometry(time.monotonic() - BOOT_S)):
                    self._send(self.peer.pack(message))
                with suppress(BlockingIOError, TimeoutError):
                    self.heard += self._parser.parse_buffer(self._receive()) or []

    def stop(self):
        self._stopping.set()
        self._thread.join()

    def heard_types(self):
        return {message.get_type() for message in self.heard}


@contextmanager
def linked(address):
    """Give a link, started, and the list that its odometry is put into."""
    samples = []
    link = MavlinkLink(MavlinkConfig(connection=address))
    link.start(samples.append)
    try:
        yield link, samples
    finally:
        link.stop()


@contextmanager
def flying(send, receive):
    autopilot = Autopilot(send, receive)
    try:
        yield autopilot
    finally:
        autopilot.stop()


@contextmanager
def flying_over_udp(port=None, to=None):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as line:
        line.setblocking(False)
        if port:
            line.bind(('127.0.0.1', port))
        peers = [('127.0.0.1', to)] if to else []

        def receive():
            data, sender = line.recvfrom(2048)
            peers[:] = [sender]
            return data

        def send(packet):
            for address in peers:
                line.sendto(packet, address)
        with flying(send, receive) as autopilot:
            yield autopilot


@contextmanager
def flying_over_tcp(port):
    with socket.create_server(('127.0.0.1', port)) as server:
        server.settimeout(10.0)
        with server.accept()[0] as line:
            line.setblocking(False)
            with flying(line.sendall, lambda: line.recv(2048)) as autopilot:
                yield autopilot


def assert_talks(link, samples, autopilot):
    wait_until(lambda: len(samples) > 10 and {'HEARTBEAT', 'COMMAND_LONG', 'TIMESYNC'}
               <= autopilot.heard_types())
    stamps = [raw.sample.stamp_ns for raw in samples]
    assert stamps == sorted(stamps)
    assert abs(stamps[-1] - time.time_ns()) < 1e9
    state = link.state()
    assert (state['mavlink_link'], state['mavlink_autopilot']) == ('up', '1/1')


def test_an_autopilot_that_speaks_first_is_answered():
    port = free_port()
    with linked(f'udpin:127.0.0.1:{port}') as (link, samples):
        with flying_over_udp(to=port) as autopilot:
            assert_talks(link, samples, autopilot)


def test_an_autopilot_that_waits_is_spoken_to():
    port = free_port()
    with linked(f'udpout:127.0.0.1:{port}') as (link, samples):
        with flying_over_udp(port) as autopilot:
            assert_talks(link, samples, autopilot)


def test_an_autopilot_that_comes_back_at_another_port_is_found_in_the_same_segment():
    port = free_port()
    with linked(f'udpin:127.0.0.1:{port}') as (link, samples):
        with flying_over_udp(to=port):
            wait_until(lambda: samples)
        wait_until(lambda: link.why_silent().startswith('none for'))
        n = len(samples)
        with flying_over_udp(to=port) as autopilot:
            wait_until(lambda: len(samples) > n and 'COMMAND_LONG' in autopilot.heard_types())
        assert samples[0].sample.segment == samples[-1].sample.segment


def test_a_stranger_does_not_turn_the_answers_to_himself():
    port = free_port()
    autopilot, stranger = (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2))
    with autopilot, stranger, linked(f'udpin:127.0.0.1:{port}') as (link, _):
        wait_until(lambda: link.why_silent() == 'no heartbeat of an autopilot')
        for line, peer in ((autopilot, Peer()), (stranger, Peer(9, 1))):
            line.settimeout(10.0)
            line.sendto(peer.pack(heartbeat()), ('127.0.0.1', port))
            wait_until(lambda: link.state()['mavlink_autopilot'] == '1/1')
        wait_until(lambda: link.state()['mavlink_foreign'])
        asked_ns = time.time_ns()
        while True:  # a question for the time that was asked after the stranger came
            message = dialect.MAVLink(None).decode(bytearray(autopilot.recv(2048)))
            if message.get_type() == 'TIMESYNC' and message.ts1 > asked_ns:
                break
        stranger.setblocking(False)
        with pytest.raises(BlockingIOError):
            stranger.recv(2048)


def test_a_tcp_line_that_goes_down_is_opened_again():
    port = free_port()
    with linked(f'tcp:127.0.0.1:{port}') as (link, samples):
        wait_until(lambda: 'refused' in link.why_silent())
        with flying_over_tcp(port) as autopilot:
            assert_talks(link, samples, autopilot)
        wait_until(lambda: link.why_silent().startswith('no connection to tcp:'))
        n = len(samples)
        with flying_over_tcp(port):
            wait_until(lambda: len(samples) > n)
        assert samples[0].sample.segment == samples[-1].sample.segment
        assert link.diagnostics()['mavlink_disconnects'] >= 1


@contextmanager
def flying_over_serial(device):
    ours, theirs = os.openpty()
    os.set_blocking(ours, False)
    device.symlink_to(os.ttyname(theirs))
    try:
        with flying(partial(os.write, ours), partial(os.read, ours, 2048)) as autopilot:
            yield autopilot
    finally:
        device.unlink()
        os.close(theirs)
        os.close(ours)


def test_a_serial_line_that_is_unplugged_is_opened_again(tmp_path):
    pytest.importorskip('serial', reason='pyserial is not installed')
    device = tmp_path / 'serial'
    with linked(f'{device}:57600') as (link, samples):
        wait_until(lambda: 'No such file' in link.why_silent())
        with flying_over_serial(device) as autopilot:
            assert_talks(link, samples, autopilot)
        wait_until(lambda: link.why_silent().startswith(f'no connection to {device}'))
        n = len(samples)
        with flying_over_serial(device) as autopilot:
            wait_until(lambda: len(samples) > n)
        assert link.diagnostics()['mavlink_disconnects'] >= 1


def test_a_serial_line_without_pyserial_is_refused(monkeypatch):
    monkeypatch.setitem(sys.modules, 'serial', None)
    with pytest.raises(ConfigError, match='a serial line needs pyserial'):
        MavlinkLink(MavlinkConfig(connection='/dev/ttyACM0:57600'))


def test_a_stream_that_stands_still_is_opened_again(monkeypatch):
    monkeypatch.setattr(mavlink, 'SILENT_S', 0.2)
    port = free_port()
    with socket.create_server(('127.0.0.1', port)) as server:
        server.settimeout(10.0)
        with linked(f'tcp:127.0.0.1:{port}') as (link, _):
            with server.accept()[0], server.accept()[0]:
                assert link.diagnostics()['mavlink_disconnects'] >= 1


def test_what_is_sent_from_elsewhere_goes_out_while_there_is_a_line():
    port = free_port()
    with linked(f'udpin:127.0.0.1:{port}') as (link, samples):
        link.send(odometry(1.0))  # nobody is there: dropped
        with flying_over_udp(to=port) as autopilot:
            wait_until(lambda: samples)
            link.send(odometry(2.0))
            wait_until(lambda: 'ODOMETRY' in autopilot.heard_types())
        sent = [message for message in autopilot.heard if message.get_type() == 'ODOMETRY']
        assert [message.time_usec for message in sent] == [2_000_000]
        assert sent[0].get_srcComponent() == 191


def test_nothing_is_delivered_once_it_is_stopped_and_it_starts_again():
    port, samples = free_port(), []
    link = MavlinkLink(MavlinkConfig(connection=f'udpin:127.0.0.1:{port}'))
    with flying_over_udp(to=port) as autopilot:
        link.start(samples.append)
        wait_until(lambda: samples)
        link.stop()
        n = len(samples)
        autopilot.heard.clear()
        link.start(samples.append)
        wait_until(lambda: len(samples) > n)
        link.stop()


def test_an_error_in_who_is_delivered_to_is_logged_once_and_survived(caplog):
    port, samples = free_port(), []

    def fails_at_first(raw):
        samples.append(raw)
        if len(samples) < 3:
            raise RuntimeError('not ready')
    link = MavlinkLink(MavlinkConfig(connection=f'udpin:127.0.0.1:{port}'))
    link.start(fails_at_first)
    with flying_over_udp(to=port):
        wait_until(lambda: len(samples) > 5)
    link.stop()
    assert link.diagnostics()['mavlink_failures'] == 2
    assert caplog.text.count('the MAVLink link failed') == 1


@pytest.mark.parametrize('address', [
    '', 'udp:1.2.3.4:14550', 'udpin:14550', 'udpin:0.0.0.0:0', 'udpin:0.0.0.0:65536', 'tcp:host',
    'tcp:host:port', '/dev/ttyACM0', '/dev/ttyACM0:0', 'ttyACM0:57600', 'udpin:::14550'])
def test_an_address_that_is_none_is_refused(address):
    with pytest.raises(ConfigError, match='expected udpin:HOST:PORT, udpout:HOST:PORT'):
        connector(address)


def test_a_tcp_line_that_the_other_side_closes_is_an_error():
    with socket.create_server(('127.0.0.1', 0)) as server:
        with closing(connector(f'tcp:127.0.0.1:{server.getsockname()[1]}')()) as line:
            server.accept()[0].close()
            with pytest.raises(ConnectionError, match='closed by the other side'):
                line.receive()


def test_nobody_waits_for_the_other_side_of_a_tcp_line_to_read():
    with socket.create_server(('127.0.0.1', 0)) as server:
        with closing(connector(f'tcp:127.0.0.1:{server.getsockname()[1]}')()) as line:
            with pytest.raises(BlockingIOError):
                for _ in range(1000):
                    line.send(bytes(100_000))


def test_a_tcp_line_that_took_half_a_packet_takes_no_other():
    with socket.create_server(('127.0.0.1', 0)) as server:
        with closing(connector(f'tcp:127.0.0.1:{server.getsockname()[1]}')()) as line:
            peer, _ = server.accept()
            with peer:
                peer.settimeout(TIMEOUT_S)
                with pytest.raises(BlockingIOError, match='does not read'):
                    for _ in range(1000):
                        line.send(bytes(100_000))
                while peer.recv(1_000_000):  # up to the end of the line
                    pass
                with pytest.raises(ConnectionError):
                    line.receive()


def test_tries_follow_each_other_so_that_odometry_is_back_within_a_second(monkeypatch):
    class Stopping:
        waits_s = []

        def is_set(self):
            return len(self.waits_s) == 10

        def wait(self, wait_s):
            self.waits_s.append(wait_s)
    link = MavlinkLink(MavlinkConfig(connection=f'tcp:127.0.0.1:{free_port()}'))
    monkeypatch.setattr(link, '_stopping', Stopping())
    link._run()
    assert Stopping.waits_s == sorted(Stopping.waits_s)
    assert 0.0 < Stopping.waits_s[0] < Stopping.waits_s[-1] < 0.5


def test_an_address_may_be_of_ipv6():
    port = free_port()
    with closing(connector(f'udpin:[::1]:{port}')()) as ours:
        with closing(connector(f'udpout:[::1]:{port}')()) as theirs:
            theirs.send(b'hello')
            assert ours.receive() == b'hello'


def test_a_line_that_is_taken_is_said_and_tried_again():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(('127.0.0.1', 0))
        port = taken.getsockname()[1]
        with linked(f'udpin:127.0.0.1:{port}') as (link, samples):
            wait_until(lambda: 'in use' in link.why_silent())
            taken.close()
            with flying_over_udp(to=port):
                wait_until(lambda: samples)


def test_a_slow_disk_holds_up_nobody_who_asks_or_sends(tmp_path, monkeypatch):
    key_file = tmp_path / 'key'
    key_file.write_bytes(bytes(32))
    key_file.chmod(0o600)
    link = MavlinkLink(MavlinkConfig(
        connection=f'udpin:127.0.0.1:{free_port()}', key_file=str(key_file)))
    syncing, synced = Event(), Event()
    monkeypatch.setattr(os, 'fsync', lambda _: syncing.set() or synced.wait(10.0))
    link.start(lambda raw: None)
    try:
        assert syncing.wait(5.0)
        other = Thread(target=lambda: link.send(heartbeat()) or link.diagnostics(), daemon=True)
        other.start()
        other.join(5.0)
        assert not other.is_alive()
    finally:
        synced.set()
        link.stop()
