"""The continual dictionary learner: Algorithm 1's two inner loops on a live dictionary."""

from __future__ import annotations

import numpy as np

from .preprocessing import input_scale, N_PAPER
from .projection import gram_of, make_projection
from .snapshot import NextSnapshot, Relation, subtract_product
from .sparse_coding import proximal_steps
from ..config import EncoderConfig

# A snapshot is begun while there is room left for the inputs of so many frames.
FRAMES_AHEAD = 10
TOUCHED_PER_FRAME = 1 << 18
# The share of the limit of lambda_max that is left in use by falling back.
HEADROOM = 0.8


class DictionaryLearner:
    """
    Dictionary phi and warm-started codes of a stream of inputs.

    A step takes a batch of n inputs that belong to one frame: one whole view in the paper's
    algorithm, or the patches of one. The dictionary follows the mean gradient of the batch.

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
    snapshot_ : ndarray of shape (n_atoms, n_inputs), float32
        The atoms as they were at an earlier frame; never written to.
    snapshot_gram_ : ndarray of shape (n_atoms, n_atoms), float64
        snapshot_ @ snapshot_.T
    snapshot_products_ : ndarray of shape (n, n_atoms), float64
        Products of the last frame's inputs with the snapshot's atoms.

    """

    def __init__(self, n_inputs: int, config: EncoderConfig):
        self._config = config
        self._room = max(
            config.n_atoms * min(max(N_PAPER // n_inputs, 1), 8), 2 * FRAMES_AHEAD)
        deviation = config.sigma_w * input_scale(n_inputs)
        self.restart(np.random.default_rng(config.seed).normal(
            0.0, deviation, (config.n_atoms, n_inputs)).astype(np.float32))

    @property
    def atoms_(self) -> np.ndarray:
        """Make the live dictionary, the paper's phi transposed: (n_atoms, n_inputs), float32."""
        atoms = np.empty_like(self.snapshot_)
        self._rows.combine(self._live.mix[:, :self._n_rows], atoms)
        return atoms

    @property
    def lambda_max(self) -> float:
        """Return the largest eigenvalue of the Gram matrix; infinite when it is not finite."""
        finite = np.isfinite(self.gram_).all()
        return float(np.linalg.eigvalsh(self.gram_)[-1]) if finite else np.inf

    @property
    def lambda_max_limit(self) -> float:
        """Return 2 / eta_c: coding converges while lambda_max is below."""
        return 2.0 / self._config.eta_c

    @property
    def is_stable(self) -> bool:
        """Whether eta_c < 2 / lambda_max(G): learning has not run away."""
        limit = self.lambda_max_limit
        power = self.gram_
        for exponent in (1, 2, 4):  # ||G^p||^(1/p) bounds lambda_max from above, ever closer
            if np.linalg.norm(power) < limit ** exponent:
                return True
            power = power @ power
        return self.lambda_max < limit

    def restart(self, atoms: np.ndarray) -> None:
        """Go on from these atoms (n_atoms, n_inputs) and zero codes."""
        self.snapshot_ = np.array(atoms, np.float32, order='C')
        self.snapshot_.flags.writeable = False
        self.snapshot_gram_ = gram_of(self.snapshot_)
        self._rows = make_projection(self.snapshot_, self._room)
        self._spare, self._n_touched = np.empty_like(self.snapshot_), 0
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
        self._n_kept = 0
        self._live = Relation(self.snapshot_gram_, self._room, scale)
        self._next: NextSnapshot | None = None
        self.gram_ = scale * scale * self.snapshot_gram_
        self.codes_ = np.zeros((1, self._config.n_atoms))
        self._drift = self._measure_drift()

    def infer(self, inputs: np.ndarray) -> float:
        """
        Infer the codes of a batch (lines 2 to 4) and return its mean reprojection error e_k.

        Parameters
        ----------
        inputs : ndarray of shape (n, n_inputs), float32
            The input vectors s_k of one frame.

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
        self._products = self._rows.products(inputs, self._n_kept)
        self.snapshot_products_ = self._products[:, :self._config.n_atoms]
        self._b = self._products @ self._live.mix[:, :self._n_rows].T
        self._among = gram_of(inputs)
        self.codes_ = proximal_steps(
            self.codes_, self._b, self.gram_,
            self._config.eta_c, self._config.lambda_1, self._config.n_coding)
        self._gradient = self.codes_ @ self.gram_ - self._b
        # ||r||^2 = c (g - b) + ||s||^2, with the gradient g = r phi^T = c G - b.
        squared = np.vdot(self.codes_, self._gradient - self._b) + np.trace(self._among)
        return float(squared) / len(inputs)

    def learn(self, inputs: np.ndarray) -> None:
        """
        Take `n_learning` gradient steps on the dictionary from the batch just inferred.

        Lines 5 to 11. With residuals r = c phi - s, phi becomes phi - eta_d c^T r / n, and the
        products with it follow: g = r phi^T = c G - b, s r^T = b c^T - s s^T, and
        r r^T = g c^T - r s^T, of which only the symmetric part matters.
        """
        codes, rate = self.codes_, self._config.eta_d / len(inputs)
        if not (self._config.n_learning * rate * codes).any():
            return  # phi stays as it is: there is no input to keep
        relations = [(self._live, self.snapshot_products_)]
        if self._next is not None:
            relations.append((self._next.live, self._next.products(self._products)))
        self._rows.keep(self._n_kept, inputs)
        for _ in range(self._config.n_learning):
            input_residuals = self._b @ codes.T - self._among
            residuals = self._gradient @ codes.T - input_residuals
            for relation, products in relations:
                relation.learn(codes, products, self._n_kept, rate)
            half = rate * self._gradient - (0.5 * rate * rate) * (residuals @ codes)
            subtract_product(self.gram_, codes, half)
            subtract_product(self.gram_, half, codes)
            self._b -= rate * input_residuals @ codes
            self._gradient = codes @ self.gram_ - self._b
        self._n_kept += len(inputs)
        self._drift = self._measure_drift()

    @property
    def _n_rows(self) -> int:
        return self._config.n_atoms + self._n_kept

    def _measure_drift(self) -> float:
        """Return how far the live atoms are from the snapshot's, in Frobenius norms of these."""
        held = np.trace(self.snapshot_gram_)
        squared = np.trace(self.gram_) - 2.0 * np.trace(self._live.cross) + held
        return np.sqrt(max(squared, 0.0) / held)

    def _tend_snapshot(self) -> None:
        """Work on a snapshot where one is begun or due, and see that there is room for inputs."""
        n_frame = len(self.codes_)
        if self._next is None:
            self._touch_spare()
        if (self._next is not None or self._drift > self._config.epoch_change
                or self._n_kept + FRAMES_AHEAD * n_frame > self._room):
            self._make_snapshot()
        while self._n_kept + n_frame > self._room:
            self._make_snapshot()

    def _make_snapshot(self) -> None:
        """Begin a snapshot or go on with it for one frame; adopt it once it is whole."""
        if self._next is None:
            self._next = NextSnapshot(
                self._spare, self._rows, self._live.mix[:, :self._n_rows], self.gram_, self._room)
        self._next.make_columns()
        if self._next.is_whole:
            self._adopt(self._next)

    def _adopt(self, snapshot: NextSnapshot) -> None:
        """Go on from a new snapshot, with the inputs learned from since it was begun."""
        kept = slice(snapshot.n_kept, self._n_kept)
        self._rows.replace(snapshot.atoms, kept)
        snapshot.live.move_kept(kept)
        self._n_kept -= snapshot.n_kept
        self.snapshot_, self.snapshot_gram_ = snapshot.atoms, snapshot.gram
        self._live, self._next = snapshot.live, None
        self._drift = self._measure_drift()
        self._spare, self._n_touched = np.empty_like(self.snapshot_), 0

    def _touch_spare(self) -> None:
        """Use some of the next snapshot's memory: its first frame would have it all mapped."""
        end = self._n_touched + TOUCHED_PER_FRAME
        self._spare.reshape(-1)[self._n_touched:end] = 0.0
        self._n_touched = end
