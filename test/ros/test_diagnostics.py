"""Losses are seen as gaps in the numbers that a publisher counts its messages with."""

from dlsc_qbs_ros.ros.diagnostics import SequenceGaps
import pytest


@pytest.mark.parametrize('numbers, lost', [
    ([], 0), ([7], 0), ([7, 8, 9], 0), ([7, 9], 1), ([1, 5, 6, 10], 6),
    ([5, 6, 1, 2], 0),  # the publisher restarted
    ([1, 1], 0), ([None, None], 0), ([1, None, 5], 0)])
def test_what_is_missing_between_two_numbers_is_lost(numbers, lost):
    gaps = SequenceGaps()
    for number in numbers:
        gaps.observe(number)
    assert gaps.lost == lost
