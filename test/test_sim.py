"""The simulated warehouse: what it promises about flights, sensors and pictures."""

from itertools import islice
from math import cos, pi, sin, tan

from hall import assert_clear_of_walls_and_shelves
import numpy as np
import pytest

from dlsc_qbs_ros.core.geometry import between, wrap_angle
from dlsc_qbs_ros.core.types import Frame, GroundTruthSample, Pose2, RawOdometry
from dlsc_qbs_ros.errors import ConfigError
from dlsc_qbs_ros.sim import camera, flight, textures, world
from dlsc_qbs_ros.sim.encodings import ENCODINGS
from dlsc_qbs_ros.sim.simulation import DEFAULT_SECONDS, EPOCH_NS, simulate_flight

FLIGHTS = (1, 2, 3)


def truth_of(simulated, stamps_ns):
    return simulated.trajectory.poses((np.asarray(stamps_ns) - EPOCH_NS) * 1e-9)


def whole_path(number, seed=0):
    """Return x, y of a default flight, each 0.1 s."""
    times_s = np.arange(0.0, DEFAULT_SECONDS[number], 0.1)
    return simulate_flight(number, seed).trajectory.poses(times_s)[:, :2]


# Seeds and stamps

def test_the_same_seed_gives_the_same_bytes():
    a, b = (simulate_flight(1, 5, 2.0) for _ in range(2))
    assert a.odometry == b.odometry
    assert a.ground_truth == b.ground_truth
    for one, other in zip(a.pictures(), b.pictures(), strict=True):
        assert one.stamp_ns == other.stamp_ns
        np.testing.assert_array_equal(one.rgb, other.rgb)


@pytest.mark.parametrize('number, seed', [(1, 6), (2, 5)])
def test_another_seed_or_flight_gives_another_recording(number, seed):
    a, b = simulate_flight(1, 5, 2.0), simulate_flight(number, seed, 2.0)
    assert a.odometry[-1] != b.odometry[-1]
    assert a.ground_truth[-1] != b.ground_truth[-1]
    assert (next(a.pictures()).rgb != next(b.pictures()).rgb).mean() > 0.5


def test_all_flights_of_a_seed_share_the_warehouse_and_other_seeds_do_not():
    a, b, c = (world.make_world(seed).layers for seed in (1, 1, 2))
    for one, same, other in zip(a, b, c):
        np.testing.assert_array_equal(one.texture, same.texture)
        assert (one.texture != other.texture).mean() > 0.1


def test_stamps_rise_and_the_rates_are_those_promised():
    simulated = simulate_flight(1, 0, 3.0)
    events = list(simulated.events(simulated.frames()))
    kinds = {Frame: [], RawOdometry: [], GroundTruthSample: []}
    for event in events:
        stamped = event.sample if isinstance(event, RawOdometry) else event
        kinds[type(event)].append(stamped.stamp_ns)
    assert [np.unique(np.diff(stamps)).tolist() for stamps in kinds.values()] == [
        [100_000_000], [20_000_000], [50_000_000]]
    merged = [getattr(event, 'sample', event).stamp_ns for event in events]
    assert (np.diff(merged) > 0).all()
    assert (len(kinds[Frame]), len(kinds[RawOdometry])) == (30, 151)


def test_frames_are_the_grey_of_the_pictures():
    simulated = simulate_flight(2, 0, 1.0)
    for frame, picture in zip(simulated.frames(), simulated.pictures(), strict=True):
        assert (frame.grey.shape, frame.grey.dtype) == ((260, 346), np.uint8)
        assert picture.rgb.shape == (260, 346, 3)
        grey = picture.rgb @ (0.299, 0.587, 0.114)
        np.testing.assert_allclose(frame.grey, grey, atol=1.0)


@pytest.mark.parametrize('arguments, message', [
    ((4, 0), r'flight = 4: expected one of 1, 2, 3'),
    ((1, -1), r'seed = -1: expected at least 0'),
    ((1, 0, 0.5), r'seconds = 0.5: expected a value in \[1, 3600\]'),
    ((1, 0, 3601.0), r'seconds = 3601.0'),
    ((1, 0, float('nan')), r'seconds = nan'),
])
def test_what_cannot_be_flown_is_refused(arguments, message):
    with pytest.raises(ConfigError, match=message):
        simulate_flight(*arguments)


# The paths

@pytest.mark.parametrize('number', FLIGHTS)
def test_a_default_flight_makes_at_least_three_laps(number):
    x, y = (whole_path(number) - (9.0, 6.5)).T
    turns = np.unwrap(np.arctan2(y, x))[-1] - np.arctan2(y[0], x[0])
    per_lap = 2 if number == 3 else 1  # both loops go round the middle shelf
    assert turns / (2 * pi) >= 3 * per_lap


@pytest.mark.parametrize('number', FLIGHTS)
def test_the_drone_keeps_clear_of_walls_and_shelves(number):
    assert_clear_of_walls_and_shelves(*whole_path(number).T)


def test_flight_1_flies_along_the_walls_2_between_the_shelves_and_3_both():
    (_, outer_south), (outer_north, _) = world.SHELF_Y_M[0], world.SHELF_Y_M[-1]
    between_shelves = {}
    for number in FLIGHTS:
        x, y = whole_path(number).T
        along = (x > world.SHELF_X_M[0]) & (x < world.SHELF_X_M[1])
        inside = (y > outer_south) & (y < outer_north)
        between_shelves[number] = inside[along].mean()
    assert between_shelves[1] == 0.0
    assert between_shelves[2] == 1.0
    assert 0.4 < between_shelves[3] < 0.6


def test_laps_differ_by_decimetres():
    simulated = simulate_flight(1, 0)
    times_s = np.arange(0.0, 150.0, 0.02)
    laps, poses = simulated.trajectory.laps(times_s), simulated.trajectory.poses(times_s)
    at = [np.searchsorted(laps, lap + share) for lap in (0, 1, 2) for share in (0.1, 0.4, 0.7)]
    first, *others = poses[at, :2].reshape(3, 3, 2)
    for other in others:
        apart_m = np.linalg.norm(other - first, axis=1)
        assert 0.02 < apart_m.max() < 2 * 0.2 + 0.03


def test_a_smooth_loop_keeps_long_sides_and_cuts_corners():
    loop = flight.smooth_loop(np.array([(0.0, 0.0), (20.0, 0.0), (20.0, 20.0), (0.0, 20.0)]))
    x, y, along_x, along_y = loop.T
    middle = np.argmin(np.hypot(x - 10.0, y))
    np.testing.assert_allclose(loop[middle], (10.0, 0.0, 1.0, 0.0), atol=0.02)
    assert 0.3 < np.hypot(x, y).min() < 0.8
    np.testing.assert_allclose(np.hypot(along_x, along_y), 1.0)


# Odometry and ground truth

def test_odometry_without_noise_is_the_motion_from_the_origin(monkeypatch):
    for name in ('SCALE_SIGMA', 'STEP_SIGMA_M', 'STEP_SIGMA_RAD', 'YAW_WALK_RAD_SQRT_S'):
        monkeypatch.setattr(flight, name, 0.0)
    monkeypatch.setattr(flight, 'YAW_BIAS_RAD_S', (0.0, 0.0))
    simulated = simulate_flight(2, 0, 20.0)
    poses = truth_of(simulated, [raw.sample.stamp_ns for raw in simulated.odometry])
    planar = [Pose2(x, y, yaw) for x, y, yaw in poses[:, (0, 1, 5)].tolist()]
    for raw, pose in zip(simulated.odometry, planar):
        moved = between(planar[0], pose)
        np.testing.assert_allclose(raw.sample.pose[:2], moved[:2], atol=1e-9)
        assert abs(wrap_angle(raw.sample.pose.yaw_rad - moved.yaw_rad)) < 1e-9


@pytest.mark.parametrize('seed', range(4))
def test_increments_of_odometry_err_by_the_stated_bias_scale_and_noise(seed):
    simulated = simulate_flight(1, seed)
    samples = [raw.sample for raw in simulated.odometry]
    poses = truth_of(simulated, [sample.stamp_ns for sample in samples])
    true = [Pose2(x, y, yaw) for x, y, yaw in poses[:, (0, 1, 5)].tolist()]
    moved = np.array([between(a.pose, b.pose) for a, b in zip(samples, samples[1:])])
    should = np.array([between(a, b) for a, b in zip(true, true[1:])])

    turned = wrap_angle(moved[:, 2] - should[:, 2])
    walk_rad_s = flight.YAW_WALK_RAD_SQRT_S / np.sqrt(0.02 * len(turned))
    low, high = flight.YAW_BIAS_RAD_S
    assert low - 4 * walk_rad_s < abs(turned.mean()) / 0.02 < high + 4 * walk_rad_s
    step_rad = np.hypot(flight.STEP_SIGMA_RAD, flight.YAW_WALK_RAD_SQRT_S * np.sqrt(0.02))
    assert turned.std() == pytest.approx(step_rad, rel=0.05)

    scale = (moved[:, 0] @ should[:, 0]) / (should[:, 0] @ should[:, 0])
    assert abs(scale - 1.0) < 4 * flight.SCALE_SIGMA
    residual_m = moved[:, :2] - scale * should[:, :2]
    np.testing.assert_allclose(residual_m.std(axis=0), flight.STEP_SIGMA_M, rtol=0.05)
    np.testing.assert_allclose(
        np.std([sample.z_m for sample in samples] - poses[:, 2]), flight.HEIGHT_SIGMA_M, rtol=0.05)


def test_the_twist_is_the_rate_of_the_poses():
    times_s = np.arange(0.0, 4.0, 0.02)
    turn = 0.5 * times_s  # a circle of 2 m at 1 m/s, to the left
    poses = np.zeros((len(times_s), 6))
    poses[:, 0], poses[:, 1], poses[:, 5] = 2 * np.sin(turn), 2 - 2 * np.cos(turn), turn
    np.testing.assert_allclose(flight.twists(times_s, poses)[1:-1], [(1.0, 0.0, 0.5)] * 198,
                               atol=1e-3)


@pytest.mark.parametrize('number', FLIGHTS)
def test_odometry_alone_is_metres_off_in_the_end(number):
    simulated = simulate_flight(number, 0)
    last = simulated.odometry[-1].sample
    start, end = truth_of(simulated, [EPOCH_NS, last.stamp_ns])[:, (0, 1, 5)]
    true = between(Pose2(*start), Pose2(*end))
    assert 1.0 < np.hypot(last.pose.x_m - true.x_m, last.pose.y_m - true.y_m) < 40.0


def test_ground_truth_is_off_by_the_noise_of_the_beacons():
    simulated = simulate_flight(3, 0)
    seen = np.array([sample.pose for sample in simulated.ground_truth])
    true = truth_of(simulated, [sample.stamp_ns for sample in simulated.ground_truth])
    error = seen - true[:, (0, 1, 5)]
    np.testing.assert_allclose(error[:, :2].std(axis=0), 0.05, rtol=0.05)
    np.testing.assert_allclose(wrap_angle(error[:, 2]).std(), 0.02, rtol=0.05)
    assert np.abs(error[:, :2].mean(axis=0)).max() < 0.005


# The camera

WALL_M = 6.0


def picture_of(pose, distance_m, texture=None, turn_rad=0.0):
    """
    Look at a wall, 6 m wide and 3 m high, across x = distance_m; its left half is white.

    Wall and pose are turned together about the origin.
    """
    if texture is None:
        texture = np.full((192, 384, 3), 250, np.uint8)
        texture[:, 192:] = 10
    c, s = cos(turn_rad), sin(turn_rad)
    turn = np.array([(c, s), (-s, c)])
    wall = world.Layer(np.array([(distance_m, WALL_M / 2)]) @ turn,
                       np.array([(distance_m, -WALL_M / 2)]) @ turn, 3.0, texture)
    pose = np.array((*(pose[:2] @ turn), *pose[2:5], pose[5] + turn_rad))
    return camera.Camera(world.World((wall,)), 0).render(pose).mean(axis=2)


def edge(profile):
    """Return where a profile, bright before and dark after, falls most: between two pixels."""
    return np.diff(profile).argmin() + 0.5


@pytest.mark.parametrize('distance_m, left_m', [(2.0, 0.0), (2.0, 0.5), (4.0, 0.5), (4.0, -1.0)])
def test_a_texture_edge_stands_where_the_pinhole_model_puts_it(distance_m, left_m):
    image = picture_of((0.0, left_m, 1.5, 0.0, 0.0, 0.0), distance_m)
    column = edge(image[120:140].mean(axis=0))
    focal_px = 346 / 2 / tan(np.radians(40.0))
    assert column == pytest.approx(172.5 + focal_px * left_m / distance_m, abs=1.0)


def test_turning_left_moves_the_picture_to_the_right():
    image = picture_of((0.0, 0.0, 1.5, 0.0, 0.0, 0.2), 2.0)
    column = edge(image[120:140].mean(axis=0))
    assert column == pytest.approx(172.5 + camera.FOCAL_PX * tan(0.2), abs=1.0)


@pytest.mark.parametrize('turn_rad', [1.0, 2.5, -1.5])
def test_only_the_view_relative_to_the_wall_matters(turn_rad):
    pose = (0.5, 0.3, 1.5, 0.02, -0.02, 0.2)
    turned, straight = (picture_of(pose, 2.0, turn_rad=turn)[100:160] for turn in (turn_rad, 0.0))
    np.testing.assert_allclose(turned, straight, atol=2.0)


def test_a_nearer_wall_looks_bigger():
    texture = np.full((192, 384, 3), 20, np.uint8)
    texture[64:128, 160:224] = 250  # 1 m by 1 m, from 1 m to 2 m above the floor
    for distance_m in (2.0, 3.0, 5.0):
        image = picture_of((0.0, 0.0, 1.5, 0.0, 0.0, 0.0), distance_m, texture)
        bright = image > 0.5 * image[120:140, 160:186].mean()
        side_px = camera.FOCAL_PX / distance_m
        assert bright[130].sum() == pytest.approx(side_px, abs=2.0)
        assert bright[:, 172].sum() == pytest.approx(side_px, abs=2.0)


def test_the_top_of_a_wall_stands_at_its_height_and_pitch_and_roll_move_it():
    focal_px, above_m, distance_m = camera.FOCAL_PX, 1.6, 4.0
    texture = np.full((192, 384, 3), 250, np.uint8)

    def row(roll, pitch, column):
        image = picture_of((0.0, 0.0, 3.0 - above_m, roll, pitch, 0.0), distance_m, texture)
        return edge(-image[:130, column - 2:column + 3].mean(axis=1))

    level = 129.5 - focal_px * above_m / distance_m
    assert row(0.0, 0.0, 172) == pytest.approx(level, abs=1.0)
    nose_down = row(0.0, 0.03, 172)
    assert nose_down == pytest.approx(level - focal_px * tan(0.03), abs=1.0)
    banked_right = 0.03  # the scene turns to the left: its right end rises
    sideways, upward = 80.0, 129.5 - level
    rise = sideways * sin(banked_right) - upward * (1.0 - cos(banked_right))
    assert row(banked_right, 0.0, 252) == pytest.approx(level - rise, abs=1.0)


def test_rays_find_the_nearest_plane_and_the_place_on_it():
    shelf = world.Layer(np.array([(4.0, 1.0), (2.0, 1.0)]), np.array([(4.0, -1.0), (2.0, 0.5)]),
                        1.0, np.zeros((64, 160, 3), np.uint8))
    depth, along_m = camera.cast(
        shelf, np.zeros(2), np.array([(1.0, 0.0), (1.0, 0.375), (-1.0, 0.0)]))
    np.testing.assert_allclose(depth, (4.0, 2.0, camera.NO_HIT_M))
    np.testing.assert_allclose(along_m[:2], (1.0, 2.25))


def test_sensor_noise_is_small_and_not_the_same_twice():
    lens = camera.Camera(world.make_world(0), 0)
    pose = np.array((9.0, 4.6, 1.4, 0.0, 0.0, 0.0))
    images = np.array([lens.render(pose) for _ in range(40)], float)[-8:]  # exposure has settled
    middle = images[:, 100:160, 40:120]
    assert middle.std(axis=0).mean() == pytest.approx(camera.NOISE_GREY, rel=0.25)


def test_brightness_swings_at_the_aisle_ends_and_exposure_brings_it_back():
    brightness = np.array([frame.grey.mean() for frame in simulate_flight(2, 0, 22.0).frames()])
    settled = brightness[20:]
    assert settled.max() / settled.min() > 1.3
    assert 80.0 < np.median(settled) < 130.0


# Look-alike shelves

def test_bays_look_alike_but_are_not_the_same():
    rng = np.random.default_rng(0)
    template = textures.bay_template(rng)
    faces = [textures.paint_shelf(rng, template, 12.0, 3.5, n_distinct=0) for _ in range(2)]
    width = round(textures.BAY_M * textures.PIXELS_PER_M)
    bays = [face[:, start:start + width].mean(axis=2).ravel()
            for face in faces for start in range(0, face.shape[1], width)]
    alike = np.corrcoef(bays)[np.triu_indices(len(bays), 1)]
    assert 0.7 < np.median(alike) and alike.max() < 0.999


# Encodings

@pytest.mark.parametrize('encoding, shape, dtype', [
    ('rgb8', (260, 346, 3), np.uint8), ('bgr8', (260, 346, 3), np.uint8),
    ('rgba8', (260, 346, 4), np.uint8), ('bgra8', (260, 346, 4), np.uint8),
    ('mono8', (260, 346), np.uint8), ('mono16', (260, 346), np.uint16),
    ('bayer_rggb8', (260, 346), np.uint8), ('yuv422_yuy2', (260, 346, 2), np.uint8),
])
def test_every_encoding_has_its_own_layout_and_the_same_grey(encoding, shape, dtype):
    pytest.importorskip('rclpy')
    from dlsc_qbs_ros.ros.image_conversions import image_to_grey, image_to_msg
    picture, = islice(simulate_flight(1, 0, 1.0).pictures(), 1)
    pixels = ENCODINGS[encoding](picture.rgb)
    assert (pixels.shape, pixels.dtype) == (shape, dtype)
    grey = image_to_grey(image_to_msg(0, pixels, encoding, 'camera')).astype(float)
    expected = picture.rgb @ (0.299, 0.587, 0.114)
    if encoding == 'yuv422_yuy2':  # its luma spans 16 to 235
        expected = 16.0 + expected * 219.0 / 255.0
    assert np.abs(grey - expected).mean() < (5.0 if encoding.startswith('bayer') else 1.0)


def test_bayer_and_yuv_of_a_pure_colour():
    red = np.zeros((4, 4, 3), np.uint8)
    red[:, :, 0] = 200
    mosaic = ENCODINGS['bayer_rggb8'](red)
    assert mosaic[:2, :2].tolist() == [[200, 0], [0, 0]]
    packed = ENCODINGS['yuv422_yuy2'](red)  # Y = 16 + .257 R, U = 128 - .148 R, V = 128 + .439 R
    np.testing.assert_allclose(packed[0, :2], [(67, 98), (67, 216)], atol=1)


# The command

@pytest.fixture
def simulate():
    pytest.importorskip('mcap')
    from dlsc_qbs_ros.cli.simulate import main
    return main


def test_the_recording_reads_back_as_it_was_flown(simulate, tmp_path, capsys):
    pytest.importorskip('rclpy')
    from dlsc_qbs_ros.io.recordings.bag import bag_topics
    from dlsc_qbs_ros.io.flight import read_flight
    out = tmp_path / 'flight'
    assert simulate(['--flight', '2', '--seed', '3', '--seconds', '2', '--out', str(out)]) == 0
    assert 'flight 2, seed 3: 20 images (rgb8), 101 odometry' in capsys.readouterr().out
    assert bag_topics(out) == {
        '/camera/image_raw': 'sensor_msgs/msg/Image', '/odom': 'nav_msgs/msg/Odometry',
        '/ground_truth': 'geometry_msgs/msg/PoseStamped'}

    flown = simulate_flight(2, 3, 2.0)
    events = list(read_flight(out))
    expected = list(flown.events(flown.frames()))
    assert [type(event) for event in events] == [type(event) for event in expected]
    for event, wanted in zip(events, expected):
        if isinstance(event, Frame):
            assert event.stamp_ns == wanted.stamp_ns
            np.testing.assert_array_equal(event.grey, wanted.grey)
        elif isinstance(event, RawOdometry):
            assert event.sample.stamp_ns == wanted.sample.stamp_ns
            np.testing.assert_allclose(event.sample.pose, wanted.sample.pose, atol=1e-9)
            assert event.forward_m_s == wanted.forward_m_s
            assert event.yaw_rate_rad_s == wanted.yaw_rate_rad_s
        else:
            np.testing.assert_allclose(event.pose, wanted.pose, atol=1e-9)


@pytest.mark.parametrize('arguments, message', [
    (['--flight', '7'], 'flight = 7: expected one of 1, 2, 3'),
    (['--flight', '1', '--seconds', '-3'], 'seconds = -3.0: expected a value in'),
    (['--flight', '1', '--seed', '-1'], 'seed = -1'),
    (['--flight', '1', '--encoding', 'jpeg'], "encoding 'jpeg': expected one of rgb8, bgr8"),
])
def test_bad_arguments_give_one_line_and_code_1(simulate, tmp_path, capsys, arguments, message):
    out = tmp_path / 'flight'
    assert simulate([*arguments, '--out', str(out)]) == 1
    errors = capsys.readouterr().err
    assert errors.startswith('simulate: ') and message in errors and errors.count('\n') == 1
    assert not out.exists()


def test_an_existing_folder_is_refused_and_left_alone(simulate, tmp_path, capsys):
    pytest.importorskip('rclpy')
    (tmp_path / 'kept').write_text('precious')
    assert simulate(['--flight', '1', '--seconds', '1', '--out', str(tmp_path)]) == 1
    assert f'simulate: {tmp_path}: ' in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ['kept']
