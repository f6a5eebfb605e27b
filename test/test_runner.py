"""A flight from end to end without ROS: what the runner hands back."""

from dataclasses import fields
from functools import lru_cache

from loop_flight import CONFIG, events, frames, LAP_S, odometry, pose_at, START_NS
import numpy as np
import pytest

from dlsc_qbs_ros.core.geometry import between_rows
from dlsc_qbs_ros.core.types import Code, Dictionary, Frame, OdometrySample, View
from dlsc_qbs_ros.pipeline.encoder import DescriptorEncoder
from dlsc_qbs_ros.pipeline.runner import encode, map_codes, run

FLIGHT_S = 2.2 * LAP_S


VARIANTS = {
    'plain': {},
    'paper': {'encoder.mode': 'paper'},
    'no gate': {'encoder.gate': False},
    'patches': {'encoder.input': 'patches'},
    'odometry': {'ratslam.min_age_s': 1e5}}


@lru_cache(maxsize=None)
def flown(name='plain'):
    return run(events(FLIGHT_S), CONFIG.override(VARIANTS[name]))


def truth(stamps_ns):
    return np.array([pose_at((stamp_ns - START_NS) * 1e-9) for stamp_ns in stamps_ns])


def error(poses, stamps_ns):
    return np.mean(np.abs(poses - truth(stamps_ns))[:, :2].sum(axis=1))


def assert_same(one, other):
    for spec in fields(one):
        a, b = getattr(one, spec.name), getattr(other, spec.name)
        if isinstance(a, np.ndarray):
            np.testing.assert_array_equal(a, b, err_msg=spec.name)
    assert one.counts == other.counts


def test_the_same_flight_gives_the_same_result_to_the_last_bit():
    assert_same(run(events(FLIGHT_S), CONFIG), flown())


def test_a_run_is_the_encoder_and_then_the_map():
    assert_same(map_codes(encode(events(FLIGHT_S), CONFIG), CONFIG), flown())


def test_an_encoded_flight_serves_any_number_of_maps():
    encoded = encode(events(FLIGHT_S), CONFIG)
    strict = CONFIG.override({'ratslam.threshold': 1.0, 'ratslam.tracking_threshold': 1.0})
    assert map_codes(encoded, strict).counts['closures'] == 0
    assert_same(map_codes(encoded, CONFIG), flown())


def test_the_map_is_better_than_the_odometry():
    result = flown()
    assert result.counts['closures'] > 0
    assert error(result.poses, result.stamps_ns) < 0.6 * error(result.odometry, result.stamps_ns)


def test_arrays_have_the_shapes_that_are_promised():
    result = flown()
    n, m = len(result.stamps_ns), result.counts['experiences']
    for poses in (result.poses, result.final_poses, result.odometry):
        assert poses.shape == (n, 3)
    assert result.experiences.shape == (m, 3)
    assert result.links.shape[1] == result.closures.shape[1] == 2
    assert 0 <= result.links.min() and result.links.max() == m - 1
    assert result.counts['closures'] == len(result.closures)
    assert (np.diff(result.stamps_ns) > 0).all()


def test_what_closures_tell_is_how_the_map_lies():
    result = flown()
    first, second = result.experiences[result.closures.T]
    np.testing.assert_allclose(result.closure_motions, between_rows(first, second), atol=0.1)


def test_every_frame_and_sample_is_accounted_for():
    counts = flown().counts
    assert counts['frames'] == len(frames(FLIGHT_S))
    assert counts['odometry_accepted'] == len(odometry(FLIGHT_S))
    assert counts['codes_received'] == counts['frames']
    unused = sum(n for key, n in counts.items() if key.startswith('codes_without'))
    assert counts['codes_used'] + unused == counts['codes_received']
    assert 0 < counts['learning_frames'] < counts['frames']


def test_codes_that_no_odometry_follows_are_given_up_at_the_end():
    flight = sorted([*frames(2.0), *odometry(1.0)],
                    key=lambda event: getattr(event, 'sample', event).stamp_ns)
    counts = run(flight, CONFIG).counts
    assert (counts['codes_used'], counts['codes_without_odometry']) == (10, 10)


def test_encoded_events_keep_their_order_and_a_dictionary_goes_before_its_code():
    kinds = encode(events(2.0), CONFIG).events
    first = [type(event) for event in kinds if not isinstance(event, OdometrySample)][:5]
    assert first == [Dictionary, View, Code, View, Code]
    stamps = [event.stamp_ns for event in kinds]
    assert stamps == sorted(stamps)


# Encoders

def test_odometry_alone_gives_back_the_odometry():
    result = flown('odometry')
    assert result.counts['closures'] == 0
    np.testing.assert_allclose(result.poses, result.odometry, atol=1e-9)
    np.testing.assert_allclose(result.final_poses, result.odometry, atol=1e-9)


def test_without_the_gate_every_frame_is_learned_from():
    counts = flown('no gate').counts
    assert counts['learning_frames'] == counts['frames']


def test_patches_close_the_loop_too():
    result = flown('patches')
    assert result.counts['closures'] > 0
    assert error(result.poses, result.stamps_ns) < 0.6 * error(result.odometry, result.stamps_ns)


def test_the_encoder_of_the_paper_has_no_epochs():
    counts = flown('paper').counts
    assert (counts['epochs'], counts['codes_used'] > 250) == (0, True)


class Brightness:
    """A measure that knows nothing but brightness: the difference is a distance."""

    direction, worst = -1, 1.0

    def prepare(self, descriptor):
        return descriptor.astype(np.float32)

    def compare(self, query, kept):
        return np.abs(kept - query).mean(axis=(1, 2))


def test_any_description_of_a_frame_with_a_measure_of_its_own_takes_the_place_of_codes():
    """Frames are described by arrays of any shape; mu of a distance has a minus sign."""
    described = DescriptorEncoder(lambda frame: frame.grey[::2, ::8] / 255.0, CONFIG.view)
    encoded = encode(events(FLIGHT_S), CONFIG, described)
    assert encoded.counts['frames'] == flown().counts['frames']
    near = CONFIG.override({'ratslam.threshold': -0.1, 'ratslam.tracking_threshold': -0.1})
    result = map_codes(encoded, near, Brightness())
    assert result.counts['closures'] > 0 and result.counts['epochs'] == 0
    assert error(result.poses, result.stamps_ns) < 0.6 * error(result.odometry, result.stamps_ns)
    never = CONFIG.override({'ratslam.threshold': 0.0, 'ratslam.tracking_threshold': 0.0})
    assert map_codes(encoded, never, Brightness()).counts['closures'] == 0


# What is refused

def test_refused_frames_and_samples_are_counted_and_change_nothing():
    spoiled = []
    for event in events(FLIGHT_S):
        spoiled.append(event)
        if isinstance(event, Frame):
            spoiled.append(Frame(event.stamp_ns, event.grey))
            spoiled.append(Frame(event.stamp_ns + 1, np.zeros((0, 0), np.uint8)))
        else:
            spoiled.append(event)
    result = run(spoiled, CONFIG)
    assert result.counts['frames_refused'] == 2 * result.counts['frames']
    assert result.counts['odometry_out_of_order'] == result.counts['odometry_accepted']
    np.testing.assert_array_equal(result.poses, flown().poses)


@pytest.mark.parametrize('flight, used', [
    ([], 0), (odometry(5.0), 0), (frames(5.0), 0), (frames(0.1) + odometry(0.05), 1)])
def test_a_flight_with_hardly_anything_in_it_gives_hardly_anything(flight, used):
    flight = sorted(flight, key=lambda event: getattr(event, 'sample', event).stamp_ns)
    result = run(flight, CONFIG)
    assert result.stamps_ns.shape == (used,)
    assert result.poses.shape == result.final_poses.shape == (used, 3)
    assert result.experiences.shape == (used, 3)
    assert result.counts['view_cells'] == result.counts['experiences'] == used
