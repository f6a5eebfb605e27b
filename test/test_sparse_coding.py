"""The codes: what minimises the LASSO problem, and the paper's iterations towards it."""

from algorithm_1 import prox
import numpy as np
import pytest

from dlsc_qbs_ros.core import kernel, sparse_coding
from dlsc_qbs_ros.core.sparse_coding import infer, Lasso, soft_threshold, sparse_codes

LAMBDA_1 = 0.2


def problem(seed, n_samples=7, n_atoms=12, n_inputs=40):
    """Return inputs (n, N), atoms (M, N), b and Gram matrix, float64."""
    rng = np.random.default_rng(seed)
    inputs = rng.normal(0.0, 1.0, (n_samples, n_inputs))
    atoms = rng.normal(0.0, 0.3, (n_atoms, n_inputs)) + 0.2 * rng.normal(size=n_inputs)
    return inputs, atoms, inputs @ atoms.T, atoms @ atoms.T


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


@pytest.mark.parametrize('n_steps', [0, 1, 6])
def test_inferring_takes_the_steps_on_the_input_itself(n_steps):
    """Though the atoms are known as a mix of other rows only."""
    (s, *_), atoms, _, gram = problem(0)
    rng = np.random.default_rng(1)
    mix = np.linalg.qr(rng.normal(size=(12, 12)))[0]
    start = literal = rng.normal(size=12)
    for _ in range(n_steps):
        literal = prox(literal - 0.01 * atoms @ (literal @ atoms - s), 0.01 * LAMBDA_1)
    b, code, gradient, change = infer(
        mix.T @ atoms @ s, mix, start, gram, 0.01, LAMBDA_1, n_steps)
    np.testing.assert_allclose(b, atoms @ s, atol=1e-12)
    np.testing.assert_allclose(code, literal, atol=1e-12)
    np.testing.assert_allclose(gradient, atoms @ (literal @ atoms - s), atol=1e-12)
    assert change == pytest.approx(np.sum((literal @ atoms - s) ** 2) - s @ s)


@pytest.mark.parametrize('has_kernel', [True, False])
@pytest.mark.parametrize('n_steps', [1, 6])
def test_sparse_codes_are_the_steps_from_zero_on_the_inputs_themselves(
        n_steps, has_kernel, monkeypatch):
    if not has_kernel:
        monkeypatch.setattr(kernel, 'LIBRARY', None)
    inputs, atoms, b, gram = problem(0)
    literal = np.zeros_like(b)
    for _ in range(n_steps):
        literal = prox(literal - 0.01 * (literal @ atoms - inputs) @ atoms.T, 0.01 * LAMBDA_1)
    codes = sparse_codes(b, gram, 0.01, LAMBDA_1, n_steps)
    assert codes.dtype == np.float32
    np.testing.assert_allclose(codes, literal, atol=1e-6)


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
    together = Lasso(gram, LAMBDA_1).solve(b)
    alone = np.concatenate([Lasso(gram, LAMBDA_1).solve(row[None]) for row in b])
    np.testing.assert_allclose(together, alone, atol=1e-12)


# How exact they are: by active sets in float64, and by descent where there is no other way

@pytest.fixture(params=[False, pytest.param(True, marks=pytest.mark.skipif(
    kernel.LIBRARY is None, reason='the compiled kernel was not built'))],
    ids=['numpy', 'kernel'])
def with_and_without_kernel(request, monkeypatch):
    if not request.param:
        monkeypatch.setattr(kernel, 'LIBRARY', None)


def violation(codes, b, gram, lambda_1):
    """Return how far the optimality conditions are missed, relative to the largest |b|."""
    pull = b - codes @ gram
    missed = np.where(codes != 0.0, np.abs(pull - lambda_1 * np.sign(codes)),
                      np.maximum(np.abs(pull) - lambda_1, 0.0))
    return missed.max() / np.abs(b).max()


def forbid_descent(monkeypatch):
    monkeypatch.setattr(sparse_coding, 'MAX_STEPS', 0)


@pytest.mark.parametrize('n_atoms, n_inputs', [(1, 5), (12, 40), (64, 1376), (64, 100)])
@pytest.mark.parametrize('lambda_1', [0.0, 0.05, 0.2, 1.0, 5.0, 20.0, 1e3])
@pytest.mark.usefixtures('with_and_without_kernel')
def test_codes_of_independent_atoms_are_exact(n_atoms, n_inputs, lambda_1, monkeypatch):
    forbid_descent(monkeypatch)
    _, _, b, gram = problem(0, 50, n_atoms, n_inputs)
    assert violation(Lasso(gram, lambda_1).solve(b), b, gram, lambda_1) < 1e-10


@pytest.mark.parametrize('share', [0.0, 0.02, 0.1, 0.5, 0.9, 1.0])
@pytest.mark.usefixtures('with_and_without_kernel')
def test_codes_are_exact_however_many_entries_are_zero(share, monkeypatch):
    """From all of them to none; the penalty is the one that leaves about this share."""
    forbid_descent(monkeypatch)
    _, _, b, gram = problem(1, 40, 64, 1376)
    lambda_1 = 1.001 * np.quantile(np.abs(b), 1.0 - share) if share < 1.0 else 0.0
    codes = Lasso(gram, lambda_1).solve(b)
    assert violation(codes, b, gram, lambda_1) < 1e-10
    assert np.mean(codes != 0.0) == pytest.approx(share, abs=0.3)
    assert codes.any() == (share > 0.0)


@pytest.mark.parametrize('closeness', [1e-1, 1e-2, 1e-3])
@pytest.mark.usefixtures('with_and_without_kernel')
def test_two_atoms_that_are_nearly_one_are_told_apart(closeness, monkeypatch):
    forbid_descent(monkeypatch)
    inputs, atoms, _, _ = problem(2, 50, 16, 200)
    atoms[1] = atoms[0] + closeness * atoms[1]
    b, gram = inputs @ atoms.T, atoms @ atoms.T
    assert violation(Lasso(gram, LAMBDA_1).solve(b), b, gram, LAMBDA_1) < 1e-9


@pytest.mark.usefixtures('with_and_without_kernel')
def test_without_a_penalty_the_code_is_that_of_least_squares():
    inputs, atoms, b, gram = problem(3)
    expected = np.linalg.lstsq(atoms.T, inputs.T, rcond=None)[0].T
    np.testing.assert_allclose(Lasso(gram, 0.0).solve(b), expected, atol=1e-10)


@pytest.mark.parametrize('product, expected', [
    (3.0, 1.4), (-3.0, -1.4), (0.21, 0.005), (0.2, 0.0), (0.1, 0.0), (0.0, 0.0)])
@pytest.mark.usefixtures('with_and_without_kernel')
def test_the_code_of_one_atom_by_hand(product, expected):
    codes = Lasso(np.array([[2.0]]), 0.2).solve(np.array([[product]]))
    assert codes == pytest.approx(np.array([[expected]]), abs=1e-15)


@pytest.mark.parametrize('lambda_1', [0.0, 0.2])
@pytest.mark.parametrize('n_atoms', [12, 50])
@pytest.mark.usefixtures('with_and_without_kernel')
def test_an_input_without_products_has_no_code(lambda_1, n_atoms):
    *_, gram = problem(4, n_atoms=n_atoms)
    codes = Lasso(gram, lambda_1).solve(np.zeros((2, n_atoms)))
    np.testing.assert_array_equal(codes, np.zeros((2, n_atoms)))


@pytest.mark.parametrize('n_atoms', [41, 60])
@pytest.mark.parametrize('lambda_1', [0.2, 3.0])
@pytest.mark.usefixtures('with_and_without_kernel')
def test_codes_of_dependent_atoms_are_exact_to_the_tolerance(n_atoms, lambda_1):
    """More atoms than inputs: the code may not be the only one, but no other costs less."""
    _, _, b, gram = problem(5, 10, n_atoms, 40)
    codes = Lasso(gram, lambda_1).solve(b)
    assert violation(codes, b, gram, lambda_1) < 10 * sparse_coding.TOLERANCE


@pytest.mark.usefixtures('with_and_without_kernel')
def test_an_atom_that_occurs_twice_is_no_obstacle():
    inputs, atoms, _, _ = problem(6, 10, 6)
    atoms[3] = atoms[2]
    b, gram = inputs @ atoms.T, atoms @ atoms.T
    assert violation(
        Lasso(gram, LAMBDA_1).solve(b), b, gram, LAMBDA_1) < 10 * sparse_coding.TOLERANCE


@pytest.mark.usefixtures('with_and_without_kernel')
def test_where_no_guess_confirms_itself_in_time_the_code_is_found_by_descent(monkeypatch):
    _, _, b, gram = problem(7, 50, 64, 100)
    exact = Lasso(gram, LAMBDA_1).solve(b)
    monkeypatch.setattr(sparse_coding, 'MAX_SETS', 1)
    codes = Lasso(gram, LAMBDA_1).solve(b)
    assert violation(codes, b, gram, LAMBDA_1) < 10 * sparse_coding.TOLERANCE
    differs = np.any(codes != exact, axis=1)
    assert differs.any()
    np.testing.assert_allclose(codes, exact, atol=1e-2 * np.abs(exact).max())
