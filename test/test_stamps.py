"""One rule for every stream: rise, or be late, or start again."""

import pytest

from dlsc_qbs_ros.pipeline.stamps import CLOCK_JUMP_NS, StampOrder, Succession

START_NS = 5_000_000_000


@pytest.mark.parametrize('stamp_ns, succession, newest_ns', [
    (START_NS + 1, Succession.AFTER, START_NS + 1),
    (START_NS + 10**15, Succession.AFTER, START_NS + 10**15),
    (START_NS, Succession.LATE, START_NS),
    (START_NS - 1, Succession.LATE, START_NS),
    (START_NS - CLOCK_JUMP_NS, Succession.LATE, START_NS),
    (START_NS - CLOCK_JUMP_NS - 1, Succession.RESTART, START_NS - CLOCK_JUMP_NS - 1),
])
def test_a_stamp_is_judged_by_the_newest_one(stamp_ns, succession, newest_ns):
    order = StampOrder()
    assert order.take(START_NS) is Succession.AFTER
    assert order.take(stamp_ns) is succession
    assert order.newest_ns == newest_ns


def test_any_stamp_may_be_the_first():
    order = StampOrder()
    assert order.newest_ns is None
    assert order.take(-3) is Succession.AFTER


def test_after_a_restart_stamps_rise_from_there():
    order = StampOrder()
    assert [order.take(s * 10**9) for s in (100, 3, 4, 4, 5)] == [
        Succession.AFTER, Succession.RESTART, Succession.AFTER, Succession.LATE, Succession.AFTER]
