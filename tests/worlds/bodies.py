"""Rigid bodies of an arm by MuJoCo's inverse dynamics, from the URDF of any robot."""

from collections.abc import Sequence
from typing import NamedTuple
from xml.etree import ElementTree as ET

import mujoco
import numpy as np

LINK_ERROR = (0.03, 0.08)
"""Share by which a link's mass, extents and centre are off; the centre's in distances of the link's size."""


class Links(NamedTuple):
    """Inertias of every body of a MuJoCo model: (nb,) kg, (nb, 3) m and (nb, 3) kg m^2 about its principal axes."""

    mass: np.ndarray
    centre: np.ndarray
    inertia: np.ndarray

    @classmethod
    def of(cls, model: mujoco.MjModel) -> "Links":
        """As they are."""
        return cls(model.body_mass.copy(), model.body_ipos.copy(), model.body_inertia.copy())

    def into(self, model: mujoco.MjModel) -> None:
        """Give them to the model."""
        model.body_mass[:], model.body_ipos[:], model.body_inertia[:] = self.mass, self.centre, self.inertia

    def off(self, rng: np.random.Generator) -> "Links":
        """Every body off by `LINK_ERROR`: its mass, its extent along each principal axis, its centre; still a body."""
        count = len(self.mass)
        mass = self.mass * (1.0 + _off(rng, count))
        extents = 0.5 * self.inertia.sum(axis=1, keepdims=True) - self.inertia  # integrals of x^2, y^2, z^2 over mass
        extents = extents * (1.0 + _off(rng, count))[:, None] * (1.0 + 0.5 * _off(rng, (count, 3)))
        has_mass = self.mass > 0.0
        gyration = np.sqrt(0.5 * self.inertia.sum(axis=1) / np.where(has_mass, self.mass, 1.0))
        size = np.where(has_mass, np.maximum(np.linalg.norm(self.centre, axis=1), gyration), 0.0)
        way = rng.standard_normal((count, 3))
        way = way / np.linalg.norm(way, axis=1, keepdims=True)
        centre = self.centre + way * (size * rng.uniform(*LINK_ERROR, count))[:, None]
        return Links(mass, centre, extents.sum(axis=1, keepdims=True) - extents)


def _off(rng: np.random.Generator, shape: int | tuple[int, ...]) -> np.ndarray:
    return rng.choice([-1.0, 1.0], shape) * rng.uniform(*LINK_ERROR, shape)


def compiled(urdf_xml: str, joints: Sequence[str]) -> mujoco.MjModel:
    """An arm in MuJoCo without shapes, friction, contacts and what its joints, from base to tool, do not move.

    Every link stays a body of its own; the link that a joint moves carries another one, ``lump on <joint>``.
    """
    root = ET.fromstring(urdf_xml)
    for link in root.findall("link"):
        for kind in ("visual", "collision"):
            for element in link.findall(kind):
                link.remove(element)
    _leave_out_other_branches(root, joints[0])
    extension = ET.SubElement(root, "mujoco")
    ET.SubElement(extension, "compiler", fusestatic="false", discardvisual="false")
    for joint in joints:
        _attach_lump(root, joint)
    model = mujoco.MjModel.from_xml_string(ET.tostring(root, encoding="unicode"))
    model.dof_damping[:] = 0.0
    model.dof_frictionloss[:] = 0.0
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
    return model


def torques(model: mujoco.MjModel, joints: Sequence[str], q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
    """(n, nj) N m by inverse dynamics at (n, nj) rad, rad/s and rad/s^2, all other joints at zero."""
    position = [model.joint(name).qposadr[0] for name in joints]
    dof = [model.joint(name).dofadr[0] for name in joints]
    data = mujoco.MjData(model)
    torque = np.empty_like(q)
    for i in range(len(q)):
        data.qpos[position], data.qvel[dof], data.qacc[dof] = q[i], v[i], a[i]
        mujoco.mj_inverse(model, data)
        torque[i] = data.qfrc_inverse[dof]
    return torque


def _leave_out_other_branches(root: ET.Element, first: str) -> None:
    """Drop every branch that leaves the path from the robot's root to the joint `first`."""
    joints = root.findall("joint")
    parent_of = {_end(joint, "child"): joint for joint in joints}
    path = [next(joint for joint in joints if joint.get("name") == first)]
    while _end(path[-1], "parent") in parent_of:
        path.append(parent_of[_end(path[-1], "parent")])
    fixed = {_end(joint, "parent") for joint in path}
    doomed = [joint for joint in joints if _end(joint, "parent") in fixed and joint not in path]
    while doomed:
        gone = doomed.pop()
        root.remove(gone)
        link = _end(gone, "child")
        root.remove(next(element for element in root.findall("link") if element.get("name") == link))
        doomed += [joint for joint in joints if _end(joint, "parent") == link]


def _end(joint: ET.Element, which: str) -> str:
    element = joint.find(which)
    return str(element.get("link")) if element is not None else ""


def _attach_lump(root: ET.Element, joint: str) -> None:
    carrier = next(element for element in root.findall("joint") if element.get("name") == joint)
    link = ET.SubElement(root, "link", name=f"lump on {joint}")
    inertial = ET.SubElement(link, "inertial")
    ET.SubElement(inertial, "mass", value="1.0")
    ET.SubElement(inertial, "origin", xyz="0 0 0")
    ET.SubElement(inertial, "inertia", ixx="1e-9", iyy="1e-9", izz="1e-9", ixy="0", ixz="0", iyz="0")
    fixed = ET.SubElement(root, "joint", name=f"lump on {joint}, fixed", type="fixed")
    ET.SubElement(fixed, "parent", link=_end(carrier, "child"))
    ET.SubElement(fixed, "child", link=f"lump on {joint}")
