"""Raw odometry is put in order; between two samples there is a pose."""

from math import cos, inf, nan, pi, sin

import pytest

from dlsc_qbs_ros.config import OdometryConfig
from dlsc_qbs_ros.core.types import OdometrySample, Pose2, RawOdometry
from dlsc_qbs_ros.pipeline.odometry import OdometryHistory, OdometryNormaliser

MS = 1_000_000
START_MS = 1_700_000_000_000


def sample(time_ms, x=0.0, segment=0, y=0.0, yaw=0.0, **rest):
    return OdometrySample(
        (START_MS + time_ms) * MS, Pose2(float(x), float(y), yaw), segment=segment, **rest)


def raw(time_ms, x=0.0, segment=0, twist=(0.0, 0.0, 0.0)):
    return RawOdometry(sample(time_ms, x, segment), *twist)


def accepted(raws, **config):
    """Return the samples that came out, None where refused, and what was counted."""
    normaliser = OdometryNormaliser(OdometryConfig(**config))
    return [normaliser.accept(one) for one in raws], dict(normaliser.counts)


def segments(samples):
    return [None if one is None else one.segment for one in samples]


# Order and segments

def test_what_is_in_order_passes_as_it_came():
    raws = [raw(20 * k, x=0.02 * k) for k in range(10)]
    samples, counts = accepted(raws)
    assert samples == [one.sample for one in raws]
    assert counts == {'odometry_accepted': 10}


@pytest.mark.parametrize('late_ms', [20, 0, -900])
def test_what_is_not_after_its_predecessor_is_refused(late_ms):
    samples, counts = accepted([raw(0), raw(20), raw(late_ms), raw(40)])
    assert segments(samples) == [0, 0, None, 0]
    assert counts == {'odometry_accepted': 3, 'odometry_out_of_order': 1}


def test_a_refused_sample_is_no_predecessor():
    """The late sample lies 90 m away; the next one does not jump from there."""
    samples, counts = accepted([raw(0), raw(100), raw(50, x=90.0), raw(200)])
    assert segments(samples) == [0, 0, None, 0]
    assert 'odometry_jumps' not in counts


@pytest.mark.parametrize('second, cause', [
    (raw(-5000), 'odometry_clock_jumps'),
    (raw(120, segment=1), 'odometry_resets'),
    (raw(200, x=5.1), 'odometry_jumps'),
])
def test_a_break_starts_a_new_segment_and_names_its_cause(second, cause):
    third = raw((second.sample.stamp_ns // MS) - START_MS + 20, second.sample.pose.x_m,
                second.sample.segment)
    samples, counts = accepted([raw(100), second, third])
    assert segments(samples) == [0, 1, 1]
    assert counts == {'odometry_accepted': 3, cause: 1}


@pytest.mark.parametrize('second', [raw(9100), raw(200, x=5.0), raw(200, x=-5.0)])
def test_just_inside_the_bounds_nothing_breaks(second):
    assert segments(accepted([raw(100), second])[0]) == [0, 0]


def test_bounds_come_from_the_configuration():
    raws = [raw(0), raw(500), raw(600, x=1.0)]
    assert segments(accepted(raws, max_gap_s=0.4)[0]) == [0, 0, 0]
    assert segments(accepted(raws, max_gap_s=0.4, use_twist=True)[0]) == [0, 1, 1]
    assert segments(accepted(raws, max_speed_m_s=9.0)[0]) == [0, 0, 1]


def test_each_break_counts_its_own_segment_whatever_the_source_numbers():
    raws = [raw(0, segment=7), raw(20, segment=7), raw(40, segment=3), raw(60, segment=7)]
    assert segments(accepted(raws)[0]) == [0, 0, 1, 2]


def test_height_roll_and_pitch_pass_through():
    one = sample(0, z_m=1.5, roll_rad=0.1, pitch_rad=-0.2)
    samples, _ = accepted([RawOdometry(one, nan, nan, nan)])
    assert samples == [one]


# Twists

def test_a_circle_flown_by_its_twist_closes():
    """A twist of 2 m/s and 0.5 rad/s draws a circle of 4 m; poses are ignored."""
    n = 1257
    raws = [raw(10 * k, x=100.0 * (k % 2), twist=(2.0, 0.0, 0.5)) for k in range(n)]
    samples, counts = accepted(raws, use_twist=True)
    for k in range(0, n, 100):
        angle = 0.5 * 0.01 * k
        assert samples[k].pose[:2] == pytest.approx(
            (4 * sin(angle), 4 * (1 - cos(angle))), abs=1e-3)
    assert samples[-1].pose[:2] == pytest.approx((0.0, 0.0), abs=0.02)
    assert counts == {'odometry_accepted': n}


def test_a_twist_to_the_left_moves_to_the_left_of_the_heading():
    raws = [raw(0, twist=(0.0, 0.0, pi)), raw(500, twist=(0.0, 0.0, pi)),
            raw(501, twist=(0.0, 2.0, 0.0)), raw(1501, twist=(0.0, 2.0, 0.0))]
    pose = accepted(raws, use_twist=True)[0][-1].pose
    assert pose.x_m == pytest.approx(-2.0, abs=0.01)
    assert pose.y_m == pytest.approx(0.0, abs=0.01)


def test_twists_are_not_integrated_across_a_break():
    raws = [raw(0, twist=(1.0, 0, 0)), raw(1000, twist=(1.0, 0, 0)),
            raw(9000, twist=(1.0, 0, 0)), raw(10000, twist=(1.0, 0, 0))]
    samples, _ = accepted(raws, use_twist=True)
    assert [one.pose.x_m for one in samples] == pytest.approx([0.0, 1.0, 1.0, 2.0])
    assert segments(samples) == [0, 0, 1, 1]


@pytest.mark.parametrize('twist', [(nan, 0.0, 0.0), (0.0, nan, 0.0), (0.0, 0.0, nan)])
def test_a_sample_without_the_twist_that_is_asked_for_is_refused(twist):
    raws = [raw(0, twist=(1.0, 0, 0)), raw(500, twist=twist), raw(1000, twist=(1.0, 0, 0))]
    samples, counts = accepted(raws, use_twist=True)
    assert segments(samples) == [0, None, 0]
    assert samples[-1].pose == pytest.approx(Pose2(1.0, 0.0, 0.0))
    assert counts == {'odometry_accepted': 2, 'odometry_without_twist': 1}


@pytest.mark.parametrize('twist', [(51.0, 0.0, 0.0), (36.0, -36.0, 0.0), (1e200, 0.0, 0.0)])
def test_a_twist_faster_than_any_is_refused_where_it_is_integrated(twist):
    raws = [raw(0, twist=(1.0, 0, 0)), raw(500, twist=twist), raw(1000, twist=(1.0, 0, 0))]
    samples, counts = accepted(raws, use_twist=True, max_speed_m_s=50.0)
    assert segments(samples) == [0, None, 0]
    assert samples[-1].pose == pytest.approx(Pose2(1.0, 0.0, 0.0))
    assert counts == {'odometry_accepted': 2, 'odometry_too_fast': 1}
    assert accepted(raws)[1] == {'odometry_accepted': 3}


@pytest.mark.parametrize('where', [
    {'x': 1.1e8}, {'y': -1e200}, {'z_m': 1e200}, {'z_m': nan}, {'x': -inf}])
def test_what_lies_beyond_the_world_is_refused(where):
    lost = RawOdometry(sample(20, **where), 0.0, 0.0, 0.0)
    samples, counts = accepted([raw(0), lost, raw(40)])
    assert segments(samples) == [0, None, 0]
    assert counts == {'odometry_accepted': 2, 'odometry_malformed': 1}


# History

def history(*samples):
    made = OdometryHistory()
    for one in samples:
        made.add(one)
    return made


def at(made, time_ms):
    return made.at((START_MS + time_ms) * MS)


def test_an_empty_history_knows_nothing():
    made = history()
    assert made.newest_ns is None
    assert at(made, 0) is None


def test_a_sample_is_found_at_its_own_stamp():
    a, b = sample(0, 1.0, z_m=2.0), sample(20, 3.0)
    made = history(a, b)
    assert (at(made, 0), at(made, 20)) == (a, b)
    assert made.newest_ns == b.stamp_ns


def test_between_two_samples_the_pose_is_interpolated():
    made = history(sample(0, 1.0, y=2.0, yaw=pi - 0.1, z_m=2.0),
                   sample(20, 3.0, y=1.0, yaw=-pi + 0.1, z_m=4.0))
    found = at(made, 5)
    assert found.stamp_ns == (START_MS + 5) * MS
    assert found.pose == pytest.approx(Pose2(1.5, 1.75, pi - 0.05))


@pytest.mark.parametrize('time_ms', [-1, 21])
def test_outside_of_the_samples_there_is_no_pose(time_ms):
    assert at(history(sample(0), sample(20)), time_ms) is None


def test_across_segments_nothing_is_interpolated():
    a, b = sample(0, 1.0, segment=0), sample(20, 9.0, segment=1)
    found = at(history(a, b), 15)
    assert (found.pose, found.segment) == (a.pose, 0)
    assert found.stamp_ns == (START_MS + 15) * MS


@pytest.mark.parametrize('time_ms', [20, 10, -5000])
def test_a_stamp_that_falls_back_ends_the_history_before_it(time_ms):
    made = history(sample(0, 1.0), sample(20, 2.0), sample(time_ms, 3.0))
    assert at(made, time_ms).pose.x_m == 3.0
    assert made.newest_ns == (START_MS + time_ms) * MS
    assert at(made, -6000) is None
    assert time_ms == 0 or at(made, 0) is None


def test_what_is_forgotten_is_gone_and_all_after_it_stays():
    made = history(*(sample(20 * k, float(k)) for k in range(10)))
    made.forget_before((START_MS + 70) * MS)
    assert at(made, 59) is None
    assert [at(made, time_ms).pose.x_m for time_ms in (60, 70, 180)] == [3.0, 3.5, 9.0]


def test_a_history_that_nobody_reads_does_not_grow_for_ever(monkeypatch):
    monkeypatch.setattr(OdometryHistory, 'MAX_SAMPLES', 100)
    made = history(*(sample(20 * k, float(k)) for k in range(1000)))
    assert at(made, 20 * 890) is None
    assert at(made, 20 * 960).pose.x_m == 960.0


def test_height_is_interpolated_too():
    low, high = sample(0), sample(100, z_m=1.0)
    assert at(history(low, high), 25).z_m == pytest.approx(0.25)
