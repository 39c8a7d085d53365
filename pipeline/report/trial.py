"""Sections of a trial's report: swing, length estimate, load cell against model, gripper and computing times."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import plotly.graph_objects as go

from armdyn.document import Chart, Section, Table
from armdyn.recording.channels import FloatArray
from pipeline.box import Box
from pipeline.nodes.learning import LengthEstimate
from pipeline.nodes.scheduler import Timing
from pipeline.report.theme import (
    ACTUAL,
    BLUE,
    FAINT,
    GREY,
    INK,
    MEASURED,
    MODEL,
    ORANGE,
    REFERENCE,
    TRUTH,
    Phases,
    add_band,
    number,
    stacked,
)

STRING_SNAPSHOTS = 9
"""Positions of the string that are drawn."""


class SwingTrace(NamedTuple):
    """Gripper and load in the vertical plane of the line during the swing.

    Attributes:
        time: (n,) [s].
        gripper_x: (n,) [m] along the line.
        load_x: (n,) [m] along the line.
        load_z: (n,) [m] over the line, negative below.
    """

    time: FloatArray
    gripper_x: FloatArray
    load_x: FloatArray
    load_z: FloatArray


def swing_section(planned: SwingTrace, executed: SwingTrace | None, box: Box | None, radius: float) -> Section:
    """Section on the swing: paths of gripper and load to scale, with snapshots of the string.

    Args:
        planned: swing from the optimiser.
        executed: swing that was observed; None where it was not observed.
        box: the box; None for a trial without one.
        radius: radius of the load [m].
    """
    shown = executed or planned
    figure = go.Figure(layout={"height": 520, "hovermode": "closest"})
    times = np.linspace(shown.time[0], shown.time[-1], STRING_SNAPSHOTS)
    gripper, x, z = (np.interp(times, shown.time, path) for path in shown[1:])
    ends = np.full((2, STRING_SNAPSHOTS, 3), np.nan)  # the two ends of each string, then a gap in the curve
    ends[:, :, :2] = [np.column_stack([gripper, x]), np.column_stack([0 * z, z])]
    thin = {"color": GREY, "width": 1}
    figure.add_scatter(x=ends[0].ravel(), y=ends[1].ravel(), name="string", mode="lines", line=thin, hoverinfo="skip")
    for i in range(STRING_SNAPSHOTS):
        disc = {"x0": x[i] - radius, "x1": x[i] + radius, "y0": z[i] - radius, "y1": z[i] + radius}
        opacity = 0.25 + 0.6 * i / (STRING_SNAPSHOTS - 1)
        figure.add_shape(type="circle", **disc, line=thin, fillcolor=BLUE, opacity=opacity, layer="below")
    if box is not None:
        near, far = box.near_wall, box.near_wall + box.width
        rim, floor = -box.rim, -box.rim - box.height
        figure.add_scatter(
            x=[near, near, far, far], y=[rim, floor, floor, rim], name="box", mode="lines",
            line={"color": INK, "width": 4}, fill="toself", fillcolor=FAINT,
        )  # fmt: skip
    rail = {"color": INK, "width": 3}
    figure.add_scatter(x=shown.gripper_x, y=0 * shown.gripper_x, name="gripper", mode="lines", line=rail)
    if executed is not None:
        figure.add_scatter(x=executed.load_x, y=executed.load_z, name="load, executed", **ACTUAL)
    figure.add_scatter(x=planned.load_x, y=planned.load_z, name="load, planned", **REFERENCE)
    figure.update_xaxes(title_text="along the line [m]")
    figure.update_yaxes(title_text="height over the line [m]", scaleanchor="x")
    kind = "executed" if executed is not None else "planned"
    caption = f"To scale. Thin lines: the string at {STRING_SNAPSHOTS} equally spaced times, {kind}."
    return Section("Swing", _missed(planned, executed), [Chart(figure, caption)])


def _missed(planned: SwingTrace, executed: SwingTrace | None) -> str:
    if executed is None:
        return "The swing was planned and not executed."
    end = float(planned.time[-1])
    if executed.time[-1] < end:
        return f"The swing was stopped after {executed.time[-1] - executed.time[0]:.2f} s, before the plan's end."
    across = float(np.interp(end, executed.time, executed.load_x) - planned.load_x[-1])
    up = float(np.interp(end, executed.time, executed.load_z) - planned.load_z[-1])
    return (
        f"Where the plan ends the load was {number(float(np.hypot(across, up)), 'm', 2)} from its planned place "
        f"({number(across, 'm', 2)} along the line, {number(up, 'm', 2)} up)."
    )


def estimate_section(
    estimates: Sequence[LengthEstimate], guess: float, truth: float | None, phases: Phases = ()
) -> Section:
    """Section on the learnt length of the string over time, with its confidence interval and the true length.

    Args:
        estimates: every update of the estimator, at least one.
        guess: length at the start [m].
        truth: true length [m]; None where it is unknown.
        phases: of the trial.
    """
    time, value, std = np.array([(e.time, e.value, e.std) for e in estimates]).T
    text = f"The length was learnt as {value[-1]:.4f} m ± {number(std[-1], 'm', 2)} "
    text += f"after {len(time)} updates from a guess of {number(guess, 'm')}"
    text += "." if truth is None else f"; it is {truth:.4f} m."
    figure = stacked({"length [m]": 0.6, "error [mm]": 0.4}, 460, phases)
    add_band(figure, time, value, 2 * std, "± 2 std")
    figure.add_scatter(x=time, y=value, name="estimate", **{**MODEL, "mode": "lines+markers"})
    dashed = {"color": ORANGE, "width": 1.5, "dash": "dash"}
    figure.add_scatter(x=time[[0, -1]], y=[guess] * 2, name="guess", mode="lines", line=dashed)
    figure.add_scatter(x=time, y=1e3 * std, name="std", yaxis="y2", mode="lines", line={"color": GREY})
    if truth is not None:
        figure.add_scatter(x=time[[0, -1]], y=[truth] * 2, name="truth", **TRUTH)
        diamonds = {"color": INK, "size": 6, "symbol": "diamond"}
        error = 1e3 * np.abs(value - truth)
        figure.add_scatter(x=time, y=error, name="|error|", yaxis="y2", mode="markers", marker=diamonds)
    # The first intervals are wide; the axis follows the estimates instead.
    shown = [*value, guess, *([] if truth is None else [truth])]
    pad = 0.25 * (max(shown) - min(shown)) or 0.1 * max(shown)
    figure.update_layout(yaxis={"range": [min(shown) - pad, max(shown) + pad]}, yaxis2={"type": "log", "dtick": 1})
    below = "standard deviation reported" + (" and error made" if truth is not None else "")
    caption = f"Above: length with two standard deviations. Below, on a logarithmic scale: {below}."
    return Section("Estimate", text, [Chart(figure, caption)])


def force_section(
    time: FloatArray, measured: FloatArray, predicted: FloatArray, noise: float, phases: Phases = ()
) -> Section:
    """Section on measured and predicted force, and on the residual between them, compared with the noise.

    Args:
        time: (n,) [s].
        measured: (n,) measured force [N].
        predicted: (n,) force of the model with the final estimate [N]; nan where the model was not run.
        noise: standard deviation of the load cell [N].
        phases: of the trial.
    """
    residual = measured - predicted
    sentence = "The model was not run against the load cell."
    if np.isfinite(residual).any():
        rms = float(np.sqrt(np.nanmean(residual**2)))
        sentence = (
            f"With the final estimate the model misses the measured tension by {number(rms, 'N')} rms, "
            f"{rms / noise:.2f} times the sensor's noise of {number(noise, 'N')}."
        )
    figure = stacked({"tension [N]": 0.62, "residual [mN]": 0.38}, 440, phases)
    figure.add_scatter(x=time, y=measured, name="measured", **MEASURED)
    figure.add_scatter(x=time, y=predicted, name="predicted", **MODEL)
    add_band(figure, time, 0 * time, np.full(time.shape, 2e3 * noise), "± 2 std of the noise", axis="y2")
    figure.add_scatter(x=time, y=1e3 * residual, yaxis="y2", name="residual", showlegend=False, **MEASURED)
    caption = "Residual: measured minus predicted. A right model leaves 95 % of the points in the band."
    return Section("Load cell", sentence, [Chart(figure, caption)])


def gripper_section(time: FloatArray, reference: FloatArray, actual: FloatArray, phases: Phases = ()) -> Section:
    """Section on the gripper: (n,) reference and actual position along the line [m], and the error between them."""
    error = actual - reference
    sentence = "The gripper did not move."
    if np.isfinite(error).any():
        worst = int(np.nanargmax(np.abs(error)))
        sentence = (
            f"The gripper follows its reference to {number(float(np.sqrt(np.nanmean(error**2))), 'm', 2)} rms; the "
            f"largest error is {number(abs(error[worst]), 'm', 2)} at {time[worst]:.2f} s."
        )
    figure = stacked({"along the line [m]": 0.62, "error [mm]": 0.38}, 420, phases)
    figure.add_scatter(x=time, y=actual, name="actual", **ACTUAL)
    figure.add_scatter(x=time, y=reference, name="reference", **REFERENCE)
    figure.add_scatter(x=time, y=1e3 * error, yaxis="y2", name="error", showlegend=False, **ACTUAL)
    return Section("Gripper", sentence, [Chart(figure, "Error: actual minus reference, the lag of the arm included.")])


def timing_section(nodes: Sequence[Timing]) -> Section:
    """Section on the computing time of every node, and on steps that took longer than their period."""
    late = ", ".join(f"{node.name} {node.overruns} of {node.steps} times" for node in nodes if node.overruns)
    rows = [
        [
            node.name, "once" if node.period is None else f"{1 / node.period:.4g} Hz", str(node.steps),
            number(node.mean, "s", 2), number(node.longest, "s", 2), str(node.overruns),
        ]
        for node in nodes
    ]  # fmt: skip
    return Section(
        "Computing time",
        f"Some steps took longer than their period: {late}." if late else "Every node finished its steps in time.",
        tables=[Table.of(["node", "rate", "steps", "mean", "longest", "overruns"], rows)],
    )
