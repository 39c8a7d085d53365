"""From a robot and its line to the table."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from armdyn.cache import cache_directory
from armdyn.errors import InputError
from ik.chain import Chain
from ik.errors import UnreachableError
from ik.path import LinePath
from ik.plan import plan_branch
from ik.selfmotion import Wish
from ik.table import FORMAT, LineTable
from urdf import Line, Robot

Array = NDArray[np.float64]

SPACING = 0.0005  # m between nodes: fourth-order differences of the nodes then agree with q' to 1e-9
Progress = Callable[[str], None]


def build_line_table(
    robot: Robot, line: Line | None = None, spacing: float = SPACING, progress: Progress | None = None
) -> LineTable:
    """Plan the branch along a line and solve it at every node.

    Args:
        robot: the arm.
        line: where the tool point moves; the robot's own line if not given.
        spacing: distance between nodes [m].
        progress: told what is being done.

    Raises:
        UnreachableError: a target on the line cannot be reached; the message says which, how far off and why.
    """
    line = line or robot.line
    say = progress or (lambda _: None)
    chain, path = Chain.of(robot), LinePath(line)
    say("planning the branch")
    branch, coarse, guess = plan_branch(robot, chain, path, Wish(line.core, line.core_speed))
    say("solving the nodes")
    s = np.linspace(line.s_min, line.s_max, max(8, round((line.s_max - line.s_min) / spacing)) + 1)
    solution = branch.solve(chain, path, s, CubicSpline(coarse, guess)(s))
    margin = robot.limits.margin(solution.q)
    if margin.min() < 0:
        node, joint = np.unravel_index(int(margin.argmin()), margin.shape)
        raise UnreachableError(
            f"robot '{robot.name}': at s = {s[node]:.3f} m joint '{robot.joint_names[joint]}' would be "
            f"{-margin[node, joint]:.3f} rad or m beyond its limit; shorten or move the line"
        )
    rate, bending, jacobian = branch.derivatives(chain, path, s, solution.q)
    return LineTable(
        robot_name=robot.name,
        joint_names=robot.joint_names,
        tool_frame=robot.tool_frame,
        tool_offset=robot.tool_offset,
        s=s,
        q=solution.q,
        dq_ds=rate,
        d2q_ds2=bending,
        jacobian=jacobian,
        velocity_limits=robot.limits.velocity,
        acceleration_limits=robot.limits.acceleration,
        joint_margin=float(margin.min()),
        line=line,
        fingerprint=robot.fingerprint,
    )


def default_path(robot: Robot) -> Path:
    """Where the table of a robot's own line is kept."""
    return cache_directory() / f"{robot.name}-{robot.fingerprint[:16]}-{FORMAT}.npz"


def default_table(robot: Robot, progress: Progress | None = None) -> LineTable:
    """The table of a robot's own line: built once, kept in the user's cache, built again when anything changed.

    Args:
        robot: the arm.
        progress: told what is being done.
    """
    path = default_path(robot)
    try:
        return LineTable.load(path, robot)
    except InputError:
        table = build_line_table(robot, progress=progress)
        table.save(path)
        return table
