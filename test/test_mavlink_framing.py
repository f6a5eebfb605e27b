"""Whatever the line does to the bytes, every good packet is found, and losses are counted."""

from itertools import accumulate
import random

from dlsc_qbs_ros.io.mavlink.framing import Framer, SequenceCounter
from mavlink_peer import attitude, dialect, heartbeat, odometry, Peer
import pytest

GOOD = [Peer().pack(message) for message in (heartbeat(), odometry(1.0, x=2.0), attitude(1.0))]
TYPES = ['HEARTBEAT', 'ODOMETRY', 'ATTITUDE']


def types(framer, data):
    return [packet.message.get_type() if packet.message else None for packet in framer.feed(data)]


def corrupt(packet):
    return packet[:-1] + bytes([packet[-1] ^ 1])


def unknown(message_id=0x123456):
    packet = bytearray(GOOD[0])
    packet[7:10] = message_id.to_bytes(3, 'little')
    return bytes(packet)


@pytest.mark.parametrize('datagrams', [True, False])
def test_packets_that_run_together_are_told_apart(datagrams):
    framer = Framer(datagrams)
    assert types(framer, b''.join(GOOD)) == TYPES
    assert framer.corrupt == 0


@pytest.mark.parametrize('size', [1, 2, 7, 100])
def test_a_stream_may_come_in_pieces_of_any_size(size):
    framer, data = Framer(False), b''.join(GOOD)
    pieces = [data[at:at + size] for at in range(0, len(data), size)]
    found = [kind for piece in pieces for kind in types(framer, piece)]
    assert found == TYPES


def test_old_packets_are_read_beside_new_ones():
    old = Peer(3, 4).pack(attitude(1.0), force_mavlink1=True)
    packet, = Framer(True).feed(old)
    assert (packet.system, packet.component, packet.sequence) == (3, 4, 0)
    assert packet.message.get_type() == 'ATTITUDE' and not packet.is_signed


@pytest.mark.parametrize('datagrams', [True, False])
@pytest.mark.parametrize('bad', [
    pytest.param(b'noise', id='noise'),
    pytest.param(corrupt(GOOD[1]), id='wrong checksum'),
    pytest.param(GOOD[1][:50], id='cut'),
    pytest.param(b'\xfd\xff\x00', id='false start'),
    pytest.param(b'\xfe\x09', id='false start of an old packet'),
    pytest.param(b'\xfd\x09\x02' + bytes(30), id='format of the future')])
def test_good_packets_behind_bad_bytes_are_found_and_the_bad_counted_once(bad, datagrams):
    framer = Framer(datagrams)
    assert types(framer, GOOD[0] + bad + 3 * GOOD[1]) == ['HEARTBEAT'] + 3 * ['ODOMETRY']
    assert framer.corrupt == 1


def test_a_packet_cut_by_the_end_of_its_datagram_does_not_swallow_the_next():
    framer = Framer(True)
    assert types(framer, GOOD[1][:-20]) == []
    assert types(framer, GOOD[1]) == ['ODOMETRY']
    assert framer.corrupt == 1


def test_no_flip_of_a_bit_passes_for_a_packet():
    for bit in range(8 * len(GOOD[2])):
        packet = bytearray(GOOD[2])
        packet[bit // 8] ^= 1 << bit % 8
        assert 'ATTITUDE' not in types(Framer(True), bytes(packet))


def test_an_unknown_packet_is_passed_on_without_a_message_and_hides_no_good_one():
    assert types(Framer(True), unknown() + GOOD[1]) == [None, 'ODOMETRY']
    hiding = bytearray(unknown())
    hiding[1] = len(GOOD[1])
    assert types(Framer(True), bytes(hiding[:10]) + GOOD[1])[-1] == 'ODOMETRY'


def test_random_bytes_are_no_packets_and_leave_none_waiting():
    framer, noise = Framer(False), random.Random(0).randbytes(20_000)
    assert not any(packet.message for packet in framer.feed(noise))
    assert list(framer.feed(bytes(300))) == []
    assert types(framer, GOOD[0]) == ['HEARTBEAT']


def sequence(*numbers, counter=None):
    counter = counter or SequenceCounter()
    packets = list(Framer(True).feed(GOOD[0]))
    for number in numbers:
        counter.observe(packets[0]._replace(sequence=number % 256))
    return counter


def test_numbers_that_rise_and_go_round_lose_nothing():
    assert sequence(*range(250, 600)).lost == 0


def test_what_is_missing_is_lost():
    assert sequence(250, 251, 254, 1, 2).lost == 4


def test_a_swapped_pair_is_a_late_packet_and_no_loss():
    counter = sequence(4, 6, 5, 7)
    assert (counter.lost, counter.reordered) == (0, 1)


@pytest.mark.parametrize('step, lost, reordered', [(128, 127, 0), (129, 0, 1)])
def test_half_the_round_tells_a_loss_from_a_late_packet(step, lost, reordered):
    counter = sequence(10, 10 + step)
    assert (counter.lost, counter.reordered) == (lost, reordered)


def test_repeated_packets_are_no_loss():
    assert sequence(4, 4, 5, 5, 6).lost == 0


def test_shuffled_neighbours_never_count_more_than_what_is_missing():
    rng = random.Random(1)
    numbers = list(accumulate([rng.choice([1, 1, 1, 2]) for _ in range(2000)]))
    missing = numbers[-1] - numbers[0] + 1 - len(numbers)
    for at in range(0, len(numbers) - 1, 5):
        numbers[at:at + 2] = reversed(numbers[at:at + 2])
    counter = sequence(*numbers)
    assert counter.lost == pytest.approx(missing, abs=1)
    assert counter.reordered == pytest.approx(400, abs=1)


def test_an_unknown_packet_has_its_number_too_but_cannot_be_trusted_with_another():
    counter, (packet,) = sequence(4), Framer(True).feed(unknown())
    counter.observe(packet._replace(sequence=5))
    counter.observe(packet._replace(sequence=77))
    sequence(6, counter=counter)
    assert counter.lost == 0


def test_the_dialect_knows_odometry():
    assert dialect.MAVLINK_MSG_ID_ODOMETRY == 331
