"""Batch kinematics against Pinocchio and MuJoCo."""

from xml.etree import ElementTree

import mujoco
import numpy as np
import pinocchio as pin
import pytest

from ik.chain import Chain, rotation_error


@pytest.fixture(scope="module")
def chain(baxter) -> Chain:
    return Chain.of(baxter)


@pytest.fixture(scope="module")
def postures(baxter):
    return np.random.default_rng(0).uniform(baxter.limits.lower, baxter.limits.upper, (50, 7))


@pytest.fixture(scope="module")
def pinocchio(baxter):
    """Baxter in Pinocchio with a frame at the tool point."""
    model = baxter.model.copy()
    frame = model.frames[baxter.tool_frame_id]
    at = frame.placement * pin.SE3(np.eye(3), baxter.tool_offset)
    return model, model.addFrame(pin.Frame("tool_point", frame.parentJoint, at, pin.FrameType.OP_FRAME))


@pytest.fixture(scope="module")
def in_mujoco(baxter) -> mujoco.MjModel:
    """The unmended URDF in MuJoCo, every link a body of its own, without shapes."""
    root = ElementTree.fromstring(baxter.urdf_path.read_text())
    for link in root.findall("link"):
        for element in [*link.findall("visual"), *link.findall("collision")]:
            link.remove(element)
    compiler = {"fusestatic": "false", "balanceinertia": "true", "boundmass": "1e-4", "boundinertia": "1e-9"}
    ElementTree.SubElement(ElementTree.SubElement(root, "mujoco"), "compiler", compiler)
    return mujoco.MjModel.from_xml_string(ElementTree.tostring(root, encoding="unicode"))


def test_tool_poses_agree_with_mujoco(baxter, chain, postures, in_mujoco) -> None:
    data = mujoco.MjData(in_mujoco)
    motion = chain.motion(postures)
    for k, q in enumerate(postures):
        for name, value in zip(baxter.joint_names, q, strict=True):
            data.joint(name).qpos = value
        mujoco.mj_kinematics(in_mujoco, data)
        tool = data.body(baxter.tool_frame)
        rotation = tool.xmat.reshape(3, 3)
        assert rotation == pytest.approx(motion.rotation[:, :, k], abs=1e-12)
        assert tool.xpos + rotation @ baxter.tool_offset == pytest.approx(motion.position[:, k], abs=1e-12)


def test_poses_and_jacobians_agree_with_pinocchio(chain, postures, pinocchio) -> None:
    model, frame = pinocchio
    data = model.createData()
    motion = chain.motion(postures)
    jacobian = chain.jacobian(motion)
    for k, q in enumerate(postures):
        expected = pin.computeFrameJacobian(model, data, q, frame, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
        pin.framesForwardKinematics(model, data, q)
        assert np.abs(jacobian[:, :, k] - expected).max() < 1e-13
        assert np.abs(motion.rotation[:, :, k] - data.oMf[frame].rotation).max() < 1e-13
        assert np.abs(motion.position[:, k] - data.oMf[frame].translation).max() < 1e-13


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
