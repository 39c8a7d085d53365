"""Build the table of postures of a robot along a path."""

from collections.abc import Callable
from contextlib import suppress
from pathlib import Path as File
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

from armdyn.cache import cache_directory, entry_name
from armdyn.errors import InputError
from ik.errors import UnreachableError
from ik.misses import find_misses
from ik.path import Path
from ik.plan import Planner
from ik.table import LineTable, PathTable
from ik.tablefile import TABLE_FORMAT
from ik.torque import JointTorque
from urdf import CollisionModel, Line, Robot

TABLE_SPACING = 0.0005  # m between nodes: fourth-order differences of the nodes then agree with q' to 1e-9
SURVEYED_TARGETS = 86  # targets looked at when a path cannot be followed
Progress = Callable[[str], None]


def build_line_table(robot: Robot, line: Line | None = None, progress: Progress | None = None) -> LineTable:
    """Plan the branch along a line, the robot's own if none is given, and solve it at every node.

    Raises:
        UnreachableError: a target on the line cannot be reached; the message says which, how far off and why.
        InputError: the arm has too few joints to hold a tool.
    """
    return LineTable(**_content(robot, line or robot.line, progress))


def build_path_table(robot: Robot, path: Path, progress: Progress | None = None) -> PathTable:
    """Plan the branch along any smooth path in SE(3) and solve it at every node.

    Raises:
        UnreachableError: a target on the path cannot be reached; the message says which, how far off and why.
        InputError: the arm has too few joints to hold a tool.
    """
    return PathTable(**_content(robot, path, progress))


def _content(robot: Robot, path: Path, progress: Progress | None) -> dict[str, Any]:
    """All fields of a table, by name."""
    say = progress or (lambda _: None)
    say("planning the branch")
    collisions = CollisionModel(robot)
    planner = Planner(robot, path, collisions)
    try:
        branch, guess = planner.plan()
    except UnreachableError as error:
        raise UnreachableError(_why_not(robot, path, collisions, str(error))) from error
    say("solving the nodes")
    s = np.linspace(path.s_min, path.s_max, max(8, round((path.s_max - path.s_min) / TABLE_SPACING)) + 1)
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
        "torque": JointTorque(robot, springs=True).along(q, rate, bending),
        "fingerprint": robot.fingerprint,
    }


def _why_not(robot: Robot, path: Path, collisions: CollisionModel, planned: str) -> str:
    """The reason why a path cannot be followed: targets that cannot be held, or the reason of the planner."""
    misses = find_misses(robot, path, np.linspace(path.s_min, path.s_max, SURVEYED_TARGETS), collisions)
    if misses:
        return (
            f"robot '{robot.name}': {len(misses)} of {SURVEYED_TARGETS} targets on the path cannot be held; "
            f"{misses[0].sentence}; move or shorten the path"
        )
    return (
        f"robot '{robot.name}': every target on the path can be held, but not on one smooth course: {planned}; "
        "move or shorten the path, or choose another home posture"
    )


def default_path(robot: Robot) -> File:
    """Path of the file in which the table of a robot's own line is cached."""
    return cache_directory() / f"{entry_name(robot.name)}-{robot.fingerprint[:16]}-{TABLE_FORMAT}.npz"


def default_table(robot: Robot, progress: Progress | None = None) -> LineTable:
    """The table of a robot's own line; it is built once, cached, and built again when the robot or the code changed.

    `progress` is called with a text on the progress.
    """
    path = default_path(robot)
    try:
        return LineTable.load(path, robot)
    except InputError:
        table = build_line_table(robot, progress=progress)
        with suppress(InputError):  # a cache that cannot be written to costs time, not the answer
            table.save(path)
        return table
