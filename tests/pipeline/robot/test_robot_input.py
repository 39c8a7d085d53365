from dataclasses import replace

import numpy as np
import pytest

from armdyn.errors import InputError, TaskFailedError
from pipeline.box import Box
from pipeline.robot.hidden import HIDDEN_EFFECTS, resolve_hidden
from pipeline.robot.settings import CellSettings, PlantSettings, ServoSettings
from pipeline.robot.simulated import SimulatedRobot


@pytest.fixture(scope="module")
def measured(plant, table):
    """What a moving plant measures and how it moved, with hidden effects and other settings."""

    def run(hidden, **settings):
        robot, readings = plant(hidden, seed=3, start_angle=0.2, **settings), []
        for step in range(31):
            state = robot.joint_state()
            readings += [state.q, state.v, state.tau, [s.force for s in robot.load_cell()][-1:] or [0.0]]
            t = step * 0.01
            motion = table.joint_motion(0.05 * t**2, 0.1 * t, 0.1)
            robot.command(motion.q, motion.v, motion.a)
            robot.advance(0.01)
        return np.concatenate([*readings, robot.history().load[-1]])

    return run


@pytest.fixture(scope="module")
def plain(measured):
    return {name: measured({}, settings=made) for name, made in (("exact", None), ("usual", PlantSettings()))}


@pytest.mark.parametrize("name", HIDDEN_EFFECTS)
def test_an_effect_of_zero_changes_nothing_and_a_typical_one_something_measured(measured, plain, name):
    np.testing.assert_array_equal(measured({name: 0.0}, settings=PlantSettings()), plain["usual"])
    assert resolve_hidden({name: None})[name] == HIDDEN_EFFECTS[name].typical
    found = measured({name: None})
    assert np.abs(found - plain["exact"]).max() > 1e-6
    first, second = found[:22], found[22:44]  # it was at rest when it was looked at first
    assert np.abs(first[7:14]).max() < 0.1
    assert np.abs(second[:7] - first[:7]).max() < 0.01


IMPOSSIBLE = [
    *((lambda _, length=length: PlantSettings(length=length)) for length in (-0.1, np.nan, 0.01)),
    lambda _: PlantSettings(mass=0.0),
    lambda _: PlantSettings(start_angle=2.0),
    lambda _: CellSettings(latency=-0.01),
    lambda _: CellSettings(period=0.0),
    lambda _: Box(width=0.0),
    lambda _: ServoSettings(stiffness=(1.0, np.inf)),
    *((lambda _, value=value: resolve_hidden({"linear_drag": value})) for value in (np.nan, np.inf, -1.0)),
    lambda plant: plant(servo=ServoSettings(friction=(1.0,) * 6)),
    *((lambda plant, duration=duration: plant().advance(duration)) for duration in (-0.1, np.nan, np.inf)),
]


@pytest.mark.parametrize("make", IMPOSSIBLE, ids=range(len(IMPOSSIBLE)))
def test_what_is_impossible_is_refused_by_name(plant, make, complains):
    with complains(InputError):
        make(plant)


def test_a_start_beyond_a_joint_limit_and_springs_that_are_not_there_are_refused(baxter, q_start, complains):
    with complains(InputError):
        SimulatedRobot(baxter, np.where(np.arange(7) == 3, 3.0, q_start))
    with complains(InputError):
        SimulatedRobot(replace(baxter, springs=()), q_start, PlantSettings(), {"gravity_spring": None})


def test_many_short_advances_take_as_long_as_one(plant):
    robot = plant()
    for _ in range(100):
        robot.advance(0.0123)
    assert robot.time == pytest.approx(1.23, abs=6e-4)


def test_diverging_simulation_says_so(plant, complains):
    # A gram cannot be braked by this much drag in steps of 1 ms.
    robot = plant({"linear_drag": 5.0}, mass=1e-3, start_angle=0.5)
    with complains(TaskFailedError):
        robot.advance(2.0)


@pytest.mark.parametrize(
    "spoil",
    [
        lambda q, v, a: (q + 5.0, v, a), lambda q, v, a: (q + np.eye(7)[6] * 0.3, v, a),
        lambda q, v, a: (q, v + 50.0, a), lambda q, v, a: (q, v, a + 500.0), lambda q, v, a: (q * np.nan, v, a),
        lambda q, v, a: (q[:-1], v, a),
    ],
)  # fmt: skip
def test_a_command_that_a_real_arm_would_refuse_is_refused_and_the_arm_stays(plant, q_start, spoil, complains):
    robot, still = plant(), np.zeros(7)
    with complains(InputError):
        robot.command(*spoil(q_start, still, still))
    robot.advance(0.5)
    np.testing.assert_allclose(robot.joint_state().q, q_start, atol=1e-9)
