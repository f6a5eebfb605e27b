"""Association, alignment and ATE give what the `evo` package gives for the same flight."""

from dlsc_qbs_ros.core.types import GroundTruthSample, Pose2
from dlsc_qbs_ros.evaluation.alignment import align, align_least_squares
from dlsc_qbs_ros.evaluation.association import associate
from dlsc_qbs_ros.evaluation.metrics import ate_rmse_m, evaluate_run
from dlsc_qbs_ros.pipeline.runner import RunResult
from dlsc_qbs_ros.sim.simulation import EPOCH_NS, simulate_flight
import numpy as np
import pytest

metrics = pytest.importorskip('evo.core.metrics', reason='evo is not installed')
geometry = pytest.importorskip('evo.core.geometry')
sync = pytest.importorskip('evo.core.sync')
trajectory = pytest.importorskip('evo.core.trajectory')
INTERPOLATION = pytest.importorskip('evo.core.sync_method').SyncMethod.interpolation


class Example:
    """A simulated flight: drifting odometry as the estimate, beacons as the ground truth."""

    flight = simulate_flight(2, 7, 60.0)
    samples = [raw.sample for raw in flight.odometry][5:-1:5]  # at 10 Hz, while beacons are seen
    stamps_ns = np.array([sample.stamp_ns for sample in samples])
    poses = np.array([sample.pose for sample in samples])
    truth = flight.ground_truth

    @classmethod
    def of_evo(cls):
        """Return ground truth and estimate as evo has them."""
        return (of_evo([sample.stamp_ns for sample in cls.truth],
                       np.array([sample.pose for sample in cls.truth])),
                of_evo(cls.stamps_ns, cls.poses))


def of_evo(stamps_ns, poses):
    """Return planar poses as a trajectory in space; its clock starts with the flight."""
    x, y, yaw = np.asarray(poses).T
    zero = np.zeros_like(x)
    return trajectory.PoseTrajectory3D(
        positions_xyz=np.column_stack([x, y, zero]),
        orientations_quat_wxyz=np.column_stack([np.cos(yaw / 2), zero, zero, np.sin(yaw / 2)]),
        timestamps=(np.asarray(stamps_ns) - EPOCH_NS) * 1e-9)


def planar(path):
    """Return x, y, yaw of evo's poses."""
    return np.array([(*pose[:2, 3], np.arctan2(pose[1, 0], pose[0, 0]))
                     for pose in path.poses_se3])


def rmse_of_evo(reference, estimate):
    """Align the estimate without scale and return evo's absolute pose error."""
    estimate.align(reference)
    error = metrics.APE(metrics.PoseRelation.translation_part)
    error.process_data((reference, estimate))
    return error.get_statistic(metrics.StatisticsType.rmse)


def turned(points, angle_rad):
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return points @ np.array([[c, s], [-s, c]])


def paired():
    """Return the estimate and the ground truth of the same frames, shape (n, 2) each."""
    return Example.poses[:, :2], associate(Example.stamps_ns, Example.truth)[:, :2]


def test_association_pairs_the_same_frames_where_stamps_are_shared():
    """Ground truth at the frames' own stamps, missing at both ends and for three seconds."""
    whole = associate(Example.stamps_ns, Example.truth)
    there = np.ones(len(whole), bool)
    there[:10] = there[200:230] = there[-7:] = False
    truth = [GroundTruthSample(stamp_ns, Pose2(*pose))
             for stamp_ns, pose in zip(Example.stamps_ns[there].tolist(), whole[there].tolist())]
    ours = associate(Example.stamps_ns, truth)
    used = np.isfinite(ours).all(axis=1)
    reference, estimate = sync.associate_trajectories(
        of_evo(Example.stamps_ns[there], whole[there]),
        of_evo(Example.stamps_ns, Example.poses), max_diff=0.001)
    np.testing.assert_allclose(
        (Example.stamps_ns[used] - EPOCH_NS) * 1e-9, estimate.timestamps, atol=1e-6)
    np.testing.assert_allclose(ours[used], planar(reference), atol=1e-9)


def test_association_interpolates_alike_where_they_are_not():
    reference, estimate = sync.associate_trajectories(
        *Example.of_evo(), sync_method=INTERPOLATION, max_diff=0.05)
    assert estimate.num_poses == len(Example.stamps_ns)
    ours = associate(Example.stamps_ns, Example.truth)
    np.testing.assert_allclose(ours, planar(reference), atol=1e-6)


@pytest.mark.parametrize('rotation_rad', [-2.9, 0.0, 1.2])
def test_without_noise_both_alignments_are_that_of_evo(rotation_rad):
    _, truth = paired()
    estimate = turned(truth, rotation_rad) + [12.0, -7.0]
    rotation, translation, scale = geometry.umeyama_alignment(truth.T, estimate.T)
    assert scale == 1.0
    for found in (align(truth, estimate), align_least_squares(truth, estimate)):
        assert found.rotation_rad == pytest.approx(np.arctan2(rotation[1, 0], rotation[0, 0]),
                                                   abs=1e-6)
        np.testing.assert_allclose(found.translation_m, translation, atol=1e-5)


def test_least_squares_alignment_of_a_drifting_flight_is_that_of_evo_in_plane_and_space():
    estimate, truth = paired()
    found = align_least_squares(truth, estimate)
    for dimensions in (2, 3):
        flat = np.zeros((dimensions - 2, len(truth)))
        rotation, translation, _ = geometry.umeyama_alignment(
            np.vstack([truth.T, flat]), np.vstack([estimate.T, flat]))
        assert np.arctan2(rotation[1, 0], rotation[0, 0]) == pytest.approx(found.rotation_rad)
        np.testing.assert_allclose(translation[:2], found.translation_m, atol=1e-9)


def test_ate_of_a_drifting_flight_is_that_of_evo_whichever_side_is_moved():
    estimate, truth = paired()
    stamps_ns = np.arange(len(truth))
    paths = [of_evo(stamps_ns, np.column_stack([points, np.zeros(len(points))]))
             for points in (truth, estimate, truth, estimate)]
    ours = ate_rmse_m(estimate, truth)
    assert ours > 0.1
    assert ours == pytest.approx(rmse_of_evo(*paths[:2]), abs=1e-9)
    assert ours == pytest.approx(rmse_of_evo(*paths[3:1:-1]), abs=1e-9)


def test_a_run_gets_from_stamps_to_ate_as_in_evo():
    better = Example.poses * [1.01, 0.99, 1.0]
    result = RunResult(
        stamps_ns=Example.stamps_ns, poses=better, sigmas=better[:, :2], final_poses=better,
        odometry=Example.poses, experiences=better, births=np.arange(len(better)),
        links=np.zeros((0, 2), int), closures=np.zeros((0, 2), int),
        closure_motions=np.zeros((0, 3)), counts={}, seconds=1.0)
    ours = evaluate_run(result, Example.truth)
    assert ours.frames == len(Example.stamps_ns)
    for ate_m, poses in ((ours.ate_rmse_m, better), (ours.odometry_ate_rmse_m, Example.poses)):
        reference, estimate = sync.associate_trajectories(
            Example.of_evo()[0], of_evo(Example.stamps_ns, poses),
            sync_method=INTERPOLATION, max_diff=0.05)
        assert ate_m == pytest.approx(rmse_of_evo(reference, estimate), abs=1e-6)
