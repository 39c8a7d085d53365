"""Parts of every report on a fit: errors by channel, dependence of the residual on covariates, key figures."""

from collections.abc import Mapping
from heapq import nlargest

import numpy as np
import plotly.graph_objects as go

from armdyn.document import Chart, Column, KeyFigure, Section, Table
from armdyn.identify.compare import ChannelQuality
from armdyn.identify.explained_share import percent_text
from armdyn.identify.fit import Fit
from armdyn.identify.sentence import plain_number, total_errors
from armdyn.identify.study import Study
from armdyn.recording.channel_names import channel_full_name, channel_quantity, channel_short_name
from pipeline.report.overlay import OverlayFigure, PredictionQuality, prediction_quality
from pipeline.report.theme import FOLLOWS_BULK, LIMIT_STYLE, MEASURED_STYLE, MODEL_STYLE


def channel_error_section(shown: OverlayFigure, quality: Mapping[str, ChannelQuality]) -> Section:
    """Section with a table by channel: errors of given and fitted model on each kind of run, and explained shares.

    Args:
        shown: curves of the runs.
        quality: quality of each channel in the answer, whose noise is shown.
    """
    steps = {"as given": 0, "now": -1} if len(shown.steps) > 1 else {"now": -1}
    kinds = list(dict.fromkeys(curve.kind for curve in shown.curves))
    channels = [[c for c in shown.curves if c.channel == channel] for channel in shown.tabs]

    def of(kind: str, step: int) -> list[PredictionQuality | None]:
        """One cell per channel; None where no run of this kind has the channel."""
        each = [[c for c in mine if c.kind == kind] for mine in channels]
        return [prediction_quality(mine, step) if mine else None for mine in each]

    columns = [
        Column("channel", [channel_full_name(mine[0].channel, mine[0].unit) for mine in channels]),
        Column("noise std", [quality[name].noise_std if name in quality else None for name in shown.tabs], ".3g"),
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
"""Number of intervals of a covariate in which the residual is averaged."""
MAX_SCATTER_POINTS = 800
"""Largest number of drawn samples of a residual against a covariate."""
MAX_CHARTS_PER_TAB = 4
"""Number of figures under each channel's tab: over its own speed, then its residual's strongest dependences."""


def residual_dependence_section(fit: Fit, whose: str) -> Section:
    """Section with figures of the residual: against a joint's or swing's own speed, then the strongest dependences.

    Args:
        fit: fit whose residuals of all runs are shown.
        whose: name of the fitted model for a reader, such as "the last step".
    """
    of_run, by_tab = fit.covariates(), dict[str, list[tuple[float, Chart]]]()
    names = {name: channel.unit for found in of_run.values() for name, channel in found.items()}
    for tab in dict.fromkeys(block.channel for block in fit.blocks):
        joint = tab.partition(".")[2]
        for name, unit in names.items():
            if name.startswith(("q.", "v.")) and name[2:] != joint:
                continue  # a joint is shown against itself
            blocks = [(b, of_run[b.run][name]) for b in fit.blocks if b.channel == tab and name in of_run[b.run]]
            if blocks:
                at = np.concatenate([block.interpolate(c) for block, c in blocks])
                residual = np.concatenate([block.residual for block, _ in blocks])
                strength, chart = _dependence(tab, name, unit, at, residual)
                own_speed = name in (f"v.{joint}", "swing_rate")
                by_tab.setdefault(tab, []).append((np.inf if own_speed else strength, chart))
    return Section(
        "What the residual depends on",
        f"Residual of {whose}. Dashed: 3 standard deviations of a mean of noise alone. The quantity over which the "
        "mean leaves them is one on which the missing effect depends; over a speed, a step at zero is dry friction and "
        "a slope viscous friction.",
        [chart for found in by_tab.values() for _, chart in nlargest(MAX_CHARTS_PER_TAB, found, key=lambda f: f[0])],
        tabs={tab: channel_short_name(tab) for tab in by_tab},
    )


def _dependence(tab: str, against: str, unit: str, at: np.ndarray, residual: np.ndarray) -> tuple[float, Chart]:
    """Strength of a dependence, and its figure: residual (n,) in units of the noise, and its mean in bins."""
    edges = np.unique(np.quantile(at, np.linspace(0, 1, RESIDUAL_BINS + 1)))  # an input may rest at one value
    place = np.clip(np.searchsorted(edges, at, side="right") - 1, 0, max(len(edges) - 2, 0))
    count = np.bincount(place)
    mean, middle = (np.bincount(place, values)[count > 0] / count[count > 0] for values in (residual, at))
    every = slice(None, None, max(1, len(at) // MAX_SCATTER_POINTS))
    figure = go.Figure(layout={"height": 280, "meta": FOLLOWS_BULK})
    figure.update_xaxes(title_text=f"{channel_full_name(against, unit)} [{unit}]")
    figure.update_yaxes(title_text="residual [std of noise]")
    figure.add_scatter(x=at[every], y=residual[every], name="samples", opacity=0.4, **MEASURED_STYLE)
    figure.add_scatter(x=middle, y=mean, name="mean", **MODEL_STYLE)
    bound = 3 / np.sqrt(count[count > 0])
    for sign in (-1, 1):
        figure.add_scatter(x=middle, y=sign * bound, name="± 3 std", showlegend=sign > 0, **LIMIT_STYLE)
    caption = f"Residual of the {channel_full_name(tab)} against {channel_full_name(against)}."
    return float(np.sum((mean / bound) ** 2)), Chart(figure, caption, tab)


def fit_key_figures(shown: OverlayFigure, quality: Mapping[str, ChannelQuality]) -> list[KeyFigure]:
    """Error and explained share of each measured quantity, on the runs that were most independent of the fit.

    Args:
        shown: curves of the runs.
        quality: quality of each channel in the answer, whose noise is shown.
    """
    noise = {name: channel.noise_std for name, channel in quality.items()}
    kind, figures = shown.curves[-1].kind, []
    independent = [curve for curve in shown.curves if curve.kind == kind]
    for unit in dict.fromkeys(curve.unit for curve in independent):
        mine = [curve for curve in independent if curve.unit == unit]
        before, after = prediction_quality(mine, 0), prediction_quality(mine, -1)
        units = {curve.channel: unit for curve in mine}
        size = plain_number(total_errors(noise, units).get(unit, np.nan))
        quantity = channel_quantity(mine[0].channel, unit)
        title, whose = quantity[:1].upper() + quantity[1:], f"{kind}{', all joints' if len(units) > 1 else ''}"
        given = [f"as given {percent_text(before.explained)}; ", f"as given {plain_number(before.rmse)} {unit}; "]
        share, error = given if len(shown.steps) > 1 else ("", "")
        figures += [
            KeyFigure(f"{title} explained", percent_text(after.explained), f"{share}of its variation, {whose}"),
            KeyFigure(f"{title} error", f"{plain_number(after.rmse)} {unit}", f"{error}{whose}; noise {size} {unit}"),
        ]
    return figures


def run_names_by_role(study: Study) -> str:
    """Names of a study's recordings in one line, by their role: fitted, held out, exam."""
    kinds = {"": study.runs, "; held out: ": study.held_out, "; exam: ": study.exam}
    return "".join(kind + ", ".join(run.name for run in runs) for kind, runs in kinds.items() if runs)
