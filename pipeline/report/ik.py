"""Report of an IK table: is the path usable, how fast, and what limits it."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import plotly.graph_objects as go

from ik import LinePath, PathTable
from pipeline.report.page import Chart, KeyFigure, Level, Report, Section, Table
from pipeline.report.theme import LIMIT, MODEL, REFERENCE
from urdf import Robot

PATH_AXIS = "path coordinate s [m]"
TIGHT = 0.1  # rad to a joint limit below which a table is called tight


def core_of(table: PathTable) -> tuple[float, float]:
    """The stretch on which speed matters most: a line's core, all of another path."""
    return table.path.line.core if isinstance(table.path, LinePath) else (table.path.s_min, table.path.s_max)


def ik_report(table: PathTable, robot: Robot | None, command: str = "") -> Report:
    """The report of a table.

    Args:
        table: what was built.
        robot: whose table it is, for the defects of its description; None leaves them out.
        command: how to make this report again.
    """
    low, high = core_of(table)
    core = float(table.speed_limit_at(np.linspace(low, high, 1001)).min())
    overloaded, helped = table.torque_share.max(axis=0)
    tight = table.joint_margin < TIGHT or overloaded > 1.0
    sections: list[Section] = [Speed(table), Joints(table), Margins(table), Torque(table), Dexterity(table)]
    return Report(
        title=f"IK table of {table.robot_name}",
        level=Level.CAUTION if tight else Level.GOOD,
        verdict=f"{table.s[-1] - table.s[0]:.2f} m of {table.path.describe()['kind']}, {core:.2f} m/s in its core, "
        f"every joint at least {table.joint_margin:.2f} rad from its limits, "
        f"holding still takes up to {100 * overloaded:.0f} % of a torque limit.",
        subtitle=f"{len(table.s)} nodes from s = {table.s[0]:g} to {table.s[-1]:g} m",
        key_figures=[
            KeyFigure("core speed", f"{core:.3f} m/s", f"s = {low:g} to {high:g} m"),
            KeyFigure("joint margin", f"{table.joint_margin:.3f} rad"),
            KeyFigure("acceleration", f"{table.acceleration_limit.min():.1f} m/s²", "joints, at full speed, least"),
            KeyFigure("torque at rest", f"{100 * overloaded:.0f} %", f"{100 * helped:.0f} % with springs"),
        ],
        sections=sections,
        notes=() if robot is None else robot.defects,
        command=command,
    )


def _shares(joints: np.ndarray, names: Sequence[str]) -> str:
    counted = sorted(((np.mean(joints == joint), name) for joint, name in enumerate(names)), reverse=True)
    return ", ".join(f"{name} on {100 * share:.0f} %" for share, name in counted if share)


@dataclass(frozen=True)
class Speed(Section):
    """How fast the tool may move."""

    title: ClassVar[str] = "Speed and acceleration"
    table: PathTable

    def sentence(self) -> str:
        """Which joint limits the speed where."""
        slowest = np.abs(self.table.dq_ds / self.table.velocity_limits).argmax(axis=1)
        return f"Of the path, the speed is limited by {_shares(slowest, self.table.joint_names)}."

    def charts(self) -> Sequence[Chart]:
        """Limits along the path."""
        table = self.table
        speed = go.Figure(layout={"xaxis_title": PATH_AXIS, "yaxis_title": "speed limit [m/s]"})
        speed.add_scatter(x=table.s, y=table.speed_limit, name="speed", **MODEL)
        acceleration = go.Figure(layout={"xaxis_title": PATH_AXIS, "yaxis_title": "acceleration [m/s²]"})
        for name, values in (("at rest", table.acceleration_limit_at(table.s, 0.0 * table.s)), ("at full speed", None)):
            limit = table.acceleration_limit if values is None else values
            acceleration.add_scatter(x=table.s, y=limit, name=f"joints, {name}", mode="lines")
        for springs in (False, True) if table.torque.springs.any() else (False,):
            name = "torque, at rest, with springs" if springs else "torque, at rest"
            low, high = table.torque_acceleration_range(table.s, 0.0, springs)
            acceleration.add_scatter(
                x=table.s, y=np.minimum(-low, high), name=name, **(REFERENCE if springs else LIMIT)
            )
        return [
            Chart(speed),
            Chart(
                acceleration,
                "What the joints' acceleration limits allow, and what their torques allow in the weaker direction; "
                "negative where the torque does not even hold the arm.",
            ),
        ]


@dataclass(frozen=True)
class Joints(Section):
    """Where the joints are."""

    title: ClassVar[str] = "Joint positions"
    table: PathTable

    def charts(self) -> Sequence[Chart]:
        """Positions, as they are and as shares of their range."""
        table = self.table
        plain = go.Figure(layout={"xaxis_title": PATH_AXIS, "yaxis_title": "joint position [rad]"})
        figure = go.Figure(layout={"xaxis_title": PATH_AXIS, "yaxis_title": "share of the range [-1, 1]"})
        middle, half = (table.lower + table.upper) / 2, (table.upper - table.lower) / 2
        for joint, name in enumerate(table.joint_names):
            plain.add_scatter(x=table.s, y=table.q[:, joint], name=name, mode="lines")
            share = (table.q[:, joint] - middle[joint]) / half[joint]
            figure.add_scatter(x=table.s, y=share, name=name, mode="lines")
        for bound in (-1.0, 1.0):
            figure.add_scatter(x=table.s[[0, -1]], y=[bound, bound], showlegend=False, **LIMIT)
        return [Chart(plain), Chart(figure, "One smooth branch; the dashed lines are the position limits.")]

    def tables(self) -> Sequence[Table]:
        """Extremes per joint."""
        table = self.table
        margin = table.margin.min(axis=0)
        rows = [
            [
                name,
                f"{table.q[:, joint].min():.3f}",
                f"{table.q[:, joint].max():.3f}",
                f"{margin[joint]:.3f}",
                f"{np.abs(table.dq_ds[:, joint]).max():.2f}",
            ]
            for joint, name in enumerate(table.joint_names)
        ]
        return [Table(["joint", "lowest [rad]", "highest [rad]", "margin [rad]", "largest |dq/ds| [rad/m]"], rows)]


@dataclass(frozen=True)
class Margins(Section):
    """How far the joints are from their limits."""

    title: ClassVar[str] = "Joint margins"
    table: PathTable

    def sentence(self) -> str:
        """Which joint is closest where."""
        return f"Closest to its limit is {_shares(self.table.margin.argmin(axis=1), self.table.joint_names)}."

    def charts(self) -> Sequence[Chart]:
        """Distance to the nearer limit."""
        figure = go.Figure(layout={"xaxis_title": PATH_AXIS, "yaxis_title": "distance to the limit [rad]"})
        for joint, name in enumerate(self.table.joint_names):
            figure.add_scatter(x=self.table.s, y=self.table.margin[:, joint], name=name, mode="lines")
        figure.add_scatter(x=self.table.s[[0, -1]], y=[0.0, 0.0], showlegend=False, **LIMIT)
        return [Chart(figure)]


@dataclass(frozen=True)
class Torque(Section):
    """What it takes to hold the arm."""

    title: ClassVar[str] = "Torque at rest"
    table: PathTable

    def sentence(self) -> str:
        """What the springs change."""
        helped = np.flatnonzero(self.table.torque.springs.any(axis=0))
        if not len(helped):
            return "Gravity alone, as a share of each joint's limit."
        joints = ", ".join(self.table.joint_names[joint] for joint in helped)
        return f"Gravity as a share of each joint's limit; the real robot has springs on {joints}, shown dashed."

    def charts(self) -> Sequence[Chart]:
        """Static torque along the path."""
        table = self.table
        figure = go.Figure(layout={"xaxis_title": PATH_AXIS, "yaxis_title": "share of the torque limit"})
        for joint, name in enumerate(table.joint_names):
            share = table.torque.gravity[:, joint] / table.effort_limits[joint]
            figure.add_scatter(x=table.s, y=share, name=name, mode="lines")
        for helped in np.flatnonzero(table.torque.springs.any(axis=0)):
            joint = int(helped)
            share = (table.torque.gravity + table.torque.springs)[:, joint] / table.effort_limits[joint]
            figure.add_scatter(x=table.s, y=share, name=f"{table.joint_names[joint]} with its springs", **REFERENCE)
        for bound in (-1.0, 1.0):
            figure.add_scatter(x=table.s[[0, -1]], y=[bound, bound], showlegend=False, **LIMIT)
        return [Chart(figure)]


@dataclass(frozen=True)
class Dexterity(Section):
    """How far the arm is from a singularity."""

    title: ClassVar[str] = "Manipulability"
    table: PathTable

    def charts(self) -> Sequence[Chart]:
        """Yoshikawa's measure, separately for shifting and turning the tool, as their units differ."""
        figure = go.Figure(layout={"xaxis_title": PATH_AXIS, "yaxis_title": "sqrt det(J Jᵀ)"})
        for column, name, style in ((0, "linear [m³/rad³]", MODEL), (1, "angular [1]", REFERENCE)):
            figure.add_scatter(x=self.table.s, y=self.table.manipulability[:, column], name=name, **style)
        return [Chart(figure, "Yoshikawa 1985; zero at a singularity.")]
