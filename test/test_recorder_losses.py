"""Losses are gaps in the numbers with which publishers count, whoever of several published."""

import random

from dlsc_qbs_ros.nodes.recorder_losses import Losses, PublicationGaps
import pytest

A, B = b'a', b'b'


def gaps_in(numbers, publishers=(A,)):
    gaps = PublicationGaps(lambda: publishers)
    for number in numbers:
        gaps.observe(number)
    return gaps.lost


@pytest.mark.parametrize('numbers, lost', [
    ([], ()), ([7], (0,)), ([7, 8, 9], (0,)), ([7, 9], (1,)), ([1, 5, 6, 10], (6,)),
    ([None, None], ()), ([1, None, 5], (3,))])
def test_what_is_missing_between_two_numbers_is_lost(numbers, lost):
    assert gaps_in(numbers) == lost


@pytest.mark.parametrize('numbers, lost', [
    ([10, 50, 11, 51], (0, 0)),
    ([10, 50, 13, 53], (2, 2)),
    ([50, 10, 13, 51], (0, 2)),
    ([50, 10, 51, 52, 14], (0, 3)),  # what comes late belongs to the one that lags behind
])
def test_each_of_two_publishers_counts_for_itself(numbers, lost):
    assert gaps_in(numbers, (A, B)) == lost


def test_a_publisher_that_takes_the_place_of_another_begins_anew():
    publishers = [A]
    gaps = PublicationGaps(lambda: publishers)
    for number in (5, 6):
        gaps.observe(number)
    publishers[:] = [B]
    for number in (3, 4, 7):
        gaps.observe(number)
    assert gaps.lost == (0, 2)


def test_a_publisher_that_nobody_saw_begin_anew_lost_nothing():
    assert sum(gaps_in([100, 1, 2, 3])) == 0


def test_what_was_not_listened_to_is_not_lost():
    gaps = PublicationGaps(lambda: (A,))
    gaps.observe(1)
    gaps.restart()
    gaps.observe(100)
    assert sum(gaps.lost) == 0


@pytest.mark.parametrize('seed', range(50))
def test_several_publishers_lose_what_they_lost_once_each_was_heard_and_goes_on(seed):
    rng = random.Random(seed)
    publishers = {bytes([k]): first for k, first in enumerate(rng.sample(range(1, 200, 2), 4))}
    gaps = PublicationGaps(lambda: publishers)
    for first in publishers.values():
        gaps.observe(first)
    lost = 0
    for k in range(400):
        name = rng.choice(list(publishers))
        publishers[name] += 1
        if k < 200 and rng.random() < 0.3:
            lost += 1
        else:
            gaps.observe(publishers[name])
        assert sum(gaps.lost) <= lost
    for name in 100 * list(publishers):
        publishers[name] += 1
        gaps.observe(publishers[name])
    assert sum(gaps.lost) == lost


def test_gaps_and_events_see_the_same_losses_and_a_full_queue_others():
    losses = Losses((3, 1), message_lost=2, overflowed=10, not_written=100)
    assert losses.total == 114
    assert losses._replace(message_lost=5).total == 115
    assert losses.values() == {
        'lost': 114, 'gaps': '3 1', 'message_lost': 2, 'overflowed': 10, 'not_written': 100}
