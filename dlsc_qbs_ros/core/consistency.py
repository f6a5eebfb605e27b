"""Loop closures against odometry and one another: which contradict, what the others tell."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .geometry import between_rows, wrap_angle

# One in a hundred true closures is as much of a surprise: chi-square of 3 degrees of freedom.
SURPRISE = 11.3
# What each more closure of a run adds. Not 3, as those of one run mostly err alike.
SURPRISE_PER_CLOSURE = 1.0
N_ITERATIONS = 4


class Chain(NamedTuple):
    """
    A path by odometry, from node to node.

    Attributes
    ----------
    poses : ndarray of shape (n + 1, 3)
        Where the nodes are by a first guess, in metres and radians.
    motions : ndarray of shape (n, 3)
        The pose of each next node in the frame of the one before it, by odometry.
    seconds : ndarray of shape (n,)
        How long each motion took.
    variances : ndarray of shape (n, 3)
        Of the motions: along, across and of the heading.
    segments : ndarray of shape (n,), optional
        Which constant errors of the odometry each motion has; by default all have the same.

    """

    poses: np.ndarray
    motions: np.ndarray
    seconds: np.ndarray
    variances: np.ndarray
    segments: np.ndarray | None = None


def contradiction(chain: Chain, ends: np.ndarray, variances: np.ndarray,
                  calibration_variances: np.ndarray, runs: np.ndarray) -> int | None:
    """
    Return the run of closures that best leaves, if it is too much of a surprise to stay.

    Leaving out a wrong run resolves more than leaving out the right ones, which have to be many
    to be as much of a surprise. See `surprises` for the parameters.
    """
    surplus = surprises(chain, ends, variances, calibration_variances, runs) - SURPRISE
    surplus -= SURPRISE_PER_CLOSURE * (np.bincount(runs) - 1)
    return int(np.argmax(surplus)) if surplus.max() > 0.0 else None


def surprises(chain: Chain, ends: np.ndarray, variances: np.ndarray,
              calibration_variances: np.ndarray, runs: np.ndarray) -> np.ndarray:
    """
    Return by how much chi-square falls when a run of closures is left out, for each run.

    The unknowns x are the noise of every motion and the odometry's constant errors of yaw rate
    and of scale in each segment, of variances V. Each closure says "here again", with the
    variances R; all of them together r = H x + noise, of covariance K = H V H^T + R. The
    chi-square of the least squares is r^T K^-1 r, and with l = K^-1 r, leaving out the run g
    takes l_g^T ([K^-1]_gg)^-1 l_g from it. Only the closures' number is cubed, not that of the
    nodes.

    Parameters
    ----------
    chain : Chain
        The first guess must have all turns right by less than half a turn.
    ends : ndarray of shape (c, 2), int64
        The nodes that each closure takes for one, the earlier one first.
    variances : ndarray of shape (3,)
        Of the second node in the frame of the first: along, across and of the heading.
    calibration_variances : ndarray of shape (2,)
        Of the error of the yaw rate, in (rad/s)^2, and of the scale.
    runs : ndarray of shape (c,), int64
        The run of each closure, counted from 0 without a gap.

    Returns
    -------
    ndarray of shape (n_runs,)

    """
    _, multipliers, information = _solution(
        chain, _by_calibration(chain), ends, variances, calibration_variances)
    row_runs = np.repeat(runs, 3)
    return np.array([_fall(multipliers[mine], information[np.ix_(mine, mine)])
                     for mine in (row_runs == run for run in range(runs.max() + 1))])


def calibration(chain: Chain, ends: np.ndarray, variances: np.ndarray,
                calibration_variances: np.ndarray, shares: np.ndarray) -> np.ndarray:
    """
    Return what the closures tell of the odometry's constant errors, by segment.

    The scale that all segments have in common is told by none: a smaller map has smaller
    contradictions, and would always win. Only how they differ counts, about a mean.

    Parameters
    ----------
    chain, ends, variances, calibration_variances
        As in `surprises`.
    shares : ndarray of shape (n_segments,)
        By which each counts in the mean of the scales, of 1 in all.

    Returns
    -------
    ndarray of shape (n_segments, 2)
        Of the yaw rate in rad/s, too much to the left, and of the scale, as a share, too long;
        of the segments that the chain names, in order.

    """
    relative = _relative(shares)
    errors, *_ = _solution(chain, _by_calibration(chain) @ relative, ends, variances,
                           calibration_variances)
    return (relative @ errors).reshape(-1, 2)


def _solution(chain: Chain, by_calibration: np.ndarray, ends: np.ndarray, variances: np.ndarray,
              calibration_variances: np.ndarray
              ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the errors of yaw rate and scale, by segment, l and K^-1; see `surprises`."""
    prior = _prior(chain, by_calibration, calibration_variances)
    poses = chain.poses
    for _ in range(N_ITERATIONS):
        by_motion = _jacobian(poses, ends)
        jacobian = np.hstack([by_motion, by_motion @ by_calibration])
        changes = between_rows(poses[:-1], poses[1:]) - chain.motions
        changes[:, 2] = wrap_angle(changes[:, 2])
        errors = by_motion @ changes.ravel() - between_rows(*poses[ends.T]).ravel()
        spread = jacobian * prior
        covariance = spread @ jacobian.T + np.diag(np.tile(variances, len(ends)))
        information = np.linalg.inv(covariance)
        multipliers = information @ errors
        noise, constant = np.split(spread.T @ multipliers, [changes.size])
        change = noise + by_calibration @ constant
        poses = _path(poses[0], chain.motions + change.reshape(-1, 3))
    return constant, multipliers, information


def deviations(chain: Chain, ends: np.ndarray, variances: np.ndarray,
               calibration_variances: np.ndarray, nodes: np.ndarray) -> np.ndarray:
    """
    Return how well it is known where nodes are among all of these, if the closures are right.

    Of the variances V of the unknowns x, see `surprises`, the closures leave the covariance
    V - V H^T K^-1 H V. They move the nodes by D x, less what moves all of them as one, which is
    the rigid motion that fits their positions best: a map as a whole may lie anywhere.

    Parameters
    ----------
    chain : Chain
        Its poses should agree with the closures.
    ends, variances, calibration_variances
        As in `surprises`.
    nodes : ndarray of shape (m,), int64
        The nodes that are asked for.

    Returns
    -------
    ndarray of shape (m, 2)
        The deviations of the position along either axis, and of the heading.

    """
    by_calibration = _by_calibration(chain)
    prior = _prior(chain, by_calibration, calibration_variances)
    by_closure, by_node = (
        np.hstack([by_motion, by_motion @ by_calibration]) for by_motion in (
            _jacobian(chain.poses, pairs)
            for pairs in (ends, np.column_stack([np.zeros_like(nodes), nodes]))))
    by_node = _less_rigid(by_node, between_rows(chain.poses[[0]], chain.poses[nodes]))
    covariance = (by_closure * prior) @ by_closure.T + np.diag(np.tile(variances, len(ends)))
    known = (by_node * prior) @ by_closure.T
    # Of hours without a closure, rounding may leave no inverse.
    information = np.linalg.pinv(covariance, hermitian=True)
    left = (by_node ** 2) @ prior - np.sum(known @ information * known, axis=1)
    x, y, yaw = np.maximum(left, 0.0).reshape(-1, 3).T
    return np.sqrt(np.column_stack([0.5 * (x + y), yaw]))


def _less_rigid(by_node: np.ndarray, poses: np.ndarray) -> np.ndarray:
    """Return what moves nodes (3 m, k), less the rigid motions that fit their positions best."""
    ones, zeros = np.ones(len(poses)), np.zeros(len(poses))
    rigid = np.stack([np.column_stack([ones, zeros, -poses[:, 1]]),
                      np.column_stack([zeros, ones, poses[:, 0]]),
                      np.column_stack([zeros, zeros, ones])], axis=1).reshape(-1, 3)
    is_position = np.tile([True, True, False], len(poses))
    return by_node - rigid @ (np.linalg.pinv(rigid[is_position]) @ by_node[is_position])


def _fall(multipliers: np.ndarray, information: np.ndarray) -> float:
    return float(multipliers @ np.linalg.solve(information, multipliers))


def _prior(chain: Chain, by_calibration: np.ndarray, calibration_variances: np.ndarray
           ) -> np.ndarray:
    """Return the variances of all unknowns."""
    n_segments = by_calibration.shape[1] // 2
    return np.concatenate([chain.variances.ravel(), np.tile(calibration_variances, n_segments)])


def _relative(shares: np.ndarray) -> np.ndarray:
    """Return the matrix that subtracts from the scale of each segment the mean of all."""
    relative = np.eye(2 * len(shares))
    relative[1::2, 1::2] -= shares
    return relative


def _by_calibration(chain: Chain) -> np.ndarray:
    """Return what a unit of yaw rate error and of scale, by segment, takes from the motions."""
    x, y, _ = chain.motions.T
    half = 0.5 * chain.seconds
    of_all = np.stack([np.column_stack([half * y, -half * x, -chain.seconds]),
                       np.column_stack([-x, -y, np.zeros_like(x)])], axis=2)
    segments = np.zeros_like(x) if chain.segments is None else chain.segments
    is_of = segments[:, None] == np.unique(segments)
    return np.einsum('nij,ns->nisj', of_all, is_of).reshape(3 * len(x), -1)


def _path(start: np.ndarray, motions: np.ndarray) -> np.ndarray:
    """Return the poses (n + 1, 3) that motions (n, 3) lead through."""
    x, y, turns = motions.T
    yaw = start[2] + np.concatenate([[0.0], np.cumsum(turns)])
    c, s = np.cos(yaw[:-1]), np.sin(yaw[:-1])
    return np.column_stack([
        start[0] + np.concatenate([[0.0], np.cumsum(c * x - s * y)]),
        start[1] + np.concatenate([[0.0], np.cumsum(s * x + c * y)]), yaw])


def _jacobian(poses: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """
    Return how each closure's second node, in the frame of its first, goes with the motions.

    Shape (3 c, 3 n): a motion moves what comes after it, and its turn swings that round the node
    it leads to. Motions outside the closure's loop move nothing.
    """
    start, end = poses[ends.T]
    c, s = np.cos(start[:, 2, None]), np.sin(start[:, 2, None])
    turn = poses[None, :-1, 2] - start[:, 2, None]
    lever = end[:, None, :2] - poses[None, 1:, :2]
    steps = np.arange(len(poses) - 1)
    jacobian = np.zeros((len(ends), 3, len(steps), 3))
    jacobian[:, 0, :, 0] = jacobian[:, 1, :, 1] = np.cos(turn)
    jacobian[:, 1, :, 0] = np.sin(turn)
    jacobian[:, 0, :, 1] = -np.sin(turn)
    jacobian[:, 0, :, 2] = s * lever[..., 0] - c * lever[..., 1]
    jacobian[:, 1, :, 2] = c * lever[..., 0] + s * lever[..., 1]
    jacobian[:, 2, :, 2] = 1.0
    is_inside = (steps >= ends[:, :1]) & (steps < ends[:, 1:])
    return (jacobian * is_inside[:, None, :, None]).reshape(3 * len(ends), 3 * len(steps))
