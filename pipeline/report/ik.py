"""Report of an IK table: is the line usable, how fast, and what limits it."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pinocchio as pin
import plotly.graph_objects as go

from ik import LineTable
from pipeline.report.page import KeyFigure, Level, Report
from pipeline.report.section import Chart, Section, Table
from pipeline.report.theme import LIMIT, MODEL, REFERENCE
from urdf import Robot

LINE_AXIS = "line coordinate s [m]"


def ik_report(table: LineTable, robot: Robot | None, command: str = "") -> Report:
    """The report of a table.

    Args:
        table: what was built.
        robot: whose table it is; without it limits of position and torque are left out.
        command: how to make this report again.
    """
    low, high = table.line.core
    core = float(table.speed_limit_at(np.linspace(low, high, 1001)).min())
    sections: list[Section] = [Speed(table)]
    if robot is not None:
        sections += [Joints(table, robot), Torque(table, robot)]
    sections.append(Dexterity(table))
    return Report(
        title=f"IK table of {table.robot_name}",
        level=Level.GOOD,
        verdict=f"{table.line.s_max - table.line.s_min:.2f} m of line, {core:.2f} m/s in its core, "
        f"every joint at least {table.joint_margin:.2f} rad from its limits.",
        subtitle=f"{len(table.s)} nodes from s = {table.line.s_min:g} to {table.line.s_max:g} m",
        key_figures=[
            KeyFigure("core speed", f"{core:.3f} m/s", f"s = {low:g} to {high:g} m"),
            KeyFigure("joint margin", f"{table.joint_margin:.3f} rad"),
            KeyFigure(
                "acceleration", f"{table.acceleration_limit.min():.1f} m/s²", "at full speed, least along the line"
            ),
        ],
        sections=sections,
        command=command,
    )


@dataclass(frozen=True)
class Speed(Section):
    """How fast the tool may move."""

    title: ClassVar[str] = "Speed and acceleration"
    table: LineTable

    def sentence(self) -> str:
        """Which joint limits the speed where."""
        slowest = np.abs(self.table.dq_ds / self.table.velocity_limits).argmax(axis=1)
        shares = [(np.mean(slowest == joint), name) for joint, name in enumerate(self.table.joint_names)]
        named = ", ".join(f"{name} on {100 * share:.0f} %" for share, name in sorted(shares, reverse=True) if share)
        return f"Of the line, the speed is limited by {named}."

    def charts(self) -> Sequence[Chart]:
        """Limits along the line."""
        figure = go.Figure(layout={"xaxis_title": LINE_AXIS, "yaxis_title": "limit [m/s, m/s²]"})
        figure.add_scatter(x=self.table.s, y=self.table.speed_limit, name="speed [m/s]", **MODEL)
        figure.add_scatter(x=self.table.s, y=self.table.acceleration_limit, name="acceleration [m/s²]", **REFERENCE)
        return [Chart(figure, "Acceleration is what the joints have left when the tool moves at full speed.")]


@dataclass(frozen=True)
class Joints(Section):
    """Where the joints are."""

    title: ClassVar[str] = "Joint positions"
    table: LineTable
    robot: Robot

    def charts(self) -> Sequence[Chart]:
        """Positions as shares of their range."""
        limits = self.robot.limits
        figure = go.Figure(layout={"xaxis_title": LINE_AXIS, "yaxis_title": "share of the range [-1, 1]"})
        middle, half = (limits.lower + limits.upper) / 2, (limits.upper - limits.lower) / 2
        for joint, name in enumerate(self.table.joint_names):
            share = (self.table.q[:, joint] - middle[joint]) / half[joint]
            figure.add_scatter(x=self.table.s, y=share, name=name, mode="lines")
        for bound in (-1.0, 1.0):
            figure.add_scatter(x=self.table.s[[0, -1]], y=[bound, bound], showlegend=False, **LIMIT)
        return [Chart(figure, "One smooth branch; the dashed lines are the position limits.")]

    def tables(self) -> Sequence[Table]:
        """Extremes per joint."""
        margin = self.robot.limits.margin(self.table.q).min(axis=0)
        rows = [
            [
                name,
                f"{self.table.q[:, joint].min():.3f}",
                f"{self.table.q[:, joint].max():.3f}",
                f"{margin[joint]:.3f}",
                f"{np.abs(self.table.dq_ds[:, joint]).max():.2f}",
            ]
            for joint, name in enumerate(self.table.joint_names)
        ]
        return [Table(["joint", "lowest [rad]", "highest [rad]", "margin [rad]", "largest |dq/ds| [rad/m]"], rows)]


@dataclass(frozen=True)
class Torque(Section):
    """What it takes to hold the arm."""

    title: ClassVar[str] = "Torque at rest"
    table: LineTable
    robot: Robot

    def sentence(self) -> str:
        """What the springs change."""
        if not self.robot.springs:
            return "Gravity alone, as a share of each joint's limit."
        joints = ", ".join(spring.joint for spring in self.robot.springs)
        return f"Gravity as a share of each joint's limit; the real robot has springs on {joints}, shown dashed."

    def charts(self) -> Sequence[Chart]:
        """Static torque along the line."""
        data = self.robot.model.createData()
        torque = np.array([pin.computeGeneralizedGravity(self.robot.model, data, q) for q in self.table.q])
        figure = go.Figure(layout={"xaxis_title": LINE_AXIS, "yaxis_title": "share of the torque limit"})
        for joint, name in enumerate(self.table.joint_names):
            figure.add_scatter(
                x=self.table.s, y=torque[:, joint] / self.robot.limits.effort[joint], name=name, mode="lines"
            )
        for spring in self.robot.springs:
            joint = self.table.joint_names.index(spring.joint)
            helped = torque[:, joint] + spring.torque(self.table.q[:, joint])
            share = helped / self.robot.limits.effort[joint]
            figure.add_scatter(x=self.table.s, y=share, name=f"{spring.joint} with its springs", **REFERENCE)
        for bound in (-1.0, 1.0):
            figure.add_scatter(x=self.table.s[[0, -1]], y=[bound, bound], showlegend=False, **LIMIT)
        return [Chart(figure)]


@dataclass(frozen=True)
class Dexterity(Section):
    """How far the arm is from a singularity."""

    title: ClassVar[str] = "Manipulability"
    table: LineTable

    def charts(self) -> Sequence[Chart]:
        """Yoshikawa's measure, separately for shifting and turning the tool, as their units differ."""
        figure = go.Figure(layout={"xaxis_title": LINE_AXIS, "yaxis_title": "sqrt det(J Jᵀ)"})
        for rows, name, style in ((slice(0, 3), "linear [m³/rad³]", MODEL), (slice(3, 6), "angular [1]", REFERENCE)):
            part = self.table.jacobian[:, rows]
            measure = np.sqrt(np.linalg.det(part @ part.transpose(0, 2, 1)))
            figure.add_scatter(x=self.table.s, y=measure, name=name, **style)
        return [Chart(figure, "Yoshikawa 1985; zero at a singularity.")]
