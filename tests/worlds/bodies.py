"""Rigid bodies of an arm by MuJoCo's inverse dynamics, from the URDF of any robot."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import NamedTuple
from xml.etree import ElementTree as ET

import mujoco
import numpy as np

LINK_ERROR = (0.03, 0.08)
"""Share by which a link's mass, extents and centre are off; the centre's in distances of the link's size."""


@dataclass(frozen=True)
class Attachment:
    """A body that is fixed to the link that a joint moves; of no size until its mass is set."""

    name: str  # of the body
    joint: str  # whose child link carries it
    place: tuple[float, float, float] = (0.0, 0.0, 0.0)  # (3,) of its frame in that link's frame, m


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


def compiled(urdf_xml: str, attachments: Collection[Attachment] = (), arm: Sequence[str] = ()) -> mujoco.MjModel:
    """A robot in MuJoCo without shapes, friction and contacts; every link stays a body of its own.

    Args:
        urdf_xml: its URDF as text.
        attachments: bodies to add.
        arm: joints from base to tool; given, what does not move with them is left out, which is faster.
    """
    root = ET.fromstring(urdf_xml)
    for link in root.findall("link"):
        for kind in ("visual", "collision"):
            for element in link.findall(kind):
                link.remove(element)
    if arm:
        _leave_out_other_branches(root, arm[0])
    extension = ET.SubElement(root, "mujoco")
    ET.SubElement(extension, "compiler", fusestatic="false", discardvisual="false")
    for attachment in attachments:
        _attach(root, attachment)
    model = mujoco.MjModel.from_xml_string(ET.tostring(root, encoding="unicode"))
    model.dof_damping[:] = 0.0
    model.dof_frictionloss[:] = 0.0
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
    return model


def torques(model: mujoco.MjModel, joints: Sequence[str], q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
    """(n, nj) N m by inverse dynamics, all other joints at zero.

    Args:
        model: of the robot.
        joints: (nj,) names.
        q: (n, nj) rad.
        v: (n, nj) rad/s.
        a: (n, nj) rad/s^2.
    """
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


def _attach(root: ET.Element, attachment: Attachment) -> None:
    carrier = next(joint for joint in root.findall("joint") if joint.get("name") == attachment.joint)
    link = ET.SubElement(root, "link", name=attachment.name)
    inertial = ET.SubElement(link, "inertial")
    ET.SubElement(inertial, "mass", value="1.0")
    ET.SubElement(inertial, "origin", xyz="0 0 0")
    ET.SubElement(inertial, "inertia", ixx="1e-9", iyy="1e-9", izz="1e-9", ixy="0", ixz="0", iyz="0")
    joint = ET.SubElement(root, "joint", name=f"{attachment.name}_fixed", type="fixed")
    ET.SubElement(joint, "parent", link=_end(carrier, "child"))
    ET.SubElement(joint, "child", link=attachment.name)
    ET.SubElement(joint, "origin", xyz=" ".join(map(str, attachment.place)))
