"""The first picture of every report about a fit: what the model cannot explain, against what it may depend on."""

from collections.abc import Iterable, Sequence
from typing import Any

import plotly.graph_objects as go

from armdyn.channels import FloatArray
from armdyn.identify.force_law import QUANTITIES, law
from armdyn.identify.missing_force import ForceCurve, pooled
from pipeline.report.page import Chart, Section
from pipeline.report.theme import BAND, BLUE, GREY, ORANGE, SHADE, SHADE_GIVEN

TITLE = "The missing force"
WIDTH = 2.0
"""Standard errors on either side that a band shows."""
GAP = 0.025
"""Between two panels, as a share of the figure's width."""
HEIGHT = 300
SPOKEN = {"load": "predicted load", "pivot_acceleration": "pivot acceleration"}


def missing_force_sections(curves: Sequence[ForceCurve], added: str = "") -> list[Section]:
    """One section, with a row of panels for each joint; none where the missing force is not known.

    Args:
        curves: the joint that lacks most first.
        added: what the repaired model has besides, for the legend.
    """
    if not curves:
        return []
    figures = missing_force_figures(curves, added)
    found = law(curves)
    text = f"{found.sentence[:1].upper()}{found.sentence[1:]}." if found is not None else ""
    caption = (
        f"What the model lacks, as means over equally many samples; shaded: ± {WIDTH:g} standard errors. A step at zero "
        "speed is dry friction, a straight line over the speed viscous friction; a line at zero, nothing."
    )
    charts = [Chart(figure, caption, tab_of(joint)) for joint, figure in figures.items()]
    tabs = {tab_of(joint): joint for joint in figures if joint is not None}
    return [Section(TITLE, text, charts, tabs=tabs)]


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
        _line(figure, curve, curve.as_given, "as given", ORANGE, SHADE_GIVEN, axis)
        if curve.repaired is not None:
            _line(figure, curve, curve.repaired, added or "repaired", BLUE, SHADE, axis)
    return figure


def _line(
    figure: go.Figure, curve: ForceCurve, value: FloatArray, name: str, colour: str, shade: str, axis: str
) -> None:
    """Means and their band; one entry of the legend for all panels."""
    half = WIDTH * curve.std
    outline = {"x": [*curve.x, *curve.x[::-1]], "y": [*(value + half), *(value - half)[::-1]]}
    figure.add_scatter(
        **outline, fill="toself", xaxis=axis, showlegend=False, legendgroup=name, **{**BAND, "fillcolor": shade}
    )
    look = {"mode": "lines+markers", "line": {"color": colour, "width": 2}, "marker": {"color": colour, "size": 5}}
    figure.add_scatter(x=curve.x, y=value, name=name, legendgroup=name, showlegend=axis == "x", xaxis=axis, **look)
