"""Values and the states in which windows begin, eliminated from one least-squares problem."""

from types import SimpleNamespace as Plain

import numpy as np
import pytest

from armdyn.identify.motion.motion_fit import _Cost, _Descent


def test_without_the_starts_of_windows_values_are_those_of_the_whole_problem():
    random = np.random.default_rng(3)
    rows = [slice(0, 40), slice(40, 90)]
    slopes, of_starts = random.normal(size=(3, 90, 2)), random.normal(size=(4, 90, 2))
    share, held, errors = random.uniform(0.5, 2.0, (90, 2)), np.full((2, 4), 0.7), random.normal(size=(90, 2))
    H, own, inner = _Descent._eliminated(Plain(_rows=rows), slopes, of_starts, share, held)

    whole = np.zeros((3 + 8, 90, 2))  # all values, then the states of both windows
    whole[:3] = slopes
    for w, mine in enumerate(rows):
        whole[3 + 4 * w : 7 + 4 * w, mine] = of_starts[:, mine]
    A = np.einsum("unj,vnj->uv", whole * share, whole) + np.diag(np.append(np.zeros(3), held.ravel()))
    b = -np.einsum("unj,nj->u", whole, share * errors)
    assert np.linalg.inv(H) == pytest.approx(np.linalg.inv(A)[:3, :3], rel=1e-9)
    pulls = -np.einsum("unj,nj->u", own, share * errors)
    every = np.linalg.solve(A, b)
    assert np.linalg.solve(H, pulls) == pytest.approx(every[:3], rel=1e-9)
    for w, (inverse, B) in enumerate(inner):
        of_window = -np.einsum("snj,nj->s", of_starts[:, rows[w]], (share * errors)[rows[w]])
        assert inverse @ (of_window - B.T @ every[:3]) == pytest.approx(every[3 + 4 * w : 7 + 4 * w], rel=1e-9)


def test_large_errors_count_as_their_sizes_and_small_ones_as_their_squares():
    cost = _Cost(np.array([0.1]), np.zeros(1), np.zeros(1), np.zeros((1, 2)))
    small, large = (cost.of(np.full((5, 1), e), np.zeros(1), np.zeros((1, 2))) for e in (1e-3, 100.0))
    assert small == pytest.approx((1e-3 / 0.1) ** 2, rel=1e-3)
    assert large == pytest.approx(2.0 * 100.0 / 0.1, rel=1e-2)
