"""The metrics, the alignment, the picture and the table of the evaluation."""

import json
import sys

from dlsc_qbs_ros.core.types import GroundTruthSample, Pose2
from dlsc_qbs_ros.errors import DlscQbsError
from dlsc_qbs_ros.evaluation.alignment import align, align_least_squares, Alignment
from dlsc_qbs_ros.evaluation.association import associate
from dlsc_qbs_ros.evaluation.metrics import (
    ate_rmse_m, evaluate_run, mae_l, mae_m, share_within_95)
from dlsc_qbs_ros.evaluation.plots import plot_run
from dlsc_qbs_ros.evaluation.table import format_table, Row
from dlsc_qbs_ros.pipeline.runner import RunResult
import numpy as np
import pytest

SECOND_NS = 10**9
COUNTS = {'frames': 900, 'view_cells': 31, 'experiences': 42, 'closures': 2,
          'learning_frames': 17, 'epochs': 3}


def truth_at(times_s, poses):
    return [GroundTruthSample(round(t * SECOND_NS), Pose2(*map(float, pose)))
            for t, pose in zip(times_s, poses)]


def turned(points, angle_rad):
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return points @ np.array([[c, s], [-s, c]])


def walk(n, seed=0):
    return np.random.default_rng(seed).normal(0.0, 0.3, (n, 2)).cumsum(axis=0)


def result_of(poses, final_poses=None, odometry=None, closures=()):
    """Return a run of one code a second with the given planar positions."""
    def planar(points):
        return np.column_stack([points, np.zeros(len(points))])
    poses = planar(np.asarray(poses, dtype=float))
    final = poses if final_poses is None else planar(np.asarray(final_poses, dtype=float))
    odometry = poses if odometry is None else planar(np.asarray(odometry, dtype=float))
    n = len(poses)
    return RunResult(
        stamps_ns=np.arange(n, dtype=np.int64) * SECOND_NS, poses=poses,
        sigmas=np.ones((n, 2)), final_poses=final,
        odometry=odometry, experiences=final, births=np.arange(n),
        links=np.column_stack([np.arange(n - 1), np.arange(1, n)]),
        closures=np.array(closures, dtype=np.int64).reshape(-1, 2),
        closure_motions=np.zeros((len(closures), 3)), counts=COUNTS, seconds=1.5)


def truth_of(points):
    return truth_at(range(len(points)), np.column_stack([points, np.zeros(len(points))]))


def row_of(result, truth, **changes):
    values = {'flight': 'flight_1', 'encoder': 'dlsc_qbs', 'metrics': evaluate_run(result, truth),
              'threshold': 0.75, 'threshold_tuned': False, 'n_codes': len(result.stamps_ns),
              'counts': result.counts, 'refused': {}, 'false_closures': 0, 'encode_s': 1.8,
              'map_s': 0.9}
    return Row(**{**values, **changes})


class TestFigures:
    """MAE_L and MAE_M are the paper's equations."""

    estimate = np.array([[0.0, 0.0], [1.0, 2.0], [4.0, 0.0]])
    truth = np.array([[0.5, 0.0], [1.0, 0.0], [1.0, 1.0]])

    def test_mae_l_by_hand(self):
        assert mae_l(self.estimate, self.truth) == pytest.approx((0.5 + 2.0 + 4.0) / 3)

    def test_mae_m_by_hand_takes_the_nearest_point_of_all(self):
        assert mae_m(self.estimate, self.truth) == pytest.approx((0.5 + 1.0 + 3.0) / 3)

    def test_mae_m_ignores_the_order_of_the_ground_truth_and_mae_l_does_not(self):
        assert mae_m(self.estimate, self.truth[::-1]) == mae_m(self.estimate, self.truth)
        assert mae_l(self.estimate, self.truth[::-1]) != mae_l(self.estimate, self.truth)

    def test_mae_m_is_never_above_mae_l(self):
        estimate, truth = walk(100), walk(100, seed=1)
        assert mae_m(estimate, truth) <= mae_l(estimate, truth)

    def test_both_equal_a_scalar_loop_beyond_one_chunk(self):
        estimate, truth = walk(700), walk(600, seed=1)
        rows = list(zip(estimate.tolist(), truth.tolist()))
        expected_l = sum(abs(x - gx) + abs(y - gy) for (x, y), (gx, gy) in rows) / len(rows)
        expected_m = sum(min(abs(x - gx) + abs(y - gy) for gx, gy in truth.tolist())
                         for x, y in estimate.tolist()) / len(estimate)
        assert mae_l(estimate[:600], truth) == pytest.approx(expected_l)
        assert mae_m(estimate, truth) == pytest.approx(expected_m)


class TestAte:
    """The absolute trajectory error is what is left by the rigid motion of least squares."""

    @pytest.mark.parametrize('shift, turn', [((0.0, 0.0), 0.0), ((40.0, -9.0), 2.5)])
    def test_by_hand(self, shift, turn):
        """Turned by a quarter, two of four points a metre too far out: sqrt(2 / 4)."""
        truth = np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
        estimate = np.array([[0.0, 2.0], [0.0, -2.0], [-1.0, 0.0], [1.0, 0.0]]) + 5.0
        assert align_least_squares(truth, estimate).rotation_rad == pytest.approx(np.pi / 2)
        assert align_least_squares(truth, estimate).translation_m == pytest.approx([5.0, 5.0])
        assert ate_rmse_m(estimate, turned(truth, turn) + shift) == pytest.approx(0.5 ** 0.5)

    def test_it_never_scales(self):
        truth = np.array([[0.0, 0.0], [2.0, 0.0]])
        assert ate_rmse_m(2.0 * truth, truth) == pytest.approx(1.0)

    def test_it_is_the_same_seen_from_either_side(self):
        estimate, truth = walk(60), walk(60, seed=1)
        assert ate_rmse_m(estimate, truth) == pytest.approx(ate_rmse_m(truth, estimate))

    @pytest.mark.parametrize('seed', range(4))
    def test_no_other_motion_leaves_less(self, seed):
        rng = np.random.default_rng(seed)
        truth, estimate = walk(40, seed), walk(40, seed + 9)
        found = align_least_squares(truth, estimate)
        others = [align(truth, estimate)] + [
            Alignment(found.rotation_rad + turn, found.translation_m + shift)
            for scale in (1.0, 1e-1, 1e-3) for turn, *shift in rng.normal(0.0, scale, (100, 3))]
        for other in others:
            off_m = np.hypot(*(estimate - other.apply(truth)).T)
            assert ate_rmse_m(estimate, truth) <= np.sqrt(np.mean(off_m ** 2)) + 1e-12

    def test_a_flight_that_stands_still_lands_on_its_estimate(self):
        assert ate_rmse_m(np.full((5, 2), 3.0), np.ones((5, 2))) == pytest.approx(0.0)


class TestAssociation:
    """Ground truth is taken at the stamp of each code, or not at all."""

    def test_interpolates_between_the_two_neighbours(self):
        truth = truth_at([0.0, 1.0], [(0, 0, 0), (4, 8, 1)])
        assert associate([SECOND_NS // 4], truth) == pytest.approx(np.array([[1.0, 2.0, 0.25]]))

    def test_turns_the_heading_the_shorter_way_round(self):
        truth = truth_at([0.0, 1.0], [(0, 0, np.pi - 0.1), (0, 0, -np.pi + 0.3)])
        assert associate([SECOND_NS // 2], truth)[0, 2] == pytest.approx(-np.pi + 0.1)

    def test_is_silent_outside_and_exact_on_the_samples(self):
        truth = truth_at([1.0, 2.0], [(1, 0, 0), (2, 0, 0)])
        stamps = np.array([SECOND_NS - 1, SECOND_NS, 2 * SECOND_NS, 2 * SECOND_NS + 1])
        assert associate(stamps, truth)[:, 0] == pytest.approx(
            [np.nan, 1.0, 2.0, np.nan], nan_ok=True)

    def test_is_silent_inside_a_gap_and_not_at_its_ends(self):
        truth = truth_at([0.0, 0.5, 1.6], [(0, 0, 0), (5, 0, 0), (16, 0, 0)])
        stamps = np.array([0.5, 1.0, 1.6]) * SECOND_NS
        assert associate(stamps, truth, max_gap_s=1.0)[:, 0] == pytest.approx(
            [5.0, np.nan, 16.0], nan_ok=True)
        assert associate(stamps, truth, max_gap_s=1.1)[:, 0] == pytest.approx([5.0, 10.0, 16.0])

    def test_takes_samples_in_any_order_and_repeated_stamps(self):
        truth = truth_at([2.0, 1.0, 0.0, 1.0], [(9, 0, 0), (4, 0, 0), (0, 0, 0), (4, 0, 0)])
        stamps = np.array([0.5, 1.0, 1.5]) * SECOND_NS
        assert associate(stamps, truth)[:, 0] == pytest.approx([2.0, 4.0, 6.5])

    def test_keeps_nanoseconds_of_an_epoch_time(self):
        start_ns = 1_700_000_000_000_000_001
        truth = [GroundTruthSample(start_ns, Pose2(0.0, 0.0, 0.0)),
                 GroundTruthSample(start_ns + 100, Pose2(100.0, 0.0, 0.0))]
        assert associate([start_ns + 37], truth)[0, 0] == pytest.approx(37.0)

    def test_without_ground_truth_all_is_silent(self):
        assert np.isnan(associate([0, 1], [])).all()


class TestAlignment:
    """The rigid motion of least MAE_L."""

    @pytest.mark.parametrize('rotation_rad', [-3.1, -1.234, 0.0, 0.01, 1.0, 2.5])
    def test_recovers_a_known_motion(self, rotation_rad):
        truth = walk(300)
        found = align(truth, turned(truth, rotation_rad) + [12.0, -7.0])
        assert found.rotation_rad == pytest.approx(rotation_rad, abs=1e-7)
        assert found.translation_m == pytest.approx([12.0, -7.0], abs=1e-5)

    def test_recovers_it_though_a_third_of_the_frames_are_far_off(self):
        truth = walk(300)
        estimate = turned(truth, 0.5) + [1.0, 2.0]
        estimate[::3] += np.random.default_rng(2).normal(0.0, 5.0, (100, 2))
        found = align(truth, estimate)
        assert found.rotation_rad == pytest.approx(0.5, abs=1e-6)
        assert found.translation_m == pytest.approx([1.0, 2.0], abs=1e-5)

    def test_translation_is_the_median_of_the_residuals_not_their_mean(self):
        truth = np.array([[-100.0, 0.0], [0.0, 0.0], [100.0, 0.0]])
        estimate = truth + [[0.0, 5.0], [1.0, 5.0], [9.0, 5.0]]
        found = align(truth, estimate)
        residuals = estimate - turned(truth, found.rotation_rad)
        assert found.translation_m == pytest.approx(np.median(residuals, axis=0))
        assert not np.allclose(found.translation_m, residuals.mean(axis=0), atol=0.1)

    @pytest.mark.parametrize('n, seed', [
        (2, 0), (3, 0), (10, 0), (60, 0), (60, 1),
        (2, 25), (10, 135), (60, 103)])  # the last three: the best coarse angle misleads
    def test_no_fine_grid_beats_it(self, n, seed):
        truth, estimate = walk(n, seed), walk(n, seed + 50)
        found = align(truth, estimate)
        cost = mae_l(found.apply(truth), estimate)
        for angle in np.linspace(-np.pi, np.pi, 10_000):
            residuals = estimate - turned(truth, angle)
            spread = np.abs(residuals - np.median(residuals, axis=0)).sum(axis=1).mean()
            assert cost <= spread + 1e-9

    @pytest.mark.parametrize('seed', range(4))
    def test_no_motion_near_it_is_better(self, seed):
        rng = np.random.default_rng(seed)
        truth, estimate = walk(40, seed), walk(40, seed + 9)
        found = align(truth, estimate)
        cost = mae_l(found.apply(truth), estimate)
        for scale in (1e-1, 1e-3, 1e-6):
            for turn, *shift in rng.normal(0.0, scale, (300, 3)):
                near = Alignment(found.rotation_rad + turn, found.translation_m + shift)
                assert cost <= mae_l(near.apply(truth), estimate) + 1e-8

    def test_never_scales(self):
        truth = walk(50)
        moved = align(truth, 3.0 * truth).apply(truth)
        assert np.linalg.norm(moved[0] - moved[-1]) == pytest.approx(
            np.linalg.norm(truth[0] - truth[-1]))

    def test_a_flight_that_stands_still_lands_on_its_estimate(self):
        found = align(np.ones((5, 2)), np.full((5, 2), 3.0))
        assert found.apply(np.ones((5, 2))) == pytest.approx(np.full((5, 2), 3.0))


class TestCovariance:
    """How many of the errors lie where 95 % of them ought to."""

    def test_four_frames_by_hand(self):
        """The circle of one deviation 1 has the radius sqrt(5.991) = 2.448."""
        estimate = np.array([[2.44, 0.0], [0.0, -2.46], [1.8, 1.8], [1.7, -1.7]])
        sigma_m = np.ones(4)
        assert share_within_95(estimate, np.zeros((4, 2)), sigma_m) == 0.5
        assert share_within_95(3.0 * estimate, np.zeros((4, 2)), 3.0 * sigma_m) == 0.5

    def test_of_normal_errors_it_is_95_percent(self):
        rng = np.random.default_rng(0)
        sigma_m = rng.uniform(0.1, 3.0, 20_000)
        errors = sigma_m[:, None] * rng.normal(size=(20_000, 2))
        truth = rng.normal(size=(20_000, 2))
        assert share_within_95(truth + errors, truth, sigma_m) == pytest.approx(0.95, abs=0.005)

    def test_who_says_that_it_is_lost_is_right_wherever_it_is(self):
        assert share_within_95(np.full((3, 2), 1e6), np.zeros((3, 2)), np.full(3, np.inf)) == 1.0


class TestRun:
    """Which poses, which frames and which alignment go into which figure."""

    def test_five_frames_by_hand(self):
        """
        The map is 2 m off in the middle as it flies, and 1 m at its end afterwards.

        MAE_L and MAE_M leave the four good frames where they are: 2/5 and 1/5. Least squares moves
        all by 0.4 m: four errors of 0.4 m and one of 1.6 m. Odometry, 1 m too long at both ends,
        stays in its middle: 2/5 for both of the paper's figures, sqrt(2/5) for the other.
        """
        truth = np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0], [3.0, 0.0], [4.0, 0.0]])
        poses, final, odometry = truth.copy(), truth.copy(), truth.copy()
        poses[2, 1], final[4, 1] = 2.0, 1.0
        odometry[[0, 4], 0] = -1.0, 5.0
        metrics = evaluate_run(result_of(poses, final, odometry), truth_of(truth))
        assert (metrics.mae_l, metrics.mae_m) == pytest.approx((0.4, 0.2))
        assert metrics.ate_rmse_m == pytest.approx(((4 * 0.4**2 + 1.6**2) / 5) ** 0.5)
        assert (metrics.odometry_mae_l, metrics.odometry_mae_m) == pytest.approx((0.4, 0.4))
        assert metrics.odometry_ate_rmse_m == pytest.approx(0.4 ** 0.5)
        assert metrics.within_95 == 1.0  # of errors up to 2 m, with deviations of 1 m

    def test_online_poses_give_mae_l_final_poses_mae_m_under_the_alignment_of_mae_l(self):
        truth = walk(50)
        poses = turned(truth, 0.7) + [1.0, 2.0]
        metrics = evaluate_run(result_of(poses, final_poses=poses + [1000.0, 0.0]),
                               truth_of(truth))
        assert metrics.mae_l == pytest.approx(0.0, abs=1e-6)
        assert metrics.mae_m > 900.0
        assert metrics.alignment.rotation_rad == pytest.approx(0.7, abs=1e-6)
        assert metrics.truth_m == pytest.approx(poses, abs=1e-6)

    def test_odometry_gets_an_alignment_of_its_own(self):
        truth = walk(50)
        result = result_of(turned(truth, 0.7) + 5.0, odometry=turned(truth, -2.0) - 3.0)
        metrics = evaluate_run(result, truth_of(truth))
        assert metrics.odometry_mae_l == pytest.approx(0.0, abs=1e-6)
        assert metrics.odometry_mae_m == pytest.approx(0.0, abs=1e-6)

    def test_a_rigid_motion_of_the_ground_truth_changes_nothing(self):
        truth = walk(80)
        drift = np.linspace(0.0, 3.0, 80)[:, None] * [1.0, -0.5]
        result = result_of(truth + drift, truth + 0.2 * drift, truth + 2.0 * drift)
        still = evaluate_run(result, truth_of(truth))
        moved = evaluate_run(result, truth_of(turned(truth, 2.1) + [40.0, -9.0]))
        for name in ('mae_l', 'mae_m', 'odometry_mae_l', 'odometry_mae_m', 'ate_rmse_m',
                     'odometry_ate_rmse_m'):
            assert getattr(moved, name) == pytest.approx(getattr(still, name), abs=1e-6)
            assert getattr(still, name) > 0.01

    def test_frames_without_ground_truth_are_left_out_and_counted(self):
        truth = walk(20)
        poses = truth.copy()
        poses[15:] += 1e6
        metrics = evaluate_run(result_of(poses), truth_of(truth)[:15])
        assert (metrics.frames, metrics.frames_left_out) == (15, 5)
        assert metrics.mae_l == pytest.approx(0.0, abs=1e-6)
        assert np.isnan(metrics.truth_m[15:]).all()

    def test_without_ground_truth_there_are_no_metrics(self):
        assert evaluate_run(result_of(walk(5)), []) is None


class TestRow:
    """A row says what metrics.json and the table promise."""

    keys = ['flight', 'encoder', 'mae_l', 'mae_m', 'odometry_mae_l', 'odometry_mae_m',
            'ate_rmse_m', 'odometry_ate_rmse_m', 'within_95', 'threshold', 'threshold_tuned',
            'frames',
            'view_cells', 'experiences', 'closures', 'learning_frames', 'epochs',
            'false_closures', 'alignment']

    def test_json_holds_the_promised_keys(self):
        truth = walk(30)
        row = json.loads(json.dumps(row_of(result_of(truth + 1.0), truth_of(truth)).as_json()))
        assert list(row) == self.keys
        assert row['frames'] == 30
        assert row['view_cells'] == 31
        assert row['threshold'] == 0.75
        assert list(row['alignment']) == ['rotation_rad', 'translation_m']
        assert row['alignment']['translation_m'] == pytest.approx([1.0, 1.0], abs=1e-5)

    def test_time_stands_apart_as_it_is_another_each_time(self):
        truth = walk(30)
        assert row_of(result_of(truth), truth_of(truth)).timing() == {
            'flight': 'flight_1', 'encoder': 'dlsc_qbs', 'threshold_tuned': False,
            'encode_ms_per_frame': 2.0, 'map_ms_per_code': 30.0}

    def test_json_is_null_without_ground_truth(self):
        row = json.loads(json.dumps(row_of(result_of(walk(30)), []).as_json()))
        assert list(row) == self.keys
        assert [key for key in self.keys if row[key] is None] == [
            'mae_l', 'mae_m', 'odometry_mae_l', 'odometry_mae_m', 'ate_rmse_m',
            'odometry_ate_rmse_m', 'within_95', 'alignment']
        assert row['frames'] == 30

    def test_table_names_every_figure(self):
        truth = walk(30)
        poses = truth + np.array([[0.5, 0.0], [-0.5, 0.0]] * 15)
        row = row_of(result_of(poses), truth_of(truth)[:-1], threshold_tuned=True)
        text = format_table([row])
        metrics = row.metrics
        for part in ('flight_1', 'dlsc_qbs', f'{metrics.mae_l:.3f} | {metrics.mae_m:.3f}',
                     f'{metrics.odometry_mae_l:.3f} | {metrics.odometry_mae_m:.3f}', '0.750*',
                     '29 frames used, 1 without', ' 31 ', ' 42 ', ' deg, then moved by (',
                     '* tuned on that very flight'):
            assert part in text

    def test_table_keeps_its_columns_and_says_where_nothing_is_known(self):
        result = result_of(walk(30))
        text = format_table([row_of(result, truth_of(walk(30))),
                             row_of(result, [], encoder='odometry', threshold=None)])
        header, rule, *rows = text.splitlines()[:4]
        assert {len(line) for line in (header, rule, *rows)} == {len(header)}
        assert rows[1].split()[:5] == ['flight_1', 'odometry', '-', '-', '-']
        assert 'flight_1 odometry: no ground truth' in text
        assert 'tuned' not in text
        assert 'refused' not in text

    def test_table_says_what_the_reader_refused(self):
        text = format_table([row_of(result_of(walk(5)), [], refused={'/odom': 3})])
        assert 'flight_1 dlsc_qbs: 3 messages of /odom refused' in text

    def test_table_says_what_the_pipeline_gave_up_and_nothing_usual(self):
        counts = {**COUNTS, 'codes_used': 9, 'code_books': 8, 'codes_before_odometry': 4,
                  'codes_out_of_order': 0}
        text = format_table([row_of(result_of(walk(5)), [], counts=counts)])
        assert text.splitlines()[-1] == '  flight_1 dlsc_qbs: codes_before_odometry: 4'
        assert 'codes_used' not in text
        assert 'code_books' not in text


class TestPicture:
    """One picture per flight and encoder."""

    @pytest.mark.parametrize('closures', [(), [(0, 9), (3, 25)]])
    @pytest.mark.parametrize('n_truth', [0, 20])
    def test_is_written(self, tmp_path, closures, n_truth):
        truth = walk(30)
        result = result_of(truth, closures=closures)
        plot_run(tmp_path / 'a.png', row_of(result, truth_of(truth)[:n_truth]), result)
        picture = (tmp_path / 'a.png').read_bytes()
        assert picture.startswith(b'\x89PNG')
        assert len(picture) > 10_000

    def test_without_matplotlib_the_error_says_so(self, tmp_path, monkeypatch):
        monkeypatch.setitem(sys.modules, 'matplotlib.figure', None)
        result = result_of(walk(5))
        with pytest.raises(DlscQbsError, match=r'a\.png: pictures need matplotlib'):
            plot_run(tmp_path / 'a.png', row_of(result, []), result)
