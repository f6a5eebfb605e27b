"""Runs of views: how alike they are to rows of view cells, over gaps too."""

import numpy as np
import pytest

from dlsc_qbs_ros.core.sequence import SequenceScore


def naive_score(looks, stations, length, shortest):
    """
    Return the scores of runs of up to so many views and whether they are, by the definition.

    `looks` are the station, the likenesses and the slack of the views, the newest first, as
    many as such a run reaches back over.
    """
    scores, is_whole = [], []
    for here in stations:
        values = []
        for station, likenesses, slack in looks:
            there = here - (looks[0][0] - station)
            near = [value for value, at in zip(likenesses, stations) if abs(at - there) <= slack]
            if near:
                values.append(max(near))
            elif not -slack <= there <= stations[len(likenesses) - 1] + slack:
                values.append(-1.0)  # beyond the first or the last cell; else there is none
        values = values[:length]
        scores.append(np.mean(values) if len(values) >= shortest else -1.0)
        is_whole.append(len(values) == length)
    return scores, is_whole


@pytest.mark.parametrize('length, slack', [(1, 1), (2, 0), (3, 1), (5, 2), (12, 1)])
@pytest.mark.parametrize('growth', [0, 1])
@pytest.mark.parametrize('holes', [False, True])
def test_the_score_is_the_triple_loop(length, slack, growth, holes):
    """Whether cells and views follow each other, or some of either lack."""
    rng = np.random.default_rng(length)
    all_stations = np.cumsum(rng.choice([1, 1, 1, 2, 5], 40) if holes else np.ones(40, int))
    all_stations -= all_stations[0]
    shortest = min(length, 2) if holes else max(length - 2, 1)
    score, looks, station = SequenceScore(length, slack, shortest), [], 0
    for k in range(20):
        stations = all_stations[:7 + growth * k]
        if holes and k in (6, 9, 16):
            score.skip(k, stations)
            station += k
            looks = [(at, row, min(wide + np.ceil(score.UNSURE * k), length))
                     for at, row, wide in looks]
        station += 1
        likenesses = rng.uniform(-1.0, 1.0, len(stations))
        looks = [(station, likenesses, 0), *looks][:score.REACH * length]
        result = score.update(likenesses, stations if holes else None)
        long, is_whole = naive_score(looks, stations, length, shortest)
        short, _ = naive_score(looks[:score.REACH * shortest], stations, shortest, shortest)
        looks[0] = station, likenesses, slack  # the newest view is compared without slack
        if k + 1 < shortest:
            assert result is None
        else:
            np.testing.assert_array_equal(result.last, likenesses)
            np.testing.assert_allclose(result.short, short)
            np.testing.assert_allclose(result.long, long)
            np.testing.assert_array_equal(result.is_whole, is_whole)


def without(stations, first, last):
    """Return stations less a hole."""
    return stations[(stations < first) | (stations > last)]


def test_a_second_pass_is_known_where_the_first_one_lacks_views():
    score, stations = SequenceScore(6, slack=0), without(np.arange(30), 10, 14)
    for k in range(17):
        result = score.update((stations == k).astype(float), stations)
    assert result.long[list(stations).index(16)] == 1.0
    assert result.is_whole[list(stations).index(16)]


def test_a_run_reaches_over_no_hole_that_is_too_wide():
    score, stations = SequenceScore(6, slack=0, shortest=2), without(np.arange(30), 10, 22)
    for k in range(25):
        result = score.update((stations == k).astype(float), stations)
    assert result.long[list(stations).index(24)] == 1.0
    assert not result.is_whole[list(stations).index(24)]


@pytest.mark.parametrize('passed', [4, 5, 6, 7])
def test_views_that_lack_are_passed_over_though_nobody_counted_them(passed):
    score, stations = SequenceScore(6, slack=0), np.arange(30)
    for k in [*range(10), *range(10 + passed, 13 + passed)]:
        if k == 10 + passed:
            score.skip(5, stations)
        result = score.update(np.eye(30)[k])
    assert np.argmax(result.long) == 12 + passed and result.long[12 + passed] == 1.0


@pytest.mark.parametrize('n_skipped', [1, 3])
def test_a_row_of_views_goes_on_from_what_was_kept_of_it(n_skipped):
    rng = np.random.default_rng(0)
    stations = np.array([0, 1, 2, 5, 6, 7, 8, 14, 20, 21, 30, 31])
    kept, score = SequenceScore(5, shortest=2), SequenceScore(5, shortest=2)
    for n in range(5, 12):
        score.update(rng.uniform(size=n).astype(np.float32), stations[:n])
        score.skip(n_skipped, stations[:n])
    kept.restore(score.state(11), stations[:11])
    for _ in range(8):
        row = rng.uniform(size=12).astype(np.float32)
        for one, other in zip(kept.update(row, stations), score.update(row, stations)):
            np.testing.assert_array_equal(one, other)


def test_a_second_pass_in_step_scores_1_at_the_end_of_its_run():
    score = SequenceScore(4, slack=0)
    for k in range(10):
        result = score.update(np.eye(10)[k])
    assert result.long[9] == 1.0
    assert (result.long[:9] < 0.3).all()


@pytest.mark.parametrize('cells', [(3, 4, 6), (3, 5, 6)])
def test_slack_forgives_one_cell_out_of_step(cells):
    score = SequenceScore(3, slack=1)
    for cell in cells:
        result = score.update(np.eye(10)[cell])
    assert result.long[6] == 1.0


def test_without_slack_a_run_out_of_step_scores_less():
    score = SequenceScore(3, slack=0)
    for cell in (3, 4, 6):
        result = score.update(np.eye(10)[cell])
    assert result.long[6] < 0.7


def test_a_run_that_would_start_before_the_first_cell_is_marked_down():
    score = SequenceScore(3, slack=0)
    for _ in range(3):
        result = score.update(np.ones(5))
    np.testing.assert_allclose(result.long, [-1 / 3, 1 / 3, 1.0, 1.0, 1.0])


def test_a_view_from_before_the_first_cell_is_like_none():
    score = SequenceScore(3, slack=1)
    for n_cells in range(3):
        result = score.update(np.ones(n_cells))
    np.testing.assert_allclose(result.long, [1 / 3, 1 / 3])


def test_a_view_that_does_not_continue_starts_a_run_of_its_own():
    score = SequenceScore(2)
    score.update(np.ones(4))
    score.clear()
    assert score.update(np.ones(4)) is None
    assert score.update(np.ones(4)) is not None


def test_a_run_that_was_cut_short_has_the_mean_of_what_there_is():
    score, rows = SequenceScore(4, slack=0, shortest=2), np.eye(5) + 0.2
    assert score.update(rows[0]) is None
    result = score.update(rows[1])
    np.testing.assert_allclose(result.long, [-0.4, 1.2, 0.2, 0.2, 0.2])
    assert not result.is_whole.any()
    for row in rows[2:4]:
        result = score.update(row)
    assert result.is_whole.all()
    assert result.long[3] == pytest.approx(1.2)


def test_a_short_run_tells_of_the_last_views_alone():
    score = SequenceScore(4, slack=0, shortest=2)
    for cell in (9, 9, 2, 3):
        result = score.update(np.eye(10)[cell])
    assert result.last[3] == result.short[3] == 1.0 and result.long[3] == 0.5


def test_similarities_are_left_as_they_were():
    score, row = SequenceScore(2), np.linspace(0.0, 1.0, 5)
    row.flags.writeable = False
    score.update(row)
    score.update(row)
