"""Find joints of a description that are not part of the arm but move in recordings, such as a lift below the arm.

Their recorded motion moves the rigid bodies, so that weight and inertia of the moved bodies are in the right place.
"""

from collections.abc import Sequence
from dataclasses import replace
from xml.etree import ElementTree as ET

import numpy as np
import pinocchio as pin

import urdf
from armdyn.arm.arm import Arm
from armdyn.run import Run

MIN_JOINT_DISTANCE_FROM_ZERO = 1e-3
"""Least distance of a joint's position from zero, rad or m, at which the joint counts as one that moves."""
MIN_JOINT_WEIGHT_CHANGE_SHARE = 3e-4
"""Least change of the weight on a joint by the motion of another one, as a share of the largest weight. A Panda's
fingers that open and close change 1.3e-4, its last joint, which turns a hand almost about its own axis, 5.8e-4."""
WEIGHT_COMPARISON_POSTURES = 20
"""Number of postures of a recording at which weights are compared."""


def with_joints_moving_as_recorded(arm: Arm, runs: Sequence[Run]) -> Arm:
    """The arm with other joints that change its torques; they move as all runs recorded."""
    wanted = [
        joint
        for joint in moving_joints_outside_arm_model(arm, runs)
        if all(f"q.{joint}" in run.channels for run in runs)
    ]
    if not wanted:
        return arm
    full = pin.buildModelFromXML(arm.robot.urdf_xml)
    joints = [name for name in full.names if name in {*arm.joints, *wanted}]
    try:
        robot = urdf.load(str(arm.file or arm.robot.name), joints=joints, tool=arm.robot.tool_frame, meshes=False)
    except urdf.UrdfError:
        return arm
    return replace(arm, robot=robot, carried=arm.carried | set(wanted))


def moving_joints_outside_arm_model(arm: Arm, runs: Sequence[Run]) -> list[str]:
    """Names of joints that are not part of the arm's model but change its torques in a recording."""
    if not any(joint not in arm.joints for run in runs for joint in run.joints):
        return []
    full = pin.buildModelFromXML(arm.robot.urdf_xml)
    others = [
        joint
        for joint in range(1, full.njoints)
        if full.names[joint] not in arm.joints and full.joints[joint].nv == 1 and full.joints[joint].nq == 1
    ]
    moving = [joint for joint in others if any(_away(run, full, joint) for run in runs)]
    own = [full.getJointId(name) for name in arm.driven]
    below = [joint for joint in moving if any(joint in list(full.supports[i])[1:] for i in own)]
    return [full.names[j] for j in moving if j in below or any(_matters(full, arm, j, run) for run in runs)]


def movable_joints(arm: Arm) -> tuple[str, ...]:
    """Names of all movable joints in an arm's description, including those that mimic others."""
    root = ET.fromstring(arm.robot.urdf_xml)
    return tuple(str(joint.get("name")) for joint in root.findall("joint") if joint.get("type") != "fixed")


def _away(run: Run, full: pin.Model, joint: int) -> bool:
    channel = run.channels.get(f"q.{full.names[joint]}")
    slides = "P" in full.joints[joint].shortname().removeprefix("JointModel")
    if channel is None or (channel.unit == "m") != slides:
        return False
    return bool(np.quantile(np.abs(channel.value), 0.99) > MIN_JOINT_DISTANCE_FROM_ZERO)


def _matters(full: pin.Model, arm: Arm, joint: int, run: Run) -> bool:
    """Whether the weight on the arm's joints depends on the position of a joint outside the arm."""
    channels = {i: run.channels.get(f"q.{full.names[i]}") for i in range(1, full.njoints)}
    given = {i: c for i, c in channels.items() if c is not None and full.joints[i].nq == 1}
    if joint not in given:
        return False
    time = np.linspace(given[joint].time[0], given[joint].time[-1], WEIGHT_COMPARISON_POSTURES)
    data, change, largest = full.createData(), 0.0, float(np.finfo(float).tiny)
    own = [full.joints[full.getJointId(name)].idx_v for name in arm.driven]
    for t in time:
        q = pin.neutral(full)
        for i, channel in given.items():
            q[full.joints[i].idx_q] = np.interp(t, channel.time, channel.value)
        as_recorded = pin.computeGeneralizedGravity(full, data, q)[own]
        q[full.joints[joint].idx_q] = pin.neutral(full)[full.joints[joint].idx_q]
        change = max(change, float(np.abs(as_recorded - pin.computeGeneralizedGravity(full, data, q)[own]).max()))
        largest = max(largest, float(np.abs(as_recorded).max()))
    return bool(change > MIN_JOINT_WEIGHT_CHANGE_SHARE * largest)
