"""How a trial went, section by section: what was learnt, the load cell against the model, gripper, joints and nodes."""

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

import numpy as np
import plotly.graph_objects as go

from armdyn.channels import FloatArray
from armdyn.document import Chart, Section, Table
from pipeline.nodes.scheduler import Timing
from pipeline.report.theme import (
    ACTUAL,
    GREY,
    INK,
    LIMIT,
    LINKED_TIME,
    MEASURED,
    MODEL,
    ORANGE,
    REFERENCE,
    TIME_AXIS,
    TRUTH,
    Span,
    add_band,
    number,
    percent,
    stacked,
)


@dataclass(frozen=True)
class EstimateTrace:
    """A parameter learnt during the trial.

    Attributes:
        name: such as ``"length"``.
        unit: SI unit.
        time: (k,) [s], when each estimate was made.
        value: (k,) in `unit`.
        std: (k,) standard deviation that the estimator gave, in `unit`.
        guess: where it started.
        truth: None where nobody knows it.
    """

    name: str
    unit: str
    time: FloatArray
    value: FloatArray
    std: FloatArray
    guess: float
    truth: float | None = None


@dataclass(frozen=True)
class ForceTrace:
    """The load cell against the model with the final estimate.

    Attributes:
        time: (n,) [s].
        measured: (n,) [N].
        predicted: (n,) [N]; nan where the model was not run.
        noise: standard deviation of the load cell [N]; None where unknown.
        residual_is_white: None where not tested; False means that intervals do not hold.
    """

    time: FloatArray
    measured: FloatArray
    predicted: FloatArray
    noise: float | None = None
    residual_is_white: bool | None = None


def estimate_section(
    estimates: Sequence[EstimateTrace], phases: Sequence[Span] = (), residual_is_white: bool | None = None
) -> Section:
    """Each estimated parameter over time, with its interval and the truth.

    Args:
        estimates: at least one; the sentence tells the first.
        phases: of the trial.
        residual_is_white: False where the intervals do not hold.
    """
    charts = [Chart(_figure(trace, phases), _caption(trace)) for trace in estimates if trace.value.size]
    return Section("Estimate", _learnt(estimates[0], residual_is_white), charts)


def _learnt(trace: EstimateTrace, residual_is_white: bool | None) -> str:
    """The last estimate, its error in standard deviations, and whether the interval can be trusted."""
    if not trace.value.size:
        return f"No estimate of the {trace.name} was made; the guess was {number(trace.guess, trace.unit)}."
    learnt = f"{trace.value[-1]:.4f} {trace.unit} ± {number(trace.std[-1], trace.unit, 2)}"
    text = (
        f"The {trace.name} was learnt as {learnt} "
        f"after {trace.value.size} updates from a guess of {number(trace.guess, trace.unit)}"
    )
    if trace.truth is not None:
        text += f"; it is {trace.truth:.4f} {trace.unit}"
    if residual_is_white is False:
        text += ". The residual of the force is not white: the interval is too narrow and does not hold"
    return text + "."


def _caption(trace: EstimateTrace) -> str:
    below = "standard deviation reported" + (" and error made" if trace.truth is not None else "")
    return f"Above: {trace.name} with two standard deviations. Below, on a logarithmic scale: {below}."


def _figure(trace: EstimateTrace, phases: Sequence[Span]) -> go.Figure:
    scale, small = (1e3, f"m{trace.unit}") if trace.unit in ("m", "s", "N") else (1.0, trace.unit)
    figure = stacked([f"{trace.name} [{trace.unit}]", f"error [{small}]"], [0.6, 0.4], phases, 460)
    add_band(figure, trace.time, trace.value, 2 * trace.std, "± 2 std")
    figure.add_scatter(x=trace.time, y=trace.value, name="estimate", **{**MODEL, "mode": "lines+markers"})
    ends = np.array([trace.time[0], trace.time[-1]])
    figure.add_scatter(
        x=ends, y=[trace.guess] * 2, name="guess", mode="lines", line={"color": ORANGE, "width": 1.5, "dash": "dash"}
    )
    figure.add_scatter(x=trace.time, y=scale * trace.std, name="std", yaxis="y2", mode="lines", line={"color": GREY})
    if trace.truth is not None:
        figure.add_scatter(x=ends, y=[trace.truth] * 2, name="truth", **TRUTH)
        figure.add_scatter(
            x=trace.time,
            y=scale * np.abs(trace.value - trace.truth),
            name="|error|",
            yaxis="y2",
            mode="markers",
            marker={"color": INK, "size": 6, "symbol": "diamond"},
        )
    # The first intervals are wide; the axis follows the estimates instead.
    shown = [*trace.value, trace.guess, *([] if trace.truth is None else [trace.truth])]
    low, high = min(shown), max(shown)
    pad = 0.25 * (high - low) or 0.1 * abs(high) or 1.0
    figure.update_layout(yaxis={"range": [low - pad, high + pad]}, yaxis2={"type": "log", "dtick": 1})
    return figure


WHITENESS = {
    None: "",
    True: "; what is left is white",
    False: "; what is left is not white: something is missing",
}


def force_section(force: ForceTrace, phases: Sequence[Span] = ()) -> Section:
    """Force measured and predicted, and what is left between them, against the noise."""
    residual = force.measured - force.predicted
    sentence = "The model was not run against the load cell."
    if np.isfinite(residual).any():
        rms = float(np.sqrt(np.nanmean(residual**2)))
        sentence = f"With the final estimate the model misses the measured tension by {number(rms, 'N')} rms"
        if force.noise is not None:
            sentence += f", {rms / force.noise:.2f} times the sensor's noise of {number(force.noise, 'N')}"
        sentence += WHITENESS[force.residual_is_white] + "."
    figure = stacked(["tension [N]", "residual [mN]"], [0.62, 0.38], phases, 440)
    figure.add_scatter(x=force.time, y=force.measured, name="measured", **MEASURED)
    figure.add_scatter(x=force.time, y=force.predicted, name="predicted", **MODEL)
    caption = "Residual: measured minus predicted."
    if force.noise is not None:
        band = np.full(force.time.shape, 2e3 * force.noise)
        add_band(figure, force.time, 0 * band, band, "± 2 std of the noise", axis="y2")
        caption += " A right model leaves 95 % of the points in the band."
    figure.add_scatter(x=force.time, y=1e3 * residual, yaxis="y2", name="residual", showlegend=False, **MEASURED)
    return Section("Load cell", sentence, [Chart(figure, caption)])


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
        tables=[Table.of(["node", "rate", "steps", "mean", "longest", "overruns"], rows)],
    )
