import numpy as np
import pytest
from derivatives import assert_jacobian
from scipy.integrate import solve_ivp

from armdyn.control.task import SwingState, TaskCost, TaskPlanner, task_problem
from armdyn.effects.catalogue import CATALOGUE
from armdyn.errors import InputError, TaskFailedError
from armdyn.pendulum.model import pendulum_model

TA_COST = TaskCost((-0.45, -0.248), position_weights=(1e4, 1e4), velocity_weights=(1e3, 1e3), control_weight=1.0)
TA_OPTIMUM = 0.515326192  # problem TA; IPOPT on the same variational problem, to 1e-9
SWING = TaskCost((0.45, -0.15))


@pytest.fixture(scope="module")
def bare():
    model = pendulum_model(0.368, 0.1)
    return model, TaskPlanner(model)


def test_problem_ta_reaches_the_optimum_that_ipopt_finds(bare):
    model, planner = bare
    plan = planner.plan(model, TA_COST)
    assert abs(plan.solution.cost - TA_OPTIMUM) < 1e-6
    assert len(plan.solution.iterations) <= 10


def test_the_cost_falls_at_every_step(bare):
    model, planner = bare
    costs = planner.plan(model, SWING).solution.iterations
    assert np.all(np.diff(costs) < 0)


def test_no_small_change_of_the_controls_lowers_the_cost(bare):
    model, planner = bare
    u = planner.plan(model, SWING, tolerance=1e-12).solution.controls
    theta, steps, dt = model.physics_theta(), planner.steps, planner.dt
    problem = task_problem(model.variational(), "test")
    p = np.concatenate([theta, SWING.vector(), [dt]])

    def cost(controls):
        s, total = np.zeros(4), 0.0
        for k in range(steps):
            total += float(problem.running(s, controls[k], k * dt, p))
            s = np.array(problem.step(s, controls[k], k * dt, p)).ravel()
        return total + float(np.sum(np.array(problem.terminal_residual(s, steps * dt, p)) ** 2)) / 2

    rng = np.random.default_rng(0)
    best = cost(u)
    for direction in rng.normal(size=(3, steps)):
        up, down = (cost(u + h * direction) for h in (1e-3, -1e-3))
        assert up > best
        assert down > best
        assert abs(up - down) < 1e-3 * (up + down - 2 * best)


def test_the_load_of_a_simulated_pendulum_arrives_where_the_plan_says(bare):
    model, planner = bare
    plan = planner.plan(model, SWING)

    def motion(t, s):
        a = plan.solution.controls[min(int(t / planner.dt), planner.steps - 1)]
        return [s[1], (a * np.cos(s[0]) - 9.81 * np.sin(s[0])) / 0.368]

    end = solve_ivp(motion, (0, plan.time[-1]), [0.0, 0.0], "RK45", max_step=planner.dt / 2, rtol=1e-9).y[:, -1]
    reached = [plan.x[-1] - 0.368 * np.sin(end[0]), -0.368 * np.cos(end[0])]
    assert np.allclose(reached, plan.load[-1], atol=3e-3)
    assert np.allclose(plan.load[-1], SWING.target, atol=2e-3)


def test_a_moving_load_can_be_brought_to_rest(bare):
    model, planner = bare
    weights = {"position_weights": (1e4, 1e4), "velocity_weights": (1e4, 1e4), "gripper_weights": (1e4, 1e4)}
    cost = TaskCost((0.0, -0.368), **weights)
    plan = planner.plan(model, cost, SwingState(0.02, 0.1, 0.3, -0.5))
    assert abs(plan.angle[-1]) < 1e-2
    assert abs(plan.solution.states[3, -1]) < 1e-2
    assert abs(plan.v[-1]) < 1e-2


def test_a_model_with_drag_plans_a_different_swing_that_accounts_for_it():
    model = pendulum_model(0.368, 0.1, [CATALOGUE["linear_drag"]]).with_values({"linear_drag.coefficient": 0.03})
    plan = TaskPlanner(model).plan(model, SWING)
    bare = pendulum_model(0.368, 0.1)
    assert np.allclose(plan.load[-1], SWING.target, atol=3e-3)
    assert np.abs(plan.x - TaskPlanner(bare).plan(bare, SWING).x).max() > 5e-3


def test_linearisation_of_the_problem_is_exact(bare):
    model, planner = bare
    problem = task_problem(model.variational(), "test")
    p = np.concatenate([model.physics_theta(), SWING.vector(), [planner.dt]])
    z = np.array([0.1, -0.2, 0.5, 1.0, 0.3])
    following = problem.step(z[:4], z[4], 0.0, p)
    A, B = (np.array(m) for m in problem.linearised(z[:4], z[4], 0.0, p, following))
    assert_jacobian(lambda z: np.array(problem.step(z[:4], z[4], 0.0, p)), z, np.hstack([A, B]), 1e-3, 1e-7)


def test_too_few_iterations_are_said(bare, complains):
    model, planner = bare
    with complains(TaskFailedError):
        planner.optimizer(constrained=False).solve(
            np.zeros(4), planner.dt * np.arange(501), _parameters(model), most_iterations=1
        )


def _parameters(model):
    return np.concatenate([model.physics_theta(), SWING.vector(), [0.01]])


def test_a_planner_refuses_a_model_with_other_effects(bare, complains):
    other = pendulum_model(0.368, 0.1, [CATALOGUE["linear_drag"]])
    with complains(InputError):
        bare[1].plan(other, SWING)


@pytest.mark.parametrize("wrong", [{"control_weight": 0.0}, {"target": (np.nan, 0.0)}])
def test_costs_without_a_unique_optimum_are_refused(wrong):
    with pytest.raises(InputError):
        TaskCost(**{"target": (0.45, -0.15), **wrong})
