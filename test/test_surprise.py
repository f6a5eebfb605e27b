"""The QBS gate on sequences worked out by hand."""

import numpy as np
import pytest

from dlsc_qbs_ros.core.surprise import SurpriseGate


def run(errors, window=5):
    """Return surprise after, and gate before, each error."""
    gate = SurpriseGate(window)
    opened, surprises = [], []
    for error in errors:
        opened.append(gate.is_open)
        gate.observe(error)
        surprises.append(gate.surprise)
    return surprises, opened


def test_surprise_starts_at_1_and_the_gate_open():
    gate = SurpriseGate(5)
    assert (gate.surprise, gate.is_open) == (1.0, True)


def test_the_first_difference_is_known_after_the_second_frame():
    surprises, opened = run([7.0, 4.0, 9.0])
    assert surprises == [1.0, -3.0, 1.0]
    assert opened == [True, True, False]


def test_surprise_is_the_mean_of_the_last_five_differences():
    """Differences: 4, -1, -3, 2, 6, -9, 0; means of up to five of them, the newest last."""
    surprises, opened = run([1.0, 5.0, 4.0, 1.0, 3.0, 9.0, 0.0, 0.0])
    assert surprises == pytest.approx([1.0, 4.0, 1.5, 0.0, 0.5, 8 / 5, -5 / 5, -4 / 5])
    assert opened == [True, True, True, True, False, True, True, False]


def test_a_window_of_one_is_the_bare_difference():
    assert run([1.0, 3.0, 2.0, 2.0], window=1)[0] == [1.0, 2.0, -1.0, 0.0]


def test_no_change_is_no_surprise():
    assert run([2.0] * 8)[1] == [True, True] + [False] * 6


@pytest.mark.parametrize('window', [1, 2, 5, 9])
def test_surprise_is_the_moving_average_written_out(window):
    errors = np.random.default_rng(window).exponential(100.0, 60)
    surprises, _ = run(errors.tolist(), window)
    differences = np.diff(errors)
    expected = [np.mean(differences[max(0, k - window):k]) for k in range(1, len(errors))]
    assert surprises[1:] == pytest.approx(expected)
