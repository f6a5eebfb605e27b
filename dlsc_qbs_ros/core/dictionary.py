"""The continual dictionary learner: Algorithm 1's two inner loops on a live dictionary."""

from __future__ import annotations

from math import sqrt

import numpy as np

from . import kernel
from .learner import Learner
from .planes import PlaneProjection
from .preprocessing import input_scale, N_PAPER, PixelInput
from .projection import gram_of, Projection
from .snapshot import NextSnapshot, Relation
from .sparse_coding import infer
from ..config import EncoderConfig

# From this many inputs on, three bytes an entry are worth their unpacking.
LONG = 16384
# A snapshot is begun while there is room left for the inputs of so many frames.
FRAMES_AHEAD = 10
# The share of the limit of lambda_max that is left in use by falling back.
HEADROOM = 0.8


class DictionaryLearner(Learner):
    """
    Dictionary phi and warm-started code of a stream of whole views, one input vector a frame.

    A learning step adds to each atom multiples of the atoms and of the inputs. So nothing of
    size N is written: the live atoms are kept as a mix of the rows of a snapshot and of the
    inputs learned from since, and all else happens in M x M. Only the products of an input with
    these rows read N numbers a row, and they give its products with the live atoms and with the
    snapshot's, to which published codes refer, at once. A new snapshot is taken when the live
    atoms have moved by `epoch_change`, or when there is no room for more inputs; it is made
    over several frames where it is large.

    Attributes
    ----------
    gram_ : ndarray of shape (n_atoms, n_atoms), float64
        atoms_ @ atoms_.T
    snapshot_gram_ : ndarray of shape (n_atoms, n_atoms), float64
        snapshot_ @ snapshot_.T

    """

    def __init__(self, n_inputs: int, config: EncoderConfig):
        super().__init__(config.eta_c)
        self._config = config
        self._room = max(config.n_atoms * min(max(N_PAPER // n_inputs, 1), 8), 2 * FRAMES_AHEAD)
        deviation = config.sigma_w * input_scale(n_inputs)
        self.restart(np.random.default_rng(config.seed).normal(
            0.0, deviation, (config.n_atoms, n_inputs)))

    @property
    def atoms_(self) -> np.ndarray:
        """Make the live dictionary, the paper's phi transposed: (n_atoms, n_inputs), float32."""
        atoms = np.empty((self._config.n_atoms, self._rows.n_inputs), np.float32)
        mix = self._live.used(self._rows.n_kept)
        for columns, block in self._rows.combine(mix, 0, self._rows.n_inputs):
            atoms[:, columns] = block
        return atoms

    @property
    def codes_(self) -> np.ndarray:
        """Return the code of the last frame, where the next frame's iterations start: one row."""
        return self._code[None]

    @property
    def snapshot_products_(self) -> np.ndarray:
        """Return the products of the last frame with the snapshot's atoms: one row."""
        return self._products[None, :self._config.n_atoms]

    @property
    def snapshot_(self) -> np.ndarray:
        """Return the atoms (n_atoms, n_inputs), float32, as they were; never written to."""
        atoms = self._rows.atoms
        atoms.flags.writeable = False
        return atoms

    def restart(self, atoms: np.ndarray) -> None:
        """Go on from these atoms (n_atoms, n_inputs) and a code of zeros."""
        atoms = np.array(atoms, np.float32, order='C')
        self._rows = make_projection(atoms, self._room)
        self.snapshot_gram_ = gram_of(self.snapshot_)
        self._go_on_from_snapshot(1.0)

    def fall_back(self) -> None:
        """
        Go on from the atoms of the snapshot and a code of zeros.

        All are scaled down where their lambda_max is so near the limit that learning would soon
        be back here: atoms that only ever learn grow without bound.
        """
        highest = np.linalg.eigvalsh(self.snapshot_gram_)[-1]
        self._go_on_from_snapshot(min(1.0, np.sqrt(HEADROOM * self.lambda_max_limit / highest)))

    def _go_on_from_snapshot(self, scale: float) -> None:
        self._rows.forget()
        self._live = Relation(self.snapshot_gram_, self._room, scale)
        self._next: NextSnapshot | None = None
        self.gram_ = scale * scale * self.snapshot_gram_
        self._code = np.zeros(self._config.n_atoms)
        self._drift = self._measure_drift()

    def infer(self, vector: PixelInput) -> float:
        """
        Infer the code of the next frame (lines 2 to 4) and return its reprojection error e_k.

        Parameters
        ----------
        vector : PixelInput
            The input vector s_k.

        """
        self._tend_snapshot()
        self._products = self._rows.products(vector)
        self._b, self._code, self._gradient, beyond = infer(
            self._products, self._live.used(self._rows.n_kept), self._code, self.gram_,
            self._config.eta_c, self._config.lambda_1, self._config.n_coding)
        return vector.squared_norm + beyond

    def learn(self, vector: PixelInput) -> None:
        """
        Take `n_learning` gradient steps on the dictionary from the frame just inferred.

        Lines 5 to 11. With the residual r = c phi - s, phi becomes phi - eta_d outer(c, r), and
        the products with it follow: g = phi r = G c - b, s r = b c - s s and r r = g c - s r.
        """
        code, b, gradient, rate = self._code, self._b, self._gradient, self._config.eta_d
        if self._config.n_learning * rate * (code @ code) == 0.0:
            return  # phi stays as it is: there is no input to keep
        relations = [(self._live, self._products[:self._config.n_atoms])]
        if self._next is not None:
            relations.append((self._next.live, self._next.products(self._products)))
        slot = self._rows.keep(vector)
        for _ in range(self._config.n_learning):
            of_input = b @ code - vector.squared_norm
            squared = gradient @ code - of_input
            for relation, products in relations:
                relation.learn(code, products, slot, rate)
            half = code[:, None] * (rate * gradient - (0.5 * rate * rate * squared) * code)
            self.gram_ -= half + half.T
            b = b - (rate * of_input) * code
            gradient = self.gram_ @ code - b
        self._drift = self._measure_drift()

    def _measure_drift(self) -> float:
        """Return how far the live atoms are from the snapshot's, in Frobenius norms of these."""
        held = self.snapshot_gram_.trace()
        squared = self.gram_.trace() - 2.0 * self._live.cross.trace() + held
        return sqrt(max(squared, 0.0) / held)

    def _tend_snapshot(self) -> None:
        """Work on a snapshot where one is begun or due, and see that there is room for inputs."""
        if (self._next is not None or self._drift > self._config.epoch_change
                or self._rows.room < FRAMES_AHEAD):
            self._make_snapshot()
        while not self._rows.room:
            self._make_snapshot()

    def _make_snapshot(self) -> None:
        """Begin a snapshot or go on with it for one frame; adopt it once it is whole."""
        if self._next is None:
            self._next = NextSnapshot(
                self._rows, self._live.used(self._rows.n_kept), self.gram_, self._room)
        self._next.make_columns()
        if self._next.is_whole:
            self._adopt(self._next)

    def _adopt(self, snapshot: NextSnapshot) -> None:
        """Go on from a new snapshot, with the inputs learned from since it was begun."""
        snapshot.live.move_kept(self._rows.replace(snapshot.atoms, snapshot.n_kept))
        self.snapshot_gram_ = snapshot.gram
        self._live, self._next = snapshot.live, None
        self._drift = self._measure_drift()


def make_projection(atoms: np.ndarray, room: int) -> Projection:
    """Return the projection with room for so many inputs that is cheapest here."""
    is_long = kernel.LIBRARY is not None and atoms.shape[1] >= LONG
    return (PlaneProjection if is_long else Projection)(atoms, room)
