"""Batch kinematics against Pinocchio, MuJoCo and differences."""

import mujoco
import numpy as np
import pinocchio as pin
import pytest

from ik.chain import Chain, rotation_error


@pytest.fixture(scope="module")
def chain(robot) -> Chain:
    return Chain.of(robot)


@pytest.fixture(scope="module")
def postures(robot):
    return np.random.default_rng(0).uniform(robot.limits.lower, robot.limits.upper, (50, robot.model.nv))


def test_tool_poses_agree_with_mujoco(robot, chain, postures, plant) -> None:
    data, motion = mujoco.MjData(plant), chain.motion(postures)
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
    data, jacobian = model.createData(), chain.jacobian(chain.motion(postures))
    for k, q in enumerate(postures):
        expected = pin.computeFrameJacobian(model, data, q, tool, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
        assert np.abs(jacobian[:, :, k] - expected).max() < 1e-13


def test_velocity_product_agrees_with_the_change_of_the_jacobian(chain, postures) -> None:
    rates = np.random.default_rng(1).normal(size=postures.shape)
    product = chain.velocity_product(chain.motion(postures), rates)
    step = 1e-6
    ahead, behind = (chain.jacobian(chain.motion(postures + k * step * rates)) for k in (1, -1))
    differences = np.einsum("ijk,kj->ik", (ahead - behind) / (2 * step), rates)
    assert np.abs(product - differences).max() < 1e-7


@pytest.mark.parametrize("angle", [0.0, 1e-9, 0.3, 3.0])
def test_rotation_error_is_the_rotation_vector_between_orientations(angle: float) -> None:
    axis = np.array([0.6, -0.48, 0.64])
    current = pin.exp3(np.array([0.2, 0.4, -0.3]))
    target = pin.exp3(angle * axis) @ current
    assert rotation_error(target[:, :, None], current[:, :, None])[:, 0] == pytest.approx(angle * axis, abs=1e-12)
