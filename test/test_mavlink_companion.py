"""What a companion says to an autopilot, whom it believes, and how it bears reboots."""

from dlsc_qbs_ros.config import MavlinkConfig
from dlsc_qbs_ros.io.mavlink.companion import Companion
from dlsc_qbs_ros.io.mavlink.framing import Framer
from mavlink_peer import attitude, dialect, heartbeat, odometry, Peer, position
import pytest

S = 1_000_000_000
NOW_NS = 1_700_000_000 * S
BOOT_NS = NOW_NS - 100 * S
TICK_S = 0.05


class Flight:
    """A companion and an autopilot that booted 100 s before, in a time of their own."""

    def __init__(self, datagrams=True, **config):
        self.time_s = 0.0
        self.clock_step_ns = 0
        self.boot_ns = BOOT_NS
        self.companion = Companion(MavlinkConfig(**config), self.now_ns)
        self.companion.connected(datagrams)
        self.peer = Peer()
        self.heard = []
        self.samples = []
        self._framer = Framer(True)

    def now_ns(self):
        return NOW_NS + int(self.time_s * S) + self.clock_step_ns

    @property
    def boot_s(self):
        return (NOW_NS + int(self.time_s * S) - self.boot_ns) / S

    def receive(self, *messages, peer=None):
        for message in messages:
            data = (peer or self.peer).pack(message)
            self.samples += self.companion.receive(data, self.time_s)

    def listen(self):
        """Return what the companion says now."""
        packets = list(self._framer.feed(b''.join(self.companion.outgoing(self.time_s))))
        self.heard += packets
        return [packet.message for packet in packets]

    def run(self, duration_s, make=lambda flight: (), react=lambda message, flight: ()):
        """Let time pass; each tick the autopilot sends what `make` says and then reacts."""
        said = []
        for _ in range(round(duration_s / TICK_S)):
            self.time_s += TICK_S
            self.receive(*make(self))
            now = self.listen()
            said += now
            for message in now:
                self.receive(*react(message, self))
        return said

    @property
    def counts(self):
        return dict(self.companion.counts())


def kinds(messages):
    return [message.get_type() for message in messages]


def asked_for(messages):
    return [int(message.param1) for message in messages if message.get_type() == 'COMMAND_LONG']


def beats(flight):
    return [heartbeat()]


def flies(flight):
    return [heartbeat(), odometry(flight.boot_s)]


def grants(message, flight):
    if message.get_type() == 'COMMAND_LONG':
        yield dialect.MAVLink_command_ack_message(message.command, 0)


def refuses(message, flight):
    if message.get_type() == 'COMMAND_LONG':
        yield dialect.MAVLink_command_ack_message(message.command, dialect.MAV_RESULT_DENIED)


def test_a_heartbeat_each_second_as_an_onboard_controller_of_the_autopilots_system():
    flight = Flight()
    flight.peer = Peer(7, 1)
    flight.receive(heartbeat())
    said = [message for message in flight.run(5.0) if message.get_type() == 'HEARTBEAT']
    assert len(said) == 5
    assert {(message.type, message.autopilot) for message in said} == {
        (dialect.MAV_TYPE_ONBOARD_CONTROLLER, dialect.MAV_AUTOPILOT_INVALID)}
    assert {(packet.system, packet.component) for packet in flight.heard} == {(7, 191)}
    sequence = [packet.sequence for packet in flight.heard]
    assert sequence == [k % 256 for k in range(len(sequence))]


def test_nothing_is_believed_before_the_heartbeat_of_an_autopilot():
    flight = Flight()
    flight.receive(odometry(100.0))
    for other in (heartbeat(dialect.MAV_AUTOPILOT_INVALID), odometry(100.1)):
        flight.receive(other)
    assert flight.samples == []
    assert flight.companion.condition(0.0) == 'no heartbeat of an autopilot'
    flight.receive(heartbeat(), odometry(100.2))
    assert len(flight.samples) == 1
    assert flight.companion.state()['mavlink_foreign'] == 3


@pytest.mark.parametrize('config, senders, believed', [
    ({}, [(1, 1), (2, 1)], '1/1'), ({'system': 2}, [(1, 1), (2, 1)], '2/1'),
    ({}, [(1, 154), (1, 1)], '1/1'), ({'component': 154}, [(1, 1), (1, 154)], '1/154'),
    ({'component': 0}, [(1, 154), (1, 1)], '1/154')])
def test_one_autopilot_is_believed_and_others_are_foreign(config, senders, believed):
    flight = Flight(**config)
    for sender in senders:
        flight.receive(heartbeat(), odometry(flight.boot_s), peer=Peer(*sender))
    state = flight.companion.state()
    assert state['mavlink_autopilot'] == believed
    assert state['mavlink_foreign'] == 2
    assert len(flight.samples) == 1
    assert flight.counts == {}


def test_who_takes_the_place_of_an_autopilot_that_fell_silent_is_believed_in_its_own_segment():
    flight = Flight()
    flight.run(2.0, flies, grants)
    n_samples, flight.peer = len(flight.samples), Peer(2, 1)
    flight.run(9.9, flies)
    assert len(flight.samples) == n_samples
    assert asked_for(flight.run(0.2, flies, grants)) == [331]
    flight.run(1.0, flies)
    assert flight.companion.state()['mavlink_autopilot'] == '2/1'
    assert flight.companion.condition(flight.time_s) == 'up'
    assert len({raw.sample.segment for raw in flight.samples}) == 2
    assert len(flight.samples) - n_samples >= 20
    assert flight.counts == {'mavlink_autopilots_replaced': 1}


@pytest.mark.parametrize('kind', [
    'GCS', 'ONBOARD_CONTROLLER', 'GIMBAL', 'ANTENNA_TRACKER'])
def test_a_heartbeat_of_what_does_not_fly_is_no_autopilots_whatever_it_says(kind):
    flight = Flight(component=0)
    other = heartbeat(dialect.MAV_AUTOPILOT_GENERIC, getattr(dialect, f'MAV_TYPE_{kind}'))
    flight.receive(other, peer=Peer(255, 190))
    assert flight.companion.state()['mavlink_autopilot'] == 'none'
    flight.receive(heartbeat())
    for _ in range(30):
        flight.run(0.5)
        flight.receive(other, peer=Peer(255, 190))
    assert flight.companion.state()['mavlink_autopilot'] == '1/1'


def test_an_autopilot_that_is_heard_keeps_its_place():
    flight = Flight()
    for _ in range(30):
        flight.run(0.5, beats)
        flight.receive(heartbeat(), peer=Peer(2, 1))
    flight.run(0.5, beats)
    flight.clock_step_ns = 3600 * S  # which is no silence
    flight.receive(heartbeat(), peer=Peer(2, 1))
    assert flight.companion.state()['mavlink_autopilot'] == '1/1'


def test_odometry_is_asked_for_at_the_rate_of_the_configuration_until_it_is_granted():
    flight = Flight(rate_hz=50.0)
    said = flight.run(3.0, flies, grants)
    command, = (message for message in said if message.get_type() == 'COMMAND_LONG')
    assert (command.command, command.param1, command.param2) == (511, 331, 20_000.0)
    assert (command.target_system, command.target_component) == (1, 1)
    assert len(flight.samples) == 60


def test_a_request_that_nobody_answers_is_repeated_while_odometry_comes_but_not_for_ever():
    assert asked_for(Flight().run(10.0, flies)) == 5 * [331]


def test_without_odometry_its_parts_are_asked_for_and_then_the_streams():
    said = Flight(rate_hz=30.0).run(1.6, beats)
    assert asked_for(said) == [331, 331, 32, 31, 331, 32, 31, 331, 32, 31]
    streams = [message for message in said if message.get_type() == 'REQUEST_DATA_STREAM']
    assert [(message.req_stream_id, message.req_message_rate, message.start_stop)
            for message in streams] == 2 * [(6, 30, 1), (10, 30, 1)]


def test_a_refusal_leads_to_the_parts_even_while_positions_come_slowly():
    def crawls(flight):
        return [heartbeat(), attitude(flight.boot_s), position(flight.boot_s)]
    said = Flight().run(2.0, crawls, refuses)
    assert asked_for(said)[:4] == [331, 331, 32, 31]


def test_a_silent_autopilot_is_not_asked_and_asked_again_when_it_is_back():
    flight = Flight()
    flight.run(2.0, flies, grants)
    flight.run(1.6)
    assert asked_for(flight.run(5.0)) == []
    assert asked_for(flight.run(0.5, flies, grants)) == [331]


def test_what_had_to_be_asked_for_before_is_asked_for_at_once_again():
    def flies_in_parts(flight):
        messages = [heartbeat()]
        if flight.is_asked:
            messages += [attitude(flight.boot_s), position(flight.boot_s)]
        return messages

    def grants_parts(message, flight):
        if message.get_type() == 'COMMAND_LONG':
            flight.is_asked |= message.param1 == 32
            yield dialect.MAVLink_command_ack_message(511, 4 if message.param1 == 331 else 0)
    flight = Flight()
    flight.is_asked = False
    flight.run(3.0, flies_in_parts, grants_parts)
    assert len(flight.samples) > 40
    flight.is_asked = False
    flight.companion.connected(True)
    assert asked_for(flight.run(TICK_S, flies_in_parts, grants_parts)) == [331, 32, 31]


def test_after_a_reboot_and_after_a_reconnect_it_is_asked_again_at_once():
    flight = Flight()
    flight.run(2.0, flies, grants)
    flight.boot_ns = flight.now_ns() - S // 10
    assert asked_for(flight.run(3 * TICK_S, flies, grants)) == [331]
    flight.companion.connected(True)
    assert asked_for(flight.run(2 * TICK_S, flies, grants)) == [331]


def test_a_reboot_is_another_segment_and_the_stamps_go_on():
    flight = Flight()
    flight.run(1.0, flies)
    flight.boot_ns = flight.now_ns()
    flight.run(1.0, flies)
    stamps = [raw.sample.stamp_ns for raw in flight.samples]
    assert stamps == sorted(stamps)
    assert len({raw.sample.segment for raw in flight.samples}) == 2
    assert flight.counts['mavlink_reboots'] == 1
    assert len(stamps) == 39  # all but the first after it, which might have been an outlier


def test_a_clock_of_this_computer_that_is_set_begins_another_segment_on_its_time():
    flight = Flight()
    flight.run(1.0, flies)
    flight.clock_step_ns = 3600 * S
    flight.run(1.0, flies)
    assert flight.samples[-1].sample.stamp_ns == pytest.approx(flight.now_ns(), abs=S // 100)
    assert len({raw.sample.segment for raw in flight.samples}) == 2
    assert flight.counts == {'mavlink_time_jumps': 1}


def test_the_time_is_asked_for_ten_times_a_second_and_answers_are_used():
    def tells(message, flight):
        if message.get_type() == 'TIMESYNC':
            yield dialect.MAVLink_timesync_message(round(flight.boot_s * S), message.ts1)
    flight = Flight()
    flight.receive(heartbeat())
    said = flight.run(2.0, flies, tells)
    assert kinds(said).count('TIMESYNC') in (19, 20)
    assert all(message.tc1 == 0 for message in said if message.get_type() == 'TIMESYNC')
    state = flight.companion.state()
    assert state['time_source'] == 'timesync'
    assert state['clock_offset_s'] == pytest.approx(BOOT_NS / S, abs=1e-3)


def test_answers_to_questions_of_others_are_not_used():
    flight = Flight()
    flight.run(1.0, lambda flight: [*flies(flight), dialect.MAVLink_timesync_message(
        round(flight.boot_s * S), flight.now_ns() - 12345)])
    assert flight.companion.state()['time_source'] == 'least delay of arrival'


def test_the_autopilots_question_for_the_time_is_answered():
    flight = Flight()
    flight.receive(heartbeat(), dialect.MAVLink_timesync_message(0, 777))
    answers = [message for message in flight.listen()
               if message.get_type() == 'TIMESYNC' and message.tc1]
    assert [(message.tc1, message.ts1) for message in answers] == [(flight.now_ns(), 777)]


def test_odometry_is_up_missing_or_late_in_words():
    flight = Flight()
    flight.receive(heartbeat())
    assert flight.companion.condition(0.0) == 'the autopilot sends none'
    flight.receive(odometry(flight.boot_s))
    assert flight.companion.condition(0.5) == 'up'
    assert flight.companion.condition(2.0) == 'none for 2.0 s'


def test_losses_and_corrupt_packets_are_counted_and_the_rest_is_used():
    flight = Flight()
    flight.receive(heartbeat())
    for k in range(10):
        packet = flight.peer.pack(odometry(flight.boot_s + 0.02 * k))
        if k == 3:
            continue
        data = packet[:-1] if k == 5 else packet
        flight.samples += flight.companion.receive(data, flight.time_s)
    assert flight.counts == {'mavlink_lost': 2, 'mavlink_corrupt': 1}
    assert len(flight.samples) == 8


def test_corrupt_packets_stay_counted_over_a_reconnect():
    flight = Flight(datagrams=False)
    flight.companion.receive(b'noise', 0.0)
    flight.companion.connected(False)
    assert flight.counts == {'mavlink_corrupt': 1}


def test_with_a_key_only_signed_packets_are_believed_and_what_is_said_is_signed(tmp_path):
    key_file = tmp_path / 'key'
    key_file.write_bytes(bytes(32))
    key_file.chmod(0o600)
    flight = Flight(key_file=str(key_file))
    flight.receive(heartbeat(), odometry(flight.boot_s))
    flight.receive(heartbeat(), peer=Peer(key=bytes([1] * 32)))
    assert flight.samples == []
    flight.peer = Peer(key=bytes(32))
    flight.run(1.0, flies, grants)
    assert len(flight.samples) == 20
    assert flight.counts == {'mavlink_unsigned': 2, 'mavlink_wrong_key': 1}
    assert all(packet.is_signed for packet in flight.heard)
    flight.companion.save()
    again = Flight(key_file=str(key_file))
    again.receive(heartbeat(), peer=Peer(key=bytes(32)))
    assert again.counts == {'mavlink_replayed': 1}
