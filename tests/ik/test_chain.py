"""Batch kinematics against Pinocchio, MuJoCo and differences."""

import mujoco
import numpy as np
import pinocchio as pin
import pytest

from armdyn.arm.posture import arm_posture
from armdyn.errors import InputError
from ik.chain import KinematicChain, rotation_error


@pytest.fixture(scope="module")
def chain(robot) -> KinematicChain:
    return KinematicChain.from_robot(robot)


@pytest.fixture(scope="module")
def postures(robot):
    return np.random.default_rng(0).uniform(robot.limits.lower, robot.limits.upper, (50, robot.model.nv))


def test_tool_poses_agree_with_mujoco(robot, chain, postures, plant) -> None:
    data, motion = mujoco.MjData(plant), chain.forward_kinematics(postures)
    for k, q in enumerate(postures):
        data.qpos[:] = q
        mujoco.mj_kinematics(plant, data)
        tool, pose = data.body(robot.tool_frame), robot.tool_pose(q)
        rotation = tool.xmat.reshape(3, 3)
        position = tool.xpos + rotation @ robot.tool_offset
        for found in ((motion.rotation[:, :, k], motion.position[:, k]), (pose.rotation, pose.translation)):
            assert np.abs(rotation - found[0]).max() < 1e-12
            assert np.abs(position - found[1]).max() < 1e-12


def test_jacobians_agree_with_pinocchio(robot, chain, postures) -> None:
    model = robot.model.copy()
    frame = model.frames[robot.tool_frame_id]
    at = frame.placement * pin.SE3(np.eye(3), robot.tool_offset)
    tool = model.addFrame(pin.Frame("tool_point", frame.parentJoint, at, pin.FrameType.OP_FRAME))
    data, jacobian = model.createData(), chain.jacobian(chain.forward_kinematics(postures))
    for k, q in enumerate(postures):
        expected = pin.computeFrameJacobian(model, data, q, tool, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
        assert np.abs(jacobian[:, :, k] - expected).max() < 1e-13


def test_velocity_product_agrees_with_the_change_of_the_jacobian(chain, postures) -> None:
    rates = np.random.default_rng(1).normal(size=postures.shape)
    product = chain.velocity_product(chain.forward_kinematics(postures), rates)
    step = 1e-6
    ahead, behind = (chain.jacobian(chain.forward_kinematics(postures + k * step * rates)) for k in (1, -1))
    differences = np.einsum("ijk,kj->ik", (ahead - behind) / (2 * step), rates)
    assert np.abs(product - differences).max() < 1e-7


@pytest.mark.parametrize("angle", [0.0, 1e-9, 0.3, 3.0])
def test_rotation_error_is_the_rotation_vector_between_orientations(angle: float) -> None:
    axis = np.array([0.6, -0.48, 0.64])
    current = pin.exp3(np.array([0.2, 0.4, -0.3]))
    target = pin.exp3(angle * axis) @ current
    assert rotation_error(target[:, :, None], current[:, :, None])[:, 0] == pytest.approx(angle * axis, abs=1e-12)


STATES = 40


@pytest.fixture(scope="module")
def states(robot):
    """Random postures and rates, (k, n) each."""
    rng, limits = np.random.default_rng(11), robot.limits
    q = rng.uniform(limits.lower, limits.upper, (STATES, robot.model.nv))
    return q, rng.uniform(-1, 1, q.shape) * limits.velocity


def relative(one: np.ndarray, other: np.ndarray) -> float:
    return float(np.abs(one - other).max() / np.abs(other).max())


def test_the_closed_form_is_mujocos_equation_of_motion(robot, plant, states) -> None:
    data, full = mujoco.MjData(plant), np.zeros((plant.nv, plant.nv))
    for q, v in zip(*states, strict=True):
        shown = arm_posture(robot, q, v)
        data.qpos[:], data.qvel[:] = q, v
        mujoco.mj_forward(plant, data)
        mujoco.mj_fullM(plant, data, full)
        assert relative(shown.inertia, full) < 1e-10
        assert relative(shown.coriolis @ v + shown.gravity, data.qfrc_bias) < 1e-10
        assert relative(shown.regressor @ shown.parameters, data.qfrc_bias) < 1e-10
        assert shown.damping * v == pytest.approx(-data.qfrc_passive, abs=1e-12)
        mujoco.mj_energyPos(plant, data)
        mujoco.mj_energyVel(plant, data)
        assert shown.kinetic_energy == pytest.approx(data.energy[1], rel=1e-10)
        rest = arm_posture(robot, states[0][0])
        data.qpos[:] = states[0][0]
        before = data.energy[0]
        mujoco.mj_kinematics(plant, data)
        mujoco.mj_comPos(plant, data)
        mujoco.mj_energyPos(plant, data)
        assert shown.potential_energy - rest.potential_energy == pytest.approx(before - data.energy[0], abs=1e-9)


def test_gravity_is_the_gradient_of_the_potential_energy(robot) -> None:
    step = 1e-6
    for joint, expected in enumerate(arm_posture(robot).gravity):
        moved = [robot.home + side * step * np.eye(len(robot.home))[joint] for side in (1, -1)]
        ahead, behind = (arm_posture(robot, q).potential_energy for q in moved)
        assert (ahead - behind) / (2 * step) == pytest.approx(expected, abs=1e-6)


def test_the_speed_ellipsoid_holds_every_speed_of_the_unit_ball(baxter) -> None:
    shown = arm_posture(baxter)
    rng = np.random.default_rng(0)
    rates = rng.normal(size=(500, 7))
    rates *= baxter.limits.velocity / np.linalg.norm(rates, axis=1)[:, None]
    speeds = shown.speed.axes.T @ shown.jacobian[:3] @ rates.T
    size = np.linalg.norm(speeds / shown.speed.lengths[:, None], axis=0)
    assert size.max() <= 1.0 + 1e-12
    assert size.max() > 0.9


def test_the_largest_speed_along_an_axis_leaves_no_joint_faster_than_its_limit(baxter) -> None:
    shown = arm_posture(baxter)
    # Its dual: the least of |J^T w|_1 over w with w_y = 1, by brute force over a grid.
    w = np.stack(np.meshgrid(np.linspace(-3, 3, 301), 1.0, np.linspace(-3, 3, 301)), axis=-1).reshape(-1, 3)
    bound = (np.abs(w @ shown.jacobian[:3]) * baxter.limits.velocity).sum(axis=1).min()
    assert shown.speed.along[1] == pytest.approx(bound, rel=2e-2)
    assert shown.speed.along[1] <= bound + 1e-9


def test_the_largest_force_puts_one_joint_at_its_torque_limit(baxter) -> None:
    shown = arm_posture(baxter)
    for axis in range(3):
        force = np.zeros(3)
        force[axis] = shown.force.along[axis]
        torque = shown.gravity + shown.jacobian[:3].T @ force
        assert (np.abs(torque) / baxter.limits.effort).max() == pytest.approx(1.0)


@pytest.mark.parametrize(
    "q",
    [
        [0.0] * 6,
        [0.0, 0.0, float("nan"), 0.0, 0.0, 0.0, 0.0],
        [0.0, 5.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        [0.0, -30.0, 40.0, 90.0, 0.0, 0.0, 0.0],
    ],
)
def test_postures_that_cannot_be_are_refused(baxter, q: list[float], complains) -> None:
    with complains(InputError):
        arm_posture(baxter, q)
