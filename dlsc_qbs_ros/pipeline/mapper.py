"""RatSLAM's three parts in their order: view cells, pose cells, experience map."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from math import hypot, inf, sqrt

import numpy as np

from .journey import Journey
from .matcher import Matcher
from .packet import Packet
from .visual_gyro import VisualGyro
from .visits import Place
from ..config import Config
from ..core.drift import Drift
from ..core.geometry import between, compose, invert
from ..core.local_view import CentredCells, Cosine, Measure, ViewCells
from ..core.sequence import Scores
from ..core.types import IDENTITY, OdometrySample, Pose2


class Mapper:
    """
    Builds the map from codes and the odometry at their stamps.

    Views are compared at keyframes, that is after some motion; a hovering drone adds nothing.
    A run of views that is similar enough to a run of old view cells, at a place that the
    odometry allows, activates the old cell; its injections move the pose cells' packet; and
    when the packet has arrived there, the experience is linked to the old one. As published,
    each view by itself activates the most similar cell, wherever that is.

    What lies in another piece of the map, from before odometry broke, is found by views alone.

    Attributes
    ----------
    is_mapping : bool
        If not, matches still move the robot, but the map stays as it is.

    """

    # A view without a code, of darkness say, is waited out for so many distances of a keyframe.
    PATIENCE = 2.0
    # Experiences times steps of the relaxation: what bounds the time of an update.
    RELAXED_PER_UPDATE = 30_000
    # Of odometry that was saved: no source counts below 0.
    PAST_SEGMENT = -1

    def __init__(self, config: Config, measure: Measure | None = None):
        self._config = config.ratslam
        self._link_distance = config.pose_cells.link_distance
        self._is_published = config.ratslam.backend == 'published'
        is_centred = measure is None and config.encoder.mode == 'epochs'
        self._make_cells = (
            CentredCells if is_centred else partial(ViewCells, measure or Cosine()))
        self.view_cells: ViewCells = self._make_cells()
        self.packet = Packet(config.pose_cells)
        self.journey = Journey(config)
        self.visits, self.drift = self.journey.visits, self.journey.drift
        self.map = self.visits.map
        self._matcher = Matcher(config, self.journey)
        self.gyro = VisualGyro(config)
        self.is_mapping = True
        self.odometry: OdometrySample | None = None
        self._first_pose: Pose2 | None = None
        self._keyframe: OdometrySample | None = None
        self._active_cell: int | None = None

    def reconfigure(self, config: Config) -> None:
        """Go on with other values of `live` parameters; the map stays."""
        self._config = config.ratslam
        self.journey.reconfigure(config)
        self.gyro.reconfigure(config)
        self._matcher.reconfigure(config)

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
        if not self.is_mapping:
            self.visits.odometry.halt()
        n_cells = len(self.view_cells)
        is_keyframe = self._is_keyframe(odometry, 1.0 if code.any() else self.PATIENCE)
        if is_keyframe:
            self._begin_keyframe(odometry)
            self._view_event(code)
        self.packet.step(motion)
        if is_keyframe and self._active_cell is not None:
            self._act(odometry)
        return len(self.view_cells) > n_cells

    def carry(self, odometry: OdometrySample) -> None:
        """Go along with the odometry without a look; the views before are not continued."""
        self.packet.step(self._advance(odometry))
        self.visits.odometry.halt()
        self._matcher.end_run()

    def put(self, pose: Pose2, position_sigma_m: float, yaw_sigma_rad: float) -> None:
        """Take the robot to be at a pose in the map, known this well, whatever was believed."""
        self._matcher.clear()
        if self.place is None:
            self._first_pose = pose
        else:
            self.journey.break_off()
            offsets = self.map.poses[:, :2] - (pose.x_m, pose.y_m)
            pieces = self.journey.pieces
            nearest = int(np.argmin(np.where(
                pieces.of() == pieces.main, np.hypot(*offsets.T), inf)))
            self.packet.place(nearest)
            self.journey.put(nearest, between(self.map.pose(nearest), pose))
        self.drift.anchor(position_sigma_m, yaw_sigma_rad)

    def state(self) -> dict[str, np.ndarray]:
        """Return what `restore` takes, by the names in `map_state.ARRAYS`."""
        last = self.odometry
        return {
            'odometry_stamp_ns': np.array([last.stamp_ns]),
            'odometry': np.array([*last.pose, last.z_m, last.roll_rad, last.pitch_rad]),
            'gyro': self.gyro.error.state(),
            **self.packet.state(), **self.journey.state(), **self._matcher.state()}

    def restore(self, state: dict[str, np.ndarray]) -> None:
        """Go on, where there was no map yet, from what `state` returned; the codes are to come."""
        *pose, z_m, roll_rad, pitch_rad = state['odometry'].tolist()
        self.odometry = self._keyframe = OdometrySample(
            int(state['odometry_stamp_ns'][0]), Pose2(*pose), z_m, roll_rad, pitch_rad,
            self.PAST_SEGMENT)
        self.gyro.restore(state['gyro'])
        self.journey.believe(self.gyro.yaw_noise())
        self.packet.restore(state)
        self.journey.restore(state)
        self._matcher.restore(state)

    def bridge(self, segment: int) -> None:
        """Take the odometry that was saved for part of a segment of what comes now."""
        self.odometry = self._keyframe = replace(self.odometry, segment=segment)

    def cells_of(self, codes: np.ndarray) -> ViewCells:
        """Return the view cells of codes (n_cells, n_values): they may take the present place."""
        cells = self._make_cells()
        cells.extend(codes)
        return cells

    @property
    def place(self) -> Place | None:
        """Where the robot stands; None before the first update."""
        return self.visits.place()

    def pose(self) -> Pose2:
        """Return map_T_base at the last update."""
        return self.visits.pose()

    @property
    def is_localised(self) -> bool:
        """Whether the robot was, at the last update, in the map rather than in a piece apart."""
        return self.journey.pieces.is_localised

    @property
    def undone(self) -> int:
        """How many runs of matches were taken back."""
        return self.journey.undone

    def map_T_odom(self) -> Pose2:
        """Return the correction of the odometry as the map stands."""
        return compose(self.pose(), invert(self.odometry.pose))

    def sigmas(self, drift: Drift | None = None) -> tuple[float, float]:
        """
        Return the deviations of position in metres and heading in radians of a pose in the map.

        They are those of the drift, the last update's if left out, of the place it set out from
        in the map as a whole, and of one view there: views of one place err alike.
        """
        if not self.is_localised:
            return inf, inf
        drift = drift or self.drift
        place_m, place_rad = self.journey.place_sigmas()
        return (hypot(self._config.match_position_sigma_m, place_m, drift.position_sigma_m(inf)),
                hypot(self._config.match_yaw_sigma_rad, place_rad, drift.yaw_sigma_rad()))

    def _advance(self, odometry: OdometrySample) -> Pose2:
        """Carry the place along with the odometry; return the motion since the last code."""
        motion, seconds = IDENTITY, 0.0
        if self.odometry is not None:
            seconds = (odometry.stamp_ns - self.odometry.stamp_ns) * 1e-9
            if odometry.segment == self.odometry.segment and seconds >= 0.0:
                motion = self.gyro.corrected(
                    between(self.odometry.pose, odometry.pose), seconds)
            else:
                self.journey.break_off()
                self.gyro.restart()
        seconds = max(seconds, 0.0)  # a clock that falls back makes nothing younger
        self.odometry = odometry
        self.journey.believe(self.gyro.yaw_noise())
        self.journey.move(motion, seconds)
        if self._first_pose is not None:
            self._first_pose = compose(self._first_pose, motion)
        return motion

    def _is_keyframe(self, odometry: OdometrySample, patience: float) -> bool:
        """Whether the view counts: after some motion; as published, every view does."""
        last = self._keyframe
        if self._is_published or last is None or last.segment != odometry.segment:
            return True
        motion = between(last.pose, odometry.pose)
        climb = odometry.z_m - last.z_m
        return (sqrt(motion.x_m ** 2 + motion.y_m ** 2 + climb ** 2)
                >= patience * self._config.keyframe_distance_m
                or abs(motion.yaw_rad) >= patience * self._config.keyframe_angle_rad)

    def _begin_keyframe(self, odometry: OdometrySample) -> None:
        """Let the next view continue those before as far as it does."""
        last, self._keyframe = self._keyframe, odometry
        if last is None or last.segment != odometry.segment:
            self._matcher.clear()
        else:
            motion = between(last.pose, odometry.pose)
            self._matcher.go_on((odometry.stamp_ns - last.stamp_ns) * 1e-9,
                                hypot(motion.x_m, motion.y_m))

    def _view_event(self, code: np.ndarray) -> None:
        """Find the view in another piece, match it to an old view cell, or make a new one."""
        scores = self._matcher.score(self.view_cells.likeness(code))
        found = None if scores is None else self._matcher.find(scores)
        if found is not None:
            self._active_cell = int(self._matcher.view_cell.values[found])
            self.packet.place(found)
            return
        matched = None if scores is None else self._match(scores)
        if matched is not None:
            self._activate(matched)
        elif self.is_mapping:
            self._active_cell = self.view_cells.add(code)
            self.packet.add_view_cell()
        else:
            self._active_cell = None

    def _match(self, scores: Scores) -> int | None:
        """Return the view cell that the views match; a jump must not contradict other matches."""
        match = self._matcher.match(scores)
        if match is None or match.is_jump and self._contradicts(match.view_cell):
            return None
        return match.view_cell

    def _contradicts(self, view_cell: int) -> bool:
        """Whether a match contradicts earlier ones."""
        return self.is_mapping and self._judge(self._matcher.nearest_experience(view_cell))

    def _judge(self, experience: int | None = None) -> bool:
        """Whether matches, here with an experience too, contradict; one that looks wrong goes."""
        run = self.journey.contradiction(experience)
        if run:
            self.journey.undo(run)
        return run is not None

    def _activate(self, matched: int) -> None:
        """Inject what an old view cell has power for."""
        self._active_cell = matched
        energy = self.packet.spend(matched)
        if energy > 0.0:
            relative = self._matcher.offset_from(self._matcher.nearest_experience(matched))
            self.packet.inject(matched, relative.yaw_rad, energy)

    def _act(self, odometry: OdometrySample) -> None:
        """Create or meet an experience for the active view cell, then relax the map."""
        old = self._matcher.old_experiences(self._active_cell)
        distance = self.packet.distance(old)
        if len(old) and distance.min() < self._link_distance:
            self._meet(int(old[np.argmin(distance)]))
        elif self.is_mapping:
            self._create(odometry)
        if not self.is_mapping:
            return
        if self._is_published:
            self.map.sweep(self._config.relaxation_steps)
        else:
            self.map.relax(min(self._config.relaxation_steps,
                               max(self.RELAXED_PER_UPDATE // len(self.map), 1)))

    def _create(self, odometry: OdometrySample) -> None:
        start = self._first_pose or odometry.pose
        self.visits.create(start if self.place is None else self.pose())
        self._matcher.add_experience(self._active_cell)
        self.packet.add_experience()

    def _meet(self, experience: int) -> None:
        """Arrive at an old experience."""
        offset = self._matcher.offset_from(experience)
        trust_m, trust_rad = self._matcher.trust(experience)
        sigma_m, sigma_rad = self._matcher.sigmas_at(experience)
        arrive = self.journey.meet if self.is_mapping else self.journey.put
        is_news = arrive(experience, offset)
        self.drift.anchor(sigma_m * sqrt(1.0 - trust_m), sigma_rad * sqrt(1.0 - trust_rad))
        if is_news and not self._judge():
            self.journey.take_stock()
