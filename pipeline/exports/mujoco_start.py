"""Where an arm in MuJoCo begins: the keyframe of an exported file, and any other posture.

MuJoCo's keyframes hold no commands that were given before the start, and `mj_resetData` takes them as 0. So the arm of
the keyframe stands at 0 and is told 0. For every other start the commands before it must be given, else each delayed
drive pulls towards 0 until its delay is over.
"""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING
from xml.etree import ElementTree as ET

import numpy as np

from armdyn.arm.closed_loop.play import play_sides
from armdyn.arm.model import ArmModel
from armdyn.errors import InputError
from pipeline.exports.mujoco_drives import drive_delay
from pipeline.exports.parts import ExportedJointDynamics
from urdf.write import xml_number_list

if TYPE_CHECKING:
    import mujoco

START = "start"
"""Name of the keyframe."""
START_COMMENT = """ mujoco.mj_resetDataKeyframe(model, data, 0) begins at rest at 0. To begin at another posture, set
qpos and ctrl, then give the delayed drives their earlier commands, which mj_resetData takes as 0:
for i in range(model.nu):
    if n := model.actuator_history[i, 0]:
        mujoco.mj_initCtrlHistory(model, data, i, None, numpy.full(n, data.ctrl[i]))
or call pipeline.exports.mujoco_start.begin(model, data, positions). """


def play_joint(joint: str) -> str:
    """Name of the second joint that an exported joint with play has; it lies between the drive and the link."""
    return f"{joint}_play"


def add_start(root: ET.Element, model: ArmModel, parts: Sequence[ExportedJointDynamics]) -> None:
    """Add the keyframe of an arm with servos: drives at 0, or as near as their range allows, told to stay there.

    A delayed drive whose range is away from 0 has the range as limit of its commands, also of those before the start.
    """
    if not model.servo_joints:
        return
    arm = model.arm.model
    q = np.clip(np.zeros(len(parts)), arm.lowerPositionLimit, arm.upperPositionLimit)
    sides = play_sides(model, model.theta(), (q[None], 0.0 * q[None], 0.0 * q[None]))[0]
    at, told = dict[str, float](), dict[str, float]()
    actuators = {one.get("name"): one for one in root.iter("general")}
    for j, joint in enumerate(parts):
        at[joint.name], at[play_joint(joint.name)] = q[j], -joint.play * sides[j]
        servo = model.servo(joint.name)
        told[joint.name] = q[j] if servo is not None and servo.control.holds_position else 0.0
        if told[joint.name] and drive_delay(model, joint.name):
            span = np.array([arm.lowerPositionLimit[j], arm.upperPositionLimit[j]])
            actuators[joint.name].set("ctrlrange", xml_number_list(span))
    joints = [str(one.get("name")) for body in root.findall("worldbody") for one in body.iter("joint")]
    key = {"qpos": [at[name] for name in joints], "ctrl": [told[joint.name] for joint in parts]}
    frame = ET.SubElement(root, "keyframe")
    ET.SubElement(frame, "key", {"name": START} | {k: xml_number_list(np.array(part)) for k, part in key.items()})
    if any(drive_delay(model, joint.name) for joint in parts):
        root.insert(0, ET.Comment(START_COMMENT))


def begin(
    simulation: "mujoco.MjModel",
    data: "mujoco.MjData",
    positions: Mapping[str, float],
    velocities: Mapping[str, float] | None = None,
    commands: Mapping[str, float] | None = None,
) -> None:
    """Put an exported arm at the start of a motion; a link with play hangs at the end to which its weight pushes it.

    Args:
        simulation: the compiled file.
        data: its state, which is reset.
        positions: positions of links by joint, rad or m; joints that are not named begin at 0.
        velocities: their velocities, rad/s or m/s; 0 where not named.
        commands: what the drives are told at the start and were told before; where not named, position servos were told
            the start, others 0.

    Raises:
        InputError: a joint or a drive is not in the file; the message lists those that are.
    """
    import mujoco

    mujoco.mj_resetData(simulation, data)
    joints = {simulation.joint(i).name: i for i in range(simulation.njnt)}
    drives = {simulation.actuator(i).name: i for i in range(simulation.nu)}
    for kind, given, known in (
        ("joint", {**positions, **(velocities or {})}, joints),
        ("drive", commands or {}, drives),
    ):
        if unknown := sorted(set(given) - set(known)):
            raise InputError(f"no {kind} is called {', '.join(unknown)}: the file has {', '.join(known)}")
    for values, state in ((positions, data.qpos), (velocities or {}, data.qvel)):
        for name, value in values.items():
            state[joints[name]] = value  # each joint is one coordinate
    mujoco.mj_forward(simulation, data)
    for name, drive in joints.items():
        if (gap := joints.get(play_joint(name))) is not None:
            behind = simulation.jnt_range[gap, 1] * np.sign(data.qfrc_bias[gap])
            data.qpos[drive] += behind
            data.qpos[gap] = -behind
    for name, i in drives.items():
        follows = simulation.actuator_biasprm[i, 1] != 0.0
        data.ctrl[i] = (commands or {}).get(name, positions.get(name, 0.0) if follows else 0.0)
        if count := int(simulation.actuator_history[i, 0]):
            mujoco.mj_initCtrlHistory(simulation, data, i, None, np.full(count, data.ctrl[i]))
    mujoco.mj_forward(simulation, data)
