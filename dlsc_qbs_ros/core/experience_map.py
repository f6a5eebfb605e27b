"""The experience map: places met, the motions between them, and its relaxation."""

from __future__ import annotations

from typing import Iterator

import numpy as np

from .geometry import between, compose, wrap_angle
from .relaxation import relaxation
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

    # A link that is this near to the poses, in metres and radians, pulls at nothing.
    AGREEMENT = 1e-6

    def __init__(self):
        self._poses = Rows(np.zeros((0, 3)))
        self._links = Rows(np.zeros((0, 2), np.int64))
        self._motions = Rows(np.zeros((0, 3)))
        self._is_closure = Rows(np.zeros(0, bool))
        # The lowest and highest x and y; None where they are not known any more.
        self._box: tuple[np.ndarray, np.ndarray] | None = None
        self._joined: set[tuple[int, int]] = set()
        # Whether a link may disagree with the poses; and the work on those that did.
        self._is_strained = False
        self._relaxation: Iterator[np.ndarray | None] | None = None

    def __len__(self) -> int:
        return len(self._poses.values)

    poses = property(lambda self: self._poses.values)
    links = property(lambda self: self._links.values)
    motions = property(lambda self: self._motions.values)
    is_closure = property(lambda self: self._is_closure.values)

    @property
    def radius_m(self) -> float:
        """Half the diagonal of the box about all experiences."""
        if not len(self):
            return 0.0
        if self._box is None:
            self._box = self.poses[:, :2].min(axis=0), self.poses[:, :2].max(axis=0)
        low, high = self._box
        return 0.5 * float(np.hypot(*(high - low)))

    def pose(self, experience: int) -> Pose2:
        """Return the pose of one experience."""
        return Pose2(*self.poses[experience].tolist())

    def add_experience(self, pose: Pose2) -> int:
        """Add an experience at a pose and return its index."""
        self._poses.append(pose)
        if self._box is not None:
            low, high = self._box
            self._box = np.minimum(low, pose[:2]), np.maximum(high, pose[:2])
        return len(self) - 1

    def add_link(self, origin: int, target: int, motion: Pose2, is_closure: bool) -> bool:
        """Join two experiences by the motion between them; return False if they are already."""
        if origin == target or (origin, target) in self._joined:
            return False
        self._joined.update(((origin, target), (target, origin)))
        self._links.append((origin, target))
        self._motions.append(motion)
        self._is_closure.append(is_closure)
        error = between(compose(self.pose(origin), motion), self.pose(target))
        self._is_strained |= max(map(abs, error)) > self.AGREEMENT
        return True

    def remove_links(self, is_removed: np.ndarray) -> None:
        """Take out the links so marked, shape (l,), bool; the experiences stay."""
        for origin, target in self.links[is_removed].tolist():
            self._joined -= {(origin, target), (target, origin)}
        self._links, self._motions, self._is_closure = (
            Rows(rows.values[~is_removed])
            for rows in (self._links, self._motions, self._is_closure))
        self._strain()

    def change_motions(self, changed: np.ndarray, motions: np.ndarray) -> None:
        """
        Let some links, given by an index array or mask, tell motions of shape (k, 3).

        A relaxation under way ends as it began, or else one would never end in a large map.
        """
        told = self.motions.copy()
        told[changed] = motions
        self._motions = Rows(told)
        self._is_strained = True

    def move(self, moved: np.ndarray, poses: np.ndarray) -> None:
        """Put some experiences, given by an index array or mask, at poses of shape (m, 3)."""
        self.poses[moved] = poses
        self._box = None
        self._strain()

    def relax(self, n_steps: int) -> None:
        """
        Move the experiences into agreement with their links, as `relaxation` finds it.

        That much work is done at a time: a large map moves some calls later, in one go, as it
        was at the first of them. What was added meanwhile goes along, as its links tell.
        """
        if self._relaxation is None and self._is_strained and len(self.links):
            self._is_strained = False
            self._relaxation = relaxation(self.poses.copy(), self.links, self.motions)
        for _ in range(n_steps if self._relaxation else 0):
            relaxed = next(self._relaxation)
            if relaxed is not None:
                self._relaxation = None
                self._take_over(relaxed)
                break

    def _strain(self) -> None:
        """Begin the relaxation anew: what it set out from is not so any more."""
        self._relaxation, self._is_strained = None, True

    def _take_over(self, relaxed: np.ndarray) -> None:
        """Put the first experiences where they belong, and the others where those lead."""
        n, poses = len(relaxed), self.poses
        poses[:n] = relaxed
        self._box = None
        for link in np.flatnonzero((self.links[:, 1] >= n) & ~self.is_closure).tolist():
            origin, target = self.links[link].tolist()
            poses[target] = compose(self.pose(origin), Pose2(*self.motions[link].tolist()))

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
        self._box = None
