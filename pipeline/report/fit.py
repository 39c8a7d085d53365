"""What every report about a fit shows: measured and predicted, the residual, the parameters."""

from collections.abc import Sequence

import numpy as np
import plotly.graph_objects as go

from armdyn.document import Chart, KeyFigure, Section, Table
from armdyn.identify.explained import in_percent
from armdyn.identify.fit import Fit
from armdyn.identify.study import Study
from pipeline.report.overlay import Overlay, Overlays, quality
from pipeline.report.theme import LIMIT, MEASURED, MODEL, full_name, number, quantity_of, short_name


def error_section(curves: Sequence[Overlay], steps: int) -> Section:
    """Of every channel: the error as given and now, on every kind of run, and what is explained of the signal."""
    kinds = list(dict.fromkeys(c.kind for c in curves))
    shown = (0, steps - 1) if steps > 1 else (0,)
    each = ("as given", "now") if steps > 1 else ("now",)
    header = ["", "noise", *(f"{kind}, {when}" for kind in kinds for when in each), "unit"]
    header += [f"explained {when}" for when in each]
    rows: list[list[str]] = []
    shares: list[list[float]] = []
    for channel in dict.fromkeys(c.channel for c in curves):
        mine = [c for c in curves if c.channel == channel]
        errors: list[str] = []
        share = [0.0] * len(each)
        for kind in kinds:
            of_kind = [c for c in mine if c.kind == kind]
            found = [quality(of_kind, step) for step in shown] if of_kind else []
            errors += [f"{q.rmse:.4g}" for q in found] or ["–"] * len(each)
            share = [q.explained for q in found] or share
        noise = float(np.sqrt(np.mean([c.noise**2 for c in mine])))
        rows.append([full_name(channel, mine[0].unit), f"{noise:.3g}", *errors, mine[0].unit, *map(in_percent, share)])
        shares.append([max(x, 0.0) for x in share])
    bars = {len(header) - len(each) + i: [share[i] for share in shares] for i in range(len(each))}
    caption = (
        "Error: root mean square of measured minus predicted. Explained: share of the measured signal's variation "
        f"about its mean, {kinds[-1]}; below 0 the mean alone would do better."
    )
    return Section("Errors", tables=[Table.of(header, rows, caption, bars=bars)])


BINS = 24
MOST_DOTS = 800
MOST_CHARTS = 4
"""Under each tab: what matters most."""


def dependence_section(fit: Fit, whose: str) -> Section:
    """One figure per channel and covariate, all runs together, for each channel those that matter most first."""
    by_tab: dict[str, list[Chart]] = {}
    for _, chart in sorted(_gathered(fit), key=lambda item: -item[0]):
        by_tab.setdefault(chart.tab, []).append(chart)
    return Section(
        "What the residual depends on",
        f"Residual of {whose}. A line that leaves the band has a cause: a step at zero speed is dry friction, a slope "
        "is viscous.",
        [chart for charts in by_tab.values() for chart in charts[:MOST_CHARTS]],
        tabs={block.channel: short_name(block.channel) for block in fit.blocks},
    )


def _gathered(fit: Fit) -> list[tuple[float, Chart]]:
    """Residual in units of the noise, and its mean in bins, with how much each figure matters."""
    problem, points = fit.problem, dict[tuple[str, str], list[tuple[np.ndarray, np.ndarray]]]()
    units = {}
    for i, run in enumerate(problem.runs):
        covariates = problem.model.covariates(run, problem.theta(i, fit.values))
        for block in (b for b in fit.blocks if b.run == run.name):
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


def key_figures(shown: Overlays) -> list[KeyFigure]:
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
