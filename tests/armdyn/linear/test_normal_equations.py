"""Sums against the samples that they are of."""

import numpy as np

from armdyn.linear.normal_equations import NormalEquations


def test_sums_tell_errors_and_fits_as_the_samples_do() -> None:
    rng = np.random.default_rng(0)
    X, r = [rng.standard_normal((n, 4)) for n in (30, 50)], [rng.standard_normal(n) for n in (30, 50)]
    sums = NormalEquations(
        np.array([x.T @ x for x in X]), np.array([x.T @ y for x, y in zip(X, r, strict=True)]),
        np.array([y @ y for y in r]), np.array([30.0, 50.0]),
    )  # fmt: skip
    change = np.array([0.3, 0.0, -2.0, 1.0])
    left = [float(np.sum((y - x @ change) ** 2)) for x, y in zip(X, r, strict=True)]
    np.testing.assert_allclose(sums.squared_error(change, np.array([0, 1])), left)
    gram, slope = sums.weighted(np.array([1.0, 4.0]), np.array([0, 1]))
    stacked, target = np.vstack([X[0], 2.0 * X[1]]), np.concatenate([r[0], 2.0 * r[1]])
    np.testing.assert_allclose(np.linalg.solve(gram, slope), np.linalg.lstsq(stacked, target)[0])
