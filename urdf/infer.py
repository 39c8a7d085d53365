"""Choose the settings of a robot that has no settings file: its arm, its tool and a home posture."""

import math
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pinocchio as pin

from urdf.gripper import gripper_joints
from urdf.library_output import library_errors
from urdf.robot import Array, UrdfError
from urdf.settings import ArmSettings, LimitSettings, RobotSettings, ToolSettings, UrdfSettings
from urdf.validate import MOVING_JOINT_TYPES, joint_link, mimicked_joints

ASSUMED_SECONDS_TO_FULL_SPEED = 0.1
"""Assumed time in which a joint reaches its full speed from rest, at its largest acceleration [s]."""
ASSUMED_SECONDS_TO_FULL_ACCELERATION = 0.02
"""Assumed time in which a joint's acceleration rises from zero to its largest value [s]."""
ASSUMED_LIMITS_EXPLANATION = (
    "No settings file gives them: an assumption, that each joint reaches its full speed in 0.1 s and its full "
    "acceleration in 20 ms."
)
HOME_POSTURE_CANDIDATES = 2000
"""Number of random postures among which the home posture is chosen."""
GRIPPER_NAME_PARTS = ("gripper", "finger", "knuckle", "thumb", "jaw", "claw")
"""Parts of names in a recording that mark a gripper's joint; in a URDF, `urdf.gripper` finds these by their mass."""


def infer_settings(
    root: ET.Element, path: Path, joints: tuple[str, ...] | None, tool: str | None
) -> tuple[RobotSettings, tuple[str, ...]]:
    """Choose the arm and the tool of a robot in a URDF, where they are not given.

    The arm is the chain from the root with the most moving joints, without those of a gripper; its tool is the last
    link that moves with it and carries no further joint.

    Args:
        root: root element of the URDF.
        path: the URDF's file, for messages.
        joints: names of the arm's joints from base to tool; None to choose them.
        tool: name of the tool's link; None to choose it.

    Returns:
        The settings, without home posture and limits, and a sentence per choice that was made.

    Raises:
        UrdfError: a given joint does not exist, does not move or mimics another joint.
    """
    moving = {
        str(joint.get("name")): joint
        for joint in root.findall("joint")
        if joint.get("type") in MOVING_JOINT_TYPES and joint.find("mimic") is None
    }
    chains = _chains(root)
    said: list[str] = []
    if joints is None:
        with library_errors(f"{path}: Pinocchio cannot read it", "correct it"):
            grippers = gripper_joints(root)
        counted = [[name for name in chain if name in moving and name not in grippers] for chain, _ in chains]
        longest = max(counted, key=len)
        joints = tuple(longest)
        if len({tuple(names) for names in counted if len(names) == len(longest)}) > 1 or len(longest) < len(
            moving.keys() - grippers
        ):
            said.append(f"the arm was taken to be {', '.join(joints)}; --joints names others")
    for name in joints:
        if name not in moving:
            leader = mimicked_joints(root).get(name)
            what = f"joint '{name}' copies '{leader}'" if leader else f"there is no moving joint '{name}'"
            raise UrdfError(f"{path}: {what}; choose among {', '.join(moving)}")
    if tool is None:
        tool = _tool(root, chains, joints)
        said.append(f"the tool was taken to be at link '{tool}'; --tool names another link")
    settings = RobotSettings(
        name=path.name,
        urdf=UrdfSettings(str(path)),
        arm=ArmSettings(joints, home=()),
        tool=ToolSettings(tool, (0.0, 0.0, 0.0)),
        limits=LimitSettings((), (), ASSUMED_LIMITS_EXPLANATION),
    )
    return settings, tuple(said)


def is_gripper_name(name: str) -> bool:
    """Whether a joint's or link's name contains a usual word for a part of a gripper, such as "finger"."""
    return any(part in name.lower() for part in GRIPPER_NAME_PARTS)


def choose_home(model: pin.Model, tool_frame: int) -> Array:
    """Choose a home posture (n,) [rad or m] far from joint limits and singularities, the best of many random ones.

    The best one has the largest product of the Jacobian's smallest singular value and the smallest relative distance
    to a joint limit. `tool_frame` is the index of the tool's frame in the model.
    """
    lower, upper = np.array(model.lowerPositionLimit), np.array(model.upperPositionLimit)
    lower, upper = np.maximum(lower, -math.pi), np.minimum(upper, math.pi)
    data, rng = model.createData(), np.random.default_rng(0)
    best, best_score = (lower + upper) / 2, -1.0
    for q in rng.uniform(
        lower + 0.1 * (upper - lower), upper - 0.1 * (upper - lower), (HOME_POSTURE_CANDIDATES, model.nq)
    ):
        jacobian = pin.computeFrameJacobian(model, data, q, tool_frame, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
        jacobian = jacobian.reshape(6, model.nv)  # Pinocchio removes the second axis for a single joint
        # The smallest singular value that counts: an arm with few joints has as many singular values as joints.
        singular = float(np.linalg.svd(jacobian, compute_uv=False)[min(6, model.nv) - 1])
        margin = float(np.min(np.minimum(q - lower, upper - q) / (upper - lower)))
        if singular * margin > best_score:
            best, best_score = q, singular * margin
    return np.asarray(best, dtype=np.float64)


def _chains(root: ET.Element) -> list[tuple[list[str], list[str]]]:
    """Joint names and link names from the root to every leaf, in the order of the file."""
    parent_of = {joint_link(joint, "child"): joint for joint in root.findall("joint")}
    parents = {joint_link(joint, "parent") for joint in root.findall("joint")}
    chains = []
    for link in (str(link.get("name")) for link in root.findall("link")):
        if link in parents:
            continue
        joints, links = [], [link]
        while links[-1] in parent_of:
            joint = parent_of[links[-1]]
            joints.append(str(joint.get("name")))
            links.append(joint_link(joint, "parent"))
        chains.append((joints[::-1], links[::-1]))
    return chains


def _tool(root: ET.Element, chains: list[tuple[list[str], list[str]]], joints: tuple[str, ...]) -> str:
    """The last link that is fixed to the link which the arm's last joint moves."""
    moving = {joint.get("name") for joint in root.findall("joint") if joint.get("type") in MOVING_JOINT_TYPES}
    best: list[str] = []
    for chain, links in chains:
        if joints[-1] not in chain:
            continue
        start = chain.index(joints[-1])
        end = next((i for i in range(start + 1, len(chain)) if chain[i] in moving), len(chain))
        # links[i + 1] is the link that chain[i] carries.
        if end - start > len(best):
            best = links[start + 1 : end + 1]
    if best:
        return best[-1]
    return next(joint_link(joint, "child") for joint in root.findall("joint") if joint.get("name") == joints[-1])
