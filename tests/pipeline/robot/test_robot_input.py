from dataclasses import replace

import numpy as np
import pytest

from armdyn.errors import InputError, TaskFailedError, UnknownNameError
from pipeline.box import Box
from pipeline.robot.hidden import HIDDEN_EFFECTS, resolve_hidden
from pipeline.robot.settings import CellSettings, PlantSettings, ServoSettings
from pipeline.robot.simulated import SimulatedRobot


def test_misspelt_hidden_effect_is_answered_with_the_right_name(baxter, q_start):
    with pytest.raises(UnknownNameError, match="did you mean 'quadratic_drag'"):
        SimulatedRobot(baxter, q_start, hidden={"quadratc_drag": None})


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -1.0])
def test_hidden_effect_out_of_range_is_refused(value):
    with pytest.raises(InputError, match="linear_drag"):
        resolve_hidden({"linear_drag": value})


def test_typical_value_stands_for_none():
    assert resolve_hidden({"quadratic_drag": None})["quadratic_drag"] == HIDDEN_EFFECTS["quadratic_drag"].typical


@pytest.mark.parametrize("name", HIDDEN_EFFECTS)
def test_zero_leaves_the_plant_unchanged_to_the_last_digit(baxter, q_start, name):
    def run(hidden):
        plant = SimulatedRobot(baxter, q_start, PlantSettings(start_angle=0.2), hidden, seed=3)
        plant.advance(0.05)
        return plant.history().load[-1], plant.joint_state().q, plant.load_cell()

    plain, zero = run({}), run({name: 0.0})
    np.testing.assert_array_equal(plain[0], zero[0])
    np.testing.assert_array_equal(plain[1], zero[1])
    assert plain[2] == zero[2]


@pytest.mark.parametrize("name", HIDDEN_EFFECTS)
def test_the_first_reading_is_one_of_an_arm_at_rest(baxter, q_start, name):
    plant = SimulatedRobot(baxter, q_start, PlantSettings(), {name: None})
    first = plant.joint_state()
    plant.advance(0.01)
    assert np.abs(first.v).max() < 0.1
    assert np.abs(first.q - plant.joint_state().q).max() < 0.01


@pytest.mark.parametrize("name", HIDDEN_EFFECTS)
def test_typical_value_is_in_range_and_changes_something_measured(baxter, q_start, line_motion, name):
    def run(hidden):
        settings = replace(PlantSettings.exact(), start_angle=0.2)
        plant = SimulatedRobot(baxter, q_start, settings, hidden)
        readings = []
        for step in range(30):
            t = step * 0.01
            plant.command(*line_motion.joints(0.05 * t**2, 0.1 * t, 0.1))
            plant.advance(0.01)
            state = plant.joint_state()
            readings.append(np.concatenate([state.q, state.tau, [s.force for s in plant.load_cell()][-1:] or [0.0]]))
        return np.array(readings)

    assert np.abs(run({name: None}) - run({})).max() > 1e-6


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: PlantSettings(length=-0.1), "length"),
        (lambda: PlantSettings(length=float("nan")), "length"),
        (lambda: PlantSettings(length=0.01), "load_radius"),
        (lambda: PlantSettings(mass=0.0), "mass"),
        (lambda: PlantSettings(start_angle=2.0), "start_angle"),
        (lambda: CellSettings(latency=-0.01), "latency"),
        (lambda: CellSettings(period=0.0), "period"),
        (lambda: Box(width=0.0), "width"),
        (lambda: ServoSettings(stiffness=(1.0, float("inf"))), "stiffness"),
    ],
)
def test_impossible_settings_are_refused_by_name(make, words):
    with pytest.raises(InputError, match=words):
        make()


def test_start_beyond_a_joint_limit_names_the_joint(baxter, q_start):
    q = q_start.copy()
    q[3] = 3.0
    with pytest.raises(InputError, match="right_e1"):
        SimulatedRobot(baxter, q)


def test_settings_for_another_number_of_joints_are_refused(baxter, q_start):
    settings = PlantSettings(servo=ServoSettings(friction=(1.0,) * 6))
    with pytest.raises(InputError, match=r"servo\.friction has 6 values"):
        SimulatedRobot(baxter, q_start, settings)


def test_command_that_is_not_finite_is_refused_and_the_arm_goes_on(baxter, q_start):
    plant = SimulatedRobot(baxter, q_start, PlantSettings.exact())
    with pytest.raises(InputError, match="not finite"):
        plant.command(q_start, np.full(7, np.nan), np.zeros(7))
    with pytest.raises(InputError, match="6 of 7 joints"):
        plant.command(q_start[:6], np.zeros(7), np.zeros(7))
    plant.advance(0.5)
    np.testing.assert_allclose(plant.joint_state().q, q_start, atol=1e-9)


def test_many_short_advances_take_as_long_as_one(baxter, q_start):
    plant = SimulatedRobot(baxter, q_start)
    for _ in range(100):
        plant.advance(0.0123)
    assert plant.time == pytest.approx(1.23, abs=6e-4)


@pytest.mark.parametrize("duration", [-0.1, float("nan"), float("inf")])
def test_impossible_duration_is_refused(baxter, q_start, duration):
    with pytest.raises(InputError, match="duration"):
        SimulatedRobot(baxter, q_start).advance(duration)


def test_diverging_simulation_says_so(baxter, q_start):
    # A gram cannot be braked by this much drag in steps of 1 ms.
    plant = SimulatedRobot(baxter, q_start, PlantSettings(mass=1e-3, start_angle=0.5), {"linear_drag": 5.0})
    with pytest.raises(TaskFailedError, match="diverged"):
        plant.advance(2.0)


@pytest.mark.parametrize(
    ("spoil", "says"),
    [
        (lambda q, v, a: (q + 5.0, v, a), "leave its range.*right_s0"),
        (lambda q, v, a: (q + np.eye(7)[6] * 0.3, v, a), r"not where it was told.*right_w2: 0\.3 of 0\.2 rad"),
        (lambda q, v, a: (q, v + 50.0, a), "faster than its limit.*right_"),
        (lambda q, v, a: (q, v, a + 500.0), "accelerate more than its limit.*right_"),
        (lambda q, v, a: (q * np.nan, v, a), "not finite"),
        (lambda q, v, a: (q[:-1], v, a), "6 of 7 joints"),
    ],
)
def test_a_command_that_a_real_arm_would_refuse_is_refused_and_the_arm_stays(baxter, q_start, spoil, says):
    plant = SimulatedRobot(baxter, q_start)
    still = np.zeros(7)
    with pytest.raises(InputError, match=says):
        plant.command(*spoil(q_start, still, still))
    plant.advance(0.1)
    assert abs(plant.gripper_truth().s_velocity) < 1e-3
