"""How gripper, joints and nodes did in a trial."""

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

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


def gripper_section(gripper: GripperTrace, phases: Sequence[Span] = ()) -> Section:
    """Reference and actual position of the gripper, and the error: its mean and its largest value."""
    error = gripper.actual - gripper.reference
    sentence = "The gripper did not move."
    if np.isfinite(error).any():
        worst = int(np.nanargmax(np.abs(error)))
        rms = float(np.sqrt(np.nanmean(error**2)))
        sentence = (
            f"The gripper follows its reference to {number(rms, 'm', 2)} rms; the largest error is "
            f"{number(abs(error[worst]), 'm', 2)} at {gripper.time[worst]:.2f} s."
        )
    figure = stacked(["along the line [m]", "error [mm]"], [0.62, 0.38], phases, 420)
    figure.add_scatter(x=gripper.time, y=gripper.actual, name="actual", **ACTUAL)
    figure.add_scatter(x=gripper.time, y=gripper.reference, name="reference", **REFERENCE)
    figure.add_scatter(x=gripper.time, y=1e3 * error, yaxis="y2", name="error", showlegend=False, **ACTUAL)
    return Section("Gripper", sentence, [Chart(figure, "Error: actual minus reference, the lag of the arm included.")])


_COLUMNS = 2
_ROW_HEIGHT = 118  # px
_GAP = 0.42  # between two rows, in panels


def position_section(joints: JointTrace) -> Section:
    """Position of every joint in its range, and the joint that came closest to its end."""
    middle, half = (joints.upper + joints.lower) / 2, (joints.upper - joints.lower) / 2
    used = np.abs(joints.position - middle).max(axis=0) / half
    sentence = _closest(joints.names, used, "of the way from the middle of its range to its end")
    figure = _small_multiples(joints, joints.position, joints.lower, joints.upper, "rad")
    return Section("Joint positions", sentence, [Chart(figure, "Dashed: limits.")])


def velocity_section(joints: JointTrace) -> Section:
    """Velocity of every joint within its limit, and the joint that came closest to it."""
    used = np.abs(joints.velocity).max(axis=0) / joints.speed
    figure = _small_multiples(joints, joints.velocity, -joints.speed, joints.speed, "rad/s")
    sentence = _closest(joints.names, used, "of its speed limit")
    return Section("Joint velocities", sentence, [Chart(figure, "Dashed: limits.")])


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


def timing_section(nodes: Sequence[Timing]) -> Section:
    """Computing time of every node, and whether a step took longer than its period."""
    late = ", ".join(f"{node.name} {node.overruns} of {node.steps} times" for node in nodes if node.overruns)
    rows = [
        [
            node.name,
            "once" if node.period is None else f"{1 / node.period:.4g} Hz",
            str(node.steps),
            number(node.mean, "s", 2),
            number(node.longest, "s", 2),
            str(node.overruns),
        ]
        for node in nodes
    ]
    return Section(
        "Computing time",
        f"Some steps took longer than their period: {late}." if late else "Every node finished its steps in time.",
        tables=[Table(["node", "rate", "steps", "mean", "longest", "overruns"], rows)],
    )
