"""Sections of a trial's report: swing, length estimate, load cell against model, gripper and computing times."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import plotly.graph_objects as go

from armdyn.document import Chart, Section, Table
from armdyn.recording.channels import FloatArray
from pipeline.box import Box
from pipeline.nodes.learning import LengthEstimate
from pipeline.nodes.scheduler import NodeTiming
from pipeline.report.theme import (
    ACTUAL_STYLE,
    BLUE,
    FAINT_FILL,
    GREY,
    MEASURED_STYLE,
    MODEL_STYLE,
    ORANGE,
    REFERENCE_STYLE,
    TEXT_COLOUR,
    TRUTH_STYLE,
    NamedIntervals,
    add_band,
    number_text,
    stacked_figure,
)

STRING_SNAPSHOTS = 9
"""Number of instants at which the string is drawn in the figure of a swing."""


class SwingTrace(NamedTuple):
    """Motion of gripper and load during a swing, in the vertical plane that contains the gripper's line.

    Attributes:
        time: times of the samples (n,) [s].
        gripper_x: position of the gripper along the line (n,) [m].
        load_x: position of the load along the line (n,) [m].
        load_z: height of the load over the line, negative below it (n,) [m].
    """

    time: FloatArray
    gripper_x: FloatArray
    load_x: FloatArray
    load_z: FloatArray


def swing_section(planned: SwingTrace, executed: SwingTrace | None, box: Box | None, radius: float) -> Section:
    """Section on the swing: paths of gripper and load, drawn to scale, and the string at a few instants.

    Args:
        planned: swing from the optimiser.
        executed: swing that was observed; None where it was not observed.
        box: box in which the load should come to rest; None for a trial without a box.
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
            line={"color": TEXT_COLOUR, "width": 4}, fill="toself", fillcolor=FAINT_FILL,
        )  # fmt: skip
    rail = {"color": TEXT_COLOUR, "width": 3}
    figure.add_scatter(x=shown.gripper_x, y=0 * shown.gripper_x, name="gripper", mode="lines", line=rail)
    if executed is not None:
        figure.add_scatter(x=executed.load_x, y=executed.load_z, name="load, executed", **ACTUAL_STYLE)
    figure.add_scatter(x=planned.load_x, y=planned.load_z, name="load, planned", **REFERENCE_STYLE)
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
        f"Where the plan ends the load was {number_text(float(np.hypot(across, up)), 'm', 2)} from its planned place "
        f"({number_text(across, 'm', 2)} along the line, {number_text(up, 'm', 2)} up)."
    )


def estimate_section(
    estimates: Sequence[LengthEstimate], guess: float, truth: float | None, phases: NamedIntervals = ()
) -> Section:
    """Section on the estimated length of the string over time, with its confidence interval and the true length.

    Args:
        estimates: every update of the estimator, at least one.
        guess: length at the start [m].
        truth: true length [m]; None where it is unknown.
        phases: phases of the trial.
    """
    time, value, std = np.array([(e.time, e.value, e.std) for e in estimates]).T
    text = f"The length was learnt as {value[-1]:.4f} m ± {number_text(std[-1], 'm', 2)} "
    text += f"after {len(time)} updates from a guess of {number_text(guess, 'm')}"
    text += "." if truth is None else f"; it is {truth:.4f} m."
    figure = stacked_figure({"length [m]": 0.6, "error [mm]": 0.4}, 460, phases)
    add_band(figure, time, value, 2 * std, "± 2 std")
    figure.add_scatter(x=time, y=value, name="estimate", **{**MODEL_STYLE, "mode": "lines+markers"})
    dashed = {"color": ORANGE, "width": 1.5, "dash": "dash"}
    figure.add_scatter(x=time[[0, -1]], y=[guess] * 2, name="guess", mode="lines", line=dashed)
    figure.add_scatter(x=time, y=1e3 * std, name="std", yaxis="y2", mode="lines", line={"color": GREY})
    if truth is not None:
        figure.add_scatter(x=time[[0, -1]], y=[truth] * 2, name="truth", **TRUTH_STYLE)
        diamonds = {"color": TEXT_COLOUR, "size": 6, "symbol": "diamond"}
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
    time: FloatArray, measured: FloatArray, predicted: FloatArray, noise: float, phases: NamedIntervals = ()
) -> Section:
    """Section on measured and predicted force of the load cell, and on the residual compared with the noise.

    Args:
        time: times of the samples (n,) [s].
        measured: measured force (n,) [N].
        predicted: force of the model with the final estimate (n,) [N]; nan where the model was not simulated.
        noise: standard deviation of the load cell's noise [N].
        phases: phases of the trial.
    """
    residual = measured - predicted
    sentence = "The model was not run against the load cell."
    if np.isfinite(residual).any():
        rms = float(np.sqrt(np.nanmean(residual**2)))
        sentence = (
            f"With the final estimate the model misses the measured tension by {number_text(rms, 'N')} rms, "
            f"{rms / noise:.2f} times the sensor's noise of {number_text(noise, 'N')}."
        )
    figure = stacked_figure({"tension [N]": 0.62, "residual [mN]": 0.38}, 440, phases)
    figure.add_scatter(x=time, y=measured, name="measured", **MEASURED_STYLE)
    figure.add_scatter(x=time, y=predicted, name="predicted", **MODEL_STYLE)
    add_band(figure, time, 0 * time, np.full(time.shape, 2e3 * noise), "± 2 std of the noise", axis="y2")
    figure.add_scatter(x=time, y=1e3 * residual, yaxis="y2", name="residual", showlegend=False, **MEASURED_STYLE)
    caption = "Residual: measured minus predicted. A right model leaves 95 % of the points in the band."
    return Section("Load cell", sentence, [Chart(figure, caption)])


def gripper_section(
    time: FloatArray, reference: FloatArray, actual: FloatArray, phases: NamedIntervals = ()
) -> Section:
    """Section on how well the gripper followed its reference.

    Args:
        time: times of the samples (n,) [s].
        reference: commanded position along the line (n,) [m].
        actual: measured position along the line (n,) [m].
        phases: phases of the trial.
    """
    error = actual - reference
    sentence = "The gripper did not move."
    if np.isfinite(error).any():
        worst = int(np.nanargmax(np.abs(error)))
        sentence = (
            f"The gripper follows its reference to {number_text(float(np.sqrt(np.nanmean(error**2))), 'm', 2)} rms; "
            f"the largest error is {number_text(abs(error[worst]), 'm', 2)} at {time[worst]:.2f} s."
        )
    figure = stacked_figure({"along the line [m]": 0.62, "error [mm]": 0.38}, 420, phases)
    figure.add_scatter(x=time, y=actual, name="actual", **ACTUAL_STYLE)
    figure.add_scatter(x=time, y=reference, name="reference", **REFERENCE_STYLE)
    figure.add_scatter(x=time, y=1e3 * error, yaxis="y2", name="error", showlegend=False, **ACTUAL_STYLE)
    return Section("Gripper", sentence, [Chart(figure, "Error: actual minus reference, the lag of the arm included.")])


def timing_section(nodes: Sequence[NodeTiming]) -> Section:
    """Section on the computing time of each periodic task (node), and on steps that took longer than their period."""
    late = ", ".join(f"{node.name} {node.overruns} of {node.steps} times" for node in nodes if node.overruns)
    rows = [
        [
            node.name, "once" if node.period is None else f"{1 / node.period:.4g} Hz", str(node.steps),
            number_text(node.mean, "s", 2), number_text(node.longest, "s", 2), str(node.overruns),
        ]
        for node in nodes
    ]  # fmt: skip
    return Section(
        "Computing time",
        f"Some steps took longer than their period: {late}." if late else "Every node finished its steps in time.",
        tables=[Table.of(["node", "rate", "steps", "mean", "longest", "overruns"], rows)],
    )
