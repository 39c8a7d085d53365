"""The first picture of every report about a fit: what the model cannot explain, against what it may depend on."""

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import plotly.graph_objects as go

from armdyn.channels import FloatArray
from armdyn.identify.force_law import QUANTITIES, law
from armdyn.identify.missing_force import ForceCurve, pooled
from pipeline.report.page import Chart, Section
from pipeline.report.theme import BAND, BLUE, GREY, ORANGE, SHADE, SHADE_GIVEN, short_name

TITLE = "The missing force"
WIDTH = 2.0
"""Standard errors on either side that a band shows."""
GAP = 0.025
"""Between two panels, as a share of the figure's width."""
HEIGHT = 330
HINT = (
    "What the model cannot explain, averaged. Over the speed, a step at zero is dry friction, a straight line viscous "
    "friction; a flat line at zero means that nothing is missing there."
)
SPOKEN = {"load": "predicted load", "pivot_acceleration": "pivot acceleration"}


def missing_force_sections(curves: Sequence[ForceCurve], added: str = "") -> list[Section]:
    """One section, with a row of panels for each joint; none where the missing force is not known.

    Args:
        curves: the joint that lacks most first.
        added: what the repaired model has besides, for the legend.
    """
    if not curves:
        return []
    charts = [
        Chart(figure, _caption([c for c in curves if c.joint == joint]), tab_of(joint))
        for joint, figure in missing_force_figures(curves, added).items()
    ]
    tabs = {chart.tab: short_name(chart.tab) for chart in charts if chart.tab}
    return [Section(TITLE, HINT, charts, tabs=tabs)]


def _caption(curves: Sequence[ForceCurve]) -> str:
    """The law of one joint, where it is clear."""
    found = law(curves)
    text = f"Here {found.sentence}." if found is not None else "None of the simple laws is clear here."
    return f"{text} Shaded: ± {WIDTH:g} standard errors of the mean."


def tab_of(joint: str | None) -> str:
    """The tab under which a joint's picture stands: that of its torque."""
    return f"tau.{joint}" if joint is not None else ""


def missing_force_figures(curves: Iterable[ForceCurve], added: str = "") -> dict[str | None, go.Figure]:
    """By joint: a row of panels, one for each quantity, all runs together."""
    by_joint: dict[str | None, list[ForceCurve]] = {}
    for curve in pooled(curves):
        by_joint.setdefault(curve.joint, []).append(curve)
    return {joint: _row(mine, added) for joint, mine in by_joint.items()}


def _row(curves: Sequence[ForceCurve], added: str) -> go.Figure:
    """Panels side by side that share the vertical axis."""
    unit, count = curves[0].unit, len(curves)
    width = (1.0 - GAP * (count - 1)) / count
    title = {"text": f"missing {QUANTITIES[unit]} [{unit}]"}
    layout: dict[str, Any] = {"height": HEIGHT, "yaxis": {"title": title}, "hovermode": "closest"}
    layout["margin"] = {"t": 40}
    figure = go.Figure(layout=layout)
    for i, curve in enumerate(curves):
        axis = f"x{i + 1 if i else ''}"
        start = i * (width + GAP)
        name = SPOKEN.get(curve.against, curve.against)
        domain = [start, min(start + width, 1.0)]
        figure.update_layout({f"xaxis{i + 1 if i else ''}": {
            "title": {"text": f"{name} [{curve.x_unit}]"}, "domain": domain, "anchor": "y", "nticks": 5,
        }})  # fmt: skip
        ends = [curve.x[0], curve.x[-1]]
        zero = {"mode": "lines", "line": {"color": GREY, "width": 1}, "hoverinfo": "skip", "showlegend": False}
        figure.add_scatter(x=ends, y=[0.0, 0.0], xaxis=axis, **zero)
        _line(figure, curve.x, curve.as_given, curve.std, "as given", (ORANGE, SHADE_GIVEN), axis)
        if curve.repaired is not None and curve.repaired_std is not None:
            _line(figure, curve.x, curve.repaired, curve.repaired_std, added or "repaired", (BLUE, SHADE), axis)
    return figure


def _line(
    figure: go.Figure, x: FloatArray, mean: FloatArray, std: FloatArray, name: str, colours: tuple[str, str], axis: str
) -> None:
    """Means and their band; one entry of the legend for all panels."""
    colour, shade = colours
    outline = np.concatenate([mean + WIDTH * std, (mean - WIDTH * std)[::-1]])
    band = {**BAND, "fillcolor": shade, "fill": "toself", "legendgroup": name, "showlegend": False, "xaxis": axis}
    figure.add_scatter(x=np.concatenate([x, x[::-1]]), y=outline, **band)
    look = {"mode": "lines+markers", "line": {"color": colour, "width": 2}, "marker": {"color": colour, "size": 5}}
    figure.add_scatter(x=x, y=mean, name=name, legendgroup=name, showlegend=axis == "x", xaxis=axis, **look)
