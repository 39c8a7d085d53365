"""A force/torque sensor, as a cut through the arm: six joints that do not move, whose torques are the wrench.

The sensor's frame is put between a link and what carries it, with three sliding and three turning joints at zero.
Inverse dynamics, its derivatives by inertial parameters and by gravity then hold for the wrench as for joint torques.
"""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
import pinocchio as pin

from armdyn.arm.arm import Arm
from armdyn.arm.motion import Motion
from armdyn.arm.rigid import INERTIAL_PARAMETERS_PER_BODY, inertial_parameters_of, parent_joints, pseudo_inertia
from armdyn.errors import InputError, UnknownNameError, error_location
from armdyn.object_cache import cached_with_first_argument
from armdyn.recording.channels import WRENCH_CHANNELS
from armdyn.run import Run
from urdf.robot import rotation_from_rpy
from urdf.toml_tables import table_to_dataclass

WRENCH_AXES = tuple(WRENCH_CHANNELS)


class WrenchAxes(Enum):
    """Axes along which the channels of a force/torque sensor are: those of its own frame, or of the arm's base."""

    SENSOR = "sensor"
    BASE = "base"


@dataclass(frozen=True)
class WrenchSensor:
    """A force/torque sensor: it carries a link with everything behind it.

    It reads the force, N, and the torque about its origin, N m, that these exert on it: at rest their weight.

    Attributes:
        name: name of the sensor, which its channels have after the dot.
        link: the first link that it carries.
        xyz: origin of the sensor's frame in the frame of the link, m.
        rpy: roll, pitch and yaw of the sensor's frame against that of the link, rad.
        axes: axes along which its channels are.
        gain_std: standard deviation of the gain that all axes share, as a share; None where its maker states none.
    """

    name: str
    link: str
    xyz: tuple[float, ...] = (0.0, 0.0, 0.0)
    rpy: tuple[float, ...] = (0.0, 0.0, 0.0)
    axes: WrenchAxes = WrenchAxes.SENSOR
    gain_std: float | None = None

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of its six channels."""
        return tuple(f"{axis}.{self.name}" for axis in WRENCH_AXES)

    def recorded(self, run: Run) -> tuple[str, ...]:
        """Those of its channels that a run contains."""
        return tuple(name for name in self.channels if name in run.channels)

    def entries(self) -> dict[str, Any]:
        """Entries of the sensor's table in a model file."""
        places = {key: list(place) for key in ("xyz", "rpy") if any(place := getattr(self, key))}
        axes = {"axes": self.axes.value} if self.axes is not WrenchAxes.SENSOR else {}
        return {"link": self.link, **places, **axes} | ({} if self.gain_std is None else {"gain_std": self.gain_std})

    @property
    def placement(self) -> pin.SE3:
        """Placement of the sensor's frame in the frame of the link."""
        return pin.SE3(rotation_from_rpy(*self.rpy), np.array(self.xyz))


@dataclass(frozen=True)
class _Entry:
    link: str
    xyz: tuple[float, ...] = (0.0, 0.0, 0.0)
    rpy: tuple[float, ...] = (0.0, 0.0, 0.0)
    axes: WrenchAxes = WrenchAxes.SENSOR
    gain_std: float | None = None


def read_wrench_sensors(table: Mapping[str, Any], arm: Arm) -> dict[str, WrenchSensor]:
    """Read the tables ``[wrench.NAME]`` of a model file.

    Raises:
        InputError: an entry cannot be used, or the arm does not carry the link.
    """
    found = {}
    if not isinstance(table, Mapping):
        raise InputError('[wrench]: write a table for each sensor, such as [wrench.ft] with link = "tool0"')
    for name, entries in table.items():
        with error_location(f"[wrench.{name}]"):
            entry = table_to_dataclass(_Entry, entries)
            if not name.isidentifier():
                raise InputError("name the sensor with letters, digits and '_'")
            if name in arm.joints:
                raise InputError("a joint has this name: give the sensor another one")
            for key, unit in (("xyz", "m"), ("rpy", "rad")):
                if len(getattr(entry, key)) != len("xyz"):
                    raise InputError(f"{key}: write three numbers, in {unit}")
            if entry.gain_std is not None and not 0.0 <= entry.gain_std < 1.0:
                raise InputError("gain_std: write a share of 1, such as 0.02 for 2 %")
            found[name] = WrenchSensor(name, entry.link, tuple(entry.xyz), tuple(entry.rpy), entry.axes, entry.gain_std)
            cut_at_sensor(arm, found[name])
    return found


def chosen_sensors(chosen: Sequence[str]) -> dict[str, Any]:
    """Table ``[wrench]`` of a model file for texts ``"NAME=LINK"``.

    Raises:
        InputError: a text has another form.
    """
    found = {}
    for text in chosen:
        name, _, link = (part.strip() for part in text.partition("="))
        if not name.isidentifier() or not link:
            raise InputError(f"--wrench {text}: write it as ft=tool0, with the first link that the sensor carries")
        found[name] = {"link": link}
    return found


def unused_wrenches(
    sensors: Mapping[str, WrenchSensor], runs: Iterable[Run], compared: Collection[str]
) -> tuple[str, ...]:
    """Sentences, without full stops, on sensors whose wrench the runs contain and nothing is compared with.

    Args:
        sensors: the sensors of the model.
        runs: the recordings.
        compared: names of the compared channels.
    """
    parts = [(kind, name) for run in runs for kind, _, name in (channel.partition(".") for channel in run.channels)]
    recorded = dict.fromkeys(name for kind, name in parts if kind in WRENCH_CHANNELS)
    unused = [name for name in recorded if not any(f"{axis}.{name}" in compared for axis in WRENCH_AXES)]
    return tuple(
        f"The wrench of {name} is not used: "
        + (
            "no fitted recording contains it"
            if name in sensors
            else f'write [wrench.{name}] with link = "...", the first link that it carries, into the model file'
        )
        for name in unused
    )


@dataclass(frozen=True, eq=False)
class CutArm:
    """An arm that is cut at a sensor.

    Attributes:
        model: the rigid bodies, with six joints of the sensor between those of the arm.
        moved: (nj,) index in `model` of each joint of the arm.
        axes: (6,) index in `model` of the joints of the sensor; the last one moves the first link behind it.
        host: index of the arm's joint that moves the sensor, -1 for one below the arm.
        transfer: (10, 10) inertial parameters in the sensor's frame per parameter in the frame of the host.
    """

    model: pin.Model
    moved: tuple[int, ...]
    axes: tuple[int, ...]
    host: int
    transfer: np.ndarray

    @property
    def tool(self) -> int:
        """Index in `model` of the link behind the sensor."""
        return self.axes[-1]

    @property
    def parents(self) -> tuple[int, ...]:
        """Index of each joint's neighbour towards the base."""
        return parent_joints(self.model)

    def behind(self, joint: int) -> bool:
        """Whether the sensor carries a joint of the arm."""
        at = self.moved[joint]
        while at > self.tool:
            at = self.parents[at]
        return at == self.tool

    def motion(self, motion: Motion) -> Motion:
        """The motion of all joints of `model`, for that of the arm."""
        columns = {"q": motion.q, "v": motion.v, "a": motion.a, "direction": motion.direction}
        return Motion(motion.time, **{name: self.embedded(values) for name, values in columns.items()})

    def embedded(self, values: np.ndarray) -> np.ndarray:
        """(..., n) values of all joints of `model`, zero for those of the sensor, for (..., nj) ones of the arm."""
        found = np.zeros((*values.shape[:-1], self.model.nv))
        found[..., self.moved] = values
        return found

    def poses(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(n, 3, 3) orientations and (n, 3) positions, m, of the sensor in the base's frame, at (n, nj) positions."""
        data, rotation, place = self.model.createData(), np.empty((len(q), 3, 3)), np.empty((len(q), 3))
        for i, row in enumerate(self.embedded(q)):
            pin.forwardKinematics(self.model, data, row)
            rotation[i], place[i] = data.oMi[self.tool + 1].rotation, data.oMi[self.tool + 1].translation
        return rotation, place


@cached_with_first_argument
def cut_at_sensor(arm: Arm, sensor: WrenchSensor) -> CutArm:
    """Cut an arm at a sensor.

    Raises:
        InputError: no joint of the description carries the sensor's link.
    """
    root = ET.fromstring(arm.robot.urdf_xml)
    joints = {child.get("link"): joint for joint in root.findall("joint") if (child := joint.find("child")) is not None}
    if sensor.link not in joints:
        raise UnknownNameError("link", sensor.link, [str(link) for link in joints])
    child = joints[sensor.link].find("child")
    assert child is not None
    names = tuple(f"{sensor.name} {axis}" for axis in WRENCH_AXES)
    links = [f"{sensor.name} cut {i}" for i in range(len(names) + 2)]
    child.set("link", links[0])
    for link in links:
        ET.SubElement(root, "link", name=link)
    _add_joint(root, f"{sensor.name} frame", links[:2], sensor.placement)
    for i, name in enumerate(names):  # against the axes: the torque of a joint is what it does to the tool
        axis = " ".join(str(-1 if k == i % len("xyz") else 0) for k in range(len("xyz")))
        _add_joint(
            root, name, links[i + 1 : i + 3], None, axis, "prismatic" if name.split()[-1][0] == "f" else "revolute"
        )
    _add_joint(root, f"{sensor.name} link", [links[-1], sensor.link], sensor.placement.inverse())
    full = pin.buildModelFromXML(ET.tostring(root, encoding="unicode"))
    kept = {*arm.joints, *names}
    locked = [i for i in range(1, full.njoints) if full.names[i] not in kept]
    model = pin.buildReducedModel(full, locked, pin.neutral(full))
    model.gravity, model.armature = arm.model.gravity, np.zeros(model.nv)
    index = {name: i for i, name in enumerate(list(model.names)[1:])}
    moved, axes = (tuple(index[name] for name in those) for those in (arm.joints, names))
    parent = parent_joints(model)[axes[0]]
    data = model.createData()
    pin.forwardKinematics(model, data, pin.neutral(model))
    to_sensor = data.oMi[axes[-1] + 1].actInv(data.oMi[parent + 1]).homogeneous
    units = np.eye(INERTIAL_PARAMETERS_PER_BODY)
    transfer = [inertial_parameters_of(to_sensor @ pseudo_inertia(unit) @ to_sensor.T) for unit in units]
    return CutArm(model, moved, axes, moved.index(parent) if parent >= 0 else -1, np.column_stack(transfer))


def _add_joint(
    root: ET.Element, name: str, links: list[str], placement: pin.SE3 | None, axis: str = "", kind: str = "fixed"
) -> None:
    joint = ET.SubElement(root, "joint", name=name, type=kind)
    for tag, link in zip(("parent", "child"), links, strict=True):
        ET.SubElement(joint, tag, link=link)
    if placement is not None:
        places = {"xyz": placement.translation, "rpy": pin.rpy.matrixToRpy(placement.rotation)}
        ET.SubElement(joint, "origin", {key: " ".join(map(repr, map(float, x))) for key, x in places.items()})
    if axis:
        ET.SubElement(joint, "axis", xyz=axis)
        ET.SubElement(joint, "limit", lower="-1", upper="1", effort="1", velocity="1")
