"""RatSLAM's three parts in their order: view cells, pose cells, experience map."""

from __future__ import annotations

from math import hypot, sqrt

import numpy as np

from .journey import Journey, Place
from ..config import Config
from ..core.geometry import between, compose, invert, wrap_angle
from ..core.local_view import CentredCells, Cosine, Measure, SequenceScore, ViewCells
from ..core.pose_cells import PoseCells
from ..core.rows import Rows
from ..core.types import IDENTITY, OdometrySample, Pose2


class Mapper:
    """
    Builds the map from codes and the odometry at their stamps.

    Views are compared at keyframes, that is after some motion; a hovering drone adds nothing.
    A run of views that is similar enough to a run of old view cells, at a place that the
    odometry allows, activates the old cell; its injections move the pose cells' packet; and
    when the packet has arrived there, the experience is linked to the old one. As published,
    each view by itself activates the most similar cell, wherever that is.
    """

    # A view without a code, of darkness say, is waited out for so many distances of a keyframe.
    PATIENCE = 2.0

    def __init__(self, config: Config, measure: Measure | None = None):
        self._config = config.ratslam
        self._pose_cell_config = config.pose_cells
        self._is_published = config.ratslam.backend == 'published'
        is_centred = measure is None and config.encoder.mode == 'epochs'
        self.view_cells = CentredCells() if is_centred else ViewCells(measure or Cosine())
        self.pose_cells = PoseCells(config.pose_cells)
        self.journey = Journey(config)
        self.map, self.drift = self.journey.map, self.journey.drift
        self._sequence = SequenceScore(
            1 if self._is_published else config.ratslam.sequence_length)
        # Per view cell: where the pose cells stood, and how spent it is.
        self._cell_position = Rows(np.zeros((0, 3)))
        self._cell_decay = Rows(np.zeros(0))
        # Per experience: its view cell and pose cell position.
        self._view_cell = Rows(np.zeros(0, np.int64))
        self._position = Rows(np.zeros((0, 3)))
        self.odometry: OdometrySample | None = None
        self._keyframe: OdometrySample | None = None
        self._active_cell: int | None = None

    def update(self, odometry: OdometrySample, code: np.ndarray) -> bool:
        """
        Take in a code and the odometry at its stamp; return whether a view cell was made.

        Parameters
        ----------
        odometry : OdometrySample
            The odometry at the code's stamp.
        code : ndarray of shape (n_values,)
            The code.

        """
        motion = self._advance(odometry)
        n_cells = len(self.view_cells)
        is_keyframe = self._is_keyframe(odometry, 1.0 if code.any() else self.PATIENCE)
        if is_keyframe:
            self._keyframe = odometry
            self._view_event(code)
        self.pose_cells.step(motion)
        np.maximum(self._cell_decay.values - self._pose_cell_config.restore,
                   self._pose_cell_config.active_decay, out=self._cell_decay.values)
        if is_keyframe:
            self._act(odometry)
        return len(self.view_cells) > n_cells

    def replace_codes(self, codes: np.ndarray) -> None:
        """Put the view cells' codes (n_cells, n_values) under another dictionary in force."""
        self.view_cells.replace(codes)

    @property
    def place(self) -> Place | None:
        """Where the robot stands; None before the first update."""
        return self.journey.place()

    def pose(self) -> Pose2:
        """Return map_T_base at the last update."""
        return self.journey.pose()

    @property
    def undone(self) -> int:
        """How many runs of matches were taken back."""
        return self.journey.undone

    def map_T_odom(self) -> Pose2:
        """Return the correction of the odometry as the map stands."""
        return compose(self.pose(), invert(self.odometry.pose))

    def sigmas(self) -> tuple[float, float]:
        """Return the deviations of position in metres and heading in radians."""
        return (self.drift.position_sigma_m(self._map_radius_m()), self.drift.yaw_sigma_rad())

    def _advance(self, odometry: OdometrySample) -> Pose2:
        """Carry the place along with the odometry; return the motion since the last code."""
        motion, seconds = IDENTITY, 0.0
        if self.odometry is not None:
            seconds = (odometry.stamp_ns - self.odometry.stamp_ns) * 1e-9
            if odometry.segment == self.odometry.segment and seconds >= 0.0:
                motion = between(self.odometry.pose, odometry.pose)
            else:
                self.journey.break_off()
        seconds = max(seconds, 0.0)  # a clock that falls back makes nothing younger
        self.odometry = odometry
        self.journey.move(motion, seconds)
        return motion

    def _is_keyframe(self, odometry: OdometrySample, patience: float) -> bool:
        """Whether the view counts: after some motion; as published, every view does."""
        if self._keyframe is None or self._keyframe.segment != odometry.segment:
            self._sequence.clear()
            return True
        if self._is_published:
            return True
        motion = between(self._keyframe.pose, odometry.pose)
        climb = odometry.z_m - self._keyframe.z_m
        return (sqrt(motion.x_m ** 2 + motion.y_m ** 2 + climb ** 2)
                >= patience * self._config.keyframe_distance_m
                or abs(motion.yaw_rad) >= patience * self._config.keyframe_angle_rad)

    def _view_event(self, code: np.ndarray) -> None:
        """Match the code to an old view cell and inject, or make a new one."""
        matched = self._match(self.view_cells.likeness(code))
        if matched is None:
            self._active_cell = self.view_cells.add(code)
            self._cell_position.append(self.pose_cells.position())
            self._cell_decay.append(self._pose_cell_config.active_decay)
            return
        self._active_cell = matched
        decay = self._cell_decay.values[matched]
        energy = self._pose_cell_config.injection * (30.0 - np.exp(1.2 * decay)) / 30.0
        self._cell_decay.values[matched] += self._pose_cell_config.active_decay
        if energy > 0.0:
            relative = self._offset_from(self._nearest_experience(matched))
            self.pose_cells.inject(self.pose_cells.turned(
                self._cell_position.values[matched], relative.yaw_rad), energy)

    def _match(self, similarities: np.ndarray) -> int | None:
        """Return the view cell that the last run of views ends in, if odometry allows one."""
        score = self._sequence.update(similarities)
        if score is None or self.place is None:
            return None
        if self._is_published:
            best = int(np.argmax(score))
            return best if score[best] >= self._config.threshold else None
        distance_m = self._gated_distance()
        # Near by chance is not tracking: odometry must be sure enough to tell.
        is_tracking = self.sigmas()[0] <= self._config.tracking_distance_m
        needed = np.where(is_tracking & (distance_m <= self._config.tracking_distance_m),
                          self._config.tracking_threshold, self._config.threshold)
        candidates = np.flatnonzero(np.isfinite(distance_m) & (score >= needed))
        if not len(candidates):
            return None
        best = int(candidates[np.argmax(score[candidates])])
        is_jump = needed[best] == self._config.threshold
        return None if is_jump and self._contradicts(best) else best

    def _contradicts(self, view_cell: int) -> bool:
        """Whether a match contradicts earlier ones; a run of these that looks wrong goes."""
        run = self.journey.contradiction(self._nearest_experience(view_cell))
        if run:
            self.journey.undo(run)
        return run is not None

    def _gated_distance(self) -> np.ndarray:
        """
        Return each view cell's distance from the estimated position, shape (n_cells,).

        Infinite where no old enough experience of the cell lies within the drift of the
        odometry since the last closure.
        """
        here = self.pose()
        offset_m = np.hypot(self.map.poses[:, 0] - here.x_m, self.map.poses[:, 1] - here.y_m)
        turn_rad = np.abs(wrap_angle(self.map.poses[:, 2] - here.yaw_rad))
        sigma_m, sigma_rad = self.sigmas()
        reach = self._config.gate_sigmas
        allowed = (
            (offset_m <= reach * hypot(sigma_m, self._config.match_position_sigma_m))
            & (turn_rad <= reach * hypot(sigma_rad, self._config.match_yaw_sigma_rad))
            & (self.journey.ages() >= (self._config.min_age_s, self._config.min_path_m)
               ).all(axis=1))
        distance_m = np.full(len(self.view_cells), np.inf)
        np.minimum.at(distance_m, self._view_cell.values[allowed], offset_m[allowed])
        return distance_m

    def _act(self, odometry: OdometrySample) -> None:
        """Create or meet an experience for the active view cell, then relax the map."""
        position = self.pose_cells.position()
        old = np.flatnonzero(self._view_cell.values == self._active_cell)
        distance = self.pose_cells.distance(self._position.values[old], position)
        if len(old) and distance.min() < self._pose_cell_config.link_distance:
            self._meet(int(old[np.argmin(distance)]))
        else:
            self._create(odometry, position)
        if self._is_published:
            self.map.sweep(self._config.relaxation_steps)
        else:
            self.map.relax(self._config.relaxation_steps)

    def _create(self, odometry: OdometrySample, position: np.ndarray) -> None:
        self.journey.create(odometry.pose if self.place is None else self.pose())
        self._view_cell.append(self._active_cell)
        self._position.append(position)

    def _meet(self, experience: int) -> None:
        """Arrive at an old experience."""
        offset = self._offset_from(experience)
        trust_m, trust_rad = self._trust()
        is_news = self.journey.meet(experience, offset)
        self.drift.anchor(self._config.match_position_sigma_m * sqrt(1.0 - trust_m),
                          self._config.match_yaw_sigma_rad * sqrt(1.0 - trust_rad))
        if is_news:
            run = self.journey.contradiction()
            if run:
                self.journey.undo(run)

    def _offset_from(self, experience: int) -> Pose2:
        """
        Return where the robot stands in the frame of an experience whose view it sees.

        Odometry says where, the view says "here, heading the same way"; each is weighed by its
        variance. The yaw is RatSLAM's relative heading.
        """
        expected = between(self.map.pose(experience), self.pose())
        trust_m, trust_rad = (0.0, 0.0) if self._is_published else self._trust()
        return Pose2(trust_m * expected.x_m, trust_m * expected.y_m,
                     trust_rad * expected.yaw_rad)

    def _trust(self) -> tuple[float, float]:
        """Return the weights of odometry beside a view, for position and heading."""
        sigma_m, sigma_rad = self.sigmas()
        return (_share(self._config.match_position_sigma_m, sigma_m),
                _share(self._config.match_yaw_sigma_rad, sigma_rad))

    def _nearest_experience(self, view_cell: int) -> int:
        """Return the experience of a view cell that is nearest to the estimated position."""
        experiences = np.flatnonzero(self._view_cell.values == view_cell)
        here = self.pose()
        offsets = self.map.poses[experiences, :2] - (here.x_m, here.y_m)
        return int(experiences[np.argmin(np.hypot(*offsets.T))])

    def _map_radius_m(self) -> float:
        extent = np.ptp(self.map.poses[:, :2], axis=0) if len(self.map) else np.zeros(2)
        return 0.5 * float(np.hypot(*extent))


def _share(match_sigma: float, odometry_sigma: float) -> float:
    """Return the weight of the odometry beside a match."""
    return match_sigma ** 2 / (match_sigma ** 2 + odometry_sigma ** 2)
