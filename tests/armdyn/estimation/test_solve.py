"""Small quadratic problems against another library and the conditions of their minimum."""

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from armdyn.estimation.solve import BoundedSolution, inverse_positive, log_det, solve_bounded, solve_positive


def drawn(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """A least-squares problem of 1 to 20 unknowns in different units, most of them bounded: (m, n), (m,), 2 x (n,)."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 21))
    X = rng.standard_normal((3 * n + 1, n)) @ (np.eye(n) + (seed % 3) * rng.standard_normal((n, n)))
    X *= 10.0 ** rng.uniform(-3, 3, n)
    typical = 1.0 / np.linalg.norm(X, axis=0)
    # A third starts on its bound, as an effect does that is absent.
    lower, upper = (np.where(rng.random(n) < 0.3, 0.0, np.abs(rng.standard_normal(n))) * typical for _ in range(2))
    lower, upper = np.where(rng.random(n) < 0.3, np.inf, lower), np.where(rng.random(n) < 0.3, np.inf, upper)
    upper = np.where(lower + upper > 0, upper, np.inf)
    return X, 3.0 * rng.standard_normal(len(X)), -lower, upper


def broken(A: np.ndarray, b: np.ndarray, found: BoundedSolution) -> float:
    """By how much a solution breaks the conditions of Karush, Kuhn and Tucker, in units of the unknowns' own pull."""
    size = np.sqrt(np.diagonal(A, axis1=-2, axis2=-1))
    wrong = np.where(found.on_bound == 0, np.abs(found.gradient), found.on_bound * found.gradient) / size
    return float(np.max(np.maximum(wrong, 0.0) / (1.0 + np.linalg.norm(b / size, axis=-1, keepdims=True))))


def test_a_thousand_bounded_minima_equal_those_of_another_library_and_meet_their_conditions() -> None:
    for seed in range(1000):
        X, y, lower, upper = drawn(seed)
        A, b = X.T @ X, X.T @ y
        found = solve_bounded(A, b, lower, upper)
        assert np.all((lower <= found.x) & (found.x <= upper))
        assert broken(A, b, found) < 1e-8
        size = np.linalg.norm(X, axis=0)
        peer = lsq_linear(X / size, y, (lower * size, upper * size), method="bvls", tol=1e-14)
        np.testing.assert_allclose(found.x * size, peer.x, atol=1e-6 * (1.0 + np.abs(peer.x).max()))


def test_an_unknown_that_was_put_on_its_bound_is_released_where_the_others_need_it() -> None:
    """Without bounds both unknowns are negative; with the first at 0 the second is positive."""
    A, b = np.array([[1.0, -0.9], [-0.9, 1.0]]), np.array([-0.55, 0.4])
    found = solve_bounded(A, b, np.zeros(2), np.full(2, np.inf))
    np.testing.assert_allclose(solve_positive(A, b), [-1.0, -0.5])
    np.testing.assert_allclose(found.x, [0.0, 0.4])
    assert found.on_bound.tolist() == [-1, 0]


def test_a_matrix_that_rounding_has_made_indefinite_has_a_minimum_as_well() -> None:
    """Sums of a pneumatic chamber's samples: released at its bound the third unknown leaves it, and held it pulls."""
    A = np.array(
        [
            [1.0, -0.258423, 0.17690076, -0.22047138],
            [-0.258423, 1.0, -0.99638885, 0.99920914],
            [0.17690076, -0.99638885, 1.0, -0.99897761],
            [-0.22047138, 0.99920914, -0.99897761, 1.0],
        ]
    )
    A -= (np.linalg.eigvalsh(A)[0] + 3.7e-7) * np.eye(4)
    b = np.array([-49.82930802, 37.99014322, -34.27361936, 36.32323603])
    lower = np.array([-1111.42935725, -12665.47476678, -12414.22741442, -np.inf])
    found = solve_bounded(A, b, lower, np.array([554880.7, 7370074.3, 16143038.5, np.inf]))
    assert np.isfinite(found.x).all()
    assert np.all(found.x >= lower)


def test_problems_solved_at_once_have_the_minima_of_each_alone() -> None:
    rng = np.random.default_rng(1)
    X = rng.standard_normal((50, 12, 6))
    A, b = np.swapaxes(X, 1, 2) @ X, 3.0 * rng.standard_normal((50, 6))
    lower, upper = np.full(6, -0.1), np.full(6, 0.1)
    together = solve_bounded(A, b, lower, upper)
    alone = [solve_bounded(*one, lower, upper).x for one in zip(A, b, strict=True)]
    assert (together.on_bound != 0).any(axis=1).sum() > 40
    np.testing.assert_allclose(together.x, alone, atol=1e-12)


@pytest.mark.parametrize("exponent", [0.0, 8.0])
def test_determinant_and_solution_do_not_depend_on_the_unknowns_units(exponent: float) -> None:
    rng = np.random.default_rng(2)
    X, b = rng.standard_normal((9, 4)), rng.standard_normal(4)
    A, unit = X.T @ X, 10.0 ** (exponent * np.arange(4))
    there = A * np.outer(unit, unit)
    np.testing.assert_allclose(log_det(there), np.linalg.slogdet(A)[1] + 2.0 * np.log(unit).sum(), rtol=1e-10)
    np.testing.assert_allclose(solve_positive(there, b * unit) * unit, np.linalg.solve(A, b), rtol=1e-9)
    np.testing.assert_allclose(inverse_positive(there) * np.outer(unit, unit), np.linalg.inv(A), rtol=1e-8)
