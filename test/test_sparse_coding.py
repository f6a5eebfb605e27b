"""The codes: what minimises the LASSO problem, and the paper's iterations towards it."""

from algorithm_1 import prox
import numpy as np
import pytest

from dlsc_qbs_ros.core.sparse_coding import Lasso, proximal_steps, soft_threshold, squared_errors

LAMBDA_1 = 0.2


def problem(seed, n_samples=7, n_atoms=12, n_inputs=40):
    """Return inputs (n, N), atoms (M, N), b and Gram matrix, float64."""
    rng = np.random.default_rng(seed)
    inputs = rng.normal(0.0, 1.0, (n_samples, n_inputs))
    atoms = rng.normal(0.0, 0.3, (n_atoms, n_inputs)) + 0.2 * rng.normal(size=n_inputs)
    return inputs, atoms, inputs @ atoms.T, atoms @ atoms.T


def step_of(gram):
    return 1.0 / np.linalg.eigvalsh(gram)[-1]


def objective(codes, inputs, atoms, lambda_1=LAMBDA_1):
    return (0.5 * np.sum((codes @ atoms - inputs) ** 2, axis=-1)
            + lambda_1 * np.sum(np.abs(codes), axis=-1))


def coordinate_descent(s, atoms, lambda_1, sweeps=400):
    c = np.zeros(len(atoms))
    for _ in range(sweeps):
        for m, atom in enumerate(atoms):
            rest = s - c @ atoms + c[m] * atom
            c[m] = soft_threshold(rest @ atom, lambda_1) / (atom @ atom)
    return c


@pytest.mark.parametrize('x, expected', [
    (1.0, 0.7), (-1.0, -0.7), (0.3, 0.0), (-0.2, 0.0), (0.0, 0.0)])
def test_soft_threshold_draws_towards_zero_by_the_threshold(x, expected):
    assert soft_threshold(np.array(x), 0.3) == pytest.approx(expected)


def test_soft_threshold_is_the_proximal_operator_of_the_paper():
    x = np.random.default_rng(0).normal(size=200)
    np.testing.assert_allclose(soft_threshold(x, 0.4), prox(x, 0.4), atol=1e-15)


def test_proximal_steps_are_those_on_the_input_itself():
    inputs, atoms, b, gram = problem(0)
    codes = np.random.default_rng(1).normal(size=b.shape)
    literal = codes.copy()
    for _ in range(6):
        literal = prox(literal - 0.01 * (literal @ atoms - inputs) @ atoms.T, 0.01 * LAMBDA_1)
    np.testing.assert_allclose(
        proximal_steps(codes, b, gram, 0.01, LAMBDA_1, 6), literal, atol=1e-12)


def test_no_steps_leave_the_codes_alone():
    _, _, b, gram = problem(0)
    np.testing.assert_array_equal(proximal_steps(b, b, gram, 0.01, LAMBDA_1, 0), b)


def test_squared_errors_are_those_of_the_reprojection():
    inputs, atoms, b, gram = problem(2)
    codes = np.random.default_rng(1).normal(size=b.shape)
    np.testing.assert_allclose(
        squared_errors(codes, b, gram, np.sum(inputs ** 2, axis=1)),
        np.sum((codes @ atoms - inputs) ** 2, axis=1))


# The converged codes

@pytest.mark.parametrize('seed', range(5))
@pytest.mark.parametrize('lambda_1', [0.0, 0.2, 3.0])
def test_lasso_meets_its_optimality_conditions(seed, lambda_1):
    """Where c is not 0, b - G c = lambda_1 sign(c); where it is, |b - G c| <= lambda_1."""
    _, _, b, gram = problem(seed)
    codes = Lasso(gram, lambda_1).solve(b)
    pull = b - codes @ gram
    slack = 1e-4 * np.abs(b).max()
    used = codes != 0.0
    np.testing.assert_allclose(pull[used], lambda_1 * np.sign(codes[used]), atol=slack)
    assert (np.abs(pull[~used]) <= lambda_1 + slack).all()


@pytest.mark.parametrize('lambda_1', [0.2, 3.0])
def test_lasso_finds_what_coordinate_descent_finds(lambda_1):
    inputs, atoms, b, gram = problem(3, n_atoms=6)
    expected = [coordinate_descent(s, atoms, lambda_1) for s in inputs]
    codes = Lasso(gram, lambda_1).solve(b)
    np.testing.assert_allclose(codes, expected, atol=1e-4 * np.abs(codes).max())


def test_lasso_of_orthonormal_atoms_is_the_soft_threshold():
    b = np.random.default_rng(0).normal(size=(5, 4))
    np.testing.assert_allclose(
        Lasso(np.eye(4), 0.3).solve(b), soft_threshold(b, 0.3), atol=1e-12)


def test_no_code_near_by_costs_less():
    inputs, atoms, b, gram = problem(4)
    codes = Lasso(gram, LAMBDA_1).solve(b)
    least = objective(codes, inputs, atoms)
    rng = np.random.default_rng(5)
    for size in (1e-3, 1e-2, 1e-1, 1.0):
        for _ in range(50):
            other = objective(codes + rng.normal(0.0, size, codes.shape), inputs, atoms)
            assert (other > least - 1e-8).all()


def test_a_heavy_enough_penalty_leaves_nothing():
    _, _, b, gram = problem(5)
    assert not Lasso(gram, np.abs(b).max() * 1.001).solve(b).any()
    assert Lasso(gram, np.abs(b).max() * 0.999).solve(b).any()


def test_a_code_does_not_depend_on_the_scale_of_the_problem():
    """Atoms twice as long under twice the penalty make codes half as long."""
    _, _, b, gram = problem(6)
    codes = Lasso(gram, LAMBDA_1).solve(b)
    halved = Lasso(4 * gram, 2 * LAMBDA_1).solve(2 * b)
    np.testing.assert_allclose(halved, codes / 2, atol=1e-12)


def test_nothing_seen_is_coded_as_nothing():
    _, _, b, gram = problem(7)
    b[2] = 0.0
    codes = Lasso(gram, LAMBDA_1).solve(b)
    assert not codes[2].any()
    assert codes[[0, 1, 3]].any(axis=1).all()


def test_a_fast_sample_is_as_exact_beside_a_slow_one():
    """A batch goes on until its slowest sample has converged; the others stand still."""
    _, _, b, gram = problem(8)
    step = step_of(gram)
    together = Lasso(gram, LAMBDA_1).solve(b)
    alone = np.concatenate([Lasso(gram, LAMBDA_1).solve(row[None]) for row in b])
    np.testing.assert_allclose(together, alone, atol=1e-12)
