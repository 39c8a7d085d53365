"""A motion is checked on the arm as its model describes it; truths are MuJoCo's and formulas."""

import json
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from command import called

from armdyn.arm.model import arm_model
from armdyn.effects.catalogue import find
from armdyn.model_file import ModelFile, write_model_file
from pipeline.exports.mujoco_file import mujoco_text
from pipeline.motion.feasibility import CheckSettings, check_joints
from pipeline.motion.feasibility.as_modelled import HOLDING_SECONDS, ModelledArm
from pipeline.motion.trajectory import JointTrajectory

URDF = """<robot name="arm"><link name="base"/>
<link name="upper"><inertial><origin xyz="0.15 0 0"/><mass value="2"/>
<inertia ixx="0.01" iyy="0.03" izz="0.03" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="lift" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 1 0"/>
<limit lower="-2" upper="2" effort="{effort}" velocity="6"/></joint>
<link name="lower"><inertial><origin xyz="0.1 0 0"/><mass value="1"/>
<inertia ixx="0.004" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="elbow" type="revolute"><parent link="upper"/><child link="lower"/><origin xyz="0.3 0 0"/>
<axis xyz="0 1 0"/><limit lower="-2" upper="2" effort="{effort}" velocity="6"/></joint></robot>"""
TIME = np.arange(0.0, 4.0, 0.01)
W, SIZE = 2.0 * np.pi * np.array([0.25, 0.5]), np.array([0.6, 0.5])
MOTION = [SIZE * x for x in (1 - np.cos(TIME[:, None] * W), W * np.sin(TIME[:, None] * W),
                             W**2 * np.cos(TIME[:, None] * W))]  # fmt: skip
MOTION[0] -= SIZE


@pytest.fixture
def described(tmp_path):
    """Model of the arm with an effort limit, N m, and effects."""

    def of(effort, **values):
        file = tmp_path / "arm.urdf"
        file.write_text(URDF.format(effort=effort))
        model = arm_model(file)
        for name in dict.fromkeys(quantity.partition("__")[0] for quantity in values):
            model = model.with_effect(find(name))
        named = {q.replace("__", "."): value for q, value in values.items()}
        return model.with_values(
            {f"{q}[{j}]": v for q, v in named.items() for j in model.joints if f"{q}[{j}]" in model.names}
        )

    return of


@pytest.fixture
def trajectory(tmp_path):
    units = {"q": "rad", "v": "rad/s", "a": "rad/s^2"}
    header = ",".join(["time [s]", *(f"{k}.{j} [{u}]" for k, u in units.items() for j in ("lift", "elbow"))])
    rows = np.column_stack([TIME, *MOTION])
    np.savetxt(tmp_path / "t.csv", rows, delimiter=",", header=header, comments="", fmt="%.9f")
    return tmp_path / "t.csv"


def written(model, folder, **history):
    write_model_file(folder / "m.toml", ModelFile(model, model.file_entries(folder), (history,) if history else ()))
    return folder / "m.toml"


def test_torques_are_those_of_all_effects_and_their_band_is_that_of_error_and_values(described):
    frictions = {"joint_viscous_friction__coefficient": 1.5, "joint_coulomb_friction__torque": 2.0}
    arm = described(50, **frictions, torque_gain__error=0.1)
    p = "joint_viscous_friction.coefficient[lift]"
    arm = arm.with_parameters({p: replace(arm.parameters[p], std=0.2)})
    bodies = mujoco.MjModel.from_xml_string(mujoco_text(described(50))[0])
    data, load = mujoco.MjData(bodies), []
    for q, v, a in zip(*MOTION, strict=True):
        data.qpos[:], data.qvel[:], data.qacc[:] = q, v, a
        mujoco.mj_inverse(bodies, data)
        load.append(data.qfrc_inverse.copy())
    torque, half = ModelledArm(arm, np.array([0.3, 0.4])).torques(*MOTION)
    assert torque == pytest.approx(np.array(load) + 1.5 * MOTION[1] + 2.0 * np.sign(MOTION[1]), abs=1e-9)
    assert half[:, 0] == pytest.approx(1.96 * np.hypot(0.3, 0.2 * MOTION[1][:, 0]))
    assert half[:, 1] == pytest.approx(1.96 * 0.4)


def test_a_motion_that_the_description_allows_is_refused_for_the_friction_of_the_model(described, trajectory, tmp_path):
    largest = np.abs(ModelledArm(described(50), np.zeros(2)).torques(*MOTION)[0]).max()
    model = written(described(largest + 2.0, joint_coulomb_friction__torque=3.0), tmp_path)
    status, out, _ = called("check", trajectory, "--urdf", tmp_path / "arm.urdf", "--json", "-")
    assert status == 0
    assumed = "limits of acceleration and jerk are assumed, as no description of arm.urdf states them"
    assert json.loads(out)["notes"] == [assumed]
    status, out, _ = called("check", trajectory, "--model", model, "--json", "-")
    found = json.loads(out)
    assert status == 1
    assert {(v["limit"], v["joint"]) for v in found["violations"]} == {("torque", "lift")}


def test_a_limit_within_the_band_is_not_said_to_be_kept(described, trajectory, tmp_path):
    largest = np.abs(ModelledArm(described(50), np.zeros(2)).torques(*MOTION)[0]).max()
    arm = described(largest + 1.0)
    for error, status in ((0.4, 0), (0.6, 1)):  # 1.96 times
        model = written(arm, tmp_path, held_out_rmse={"tau.lift": error}, rmse={"tau.lift": 0.0})
        assert called("check", trajectory, "--model", model)[0] == status


def test_servos_follow_in_closed_loop_as_in_mujoco(described):
    drives = {"servo": {"joints": ["lift", "elbow"], "gain": "120 N m/rad", "limit": "9 N m", "delay": "0 s"}}
    frictions = {"joint_viscous_friction__coefficient": 2.0, "joint_coulomb_friction__torque": 0.3}
    arm = described(50, **frictions).with_drives(drives)
    motion = JointTrajectory(TIME, *MOTION, arm.joints)
    simulation = mujoco.MjModel.from_xml_string(mujoco_text(arm)[0])
    step, data, error = simulation.opt.timestep, mujoco.MjData(simulation), []
    data.qpos[:] = data.ctrl[:] = MOTION[0][0]
    every = round(0.01 / step)
    for k in range(round(HOLDING_SECONDS / step) + len(TIME) * every):
        i = (k - round(HOLDING_SECONDS / step)) // every
        data.ctrl[:] = MOTION[0][max(i, 0)]
        if i >= 0 and k % every == 0:
            error.append(data.qpos - MOTION[0][i])
        mujoco.mj_step(simulation, data)
    settings = CheckSettings(collision=False, min_singular_value=0.0, modelled=ModelledArm(arm, np.zeros(2)))
    report = check_joints(arm.robot, motion, settings)
    lift, elbow = report.tracking
    assert [one.rms for one in report.tracking] == pytest.approx(np.sqrt(np.mean(np.square(error), axis=0)), rel=0.03)
    assert lift.saturated > 0.01
    assert elbow.saturated == 0.0
    assert {v.joint for v in report.violations if v.limit == "drive"} == {"lift"}


def test_a_retimed_motion_saturates_no_servo(described, trajectory, tmp_path):
    drives = {
        "servo": {"joints": ["lift", "elbow"], "gain": "120 N m/rad", "damping": "8 N m s/rad", "limit": "7.6 N m"}
    }
    arm = described(50, joint_viscous_friction__coefficient=1.0, joint_coulomb_friction__torque=0.3).with_drives(drives)
    model, out = written(arm, tmp_path), tmp_path / "fast.csv"
    assert called("check", trajectory, "--model", model)[0] == 1
    status, text, _ = called("check", trajectory, "--model", model, "--retime", out, "--json", "-")
    assert status == 0
    assert max(one["saturated"] for one in json.loads(text)["tracking"]) == 0.0
    assert called("check", out, "--model", model)[0] == 0


def test_a_model_holds_its_robot(described, trajectory, tmp_path, refused):
    model = written(described(50), tmp_path)
    assert "--model holds robot" in refused("check", trajectory, "--model", model, "--robot", "ur5")
