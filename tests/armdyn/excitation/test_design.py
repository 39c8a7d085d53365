import numpy as np
import pytest

from armdyn.excitation.columns import random_states
from armdyn.excitation.criteria import covariance
from armdyn.excitation.design import Design, _Multipliers, _Objective
from armdyn.excitation.goal import determining
from armdyn.excitation.random_motions import random_motion
from armdyn.excitation.room import Room
from armdyn.excitation.series import Series


class OnOneSide:
    """Postures whose first joint is below a bound."""

    def __init__(self, bound):
        self.bound = bound

    def free(self, q):
        return q[0] < self.bound

    def margins(self, q):
        return np.array([self.bound - q[0]])


@pytest.fixture(scope="module")
def goal(shoulder, effects):
    return determining(shoulder, effects("joint_viscous_friction joint_coulomb_friction payload"), 100.0)


@pytest.fixture(scope="module")
def design(goal):
    return Design(goal.columns, Series(6.0), Room.of(goal.columns.arm.robot), OnOneSide(0.5))


@pytest.fixture(scope="module")
def start(design):
    found = random_motion(design, np.random.default_rng(2))
    assert found is not None
    return found


def test_a_random_motion_is_as_large_as_the_limits_allow(design, start):
    assert -0.05 < design.excess(start) <= 0.0
    assert all(design.postures.free(q) for q in design.motion(start).q)


def test_the_gradient_of_the_objective_is_that_of_finite_differences(design, goal, start):
    shapes = [(2, len(design.finer[0]), 3)] * 3
    held = _Multipliers(5.0, [np.full(s, 1e-3) for s in shapes], np.full((2, len(design.time), 3), 1e-3))
    objective = _Objective(design, goal.criterion, held, design.cuts(start))
    point, rng, h = 1.3 * (start / design.unit[:, None]).ravel(), np.random.default_rng(0), 1e-5
    _, gradient = objective(point)
    for _ in range(3):
        direction = rng.standard_normal(point.shape)
        measured = (objective(point + h * direction)[0] - objective(point - h * direction)[0]) / (2 * h)
        assert measured == pytest.approx(float(gradient @ direction), rel=2e-3)


def test_a_designed_motion_tells_more_and_stays_inside(design, goal, start):
    found = design.optimised(start, goal.criterion)

    def stds(x):
        return np.sqrt(np.diag(covariance(design.information(x), goal.columns.prior)))[goal.wanted]

    assert goal.criterion(design.information(found))[0] < goal.criterion(design.information(start))[0] - 0.3
    assert np.exp(np.mean(np.log(stds(start) / stds(found)))) > 1.3
    assert design.excess(found) < 0.02
    assert design.motion(found).q[:, 0].max() < 0.5 + 0.02


def test_twice_the_time_has_twice_the_information(goal):
    room = Room.of(goal.columns.arm.robot)
    once, twice = (Design(goal.columns, Series(seconds), room, OnOneSide(np.inf)) for seconds in (20.0, 40.0))
    x = np.random.default_rng(0).standard_normal((3, once.series.size))
    assert twice.information(x) == pytest.approx(2.0 * once.information(x))


def test_states_all_over_the_limits_are_always_the_same(goal):
    first, second = random_states(goal.columns.arm, 5), random_states(goal.columns.arm, 5)
    assert np.array_equal(first.q, second.q)
