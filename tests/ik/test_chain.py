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


def relative(one: np.ndarray, other: np.ndarray) -> float:
    return float(np.abs(one - other).max() / np.abs(other).max())


def test_the_closed_form_is_mujocos_equation_of_motion(robot, plant, postures) -> None:
    data, full = mujoco.MjData(plant), np.zeros((plant.nv, plant.nv))
    rates = np.random.default_rng(11).uniform(-1, 1, postures.shape) * robot.limits.velocity
    potential = []
    for q, v in zip(postures[:40], rates, strict=False):
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
        potential.append((shown.potential_energy, data.energy[0]))
    ours, theirs = np.array(potential).T
    np.testing.assert_allclose(ours - ours[0], theirs - theirs[0], atol=1e-9)


def test_ellipsoids_and_largest_speeds_and_forces_are_those_of_the_joints_limits(baxter) -> None:
    shown, rng = arm_posture(baxter), np.random.default_rng(0)
    jacobian, fastest = shown.jacobian[:3], baxter.limits.velocity
    rates = rng.normal(size=(500, 7))
    rates *= fastest / np.linalg.norm(rates, axis=1)[:, None]
    size = np.linalg.norm(shown.speed.axes.T @ jacobian @ rates.T / shown.speed.lengths[:, None], axis=0)
    assert 0.9 < size.max() <= 1.0 + 1e-12
    # The dual of the largest speed along y: the least of |J^T w|_1 over w with w_y = 1, by brute force over a grid.
    w = np.stack(np.meshgrid(np.linspace(-3, 3, 301), 1.0, np.linspace(-3, 3, 301)), axis=-1).reshape(-1, 3)
    bound = (np.abs(w @ jacobian) * fastest).sum(axis=1).min()
    assert shown.speed.along[1] == pytest.approx(bound, rel=2e-2)
    assert shown.speed.along[1] <= bound + 1e-9
    for force in np.diag(shown.force.along):  # puts one joint at its torque limit
        torque = shown.gravity + jacobian.T @ force
        assert (np.abs(torque) / baxter.limits.effort).max() == pytest.approx(1.0)


NONE = [[0.0] * 6, [0.0, 0.0, np.nan, *[0.0] * 4], [0.0, 5.0, *[0.0] * 5], [0.0, -30.0, 40.0, 90.0, 0.0, 0.0, 0.0]]


@pytest.mark.parametrize("q", NONE)
def test_postures_that_cannot_be_are_refused(baxter, q: list[float], complains) -> None:
    with complains(InputError):
        arm_posture(baxter, q)
