"""A recorded flight through encoder and ratslam, in stamp order, without ROS."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class RunResult:
    """
    What a flight left behind; n codes were used, m experiences stand at the end.

    Attributes
    ----------
    stamps_ns : ndarray of shape (n,), int64
    poses : ndarray of shape (n, 3)
        x, y in metres and yaw in radians at each code's stamp, as the map stood when that code
        was processed.
    final_poses : ndarray of shape (n, 3)
        The same, as the map stands at the end.
    odometry : ndarray of shape (n, 3)
        The odometry pose at each code's stamp.
    experiences : ndarray of shape (m, 3)
    links : ndarray of shape (l, 2), int64
        Indices of the experiences that each link joins.
    closures : ndarray of shape (c, 2), int64
        Indices of the experiences joined by loop closures.
    counts : dict
        view_cells, experiences, closures, learning_frames, epochs, frames (all ints).
    seconds : float
        Wall time of the run.

    """

    stamps_ns: np.ndarray
    poses: np.ndarray
    final_poses: np.ndarray
    odometry: np.ndarray
    experiences: np.ndarray
    links: np.ndarray
    closures: np.ndarray
    counts: dict[str, int]
    seconds: float
