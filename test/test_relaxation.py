"""Corrections by conjugate gradients on lines of all strides are those of the normal equations."""

import numpy as np
import pytest

from dlsc_qbs_ros.core.geometry import compose_rows
from dlsc_qbs_ros.core.relaxation import ARM_M, components, Laplacian, relaxation


def chain(n):
    return np.column_stack([np.arange(n - 1), np.arange(1, n)])


def with_extra(n, n_extra, seed):
    """Return a chain and links at random, each of two nodes that it does not join."""
    pairs = np.random.default_rng(seed).integers(0, n, (n_extra, 2))
    return np.vstack([chain(n), pairs[np.abs(pairs[:, 0] - pairs[:, 1]) > 1]])


def run(steps):
    """Return how many steps were taken and what they led to."""
    n_steps = 0
    while True:
        try:
            next(steps)
        except StopIteration as end:
            return n_steps, end.value
        n_steps += 1


def by_least_squares(links, errors, n):
    """Return the corrections of the first node zero."""
    incidence = np.zeros((len(links), n))
    incidence[np.arange(len(links)), links[:, 1]] += 1.0
    incidence[np.arange(len(links)), links[:, 0]] -= 1.0
    x = np.linalg.lstsq(incidence, errors, rcond=None)[0]
    return x - x[0]


@pytest.mark.parametrize('n, n_extra', [(2, 0), (3, 1), (5, 0), (6, 3), (40, 10), (257, 60)])
@pytest.mark.parametrize('seed', range(3))
def test_the_correction_is_that_of_least_squares(n, n_extra, seed):
    links = with_extra(n, n_extra, seed)
    errors = np.random.default_rng(seed).normal(size=(len(links), 2))
    _, x = run(Laplacian(links, n).solve(errors))
    np.testing.assert_allclose(x - x[0], by_least_squares(links, errors, n), atol=2e-3)


@pytest.mark.parametrize('n', [100, 1000, 10000])
def test_steps_are_few_however_long_the_loop(n):
    """A loop that closes with a gap of 5: each link takes its share, from end to end."""
    links = np.vstack([chain(n), [(n - 1, 0)]])
    errors = np.zeros((n, 1))
    errors[-1] = 5.0
    n_steps, x = run(Laplacian(links, n).solve(errors))
    assert n_steps <= 30
    np.testing.assert_allclose(x[:, 0] - x[0, 0], -5.0 * np.arange(n) / n, atol=5e-3)


def test_parts_of_a_graph_have_their_names_in_common_and_share_none():
    """Two stretches, 0-1-2 and 3-4; a node by itself; and two stretches joined by one link."""
    links = np.array([(0, 1), (1, 2), (3, 4), (6, 7), (8, 9), (9, 6)])
    parts = components(links, 10)
    assert [np.flatnonzero(parts == part).tolist() for part in np.unique(parts)] == [
        [0, 1, 2], [3, 4], [5], [6, 7, 8, 9]]


@pytest.mark.parametrize('seed', range(5))
def test_nodes_are_of_one_part_when_a_path_joins_them(seed):
    links = np.random.default_rng(seed).integers(0, 60, (45, 2))
    reached = np.eye(60, dtype=bool)
    for origin, target in links.tolist():
        reached[origin, target] = reached[target, origin] = True
    for _ in range(60):
        reached = reached @ reached
    parts = components(links, 60)
    np.testing.assert_array_equal(parts[:, None] == parts, reached)


def test_each_part_is_left_where_its_poses_change_least():
    """Any other place or turn of it as a whole is farther from the poses before."""
    rng = np.random.default_rng(0)
    links = np.vstack([with_extra(12, 4, 0), 12 + with_extra(9, 3, 1), [(21, 22)]])
    before = rng.normal(size=(24, 3)) * (3.0, 3.0, 0.4)
    *_, after = relaxation(before, links, rng.normal(size=(len(links), 3)) * (1.0, 1.0, 0.3))
    for part in (slice(0, 12), slice(12, 21), slice(21, 23), slice(23, 24)):
        change = changed(before[part], after[part])
        for moved in ((1e-3, 0.0, 0.0), (0.0, 1e-3, 0.0), (0.0, 0.0, 1e-3)):
            for sign in (-1.0, 1.0):
                other = compose_rows(sign * np.tile(moved, (len(after[part]), 1)), after[part])
                assert changed(before[part], other) > change
    np.testing.assert_allclose(after[23], before[23])


def changed(before, after):
    """Return the squares of the ways of positions, and of points an arm ahead of them."""
    def ahead(poses):
        return ARM_M * np.column_stack([np.cos(poses[:, 2]), np.sin(poses[:, 2])])
    return (np.square(after[:, :2] - before[:, :2]).sum()
            + np.square(ahead(after) - ahead(before)).sum())


def test_poses_are_not_touched_and_come_with_the_last_step():
    poses = np.array([(0.0, 0.0, 0.0), (3.0, 0.0, 0.0)])
    before = poses.copy()
    *steps, relaxed = relaxation(poses, np.array([(0, 1)]), np.array([(1.0, 0.0, 0.0)]))
    assert all(step is None for step in steps)
    np.testing.assert_array_equal(poses, before)
    np.testing.assert_allclose(relaxed, [(1.0, 0.0, 0.0), (2.0, 0.0, 0.0)], atol=1e-3)
