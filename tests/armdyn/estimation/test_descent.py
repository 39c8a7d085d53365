"""The nonlinear descent: nuisance unknowns are eliminated from one least-squares problem, and it ends where it says."""

import numpy as np
import pytest
from scipy.optimize import least_squares

from armdyn.estimation.descent import DescentSettings, Outcome, descend
from armdyn.estimation.expansion import QuadraticExpansion
from armdyn.estimation.nuisance import ArrowheadExpansion, eliminate_nuisance
from armdyn.identify.motion.motion_fit import robust_sum


class Decay:
    """Samples of two decays a_k exp(-b t) with one rate b and a size of their own, which are nuisances."""

    def __init__(self, *, eliminated: bool) -> None:
        self.eliminated, self.time = eliminated, np.linspace(0.0, 2.0, 30)
        rng = np.random.default_rng(5)
        self.measured = np.outer([1.0, 2.0], np.exp(-1.3 * self.time)) + 0.01 * rng.standard_normal((2, 30))
        self.lower, self.upper = np.array([0.0, -np.inf, -np.inf]), np.full(3, np.inf)
        self.evaluated = self.expanded = 0

    def residual(self, values):
        return (self.measured - values[1:, None] * np.exp(-values[0] * self.time)) / 0.01

    def value(self, values, limit):
        del limit
        self.evaluated += 1
        return 0.5 * float(np.sum(self.residual(values) ** 2)) + 0.5 * float(values[1:] @ values[1:])

    def expand(self, values):
        self.expanded += 1
        decay, r, s = np.exp(-values[0] * self.time) / 0.01, self.residual(values), values[1:]
        slope = -(s[:, None] * self.time * decay)  # by the rate
        gradient = np.append(-np.sum(slope * r), s - r @ decay)
        cost = 0.5 * float(np.sum(r**2)) + 0.5 * float(s @ s)
        if self.eliminated:
            by_rate, by_size = slope.reshape(1, -1, 1), np.tile(decay, 2).reshape(1, -1, 1)
            parts = [slice(0, 30), slice(30, 60)]
            left = eliminate_nuisance(by_rate, by_size, np.ones((60, 1)), parts, np.ones((2, 1)))
            return ArrowheadExpansion(cost, gradient, left.hessian, left)
        X = np.zeros((3, 2, 30))
        X[0], X[1, 0], X[2, 1] = slope, decay, decay
        hessian = np.einsum("ijk,ljk->il", X, X) + np.diag([0.0, 1.0, 1.0])
        return QuadraticExpansion(cost, gradient, hessian)


@pytest.mark.parametrize("eliminated", [False, True])
def test_it_finds_the_minimum_that_scipy_finds_with_nuisances_among_the_unknowns_or_eliminated(eliminated):
    cost = Decay(eliminated=eliminated)
    start = np.array([4.0, 0.1, 0.1])
    found = descend(cost, start, DescentSettings(tolerance=1e-6))
    true = least_squares(lambda v: np.append(cost.residual(v).ravel(), v[1:]), start, xtol=1e-12).x
    assert found.outcome is Outcome.CONVERGED
    assert found.values == pytest.approx(true, rel=1e-6)


def test_it_ends_after_a_step_that_gains_little_without_another_expansion():
    whole = descend(cost := Decay(eliminated=True), np.array([4.0, 0.1, 0.1]), DescentSettings(tolerance=1e-6))
    early = Decay(eliminated=True)
    found = descend(early, np.array([4.0, 0.1, 0.1]), DescentSettings(tolerance=0.0, least_gain=0.1))
    assert found.outcome is Outcome.CONVERGED
    assert early.expanded < cost.expanded
    assert early.value(found.values, np.inf) - whole.expansion.cost < 0.1
    assert found.expansion.cost - early.value(found.values, np.inf) < 0.1


def test_it_tries_no_more_steps_than_allowed():
    class Wall(Decay):
        def value(self, values, limit):
            super().value(values, limit)
            return np.inf

    cost = Wall(eliminated=False)
    found = descend(cost, np.array([4.0, 0.1, 0.1]), DescentSettings(tolerance=0.0, most_tries=4))
    assert (found.outcome, cost.evaluated, cost.expanded) == (Outcome.STALLED, 4, 1)


def test_without_nuisances_unknowns_are_those_of_the_whole_problem():
    random = np.random.default_rng(3)
    rows = [slice(0, 40), slice(40, 90)]
    slopes, of_starts = random.normal(size=(3, 90, 2)), random.normal(size=(4, 90, 2))
    share, held, errors = random.uniform(0.5, 2.0, (90, 2)), np.full((2, 4), 0.7), random.normal(size=(90, 2))
    left = eliminate_nuisance(slopes, of_starts, share, rows, held)

    whole = np.zeros((3 + 8, 90, 2))  # all values, then the states of both windows
    whole[:3] = slopes
    for w, mine in enumerate(rows):
        whole[3 + 4 * w : 7 + 4 * w, mine] = of_starts[:, mine]
    A = np.einsum("unj,vnj->uv", whole * share, whole) + np.diag(np.append(np.zeros(3), held.ravel()))
    b = -np.einsum("unj,nj->u", whole, share * errors)
    assert np.linalg.inv(left.hessian) == pytest.approx(np.linalg.inv(A)[:3, :3], rel=1e-9)
    pulls = -np.einsum("unj,nj->u", left.slopes, share * errors)
    every = np.linalg.solve(A, b)
    assert np.linalg.solve(left.hessian, pulls) == pytest.approx(every[:3], rel=1e-9)
    step, size = ArrowheadExpansion(0.0, -b, left.hessian, left).step(np.full(11, -np.inf), np.full(11, np.inf), 0.0)
    assert step == pytest.approx(every, rel=1e-9)
    assert size == pytest.approx(np.sqrt(pulls @ every[:3]), rel=1e-9)


def test_large_errors_count_as_their_sizes_and_small_ones_as_their_squares():
    small, large = (robust_sum(np.full((5, 1), e), np.array([0.1])) for e in (1e-3, 100.0))
    assert small == pytest.approx(0.5 * (1e-3 / 0.1) ** 2, rel=1e-3)
    assert large == pytest.approx(100.0 / 0.1, rel=1e-2)
