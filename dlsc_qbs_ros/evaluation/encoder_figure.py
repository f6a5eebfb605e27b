"""The paper's figure on the encoder in numbers: what it claims, and whether a flight shows it."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any, Mapping, Sequence

import numpy as np

# Neighbouring pixels of noise correlate by 1 / sqrt(2 N) or so, 0.02 at 43x32: far below this.
STRUCTURE = 0.1


@dataclass(frozen=True)
class Finding:
    """A claim of the paper, whether it held on one flight, and the numbers behind that."""

    claim: str
    held: bool
    sentence: str
    numbers: Mapping[str, Any]

    def as_json(self) -> dict[str, Any]:
        """Return the finding as encoder.json has it."""
        finding = asdict(self)
        return {**finding.pop('numbers'), **finding}


def replay_finding(gated: tuple, always: tuple, draws: Sequence[tuple]) -> Finding:
    """
    Compare the replays after learning with QBS, without, and from frames drawn at random.

    Parameters
    ----------
    gated, always : tuple
        A pipeline.continual_learning.Learning, and the errors of its replay, shape (n,).
    draws : sequence of tuple
        The same for runs that learned from as many frames as `gated`, whichever they were. They
        tell whether the gate's choice of frames matters or merely that it chose fewer.

    """
    mine, other, *means = (_or_infinite(errors).mean() for _, errors in (gated, always, *draws))
    share = float(np.mean(_or_infinite(gated[1]) < _or_infinite(always[1])))
    held, best = bool(mine < other), bool(mine < min(means))
    sentence = (
        f'mean replay error {_number(mine)} with QBS, learned from {gated[0].learned.sum()} of '
        f'{len(gated[1])} frames{_end(gated[0])}, {_number(other)} without'
        f'{_end(always[0])}, lower with QBS on {share:.0%} of the frames; as many frames drawn at '
        f'random give {", ".join(map(_number, means))}: the gate\'s choice is '
        f'{"" if best else "not "}better than each of these')
    return Finding(
        'QBS leads to a lower reprojection error during replay.', held,
        _verdict('a', held, sentence), {
            'with_qbs': _replay_numbers(*gated), 'without_qbs': _replay_numbers(*always),
            'random_frames': [_replay_numbers(*draw) for draw in draws],
            'share_lower_with_qbs': share, 'better_than_random_frames': best})


def run_away_finding(gated, always) -> Finding:
    """
    Compare the stability of learning with QBS and without.

    Both are a pipeline.continual_learning.Learning. A run away is any frame after which coding
    does not converge, eta_c >= 2 / lambda_max(G), or an error that is not finite.
    """
    held = bool(gated.stable.all() and not always.stable.all())
    return Finding(
        'Without QBS learning can run away; with it learning is stable.', held,
        _verdict('b', held, f'without QBS the dictionary {_course(always)}; '
                            f'with QBS it {_course(gated)}'),
        {'with_qbs': _course_numbers(gated), 'without_qbs': _course_numbers(always)})


def atoms_finding(start, gated, always, height: int, width: int) -> Finding:
    """
    Tell whether atoms of height * width pixels are features, and how many distinct ones.

    `start`, `gated` and `always` are a pipeline.continual_learning.Learning: from no frame, with
    QBS and without. What is left of a dictionary that ran away counts for nothing.
    """
    numbers = {name: _atoms_numbers(learning, height, width) for name, learning in (
        ('start', start), ('with_qbs', gated), ('without_qbs', always))}
    mine, other = numbers['with_qbs'], numbers['without_qbs']
    held = bool(2 * mine['structured_atoms'] > mine['atoms']
                and mine['distinct_atoms'] > other['distinct_atoms'])
    sentence = '; '.join(
        f'{label} {of["structured_atoms"]} of {of["atoms"]} atoms have structure, and they count '
        f'for {of["distinct_atoms"]:.1f} distinct ones{_end(learning)}'
        for label, of, learning in (('with QBS', mine, gated), ('without', other, always),
                                    ('before learning', numbers['start'], start)))
    return Finding('QBS leads to the learning of a more diverse set of features.', held,
                   _verdict('c', held, sentence), numbers)


def structure(atoms: np.ndarray, height: int, width: int) -> np.ndarray:
    """
    Return the correlation of neighbouring pixels in each atom, shape (n_atoms,), in [-1, 1].

    It is 0 for noise and near 1 for a smooth picture; NaN for a plain atom or one not finite.
    """
    with np.errstate(all='ignore'):
        maps = atoms.reshape(-1, height, width).astype(np.float64)
        maps = maps - maps.mean(axis=(1, 2), keepdims=True)
        beside = np.mean(maps[:, :, 1:] * maps[:, :, :-1], axis=(1, 2))
        below = np.mean(maps[:, 1:] * maps[:, :-1], axis=(1, 2))
        return (beside + below) / (2.0 * np.mean(maps * maps, axis=(1, 2)))


def distinct_atoms(atoms: np.ndarray) -> float:
    """
    Return the participation ratio of atoms at unit length: (sum l)^2 / sum l^2.

    l are the eigenvalues of their Gram matrix: n_atoms when all are orthogonal, 1 when all are
    one; NaN when an atom is zero or not finite.
    """
    with np.errstate(all='ignore'):
        unit = atoms / np.linalg.norm(atoms.astype(np.float64), axis=1, keepdims=True)
        return float(len(unit) ** 2 / np.sum((unit @ unit.T) ** 2))


def _replay_numbers(learning, errors: np.ndarray) -> dict[str, Any]:
    return {'learning_frames': int(learning.learned.sum()),
            'left_stable_range_at': _first(~learning.stable),
            'learning_not_finite_at': _first(np.isnan(learning.errors)),
            'replay_not_finite_at': _first(np.isnan(errors)),
            'mean': _finite(_or_infinite(errors).mean()),
            'median': _finite(np.median(_or_infinite(errors)))}


def _atoms_numbers(learning, height: int, width: int) -> dict[str, Any]:
    ran_away = np.isnan(learning.errors).any()
    found = np.zeros(1) if ran_away else structure(learning.atoms, height, width)
    return {'atoms': len(learning.atoms),
            'structured_atoms': int(np.sum(found > STRUCTURE)),
            'median_structure': _finite(np.median(found)),
            'distinct_atoms': 0.0 if ran_away else distinct_atoms(learning.atoms)}


def _course_numbers(learning) -> dict[str, Any]:
    finite = learning.errors[np.isfinite(learning.errors)]
    return {'learning_frames': int(learning.learned.sum()),
            'left_stable_range_at': _first(~learning.stable),
            'frames_outside': int(np.sum(~learning.stable)),
            'not_finite_at': _first(np.isnan(learning.errors)),
            'median_error': float(np.median(finite)) if len(finite) else None,
            'largest_finite_error': float(finite.max()) if len(finite) else None}


def _course(learning) -> str:
    numbers = _course_numbers(learning)
    left = f'left the stable range at frame {numbers["left_stable_range_at"]}'
    if numbers['not_finite_at'] is not None:
        return f'{left} and was not finite from frame {numbers["not_finite_at"]} on'
    largest = f'largest error {_number(numbers["largest_finite_error"])}'
    if numbers['left_stable_range_at'] is None:
        return f'stayed in the stable range ({largest})'
    return f'{left}, was outside for {numbers["frames_outside"]} frames ({largest})'


def _end(learning) -> str:
    """Say what became of a dictionary that left the stable range: the rest hangs on rounding."""
    left, end = _first(~learning.stable), _first(np.isnan(learning.errors))
    if left is None:
        return ''
    lost = '' if end is None else f' and was not finite from frame {end} on'
    return f' (its dictionary left the stable range at frame {left}{lost})'


def _verdict(panel: str, held: bool, sentence: str) -> str:
    return f'({panel}) {"held" if held else "did not hold"}: {sentence}.'


def _or_infinite(errors: np.ndarray) -> np.ndarray:
    return np.where(np.isnan(errors), np.inf, errors)


def _first(mask: np.ndarray) -> int | None:
    return int(mask.argmax()) if mask.any() else None


def _finite(value: float) -> float | None:
    """Return a number as JSON knows it: None where it is not finite."""
    return float(value) if np.isfinite(value) else None


def _number(value: float) -> str:
    return f'{value:.4g}' if np.isfinite(value) else 'not finite'
