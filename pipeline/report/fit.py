"""What every report about a fit shows: measured and predicted, the residual, the parameters."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import plotly.graph_objects as go

from armdyn.identify.compare import Comparison
from armdyn.identify.fit import Fit
from armdyn.identify.localise import Place
from armdyn.identify.problem import Block
from armdyn.identify.study import Study
from armdyn.preparation import of_all_runs, sentence
from armdyn.run import Channel
from pipeline.report.page import Chart, KeyFigure, Level, Report, Section, Table
from pipeline.report.theme import GREY, LIMIT, MEASURED, MODEL, RECORDED, Span, add_band, number, stacked

MOST_POINTS = 3000
"""Per trace; more makes the page heavy and the picture no clearer."""

FEW_POINTS, LARGE = 400, 5
"""Fewer are drawn larger, in px: small dots far apart are overlooked beside a line."""


@dataclass(frozen=True)
class FitSection(Section):
    """Every channel of every run over time."""

    title: ClassVar[str] = "Measured and predicted"

    fit: Fit
    places: Sequence[Place]

    def sentence(self) -> str:
        """What is shaded."""
        shaded = any(place.against == "time" for place in self.places)
        text = "Shaded: where the residual is far above the noise." if shaded else "No stretch of time stands out."
        problem = self.fit.problem
        return f"{text} {sentence(of_all_runs(run.preparations for run in problem.runs))}".strip()

    def charts(self) -> Sequence[Chart]:
        """One figure per channel and run."""
        return [self._chart(block) for block in self.fit.blocks]

    def _chart(self, block: Block) -> Chart:
        run = next(run for run in self.fit.problem.runs if run.name == block.run)
        channel = run.channels[block.channel]
        done = run.preparations.get(block.channel)
        measured = np.interp(block.time, channel.time, channel.value)
        every = slice(None, None, max(1, len(block.time) // MOST_POINTS))
        phases = [
            Span("", place.start, place.end)
            for place in self.places
            if place.against == "time" and place.run == block.run and place.channel == block.channel
        ]
        title = f"{block.channel} [{channel.unit}]"
        figure = stacked([title, f"residual [{channel.unit}]"], [0.6, 0.4], phases, 400)
        shown = channel if done is None else run.recording.channels[block.channel]
        figure.update_layout(xaxis_range=[float(shown.time[0]), float(shown.time[-1])])
        time = block.time[every]
        if done is not None:
            figure.add_scatter(**_thinned(shown), name="as recorded", **RECORDED)
        below = "" if done is None else f", below {done.cutoff:.3g} Hz"
        dots = MEASURED if len(time) > FEW_POINTS else {**MEASURED, "marker": {"color": GREY, "size": LARGE}}
        figure.add_scatter(x=time, y=measured[every], name=f"measured{below}", **dots)
        figure.add_scatter(x=time, y=(measured - block.misfit)[every], name="predicted", **MODEL)
        band = np.full(2, 2 * block.noise)
        ends = block.time[[0, -1]]
        add_band(figure, ends, 0 * band, band, "± 2 std of the noise", axis="y2")
        figure.add_scatter(x=time, y=block.misfit[every], yaxis="y2", showlegend=False, name="residual", **dots)
        rms = float(np.sqrt(np.mean(block.misfit**2)))
        caption = f"{block.run}: residual {number(rms, channel.unit)} rms."
        if done is not None:
            caption += f" {done.samples} samples, {done.rate:.3g} per second, of {done.recorded} recorded."
        return Chart(figure, caption)


def _thinned(channel: Channel) -> dict[str, np.ndarray]:
    """Points of a signal at its full rate; of more than `MOST_POINTS` the extremes of each stretch; they look alike."""
    time, value = channel.time, channel.value
    if len(value) > MOST_POINTS:
        width = 2 * -(-len(value) // MOST_POINTS)
        whole = len(value) // width * width
        stretches = value[:whole].reshape(-1, width)
        extremes = np.sort([stretches.argmin(axis=1), stretches.argmax(axis=1)], axis=0)
        kept = np.append((extremes + width * np.arange(len(stretches))).T.ravel(), len(value) - 1)
        time, value = time[kept], value[kept]
    return {"x": time, "y": value}


@dataclass(frozen=True)
class FormulaSection(FitSection):
    """A formula that is known to be wrong, at the motion and parameters that the right one finds."""

    title: ClassVar[str] = "The wrong formula at the right motion"

    def sentence(self) -> str:
        """Where it fails."""
        ranges = [f"{p.against} {p.start:.3g} to {p.end:.3g} {p.unit}" for p in self.places[:3]]
        return "Nothing is fitted here. It fails most at " + "; ".join(ranges) + "." if ranges else "It does not fail."


BINS = 24
MOST_DOTS = 1500
MOST_CHARTS = 12


@dataclass(frozen=True)
class DependenceSection(Section):
    """One figure per channel and covariate, all runs together, those that matter most first."""

    title: ClassVar[str] = "What the residual depends on"

    fit: Fit

    def sentence(self) -> str:
        """How to read it."""
        return "A line that leaves the band has a cause: a step at zero speed is dry friction, a slope is viscous."

    def charts(self) -> Sequence[Chart]:
        """Residual in units of the noise, and its mean in bins."""
        found = sorted(self._gathered(), key=lambda item: -item[0])[:MOST_CHARTS]
        return [chart for _, chart in found]

    def _gathered(self) -> list[tuple[float, Chart]]:
        problem, points = self.fit.problem, dict[tuple[str, str], list[tuple[np.ndarray, np.ndarray]]]()
        units = {}
        for i, run in enumerate(problem.runs):
            covariates = problem.model.covariates(run, problem.theta(i, self.fit.values))
            for block in (b for b in self.fit.blocks if b.run == run.name):
                for name, channel in covariates.items():
                    if name.startswith(("q.", "v.")) and name[2:] != block.channel.removeprefix("tau."):
                        continue  # a joint's torque is shown against that joint
                    at = np.interp(block.time, channel.time, channel.value)
                    points.setdefault((block.channel, name), []).append((at, block.residual))
                    units[name] = channel.unit
        return [_chart(*key, units[key[1]], parts) for key, parts in points.items()]


def _chart(
    channel: str, against: str, unit: str, parts: Sequence[tuple[np.ndarray, np.ndarray]]
) -> tuple[float, Chart]:
    at, residual = (np.concatenate([part[i] for part in parts]) for i in range(2))
    edges = np.quantile(at, np.linspace(0, 1, BINS + 1))
    place = np.clip(np.searchsorted(edges, at, side="right") - 1, 0, BINS - 1)
    count = np.maximum(np.bincount(place, minlength=BINS), 1)
    mean = np.bincount(place, residual, minlength=BINS) / count
    middle = np.bincount(place, at, minlength=BINS) / count
    every = slice(None, None, max(1, len(at) // MOST_DOTS))
    figure = go.Figure(layout={"height": 280})
    figure.update_xaxes(title_text=f"{against} [{unit}]")
    figure.update_yaxes(title_text=f"{channel} residual / noise")
    figure.add_scatter(x=at[every], y=residual[every], name="samples", opacity=0.4, **MEASURED)
    figure.add_scatter(x=middle, y=mean, name="mean", **MODEL)
    bound = 3 / np.sqrt(count)
    for sign in (-1, 1):
        figure.add_scatter(x=middle, y=sign * bound, name="3 std of the mean", showlegend=sign > 0, **LIMIT)
    return float(np.sum((mean / bound) ** 2)), Chart(figure, f"{channel} against {against}.")


@dataclass(frozen=True)
class ParameterSection(Section):
    """Values with their intervals, or the statement that those do not hold."""

    title: ClassVar[str] = "Parameters"

    comparison: Comparison

    def sentence(self) -> str:
        """Whether the intervals can be trusted."""
        text = self.comparison.how_certain
        if self.comparison.at_bound:
            text += f" On a physical bound, and pulled beyond it: {', '.join(self.comparison.at_bound)}."
        if self.comparison.undetermined:
            text += f" Not determined by these runs: {', '.join(self.comparison.undetermined)}."
        return " ".join([text, *(f"{left_out}." for left_out in self.comparison.left_out)])

    def tables(self) -> Sequence[Table]:
        """Parameters, then channels."""
        c = self.comparison
        parameters = [
            [name, f"{p.value:.6g}", f"{p.std:.2g}" if p.std is not None else "not fitted", p.unit]
            for name, p in c.parameters.items()
        ]
        examined = any(q.exam_rmse is not None for q in c.channels.values())
        channels = [
            [
                name,
                f"{q.noise_std:.3g}",
                f"{q.rmse:.4g}",
                *(
                    f"{error:.4g}" if error is not None else "–"
                    for error in ((q.held_out_rmse, q.exam_rmse) if examined else (q.held_out_rmse,))
                ),
                f"{q.chi2_per_sample:.4g}",
                q.unit,
            ]
            for name, q in c.channels.items()
        ]
        errors = ["rms error", "held out", *(["exam"] if examined else [])]
        return [
            Table(["parameter", "value", "std", "unit"], parameters),
            Table(["channel", "noise", *errors, "χ² per sample", "unit"], channels),
        ]


def comparison_report(study: Study, found: Comparison, command: str = "") -> Report:
    """Measured against predicted, where it fails, on what the residual depends, the parameters."""
    return Report(
        title="Compare: the model against recordings",
        level=Level.GOOD if found.explained else Level.CAUTION,
        verdict=found.sentence,
        sections=[*fit_sections(found), *formula_sections(found)],
        subtitle=runs_of(study),
        key_figures=key_figures(found),
        command=command,
    )


def fit_sections(found: Comparison) -> list[Section]:
    """What every report about a fit shows."""
    return [FitSection(found.fit, found.places), DependenceSection(found.fit), ParameterSection(found)]


def formula_sections(found: Comparison) -> list[Section]:
    """Where a formula that is known to be wrong fails; nothing where the model has none."""
    if found.correction is None:
        return []
    wrong = found.correction.wrong
    return [FormulaSection(wrong, found.correction.places), DependenceSection(wrong)]


def key_figures(found: Comparison) -> list[KeyFigure]:
    """χ² per sample, then the error of the first channels."""
    figures = [KeyFigure("χ² per sample", f"{found.fit.chi2_per_sample:.4g}", "1 is noise")]
    for name, channel in list(found.channels.items())[:4]:
        held_out, exam = channel.held_out_rmse, channel.exam_rmse
        note = f"held out {number(held_out, channel.unit)}" if held_out is not None else "nothing held out"
        note += f", exam {number(exam, channel.unit)}" if exam is not None else ""
        figures.append(KeyFigure(name, number(channel.rmse, channel.unit), note))
    return figures


def runs_of(study: Study) -> str:
    """Which recordings."""
    kinds = {"": study.runs, "; held out: ": study.held_out, "; exam: ": study.exam}
    return "".join(kind + ", ".join(run.name for run in runs) for kind, runs in kinds.items() if runs)
