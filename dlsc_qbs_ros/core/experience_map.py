"""The experience map: places met, the motions between them, and its relaxation."""

from __future__ import annotations

import numpy as np

from .geometry import wrap_angle
from .rows import Rows
from .types import Pose2


class ExperienceMap:
    """
    A graph of experiences joined by links.

    Attributes
    ----------
    poses : ndarray of shape (n, 3)
        x, y in metres and facing in radians of every experience, in the map frame.
    links : ndarray of shape (l, 2), int64
        From and to experience of every link.
    motions : ndarray of shape (l, 3)
        The pose of the to experience in the frame of the from experience.
    is_closure : ndarray of shape (l,), bool
        Whether the link led to an experience that was there before.

    """

    def __init__(self):
        self._poses = Rows(np.zeros((0, 3)))
        self._links = Rows(np.zeros((0, 2), np.int64))
        self._motions = Rows(np.zeros((0, 3)))
        self._is_closure = Rows(np.zeros(0, bool))
        self._joined: set[tuple[int, int]] = set()

    def __len__(self) -> int:
        return len(self._poses.values)

    poses = property(lambda self: self._poses.values)
    links = property(lambda self: self._links.values)
    motions = property(lambda self: self._motions.values)
    is_closure = property(lambda self: self._is_closure.values)

    def pose(self, experience: int) -> Pose2:
        """Return the pose of one experience."""
        return Pose2(*self.poses[experience].tolist())

    def add_experience(self, pose: Pose2) -> int:
        """Add an experience at a pose and return its index."""
        self._poses.append(pose)
        return len(self) - 1

    def add_link(self, origin: int, target: int, motion: Pose2, is_closure: bool) -> bool:
        """Join two experiences by the motion between them; return False if they are already."""
        if origin == target or (origin, target) in self._joined:
            return False
        self._joined.update(((origin, target), (target, origin)))
        self._links.append((origin, target))
        self._motions.append(motion)
        self._is_closure.append(is_closure)
        return True

    def remove_links(self, is_removed: np.ndarray) -> None:
        """Take out the links so marked, shape (l,), bool; the experiences stay."""
        for origin, target in self.links[is_removed].tolist():
            self._joined -= {(origin, target), (target, origin)}
        self._links, self._motions, self._is_closure = (
            Rows(rows.values[~is_removed])
            for rows in (self._links, self._motions, self._is_closure))

    def relax(self, n_steps: int) -> None:
        """
        Move the experiences towards agreement with their links.

        RatSLAM's relaxation moves both ends of each link by a share of its error, again and
        again. Its fixed point solves two linear systems with the graph's Laplacian, first for
        the facings, then for the positions given these; conjugate gradients go to the same
        point in about the square root of the number of sweeps. Neither system fixes the mean:
        the map as a whole stays where it is.
        """
        if not len(self.links):
            return
        origin, target = self.links.T
        poses = self.poses
        turn = wrap_angle(poses[target, 2] - poses[origin, 2] - self.motions[:, 2])
        poses[:, 2] = wrap_angle(
            poses[:, 2] - self._solve(turn[:, None], n_steps)[:, 0])
        c, s = np.cos(poses[origin, 2]), np.sin(poses[origin, 2])
        along, across = self.motions[:, 0], self.motions[:, 1]
        predicted = np.column_stack([c * along - s * across, s * along + c * across])
        error = poses[target, :2] - poses[origin, :2] - predicted
        poses[:, :2] -= self._solve(error, n_steps)

    def sweep(self, n_sweeps: int, share: float = 0.5) -> None:
        """
        Relax the map as published: each link moves both its ends by a share of its error.

        All links at once, each end by the mean over its links, where RatSLAM takes one link
        after the other.
        """
        if not len(self.links):
            return
        origin, target = self.links.T
        poses, n = self.poses, len(self)
        degree = np.maximum(np.bincount(self.links.ravel(), minlength=n), 1)
        for _ in range(n_sweeps):
            facing = poses[origin, 2]
            c, s = np.cos(facing), np.sin(facing)
            along, across, turn = self.motions.T
            errors = (poses[origin, 0] + c * along - s * across - poses[target, 0],
                      poses[origin, 1] + s * along + c * across - poses[target, 1],
                      wrap_angle(facing + turn - poses[target, 2]))
            for axis, error in enumerate(errors):
                moved = np.bincount(target, error, n) - np.bincount(origin, error, n)
                poses[:, axis] += share * moved / degree
        poses[:, 2] = wrap_angle(poses[:, 2])

    def _solve(self, link_errors: np.ndarray, n_steps: int, tolerance: float = 1e-4
               ) -> np.ndarray:
        """
        Return the correction of every experience that best explains the links' errors.

        Conjugate gradients, preconditioned by the number of links, on B^T B x = B^T errors, B
        the graph's incidence matrix; all columns at once.
        """
        origin, target = self.links.T
        n = len(self)

        def scatter(per_link: np.ndarray) -> np.ndarray:
            return np.column_stack([
                np.bincount(target, column, n) - np.bincount(origin, column, n)
                for column in per_link.T])

        degree = np.maximum(np.bincount(origin, minlength=n) + np.bincount(target, minlength=n),
                            1)[:, None]
        x = np.zeros((n, link_errors.shape[1]))
        residual = scatter(link_errors)
        conditioned = residual / degree
        direction = conditioned
        energy = np.sum(residual * conditioned, axis=0)
        for _ in range(n_steps):
            if np.abs(residual).max() < tolerance:
                break
            image = scatter(direction[target] - direction[origin])
            curvature = np.sum(direction * image, axis=0)
            step = np.divide(energy, curvature, out=np.zeros_like(energy), where=curvature > 0)
            x += step * direction
            residual = residual - step * image
            conditioned = residual / degree
            previous, energy = energy, np.sum(residual * conditioned, axis=0)
            ratio = np.divide(energy, previous, out=np.zeros_like(energy), where=previous > 0)
            direction = conditioned + ratio * direction
        return x
