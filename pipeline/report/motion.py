"""How gripper, joints and nodes did in a trial."""

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from typing import ClassVar

import numpy as np
import plotly.graph_objects as go

from armdyn.channels import FloatArray
from pipeline.nodes.scheduler import Timing
from pipeline.report.page import Chart, Section, Table
from pipeline.report.theme import ACTUAL, LIMIT, LINKED_TIME, REFERENCE, TIME_AXIS, Span, number, percent, stacked


@dataclass(frozen=True)
class GripperTrace:
    """The string's upper end along the line.

    Attributes:
        time: (n,) [s].
        reference: (n,) [m], what was commanded.
        actual: (n,) [m], what was measured.
    """

    time: FloatArray
    reference: FloatArray
    actual: FloatArray


@dataclass(frozen=True)
class JointTrace:
    """Joints against their limits.

    Attributes:
        names: (j,).
        time: (n,) [s].
        position: (n, j) [rad].
        velocity: (n, j) [rad/s].
        lower, upper: (j,) [rad].
        speed: (j,) [rad/s], largest in both directions.
    """

    names: tuple[str, ...]
    time: FloatArray
    position: FloatArray
    velocity: FloatArray
    lower: FloatArray
    upper: FloatArray
    speed: FloatArray


@dataclass(frozen=True)
class GripperSection(Section):
    """Reference and actual position of the gripper, and the error."""

    title: ClassVar[str] = "Gripper"

    gripper: GripperTrace
    phases: Sequence[Span] = ()

    def sentence(self) -> str:
        """Mean and largest error along the line."""
        error = self.gripper.actual - self.gripper.reference
        if not np.isfinite(error).any():
            return "The gripper did not move."
        worst = int(np.nanargmax(np.abs(error)))
        rms = float(np.sqrt(np.nanmean(error**2)))
        return (
            f"The gripper follows its reference to {number(rms, 'm', 2)} rms; the largest error is "
            f"{number(abs(error[worst]), 'm', 2)} at {self.gripper.time[worst]:.2f} s."
        )

    def charts(self) -> Sequence[Chart]:
        """Position over error."""
        gripper = self.gripper
        figure = stacked(["along the line [m]", "error [mm]"], [0.62, 0.38], self.phases, 420)
        figure.add_scatter(x=gripper.time, y=gripper.actual, name="actual", **ACTUAL)
        figure.add_scatter(x=gripper.time, y=gripper.reference, name="reference", **REFERENCE)
        error = 1e3 * (gripper.actual - gripper.reference)
        figure.add_scatter(x=gripper.time, y=error, yaxis="y2", name="error", showlegend=False, **ACTUAL)
        return [Chart(figure, "Error: actual minus reference, the lag of the arm included.")]


_COLUMNS = 2
_ROW_HEIGHT = 118  # px
_GAP = 0.42  # between two rows, in panels


@dataclass(frozen=True)
class PositionSection(Section):
    """Position of every joint in its range."""

    title: ClassVar[str] = "Joint positions"

    joints: JointTrace

    def sentence(self) -> str:
        """The joint that came closest to the end of its range."""
        middle, half = (self.joints.upper + self.joints.lower) / 2, (self.joints.upper - self.joints.lower) / 2
        used = np.abs(self.joints.position - middle).max(axis=0) / half
        return _closest(self.joints.names, used, "of the way from the middle of its range to its end")

    def charts(self) -> Sequence[Chart]:
        """Small multiples."""
        joints = self.joints
        figure = _small_multiples(joints, joints.position, joints.lower, joints.upper, "rad")
        return [Chart(figure, "Dashed: limits.")]


@dataclass(frozen=True)
class VelocitySection(Section):
    """Velocity of every joint within its limit."""

    title: ClassVar[str] = "Joint velocities"

    joints: JointTrace

    def sentence(self) -> str:
        """The joint that came closest to its speed limit."""
        used = np.abs(self.joints.velocity).max(axis=0) / self.joints.speed
        return _closest(self.joints.names, used, "of its speed limit")

    def charts(self) -> Sequence[Chart]:
        """Small multiples."""
        joints = self.joints
        figure = _small_multiples(joints, joints.velocity, -joints.speed, joints.speed, "rad/s")
        return [Chart(figure, "Dashed: limits.")]


def _closest(names: Sequence[str], used: FloatArray, what: str) -> str:
    worst = int(np.argmax(used))
    if used[worst] > 1.0:
        return f"{names[worst]} goes beyond its limit: {percent(used[worst])} {what}."
    return f"Every joint stays within its limits; {names[worst]} comes closest, {percent(used[worst])} {what}."


def _small_multiples(
    joints: JointTrace, value: FloatArray, lower: FloatArray, upper: FloatArray, unit: str
) -> go.Figure:
    """One panel per joint: `value` (n, j) between `lower` and `upper` (j,)."""
    rows = -(-len(joints.names) // _COLUMNS)
    height = 92 + rows * _ROW_HEIGHT
    panel = 1 / (rows + _GAP * (rows - 1))
    layout: dict[str, object] = {
        "height": height,
        "meta": LINKED_TIME,
        "showlegend": False,
        "hovermode": "x",
        "margin": {"t": 34},
    }
    figure = go.Figure()
    titles = []
    for i, name in enumerate(joints.names):
        suffix = str(i + 1) if i else ""
        row, column = divmod(i, _COLUMNS)
        left, right = column / _COLUMNS + 0.05 * column, (column + 1) / _COLUMNS - 0.05 * (1 - column)
        top = 1 - row * panel * (1 + _GAP)
        bottom = max(0.0, top - panel)
        last = i + _COLUMNS >= len(joints.names)
        pad = 0.12 * (upper[i] - lower[i])
        layout[f"xaxis{suffix}"] = {
            "domain": [left, right],
            "anchor": f"y{suffix}",
            "title": {"text": TIME_AXIS if last else ""},
            "showticklabels": last,
            **({"matches": "x"} if i else {}),
        }
        layout[f"yaxis{suffix}"] = {
            "domain": [bottom, top],
            "anchor": f"x{suffix}",
            "title": {"text": f"[{unit}]"},
            "range": [lower[i] - pad, upper[i] + pad],
            "nticks": 5,
        }
        label = {"text": f"<b>{escape(name)}</b>", "x": left, "y": top, "xref": "paper", "yref": "paper"}
        titles.append({**label, "xanchor": "left", "yanchor": "bottom"})
        axes = {"xaxis": f"x{suffix}", "yaxis": f"y{suffix}"}
        figure.add_scatter(x=joints.time, y=value[:, i], name=escape(name), **axes, **ACTUAL)
        for bound in (lower[i], upper[i]):
            ends = joints.time[[0, -1]]
            figure.add_scatter(x=ends, y=[bound, bound], name="limit", hoverinfo="skip", **axes, **LIMIT)
    figure.update_layout(**layout, annotations=titles)
    return figure


@dataclass(frozen=True)
class TimingSection(Section):
    """Computing time of every node."""

    title: ClassVar[str] = "Computing time"

    nodes: Sequence[Timing]

    def sentence(self) -> str:
        """Whether a step took longer than its period."""
        late = [node for node in self.nodes if node.overruns]
        if not late:
            return "Every node finished its steps in time."
        names = ", ".join(f"{node.name} {node.overruns} of {node.steps} times" for node in late)
        return f"Some steps took longer than their period: {names}."

    def tables(self) -> Sequence[Table]:
        """A row per node."""
        rows = [
            [
                node.name,
                "once" if node.period is None else f"{1 / node.period:.4g} Hz",
                str(node.steps),
                number(node.mean, "s", 2),
                number(node.longest, "s", 2),
                str(node.overruns),
            ]
            for node in self.nodes
        ]
        return [Table(["node", "rate", "steps", "mean", "longest", "overruns"], rows)]
