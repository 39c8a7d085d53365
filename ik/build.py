"""Build the table of a robot's postures (joint positions) along a path of its tool."""

from collections.abc import Callable
from contextlib import suppress
from pathlib import Path as File
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

from armdyn.cache import cache_directory, entry_name
from armdyn.errors import InputError
from ik.errors import UnreachableError
from ik.path import Path
from ik.plan import BranchPlanner
from ik.table import LineTable, PathTable
from ik.table_archive import TABLE_FORMAT_VERSION
from ik.torque import JointTorque
from ik.unreachable_targets import find_unreachable_targets
from urdf import CollisionModel, Line, Robot

TABLE_NODE_SPACING_METRES = 0.0005
"""Distance between the nodes of an IK table along the path [m]; fourth-order differences of the nodes then agree with
the derivative to 1e-9."""
FAILED_PATH_CHECKED_TARGETS = 86
"""Number of targets on a path that are checked to find out why the arm cannot follow it."""
Progress = Callable[[str], None]


def build_line_table(robot: Robot, line: Line | None = None, progress: Progress | None = None) -> LineTable:
    """Compute a table of postures along a straight line; by default, the line in the robot's settings.

    `progress` is called with a sentence about each step.

    Raises:
        UnreachableError: the arm cannot follow the line; the message says at which point and why.
        InputError: the arm has too few joints to hold a tool.
    """
    return LineTable(**_content(robot, line or robot.line, progress))


def build_path_table(robot: Robot, path: Path, progress: Progress | None = None) -> PathTable:
    """Compute a table of postures along any smooth path of the tool's position and orientation.

    `progress` is called with a sentence about each step.

    Raises:
        UnreachableError: the arm cannot follow the path; the message says at which point and why.
        InputError: the arm has too few joints to hold a tool.
    """
    return PathTable(**_content(robot, path, progress))


def _content(robot: Robot, path: Path, progress: Progress | None) -> dict[str, Any]:
    """All fields of a table, by name."""
    say = progress or (lambda _: None)
    say("planning the branch")
    collisions = CollisionModel(robot)
    planner = BranchPlanner(robot, path, collisions)
    try:
        branch, guess = planner.plan()
    except UnreachableError as error:
        raise UnreachableError(_why_not(robot, path, collisions, str(error))) from error
    say("solving the nodes")
    s = np.linspace(path.s_min, path.s_max, max(8, round((path.s_max - path.s_min) / TABLE_NODE_SPACING_METRES)) + 1)
    q, _ = branch.solve(planner.chain, path, s, CubicSpline(planner.s, guess)(s))
    rate, bending, jacobian = branch.derivatives(planner.chain, path, s, q)
    return {
        "robot_name": robot.name,
        "joint_names": robot.joint_names,
        "tool_frame": robot.tool_frame,
        "tool_offset": robot.tool_offset,
        "path": path,
        "s": s,
        "q": q,
        "dq_ds": rate,
        "d2q_ds2": bending,
        "jacobian": jacobian,
        "limits": robot.limits,
        "torque": JointTorque(robot, springs=True).path_torque_terms(q, rate, bending),
        "fingerprint": robot.fingerprint,
    }


def _why_not(robot: Robot, path: Path, collisions: CollisionModel, planned: str) -> str:
    """Explain why a path cannot be followed: targets that cannot be reached, or else the planner's reason."""
    misses = find_unreachable_targets(
        robot, path, np.linspace(path.s_min, path.s_max, FAILED_PATH_CHECKED_TARGETS), collisions
    )
    if misses:
        return (
            f"robot '{robot.name}': {len(misses)} of {FAILED_PATH_CHECKED_TARGETS} targets on the path cannot be held; "
            f"{misses[0].sentence}; move or shorten the path"
        )
    return (
        f"robot '{robot.name}': every target on the path can be held, but not on one smooth course: {planned}; "
        "move or shorten the path, or choose another home posture"
    )


def default_table_path(robot: Robot) -> File:
    """Path of the file in which the IK table of the line in a robot's settings is cached."""
    return cache_directory() / f"{entry_name(robot.name)}-{robot.fingerprint[:16]}-{TABLE_FORMAT_VERSION}.npz"


def default_table(robot: Robot, progress: Progress | None = None) -> LineTable:
    """The IK table of the line in a robot's settings, from the cache or built.

    It is built again when the robot, its settings or the file format changed. `progress` is called with a sentence
    about each step.

    Raises:
        UnreachableError: the arm cannot follow the line.
        UrdfError: the settings contain no line.
    """
    path = default_table_path(robot)
    try:
        return LineTable.load(path, robot)
    except InputError:
        table = build_line_table(robot, progress=progress)
        with suppress(InputError):  # a cache that cannot be written to costs time, not the answer
            table.save(path)
        return table
