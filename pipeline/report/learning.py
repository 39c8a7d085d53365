"""What a trial learnt: the estimate over time, and the load cell against the model."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import plotly.graph_objects as go

from armdyn.channels import FloatArray
from pipeline.report.page import Chart, Section
from pipeline.report.theme import GREY, INK, MEASURED, MODEL, ORANGE, TRUTH, Span, add_band, number, stacked


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
