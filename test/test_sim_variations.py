"""What makes simulated flights harder: each does what it says, and nothing else changes."""

from dataclasses import replace
from math import pi

from hall import assert_clear_of_walls_and_shelves
import numpy as np
import pytest

from dlsc_qbs_ros.core.geometry import between, wrap_angle
from dlsc_qbs_ros.core.types import Pose2
from dlsc_qbs_ros.errors import ConfigError
from dlsc_qbs_ros.sim import flight, schedule, world
from dlsc_qbs_ros.sim.camera import Camera
from dlsc_qbs_ros.sim.schedule import lamps, Schedule
from dlsc_qbs_ros.sim.simulation import EPOCH_NS, simulate_flight
from dlsc_qbs_ros.sim.variations import ALTITUDE_M, EACH, PLAIN, Variations

FLIGHTS = (1, 2, 3)
STEP_S = 0.02
ALL = Variations(second_altitude_m=2.2, reversed_lap=True, pause_s=20.0, dimmed_to=0.4)


def flown(number, variations=PLAIN, seed=0):
    """Return times, true poses, and the whole of a default flight."""
    simulated = simulate_flight(number, seed, variations=variations)
    last_s = (simulated.odometry[-1].sample.stamp_ns - EPOCH_NS) * 1e-9
    times_s = np.arange(0.0, last_s, STEP_S)
    return times_s, simulated.trajectory.poses(times_s), simulated


def rates(poses):
    """Return speed along the camera and across it, in m/s, and yaw rate in rad/s."""
    return flight.twists(STEP_S * np.arange(len(poses)), poses).T


# Without variations

@pytest.mark.parametrize('number, odometry, truth, greens', [
    (1, (-1.802475, 17.093144, -2.78232, 1.320911), (16.325693, 1.700934, 1.123862),
     (33, 50, 162, 121, 133, 156, 154, 103, 79)),
    (2, (9.291956, -2.120519, 0.166403, 1.50431), (1.594397, 7.990922, -2.174298),
     (44, 75, 109, 55, 208, 84, 51, 132, 73)),
    (3, (-2.691152, 0.388369, -0.02251, 1.411509), (16.539275, 3.942965, 1.536189),
     (45, 56, 172, 123, 135, 177, 165, 100, 146)),
])
def test_plain_flights_are_what_they_always_were(number, odometry, truth, greens):
    """The last bits differ between releases of NumPy and OpenCV; any real change is far larger."""
    simulated = simulate_flight(number, 0)
    sample = simulated.odometry[-1].sample
    assert (*sample.pose, sample.z_m) == pytest.approx(odometry, abs=2e-6)
    assert simulated.ground_truth[-1].pose == pytest.approx(truth, abs=2e-6)
    *_, picture = simulate_flight(number, 0, 3.0).pictures()
    np.testing.assert_allclose(picture.rgb[40::90, 50::123, 1].ravel(), greens, atol=1)


def test_each_variation_differs_from_the_plain_flight_in_its_own_way_alone():
    assert set(EACH) == {'second_altitude', 'reversed_lap', 'pause', 'dimmed', 'twin_aisle'}
    plain = vars(PLAIN)
    changed = [{name for name in plain if vars(varied)[name] != plain[name]}
               for varied in EACH.values()]
    assert changed == [{'second_altitude_m'}, {'reversed_lap'}, {'pause_s'}, {'dimmed_to'},
                       {'twin_aisle'}]


# A second altitude

@pytest.mark.parametrize('number', FLIGHTS)
def test_laps_alternate_between_two_altitudes_and_each_is_flown_twice(number):
    times_s, poses, simulated = flown(number, EACH['second_altitude'])
    laps = times_s / simulated.trajectory.schedule.lap_s
    assert laps[-1] > 4.0
    for lap, altitude_m in enumerate((ALTITUDE_M, 2.2, ALTITUDE_M, 2.2)):
        settled = (laps >= lap + 0.15 * (lap > 0)) & (laps < lap + 1.0)
        np.testing.assert_allclose(poses[settled, 2], altitude_m, atol=0.1 + 1e-9)


def test_the_climb_is_gentle_and_the_path_in_the_plan_stays_as_it_was():
    times_s, poses, _ = flown(1, EACH['second_altitude'])
    assert np.abs(np.gradient(poses[:, 2], STEP_S)).max() < 0.5
    plain = simulate_flight(1, 0).trajectory.poses(times_s)
    np.testing.assert_array_equal(np.delete(poses, 2, axis=1), np.delete(plain, 2, axis=1))


def test_a_lower_second_altitude_is_flown_too():
    times_s, poses, simulated = flown(2, Variations(second_altitude_m=0.8))
    second = np.abs(times_s / simulated.trajectory.schedule.lap_s - 1.5) < 0.3
    np.testing.assert_allclose(poses[second, 2], 0.8, atol=0.1 + 1e-9)


# A reversed lap

@pytest.mark.parametrize('number', FLIGHTS)
def test_one_lap_goes_the_other_way_round_and_the_others_on(number):
    """Seen from the middle of the hall; both loops of flight 3 go round it."""
    times_s, poses, simulated = flown(number, EACH['reversed_lap'])
    timetable = simulated.trajectory.schedule
    at_lap = np.searchsorted(timetable.flown_s(times_s), timetable.lap_s * np.arange(4))
    x, y = poses[:, :2].T - np.array(world.HALL_M)[:, None] / 2
    rounds = np.diff(np.unwrap(np.arctan2(y, x))[at_lap]) / (2 * pi)
    per_lap = 2 if number == 3 else 1
    np.testing.assert_allclose(rounds, (per_lap, -per_lap, per_lap), atol=0.05)


@pytest.mark.parametrize('number', FLIGHTS)
def test_the_reversed_lap_follows_the_same_path_backwards(number):
    """By a lap of the plain flight: no farther off than the waves to the side."""
    times_s, poses, simulated = flown(number, EACH['reversed_lap'])
    laps = simulated.trajectory.schedule.flown_s(times_s) / simulated.trajectory.schedule.lap_s
    backward, forward = poses[(laps > 1.02) & (laps < 1.98)], poses[laps < 1.0]
    for row in backward[::50]:
        apart_m = np.hypot(*(forward[:, :2] - row[:2]).T)
        alike = apart_m < 0.5
        turned_rad = wrap_angle(forward[alike, 5] - row[5])
        assert apart_m.min() < 0.45
        assert np.abs(np.abs(turned_rad) - pi).min() < 0.4


@pytest.mark.parametrize('number', FLIGHTS)
@pytest.mark.parametrize('variations', [PLAIN, EACH['reversed_lap'], ALL],
                         ids=['plain', 'reversed', 'all'])
def test_the_camera_looks_along_the_motion(number, variations):
    _, poses, _ = flown(number, variations)
    forward, left, _ = rates(poses)
    fast = np.hypot(forward, left) > 0.8
    assert np.abs(np.arctan2(left, forward))[fast].max() < 0.4
    assert fast.mean() > 0.7


@pytest.mark.parametrize('number', FLIGHTS)
def test_nothing_jumps(number):
    """However all of it is combined, the motion stays within what a drone does."""
    _, plain, _ = flown(number)
    _, poses, _ = flown(number, ALL)
    speed, plain_speed = (np.hypot(*rates(p)[:2]) for p in (poses, plain))
    assert speed.max() < 1.1 * plain_speed.max()
    assert np.abs(np.diff(speed)).max() / STEP_S < 3.0
    assert np.abs(np.diff(poses[:, 5])).max() / STEP_S < 2.5
    assert np.abs(np.diff(poses[:, 2])).max() / STEP_S < 0.5


def test_a_turn_round_turns_half_a_turn_at_a_stand():
    times_s, poses, simulated = flown(2, EACH['reversed_lap'])
    standing = simulated.trajectory.schedule.standing(times_s) == 1.0
    edges = np.flatnonzero(np.diff(standing.astype(int)))
    for start, stop in edges.reshape(2, 2):
        assert STEP_S * (stop - start) == pytest.approx(schedule.TURN_S, abs=2 * STEP_S)
        assert poses[stop, 5] - poses[start, 5] == pytest.approx(pi, abs=0.2)
        assert np.ptp(poses[start:stop, :2], axis=0).max() < 0.3


# A pause

@pytest.mark.parametrize('number', FLIGHTS)
def test_a_pause_keeps_the_drone_in_its_place_but_not_still(number):
    times_s, poses, simulated = flown(number, EACH['pause'])
    standing = simulated.trajectory.schedule.standing(times_s) == 1.0
    assert STEP_S * standing.sum() == pytest.approx(20.0, abs=2 * STEP_S)
    hovering, trajectory = poses[standing], simulated.trajectory
    along_m = trajectory.laps(times_s[standing]) * trajectory.lap_length_m
    assert 0.05 < np.ptp(along_m) <= 2 * 0.05
    assert np.ptp(hovering[:, :2], axis=0).max() < 0.45
    assert np.hypot(*rates(hovering)[:2]).max() < 0.12
    assert (np.ptp(hovering[:, 2:], axis=0) > 0.01).all()


def test_a_pause_puts_the_rest_of_the_flight_off_and_leaves_the_start_alone():
    pause_s = 12.0
    plain, paused = (simulate_flight(1, 0, 150.0, v).trajectory
                     for v in (PLAIN, Variations(pause_s=pause_s)))
    before_s = np.arange(0.0, 50.0, STEP_S)
    np.testing.assert_array_equal(paused.poses(before_s), plain.poses(before_s))
    later_s = np.arange(80.0, 120.0, STEP_S)
    cost_s = pause_s + schedule.BRAKE_S
    np.testing.assert_allclose(paused.laps(later_s + cost_s), plain.laps(later_s), atol=1e-9)


def test_the_drone_brakes_evenly_and_loses_the_time_it_stands():
    stop = schedule.Stop(brake_s=3.0, stand_s=4.0, turn_rad=0.0)
    assert stop.standing(np.array([3.0, 4.0, 5.0, 9.0, 10.0, 11.0])) == pytest.approx(
        [0.0, 0.5, 1.0, 1.0, 0.5, 0.0])
    assert stop.lost_s(np.array([3.0, 5.0, 9.0, 11.0, 50.0])) == pytest.approx(
        [0.0, 1.0, 5.0, 6.0, 6.0])
    times_s = np.arange(0.0, 15.0, 0.001)
    np.testing.assert_allclose(np.gradient(stop.lost_s(times_s), times_s),
                               stop.standing(times_s), atol=1e-3)


# Lights dimmed half-way

def test_the_lamps_go_down_in_the_middle_of_the_flight_and_stay_down():
    times_s = np.arange(0.0, 100.01, 0.1)
    shares = lamps(times_s, 0.3)
    assert (shares[times_s <= 50.0] == 1.0).all()
    np.testing.assert_allclose(shares[times_s >= 50.0 + schedule.DIM_S], 0.3)
    assert (np.diff(shares) <= 0.0).all() and np.abs(np.diff(shares)).max() < 0.1


def test_dimmed_lamps_darken_the_pictures_until_the_exposure_has_followed():
    plain, dimmed = (
        np.array([frame.grey for frame in simulate_flight(2, 0, 12.0, v).frames()])
        for v in (PLAIN, EACH['dimmed']))
    np.testing.assert_array_equal(dimmed[:60], plain[:60])
    ratio = dimmed.mean(axis=(1, 2)) / plain.mean(axis=(1, 2))
    assert ratio[70:80].min() < 0.7
    assert ratio[-1] > ratio[70:80].min() + 0.1


# An aisle that looks exactly like another

def views(world_of_seed, x_m, y_m, yaw_rad):
    """Return what is seen at a pose, and at the same one turned about the middle of the hall."""
    width_m, depth_m = world.HALL_M
    poses = np.array([(x_m, y_m, 1.4, 0.01, -0.02, yaw_rad),
                      (width_m - x_m, depth_m - y_m, 1.4, 0.01, -0.02, yaw_rad + pi)])
    return [Camera(world_of_seed, 0).render(pose).astype(int) for pose in poses]


@pytest.mark.parametrize('x_m', [2.5, 9.0, 14.0])
@pytest.mark.parametrize('sideways_m, yaw_rad', [(0.2, -0.05), (-0.2, 0.05)])
def test_the_second_aisle_westward_looks_exactly_like_the_first_one_eastward(
        x_m, sideways_m, yaw_rad):
    here, there = views(world.make_world(3, twin_aisle=True),
                        x_m, flight.AISLE_1_M + sideways_m, yaw_rad)
    assert np.abs(here - there).mean() < 0.1
    here, there = views(world.make_world(3), x_m, flight.AISLE_1_M + sideways_m, yaw_rad)
    assert np.abs(here - there).mean() > 2.0


def test_the_ends_of_the_hall_and_the_corridors_still_tell_where_one_is():
    twin = world.make_world(3, twin_aisle=True)
    for x_m, y_m, yaw_rad in [(flight.EAST_M, 6.5, pi / 2), (9.0, flight.SOUTH_M, 0.0)]:
        here, there = views(twin, x_m, y_m, yaw_rad)
        assert np.abs(here - there).mean() > 2.0


def test_the_camera_of_a_flight_sees_the_twin_aisle():
    seen = []
    for variations in (PLAIN, EACH['twin_aisle']):
        *_, last = simulate_flight(2, 0, 22.0, variations).frames()  # westward, in the second one
        seen.append(last.grey.astype(int))
    assert np.abs(seen[0] - seen[1]).mean() > 2.0


def test_a_twin_aisle_is_paint_alone():
    plain, twin = (simulate_flight(2, 0, 5.0, v) for v in (PLAIN, EACH['twin_aisle']))
    assert (twin.odometry, twin.ground_truth) == (plain.odometry, plain.ground_truth)
    for old, new in zip(world.make_world(0).layers, world.make_world(0, True).layers):
        changed = (old.texture != new.texture).any(axis=(0, 2))
        planes = np.searchsorted(old.offsets_m, np.flatnonzero(changed) / 64, side='right') - 1
        expected = [world.WEST] if len(old.lengths_m) == 4 else [
            world.SHELF_2_NORTH, world.SHELF_3_SOUTH]
        assert np.unique(planes).tolist() == expected


# All of it

@pytest.mark.parametrize('number', FLIGHTS)
def test_a_varied_flight_keeps_clear_of_walls_and_shelves(number):
    assert_clear_of_walls_and_shelves(*flown(number, ALL)[1][:, :2].T)


@pytest.mark.parametrize('number', FLIGHTS)
@pytest.mark.parametrize('variations, at_least', [
    (PLAIN, 3), (EACH['second_altitude'], 4), (EACH['reversed_lap'], 4), (EACH['pause'], 3),
    (EACH['dimmed'], 3), (ALL, 4)])
def test_a_default_flight_leaves_laps_for_revisits(number, variations, at_least):
    times_s, _, simulated = flown(number, variations)
    timetable = simulated.trajectory.schedule
    assert timetable.flown_s(times_s)[-1] / timetable.lap_s > at_least


def test_odometry_without_noise_is_the_motion_however_it_varies(monkeypatch):
    for noise in ('SCALE_SIGMA', 'STEP_SIGMA_M', 'STEP_SIGMA_RAD', 'YAW_WALK_RAD_SQRT_S',
                  'HEIGHT_SIGMA_M'):
        monkeypatch.setattr(flight, noise, 0.0)
    monkeypatch.setattr(flight, 'YAW_BIAS_RAD_S', (0.0, 0.0))
    _, _, simulated = flown(2, ALL)
    samples = [raw.sample for raw in simulated.odometry][::50]
    poses = simulated.trajectory.poses(
        np.array([sample.stamp_ns - EPOCH_NS for sample in samples]) * 1e-9)
    start = Pose2(*poses[0, [0, 1, 5]].tolist())
    for sample, pose in zip(samples, poses):
        moved = between(start, Pose2(*pose[[0, 1, 5]].tolist()))
        np.testing.assert_allclose(sample.pose[:2], moved[:2], atol=1e-8)
        assert abs(wrap_angle(sample.pose.yaw_rad - moved.yaw_rad)) < 1e-8
        assert sample.z_m == pytest.approx(pose[2])


def test_the_twist_stops_with_the_drone_and_ground_truth_follows():
    _, _, simulated = flown(1, ALL)
    timetable = simulated.trajectory.schedule
    forward = np.array([raw.forward_m_s for raw in simulated.odometry])
    standing = timetable.standing(STEP_S * np.arange(len(forward))) == 1.0
    assert np.abs(forward[standing].mean()) < 0.05 < 0.8 < forward[~standing].mean()
    truth_s = np.array([sample.stamp_ns - EPOCH_NS for sample in simulated.ground_truth]) * 1e-9
    seen = np.array([sample.pose for sample in simulated.ground_truth])
    error = seen - simulated.trajectory.poses(truth_s)[:, [0, 1, 5]]
    np.testing.assert_allclose(error[:, :2].std(axis=0), 0.05, rtol=0.05)
    np.testing.assert_allclose(wrap_angle(error[:, 2]).std(), 0.02, rtol=0.05)


def test_the_same_seed_and_variations_give_the_same_values():
    a, b, c = (simulate_flight(3, 1, variations=v) for v in (ALL, replace(ALL), PLAIN))
    assert (a.odometry, a.ground_truth) == (b.odometry, b.ground_truth)
    assert a.odometry[-1] != c.odometry[-1]


# What is refused

@pytest.mark.parametrize('changes, message', [
    ({'second_altitude_m': 0.5}, r'second_altitude_m = 0.5: expected a value in \[0.6, 3.3\]'),
    ({'second_altitude_m': 3.4}, r'second_altitude_m = 3.4: expected a value in \[0.6, 3.3\]'),
    ({'pause_s': -1.0}, r'pause_s = -1.0: expected a value in \[0, 600\]'),
    ({'pause_s': float('nan')}, r'pause_s = nan'),
    ({'dimmed_to': 0.0}, r'dimmed_to = 0.0: expected a value in \[0.05, 1\]'),
])
def test_values_out_of_range_are_refused(changes, message):
    with pytest.raises(ConfigError, match=message):
        Variations(**changes)


def test_a_twin_aisle_is_refused_where_the_flight_passes_none():
    with pytest.raises(ConfigError, match='flight = 1: expected one of 2, 3, which pass the twin'):
        simulate_flight(1, 0, variations=EACH['twin_aisle'])


@pytest.mark.parametrize('changes, least_s', [
    # By laps of 40 s: the second one and its climb, two laps and two stops, 1.25 laps and a stop.
    ({'second_altitude_m': 2.0}, 40 + schedule.CLIMB_S),
    ({'reversed_lap': True}, 80 + 2 * (schedule.TURN_S + schedule.BRAKE_S)),
    ({'pause_s': 9.0}, 50 + 9 + schedule.BRAKE_S),
    ({'dimmed_to': 0.5}, 0.0),
    ({'twin_aisle': True}, 0.0),
])
def test_a_flight_is_complete_when_all_has_happened(changes, least_s):
    assert Schedule(40.0, Variations(**changes)).complete_s == pytest.approx(least_s)


def test_a_duration_too_short_for_what_was_asked_is_refused():
    with pytest.raises(ConfigError, match='seconds = 50.0: expected at least 80 for all that was'):
        simulate_flight(2, 0, 50.0, EACH['reversed_lap'])


# The command

@pytest.fixture
def asked(monkeypatch):
    """Return a function: arguments of `simulate` to the call they lead to."""
    pytest.importorskip('mcap')
    from dlsc_qbs_ros.cli import simulate
    calls = []

    def refuse(*arguments):
        calls.append(arguments)
        raise ConfigError('no flight today')

    monkeypatch.setattr(simulate, 'simulate_flight', refuse)

    def ask(*arguments):
        assert simulate.main(['--flight', '2', '--out', 'nowhere', *arguments]) == 1
        return calls.pop()
    return ask


@pytest.mark.parametrize('name', EACH)
def test_each_variation_has_a_flag_of_its_name(asked, name):
    flag = f'--{name.replace("_", "-")}'
    assert asked(flag) == (2, 0, None, EACH[name])


def test_flags_combine_and_take_their_values(asked):
    assert asked() == (2, 0, None, PLAIN)
    assert asked('--second-altitude', '0.9', '--pause', '5', '--dimmed', '0.2',
                 '--reversed-lap', '--twin-aisle', '--seconds', '300') == (
        2, 0, 300.0, Variations(0.9, True, 5.0, 0.2, True))


@pytest.mark.parametrize('arguments, message', [
    (['--pause', '-3'], 'pause_s = -3.0: expected a value in [0, 600]'),
    (['--second-altitude', '9'], 'second_altitude_m = 9.0: expected a value in [0.6, 3.3]'),
    (['--dimmed', '40'], 'dimmed_to = 40.0: expected a value in [0.05, 1]'),
    (['--pause', '--seconds', '20'], 'seconds = 20.0: expected at least'),
])
def test_bad_values_give_one_line_and_code_1(tmp_path, capsys, arguments, message):
    pytest.importorskip('mcap')
    from dlsc_qbs_ros.cli.simulate import main
    out = tmp_path / 'flight'
    assert main(['--flight', '2', '--out', str(out), *arguments]) == 1
    errors = capsys.readouterr().err
    assert errors.startswith('simulate: ') and message in errors and errors.count('\n') == 1
    assert not out.exists()
