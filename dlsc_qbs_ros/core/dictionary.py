"""The continual dictionary learner: Algorithm 1's two inner loops on a live dictionary."""

from __future__ import annotations

import numpy as np

from . import kernel
from .learner import Learner
from .planes import PlaneProjection
from .preprocessing import input_scale, N_PAPER, PixelInputs
from .projection import gram_of, Projection
from .snapshot import NextSnapshot, Relation, subtract_product
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
    Dictionary phi and warm-started codes of a stream of inputs.

    A step takes a batch of n inputs that belong to one frame, one whole view in the paper's
    algorithm. The dictionary follows the mean gradient of the batch.

    A learning step adds to each atom multiples of the atoms and of the inputs. So nothing of
    size N is written: the live atoms are kept as a mix of the rows of a snapshot and of the
    inputs learned from since, and all else happens in M x M. Only the products of an input with
    these rows read N numbers a row, and they give its products with the live atoms and with the
    snapshot's, to which published codes refer, at once. A new snapshot is taken when the live
    atoms have moved by `epoch_change`, or when there is no room for more inputs; it is made
    over several frames where it is large.

    Attributes
    ----------
    codes_ : ndarray of shape (n, n_atoms), float64
        The codes of the last frame, where the next frame's iterations start.
    gram_ : ndarray of shape (n_atoms, n_atoms), float64
        atoms_ @ atoms_.T
    snapshot_gram_ : ndarray of shape (n_atoms, n_atoms), float64
        snapshot_ @ snapshot_.T
    snapshot_products_ : ndarray of shape (n, n_atoms), float64
        Products of the last frame's inputs with the snapshot's atoms.

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
        mix = self._live.mix[:, :self._n_rows]
        for columns, block in self._rows.combine(mix, 0, self._rows.n_inputs):
            atoms[:, columns] = block
        return atoms

    @property
    def snapshot_(self) -> np.ndarray:
        """Return the atoms (n_atoms, n_inputs), float32, as they were; never written to."""
        atoms = self._rows.atoms
        atoms.flags.writeable = False
        return atoms

    def restart(self, atoms: np.ndarray) -> None:
        """Go on from these atoms (n_atoms, n_inputs) and zero codes."""
        atoms = np.array(atoms, np.float32, order='C')
        self._rows = make_projection(atoms, self._room)
        self.snapshot_gram_ = gram_of(self.snapshot_)
        self._go_on_from_snapshot(1.0)

    def fall_back(self) -> None:
        """
        Go on from the atoms of the snapshot and zero codes.

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
        self.codes_ = np.zeros((1, self._config.n_atoms))
        self._drift = self._measure_drift()

    def infer(self, inputs: np.ndarray | PixelInputs) -> float:
        """
        Infer the codes of a batch (lines 2 to 4) and return its mean reprojection error e_k.

        Parameters
        ----------
        inputs : PixelInputs, or ndarray of shape (n, n_inputs), float32
            The n input vectors s_k of one frame; by the kernel, long ones only as PixelInputs.

        Raises
        ------
        ValueError
            When there are more of them than can be kept: `n_atoms` at the paper's size.

        """
        if len(inputs) > self._room:
            raise ValueError(f'{len(inputs)} inputs in a frame: expected at most {self._room}')
        if len(self.codes_) != len(inputs):
            self.codes_ = np.zeros((len(inputs), self._config.n_atoms))
        self._tend_snapshot()
        self._products = self._rows.products(inputs)
        self.snapshot_products_ = self._products[:, :self._config.n_atoms]
        self._b, self.codes_, self._gradient, beyond = infer(
            self._products, self._live.mix[:, :self._n_rows], self.codes_, self.gram_,
            self._config.eta_c, self._config.lambda_1, self._config.n_coding)
        self._among = self._rows.gram(inputs)
        return (float(self._among.trace()) + beyond) / len(inputs)

    def learn(self, inputs: np.ndarray | PixelInputs) -> None:
        """
        Take `n_learning` gradient steps on the dictionary from the batch just inferred.

        Lines 5 to 11. With residuals r = c phi - s, phi becomes phi - eta_d c^T r / n, and the
        products with it follow: g = r phi^T = c G - b, s r^T = b c^T - s s^T, and
        r r^T = g c^T - r s^T, of which only the symmetric part matters.
        """
        codes, b, gradient = self.codes_, self._b, self._gradient
        rate = self._config.eta_d / len(inputs)
        if not (self._config.n_learning * rate * codes).any():
            return  # phi stays as it is: there is no input to keep
        relations = [(self._live, self.snapshot_products_)]
        if self._next is not None:
            relations.append((self._next.live, self._next.products(self._products)))
        kept = self._rows.keep(inputs)
        for _ in range(self._config.n_learning):
            input_residuals = b @ codes.T - self._among
            residuals = gradient @ codes.T - input_residuals
            for relation, products in relations:
                relation.learn(codes, products, kept, rate)
            half = rate * gradient - (0.5 * rate * rate) * (residuals @ codes)
            subtract_product(self.gram_, codes, half)
            subtract_product(self.gram_, half, codes)
            b = b - rate * input_residuals @ codes
            gradient = codes @ self.gram_ - b
        self._drift = self._measure_drift()

    @property
    def _n_rows(self) -> int:
        return self._config.n_atoms + self._rows.n_kept

    def _measure_drift(self) -> float:
        """Return how far the live atoms are from the snapshot's, in Frobenius norms of these."""
        held = np.trace(self.snapshot_gram_)
        squared = np.trace(self.gram_) - 2.0 * np.trace(self._live.cross) + held
        return np.sqrt(max(squared, 0.0) / held)

    def _tend_snapshot(self) -> None:
        """Work on a snapshot where one is begun or due, and see that there is room for inputs."""
        n_frame = len(self.codes_)
        if (self._next is not None or self._drift > self._config.epoch_change
                or self._rows.room < FRAMES_AHEAD * n_frame):
            self._make_snapshot()
        while self._rows.room < n_frame:
            self._make_snapshot()

    def _make_snapshot(self) -> None:
        """Begin a snapshot or go on with it for one frame; adopt it once it is whole."""
        if self._next is None:
            self._next = NextSnapshot(
                self._rows, self._live.mix[:, :self._n_rows], self.gram_, self._room)
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
