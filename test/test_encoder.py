"""The encoder pipeline: what one frame gives, when an epoch starts, what is refused."""

from algorithm_1 import algorithm_1
from loop_flight import CONFIG, frames
import numpy as np
import pytest
from vectors import vectors_of

from dlsc_qbs_ros.core.preprocessing import make_view
from dlsc_qbs_ros.core.types import Frame
from dlsc_qbs_ros.errors import ImageError, StampError
from dlsc_qbs_ros.pipeline.coder import Coder
from dlsc_qbs_ros.pipeline.encoder import Encoder

FRAMES = frames(12.0)
SECOND_NS = 1_000_000_000
RUN_AWAY = {'encoder.eta_c': 1e-2, 'encoder.gate': False}


def encoded(images=FRAMES, **changes):
    encoder = Encoder(CONFIG.override(changes))
    return [encoder.process(frame) for frame in images]


def assert_same(results, others):
    for one, other in zip(results, others, strict=True):
        np.testing.assert_array_equal(one.code.values, other.code.values)
        assert (one.surprise, one.learned, one.epoch) == (
            other.surprise, other.learned, other.epoch)


def test_everything_carries_the_stamp_of_its_frame():
    for frame, result in zip(FRAMES, encoded()):
        assert (result.code.stamp_ns, result.view.stamp_ns) == (frame.stamp_ns, frame.stamp_ns)
        if result.dictionary:
            assert result.dictionary.stamp_ns == frame.stamp_ns


def test_a_frame_gives_a_code_per_atom_and_its_view():
    for frame, result in zip(FRAMES, encoded()):
        assert (result.code.values.shape, result.code.values.dtype) == ((16,), np.float32)
        np.testing.assert_array_equal(result.view.pixels, make_view(frame.grey, CONFIG.view))


def test_the_same_frames_give_the_same_codes_to_the_last_bit():
    assert_same(encoded(), encoded())


def test_another_seed_gives_other_codes():
    a, b = encoded()[50].code.values, encoded(**{'encoder.seed': 1})[50].code.values
    assert np.abs(a - b).max() > 1e-2


# Epochs

def test_the_first_frame_starts_an_epoch():
    first, second = encoded()[:2]
    assert first.dictionary is not None
    assert (first.epoch, second.dictionary) == (1, None)


def test_codes_refer_to_the_dictionary_that_went_out_last():
    name, n_epochs = None, 0
    for result in encoded():
        if result.dictionary:
            name, n_epochs = result.dictionary.stamp_ns, n_epochs + 1
        assert (result.code.dictionary_ns, result.epoch) == (name, n_epochs)
    assert n_epochs > 3


def test_a_view_under_the_dictionary_that_went_out_gives_the_code_that_went_out():
    for result in encoded():
        if result.dictionary:
            coder = Coder(result.dictionary, CONFIG)
        code = coder.encode_views([result.view.pixels])[0]
        np.testing.assert_allclose(
            code, result.code.values, atol=1e-5 * np.abs(result.code.values).max())


@pytest.mark.parametrize('epoch_change', [0.05, 0.25, 0.6])
def test_a_new_dictionary_goes_out_once_the_live_one_has_moved_too_far(epoch_change):
    """The live dictionary is seen through epochs as short as can be: the learner is the same."""
    live = held = None
    for fine, result in zip(encoded(**{'encoder.epoch_change': 1e-3}),
                            encoded(**{'encoder.epoch_change': epoch_change})):
        live = fine.dictionary.atoms if fine.dictionary else live
        if held is not None:
            change = np.linalg.norm(live - held) / np.linalg.norm(held)
            assert (change > epoch_change) == (result.dictionary is not None) or (
                change == pytest.approx(epoch_change, abs=2e-3))
        held = result.dictionary.atoms if result.dictionary else held


def test_a_dictionary_that_went_out_is_not_written_to_any_more():
    encoder = Encoder(CONFIG)
    dictionary = encoder.process(FRAMES[0]).dictionary
    before = dictionary.atoms.copy()
    for frame in FRAMES[1:10]:
        encoder.process(frame)
    np.testing.assert_array_equal(dictionary.atoms, before)


def test_the_learner_does_not_feel_the_epochs():
    errors = [[result.reprojection_error for result in encoded(**{'encoder.epoch_change': change})]
              for change in (0.05, 10.0)]
    assert errors[0] == pytest.approx(errors[1], rel=1e-4)


def test_without_learning_there_is_one_epoch():
    results = encoded(**{'encoder.n_learning': 0})
    assert {result.epoch for result in results} == {1}


# Modes

def test_in_paper_mode_codes_come_from_the_live_dictionary_and_nothing_else_goes_out():
    for result in encoded(**{'encoder.mode': 'paper'}):
        assert (result.dictionary, result.code.dictionary_ns, result.epoch) == (None, None, 0)
        assert result.code.values.dtype == np.float32


def test_the_mode_changes_codes_but_not_what_is_learned():
    paper, epochs = encoded(**{'encoder.mode': 'paper'}), encoded()
    assert [result.learned for result in paper] == [result.learned for result in epochs]
    assert [result.reprojection_error for result in paper] == pytest.approx(
        [result.reprojection_error for result in epochs], rel=1e-4)
    assert np.abs(paper[30].code.values - epochs[30].code.values).max() > 1e-3


def test_the_gate_decides_which_frames_are_learned_from():
    results = encoded()
    assert [result.learned for result in results[:2]] == [True, True]
    for before, after in zip(results[1:], results[2:]):
        assert after.learned == (before.surprise > 0.0)
    assert len({result.learned for result in results}) == 2


def test_without_the_gate_every_frame_is_learned_from():
    assert all(result.learned for result in encoded(**{'encoder.gate': False}))


# What is refused

@pytest.mark.parametrize('grey', [
    np.zeros((0, 0), np.uint8), np.zeros((24, 120, 3), np.uint8), np.zeros((24, 120))])
def test_an_image_that_is_none_is_refused_and_changes_nothing(grey):
    encoder = Encoder(CONFIG)
    results = []
    for frame in FRAMES[:40]:
        with pytest.raises(ImageError):
            encoder.process(Frame(frame.stamp_ns, grey))
        results.append(encoder.process(frame))
    assert_same(results, encoded(FRAMES[:40]))


@pytest.mark.parametrize('back_ns', [0, 1, SECOND_NS // 2])
def test_a_stamp_that_is_not_after_the_last_is_refused_and_changes_nothing(back_ns):
    encoder = Encoder(CONFIG)
    results = []
    for frame in FRAMES[:40]:
        results.append(encoder.process(frame))
        late_ns = frame.stamp_ns - back_ns
        with pytest.raises(StampError, match=f'stamp {late_ns} ns: expected one after '
                                             f'{frame.stamp_ns} ns'):
            encoder.process(Frame(late_ns, 255 - frame.grey))
    assert_same(results, encoded(FRAMES[:40]))


def test_a_clock_that_starts_again_is_followed():
    encoder = Encoder(CONFIG)
    for frame in FRAMES[:30]:
        encoder.process(frame)
    assert encoder.process(FRAMES[0]).code.stamp_ns == FRAMES[0].stamp_ns
    assert encoder.process(FRAMES[1]).code.stamp_ns == FRAMES[1].stamp_ns


@pytest.mark.parametrize('value', [0, 128, 255])
def test_plain_images_are_encoded_as_nothing(value):
    plain = [Frame(frame.stamp_ns, np.full_like(frame.grey, value)) for frame in FRAMES[:20]]
    for result in encoded(plain):
        assert not result.code.values.any()


# A learner that runs away

@pytest.mark.parametrize('eta_d', [0.02, 0.1, 0.5, 2.0, 10.0])
@pytest.mark.parametrize('n_learning', [1, 2])
@pytest.mark.filterwarnings('ignore::RuntimeWarning')
def test_whatever_the_rates_codes_and_dictionaries_stay_finite(eta_d, n_learning):
    changes = {**RUN_AWAY, 'encoder.eta_d': eta_d, 'encoder.n_learning': n_learning}
    results = encoded(FRAMES[:60], **changes)
    for result in results:
        assert np.isfinite(result.code.values).all()
        if result.dictionary:
            assert np.abs(result.dictionary.atoms).max() < 100.0


@pytest.mark.filterwarnings('ignore::RuntimeWarning')
def test_a_learner_that_ran_away_starts_again_from_the_last_snapshot():
    config = CONFIG.override({'encoder.eta_c': 1e-2, 'encoder.eta_d': 0.5})
    encoder, held, before, n_restarts = Encoder(config), None, None, 0
    for frame in FRAMES[:60]:
        result = encoder.process(frame)
        if before and before.ran_away:
            inputs = vectors_of([result.view.pixels], True)
            fresh = next(algorithm_1(inputs, held.T, eta_c=1e-2, eta_d=0.5, lambda_1=0.2,
                                     n_coding=10, n_learning=1))
            assert result.reprojection_error == pytest.approx(fresh.error, rel=1e-4)
            assert result.learned  # the gate is open as at the start
        held = result.dictionary.atoms if result.dictionary else held
        n_restarts += result.ran_away
        before = result
    assert n_restarts > 1


def test_a_sound_learner_never_runs_away():
    assert not any(result.ran_away for result in encoded())
