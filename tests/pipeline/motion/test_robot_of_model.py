"""What needs a robot's description gets it as the robot's model is, from the option --model."""

import json

import numpy as np
import pytest
from command import called

from armdyn.arm.model import arm_model
from armdyn.arm.symbolic import inverse_dynamics_function
from armdyn.effects.catalogue import CATALOGUE
from armdyn.model_file import ModelFile, write_model_file
from armdyn.run import read_run
from ik.torque import JointTorque
from pipeline.front import check
from pipeline.motion.feasibility import CheckSettings, check_joints
from pipeline.motion.feasibility.read import read_trajectory
from pipeline.motion.robot_of_model import robot_of_model

from ...armdyn.arm import urdfs

HELD = (
    "joint_viscous_friction",
    "payload",
    "link_inertia",
    "rotor_inertia",
    "gravity_spring",
    "joint_spring",
    "base_tilt",
)


@pytest.fixture(scope="module")
def model():
    found = arm_model(robot="ur5")
    for name in HELD:
        found = found.with_effect(CATALOGUE[name])
    rng = np.random.default_rng(0)
    values = {n: float(np.clip(p.value + rng.uniform(0.2, 0.5) * p.typical, p.lower, p.upper))
              for n, p in found.parameters.items()}  # fmt: skip
    return found.with_values(values)


@pytest.fixture
def file(model, tmp_path):
    write_model_file(tmp_path / "m.toml", ModelFile(model, {"robot": "ur5", "joints": list(model.joints)}))
    return tmp_path / "m.toml"


def test_torques_of_the_description_are_those_of_the_model(model):
    torque, function = JointTorque(robot_of_model(model)), inverse_dynamics_function(model)
    for q, v, a in np.random.default_rng(1).normal(size=(20, 3, 6)):
        assert torque(q[None], v[None], a[None])[0] == pytest.approx(np.array(function(q, v, a))[:, 0], abs=1e-9)


def test_torque_limits_along_a_path_count_dry_friction_in_its_direction_and_both_at_rest(model):
    for name in ("joint_asymmetric_friction", "joint_stribeck_friction"):
        model = model.with_effect(CATALOGUE[name])
    own = [n for n in model.names if "asymmetric" in n or n.startswith("joint_stribeck_friction.torque")]
    dry = np.random.default_rng(2).uniform(1.0, 6.0, len(own))
    model = model.with_values(dict(zip(own, dry.tolist(), strict=True)))
    robot, function = robot_of_model(model), inverse_dynamics_function(model)
    rng, effort = np.random.default_rng(3), 1.5 * robot.limits.effort
    q, along, bend = 0.5 * rng.normal(size=(3, 20, 6))
    terms = JointTorque(robot, springs=True).path_torque_terms(q, along, bend)

    smooth = model.without_effect("joint_asymmetric_friction").without_effect("joint_stribeck_friction")
    smooth_torque = inverse_dynamics_function(smooth)

    def needed(k, v, a, direction):
        # At creeping speed the whole of the Stribeck friction acts, as the table assumes at any speed.
        creep = np.array(function(q[k], direction * 1e-9 * along[k], np.zeros(6)))[:, 0]
        still = np.array(smooth_torque(q[k], np.zeros(6), np.zeros(6)))[:, 0]
        moving = np.array(smooth_torque(q[k], along[k] * v, bend[k] * v**2 + along[k] * a))[:, 0]
        return moving + creep - still

    for v, directions in ((0.4, (1,)), (-0.4, (-1,)), (0.0, (1, -1))):
        low, high = terms.acceleration_range(effort, v, springs=True)
        for k in range(20):
            if low[k] <= high[k]:
                for a in (low[k], high[k]):
                    shares = [np.abs(needed(k, v, a, way)) / effort for way in directions]
                    assert np.max(shares) == pytest.approx(1.0, abs=1e-9)
    assert (low <= high).sum() > 10
    still = np.array([[np.abs(needed(k, 0.0, 0.0, way)) / effort for way in (1, -1)] for k in range(20)])
    assert terms.holding_torque_shares(effort)[1] == pytest.approx(still.max(axis=(1, 2)), abs=1e-9)


def test_a_posture_has_the_gravity_of_the_model(model, file):
    status, out, _ = called("arm", "show", "--model", file, "--json", "-")
    found = json.loads(out)
    none = np.zeros(6)
    expected = np.array(inverse_dynamics_function(model)(np.array(found["q"]), none, none))[:, 0]
    assert status == 0
    assert np.add(found["gravity"], found["springs"]) == pytest.approx(expected, abs=1e-9)


def test_a_designed_motion_keeps_the_limits_of_the_model(tmp_path):
    arm = urdfs.arm(tmp_path, urdfs.DOUBLE).with_effect(CATALOGUE["payload"])
    arm = arm.with_values({"payload.mass[elbow]": 12.0, "payload.x[elbow]": 0.2})
    write_model_file(tmp_path / "m.toml", ModelFile(arm, arm.file_entries(tmp_path)))
    out, options = tmp_path / "q.csv", ("--for", "joint_coulomb_friction", "--seconds", "4", "--random", "5")
    assert called("excite", "--model", tmp_path / "m.toml", *options, "--no-compare", "--output", out)[0] == 0
    report, motion = check(tmp_path / "m.toml", out)
    assert report.feasible
    assert motion.channels["q.elbow"].time[-1] == pytest.approx(4.0)
    again, moved = check(arm, read_run(out))  # in memory, as from their files
    assert again.margins == report.margins
    assert moved.channels.keys() == motion.channels.keys()
    assert check(arm, read_run(out), retime=True)[0].feasible
    assert called("check", out, "--model", tmp_path / "m.toml")[0] == 0
    torques = {margin.joint: margin.used_share for margin in report.margins if margin.limit == "torque"}
    without = check_joints(arm.robot, read_trajectory(out, arm.robot), CheckSettings(min_singular_value=0.0))
    assert torques["swing"] > max(m.used_share for m in without.margins if m.limit == "torque")


def test_a_model_holds_its_robot(file, tmp_path, refused):
    assert "--model holds" in refused("arm", "show", "--model", file, "--joints", "elbow_joint")
    assert "--model holds" in refused("excite", "--model", file, "--robot", "ur5", "--output", tmp_path / "o.csv")
