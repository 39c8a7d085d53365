import numpy as np
import pytest

from armdyn.effects.catalogue import CATALOGUE
from armdyn.estimation.posterior import posterior_covariance
from armdyn.experiments.arm import ArmProblem
from armdyn.experiments.columns import random_joint_states
from armdyn.experiments.goal import goal_to_determine
from armdyn.experiments.limits import MotionLimits
from armdyn.experiments.recorded import question_of_study
from armdyn.experiments.search import AugmentedLagrangian, optimise_motion, random_motion
from armdyn.experiments.series import FourierSeries
from armdyn.identify.studies import make_study

from ..arm import urdfs


class OnOneSide:
    """Postures whose first joint is below a bound."""

    def __init__(self, bound):
        self.bound = bound

    def free(self, q):
        return q[0] < self.bound

    def margin(self, q):
        return self.bound - q[0]


@pytest.fixture(scope="module")
def goal(shoulder, effects):
    return goal_to_determine(shoulder, effects("joint_viscous_friction joint_coulomb_friction payload"), 100.0)


@pytest.fixture(scope="module")
def design(goal):
    limits = MotionLimits.of_robot(goal.columns.arm.robot)
    return ArmProblem(goal.columns, goal.criterion, FourierSeries(6.0), limits, OnOneSide(0.5))


@pytest.fixture(scope="module")
def start(design):
    found = random_motion(design, np.random.default_rng(2))
    assert found is not None
    return found


def test_a_random_motion_is_as_large_as_the_limits_allow(design, start):
    assert -0.05 < design.excess(start) <= 0.0
    assert all(design.postures.free(q) for q in design.torque_basis.motion(start).q)


def test_the_gradient_of_the_objective_is_that_of_finite_differences(design, start):
    near = design.linearised_around(start)
    multipliers = [np.full(c.shape, 1e-3) for c in near.evaluate(start).constraints]
    objective = AugmentedLagrangian(near, 5.0, multipliers)
    point, rng, h = 1.3 * start / design.coefficient_scale[:, None], np.random.default_rng(0), 1e-5
    _, gradient = objective(point)
    for _ in range(3):
        direction = rng.standard_normal(point.shape)
        measured = (objective(point + h * direction)[0] - objective(point - h * direction)[0]) / (2 * h)
        assert measured == pytest.approx(float(gradient @ direction.ravel()), rel=2e-3)


def test_a_designed_motion_tells_more_and_stays_inside(design, goal, start):
    found = optimise_motion(design, start)

    def stds(x):
        return np.sqrt(np.diag(posterior_covariance(design.information(x), goal.columns.prior)))[goal.wanted]

    assert design.cost(found) < design.cost(start) - 0.3
    assert np.exp(np.mean(np.log(stds(start) / stds(found)))) > 1.3
    assert design.excess(found) < 0.02
    assert design.torque_basis.motion(found).q[:, 0].max() < 0.5 + 0.02


def test_twice_the_time_has_twice_the_information(goal):
    limits, free = MotionLimits.of_robot(goal.columns.arm.robot), OnOneSide(np.inf)
    once, twice = (ArmProblem(goal.columns, goal.criterion, FourierSeries(t), limits, free) for t in (20.0, 40.0))
    x = np.random.default_rng(0).standard_normal((3, once.series.coefficient_count))
    assert twice.information(x) == pytest.approx(2.0 * once.information(x))


def test_states_all_over_the_limits_are_always_the_same(goal):
    first, second = random_joint_states(goal.columns.arm, 5), random_joint_states(goal.columns.arm, 5)
    assert np.array_equal(first.q, second.q)


def test_what_no_motion_determines_is_said_and_no_motion_designed(tmp_path):
    model = urdfs.arm(tmp_path, urdfs.SLIDE).with_effect(CATALOGUE["link_inertia"]).with_effect(CATALOGUE["payload"])
    run = urdfs.recorded(["slide"], ["m"], lambda q, v, a: 2.0 * a + 0.5 * v + 0.0 * q)  # the sum of masses
    asked = question_of_study(make_study(model, [run], [], [CATALOGUE["joint_viscous_friction"]]))
    assert asked.goal is None
    assert "No motion determines link_inertia and payload" in asked.sentence
