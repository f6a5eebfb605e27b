"""The learner of patches is Algorithm 1 on unit atoms, written out literally in float64."""

from dataclasses import replace

from algorithm_1 import prox
import numpy as np
import pytest

from dlsc_qbs_ros.config import EncoderConfig, PatchesConfig
from dlsc_qbs_ros.core import kernel
from dlsc_qbs_ros.core.patch_dictionary import PatchLearner

N_INPUTS, N = 9, 200
ENCODER = EncoderConfig(n_atoms=16, lambda_1=0.1, epoch_change=0.05)
ALL = PatchesConfig(n_learned=N, eta_d=10.0)
TOLERANCE = 1e-5


def frames(n_frames, n=N, seed=0):
    """Return frames of n patches (n_frames, n, N_INPUTS), sparse sums of a few patterns."""
    rng = np.random.default_rng(seed)
    patterns = rng.normal(size=(12, N_INPUTS))
    weights = rng.normal(size=(n_frames, n, 12)) * (rng.random((n_frames, n, 12)) < 0.2)
    patches = weights @ patterns
    patches /= np.maximum(np.linalg.norm(patches, axis=2, keepdims=True), 1e-3)
    return (0.9 * patches).astype(np.float32)


class Literal:
    """Algorithm 1, patch by patch, and atoms back to length 1 after every frame."""

    def __init__(self, atoms, encoder, patches, n_frames=0):
        self.atoms, self._encoder, self._patches = atoms.astype(float), encoder, patches
        self._n_frames = n_frames

    def step(self, batch):
        phi, encoder = self.atoms.T, self._encoder
        eta_c = 1.0 / np.linalg.norm(phi, 2) ** 2
        self.codes = np.zeros((len(batch), phi.shape[1]))
        for i, s in enumerate(batch.astype(float)):
            for _ in range(encoder.n_coding):
                self.codes[i] = prox(self.codes[i] - eta_c * phi.T @ (phi @ self.codes[i] - s),
                                     eta_c * encoder.lambda_1)
        error = np.mean([np.sum((phi @ c - s) ** 2) for c, s in zip(self.codes, batch)])
        eta_d = self._patches.eta_d * (1.0 + 90.0 / (30 + self._n_frames))
        for _ in range(encoder.n_learning):
            phi = phi - eta_d * np.mean(
                [np.outer(phi @ c - s, c) for c, s in zip(self.codes, batch)], axis=0)
        self.atoms = (phi / np.linalg.norm(phi, axis=0)).T
        self._n_frames += 1
        return error


def step(learner, batch):
    error = learner.infer(batch)
    learner.learn(batch)
    return error


@pytest.mark.parametrize('n_learning', [0, 1, 3])
@pytest.mark.parametrize('has_kernel', [True, False])
def test_it_is_the_literal_algorithm_through_many_snapshots(n_learning, has_kernel, monkeypatch):
    if not has_kernel:
        monkeypatch.setattr(kernel, 'LIBRARY', None)
    encoder = EncoderConfig(n_atoms=16, lambda_1=0.1, epoch_change=0.05, n_learning=n_learning)
    learner = PatchLearner(N_INPUTS, encoder, ALL)
    literal, held = Literal(learner.atoms_, encoder, ALL), set()
    for batch in frames(40):
        assert step(learner, batch) == pytest.approx(literal.step(batch), rel=TOLERANCE)
        np.testing.assert_allclose(learner.codes_, literal.codes, atol=TOLERANCE)
        np.testing.assert_allclose(learner.atoms_, literal.atoms, atol=TOLERANCE)
        np.testing.assert_allclose(learner.gram_, literal.atoms @ literal.atoms.T, atol=TOLERANCE)
        held.add(id(learner.snapshot_))
        assert learner.is_stable
    assert (len(held) > 2) == (n_learning > 0)


def test_it_learns_what_patches_are_made_of():
    learner = PatchLearner(N_INPUTS, ENCODER, ALL)
    errors = [step(learner, batch) for batch in frames(200)]
    assert np.mean(errors[-20:]) < 0.8 * np.mean(errors[:5])


def test_atoms_are_of_length_1_from_the_first():
    learner = PatchLearner(N_INPUTS, ENCODER, ALL)
    for batch in frames(20):
        np.testing.assert_allclose(np.linalg.norm(learner.atoms_, axis=1), 1.0, rtol=1e-6)
        step(learner, batch)


@pytest.mark.parametrize('n_learned', [1, 30, N, 10 * N])
def test_as_many_patches_are_learned_from_as_told_drawn_anew_each_frame(n_learned):
    """The step is the mean over some of the patches, each once."""
    learner = PatchLearner(N_INPUTS, ENCODER, PatchesConfig(n_learned=n_learned, eta_d=1e-3))
    twin = PatchLearner(N_INPUTS, ENCODER, PatchesConfig(n_learned=n_learned, eta_d=1e-3))
    rng, drawn = np.random.default_rng(ENCODER.seed), []
    for k, batch in enumerate(frames(5)):
        n = min(n_learned, N)
        drawn.append(rng.choice(N, n, replace=False))
        literal = Literal(learner.atoms_, ENCODER, PatchesConfig(eta_d=1e-3), n_frames=k)
        for one in (learner, twin):
            step(one, batch)
        literal.step(batch[drawn[-1]])
        np.testing.assert_allclose(learner.atoms_, literal.atoms, atol=1e-6)
        np.testing.assert_array_equal(learner.atoms_, twin.atoms_)
    assert n_learned >= N or len({tuple(chosen) for chosen in drawn}) == 5


@pytest.mark.parametrize('seed', range(3))
def test_atoms_are_without_mean_as_patches_are(seed):
    encoder = replace(ENCODER, seed=seed)
    learner = PatchLearner(N_INPUTS, encoder, ALL)
    for batch in frames(20):
        np.testing.assert_allclose(learner.atoms_.mean(axis=1), 0.0, atol=1e-6)
        step(learner, batch - batch.mean(axis=1, keepdims=True))


def test_the_first_steps_are_the_longest_and_none_is_shorter_than_eta_d():
    """Four times eta_d at first, half of what is too much after 30 frames learned from."""
    patches = PatchesConfig(n_learned=N, eta_d=1e-3)
    learner, (batch,) = PatchLearner(N_INPUTS, ENCODER, patches), frames(1)
    lengths = []
    for _ in range(301):
        learner.infer(batch)
        before = learner.atoms_
        learner.learn(batch)
        lengths.append(np.linalg.norm(learner.atoms_ - before))
    assert lengths[30] / lengths[0] == pytest.approx(2.5 / 4.0, rel=0.01)
    assert lengths[300] / lengths[0] == pytest.approx((1.0 + 3.0 / 11.0) / 4.0, rel=0.05)


def test_what_does_not_learn_does_not_settle():
    learner, (batch,) = PatchLearner(N_INPUTS, ENCODER, ALL), frames(1)
    for _ in range(100):
        learner.infer(batch)
    literal = Literal(learner.atoms_, ENCODER, ALL)
    step(learner, batch)
    literal.step(batch)
    np.testing.assert_allclose(learner.atoms_, literal.atoms, atol=TOLERANCE)


# Snapshots

def test_a_snapshot_is_taken_when_the_atoms_have_moved_by_epoch_change():
    learner, n_taken = PatchLearner(N_INPUTS, ENCODER, ALL), 0
    for batch in frames(60):
        held, live = learner.snapshot_, learner.atoms_
        has_moved = np.linalg.norm(live - held) > 0.05 * np.linalg.norm(held)
        learner.infer(batch)
        assert learner.snapshot_ is (live if has_moved else held)
        n_taken += has_moved
        learner.learn(batch)
    assert n_taken > 2


def test_a_snapshot_is_never_written_to():
    learner, held = PatchLearner(N_INPUTS, ENCODER, ALL), []
    for batch in frames(40):
        held.append((learner.snapshot_, learner.snapshot_.copy()))
        step(learner, batch)
    for atoms, copy in held:
        assert (atoms.dtype, atoms.flags.writeable) == (np.float32, False)
        np.testing.assert_array_equal(atoms, copy)


def test_the_products_for_published_codes_are_those_with_the_snapshot():
    learner = PatchLearner(N_INPUTS, ENCODER, ALL)
    for batch in frames(40):
        learner.infer(batch)
        held = learner.snapshot_.astype(float)
        np.testing.assert_allclose(learner.snapshot_products_, batch @ held.T, atol=1e-6)
        np.testing.assert_allclose(learner.snapshot_gram_, held @ held.T, atol=1e-6)
        learner.learn(batch)


def test_falling_back_goes_on_from_the_snapshot():
    learner = PatchLearner(N_INPUTS, ENCODER, ALL)
    for batch in frames(25):
        step(learner, batch)
    learner.fall_back()
    np.testing.assert_allclose(learner.atoms_, learner.snapshot_, atol=1e-7)
    twin = PatchLearner(N_INPUTS, ENCODER, ALL)
    twin.restart(learner.snapshot_)
    for batch in frames(5, seed=1):
        assert learner.infer(batch) == pytest.approx(twin.infer(batch), rel=1e-6)


@pytest.mark.filterwarnings('ignore::RuntimeWarning')
def test_what_is_not_finite_is_not_stable():
    learner = PatchLearner(N_INPUTS, ENCODER, ALL)
    batch = frames(1)[0]
    learner.infer(batch)
    batch[:, 3] = np.nan
    learner.infer(batch)
    learner.learn(batch)
    assert not learner.is_stable
    learner.fall_back()
    assert learner.is_stable
