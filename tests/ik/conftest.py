from functools import cache
from xml.etree import ElementTree

import mujoco
import numpy as np
import pytest
import yourdfpy

import ik
import urdf

ROBOTS = ("baxter", "ur5", "panda", "talos_arm")


@pytest.fixture(scope="session", params=ROBOTS)
def robot(request) -> urdf.Robot:
    """Each known arm in turn."""
    return urdf.load(request.param)


@pytest.fixture(scope="session")
def table(baxter: urdf.Robot) -> ik.LineTable:
    return ik.build_line_table(baxter)


@pytest.fixture(scope="session")
def tables(table):
    """The table of a known arm's own line, built once."""
    built = {"baxter": table}
    return lambda robot: built.get(robot.name) or built.setdefault(robot.name, ik.build_line_table(robot))


@pytest.fixture(scope="session")
def tool_poses():
    """Rotations (k, 3, 3) and positions (k, 3) of the tool point by the unmended URDF in yourdfpy, not Pinocchio."""
    loaded = cache(lambda path: yourdfpy.URDF.load(str(path), load_meshes=False))

    def poses(robot, postures):
        model, found = loaded(robot.urdf_path), []
        for q in postures:
            model.update_cfg(dict(zip(robot.joint_names, q, strict=True)))
            found.append(model.get_transform(robot.tool_frame, model.base_link))
        rotations = np.array(found)[:, :3, :3]
        return rotations, np.array(found)[:, :3, 3] + rotations @ robot.tool_offset

    return poses


@pytest.fixture(scope="session")
def plant(robot: urdf.Robot) -> mujoco.MjModel:
    """Each known arm in MuJoCo."""
    return in_mujoco(robot)


@pytest.fixture(scope="session")
def baxter_plant(baxter: urdf.Robot) -> mujoco.MjModel:
    return in_mujoco(baxter)


def in_mujoco(robot: urdf.Robot) -> mujoco.MjModel:
    """The arm's mended URDF in MuJoCo without shapes, every other joint fixed, with the URDF's damping."""
    root = ElementTree.fromstring(robot.urdf_xml)
    for link in root.findall("link"):
        for shape in [*link.findall("visual"), *link.findall("collision")]:
            link.remove(shape)
        inertial = link.find("inertial")
        if inertial is not None and float(inertial.find("mass").get("value")) == 0.0:
            link.remove(inertial)
    for joint in root.findall("joint"):
        if joint.get("name") not in robot.joint_names:
            joint.set("type", "fixed")
            for mimic in joint.findall("mimic"):
                joint.remove(mimic)
    compiler = {"fusestatic": "false", "balanceinertia": "false", "boundmass": "0", "boundinertia": "0"}
    ElementTree.SubElement(ElementTree.SubElement(root, "mujoco"), "compiler", compiler)
    model = mujoco.MjModel.from_xml_string(ElementTree.tostring(root, encoding="unicode"))
    model.dof_frictionloss[:] = 0.0  # dry friction has no place in Pinocchio's algorithms
    return model


@pytest.fixture
def saved(table, tmp_path):
    path = tmp_path / "table.npz"
    table.save(path)
    return path
