"""Stamps of an autopilot on this computer's clock: with TIMESYNC, without, and over jumps."""

from math import isnan
import random

from dlsc_qbs_ros.io.mavlink.clock import AutopilotClock, N_ANSWERS
import pytest

MS, S = 1_000_000, 1_000_000_000
OFFSET_NS = 1_700_000_000 * S
UNIX_NS = 1_600_000_000 * S


def synchronised(*round_trips_ms, lateness=0.5):
    """Return a clock after answers, each delayed by this share of its round trip on the way."""
    clock = AutopilotClock()
    for k, round_trip_ms in enumerate(round_trips_ms):
        answer(clock, k * 100 * MS, round_trip_ms, lateness)
    return clock


def answer(clock, boot_ns, round_trip_ms, lateness=0.5, offset_ns=OFFSET_NS):
    sent_ns = boot_ns + offset_ns
    trip_ns = int(round_trip_ms * MS)
    clock.answered(sent_ns, boot_ns + int(lateness * trip_ns), sent_ns + trip_ns)


def arrive(clock, boot_ns, delay_ms=2.0, offset_ns=OFFSET_NS):
    return clock.stamp(boot_ns, boot_ns + offset_ns + int(delay_ms * MS))


def test_without_answers_time_is_that_of_arrival_less_the_least_delay():
    clock = AutopilotClock()
    for k, delay_ms in enumerate((9.0, 4.0, 30.0, 2.0, 7.0)):
        stamp_ns = arrive(clock, k * 20 * MS, delay_ms)
    assert stamp_ns == 80 * MS + OFFSET_NS + 2 * MS
    assert clock.state(stamp_ns)['time_source'] == 'least delay of arrival'


def test_one_answer_is_enough_and_counts_at_once():
    clock = synchronised(1.0)
    assert arrive(clock, 1 * S, delay_ms=8.0) == 1 * S + OFFSET_NS
    state = clock.state(1 * S + OFFSET_NS)
    assert state['time_source'] == 'timesync'
    assert state['round_trip_ms'] == pytest.approx(1.0)
    assert state['clock_offset_s'] == pytest.approx(OFFSET_NS / S)


def test_the_answer_of_the_least_round_trip_is_believed():
    one_sided = 1.0  # all of the delay on the way there: wrong by half the round trip
    assert arrive(synchronised(8.0, 0.2, 9.0, lateness=one_sided), S) == pytest.approx(
        S + OFFSET_NS, abs=0.1 * MS)


@pytest.mark.parametrize('round_trip_ms', [10.1, 500.0, -1.0])
def test_a_slow_or_impossible_answer_is_refused_and_counted(round_trip_ms):
    clock = synchronised(round_trip_ms)
    arrive(clock, S)
    state = clock.state(S + OFFSET_NS)
    assert state['time_source'] != 'timesync'
    assert state['timesync_refused'] == 1
    assert isnan(state['round_trip_ms'])


def test_once_settled_the_offset_follows_by_5_ms_a_second_and_no_stamp_falls():
    clock = synchronised(*[1.0] * N_ANSWERS)
    offset_ns = OFFSET_NS
    for k in range(10, 20):  # one second of answers that put the offset 4 ms back
        answer(clock, k * 100 * MS, 0.5, offset_ns=OFFSET_NS - 4 * MS)
        before_ns, offset_ns = offset_ns, arrive(clock, k * 100 * MS) - k * 100 * MS
        assert 0 <= before_ns - offset_ns <= 0.51 * MS
    assert offset_ns == OFFSET_NS - 4 * MS


def test_answers_that_leap_are_taken_at_once_again():
    clock = synchronised(*[1.0] * 2 * N_ANSWERS)
    answer(clock, 2 * S, 1.0, offset_ns=OFFSET_NS + 5 * S)
    assert arrive(clock, 3 * S, offset_ns=OFFSET_NS + 5 * S) == 8 * S + OFFSET_NS


def test_the_least_delay_is_remembered_for_a_window_or_two():
    clock = AutopilotClock()
    delays_ms = {0: 9.0, 10: 2.0, 20: 30.0, 30: 30.0, 41: 30.0, 62: 30.0}
    late_ms = [(arrive(clock, k * S, delay_ms) - k * S - OFFSET_NS) / MS
               for k, delay_ms in delays_ms.items()]
    assert late_ms == [9.0, 2.0, 2.0, 2.0, 30.0, 30.0]


def test_a_drifting_crystal_is_followed_with_and_without_answers():
    drift, rng = 50e-6, random.Random(0)
    for with_answers in (True, False):
        clock = AutopilotClock()
        for k in range(3000):
            boot_ns = k * 100 * MS
            offset_ns = OFFSET_NS + int(drift * boot_ns)
            if with_answers:
                answer(clock, boot_ns, rng.uniform(0.2, 9.0), rng.random(), offset_ns)
            stamp_ns = arrive(clock, boot_ns, rng.expovariate(0.2), offset_ns)
        assert stamp_ns == pytest.approx(boot_ns + offset_ns, abs=3 * MS)
        assert not clock.counts


def test_answers_of_another_clock_than_that_of_the_messages_are_not_used():
    clock = AutopilotClock()
    for k in range(5):
        assert arrive(clock, k * S) == k * S + OFFSET_NS + 2 * MS
        answer(clock, UNIX_NS + k * S, 1.0, offset_ns=OFFSET_NS - UNIX_NS)
    assert clock.state(5 * S + OFFSET_NS)['time_source'] == 'least delay of arrival'
    assert clock.jumps == 0


def test_answers_that_stopped_long_ago_are_not_used():
    clock = synchronised(1.0)
    assert arrive(clock, 60 * S) == 60 * S + OFFSET_NS + 2 * MS


def test_a_fall_of_the_boot_time_is_a_reboot_once_the_next_message_agrees():
    clock = synchronised(1.0)
    arrive(clock, 100 * S)
    rebooted_ns = OFFSET_NS + 99 * S
    assert arrive(clock, 2 * S, offset_ns=rebooted_ns) is None
    assert arrive(clock, 2 * S + 20 * MS, offset_ns=rebooted_ns) == pytest.approx(
        rebooted_ns + 2 * S + 20 * MS, abs=3 * MS)
    assert clock.jumps == clock.counts['mavlink_reboots'] == 1
    assert clock.state(rebooted_ns)['time_source'] == 'least delay of arrival'


def test_a_reboot_soon_after_another_is_one_though_the_time_falls_by_little():
    clock = AutopilotClock()
    arrive(clock, 1500 * MS)
    rebooted_ns = OFFSET_NS + 5 * S
    assert arrive(clock, 600 * MS, offset_ns=rebooted_ns) is None
    assert arrive(clock, 620 * MS, offset_ns=rebooted_ns) == rebooted_ns + 622 * MS
    assert clock.counts['mavlink_reboots'] == 1


def test_a_late_packet_over_the_network_is_no_reboot():
    clock = AutopilotClock()
    arrive(clock, 10 * S)
    for boot_ns in (9500 * MS, 9510 * MS):
        assert clock.stamp(boot_ns, 10_050 * MS + OFFSET_NS) == boot_ns + OFFSET_NS + 2 * MS
    assert clock.jumps == 0


def test_answers_that_agree_with_the_messages_overrule_those_before():
    clock = synchronised(*[1.0] * N_ANSWERS)
    arrive(clock, 1 * S)
    stepped_ns = OFFSET_NS + 5 * S
    answer(clock, 2 * S, 1.0, offset_ns=stepped_ns)
    assert arrive(clock, 3 * S, offset_ns=stepped_ns) == pytest.approx(
        3 * S + stepped_ns, abs=3 * MS)
    assert clock.jumps == clock.counts['mavlink_time_jumps'] == 1


def test_a_time_that_leaps_ahead_is_a_jump():
    clock = AutopilotClock()
    arrive(clock, 1 * S)
    assert arrive(clock, 50 * S, offset_ns=OFFSET_NS - 49 * S) is None
    assert arrive(clock, 50 * S + 20 * MS, offset_ns=OFFSET_NS - 49 * S) is not None
    assert clock.counts['mavlink_time_jumps'] == 1


@pytest.mark.parametrize('wild_ns', [0, 4_000_000 * S, 2**64 * 1000])
def test_a_wild_time_that_stands_alone_is_refused_and_changes_nothing(wild_ns):
    clock = AutopilotClock()
    arrive(clock, 100 * S)
    if wild_ns < UNIX_NS:
        assert clock.stamp(wild_ns, 100 * S + OFFSET_NS + 20 * MS) is None
        assert clock.counts['mavlink_time_outliers'] == 1
    else:  # read as UNIX time, on a timeline of its own: not wild, but now
        assert clock.stamp(wild_ns, 100 * S + OFFSET_NS + 20 * MS) == 100 * S + OFFSET_NS + 20 * MS
    assert arrive(clock, 100 * S + 40 * MS) == 100 * S + OFFSET_NS + 42 * MS
    assert clock.jumps == 0


def test_messages_held_up_on_the_way_keep_their_times():
    clock = AutopilotClock()
    arrive(clock, 10 * S)
    for k in range(100):  # the line stood still for 2 s and gives all at once
        boot_ns = 10 * S + (k + 1) * 20 * MS
        assert clock.stamp(boot_ns, 12_100 * MS + OFFSET_NS) == boot_ns + OFFSET_NS + 2 * MS
    assert clock.jumps == 0


def test_when_everything_stays_late_a_clock_was_set():
    clock = AutopilotClock()
    for k in range(100):
        arrive(clock, k * S)
    for k in range(100, 200):
        stamp_ns = arrive(clock, k * S, offset_ns=OFFSET_NS + 5 * S)
    assert stamp_ns == 199 * S + OFFSET_NS + 5 * S + 2 * MS
    assert clock.jumps == clock.counts['mavlink_time_jumps'] == 1


def test_unix_times_have_an_offset_of_their_own():
    clock = synchronised(1.0)
    arrive(clock, S)
    assert arrive(clock, UNIX_NS, delay_ms=3.0, offset_ns=OFFSET_NS - UNIX_NS) == (
        OFFSET_NS + 3 * MS)
    assert clock.jumps == 0
