"""A map outlives the flight: kept, gone on in, left as it is, refused when unsound."""

from dataclasses import replace
from functools import lru_cache
from math import inf

from loop_flight import CONFIG, events, LAP_S, LateExecutor, START_NS, stamp_ns
import numpy as np
import pytest

from dlsc_qbs_ros.config import Config
from dlsc_qbs_ros.core.drift import rectified
from dlsc_qbs_ros.core.geometry import between, compose
from dlsc_qbs_ros.core.sequence import SequenceScore
from dlsc_qbs_ros.core.types import (
    Code, Dictionary, IDENTITY, OdometrySample, Pose2, PoseEstimate, View)
from dlsc_qbs_ros.errors import MapError
from dlsc_qbs_ros.io.map_file import read_map, write_map
from dlsc_qbs_ros.pipeline.encoder import Encoder
from dlsc_qbs_ros.pipeline.follower import Follower
from dlsc_qbs_ros.pipeline.map_state import ARRAYS, refuse_other
from dlsc_qbs_ros.pipeline.ratslam import RatSlam
from dlsc_qbs_ros.pipeline.runner import encode

FLIGHT_S = 1.7 * LAP_S
HALF_NS = stamp_ns(1.2 * LAP_S)
ELSEWHERE = Pose2(30.0, -5.0, 2.0)


@lru_cache(maxsize=None)
def flight(world=0, encoder_seed=0):
    """Return what reaches ratslam in a flight of a lap and more."""
    config = CONFIG.override({'encoder.seed': encoder_seed})
    return encode(events(FLIGHT_S, world), config, Encoder(config)).events


def later(flown, seconds, frame=None, segment=0):
    """Return a flight as it would be at another time, its odometry in another frame."""
    shift_ns = round(seconds * 1e9)

    def shifted(event):
        event = replace(event, stamp_ns=event.stamp_ns + shift_ns)
        if isinstance(event, Code) and event.dictionary_ns is not None:
            return replace(event, dictionary_ns=event.dictionary_ns + shift_ns)
        if isinstance(event, OdometrySample) and frame is not None:
            return replace(event, pose=compose(frame, event.pose), segment=segment)
        return event
    return [shifted(event) for event in flown]


def fly(ratslam, flown, end_s=inf):
    """Feed a flight; return the poses that came out."""
    add = {OdometrySample: ratslam.add_odometry, Dictionary: ratslam.add_dictionary,
           View: ratslam.add_view, Code: ratslam.add_code}
    poses = []
    for event in flown:
        add[type(event)](event)
        poses += ratslam.advance(0.0)
    return poses + ratslam.advance(end_s)


def first_part():
    return [event for event in flight() if event.stamp_ns <= HALF_NS]


def second_part():
    """Return the rest of the flight, after the dictionary that its codes refer to."""
    last = [event for event in first_part() if isinstance(event, Dictionary)][-1]
    return [last, *(event for event in flight() if event.stamp_ns > HALF_NS)]


@lru_cache(maxsize=None)
def saved():
    """Return the map of the first part of the flight; not to be written to."""
    ratslam = RatSlam(CONFIG)
    fly(ratslam, first_part())
    return ratslam.state()


def restored(state=None):
    ratslam = RatSlam(CONFIG)
    ratslam.restore(saved() if state is None else state)
    return ratslam


def assert_same(a, b):
    assert a.keys() == b.keys() == ARRAYS.keys()
    for name in a:
        np.testing.assert_array_equal(a[name], b[name], err_msg=name)


def crossings(ratslam, n):
    """Return the links between the first n experiences and the others."""
    links = ratslam.mapper.map.links
    return links[(links < n).any(axis=1) & (links >= n).any(axis=1)].tolist()


# Kept

def test_a_map_goes_through_a_file_and_comes_out_the_same(tmp_path):
    write_map(tmp_path / 'a.map', CONFIG.flat(), saved())
    config, arrays = read_map(tmp_path / 'a.map')
    refuse_other(config, CONFIG)
    assert_same(restored(arrays).state(), saved())


def test_what_is_kept_is_not_changed_by_what_comes_later():
    ratslam = RatSlam(CONFIG)
    fly(ratslam, first_part())
    state = ratslam.state()
    fly(ratslam, second_part())
    assert_same(state, saved())


def test_there_is_nothing_to_keep_before_the_first_code():
    with pytest.raises(MapError, match='there is no map yet'):
        RatSlam(CONFIG).state()


def test_codes_of_a_live_dictionary_are_kept_as_they_are():
    live = [replace(event, dictionary_ns=None) if isinstance(event, Code) else event
            for event in first_part() if not isinstance(event, Dictionary)]
    ratslam = RatSlam(CONFIG)
    fly(ratslam, live)
    state = ratslam.state()
    assert len(state['view_cell_codes']) == len(ratslam.mapper.view_cells)
    np.testing.assert_allclose(restored(state).mapper.view_cells.kept,
                               ratslam.mapper.view_cells.kept, atol=1e-6)


# Gone on in

def test_where_odometry_went_on_a_node_that_starts_again_goes_on_too():
    undisturbed, again = RatSlam(CONFIG), restored()
    fly(undisturbed, [*first_part(), *second_part()])
    poses = fly(again, second_part())
    assert again.is_localised
    assert again.mapper.map.is_closure.any()
    assert set(again.mapper.journey.pieces.of()) == {0}
    assert max(pose.position_sigma_m for pose in poses) < 1.0
    apart = between(undisturbed.mapper.pose(), again.mapper.pose())
    assert apart[:2] == pytest.approx((0.0, 0.0), abs=0.3)


@pytest.mark.parametrize('seconds, frame', [(40.0, None), (-40.0, None), (1.0, ELSEWHERE)])
def test_other_odometry_is_not_taken_for_the_same(seconds, frame):
    """It comes too late, or from the past, or is somewhere else."""
    ratslam = restored()
    poses = fly(ratslam, later(second_part()[:30], seconds, frame))
    assert not ratslam.is_localised
    assert {pose.position_sigma_m for pose in poses} == {inf}


def test_a_second_session_finds_itself_and_extends_the_map_of_the_first():
    ratslam, n = restored(), len(saved()['experience_poses'])
    before = ratslam.mapper.map.poses.copy()
    fly(ratslam, later(flight(), 1000.0, ELSEWHERE))
    assert ratslam.is_localised
    assert len(crossings(ratslam, n)) > 0
    assert set(ratslam.mapper.journey.pieces.of()) == {0}
    moved = np.hypot(*(ratslam.mapper.map.poses[:n] - before)[:, :2].T)
    assert moved.max() < 0.5
    assert len(ratslam.mapper.map) > n


def test_a_map_is_valid_for_an_encoder_that_started_again_from_another_dictionary():
    ratslam, n = restored(), len(saved()['experience_poses'])
    fly(ratslam, later(flight(encoder_seed=7), 1000.0, ELSEWHERE))
    assert ratslam.is_localised
    assert len(crossings(ratslam, n)) > 0


def test_in_another_world_nothing_is_recognised():
    ratslam, n = restored(), len(saved()['experience_poses'])
    fly(ratslam, later(flight(world=5), 1000.0, ELSEWHERE))
    assert not ratslam.is_localised
    assert crossings(ratslam, n) == []


def test_a_drone_that_was_carried_away_in_flight_joins_what_it_maps_to_what_it_had():
    ratslam = RatSlam(CONFIG)
    fly(ratslam, first_part())
    n = len(ratslam.mapper.map)
    poses = fly(ratslam, later(flight(), 100.0, ELSEWHERE, segment=1))
    assert poses[0].position_sigma_m == inf
    assert poses[-1].position_sigma_m < 1.0
    assert len(crossings(ratslam, n)) > 0


# Left as it is

@lru_cache(maxsize=None)
def localised():
    """Return a pipeline that flew a second session in the map, and the poses."""
    ratslam = restored()
    ratslam.keep_map(True)
    return ratslam, fly(ratslam, later(flight(), 1000.0, ELSEWHERE))


def test_a_map_that_is_kept_as_it_is_gives_the_same_file_before_and_after(tmp_path):
    ratslam, _ = localised()
    for name, state in (('before', saved()), ('after', ratslam.state())):
        write_map(tmp_path / name, CONFIG.flat(), state)
    assert (tmp_path / 'before').read_bytes() == (tmp_path / 'after').read_bytes()


def test_nothing_of_a_map_that_is_kept_changes_behind_the_file():
    ratslam, _ = localised()
    now = ratslam.mapper.state()
    for name in now.keys() & {name for name in ARRAYS if name.startswith(
            ('experience_', 'link_', 'view_cell_pose', 'visit_', 'closure_'))}:
        np.testing.assert_array_equal(now[name], saved()[name], err_msg=name)
    assert len(ratslam.mapper.view_cells) == len(saved()['view_cell_views'])


def test_the_pose_is_still_corrected_where_the_map_is_kept_as_it_is():
    """The robot ends half a lap on; odometry bends by 0.02 rad/s."""
    ratslam, poses = localised()
    assert ratslam.is_localised
    assert poses[0].position_sigma_m == inf
    assert poses[-1].position_sigma_m < 1.0
    undisturbed = RatSlam(CONFIG)
    expected = fly(undisturbed, flight())
    apart = between(expected[-1].pose, poses[-1].pose)
    assert apart[:2] == pytest.approx((0.0, 0.0), abs=0.5)


def test_a_map_that_grows_again_is_linked_to_where_the_robot_is():
    ratslam = restored()
    ratslam.keep_map(True)
    fly(ratslam, later(flight(), 1000.0, ELSEWHERE))
    n = len(ratslam.mapper.map)
    ratslam.keep_map(False)
    assert ratslam.is_localised
    fly(ratslam, later(flight(world=5), 1000.0 + FLIGHT_S, ratslam.mapper.odometry.pose))
    assert len(ratslam.mapper.map) > n
    assert len(crossings(ratslam, n)) > 0
    assert set(ratslam.mapper.journey.pieces.of()) == {0}


def test_where_a_map_grows_again_is_no_part_of_the_matches_before_or_after():
    """So it stays when those turn out to be wrong, and the way on with it."""
    ratslam = RatSlam(CONFIG)
    fly(ratslam, first_part())
    n = len(ratslam.mapper.visits.run.values)
    ratslam.keep_map(True)
    fly(ratslam, second_part()[:60])
    ratslam.keep_map(False)
    fly(ratslam, second_part()[60:])
    runs = ratslam.mapper.visits.run.values
    assert len(runs) > n + 1
    assert np.count_nonzero(runs == runs[n]) == 1


def test_without_a_map_there_is_nothing_to_be_localised_in():
    with pytest.raises(MapError, match='there is no map yet'):
        RatSlam(CONFIG).keep_map(True)


def test_poses_do_not_wait_for_the_views_of_a_loaded_map_to_be_encoded():
    executor = LateExecutor()
    ratslam = RatSlam(CONFIG, executor)
    ratslam.restore(saved())
    flown = later(second_part(), 1000.0)
    n = sum(isinstance(event, OdometrySample) for event in flown[:100])
    assert len(fly(ratslam, flown[:100], end_s=0.0)) == n
    assert ratslam.counts['poses_ahead_of_codes'] == ratslam.counts['codes_used'] == 0
    executor.complete()
    fly(ratslam, flown[100:110], end_s=0.0)
    assert ratslam.counts['codes_used'] > 0
    assert ratslam.counts['codes_without_view'] == 0


# Paused, forgotten, told

def with_known_errors():
    """Return what has flown the first part, with odometry that is known to tell too much, too."""
    ratslam = RatSlam(CONFIG)
    fly(ratslam, first_part())
    (error, scale), = ratslam.mapper.visits.odometry.errors
    assert abs(error) > 1e-4 and scale == 0.0
    ratslam.mapper.visits.calibrate(np.array([[error, 0.05]]))
    return ratslam


def followed(ratslam, poses):
    """Return the last of the poses by odometry, less the errors that are known of it."""
    (error, scale), = ratslam.mapper.visits.odometry.errors
    pose = poses[0].pose
    for last, now in zip(poses, poses[1:]):
        motion = np.array([between(last.odometry.pose, now.odometry.pose)])
        turn_rad = error * (now.stamp_ns - last.stamp_ns) * 1e-9
        pose = compose(pose, Pose2(*rectified(
            motion, np.array([turn_rad]), np.array([scale]))[0]))
    return pose


def test_where_no_code_comes_the_pose_goes_on_without_the_known_errors_of_the_odometry():
    ratslam = with_known_errors()
    poses = fly(ratslam, [event for event in second_part() if isinstance(event, OdometrySample)])
    expected = followed(ratslam, poses)
    assert poses[-1].pose == pytest.approx(expected, abs=1e-9)
    assert between(poses[0].track, poses[-1].track) == pytest.approx(
        between(poses[0].pose, expected), abs=1e-9)


def test_a_code_that_comes_late_moves_the_pose_by_nothing_but_what_it_tells():
    """The last one that was used is told again, when odometry is 2 s ahead of it."""
    ratslam = with_known_errors()
    mapper = ratslam.mapper
    follower = Follower(CONFIG, mapper)
    samples = [mapper.odometry, *(
        event for event in second_part() if isinstance(event, OdometrySample))][:102]
    poses = [follower.follow(sample) for sample in samples[:-1]]
    follower.correct(mapper.odometry)
    poses.append(follower.follow(samples[-1]))
    assert poses[-1].stamp_ns - mapper.odometry.stamp_ns > 1.9e9
    error = between(followed(ratslam, poses), poses[-1].pose)
    assert error == pytest.approx(IDENTITY, abs=0.01)


def test_once_the_odometry_has_broken_its_error_is_not_known_any_more():
    ratslam = RatSlam(CONFIG)
    fly(ratslam, first_part())
    poses = fly(ratslam, [replace(event, segment=1) for event in second_part()
                          if isinstance(event, OdometrySample)])
    assert between(poses[0].pose, poses[-1].pose) == pytest.approx(
        between(poses[0].odometry.pose, poses[-1].odometry.pose), abs=1e-9)


def test_a_robot_that_finds_nothing_in_a_map_that_stays_goes_on_by_its_odometry():
    """Less the known errors, step by step: its way turns meanwhile."""
    ratslam = with_known_errors()
    mapper = ratslam.mapper
    mapper.is_mapping = False
    poses = []
    for sample in second_part():
        if isinstance(sample, OdometrySample):
            mapper.update(sample, np.zeros(mapper.view_cells.kept.shape[1], np.float32))
            poses.append(PoseEstimate(
                sample.stamp_ns, mapper.pose(), sample, IDENTITY, IDENTITY, 0.0, 0.0))
    assert poses[-1].pose == pytest.approx(followed(ratslam, poses), abs=1e-6)


def test_while_paused_the_map_stands_still_and_the_pose_follows_the_odometry():
    ratslam = with_known_errors()
    n = len(ratslam.mapper.map)
    ratslam.is_paused = True
    assert ratslam.activity == 'paused'
    poses = fly(ratslam, second_part())
    assert len(ratslam.mapper.map) == n
    assert poses[-1].pose == pytest.approx(followed(ratslam, poses[10:]), abs=1e-4)
    assert poses[-1].position_sigma_m > poses[0].position_sigma_m


@pytest.mark.parametrize('is_first', [True, False])
def test_paused_without_a_map_the_pose_is_that_of_the_odometry(is_first):
    ratslam = RatSlam(CONFIG)
    if not is_first:
        fly(ratslam, first_part())
        ratslam.reset()
    ratslam.is_paused = True
    flown = later(flight(), 1000.0)
    broken = [replace(event, segment=1) if isinstance(event, OdometrySample) else event
              for event in later(flight(), 2000.0)]
    poses = fly(ratslam, flown)
    assert [tuple(pose.pose) for pose in poses] == [
        pytest.approx(tuple(pose.odometry.pose), abs=1e-9) for pose in poses]
    fly(ratslam, broken[:200])
    assert len(ratslam.mapper.map) == 0
    ratslam.is_paused = False
    fly(ratslam, broken[200:400])
    assert len(ratslam.mapper.map) > 0
    assert ratslam.is_localised


def test_after_a_reset_another_map_begins_with_the_same_dictionary():
    ratslam = RatSlam(CONFIG)
    fly(ratslam, first_part())
    ratslam.reset()
    assert len(ratslam.mapper.map) == 0
    fly(ratslam, second_part()[1:])
    assert len(ratslam.mapper.map) > 0
    assert ratslam.counts['codes_without_dictionary'] == 0
    assert ratslam.is_localised


def test_a_pose_that_is_told_is_believed_as_well_as_it_is_known():
    ratslam = restored()
    told = compose(ratslam.mapper.map.pose(20), Pose2(0.1, 0.0, 0.0))
    flown = later(second_part(), 1000.0)
    assert fly(ratslam, flown[:20])[-1].position_sigma_m == inf
    ratslam.put(told, 0.4, 0.2)
    assert ratslam.is_localised
    pose = fly(ratslam, flown[20:40])[0]
    # One sample of odometry on.
    assert between(told, pose.pose) == pytest.approx((0.02, 0.0, 0.01), abs=0.01)
    assert 0.4 <= pose.position_sigma_m < 0.6
    assert 0.2 <= pose.yaw_sigma_rad < 0.3


def test_the_first_pose_of_all_may_be_told():
    ratslam = RatSlam(CONFIG)
    ratslam.put(Pose2(5.0, 6.0, 0.5), 0.4, 0.2)
    fly(ratslam, first_part()[:60])
    assert ratslam.mapper.map.pose(0) == pytest.approx(Pose2(5.0, 6.0, 0.5))


def test_the_first_pose_goes_along_with_the_odometry_until_the_first_code():
    ratslam = RatSlam(CONFIG)
    start, *flown = [
        event for event in flight() if event.stamp_ns < stamp_ns(3.05)
        and (isinstance(event, (OdometrySample, Dictionary)) or event.stamp_ns > stamp_ns(3.0))]
    fly(ratslam, [start])
    told = Pose2(5.0, 6.0, 0.5)
    ratslam.put(told, 0.4, 0.2)
    fly(ratslam, flown)
    assert len(ratslam.mapper.map) == 1
    assert ratslam.mapper.map.pose(0) == pytest.approx(
        compose(told, between(start.pose, ratslam.mapper.odometry.pose)))


def test_a_pose_told_before_the_first_odometry_in_a_loaded_map_is_where_that_begins():
    ratslam = restored()
    told = ratslam.mapper.map.pose(5)
    ratslam.put(told, 0.4, 0.2)
    first, *_ = fly(ratslam, later(second_part(), 1000.0, ELSEWHERE)[:40])
    assert first.pose == pytest.approx(told)
    assert 0.4 <= first.position_sigma_m < 0.6
    assert ratslam.is_localised


def test_a_lost_robot_that_is_told_its_pose_is_put_in_the_map_and_not_in_what_it_mapped_since():
    ratslam = RatSlam(CONFIG.override({
        'ratslam.threshold': 1.0, 'ratslam.tracking_threshold': 1.0}))
    fly(ratslam, first_part())
    fly(ratslam, [replace(event, segment=1) if isinstance(event, OdometrySample) else event
                  for event in second_part()])
    assert not ratslam.is_localised
    ratslam.put(ratslam.mapper.map.pose(len(ratslam.mapper.map) - 1), 0.4, 0.2)
    assert ratslam.is_localised


@pytest.mark.parametrize('n_before', [0, 3, 40])
def test_codes_on_their_way_when_a_pose_is_told_do_not_take_it_back(n_before):
    """The robot is lost: odometry has broken, just now or samples ago, and codes lag behind."""
    ratslam = RatSlam(CONFIG)
    broken = later(second_part(), 0.0, ELSEWHERE, segment=1)
    odometry = [event for event in broken if isinstance(event, OdometrySample)][:n_before + 1]
    late = [event for event in [*first_part(), *broken] if not isinstance(event, OdometrySample)
            and HALF_NS - 200_000_000 < event.stamp_ns <= odometry[-1].stamp_ns]
    fly(ratslam, [event for event in first_part()
                  if isinstance(event, OdometrySample) or event.stamp_ns < late[0].stamp_ns])
    fly(ratslam, odometry)
    told = ratslam.mapper.map.pose(20)
    ratslam.put(told, 0.4, 0.2)
    fly(ratslam, late, 0.0)
    assert ratslam.counts['codes_before_told_pose'] >= 1
    assert ratslam.is_localised
    assert ratslam.mapper.pose() == pytest.approx(told)
    assert ratslam.mapper.sigmas()[0] < 0.6
    before = ratslam.counts.copy()
    fly(ratslam, [event for event in broken if event.stamp_ns > odometry[-1].stamp_ns][:30], 0.0)
    new = ratslam.counts - before
    assert new['codes_used'] > 1 and not new['codes_before_told_pose']


# Refused

def test_a_map_in_which_one_view_was_met_over_and_over_is_a_map():
    config = CONFIG.override({'ratslam.backend': 'published'})
    ratslam = RatSlam(config)
    fly(ratslam, first_part())
    code = [event for event in first_part() if isinstance(event, Code)][-1].values
    for _ in range(150):
        ratslam.mapper.update(ratslam.mapper.odometry, code)
    assert ratslam.state()['view_cell_decays'].max() > 100.0
    RatSlam(config).restore(ratslam.state())


def test_a_map_whose_last_views_lie_as_far_apart_as_views_may_is_a_map():
    score, stations = SequenceScore(200), np.arange(5)
    for _ in range(200):
        score.update(np.zeros(5, np.float32), stations)
        score.skip(200, stations)
    RatSlam(CONFIG).restore(changed('looks', with_value(score.state(5)['looks'].max())))


def changed(name, change):
    array = np.array(saved()[name])
    return {**saved(), name: change(array)}


def with_value(value, at=0):
    def change(array):
        array.reshape(-1)[at] = value
        return array
    return change


@pytest.mark.parametrize('name, change, said', [
    ('link_ends', lambda array: array[:, :1], 'shape'),
    ('link_ends', with_value(10**6), 'indices below'),
    ('link_ends', with_value(-1), 'indices below'),
    ('link_ends', lambda array: np.repeat(array[:1], len(array), axis=0), 'expected one between'),
    ('link_motions', lambda array: array[1:], r'the shape'),
    ('link_makers', with_value(10**6), 'visits'),
    ('experience_poses', with_value(np.nan), 'finite'),
    ('experience_poses', with_value(np.inf), 'finite'),
    ('experience_poses', lambda array: array.astype(np.float32), 'axes of <f8'),
    ('experience_births', with_value(10**6), 'indices below'),
    ('experience_view_cells', with_value(1), 'an experience for every view cell'),
    ('view_cell_views', lambda array: array[:, 1:], 'the shape'),
    ('view_cell_views', lambda array: array.astype(float), r'3 axes of \|u1'),
    ('view_cell_decays', with_value(-1.0), 'a decay'),
    ('visit_flown', with_value(-1.0), 'never falls'),
    ('visit_flown', with_value(1e8, at=-1), 'never falls'),
    ('robot_flown', with_value(1e8, at=-1), 'never falls'),
    ('visit_runs', with_value(10**6), 'runs there were'),
    ('visit_experiences', with_value(10**6), 'indices below'),
    ('closure_visits', lambda array: array + 10**6, 'indices below'),
    ('looks', with_value(-1), 'stations and view cells'),
    ('looks', with_value(10**7), 'stations and view cells'),
    ('look_likenesses', lambda array: array[:, 1:], 'the shape'),
    ('robot_stand', with_value(10**6), 'a visit'),
    ('odometry_errors', with_value(-1e3), 'errors of segments'),
    ('odometry_errors', lambda errors: errors + (0.0, 1.5), 'errors of segments'),
    ('odometry_errors', lambda errors: np.vstack([errors, (0.0, 0.0)]), 'errors of segments'),
    ('robot_drift', with_value(-1.0), 'none below 0'),
    ('gyro', lambda gyro: -gyro, 'variances and a noise'),
    ('gyro', lambda gyro: gyro * (1, 1, 1, 1, 1, 0), 'variances and a noise'),
    ('gyro', lambda gyro: gyro * (1, 1, 1e9, 1, 1, 1), 'variances and a noise'),
    ('put_segments', lambda array: np.array([[0, 9]]), 'segments there were'),
    ('pose_cells', lambda array: 0.0 * array, 'some activity'),
    ('dictionaries', lambda array: 0.0 * array, 'not all 0'),
    ('dictionaries', lambda array: array[:, 1:], 'the shape'),
    ('dictionaries', lambda array: array[:0], 'the shape'),
    ('view_cell_codes', lambda array: np.ones((3, array.shape[1]), np.float32), 'either all'),
])
def test_what_no_map_could_be_is_refused_and_the_present_one_stays(name, change, said):
    ratslam = restored()
    before = ratslam.state()
    with pytest.raises(MapError, match=said):
        ratslam.restore(changed(name, change))
    assert_same(ratslam.state(), before)


def test_arrays_that_are_missing_or_unknown_are_named():
    state = dict(saved())
    with pytest.raises(MapError, match="unknown array 'extra'"):
        RatSlam(CONFIG).restore({**state, 'extra': np.zeros(1)})
    del state['link_ends']
    with pytest.raises(MapError, match="missing array 'link_ends'"):
        RatSlam(CONFIG).restore(state)


@pytest.mark.parametrize('key, value', [
    ('view.width', 43), ('view.crop_top', 0.1), ('encoder.input', 'patches'),
    ('encoder.mode', 'paper'), ('encoder.n_atoms', 32), ('pose_cells.cell_size_m', 0.5)])
def test_a_map_made_with_another_configuration_is_refused_with_the_reason(key, value):
    other = CONFIG.override({key: value})
    with pytest.raises(MapError, match=f'made with {key} = .*: expected'):
        refuse_other(other.flat(), CONFIG)


def test_thresholds_may_be_others_than_the_map_was_made_with():
    refuse_other(CONFIG.override({'ratslam.threshold': 0.5}).flat(), CONFIG)


@pytest.mark.parametrize('seed', range(12))
def test_a_map_with_nonsense_in_it_is_refused_or_flown_in_without_an_error(seed):
    rng = np.random.default_rng(seed)
    state = {name: np.array(array) for name, array in saved().items()}
    for name in rng.choice(sorted(ARRAYS), 3).tolist():
        flat = state[name].reshape(-1)
        if flat.size:
            at = rng.integers(flat.size, size=5)
            flat[at] = rng.permutation(flat)[:1] + rng.integers(-1, 2)
    try:
        ratslam = restored(state)
    except MapError:
        return
    fly(ratslam, second_part())
    assert len(ratslam.state()['experience_poses']) > 0


def test_the_default_configuration_has_shapes_for_every_word():
    words = {word for spec in ARRAYS.values() for word in spec.shape if isinstance(word, str)}
    assert {spec.index_of for spec in ARRAYS.values() if spec.index_of} <= words
    assert Config().encoder.n_atoms > 0 and START_NS > 0
