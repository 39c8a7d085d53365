"""What the table says about torque, margins and singularity, held against MuJoCo and Pinocchio."""

from xml.etree import ElementTree

import mujoco
import numpy as np
import pinocchio as pin
import pytest


@pytest.fixture(scope="module")
def plant(baxter) -> mujoco.MjModel:
    """The mended Baxter in MuJoCo without shapes, every joint but the arm's taken out."""
    root = ElementTree.fromstring(baxter.urdf_xml)
    for link in root.findall("link"):
        for shape in [*link.findall("visual"), *link.findall("collision")]:
            link.remove(shape)
    for joint in root.findall("joint"):
        if joint.get("name") not in baxter.joint_names:
            joint.set("type", "fixed")
    compiler = {"fusestatic": "false", "balanceinertia": "false", "boundmass": "1e-12", "boundinertia": "1e-12"}
    ElementTree.SubElement(ElementTree.SubElement(root, "mujoco"), "compiler", compiler)
    return mujoco.MjModel.from_xml_string(ElementTree.tostring(root, encoding="unicode"))


def test_torque_along_the_line_agrees_with_mujocos_inverse_dynamics(table, plant) -> None:
    data = mujoco.MjData(plant)
    rng = np.random.default_rng(2)
    for s, v, a in zip(rng.uniform(-0.3, 0.55, 20), rng.uniform(-1, 1, 20), rng.uniform(-8, 8, 20), strict=True):
        data.qpos[:], data.qvel[:], data.qacc[:] = table.joint_motion(s, v, a)
        mujoco.mj_inverse(plant, data)
        assert table.torque.at(table.s, s).torque(v, a) == pytest.approx(data.qfrc_inverse, abs=2e-4)


def test_springs_take_their_torque_off_the_motor(table, baxter) -> None:
    without, helped = (table.torque.at(table.s, 0.1).torque(0.0, 0.0, springs) for springs in (False, True))
    shoulder = table.posture(0.1).q[1]
    assert (helped - without)[1] == pytest.approx(8.2 * np.sin(shoulder) + 35.3 * np.cos(shoulder), abs=1e-6)
    assert np.delete(without - helped, 1).tolist() == [0.0] * 6
    assert abs(helped[1]) < abs(without[1])
    assert baxter.springs[0].enabled is False


@pytest.mark.parametrize("springs", [False, True])
def test_at_either_end_of_the_acceleration_range_one_motor_is_at_its_limit(table, springs: bool) -> None:
    s, v = np.linspace(-0.3, 0.55, 40), np.linspace(-0.4, 0.4, 40)
    for a in table.torque_acceleration_range(s, v, springs):
        share = np.abs(table.torque.at(table.s, s).torque(v, a, springs)) / table.effort_limits
        assert share.max(axis=1) == pytest.approx(1.0, abs=1e-9)
    low, high = table.torque_acceleration_range(s, v, springs)
    assert (low < 0).all()
    assert (high > 0).all()


def test_holding_still_takes_less_of_the_shoulder_with_its_springs(table) -> None:
    assert table.torque_share[:, 0].max() < 1.0
    assert table.torque_share[:, 1].max() < 0.6 * table.torque_share[:, 0].max()


def test_manipulability_is_the_product_of_singular_values(table, baxter) -> None:
    data = baxter.model.createData()
    for node in (0, 700, 1700):
        pin.computeJointJacobians(baxter.model, data, table.q[node])
        values = [np.linalg.svd(table.jacobian[node, rows], compute_uv=False) for rows in (slice(0, 3), slice(3, 6))]
        assert table.manipulability[node] == pytest.approx([np.prod(value) for value in values])
    assert table.manipulability.min() > 0.01


def test_margins_are_those_of_the_nodes(table, baxter) -> None:
    assert np.array_equal(table.margin, baxter.limits.margin(table.q))
    assert table.joint_margin == table.margin.min()
