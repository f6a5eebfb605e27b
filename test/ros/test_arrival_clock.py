"""Arrivals are told by the node's clock, also where that is a simulated one, read now and then."""

from types import SimpleNamespace

from dlsc_qbs_ros.nodes.arrival_clock import ArrivalClock
from dlsc_qbs_ros.nodes.polled_subscription import Arrival
import pytest

S = 1_000_000_000


@pytest.fixture
def clocks(monkeypatch):
    """Give an ArrivalClock and a function that has it read (wall time, simulated time)."""
    now = SimpleNamespace(nanoseconds=0)
    ros_clock = SimpleNamespace(ros_time_is_active=True, now=lambda: now)
    clock = ArrivalClock(ros_clock)

    def tick(wall_s, time_s):
        monkeypatch.setattr('time.time_ns', lambda: wall_s * S)
        now.nanoseconds = time_s * S
        clock.tick()
    return clock, tick, ros_clock


def arrival(wall_s):
    return Arrival('/name', b'', {'received_timestamp': round(wall_s * S)})


@pytest.mark.parametrize('wall_s, time_s', [
    (100, 10), (101, 20), (102, 30), (100.5, 15), (99, 10), (103, 30)])
def test_a_simulated_clock_is_interpolated_between_two_readings(clocks, wall_s, time_s):
    clock, tick, _ = clocks
    tick(100, 10)
    tick(102, 30)
    assert clock.time_ns(arrival(wall_s)) == time_s * S


@pytest.mark.parametrize('first, second', [
    ((100, 0), (102, 30)),  # it has just begun
    ((100, 40), (102, 30)),  # it was set back
    ((102, 10), (102, 30))])
def test_of_a_clock_that_does_not_run_evenly_the_newest_reading_holds(clocks, first, second):
    clock, tick, _ = clocks
    tick(*first)
    tick(*second)
    assert clock.time_ns(arrival(101)) == 30 * S


def test_without_a_simulated_clock_the_middlewares_stamp_holds(clocks):
    clock, tick, ros_clock = clocks
    ros_clock.ros_time_is_active = False
    tick(100, 10)
    tick(102, 30)
    assert clock.time_ns(arrival(101)) == 101 * S
