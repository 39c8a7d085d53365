"""What constrains a plan, and what it must know of the gripper and of time."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from armdyn.control.task import SwingState, TaskCost, TaskPlanner
from armdyn.effects.catalogue import CATALOGUE
from armdyn.pendulum.model import pendulum_model

LENGTH, WALL = 0.368, (0.355, -0.285)
SWING = TaskCost((0.45, -0.08), travel_weight=1.0)


def with_drag():
    model = pendulum_model(LENGTH, 0.08, [CATALOGUE["quadratic_drag"]])
    return model.with_values({"quadratic_drag.coefficient": 0.05})


@pytest.fixture(scope="module")
def dragged():
    model = with_drag()
    return model, TaskPlanner(model)


def height_over_the_wall(plan):
    """Of the load where it last crosses the wall, by interpolation, m."""
    x, z = plan.load.T
    k = int(np.flatnonzero(np.diff(np.sign(x - WALL[0])))[-1])
    share = (WALL[0] - x[k]) / (x[k + 1] - x[k])
    return z[k] + share * (z[k + 1] - z[k]) - WALL[1]


def test_a_plan_that_would_go_through_the_wall_goes_over_it(dragged):
    model, planner = dragged
    assert height_over_the_wall(planner.plan(model, SWING)) < -0.02
    bent = planner.plan(model, replace(SWING, wall=WALL, clearance=0.025))
    assert height_over_the_wall(bent) > 0.02
    assert np.allclose(bent.load[-1], SWING.target, atol=0.02)


def test_a_plan_keeps_the_string_taut(dragged):
    model, planner = dragged
    assert planner.plan(model, SWING).tension.min() < -0.1
    assert planner.plan(model, replace(SWING, least_tension=0.1)).tension.min() > 0.05


def test_a_plan_stays_within_reach(dragged):
    model, planner = dragged
    over = replace(SWING, wall=WALL, clearance=0.025)
    assert planner.plan(model, over).x.min() < -0.4
    within = planner.plan(model, replace(over, reach=(-0.29, 0.54)))
    assert within.x.min() > -0.293
    assert within.x.max() < 0.543


def test_what_hinders_nothing_changes_nothing():
    model = pendulum_model(LENGTH, 0.08)
    planner = TaskPlanner(model)
    free = planner.plan(model, SWING)
    minded = planner.plan(model, replace(SWING, wall=WALL, clearance=0.0, least_tension=0.05, reach=(-0.29, 0.54)))
    assert np.allclose(free.x, minded.x, atol=1e-12)


def test_a_lagging_gripper_is_led_so_that_the_load_arrives():
    lag, dt = 0.1, 0.01
    model = pendulum_model(LENGTH, 0.08, [CATALOGUE["gripper_lag"]]).with_values({"gripper_lag.time": lag})
    plan = TaskPlanner(model).plan(model, SWING)

    def motion(t, s):
        k = min(int(t / dt), len(plan.x) - 2)
        command = plan.x[k] + (t - k * dt) * plan.v[k + 1]
        speed = (command - s[0]) / lag
        acceleration = (plan.v[k + 1] - speed) / lag
        return [speed, s[2], (acceleration * np.cos(s[1]) - 9.81 * np.sin(s[1])) / LENGTH]

    end = solve_ivp(motion, (0, plan.time[-1]), [plan.x[0], 0.0, 0.0], max_step=dt / 2, rtol=1e-9).y[:, -1]
    reached = [end[0] - LENGTH * np.sin(end[1]), -LENGTH * np.cos(end[1])]
    assert np.allclose(reached, plan.load[-1], atol=5e-3)
    assert np.abs(plan.x - TaskPlanner(bare := pendulum_model(LENGTH, 0.08)).plan(bare, SWING).x).max() > 0.02


def test_a_plan_knows_how_long_the_string_has_crept_when_it_begins():
    creeping = pendulum_model(LENGTH, 0.08, [CATALOGUE["string_creep"]]).with_values({"string_creep.rate": 1e-3})
    late = TaskPlanner(creeping).plan(creeping, SWING, SwingState(time=20.0))
    longer = creeping.with_values({"length": LENGTH + 0.02})
    at_once = TaskPlanner(longer).plan(longer, SWING)
    assert np.allclose(late.x, at_once.x, atol=1e-6)
    assert late.time[0] == 0.0
