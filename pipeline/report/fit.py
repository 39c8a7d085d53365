"""What every report about a fit shows: measured and predicted, the residual, the parameters."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import plotly.graph_objects as go

from armdyn.identify.compare import Comparison
from armdyn.identify.explained import in_percent
from armdyn.identify.fit import Fit
from armdyn.identify.localise import Place
from armdyn.identify.study import Study
from pipeline.report.overlay import Overlay, OverlaySection, of_fits, quality
from pipeline.report.page import Chart, KeyFigure, Level, Report, Section, Table
from pipeline.report.theme import LIMIT, MEASURED, MODEL, full_name, number, quantity_of, short_name


@dataclass(frozen=True)
class FormulaSection(OverlaySection):
    """A formula that is known to be wrong, at the motion and parameters that the right one finds."""

    title: ClassVar[str] = "The wrong formula at the right motion"

    places: Sequence[Place] = ()

    def sentence(self) -> str:
        """Where it fails."""
        ranges = [f"{p.against} {p.start:.3g} to {p.end:.3g} {p.unit}" for p in self.places[:3]]
        return "Nothing is fitted here. It fails most at " + "; ".join(ranges) + "." if ranges else "It does not fail."


@dataclass(frozen=True)
class ErrorSection(Section):
    """Of every channel: the error as given and now, on every kind of run, and what is explained of the signal."""

    title: ClassVar[str] = "Errors"

    curves: Sequence[Overlay]
    steps: int

    def tables(self) -> Sequence[Table]:
        """A row per channel."""
        kinds = list(dict.fromkeys(c.kind for c in self.curves))
        shown = (0, self.steps - 1) if self.steps > 1 else (0,)
        each = ("as given", "now") if self.steps > 1 else ("now",)
        header = ["", "noise", *(f"{kind}, {when}" for kind in kinds for when in each), "unit"]
        header += [f"explained {when}" for when in each]
        rows: list[list[str]] = []
        shares: list[list[float]] = []
        for channel in dict.fromkeys(c.channel for c in self.curves):
            mine = [c for c in self.curves if c.channel == channel]
            errors: list[str] = []
            share = [0.0] * len(each)
            for kind in kinds:
                of_kind = [c for c in mine if c.kind == kind]
                found = [quality(of_kind, step) for step in shown] if of_kind else []
                errors += [f"{q.rmse:.4g}" for q in found] or ["–"] * len(each)
                share = [q.explained for q in found] or share
            noise = float(np.sqrt(np.mean([c.noise**2 for c in mine])))
            rows.append(
                [full_name(channel, mine[0].unit), f"{noise:.3g}", *errors, mine[0].unit, *map(in_percent, share)]
            )
            shares.append([max(x, 0.0) for x in share])
        bars = {len(header) - len(each) + i: [share[i] for share in shares] for i in range(len(each))}
        caption = (
            "Error: root mean square of measured minus predicted. Explained: share of the measured signal's variation "
            f"about its mean, {kinds[-1]}; below 0 the mean alone would do better."
        )
        return [Table(header, rows, caption, bars=bars)]


BINS = 24
MOST_DOTS = 800
MOST_CHARTS = 4
"""Under each tab: what matters most."""


@dataclass(frozen=True)
class DependenceSection(Section):
    """One figure per channel and covariate, all runs together, for each channel those that matter most first."""

    title: ClassVar[str] = "What the residual depends on"

    fit: Fit
    whose: str = "this model"

    def sentence(self) -> str:
        """How to read it."""
        text = "A line that leaves the band has a cause: a step at zero speed is dry friction, a slope is viscous."
        return f"Residual of {self.whose}. {text}"

    def tabs(self) -> Mapping[str, str]:
        """The channels."""
        return {block.channel: short_name(block.channel) for block in self.fit.blocks}

    def charts(self) -> Sequence[Chart]:
        """Residual in units of the noise, and its mean in bins."""
        by_tab: dict[str, list[Chart]] = {}
        for _, chart in sorted(self._gathered(), key=lambda item: -item[0]):
            by_tab.setdefault(chart.tab, []).append(chart)
        return [chart for charts in by_tab.values() for chart in charts[:MOST_CHARTS]]

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
    figure.update_xaxes(title_text=f"{full_name(against, unit)} [{unit}]")
    figure.update_yaxes(title_text="residual [std of noise]")
    figure.add_scatter(x=at[every], y=residual[every], name="samples", opacity=0.4, **MEASURED)
    figure.add_scatter(x=middle, y=mean, name="mean", **MODEL)
    bound = 3 / np.sqrt(count)
    for sign in (-1, 1):
        figure.add_scatter(x=middle, y=sign * bound, name="3 std of the mean", showlegend=sign > 0, **LIMIT)
    return float(np.sum((mean / bound) ** 2)), Chart(
        figure, f"Residual of the {full_name(channel)} against {full_name(against)}.", channel
    )


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
        """Parameters, and the statistics behind a line."""
        c = self.comparison
        meaning = {column.name: column.parameter.source for column in c.fit.problem.columns}
        parameters = [
            [name, f"{p.value:.6g}", "not fitted" if p.std is None else f"{p.std:.2g}", p.unit, meaning.get(name, "")]
            for name, p in c.parameters.items()
        ]
        statistics = [
            [full_name(name, q.unit), f"{q.noise_std:.3g} {q.unit}", f"{q.chi2_per_sample:.4g}", f"{q.white:.2g}"]
            for name, q in c.channels.items()
        ]
        return [
            Table(["parameter", "value", "std", "unit", "what it is"], parameters),
            Table(
                ["", "noise", "χ² per sample", "p of white noise"],
                statistics,
                "χ² per sample: squared error over squared noise, 1 where only noise is left.",
                folded="Statistics: χ² per sample, whiteness",
            ),
        ]


def comparison_report(study: Study, found: Comparison, command: str = "") -> Report:
    """Measured against predicted, where it fails, on what the residual depends, the parameters."""
    shown = OverlaySection.of_study(study, [found.fit], ["as given"], found.places)
    return Report(
        title="Compare: the model against recordings",
        level=Level.GOOD if found.explained else Level.CAUTION,
        verdict=found.sentence,
        sections=[shown, *fit_sections(found, shown), *formula_sections(found)],
        subtitle=runs_of(study),
        key_figures=key_figures(shown),
        command=command,
    )


def fit_sections(found: Comparison, shown: OverlaySection, whose: str = "this model") -> list[Section]:
    """What every report about a fit shows below its curves; `whose` fit is `found`."""
    errors = ErrorSection(shown.curves, len(shown.steps))
    return [errors, DependenceSection(found.fit, whose), ParameterSection(found)]


def formula_sections(found: Comparison) -> list[Section]:
    """Where a formula that is known to be wrong fails; nothing where the model has none."""
    if found.correction is None:
        return []
    wrong, places = found.correction.wrong, found.correction.places
    curves = of_fits([wrong], places)
    return [FormulaSection(curves, places=places), DependenceSection(wrong, "the wrong formula")]


def key_figures(shown: OverlaySection) -> list[KeyFigure]:
    """What is explained of each quantity and the error, on the most independent runs; as given and after every step."""
    kind, last = shown.curves[-1].kind, len(shown.steps) - 1
    figures = []
    for unit in dict.fromkeys(curve.unit for curve in shown.curves):
        mine = [curve for curve in shown.curves if curve.unit == unit and curve.kind == kind]
        if not mine:
            continue
        before, after = quality(mine, 0), quality(mine, last)
        channels = {curve.channel for curve in mine}
        quantity = quantity_of(mine[0].channel, unit)
        title = quantity[:1].upper() + quantity[1:]
        whose = f"{kind}{', all joints' if len(channels) > 1 else ''}"
        noise = np.sqrt(sum(np.mean([c.noise**2 for c in mine if c.channel == channel]) for channel in channels))
        explained = [f"as given {in_percent(before.explained)}"] if last else []
        error = [f"as given {number(before.rmse, unit)}"] if last else []
        figures += [
            KeyFigure(
                f"{title} explained", in_percent(after.explained), "; ".join([*explained, f"of its variation, {whose}"])
            ),
            KeyFigure(
                f"{title} error",
                number(after.rmse, unit),
                "; ".join([*error, whose, f"noise {number(float(noise), unit, 2)}"]),
            ),
        ]
    return figures


def runs_of(study: Study) -> str:
    """Which recordings."""
    kinds = {"": study.runs, "; held out: ": study.held_out, "; exam: ": study.exam}
    return "".join(kind + ", ".join(run.name for run in runs) for kind, runs in kinds.items() if runs)
