"""Live atoms as a mix of a snapshot and kept inputs; the next snapshot, made meanwhile."""

import numpy as np
import pytest
from vectors import Vector

from dlsc_qbs_ros.core import snapshot
from dlsc_qbs_ros.core.projection import Projection
from dlsc_qbs_ros.core.snapshot import NextSnapshot, Relation

N_ATOMS, ROOM, N_INPUTS, RATE = 6, 12, 50, 0.05


class World:
    """A snapshot, kept inputs and live atoms, all written out in float64."""

    def __init__(self, seed=0, n_inputs=N_INPUTS, scale=1.0):
        self.rng = np.random.default_rng(seed)
        self.atoms = self.rng.normal(size=(N_ATOMS, n_inputs))
        self.live = scale * self.atoms
        self.kept = np.zeros((0, n_inputs))
        self.relation = Relation(self.atoms @ self.atoms.T, ROOM, scale)

    @property
    def rows(self):
        return np.concatenate([self.atoms, self.kept])

    @property
    def mix(self):
        """Return the mix of the rows in use."""
        return self.relation.mix[:, :len(self.rows)]

    def draw(self):
        """Draw a code (N_ATOMS,) and an input (n_inputs,)."""
        return self.rng.normal(size=N_ATOMS), self.rng.normal(size=self.atoms.shape[1])

    def learn(self, n_learning=1):
        """Take steps from a new input; return its code and the input."""
        code, s = self.draw()
        for _ in range(n_learning):
            self.relation.learn(code, self.atoms @ s, len(self.kept), RATE)
            self.live = self.live - RATE * np.outer(code, code @ self.live - s)
        self.kept = np.vstack([self.kept, s])
        return code, s


def assert_close(a, b):
    np.testing.assert_allclose(a, b, rtol=0.0, atol=1e-10 * np.abs(b).max())


# Relation

@pytest.mark.parametrize('scale', [1.0, 0.5])
def test_at_first_the_live_atoms_are_those_of_the_snapshot_times_a_scale(scale):
    world = World(scale=scale)
    assert_close(world.mix @ world.rows, scale * world.atoms)
    assert_close(world.relation.cross, scale * world.atoms @ world.atoms.T)
    assert not world.relation.mix[:, N_ATOMS:].any()


@pytest.mark.parametrize('n_learning', [1, 4])
@pytest.mark.parametrize('scale', [1.0, 0.5])
def test_learning_keeps_the_relation(n_learning, scale):
    world = World(scale=scale)
    for _ in range(ROOM):
        world.learn(n_learning)
        assert_close(world.mix @ world.rows, world.live)
        assert_close(world.relation.cross, world.live @ world.atoms.T)
        assert not world.relation.mix[:, len(world.rows):].any()


def test_the_gram_matrix_of_the_snapshot_is_left_as_it_was():
    gram = np.eye(N_ATOMS)
    relation = Relation(gram, ROOM)
    relation.learn(np.ones(N_ATOMS), np.ones(N_ATOMS), 0, RATE)
    np.testing.assert_array_equal(gram, np.eye(N_ATOMS))


@pytest.mark.parametrize('kept', [slice(0, 0), slice(0, 3), slice(4, 7), slice(2, 10)])
def test_moving_kept_inputs_to_the_first_slots_moves_their_weights(kept):
    relation = Relation(np.eye(N_ATOMS), ROOM)
    before = np.zeros((N_ATOMS, ROOM))
    before[:, kept] = np.random.default_rng(0).normal(size=(N_ATOMS, kept.stop - kept.start))
    relation.mix[:, N_ATOMS:] = before
    relation.move_kept(kept)
    n = kept.stop - kept.start
    np.testing.assert_array_equal(relation.mix[:, N_ATOMS:N_ATOMS + n], before[:, kept])
    assert not relation.mix[:, N_ATOMS + n:].any()
    np.testing.assert_array_equal(relation.mix[:, :N_ATOMS], np.eye(N_ATOMS))


# NextSnapshot

def begun(world, n_columns, monkeypatch):
    """Begin a snapshot of the live atoms of a world."""
    monkeypatch.setattr(snapshot, 'COLUMNS_PER_FRAME', n_columns)
    rows = Projection(world.atoms.astype(np.float32), ROOM)
    for s in world.kept:
        rows.keep(Vector(s.astype(np.float32)))
    return rows, NextSnapshot(rows, world.mix, world.live @ world.live.T, ROOM)


@pytest.mark.parametrize('n_columns, n_frames', [(1, 50), (7, 8), (25, 2), (49, 2), (50, 1),
                                                 (1000, 1)])
def test_a_snapshot_is_made_some_columns_at_a_time(n_columns, n_frames, monkeypatch):
    world = World()
    for _ in range(5):
        world.learn()
    expected = world.live
    rows, following = begun(world, n_columns, monkeypatch)
    assert following.n_kept == 5
    for _ in range(n_frames):
        assert not following.is_whole
        following.make_columns()
        if rows.room:
            rows.keep(Vector(world.learn()[1].astype(np.float32)))
    assert following.is_whole
    np.testing.assert_allclose(following.atoms, expected, atol=1e-5)


def test_its_gram_matrix_is_that_of_the_live_atoms_when_it_was_begun(monkeypatch):
    world = World()
    world.learn()
    gram = world.live @ world.live.T
    _, following = begun(world, 10, monkeypatch)
    gram_given = following.gram
    world.learn()
    assert_close(gram_given, gram)


def test_products_with_a_snapshot_in_the_making_come_from_those_with_the_rows(monkeypatch):
    """Though no column of it has been made, and inputs have been kept since it was begun."""
    world = World()
    for _ in range(4):
        world.learn()
    held = world.live
    _, following = begun(world, 10, monkeypatch)
    for _ in range(4):
        world.learn()
        _, s = world.draw()
        assert_close(following.products(world.rows @ s), held @ s)


def test_live_atoms_that_learn_on_are_followed_in_terms_of_the_next_snapshot(monkeypatch):
    world = World()
    for _ in range(4):
        world.learn()
    held, n_before = world.live, len(world.kept)
    _, following = begun(world, 10, monkeypatch)
    for _ in range(8):
        before = world.rows
        code, s = world.learn()
        following.live.learn(code, following.products(before @ s), len(before) - N_ATOMS, RATE)
        rows = np.concatenate([held, world.kept])
        assert_close(following.live.mix[:, :len(rows)] @ rows, world.live)
        assert_close(following.live.cross, world.live @ held.T)
    kept = slice(n_before, len(world.kept))
    following.live.move_kept(kept)
    rows = np.concatenate([held, world.kept[kept]])
    assert_close(following.live.mix[:, :len(rows)] @ rows, world.live)
