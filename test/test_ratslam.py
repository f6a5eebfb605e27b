"""Events in any order of arrival give one map; whatever never comes is given up and counted."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import lru_cache
from math import cos, inf, sin
from threading import Event

from loop_flight import CONFIG, events, LAP_S, LateExecutor, pose_at, stamp_ns
import numpy as np
import pytest

from dlsc_qbs_ros.core.geometry import between, wrap_angle
from dlsc_qbs_ros.core.types import Code, Dictionary, OdometrySample, Pose2, View
from dlsc_qbs_ros.pipeline.code_book import CodeBook
from dlsc_qbs_ros.pipeline.ratslam import RatSlam
from dlsc_qbs_ros.pipeline.runner import encode

N_PIXELS = 12 * 16
WAIT_S = CONFIG.ratslam.max_wait_s
FLIGHT_S = 1.6 * LAP_S
KINDS = (OdometrySample, Dictionary, View, Code)


# A flight in any order

@lru_cache(maxsize=None)
def flight():
    return tuple(encode(events(FLIGHT_S), CONFIG).events)


def stamp_of(event):
    return event.stamp_ns


def shuffled(seed, lag_s, sources=KINDS):
    """Return the flight as it arrives when every stream lags by its own changing time."""
    rng = np.random.default_rng(seed)
    arrivals = []
    for kind in KINDS:
        stream = [event for event in flight() if isinstance(event, kind)]
        lags_ns = rng.uniform(0.0, lag_s, len(stream)) * 1e9 * (kind in sources)
        times = np.maximum.accumulate([e.stamp_ns + lag for e, lag in zip(stream, lags_ns)])
        arrivals += zip(times, stream)
    return [event for _, event in sorted(arrivals, key=lambda arrival: arrival[0])]


def add(ratslam, event, now_s=0.0):
    if isinstance(event, OdometrySample):
        ratslam.add_odometry(event, now_s)
    elif isinstance(event, Dictionary):
        ratslam.add_dictionary(event)
    elif isinstance(event, View):
        ratslam.add_view(event)
    else:
        ratslam.add_code(event, now_s)


def fly(arrivals, executor=None, complete_every=0):
    ratslam, poses = RatSlam(CONFIG, executor), []
    for k, event in enumerate(arrivals, 1):
        add(ratslam, event)
        poses += ratslam.advance(0.0)
        if complete_every and k % complete_every == 0:
            executor.complete()
    while executor and executor.complete():
        poses += ratslam.advance(0.0)
    return ratslam, poses + ratslam.advance(inf)


def assert_same_result(one, other):
    (a, a_poses), (b, b_poses) = one, other
    np.testing.assert_allclose(a.mapper.map.poses, b.mapper.map.poses, atol=1e-6)
    np.testing.assert_array_equal(a.mapper.map.links, b.mapper.map.links)
    np.testing.assert_array_equal(a.mapper.map.is_closure, b.mapper.map.is_closure)
    np.testing.assert_array_equal(a.mapper.view_cells.kept, b.mapper.view_cells.kept)
    assert a.counts['codes_used'] == b.counts['codes_used']
    assert [pose.stamp_ns for pose in a_poses] == [pose.stamp_ns for pose in b_poses]
    difference = np.array([p.pose for p in a_poses]) - [p.pose for p in b_poses]
    np.testing.assert_allclose(difference[:, :2], 0.0, atol=1e-6)
    np.testing.assert_allclose(wrap_angle(difference[:, 2]), 0.0, atol=1e-6)


def test_the_flight_closes_its_loop_and_changes_its_dictionary():
    ratslam, poses = fly(flight())
    assert ratslam.mapper.map.is_closure.any()
    assert ratslam.counts['code_books'] > 5
    assert ratslam.counts['codes_used'] > 190
    assert ratslam.counts['code_mismatches'] == 0
    corrected = np.hypot(*np.subtract(poses[-1].pose, poses[-1].odometry.pose)[:2])
    assert corrected > 0.3


@pytest.mark.parametrize('seed', range(6))
def test_map_and_poses_do_not_depend_on_the_order_of_arrival(seed):
    expected = fly(flight())
    assert_same_result(fly(shuffled(seed, lag_s=[0.05, 0.5, 2.0][seed % 3])), expected)


@pytest.mark.parametrize('source', KINDS)
def test_any_one_stream_may_lag_behind_the_others(source):
    assert_same_result(fly(shuffled(1, 3.0, sources=[source])), fly(flight()))


@pytest.mark.parametrize('seed, complete_every', [(1, 7), (2, 50), (3, 200)])
def test_map_and_poses_do_not_depend_on_how_long_reencoding_takes(seed, complete_every):
    late = fly(shuffled(seed, 0.3), LateExecutor(), complete_every)
    assert_same_result(late, fly(flight()))


def test_every_odometry_sample_has_one_pose_in_stamp_order():
    _, poses = fly(shuffled(0, 0.5))
    samples = [event for event in flight() if isinstance(event, OdometrySample)]
    assert [pose.odometry for pose in poses] == samples
    assert [pose.stamp_ns for pose in poses] == [sample.stamp_ns for sample in samples]


def test_an_update_is_told_for_every_code_used():
    told = []
    ratslam = RatSlam(CONFIG, on_update=lambda mapper: told.append(mapper.odometry.stamp_ns))
    for event in flight():
        add(ratslam, event)
        ratslam.advance(0.0)
    assert len(told) == ratslam.counts['codes_used']
    assert set(told) <= {event.stamp_ns for event in flight() if isinstance(event, Code)}


# Single events

def sample(time_s, segment=0):
    return OdometrySample(stamp_ns(time_s), pose_at(time_s), segment=segment)


def dictionary(time_s, seed=0):
    atoms = np.random.default_rng([seed, 2]).normal(0.0, 0.1, (16, N_PIXELS))
    return Dictionary(stamp_ns(time_s), atoms.astype(np.float32))


def view(time_s):
    rng = np.random.default_rng(stamp_ns(time_s))
    return View(stamp_ns(time_s), rng.integers(0, 256, (12, 16), dtype=np.uint8))


def code(time_s, dictionary_s=0.0):
    rng = np.random.default_rng([stamp_ns(time_s), 3])
    return Code(stamp_ns(time_s), rng.normal(size=16).astype(np.float32),
                None if dictionary_s is None else stamp_ns(dictionary_s))


def live_codes(times_s):
    """Return views and codes of a live dictionary: nothing but a view is waited for."""
    return [event for time_s in times_s for event in (view(time_s), code(time_s, None))]


def started(*rest, **changes):
    """Return a pipeline that has used one code, at 0 s, and then took in the rest."""
    ratslam = RatSlam(CONFIG.override(changes))
    for event in (sample(0.0), dictionary(0.0), view(0.0), code(0.0), *rest):
        add(ratslam, event)
    ratslam.advance(0.0)
    assert ratslam.counts['codes_used'] >= 1
    return ratslam


def poses_s(poses):
    return [round((pose.stamp_ns - stamp_ns(0.0)) * 1e-9, 6) for pose in poses]


@pytest.mark.parametrize('arrived, cause', [
    ([view(0.1)], 'codes_without_odometry'),
    ([sample(0.2)], 'codes_without_view'),
    ([sample(0.2), view(0.1)], 'codes_without_dictionary'),
])
def test_what_never_comes_is_given_up_after_the_longest_wait_and_counted(arrived, cause):
    ratslam = started(*arrived)
    ratslam.add_code(code(0.1, dictionary_s=0.1), 10.0)
    ratslam.advance(10.0 + WAIT_S)
    assert ratslam.counts[cause] == 0
    ratslam.advance(10.0 + WAIT_S + 0.01)
    assert ratslam.counts[cause] == 1
    assert ratslam.counts['codes_used'] == 1


@pytest.mark.parametrize('missing', range(3))
def test_what_comes_within_the_wait_is_used(missing):
    arrivals = [sample(0.2), view(0.1), dictionary(0.1)]
    late = arrivals.pop(missing)
    ratslam = started(*arrivals)
    ratslam.add_code(code(0.1, dictionary_s=0.1), 10.0)
    ratslam.advance(10.0 + WAIT_S / 2)
    assert ratslam.counts['codes_used'] == 1
    add(ratslam, late, 10.0)
    ratslam.advance(10.0 + WAIT_S / 2)
    assert ratslam.counts['codes_used'] == 2


def test_a_code_given_up_does_not_hold_up_the_next():
    ratslam = started(sample(0.3))
    ratslam.add_code(code(0.1), 10.0)
    ratslam.add_view(view(0.2))
    ratslam.add_code(code(0.2), 10.1)
    ratslam.advance(10.01 + WAIT_S)
    assert (ratslam.counts['codes_without_view'], ratslam.counts['codes_used']) == (1, 2)


def test_reencoding_holds_nothing_up_until_it_is_due_and_then_is_waited_for(monkeypatch):
    monkeypatch.setattr(CodeBook, 'PER_VIEW_NS', 10 ** 9)
    executor = LateExecutor()
    ratslam = RatSlam(CONFIG, executor)
    for event in (sample(0.0), dictionary(0.0), view(0.0), code(0.0), dictionary(0.1),
                  sample(9.0)):
        add(ratslam, event)
    for time_s in (0.2, 1.1, 1.2):
        for event in (view(time_s), code(time_s, dictionary_s=0.1)):
            add(ratslam, event)
    ratslam.advance(1e6)
    assert ratslam.counts['codes_used'] == 3
    executor.complete()
    ratslam.advance(1e6)
    assert (ratslam.counts['codes_used'], ratslam.counts['code_books']) == (4, 2)


def test_at_the_end_even_reencoding_that_is_due_is_waited_for(monkeypatch):
    monkeypatch.setattr(CodeBook, 'PER_VIEW_NS', 0)
    may_work = Event()
    with ThreadPoolExecutor(1) as executor:
        ratslam = RatSlam(CONFIG, executor)
        for event in (sample(0.0), dictionary(0.0), view(0.0), code(0.0), dictionary(0.1),
                      sample(9.0)):
            add(ratslam, event)
        executor.submit(may_work.wait, 10.0)
        for time_s in (0.2, 0.3):
            for event in (view(time_s), code(time_s, dictionary_s=0.1)):
                add(ratslam, event)
        ratslam.advance(1e6)
        assert ratslam.counts['codes_used'] == 2
        may_work.set()
        ratslam.advance(inf)
    assert (ratslam.counts['codes_used'], ratslam.counts['code_books']) == (3, 2)


def test_a_code_before_the_first_odometry_is_passed_over_and_counted():
    ratslam = RatSlam(CONFIG)
    for event in (dictionary(0.0), view(0.0), code(0.0), sample(1.0)):
        add(ratslam, event)
    ratslam.advance(0.0)
    assert (ratslam.counts['codes_before_odometry'], ratslam.counts['codes_used']) == (1, 0)


# Poses

def test_without_codes_poses_are_those_of_the_odometry_at_once():
    ratslam = RatSlam(CONFIG)
    for time_s in (0.0, 0.1, 0.5):
        ratslam.add_odometry(sample(time_s), 0.0)
        pose, = ratslam.advance(0.0)
        assert pose.pose == pytest.approx(pose.odometry.pose)
        assert pose.odometry == sample(time_s)
    assert ratslam.counts['poses_ahead_of_codes'] == 0


def test_a_pose_waits_only_once_the_next_code_is_due():
    ratslam = started()
    for time_s in (0.02, 0.06, 0.08, 0.1, 0.12):
        ratslam.add_odometry(sample(time_s), 10.0)
    assert poses_s(ratslam.advance(10.0)) == [0.02, 0.06]
    ratslam.add_view(view(0.1))
    ratslam.add_code(code(0.1), 10.0)
    assert poses_s(ratslam.advance(10.0)) == [0.08, 0.1, 0.12]
    assert ratslam.counts['poses_ahead_of_codes'] == 0


def test_a_pose_at_the_stamp_of_a_code_waits_for_it():
    ratslam = started()
    ratslam.add_code(code(0.1), 10.0)
    ratslam.add_odometry(sample(0.1), 10.0)
    assert ratslam.advance(10.0) == []
    ratslam.add_view(view(0.1))
    assert poses_s(ratslam.advance(10.0)) == [0.1]
    assert ratslam.counts['codes_used'] == 2


def test_when_the_encoder_dies_poses_wait_once_and_then_flow_at_once():
    ratslam = started()
    ratslam.add_odometry(sample(0.1), 10.0)
    assert ratslam.advance(10.0 + WAIT_S) == []
    assert poses_s(ratslam.advance(10.01 + WAIT_S)) == [0.1]
    assert ratslam.counts['poses_ahead_of_codes'] == 1
    for time_s in (0.2, 0.3, 5.0):
        ratslam.add_odometry(sample(time_s), 20.0)
        assert poses_s(ratslam.advance(20.0)) == [time_s]
    assert ratslam.counts['poses_ahead_of_codes'] == 1


def test_when_the_encoder_comes_back_poses_wait_for_its_codes_again():
    ratslam = started(sample(0.1))
    ratslam.advance(inf)
    for event in (dictionary(1.0, seed=5), view(1.0), code(1.0, 1.0), sample(1.0)):
        add(ratslam, event, 30.0)
    assert poses_s(ratslam.advance(30.0)) == [1.0]
    assert ratslam.counts['codes_used'] == 2
    ratslam.add_odometry(sample(1.2), 30.0)
    assert ratslam.advance(30.0) == []


def test_a_pose_is_the_correction_of_the_map_after_the_odometry():
    _, poses = fly(flight())
    for pose in poses[::100]:
        map_T_odom, odom_T_base = (np.array(
            [[np.cos(p.yaw_rad), -np.sin(p.yaw_rad), p.x_m],
             [np.sin(p.yaw_rad), np.cos(p.yaw_rad), p.y_m], [0, 0, 1]])
            for p in (pose.map_T_odom, pose.odometry.pose))
        np.testing.assert_allclose(
            (map_T_odom @ odom_T_base)[:2, 2], pose.pose[:2], atol=1e-9)
        assert pose.position_sigma_m >= 0.0 and pose.yaw_sigma_rad >= 0.0


# Sampling

@pytest.mark.parametrize('rate_hz, used_hz', [
    (10, 10), (20, 10), (25, 10), (30, 10), (60, 10), (100, 10), (4, 4)])
def test_of_a_fast_camera_a_code_each_period_is_used(rate_hz, used_hz):
    """Frames come whole; on average the period is kept."""
    times_s = np.arange(0.0, 4.0, 1 / rate_hz).tolist()
    ratslam = RatSlam(CONFIG)
    for event in [sample(0.0), sample(5.0), *live_codes(times_s)]:
        add(ratslam, event)
    ratslam.advance(0.0)
    assert ratslam.counts['codes_received'] == len(times_s)
    assert ratslam.counts['codes_used'] == pytest.approx(4.0 * used_hz, abs=1)


def test_no_code_is_lost_to_the_jitter_of_a_camera_of_the_right_rate():
    jitter_s = np.random.default_rng(0).uniform(-0.012, 0.012, 100)
    ratslam = RatSlam(CONFIG)
    times_s = (0.1 * np.arange(1, 101) + jitter_s).tolist()
    for event in [sample(0.0), sample(11.0), *live_codes(times_s)]:
        add(ratslam, event)
    ratslam.advance(0.0)
    assert ratslam.counts['codes_used'] == 100


# A changing encoder

def test_an_encoder_that_starts_again_from_another_dictionary_leaves_the_map_valid():
    """The second encoder begins anew half-way, from another seed; loops still close across it."""
    half_ns = stamp_ns(0.8 * LAP_S)
    restarted = [event for event in encode(
        events(FLIGHT_S), CONFIG.override({'encoder.seed': 9})).events if event.stamp_ns >= half_ns
        and not isinstance(event, OdometrySample)]
    first = next(k for k, event in enumerate(restarted) if isinstance(event, Dictionary))
    before = [event for event in flight()
              if event.stamp_ns < half_ns or isinstance(event, OdometrySample)]
    ratslam, _ = fly(sorted([*before, *restarted[first:]], key=stamp_of))
    assert ratslam.mapper.map.is_closure.any()
    assert ratslam.counts['code_mismatches'] == 0
    assert ratslam.counts['codes_used'] > 150
    assert not any(key.startswith('codes_without') for key in ratslam.counts)


@pytest.mark.parametrize('changes', [
    {'encoder.lambda_1': 1.0}, {'view.standardise': False}])
def test_an_encoder_configured_otherwise_is_noticed(changes):
    otherwise = encode(events(6.0), CONFIG.override(changes)).events
    ratslam, _ = fly(otherwise)
    assert ratslam.counts['code_mismatches'] >= 1


def test_codes_that_match_again_are_noticed_at_the_next():
    ratslam, matched = RatSlam(CONFIG), []
    wrong = [event for event in flight() if isinstance(event, Code)][RatSlam.CHECK_EVERY]
    for event in flight():
        add(ratslam, replace(event, values=2 * event.values) if event is wrong else event)
        n_used = ratslam.counts['codes_used']
        ratslam.advance(0.0)
        matched += [ratslam.codes_match] * (ratslam.counts['codes_used'] - n_used)
    assert [k for k, matches in enumerate(matched) if not matches] == [RatSlam.CHECK_EVERY]


def test_codes_of_a_live_dictionary_are_not_checked():
    ratslam = RatSlam(CONFIG)
    for event in [sample(0.0), sample(1.0), *live_codes([0.0, 0.1, 0.2])]:
        add(ratslam, event)
    ratslam.advance(0.0)
    assert (ratslam.counts['codes_used'], ratslam.counts['code_mismatches']) == (3, 0)


# What is refused

@pytest.mark.parametrize('event, cause', [
    (Dictionary(stamp_ns(0.1), np.zeros((16, 5), np.float32)), 'dictionaries_of_another_shape'),
    (Dictionary(stamp_ns(0.1), np.zeros((8, N_PIXELS), np.float32)),
     'dictionaries_of_another_shape'),
    (View(stamp_ns(0.1), np.zeros((16, 12), np.uint8)), 'views_of_another_shape'),
    (Dictionary(stamp_ns(0.1), np.zeros((16, N_PIXELS), np.float32)), 'dictionaries_unusable'),
    (Dictionary(stamp_ns(0.1), np.full((16, N_PIXELS), 1e25, np.float32)),
     'dictionaries_unusable'),
    (Code(stamp_ns(0.1), np.zeros(15, np.float32), None), 'codes_of_another_length'),
    (Code(stamp_ns(0.1), np.full(16, np.nan, np.float32), None), 'codes_not_finite'),
    (code(0.0), 'codes_out_of_order'),
    (code(-0.5), 'codes_out_of_order'),
])
def test_what_does_not_fit_is_refused_and_counted(event, cause):
    ratslam = started()
    before = ratslam.counts.copy()
    add(ratslam, event)
    ratslam.advance(0.0)
    assert ratslam.counts - before == {cause: 1}


def test_views_that_nobody_asks_for_do_not_pile_up():
    ratslam = started()
    for k in range(RatSlam.MAX_VIEWS + 50):
        ratslam.add_view(view(1.0 + 0.1 * k))
    assert ratslam.counts['views_without_code'] == 50
    for event in (sample(9.0), code(1.0), code(6.0)):
        add(ratslam, event)
    ratslam.advance(inf)
    assert (ratslam.counts['codes_without_view'], ratslam.counts['codes_used']) == (1, 2)


# A clock that starts again

def test_a_flight_played_again_goes_on_in_the_same_map():
    ratslam, _ = fly(flight())
    n = len(ratslam.mapper.map)
    again = [replace(event, segment=1) if isinstance(event, OdometrySample) else event
             for event in flight()]
    for event in again:
        add(ratslam, event)
        ratslam.advance(0.0)
    assert ratslam.counts['codes_clock_jumps'] == 1
    assert ratslam.counts['codes_used'] > 380
    assert len(ratslam.mapper.map) < 2 * n
    assert np.isfinite(ratslam.mapper.map.poses).all()
    crossing = (ratslam.mapper.map.links < n).any(axis=1) & (
        ratslam.mapper.map.links >= n).any(axis=1)
    assert ratslam.mapper.map.is_closure[crossing].all()


def test_a_code_from_before_the_clock_fell_back_does_not_hold_up_those_after_it():
    ratslam = started(sample(50.0), *live_codes([50.0]))
    ratslam.add_odometry(sample(10.0, segment=1), 40.0)
    ratslam.add_odometry(sample(10.5, segment=1), 40.0)
    for event in live_codes([50.1, 10.2]):
        add(ratslam, event, 40.0)
    used = ratslam.counts['codes_used']
    ratslam.advance(40.0)
    assert ratslam.counts['codes_used'] == used + 1


def test_poses_flow_again_when_the_clock_falls_back():
    ratslam = started(sample(50.0))
    ratslam.advance(inf)
    ratslam.add_odometry(sample(10.0, segment=1), 40.0)
    assert poses_s(ratslam.advance(40.0)) == [10.0]


def test_codes_that_a_clock_jump_leaves_waiting_are_counted():
    ratslam = started(sample(50.0), *live_codes([50.1, 50.2]))
    ratslam.add_odometry(sample(10.0, segment=1), 40.0)
    assert ratslam.counts['codes_before_clock_jump'] == 2


def test_a_camera_whose_clock_falls_back_does_not_end_the_node():
    ratslam = started(*(sample(t / 10) for t in range(1, 60)), *live_codes([4.0, 4.2, 4.4]))
    for event in live_codes([2.2]):
        add(ratslam, event)
    ratslam.advance(0.0)
    assert ratslam.counts['codes_clock_jumps'] == 1
    add(ratslam, sample(6.0))
    ratslam.advance(100.0)
    assert ratslam.counts['codes_before_odometry'] == 1


def test_poses_go_on_from_where_they_were_when_odometry_is_reset():
    """The new segment starts 50 m away; the robot does not."""
    moved = replace(sample(1.1), pose=Pose2(-50.0, 3.0, 1.0), segment=1)
    ahead = Pose2(-50.0 + cos(1.0), 3.0 + sin(1.0), 1.0)
    further = replace(moved, stamp_ns=stamp_ns(1.2), pose=ahead)
    ratslam = started(sample(1.0), moved, further)
    before, at_reset, after = ratslam.advance(100.0)[-3:]
    np.testing.assert_allclose(at_reset.pose, before.pose, atol=1e-12)
    step = between(before.pose, after.pose)
    np.testing.assert_allclose(step, (1.0, 0.0, 0.0), atol=1e-12)
    assert at_reset.position_sigma_m == inf


def test_poses_grow_less_certain_without_codes():
    ratslam = RatSlam(CONFIG)
    for t in range(100):
        add(ratslam, sample(float(t)))
    poses = ratslam.advance(0.0)
    position, yaw = ([getattr(pose, name) for pose in poses]
                     for name in ('position_sigma_m', 'yaw_sigma_rad'))
    assert (np.diff(position) > 0).all() and (np.diff(yaw) > 0).all()
    assert position[-1] > 0.5 and yaw[-1] > 0.5


def test_poses_are_finite_after_the_odometry_was_reset():
    ratslam = started(
        sample(0.1), *live_codes([0.1]), replace(sample(0.2, segment=1), pose=Pose2(0, 0, 0)),
        *live_codes([0.2]), sample(0.21, segment=1))
    pose = ratslam.advance(inf)[-1:]
    assert ratslam.counts['codes_used'] == 3
    assert all(np.isfinite(p.pose).all() and not np.isnan(p.position_sigma_m) for p in pose)
