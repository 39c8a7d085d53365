"""Sections about one fit of a model to runs: measured against predicted, where it fails, parameters, the ladder."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import plotly.graph_objects as go

from armdyn.identify.compare import Comparison
from armdyn.identify.diagnose import Suspect
from armdyn.identify.repair import Rung
from armdyn.identify.study import Study
from pipeline.report.section import Chart, Section, Table
from pipeline.report.sections.over_time import add_band, stacked
from pipeline.report.text import number
from pipeline.report.theme import BLUE, GREY, LIMIT, MEASURED, MODEL, ORANGE, VERMILLION

MOST_POINTS = 6000
MOST_CHANNELS = 7


@dataclass(frozen=True)
class Residuals(Section):
    """Measured and predicted over time, with the stretches that fail."""

    title: ClassVar[str] = "Measured against predicted"
    study: Study
    found: Comparison

    def sentence(self) -> str:
        """What is shaded."""
        if self.found.explained:
            return "What is left between measured and predicted is noise."
        return "Shaded: stretches whose residual is far above the noise."

    def charts(self) -> Sequence[Chart]:
        """One figure per run and channel."""
        charts = []
        for block in self.found.fit.blocks[: 2 * MOST_CHANNELS]:
            channel = next(run.channels[block.channel] for run in self.study.runs if run.name == block.run)
            every = max(1, len(block.time) // MOST_POINTS)
            time, misfit = block.time[::every], block.misfit[::every]
            measured = channel.value[::every]
            figure = stacked([f"{block.channel} [{channel.unit}]", f"residual [{channel.unit}]"], [0.6, 0.4], (), 420)
            figure.add_scatter(x=time, y=measured, name="measured", **MEASURED)
            figure.add_scatter(x=time, y=measured - misfit, name="predicted", **MODEL)
            add_band(figure, time, 0 * time, np.full(time.shape, 2 * block.noise), "± 2 std of the noise", axis="y2")
            figure.add_scatter(x=time, y=misfit, yaxis="y2", name="residual", showlegend=False, **MEASURED)
            for place in self.found.places:
                if place.against == "time" and place.run == block.run and place.channel == block.channel:
                    figure.add_shape(
                        type="rect", xref="x", yref="paper", x0=place.start, x1=place.end, y0=0, y1=1,
                        fillcolor=VERMILLION, opacity=0.12, line_width=0, layer="below",
                    )  # fmt: skip
            charts.append(Chart(figure, f"{block.run}: χ² per sample {np.mean(block.residual**2):.3g}."))
        return charts


@dataclass(frozen=True)
class Dependence(Section):
    """The residual against everything that it may depend on."""

    title: ClassVar[str] = "On what the residual depends"
    study: Study
    found: Comparison

    def sentence(self) -> str:
        """The worst place."""
        if not self.found.places:
            return "No range of angle, rate, position or speed stands out."
        worst = self.found.places[0]
        return (
            f"Worst: {worst.channel} where {worst.against} is {worst.start:.3g} to {worst.end:.3g} {worst.unit}, "
            f"χ² per sample {worst.chi2_per_sample:.3g}."
        )

    def charts(self) -> Sequence[Chart]:
        """Mean and spread of the residual in bins, one row per quantity."""
        fit, problem = self.found.fit, self.found.fit.problem
        states = {
            run.name: problem.model.circumstances(run, problem.theta(i, fit.values))
            for i, run in enumerate(problem.runs)
        }
        charts = []
        for channel in list(dict.fromkeys(block.channel for block in fit.blocks))[:MOST_CHANNELS]:
            blocks = [block for block in fit.blocks if block.channel == channel]
            joint = channel.partition(".")[2]
            names = [n for n in states[blocks[0].run] if not joint or n.endswith(f".{joint}")]
            figure = go.Figure(
                layout={"height": 360, "grid": {"rows": 1, "columns": max(1, len(names)), "pattern": "independent"}}
            )
            for k, name in enumerate(names, start=1):
                at = np.concatenate(
                    [np.interp(b.time, states[b.run][name].time, states[b.run][name].value) for b in blocks]
                )
                misfit = np.concatenate([b.misfit for b in blocks])
                every = max(1, len(at) // 3000)
                axes = {"xaxis": f"x{k}" if k > 1 else "x", "yaxis": f"y{k}" if k > 1 else "y"}
                unit = states[blocks[0].run][name].unit
                figure.add_scatter(x=at[::every], y=misfit[::every], showlegend=False, **MEASURED, **axes)
                centre, mean = _binned(at, misfit)
                figure.add_scatter(x=centre, y=mean, name="mean", showlegend=k == 1, **axes,
                                   mode="lines", line={"color": ORANGE, "width": 3})  # fmt: skip
                key = f"xaxis{k if k > 1 else ''}"
                figure.update_layout({key: {"title": {"text": f"{name} [{unit}]"}}})
            unit = self.found.channels[channel].unit
            figure.update_layout({"yaxis": {"title": {"text": f"{channel} residual [{unit}]"}}})
            charts.append(Chart(figure, "A right model leaves the mean at zero everywhere."))
        return charts


@dataclass(frozen=True)
class Evidence(Section):
    """Bars of the candidates."""

    title: ClassVar[str] = "What could be missing"
    suspects: Sequence[Suspect]
    remedies: Sequence[str]

    def sentence(self) -> str:
        """How to read it."""
        text = "Evidence as difference of BIC: above 6 the first is right, within 6 it is a tie."
        return text + (f" To tell them apart: {'; '.join(self.remedies)}." if self.remedies else "")

    def charts(self) -> Sequence[Chart]:
        """Horizontal bars, the best on top, ties in one colour."""
        tied = {self.suspects[0].effect, *self.suspects[0].tied_with}
        figure = go.Figure(layout={"height": 90 + 34 * len(self.suspects)})
        figure.add_bar(
            x=[max(s.delta_bic, 1.0) for s in self.suspects],
            y=[s.effect for s in self.suspects],
            orientation="h",
            marker={"color": [BLUE if s.effect in tied else GREY for s in self.suspects]},
            text=[f"{s.delta_bic:.1f}" for s in self.suspects],
        )
        figure.update_layout(
            xaxis={"type": "log", "title": {"text": "ΔBIC"}}, yaxis={"autorange": "reversed"}, hovermode="closest"
        )
        return [Chart(figure, "Blue: the first and everything that these runs cannot tell from it.")]

    def tables(self) -> Sequence[Table]:
        """The numbers."""
        rows = [
            [s.effect + (f" ({', '.join(s.joints)})" if s.joints else ""), f"{s.delta_bic:.1f}", f"{s.p_value:.1e}",
             "; ".join(f"{n.partition('.')[2]} {p.value:.3g} {p.unit}" for n, p in list(s.parameters.items())[:3]),
             ", ".join(s.tied_with) or "–"]
            for s in self.suspects
        ]  # fmt: skip
        return [Table(["effect", "ΔBIC", "p", "would be", "tied with"], rows)]


@dataclass(frozen=True)
class Parameters(Section):
    """Values with intervals."""

    title: ClassVar[str] = "Parameters"
    found: Comparison

    def sentence(self) -> str:
        """Whether the intervals can be trusted."""
        if self.found.intervals_hold:
            return "Standard deviations hold: the residual is white."
        return "The residual is not white: the standard deviations do not hold as intervals."

    def tables(self) -> Sequence[Table]:
        """One row per parameter."""
        rows = [
            [name, f"{p.value:.6g}", "fixed" if p.std is None else f"{p.std:.2g}", p.unit,
             "on its bound" if name in self.found.at_bound else ""]
            for name, p in self.found.parameters.items()
        ]  # fmt: skip
        return [Table(["parameter", "value", "standard deviation", "unit", ""], rows)]


@dataclass(frozen=True)
class Ladder(Section):
    """The error falling."""

    title: ClassVar[str] = "The error falling"
    rungs: Sequence[Rung]
    noise: dict[str, float]
    units: dict[str, str]

    def charts(self) -> Sequence[Chart]:
        """Training and held-out error per step, and the noise."""
        steps = [_step_name(i, rung) for i, rung in enumerate(self.rungs)]
        charts = []
        for channel in list(self.rungs[0].rmse)[:MOST_CHANNELS]:
            figure = go.Figure(
                layout={
                    "height": 340,
                    "yaxis": {"type": "log", "title": {"text": f"{channel} rmse [{self.units[channel]}]"}},
                }
            )
            figure.add_scatter(x=steps, y=[r.rmse[channel] for r in self.rungs], name="training",
                               mode="lines+markers", line={"color": BLUE, "width": 3}, marker={"size": 9})  # fmt: skip
            if any(channel in r.held_out_rmse for r in self.rungs):
                figure.add_scatter(x=steps, y=[r.held_out_rmse.get(channel) for r in self.rungs], name="held out",
                                   mode="lines+markers", line={"color": ORANGE, "width": 3}, marker={"size": 9})  # fmt: skip
            figure.add_scatter(x=steps, y=[self.noise[channel]] * len(steps), name="noise", **LIMIT)
            charts.append(Chart(figure))
        return charts

    def tables(self) -> Sequence[Table]:
        """The numbers."""
        channels = list(self.rungs[0].rmse)
        head = ["step", *(t for c in channels for t in (f"{c} rmse", "held out")), "χ² per sample", "BIC", "or"]
        rows = []
        for i, rung in enumerate(self.rungs):
            cells = []
            for c in channels:
                held_out = rung.held_out_rmse.get(c)
                cells += [number(rung.rmse[c], self.units[c]), number(held_out, self.units[c]) if held_out else "–"]
            rows.append([_step_name(i, rung), *cells, f"{rung.chi2_per_sample:.4g}", f"{rung.bic:.6g}",
                         ", ".join(rung.tied_with) or "–"])  # fmt: skip
        return [Table(head, rows)]


def _step_name(i: int, rung: Rung) -> str:
    if i == 0:
        return "as given"
    return " ".join([*(f"+ {name}" for name in rung.added), *(f"− {name}" for name in rung.removed)])


def _binned(at: np.ndarray, value: np.ndarray, bins: int = 24) -> tuple[np.ndarray, np.ndarray]:
    edges = np.unique(np.quantile(at, np.linspace(0, 1, bins + 1)))
    if len(edges) < 3:
        return at[:1], value[:1]
    index = np.clip(np.searchsorted(edges, at, side="right") - 1, 0, len(edges) - 2)
    counts = np.maximum(np.bincount(index, minlength=len(edges) - 1), 1)
    return (edges[:-1] + edges[1:]) / 2, np.bincount(index, weights=value, minlength=len(edges) - 1) / counts
