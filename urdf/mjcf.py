"""Read a robot in MuJoCo's XML format, MJCF: MuJoCo compiles it, and the result is converted to a URDF.

MuJoCo resolves defaults, includes, frames and orientations, and computes the inertias of shapes. This module converts
the compiled bodies and joints to a URDF; `urdf.mjcf_dynamics` reads the properties that a URDF cannot contain.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import mujoco
import numpy as np
import pinocchio as pin

from urdf.library_output import library_errors
from urdf.mjcf_sizes import check_sizes
from urdf.robot import MJCF_NOTE_PREFIX, Array, UrdfError
from urdf.write import add_joint, inertial_element, xml_number_list

ASSUMED_SPEED_LIMITS = {"revolute": 1.0, "continuous": 1.0, "prismatic": 0.25}
"""Speed limit that is assumed for each type of joint [rad/s or m/s], because an MJCF contains none.

0.25 m/s is the reduced speed of ISO 10218-1.
"""
HINGE, SLIDE = int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)
JOINT_TRANSMISSIONS = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
"""MuJoCo's types of actuator transmission that drive a single joint."""


@dataclass(frozen=True)
class CompiledMjcf:
    """An MJCF file compiled by MuJoCo.

    Attributes:
        path: the file.
        model: compiled ``MjModel``.
        bodies: name of each body by index.
        joints: name of each joint by index; a joint without a name is named after its body.
        root: root element of a URDF with the bodies, hinges and slides.
        sentences: a sentence per assumption that was made and per element that was left out.
    """

    path: Path
    model: Any
    bodies: tuple[str, ...]
    joints: tuple[str, ...]
    urdf_root: ET.Element
    notes: tuple[str, ...]


def read_mjcf(path: Path) -> CompiledMjcf:
    """Compile an MJCF file with MuJoCo, and convert its bodies and joints to a URDF.

    Raises:
        UrdfError: MuJoCo refuses the file, with MuJoCo's message; or a number in the file is nan or infinite.
    """
    check_sizes(path)
    model, noticed = _compiled(path)
    if any("NaN" in text for text in noticed):  # MuJoCo ignores this entry
        raise UrdfError(f"{path}: {_nan_in(path)} holds 'nan', which is not a number; correct it")
    bodies = _names(model, mujoco.mjtObj.mjOBJ_BODY, model.nbody, lambda i: f"body_{i}")
    joints = _names(model, mujoco.mjtObj.mjOBJ_JOINT, model.njnt, lambda j: f"{bodies[model.jnt_bodyid[j]]}_joint")
    _check_numbers(path, model, bodies, joints)
    tree = _Tree(path.stem, model, bodies, joints)
    sentences = [*tree.held, *noticed]
    sentences.append(
        f"it has no speed limits; {ASSUMED_SPEED_LIMITS['revolute']:g} rad/s and "
        f"{ASSUMED_SPEED_LIMITS['prismatic']:g} m/s were assumed"
    )
    if model.opt.density or model.opt.viscosity:
        sentences.append("the drag of what the robot moves in is left out")
    return CompiledMjcf(
        path, model, bodies, joints, tree.root, tuple(f"{MJCF_NOTE_PREFIX}{sentence}" for sentence in sentences)
    )


def _compiled(path: Path) -> tuple[Any, list[str]]:
    """The compiled ``MjModel``, and MuJoCo's warnings."""
    noticed: list[str] = []
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda text: noticed.append(f"MuJoCo warns: {' '.join(str(text).split())}"))
    try:
        with library_errors(f"{path}: MuJoCo refuses it", "correct it"):
            model = mujoco.MjModel.from_xml_path(str(path))
    finally:
        mujoco.set_mju_user_warning(before)
    return model, noticed


def _nan_in(path: Path) -> str:
    """The element of a file that contains nan."""
    for element in ET.parse(path).iter():
        for key, text in element.attrib.items():
            if "nan" in text.lower().split():
                return f"{key} of <{element.tag}>" + (f" '{element.get('name')}'" if element.get("name") else "")
    return "a file that it includes"


def _names(model: Any, kind: Any, count: int, otherwise: Callable[[int], str]) -> tuple[str, ...]:
    """Names of bodies or joints by index, with a new name for each that has none."""
    given = [mujoco.mj_id2name(model, kind, i) for i in range(count)]
    taken, found = set(filter(None, given)), list[str]()
    for i, own in enumerate(given):
        found.append(own or _free(otherwise(i), taken))
    return tuple(found)


def _free(name: str, taken: set[str]) -> str:
    """A name that is not in `taken`, made longer where needed; it is added to `taken`."""
    while name in taken:
        name += "_"
    taken.add(name)
    return name


def _check_numbers(path: Path, model: Any, bodies: tuple[str, ...], joints: tuple[str, ...]) -> None:
    """Refuse numbers that are not finite, which MuJoCo accepts.

    Raises:
        UrdfError: names the body, joint, tendon or actuator.
    """
    dofs = tuple(joints[j] for j in model.dof_jntid)
    owners: dict[str, tuple[str, tuple[str, ...]]] = {
        "body": ("body", bodies), "jnt": ("joint", joints), "dof": ("joint", dofs), "tendon": ("tendon", ()),
        "actuator": ("actuator", ()), "site": ("site", ()),
    }  # fmt: skip
    for field in dir(model):
        prefix, _, what = field.partition("_")
        values = getattr(model, field) if prefix in owners else None
        if isinstance(values, np.ndarray) and values.dtype.kind == "f" and not np.isfinite(values).all():
            i, (kind, names) = int(np.argwhere(~np.isfinite(values))[0][0]), owners[prefix]
            who = f"'{names[i]}'" if names else str(i + 1)
            raise UrdfError(f"{path}: {kind} {who}: its {what} holds what is not a finite number; correct it")


class _Tree:
    """The URDF of a compiled model, a link for every body.

    A link's origin is on the axis of the joint that moves it, and its axes are those of the body.

    Attributes:
        root: of the URDF.
        held: a sentence per joint that a URDF cannot contain, and that is fixed.
    """

    def __init__(self, name: str, model: Any, bodies: tuple[str, ...], joints: tuple[str, ...]) -> None:
        self.root, self.held = ET.Element("robot", name=name), list[str]()
        self._model, self._bodies, self._joints = model, bodies, joints
        self._taken, self._efforts = {*bodies, *joints}, _efforts(model)
        self._shifts = np.zeros((model.nbody, 3))  # offset of a link's origin from its body's origin
        self._link(bodies[0])
        for body in range(1, model.nbody):
            self._add_body(body)
        for i in range(model.nsite):
            name, body = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_SITE, i), int(model.site_bodyid[i])
            if name and name not in self._taken:
                self._taken.add(name)
                self._link(name)
                self._fix(bodies[body], name, _pose(model.site_pos[i] - self._shifts[body], model.site_quat[i]))
        self._couple()

    def _add_body(self, body: int) -> None:
        m, name, parent = self._model, self._bodies[body], int(self._model.body_parentid[body])
        first = int(m.body_jntadr[body])
        every = range(first, first + int(m.body_jntnum[body]))
        single = [j for j in every if m.jnt_type[j] in (HINGE, SLIDE)]
        for j in every:
            if j not in single:
                kind = "is a ball joint" if m.jnt_type[j] == int(mujoco.mjtJoint.mjJNT_BALL) else "floats"
                self.held.append(f"'{self._joints[j]}' {kind}; taken as fixed")
        placement = _pose(m.body_pos[body] - self._shifts[parent], m.body_quat[body])
        inner, shift = self._bodies[parent], np.zeros(3)
        for j in single:
            # MuJoCo applies a body's joints one after the other, each in the frame that the earlier ones give.
            placement = placement * pin.SE3(np.eye(3), m.jnt_pos[j] - shift) * self._to_zero(j)
            link = name if j == single[-1] else _free(f"{name}_{self._joints[j]}", self._taken)
            self._link(link)
            self._move(j, inner, link, placement)
            placement, inner, shift = pin.SE3.Identity(), link, np.array(m.jnt_pos[j])
        self._shifts[body] = shift
        if not single:
            self._link(name)
            self._fix(inner, name, placement)
        if m.body_mass[body] > 0.0:
            R = _pose(np.zeros(3), m.body_iquat[body]).rotation
            inertia = R @ np.diag(m.body_inertia[body]) @ R.T
            self.root.findall("link")[-1].append(
                inertial_element(m.body_mass[body], m.body_ipos[body] - shift, inertia)
            )

    def _to_zero(self, j: int) -> pin.SE3:
        """Transform of a joint from its position in the file, ``ref``, to position 0."""
        back, axis = -float(self._model.qpos0[self._model.jnt_qposadr[j]]), np.array(self._model.jnt_axis[j])
        if self._model.jnt_type[j] == SLIDE:
            return pin.SE3(np.eye(3), back * axis)
        return pin.SE3(pin.AngleAxis(back, axis).toRotationMatrix(), np.zeros(3))

    def _move(self, j: int, inner: str, link: str, placement: pin.SE3) -> None:
        m = self._model
        kind = "prismatic" if m.jnt_type[j] == SLIDE else "revolute" if m.jnt_limited[j] else "continuous"
        element = self._join(kind, self._joints[j], inner, link, placement)
        ET.SubElement(element, "axis", xyz=xml_number_list(m.jnt_axis[j]))
        limit = ET.SubElement(element, "limit", velocity=repr(ASSUMED_SPEED_LIMITS[kind]))
        if j in self._efforts:
            limit.set("effort", repr(self._efforts[j]))
        if m.jnt_limited[j]:
            for key, bound in zip(("lower", "upper"), m.jnt_range[j].tolist(), strict=True):
                limit.set(key, repr(bound))

    def _couple(self) -> None:
        """Add ``<mimic>`` to joints that follow others, as the fingers of a gripper do."""
        m, elements = self._model, {joint.get("name"): joint for joint in self.root.findall("joint")}
        for i in np.flatnonzero(m.eq_type == int(mujoco.mjtEq.mjEQ_JOINT)):
            if m.eq_active0[i] and m.eq_obj2id[i] >= 0:
                follower, leader = self._joints[m.eq_obj1id[i]], self._joints[m.eq_obj2id[i]]
                ET.SubElement(elements[follower], "mimic", joint=leader, multiplier=repr(float(m.eq_data[i, 1])))

    def _link(self, name: str) -> None:
        ET.SubElement(self.root, "link", name=name)

    def _fix(self, inner: str, link: str, placement: pin.SE3) -> None:
        self._join("fixed", _free(f"{link}_fixed", self._taken), inner, link, placement)

    def _join(self, kind: str, name: str, inner: str, link: str, placement: pin.SE3) -> ET.Element:
        rpy = pin.rpy.matrixToRpy(np.asarray(placement.rotation))
        return add_joint(self.root, name, kind, inner, link, placement.translation, rpy)


def _efforts(model: Any) -> dict[int, float]:
    """Effort limit by joint: its own, or that of the actuators that drive it, where there is one."""
    found: dict[int, float] = {}
    for i in range(model.nu):
        size = 0.0
        if model.actuator_forcelimited[i]:
            size = float(np.abs(model.actuator_forcerange[i]).max())
        elif model.actuator_ctrllimited[i] and model.actuator_biastype[i] == int(mujoco.mjtBias.mjBIAS_NONE):
            size = float(np.abs(model.actuator_ctrlrange[i]).max() * abs(model.actuator_gainprm[i, 0]))
        if size and model.actuator_trntype[i] in JOINT_TRANSMISSIONS:
            j = int(model.actuator_trnid[i, 0])
            found[j] = max(found.get(j, 0.0), size * abs(float(model.actuator_gear[i, 0])))
    limited = np.flatnonzero(model.jnt_actfrclimited).tolist()
    return found | {j: float(np.abs(model.jnt_actfrcrange[j]).max()) for j in limited}


def _pose(position: Array, quaternion: Array) -> pin.SE3:
    """A frame from a position (3,) [m] and a quaternion (4,), the scalar first."""
    w, x, y, z = quaternion
    return pin.SE3(pin.Quaternion(w, x, y, z).normalized().toRotationMatrix(), np.array(position))
