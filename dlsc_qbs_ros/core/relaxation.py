"""The relaxation of the experience map: a few steps lead to where RatSLAM's leads in the end."""

from __future__ import annotations

from typing import Iterator

import numpy as np

from .geometry import wrap_angle

# Below this correction, in metres and radians, a map is relaxed.
TOLERANCE = 1e-4
MAX_STEPS = 300
# A turn of a pose counts like the way of a point so far ahead of it.
ARM_M = 1.0


def relaxation(poses: np.ndarray, links: np.ndarray, motions: np.ndarray
               ) -> Iterator[np.ndarray | None]:
    """
    Find poses that agree best with the links; yield None after each step, at last the poses.

    RatSLAM's relaxation moves both ends of each link by a share of its error, again and again.
    Its fixed point solves two linear systems with the graph's Laplacian, first for the facings,
    then for the positions given these. Neither tells where what is joined lies as a whole: it is
    laid where its poses change least.

    Parameters
    ----------
    poses : ndarray of shape (n, 3)
        Of all experiences, in metres and radians; they stay as they are.
    links : ndarray of shape (l, 2), int64
        From and to experience of every link.
    motions : ndarray of shape (l, 3)
        The pose of the to experience in the frame of the from experience.

    """
    graph = Laplacian(links, len(poses))
    origin, target = links.T
    before, poses = poses, poses.copy()
    turn = wrap_angle(poses[target, 2] - poses[origin, 2] - motions[:, 2])
    correction = yield from graph.solve(turn[:, None])
    poses[:, 2] = wrap_angle(poses[:, 2] - correction[:, 0])
    c, s = np.cos(poses[origin, 2]), np.sin(poses[origin, 2])
    along, across = motions[:, 0], motions[:, 1]
    predicted = np.column_stack([c * along - s * across, s * along + c * across])
    error = poses[target, :2] - poses[origin, :2] - predicted
    correction = yield from graph.solve(error)
    poses[:, :2] -= correction
    yield _laid_onto(before, poses, components(links, len(poses)))


class Laplacian:
    """
    The matrix B^T B of a graph, B its incidence matrix: each link pulls its ends together.

    Conjugate gradients alone carry news by one link per step. Most links join an experience to
    the next, so the numbers of the experiences are a line along which corrections are smooth:
    they are sought at once on that line and on ever coarser ones of half as many points, with
    linear interpolation in between. Steps are then a few dozen, however large the map.
    """

    def __init__(self, links: np.ndarray, n_nodes: int):
        self._origin, self._target = links.T
        self._n = n_nodes
        degree = np.maximum(np.bincount(links.ravel(), minlength=n_nodes), 1).astype(float)
        self._diagonals = [degree]
        stride, n = 2, n_nodes
        while n > 4:
            n = n // 2 + 1
            self._diagonals.append(_diagonal(*links.T, stride, n))
            stride *= 2

    def solve(self, link_errors: np.ndarray) -> Iterator[None]:
        """
        Find the correction (n, k) of every node that best explains the links' errors (l, k).

        Yield after each step and return the correction, which a constant over all that are joined
        leaves as good.
        """
        x = np.zeros((self._n, link_errors.shape[1]))
        residual = self._gather(link_errors)
        direction = conditioned = self._precondition(residual)
        energy = np.sum(residual * conditioned, axis=0)
        for _ in range(MAX_STEPS):
            if np.abs(conditioned).max() < TOLERANCE:
                break
            image = self._gather(direction[self._target] - direction[self._origin])
            curvature = np.sum(direction * image, axis=0)
            step = _ratio(energy, curvature)
            x += step * direction
            residual = residual - step * image
            conditioned = self._precondition(residual)
            previous, energy = energy, np.sum(residual * conditioned, axis=0)
            direction = conditioned + _ratio(energy, previous) * direction
            yield
        return x

    def _gather(self, per_link: np.ndarray) -> np.ndarray:
        """Return B^T times values per link."""
        return np.column_stack([
            np.bincount(self._target, column, self._n) - np.bincount(self._origin, column, self._n)
            for column in per_link.T])

    def _precondition(self, residual: np.ndarray) -> np.ndarray:
        """Return the sum of the corrections that each of the lines would make by itself."""
        residuals = [residual]
        for diagonal in self._diagonals[1:]:
            residuals.append(_coarser(residuals[-1], len(diagonal)))
        total = np.zeros_like(residuals[-1])
        for fine, diagonal in zip(residuals[::-1], self._diagonals[::-1]):
            total = _finer(total, len(fine)) if len(fine) != len(total) else total
            total += fine / diagonal[:, None]
        return total


def _laid_onto(before: np.ndarray, poses: np.ndarray, part: np.ndarray) -> np.ndarray:
    """Return poses (n, 3), each part moved as one to where, by least squares, it was before."""
    n = np.maximum(np.bincount(part), 1)

    def mean(values):
        of_parts = (np.bincount(part, values.real) + 1j * np.bincount(part, values.imag)) / n
        return of_parts[part]

    now, then = (rows[:, 0] + 1j * rows[:, 1] for rows in (poses, before))
    now, middle = now - mean(now), mean(then)
    turned = np.conj(now) * (then - middle) + ARM_M ** 2 * np.exp(1j * (before - poses)[:, 2])
    turn = np.angle(mean(turned))
    now = middle + now * np.exp(1j * turn)
    return np.column_stack([now.real, now.imag, wrap_angle(poses[:, 2] + turn)])


def components(links: np.ndarray, n_nodes: int) -> np.ndarray:
    """Return the number of the part (n,), int64, that each node of the graph belongs to."""
    origin, target = links.T
    is_start = np.ones(n_nodes, bool)
    is_start[target[target == origin + 1]] = False
    stretch = np.cumsum(is_start) - 1  # joined one to the next: few, and never torn apart
    ends = np.unique(stretch[links], axis=0)
    part = np.arange(stretch[-1] + 1)
    while True:
        lower = part.copy()
        for column in (0, 1):
            np.minimum.at(lower, part[ends[:, column]], part[ends].min(axis=1))
        if np.array_equal(lower[part], part):
            return part[stretch]
        part = lower[part]


def _diagonal(origin: np.ndarray, target: np.ndarray, stride: int, n: int) -> np.ndarray:
    """Return about how strongly the links hold each point of a line of this stride."""
    diagonal = np.zeros(n + 1)
    span = (origin - target) / stride
    for end in (origin, target):
        point, share = end // stride, end % stride / stride
        for near, weight in ((point, 1.0 - share), (point + 1, share)):
            diagonal += np.bincount(
                near, np.where(np.abs(span) < 1.0, 0.5 * span ** 2, weight ** 2), n + 1)
    return np.maximum(diagonal[:n], 1e-12)


def _coarser(values: np.ndarray, n: int) -> np.ndarray:
    """Return the transpose of `_finer`: (n, k) from (about 2 n, k)."""
    padded = np.zeros((2 * n + 1, values.shape[1]))
    padded[1:1 + len(values)] = values
    return padded[1::2] + 0.5 * (padded[:-1:2] + padded[2::2])


def _finer(values: np.ndarray, n: int) -> np.ndarray:
    """Return values (about n / 2, k) at every second point, interpolated in between: (n, k)."""
    fine = np.empty((2 * len(values) - 1, values.shape[1]))
    fine[::2] = values
    fine[1::2] = 0.5 * (values[:-1] + values[1:])
    return fine[:n]


def _ratio(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.divide(a, b, out=np.zeros_like(a), where=b > 0)
