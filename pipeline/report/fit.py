"""Parts of every report about a fit: errors, dependence of the residual on covariates, key figures."""

from heapq import nlargest

import numpy as np
import plotly.graph_objects as go

from armdyn.document import Chart, Column, KeyFigure, Section, Table
from armdyn.identify.explained_share import percent_text
from armdyn.identify.fit import Fit
from armdyn.identify.study import Study
from pipeline.report.overlay import Overlays, Quality, quality
from pipeline.report.theme import LIMIT, MEASURED, MODEL, full_name, number, quantity_of, short_name


def error_section(shown: Overlays) -> Section:
    """Table by channel: the error of the given and the fitted model on each kind of run, and the explained share."""
    steps = {"as given": 0, "now": -1} if len(shown.steps) > 1 else {"now": -1}
    kinds = list(dict.fromkeys(curve.kind for curve in shown.curves))
    channels = [[c for c in shown.curves if c.channel == channel] for channel in shown.tabs]

    def of(kind: str, step: int) -> list[Quality | None]:
        """One cell per channel; None where no run of this kind has the channel."""
        each = [[c for c in mine if c.kind == kind] for mine in channels]
        return [quality(mine, step) if mine else None for mine in each]

    columns = [
        Column("", [full_name(mine[0].channel, mine[0].unit) for mine in channels]),
        Column("noise", [float(np.sqrt(np.mean([c.noise**2 for c in mine]))) for mine in channels], ".3g"),
    ]
    for kind in kinds:
        for when, step in steps.items():
            columns.append(Column(f"{kind}, {when}", [q and q.rmse for q in of(kind, step)]))
    columns.append(Column("unit", [mine[0].unit for mine in channels]))
    for when, step in steps.items():
        shares = [q.explained if q else 0.0 for q in of(kinds[-1], step)]
        bars = [max(share, 0.0) for share in shares]
        columns.append(Column(f"explained {when}", list(map(percent_text, shares)), bar_lengths=bars))
    caption = (
        "Error: root mean square of measured minus predicted. Explained: share of the measured signal's variation "
        f"about its mean, {kinds[-1]}; below 0 the mean alone would do better."
    )
    return Section("Errors", tables=[Table(columns, caption)])


RESIDUAL_BINS = 24
MAX_DOTS = 800
MAX_CHARTS_PER_TAB = 4
"""Under each tab: what matters most."""


def dependence_section(fit: Fit, whose: str) -> Section:
    """Section on the residual against each covariate, all runs together; the strongest dependence comes first.

    Args:
        fit: whose residuals are shown.
        whose: model that is, for a reader.
    """
    of_run, by_tab = fit.covariates(), dict[str, list[tuple[float, Chart]]]()
    names = {name: channel.unit for found in of_run.values() for name, channel in found.items()}
    for tab in dict.fromkeys(block.channel for block in fit.blocks):
        for name, unit in names.items():
            if name.startswith(("q.", "v.")) and name[2:] != tab.removeprefix("tau."):
                continue  # a joint's torque is shown against that joint
            blocks = [(b, of_run[b.run][name]) for b in fit.blocks if b.channel == tab and name in of_run[b.run]]
            if blocks:
                at = np.concatenate([block.interpolate(c) for block, c in blocks])
                residual = np.concatenate([block.residual for block, _ in blocks])
                by_tab.setdefault(tab, []).append(_dependence(tab, name, unit, at, residual))
    return Section(
        "What the residual depends on",
        f"Residual of {whose}. A line that leaves the band has a cause: a step at zero speed is dry friction, a slope "
        "is viscous.",
        [chart for found in by_tab.values() for _, chart in nlargest(MAX_CHARTS_PER_TAB, found, key=lambda f: f[0])],
        tabs={tab: short_name(tab) for tab in by_tab},
    )


def _dependence(tab: str, against: str, unit: str, at: np.ndarray, residual: np.ndarray) -> tuple[float, Chart]:
    """Strength of a dependence, and its figure: residual (n,) in units of the noise, and its mean in bins."""
    edges = np.quantile(at, np.linspace(0, 1, RESIDUAL_BINS + 1))
    place = np.clip(np.searchsorted(edges, at, side="right") - 1, 0, RESIDUAL_BINS - 1)
    count = np.maximum(np.bincount(place, minlength=RESIDUAL_BINS), 1)
    mean, middle = (np.bincount(place, values, minlength=RESIDUAL_BINS) / count for values in (residual, at))
    every = slice(None, None, max(1, len(at) // MAX_DOTS))
    figure = go.Figure(layout={"height": 280})
    figure.update_xaxes(title_text=f"{full_name(against, unit)} [{unit}]")
    figure.update_yaxes(title_text="residual [std of noise]")
    figure.add_scatter(x=at[every], y=residual[every], name="samples", opacity=0.4, **MEASURED)
    figure.add_scatter(x=middle, y=mean, name="mean", **MODEL)
    bound = 3 / np.sqrt(count)
    for sign in (-1, 1):
        figure.add_scatter(x=middle, y=sign * bound, name="3 std of the mean", showlegend=sign > 0, **LIMIT)
    caption = f"Residual of the {full_name(tab)} against {full_name(against)}."
    return float(np.sum((mean / bound) ** 2)), Chart(figure, caption, tab)


def key_figures(shown: Overlays) -> list[KeyFigure]:
    """Error and explained share of each quantity on the most independent runs, for the given model and every step."""
    kind, figures = shown.curves[-1].kind, []
    independent = [curve for curve in shown.curves if curve.kind == kind]
    for unit in dict.fromkeys(curve.unit for curve in independent):
        mine = [curve for curve in independent if curve.unit == unit]
        before, after = quality(mine, 0), quality(mine, -1)
        noises = [[c.noise**2 for c in mine if c.channel == channel] for channel in {c.channel for c in mine}]
        noise = float(np.sqrt(sum(map(np.mean, noises))))
        quantity = quantity_of(mine[0].channel, unit)
        title, whose = quantity[:1].upper() + quantity[1:], f"{kind}{', all joints' if len(noises) > 1 else ''}"
        given = [f"as given {percent_text(before.explained)}; ", f"as given {number(before.rmse, unit)}; "]
        share, error = given if len(shown.steps) > 1 else ("", "")
        figures += [
            KeyFigure(f"{title} explained", percent_text(after.explained), f"{share}of its variation, {whose}"),
            KeyFigure(f"{title} error", number(after.rmse, unit), f"{error}{whose}; noise {number(noise, unit, 2)}"),
        ]
    return figures


def runs_of(study: Study) -> str:
    """Names of a study's recordings by their role, in one line."""
    kinds = {"": study.runs, "; held out: ": study.held_out, "; exam: ": study.exam}
    return "".join(kind + ", ".join(run.name for run in runs) for kind, runs in kinds.items() if runs)
