"""The clock of a replay never waits for less than no time: rclpy would wait for ever."""

from itertools import count

from dlsc_qbs_ros.nodes import flight_clock
from dlsc_qbs_ros.nodes.flight_clock import FlightClock
import pytest
from rosgraph_msgs.msg import Clock

SECOND_NS = 1_000_000_000


@pytest.fixture
def passing(monkeypatch):
    """Let a second pass each time that anybody looks at the clock on the wall."""
    seconds = count()
    monkeypatch.setattr(flight_clock.time, 'monotonic', lambda: float(next(seconds)))


@pytest.mark.parametrize('flight_s', range(1, 8))
def test_every_wait_has_a_positive_length(observer, passing, flight_s):
    waits = []

    def spin(seconds):
        waits.append(seconds)
        return True
    clock = FlightClock(observer.node, 1.0, spin)
    clock.stand_at(0)
    clock.run_until(flight_s * SECOND_NS)
    assert all(seconds > 0.0 for seconds in waits)
    assert clock.flight_s == flight_s


def test_a_stop_ends_the_wait_and_the_clock_tells_where_it_was_sent(observer):
    times = observer.collect(Clock, '/clock')
    clock = FlightClock(observer.node, 1.0, lambda seconds: False)
    clock.stand_at(5 * SECOND_NS)
    clock.run_until(3600 * SECOND_NS)
    observer.spin_until(lambda: len(times) == 2)
    assert [msg.clock.sec for msg in times] == [5, 3600]
