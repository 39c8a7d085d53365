"""One check of exact derivatives against finite differences, for every test that needs it."""

from collections.abc import Callable

import numpy as np


def assert_jacobian(
    function: Callable[[np.ndarray], np.ndarray],
    point: np.ndarray,
    jacobian: np.ndarray,
    steps: np.ndarray | float = 1e-6,
    tolerance: float = 1e-6,
) -> None:
    """Assert that `jacobian` is that of `function` at `point`, by fourth-order central differences.

    Args:
        function: (n,) -> (m,) or ().
        point: (n,).
        jacobian: (m, n) or (n,).
        steps: per variable.
        tolerance: relative to the largest entry of each column of the jacobian, or to 1e-3 of the largest of all.
    """
    point = np.asarray(point, dtype=float)
    exact = np.atleast_2d(np.asarray(jacobian, dtype=float))
    h = np.broadcast_to(steps, point.shape)
    columns = []
    for i, e in enumerate(np.eye(len(point))):
        values = [np.atleast_1d(function(point + k * h[i] * e)).ravel() for k in (-2, -1, 1, 2)]
        columns.append((values[0] - 8 * values[1] + 8 * values[2] - values[3]) / (12 * h[i]))
    measured = np.column_stack(columns)
    scale = np.maximum(np.abs(exact).max(axis=0), 1e-3 * np.abs(exact).max() + 1e-300)
    error = np.abs(measured - exact).max(axis=0) / scale
    assert error.max() < tolerance, f"column {int(error.argmax())} is off by {error.max():.1e} of its size"
