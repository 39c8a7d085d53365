"""The nonlinear descent: nuisance unknowns are eliminated from one least-squares problem, and it ends where it says."""

import numpy as np
import pytest
from scipy.optimize import least_squares

from armdyn.estimation.descent import DescentSettings, Outcome, descend, descend_each
from armdyn.estimation.equations import NormalEquations
from armdyn.estimation.expansion import QuadraticExpansion
from armdyn.estimation.nuisance import ArrowheadExpansion, eliminate_nuisance
from armdyn.identify.motion.motion_cost import robust_sum


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


def test_many_problems_descend_at_once_each_as_if_it_were_alone():
    time, rng = np.linspace(0.0, 2.0, 30), np.random.default_rng(7)
    rates = rng.uniform(0.5, 3.0, 6)
    measured = np.exp(-np.outer(rates, time)) + 1e-3 * rng.standard_normal((6, 30))

    def linearise(values):
        size, rate = values[:, :1], values[:, 1:]
        decay = np.exp(-rate * time)
        X = np.stack([decay, -size * time * decay], axis=2)
        return NormalEquations.of_units(X, measured - size * decay, np.full((len(values), 30), 1e-3))

    start = np.tile([0.3, 6.0], (6, 1))  # from so far that whole steps do not lower every error
    found = descend_each(linearise, start, 40)
    for values, samples, square in zip(found.values, measured, found.equations.square, strict=True):
        alone = least_squares(lambda v, y=samples: (y - v[0] * np.exp(-v[1] * time)) / 1e-3, [1.0, 1.0], xtol=1e-12)
        assert values == pytest.approx(alone.x, rel=1e-5)
        assert square == pytest.approx(2.0 * alone.cost, rel=1e-8)


def test_steps_may_go_uphill_where_that_is_asked_for():
    class Product(Decay):
        """The first unknown times the second is 1, the second is 100: a bent valley."""

        def residual(self, values):
            return np.array([[1e3 * (values[0] * values[1] - 1.0), values[1] - 100.0, 0.0]])

        def expand(self, values):
            J = np.array([[1e3 * values[1], 1e3 * values[0], 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
            J, r = np.vstack([J, np.diag([0.0, 1.0, 1.0])]), np.append(self.residual(values)[0], [0.0, *values[1:]])
            return QuadraticExpansion(0.5 * float(r @ r), J.T @ r, J.T @ J)

    start = np.array([1.0, 1.0, 0.0])
    straight, creeping = (
        descend(Product(eliminated=False), start, DescentSettings(10, 1e-6, uphill=uphill)) for uphill in (True, False)
    )
    assert straight.outcome is Outcome.CONVERGED
    assert straight.values == pytest.approx([1.0 / 50.0, 50.0, 0.0], rel=1e-4)
    assert creeping.outcome is Outcome.OUT_OF_STEPS


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
