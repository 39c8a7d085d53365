"""A force/torque sensor beside the joints' torques: what a motion tells of it and of its tool."""

import numpy as np
import pytest
from worlds import tools

from armdyn.effects.catalogue import CATALOGUE, find
from armdyn.errors import InputError
from armdyn.experiments.columns import TorqueRegressor, random_joint_states
from armdyn.experiments.goal import goal_to_determine
from armdyn.experiments.series import AxisMotion
from armdyn.run import Run

JOINTS = 6


@pytest.fixture(scope="module")
def model():
    found = tools.sensed_model()
    for name in ("payload", "wrench_gain", "wrench_rotation", "wrench_drift"):
        found = found.with_effect(CATALOGUE[name])
    joint = found.joints[-1]
    return found.with_values(
        {f"payload.mass[{joint}]": 1.5, f"payload.z[{joint}]": 0.08, "wrench_rotation.yaw[ft]": 0.1}
    )


def test_rows_of_a_sensor_are_what_its_readings_gain_in_a_run(model):
    time, rate = np.arange(0.0, 4.0, 0.01), 0.7 * np.arange(1, 7)
    angle = rate * time[:, None]
    motion = AxisMotion(0.5 * np.sin(angle), 0.5 * rate * np.cos(angle), -0.5 * rate**2 * np.sin(angle))
    columns = TorqueRegressor(model, 100.0)
    found = columns.values_along(motion, time)[:, JOINTS:] * columns.noise[JOINTS:, None] / columns.typical
    values = {"q": motion.q} | {f"{axis}.ft": np.zeros(len(time)) for axis in tools.AXES}
    run = Run.from_arrays(time, values, joints=tools.robot().joint_names)
    for k, name in enumerate(model.names):
        step = 1e-4
        readings = [
            np.column_stack(
                [
                    model.with_values({name: model.value(name) + s}).predict_values(
                        run, (model.with_values({name: model.value(name) + s})).theta()
                    )[f"{axis}.ft"]
                    for axis in tools.AXES
                ]
            )
            for s in (-step, step)
        ]
        expected = (readings[1] - readings[0]) / (2.0 * step)
        np.testing.assert_allclose(found[20:-20, :, k], expected[20:-20], atol=2e-3 * max(1.0, np.abs(expected).max()))


def test_no_motion_tells_a_mass_from_a_gain_that_all_axes_share_but_torques_do(model):
    """Of the wrench alone, more mass and less gain of every axis is the same; so is it for one axis of the torque."""
    columns = TorqueRegressor(model, 100.0)
    rows = columns.values_along(random_joint_states(model.arm, 200))
    own = np.concatenate([columns.column_indices("payload"), columns.column_indices("wrench_gain")])
    lost = {}
    for what, part in (("wrench", rows[:, JOINTS:]), ("both", rows)):
        values = np.linalg.svd(part[:, :, own].reshape(-1, len(own)), compute_uv=False)
        lost[what] = int((values < 1e-7 * values[0]).sum())
    assert lost == {"wrench": 1, "both": 0}


def test_a_motion_for_a_sensors_offsets_counts_what_the_joints_do_not_show(model):
    goal = goal_to_determine(model, [find("wrench_offset")], 100.0)
    assert {goal.columns.unknowns[i].name for i in goal.wanted} == {f"wrench_offset.{axis}[ft]" for axis in tools.AXES}
    assert not len(goal.unidentifiable)
    other = goal_to_determine(model, [find("joint_coulomb_friction")], 100.0)
    assert "wrench_offset" in other.nuisance_effects
    rows = goal.columns.values_along(random_joint_states(model.arm, 50))
    assert np.abs(rows[:, :JOINTS, goal.wanted]).max() == 0.0
    assert np.abs(rows[:, JOINTS:, goal.wanted]).max() > 1.0


def test_a_late_sensor_has_no_rows(model):
    with pytest.raises(InputError, match="are late"):
        TorqueRegressor(model.with_effect(CATALOGUE["wrench_delay"]), 100.0).values_along(
            random_joint_states(model.arm, 3)
        )
