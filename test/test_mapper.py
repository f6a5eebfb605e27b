"""RatSLAM's three parts together, in a made-up world where every place has a code of its own."""

from copy import copy
from functools import lru_cache
from math import hypot, pi

import numpy as np
import pytest

from dlsc_qbs_ros.config import Config
from dlsc_qbs_ros.core.geometry import between, compose
from dlsc_qbs_ros.core.types import IDENTITY, OdometrySample, Pose2
from dlsc_qbs_ros.pipeline.mapper import Mapper

CONFIG = Config().override({
    'ratslam.sequence_length': 6, 'ratslam.threshold': 0.9, 'ratslam.tracking_threshold': 0.8})
PERIOD_NS = 100_000_000
SIDE_M = 8.0
STEP = Pose2(0.1, 0.0, 0.0)
SIDE = [STEP] * round(SIDE_M / STEP.x_m)
CORNER = [Pose2(0.0, 0.0, pi / 20)] * 10
LAP = (SIDE + CORNER) * 4


def codes_along(n, seed=0, smooth=4.0):
    """Return n unit codes, ring-shaped, that change slowly from one to the next."""
    rng = np.random.default_rng(seed)
    spectrum = np.fft.rfft(rng.normal(size=(n, 64)), axis=0)
    spectrum *= np.exp(-0.5 * (2 * pi * smooth * np.fft.rfftfreq(n)[:, None]) ** 2)
    codes = np.fft.irfft(spectrum, n, axis=0)
    return (codes / np.linalg.norm(codes, axis=1, keepdims=True)).astype(np.float32)


def drifting(motions, scale=1.02, yaw_bias_rad=0.0008):
    """Return the motions as odometry measures them."""
    return [Pose2(scale * m.x_m, scale * m.y_m, m.yaw_rad + yaw_bias_rad) for m in motions]


class Robot:
    """Drives motions, feeds a mapper, and keeps the truth beside what the mapper says."""

    def __init__(self, **changes):
        self.mapper = Mapper(CONFIG.override(changes))
        self.truth = self._odometry = IDENTITY
        self._stamp_ns = 1_700_000_000_000_000_000
        self._segment = 0
        self.born = []
        self.poses, self.truths, self.odometries, self.sizes = [], [], [], []

    def see(self, code):
        self.mapper.update(
            OdometrySample(self._stamp_ns, self._odometry, segment=self._segment), code)
        self.born += [self.truth] * (len(self.mapper.map) - len(self.born))
        self.poses.append(self.mapper.pose())
        self.truths.append(self.truth)
        self.odometries.append(self._odometry)
        self.sizes.append(len(self.mapper.map))

    def drive(self, motions, codes, measured=None):
        for motion, seen, code in zip(motions, measured or drifting(motions), codes):
            self._stamp_ns += PERIOD_NS
            self.truth = compose(self.truth, motion)
            self._odometry = compose(self._odometry, seen)
            self.see(code)

    def drive_blind(self, motions):
        for motion, seen in zip(motions, drifting(motions)):
            self._stamp_ns += PERIOD_NS
            self.truth = compose(self.truth, motion)
            self._odometry = compose(self._odometry, seen)

    def reset_odometry(self):
        self._segment += 1
        self._odometry = Pose2(50.0, -20.0, 2.0)

    def errors(self, poses, last):
        """Return the mean distance to the truth over the last steps."""
        difference = np.array(poses[-last:])[:, :2] - np.array(self.truths[-last:])[:, :2]
        return np.mean(np.hypot(*difference.T))

    def closure_gaps(self):
        """Return how far apart the experiences that closures join truly are, in metres."""
        graph = self.mapper.map
        ends = np.array(self.born)[graph.links[graph.is_closure], :2]
        return np.hypot(*(ends[:, 0] - ends[:, 1]).T)


@lru_cache(maxsize=None)
def three_laps():
    robot, codes = Robot(), codes_along(len(LAP))
    for _ in range(3):
        robot.drive(LAP, codes)
    return robot


# Laps

def test_the_loop_is_closed_where_it_truly_closes():
    gaps = three_laps().closure_gaps()
    assert len(gaps) > 0
    assert gaps.max() < 0.8  # a link leads from the last experience, 0.25 m or more behind


def test_the_map_holds_the_robot_to_the_truth_where_odometry_drifts_away():
    robot = three_laps()
    lap = len(LAP)
    assert robot.errors(robot.odometries, lap) > 2.0
    assert robot.errors(robot.poses, lap) < 0.5 * robot.errors(robot.odometries, lap)


def test_experiences_grow_with_the_place_and_not_with_time():
    sizes, lap = three_laps().sizes, len(LAP)
    first, second, third = sizes[lap - 1], sizes[2 * lap - 1], sizes[-1]
    assert first > 100
    assert second - first < 0.2 * first
    assert third - second <= 0.02 * first


def test_a_view_cell_is_stored_for_an_experience_and_no_more():
    mapper = three_laps().mapper
    assert len(mapper.view_cells) <= len(mapper.map)


def test_a_drone_that_hovers_adds_nothing():
    robot, codes = Robot(), codes_along(len(LAP))
    robot.drive(LAP[:100], codes)
    before = (len(robot.mapper.map), len(robot.mapper.view_cells), len(robot.mapper.map.links))
    pose = robot.mapper.pose()
    noise = np.random.default_rng(0).normal(0.0, 0.01, (500, 3)).tolist()
    still = [Pose2(*row) for row in (np.array(noise[1:]) - noise[:-1]).tolist()]
    robot.drive([IDENTITY] * len(still), codes_along(len(still), seed=8), measured=still)
    assert before == (
        len(robot.mapper.map), len(robot.mapper.view_cells), len(robot.mapper.map.links))
    assert robot.mapper.pose()[:2] == pytest.approx(pose[:2], abs=0.1)


def test_ten_minutes_of_hovering_and_swaying_add_a_handful_of_view_cells():
    """By 0.1 m and 0.05 rad, in 3000 views of the places that it sways to."""
    rng = np.random.default_rng(0)
    waves, phase = rng.normal(size=(128, 3)) / (0.5, 0.5, 0.4), rng.uniform(0.0, 6.3, 128)
    sway = np.zeros(3)
    robot = Robot(**{
        'pose_cells.size_xy': 8, 'ratslam.sequence_length': 14, 'ratslam.threshold': 0.8,
        'ratslam.tracking_threshold': 0.6})
    before = IDENTITY
    for _ in range(3000):
        sway = 0.8 * sway + 0.6 * rng.normal(size=3) * (0.1, 0.1, 0.05)
        here = Pose2(*sway.tolist())
        robot.drive([between(before, here)], [np.maximum(np.cos(waves @ sway + phase), 0.0)],
                    measured=[between(before, here)])
        before = here
    assert len(robot.mapper.view_cells) <= 25
    assert len(robot.mapper.map) <= 25


def test_without_matches_the_pose_is_that_of_the_odometry():
    robot = Robot(**{'ratslam.min_age_s': 1e5})
    codes = codes_along(len(LAP))
    for _ in range(2):
        robot.drive(LAP, codes)
    assert not robot.mapper.map.is_closure.any()
    np.testing.assert_allclose(np.array(robot.poses)[:, :2],
                               np.array(robot.odometries)[:, :2], atol=1e-6)
    correction = robot.mapper.map_T_odom()
    assert correction == pytest.approx(IDENTITY, abs=1e-6)


def test_the_first_pose_is_that_of_the_odometry_known_as_well_as_any_place():
    robot = Robot()
    robot.reset_odometry()
    robot.see(codes_along(10)[0])
    assert robot.mapper.pose() == pytest.approx(Pose2(50.0, -20.0, 2.0))
    assert robot.mapper.sigmas() == (0.3, 0.1)


@pytest.mark.parametrize('length', [1, 2])
def test_the_shortest_runs_of_views_work_too(length):
    robot, codes = Robot(**{'ratslam.sequence_length': length}), codes_along(len(LAP))
    for _ in range(2):
        robot.drive(LAP, codes)
    assert robot.closure_gaps().max() < 0.8


# Keyframes

@pytest.mark.parametrize('motion, n_steps, expected', [
    (Pose2(0.1, 0.0, 0.0), 30, 11), (Pose2(0.0, -0.1, 0.0), 30, 11),
    (Pose2(0.0, 0.0, 0.1), 20, 11), (Pose2(0.0, 0.0, -0.05), 20, 6), (IDENTITY, 20, 1)])
def test_a_view_is_stored_after_some_motion(motion, n_steps, expected):
    """At least 0.25 m or 0.2 rad: each third step of 0.1 m, each second of 0.1 rad."""
    robot = Robot(**{'ratslam.keyframe_angle_rad': 0.199})
    codes = codes_along(50, smooth=0.0)
    robot.see(codes[0])
    robot.drive([motion] * n_steps, codes[1:], measured=[motion] * n_steps)
    assert len(robot.mapper.view_cells) == len(robot.mapper.map) == expected


def test_climbing_counts_as_motion():
    mapper, codes = Mapper(CONFIG), codes_along(20, smooth=0.0)
    made = [mapper.update(OdometrySample(k * PERIOD_NS, IDENTITY, z_m=0.1 * k), codes[k])
            for k in range(7)]
    assert made == [True, False, False, True, False, False, True]


# What is no closure

def corridor(**changes):
    """Return a robot that came out of 15 m of corridor into 15 m that look the same."""
    robot, codes = Robot(**changes), codes_along(1000, seed=3)[:600]
    codes[400:550] = codes[:150]
    robot.drive([STEP] * 600, codes)
    return robot


def test_a_look_alike_outside_the_reach_of_the_odometry_is_another_place():
    assert not corridor().mapper.map.is_closure.any()


def test_the_same_look_alike_would_be_taken_if_odometry_allowed_it():
    robot = corridor(**{'ratslam.gate_sigmas': 100.0, 'odometry.translation_drift': 0.5})
    assert robot.closure_gaps().max() > 10.0


def test_a_look_alike_that_the_gate_lets_in_is_refused_when_it_contradicts_odometry():
    robot = corridor(**{'ratslam.gate_sigmas': 100.0})
    assert not robot.mapper.map.is_closure.any()
    assert robot.mapper.undone == 0


@pytest.mark.parametrize('changes', [{'ratslam.min_age_s': 100.0}, {'ratslam.min_path_m': 60.0}])
def test_a_place_must_be_old_enough_to_be_met_again(changes):
    robot, codes = Robot(**changes), codes_along(len(LAP))
    robot.drive(LAP, codes)
    robot.drive(LAP[:150], codes)
    assert not robot.mapper.map.is_closure.any()


def test_a_place_seen_the_other_way_round_is_not_met():
    """Codes of the way out come back in order while the drone looks the other way."""
    robot, codes = Robot(), codes_along(1000, seed=4)
    robot.drive([STEP] * 150, codes[:150])
    robot.drive(CORNER * 2, codes[500:520])
    robot.drive([STEP] * 150, codes[:150])
    assert not robot.mapper.map.is_closure.any()


def test_noise_closes_nothing():
    robot = Robot()
    rng = np.random.default_rng(0)
    for _ in range(2):
        robot.drive(LAP, rng.normal(size=(len(LAP), 64)).astype(np.float32))
    assert not robot.mapper.map.is_closure.any()


def test_a_match_that_does_not_move_the_packet_makes_the_robot_no_surer_of_its_pose():
    """One view over and over: what the first match makes, of that view cell, is not met next."""
    robot, codes = Robot(**{
        'ratslam.sequence_length': 1, 'pose_cells.injection': 0.15}), codes_along(len(LAP))
    codes[180:] = 0.0
    motions = LAP + LAP[:60]
    robot.drive(motions, np.concatenate([codes, np.zeros((60, 64))]),
                measured=drifting(motions, yaw_bias_rad=0.003))
    drift = copy(robot.mapper.drift)
    made = len(robot.mapper.view_cells)
    robot.drive([STEP] * 9, [codes[60]] * 9)
    assert len(robot.mapper.view_cells) == made
    assert robot.mapper.drift.yaw_sigma_rad() > drift.yaw_sigma_rad()


# What was a mistake

@lru_cache(maxsize=None)
def misled(is_misled=True):
    """Return a robot that, half a lap on, was told to be 2.5 m further, and flew two laps more."""
    robot, codes = Robot(**{'ratslam.match_position_sigma_m': 0.15}), codes_along(len(LAP))
    robot.drive(LAP + LAP[:40], np.concatenate([codes, codes_along(200, seed=9)[:40]]))
    if is_misled:
        wrong = int(np.argmin([np.hypot(x - 6.5, y) for x, y, _ in robot.born]))
        robot.mapper._meet(wrong)
        robot.misled_by = [*robot.mapper.map.links[-1].tolist()]
    for _ in range(2):
        robot.drive(LAP[40:] + LAP[:40], np.concatenate([codes[40:], codes[:40]]))
    return robot


def test_a_wrong_closure_that_slipped_in_is_taken_back():
    robot = misled()
    assert robot.mapper.undone == 1
    assert robot.misled_by not in robot.mapper.map.links.tolist()
    assert robot.closure_gaps().max() < 0.8


def test_a_wrong_closure_is_found_by_the_ones_that_follow_it(monkeypatch):
    """Here no match is asked whether it goes with the others before it is believed."""
    monkeypatch.setattr(Mapper, '_contradicts', lambda mapper, view_cell: False)
    robot = misled.__wrapped__()
    assert robot.mapper.undone == 1
    assert robot.closure_gaps().max() < 0.8


def test_after_a_mistake_the_robot_is_where_it_would_be_without():
    mean = [misled(is_misled).errors(misled(is_misled).poses, len(LAP))
            for is_misled in (True, False)]
    assert mean[0] < 1.2 * mean[1] + 0.05


def test_without_a_mistake_nothing_is_taken_back():
    assert misled(False).mapper.undone == three_laps().mapper.undone == 0


# As published

PUBLISHED = {'ratslam.backend': 'published', 'ratslam.threshold': 0.9}


def test_as_published_a_look_alike_is_taken_wherever_it_is_and_stays():
    robot = corridor(**PUBLISHED)
    assert robot.closure_gaps().max() > 10.0
    assert robot.mapper.undone == 0


def test_as_published_every_view_counts_even_of_a_robot_that_hovers():
    robot = Robot(**PUBLISHED)
    codes = codes_along(20, smooth=0.0)
    robot.see(codes[0])
    robot.drive([IDENTITY] * 19, codes[1:], measured=[IDENTITY] * 19)
    assert len(robot.mapper.view_cells) == 20


def test_as_published_one_view_is_enough_and_the_robot_is_put_on_its_experience():
    robot = Robot(**PUBLISHED, **{'ratslam.relaxation_steps': 0, 'pose_cells.injection': 100.0})
    codes = codes_along(40, smooth=0.0)
    robot.see(codes[0])
    robot.drive([STEP] * 30, codes[1:31], measured=[STEP] * 30)
    robot.drive([STEP], codes[5:6], measured=[STEP])
    assert robot.mapper.place.experience == 5
    assert robot.mapper.place.offset == IDENTITY


def test_as_published_the_map_is_relaxed_by_sweeps(monkeypatch):
    robot, codes = Robot(**PUBLISHED), codes_along(20)
    monkeypatch.delattr(type(robot.mapper.map), 'relax')
    robot.drive([STEP] * 20, codes)
    assert len(robot.mapper.map) > 0


# Gaps

def test_a_gap_in_the_views_ends_no_run_of_matches():
    robot, codes = Robot(**{'ratslam.sequence_length': 12}), codes_along(len(LAP))
    robot.drive(LAP + LAP[:40], np.concatenate([codes, codes[:40]]))
    n = len(robot.mapper.view_cells)
    robot.drive_blind([STEP] * 20)
    robot.drive([STEP] * 20, codes[60:])
    assert len(robot.mapper.view_cells) == n


def test_a_mapper_that_starts_again_after_a_gap_ends_no_run_either():
    robot, codes = Robot(**{'ratslam.sequence_length': 12}), codes_along(len(LAP))
    robot.drive(LAP + LAP[:40], np.concatenate([codes, codes[:40]]))
    before, robot.mapper = robot.mapper, Robot(**{'ratslam.sequence_length': 12}).mapper
    robot.mapper.restore(before.state())
    robot.mapper.view_cells = before.view_cells
    robot.mapper.bridge(segment=0)
    n = len(robot.mapper.view_cells)
    robot.drive_blind([STEP] * 20)
    robot.drive([STEP] * 20, codes[60:])
    assert len(robot.mapper.view_cells) == n


def test_after_a_long_gap_a_place_where_it_is_expected_is_known_by_a_shorter_run():
    robot, codes = Robot(**{'ratslam.sequence_length': 10}), codes_along(len(LAP))
    robot.drive(LAP + LAP[:30], np.concatenate([codes, codes[:30]]))
    robot.drive_blind([STEP] * 40)
    n = len(robot.mapper.view_cells)
    robot.drive([STEP] * 7, codes[70:])
    assert len(robot.mapper.view_cells) == n + 3  # so many are too few
    robot.drive([STEP] * 3, codes[77:])
    assert len(robot.mapper.view_cells) == n + 3


def test_what_the_first_lap_did_not_see_is_all_that_the_second_adds():
    robot, codes = Robot(**{'ratslam.sequence_length': 12}), codes_along(len(LAP))
    robot.drive(LAP[:30], codes)
    robot.drive_blind([STEP] * 20)
    robot.drive(LAP[50:], codes[50:])
    robot.drive(LAP[:25], codes)
    n = len(robot.mapper.view_cells)
    robot.drive(LAP[25:80], codes[25:])
    assert 5 <= len(robot.mapper.view_cells) - n <= 8  # in 2 m


# Segments

def test_no_link_spans_a_reset_of_the_odometry():
    robot, codes = Robot(), codes_along(1000, seed=5)
    robot.drive([STEP] * 100, codes[:100])
    n, before = len(robot.mapper.map), robot.mapper.pose()
    robot.reset_odometry()
    robot.see(codes[100])
    assert robot.mapper.pose() == pytest.approx(before)
    robot.drive([STEP] * 100, codes[101:])
    is_new = robot.mapper.map.links >= n
    assert (is_new[:, 0] == is_new[:, 1]).all()
    assert is_new.any() and not is_new.all()


def test_after_a_reset_nobody_knows_where_the_robot_is():
    robot, codes = Robot(), codes_along(1000, seed=5)
    robot.drive([STEP] * 100, codes[:100])
    robot.reset_odometry()
    robot.see(codes[100])
    assert robot.mapper.sigmas() == (np.inf, np.inf)


@pytest.mark.parametrize('length', [1, 6])
def test_a_robot_is_found_again_after_a_reset_by_what_it_sees(length):
    robot, codes = Robot(**{'ratslam.sequence_length': length}), codes_along(len(LAP))
    robot.drive(LAP, codes)
    n = len(robot.mapper.map)
    robot.reset_odometry()
    robot.drive(LAP[:150], codes)
    assert robot.errors(robot.poses, 50) < 1.0
    assert np.isfinite(robot.mapper.map.poses).all()
    links, is_closure = robot.mapper.map.links, robot.mapper.map.is_closure
    crossing = (links < n).any(axis=1) & (links >= n).any(axis=1)
    assert is_closure[crossing].all()


def test_a_robot_must_see_a_whole_run_of_views_after_a_reset():
    robot, codes = Robot(), codes_along(len(LAP))
    robot.drive(LAP, codes)
    robot.drive(LAP[:60], codes)
    robot.reset_odometry()
    robot.drive(LAP[60:70], codes[60:])
    assert robot.mapper.sigmas()[0] == np.inf


def test_after_a_reset_a_place_is_believed_at_the_second_run_of_views_and_joined_by_one_link():
    """It is as sure of the pose there as a match can be; the old part of the map stays."""
    robot, codes = Robot(**{'ratslam.sequence_length': 1}), codes_along(len(LAP))
    robot.drive(LAP[:150], codes)
    n, links, poses = len(robot.mapper.map), len(robot.mapper.map.links), robot.mapper.map.poses
    before = poses.copy()
    robot.reset_odometry()
    robot.see(codes[0])
    assert robot.mapper.sigmas() == (np.inf, np.inf)
    robot.drive([STEP] * 9, codes[1:])
    assert robot.mapper.place.experience == 3
    assert robot.mapper.pose() == pytest.approx(robot.mapper.map.pose(3))
    place_m, place_rad = robot.mapper.journey.place_sigmas()
    assert 0.0 < place_m < 0.3 and 0.0 < place_rad < 0.1
    turn_rad = robot.mapper.visits.turn_at(3)  # little: that of the odometry's error
    assert robot.mapper.sigmas() == pytest.approx(
        (hypot(0.3, 0.3, place_m), hypot(0.1, 0.1, turn_rad, place_rad)))
    assert robot.mapper.map.links[links:].tolist() == [[n, n + 1], [n + 1, n + 2], [n + 2, 3]]
    np.testing.assert_allclose(robot.mapper.map.poses[:n], before, atol=1e-9)


def test_a_place_stays_old_when_the_clock_falls_back():
    robot, codes = Robot(), codes_along(len(LAP))
    robot.drive(LAP, codes)
    robot._stamp_ns -= 10**12
    robot.reset_odometry()
    robot.drive(LAP[:150], codes)
    assert robot.mapper.map.is_closure.any()


# What a match is worth

def test_a_match_that_says_nothing_of_the_pose_leaves_the_map_to_the_odometry():
    robot, codes = Robot(**{
        'ratslam.match_position_sigma_m': 100.0, 'ratslam.match_yaw_sigma_rad': 6.0,
        'odometry.yaw_bias_rad_s': 1e-3, 'odometry.yaw_noise': 1e-3}), codes_along(len(LAP))
    robot.drive(LAP + LAP[:150], np.concatenate([codes, codes]))
    assert robot.mapper.map.is_closure.any()
    np.testing.assert_allclose(np.array(robot.poses)[:, :2],
                               np.array(robot.odometries)[:, :2], atol=0.1)


def test_a_match_that_knows_the_pose_puts_the_robot_where_the_place_is():
    robot, codes = Robot(**{
        'ratslam.match_position_sigma_m': 0.01, 'ratslam.match_yaw_sigma_rad': 0.01,
        'ratslam.gate_sigmas': 100.0}), codes_along(len(LAP))
    robot.drive(LAP + LAP[:150], np.concatenate([codes, codes]))
    assert robot.errors(robot.odometries, 50) > 1.0
    assert robot.errors(robot.poses, 50) < 0.5


def test_the_packet_of_the_pose_cells_goes_with_the_odometry():
    robot = Robot()
    robot.see(codes_along(100)[0])
    start = robot.mapper.packet.cells.position()
    motions = [Pose2(0.5, 0.0, 0.0)] * 10
    robot.drive(motions, codes_along(100), measured=motions)
    moved = robot.mapper.packet.cells.distance(robot.mapper.packet.cells.position(), start)
    assert moved == pytest.approx(5.0, abs=0.5)


# Injection

def test_a_view_met_over_and_over_stops_injecting_until_it_has_rested(monkeypatch):
    """Power (30 - exp(1.2 decay)) / 30: 0.89 fresh, 0.63 after one match, none after two."""
    energies = []
    robot = Robot(**{
        'ratslam.sequence_length': 1, 'ratslam.min_age_s': 0.0, 'ratslam.min_path_m': 0.0,
        'ratslam.gate_sigmas': 3.0, 'pose_cells.restore': 0.05, 'pose_cells.injection': 1.0})
    inject = robot.mapper.packet.cells.inject
    monkeypatch.setattr(robot.mapper.packet.cells, 'inject', lambda position, energy: (
        energies.append(energy), inject(position, energy)))
    turn = Pose2(0.0, 0.0, 0.21)
    code = codes_along(10)[0]
    robot.see(code)
    for k in range(8):
        motion = [turn if k % 2 else Pose2(0.0, 0.0, -0.21)]
        robot.drive(motion, [code], measured=motion)
    assert energies[:2] == pytest.approx(
        [(30 - np.exp(1.2 * decay)) / 30 for decay in (1.0, 1.95)])
    assert len(energies) == 2
    robot.drive([IDENTITY] * 200, [code] * 200, measured=[IDENTITY] * 200)
    robot.drive([turn], [code], measured=[turn])
    assert energies[2:] == pytest.approx([(30 - np.exp(1.2)) / 30])


# Code books

def test_a_new_code_book_is_matched_by_new_codes():
    """Half-way all codes are turned in their space; the book turns with them."""
    rotation, _ = np.linalg.qr(np.random.default_rng(0).normal(size=(64, 64)))
    robot, codes = Robot(), codes_along(len(LAP))
    robot.drive(LAP, codes)
    robot.mapper.view_cells.replace(robot.mapper.view_cells.kept @ rotation)
    robot.drive(LAP, codes @ rotation)
    assert robot.mapper.map.is_closure.any()
    assert robot.closure_gaps().max() < 0.8


def test_an_old_code_book_is_not_matched_by_new_codes():
    rotation, _ = np.linalg.qr(np.random.default_rng(0).normal(size=(64, 64)))
    robot, codes = Robot(), codes_along(len(LAP))
    robot.drive(LAP, codes)
    robot.drive(LAP, codes @ rotation)
    assert not robot.mapper.map.is_closure.any()
