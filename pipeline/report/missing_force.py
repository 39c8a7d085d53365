"""Figure of the missing force (the force or torque that the model does not explain) against possible covariates."""

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from armdyn.document import Chart, Section
from armdyn.identify.residual.force_law import QUANTITY_BY_UNIT, RATE_QUANTITY, find_force_law
from armdyn.identify.residual.missing_force import ForceCurve, pool_curves
from armdyn.recording.channel_names import channel_short_name
from armdyn.recording.channels import FloatArray
from pipeline.report.theme import (
    BAND_STYLE,
    BLUE,
    BLUE_BAND_FILL,
    FOLLOWS_BULK,
    GREY,
    ORANGE,
    ORANGE_BAND_FILL,
    TEXT_COLOUR,
    WIDE_FIGURE,
)

MISSING_FORCE_TITLE = "The missing force"
MISSING_FORCE_HINT = (
    "What the model cannot explain, averaged. Over the speed, a step at zero is dry friction, a straight line viscous "
    "friction; a flat line at zero means that nothing is missing there."
)
MISSING_RATE_TITLE = "The missing rates"
MISSING_RATE_HINT = (
    "By how much the model is wrong about the rate at which each state changes, averaged. The quantity over which a "
    "line leaves zero is the one on which the missing term depends."
)
BAND_STANDARD_ERRORS = 2.0
"""Half width of a drawn uncertainty band [standard errors]."""
PANEL_GAP_SHARE_OF_WIDTH = 0.025
"""Gap between two panels of the figure, as a share of the figure's width."""
PANEL_HEIGHT_PIXELS = 330
"""Height of the figure of the missing force [px]."""
LAW_LABEL, BACKGROUND_LABEL = "what that explains", "with the background"
COVARIATE_WORDS = {"load": "predicted load", "pivot_acceleration": "pivot acceleration"}


def missing_force_sections(curves: Sequence[ForceCurve], added: str = "repaired") -> list[Section]:
    """One section with a figure of each joint's missing force; an empty list where there are no curves.

    Args:
        curves: missing force of each joint against each covariate; the largest force comes first.
        added: name of the model with the missing effects, for the legend.
    """
    charts = missing_force_charts(curves, added)
    tabs = {chart.tab: channel_short_name(chart.tab) for chart in charts if chart.tab}
    forces = any(curve.unit in QUANTITY_BY_UNIT for curve in curves)
    title, hint = (MISSING_FORCE_TITLE, MISSING_FORCE_HINT) if forces else (MISSING_RATE_TITLE, MISSING_RATE_HINT)
    return [Section(title, hint, charts, tabs=tabs)] if charts else []


def missing_force_charts(curves: Iterable[ForceCurve], added: str = "repaired") -> list[Chart]:
    """Figures of the missing force, one for each joint, pooled over all runs; the largest force comes first.

    Args:
        curves: missing force of each joint, run and covariate.
        added: name of the model with the missing effects, for the legend.
    """
    by_joint: dict[str | None, list[ForceCurve]] = {}
    for curve in pool_curves(curves):
        by_joint.setdefault(curve.joint, []).append(curve)
    charts = []
    for joint, mine in by_joint.items():
        found = find_force_law(mine)
        nothing = f"None of the simple laws is clear{f' for {joint}' if joint else ''}."
        caption = f"Here {found.sentence}." if found else nothing
        caption += f" Shaded: ± {BAND_STANDARD_ERRORS:g} standard errors of the mean."
        charts.append(Chart(_row(mine, added), caption, f"tau.{joint}" if joint else ""))
    return charts


def _row(curves: Sequence[ForceCurve], added: str) -> dict[str, Any]:
    """Panels side by side on one vertical axis; `go.Figure` is avoided because its checks are too slow for a click."""
    unit, count = curves[0].unit, len(curves)
    width = (1.0 - PANEL_GAP_SHARE_OF_WIDTH * (count - 1)) / count
    layout: dict[str, Any] = {
        "height": PANEL_HEIGHT_PIXELS,
        "margin": {"t": 40},
        "hovermode": "closest",
        "meta": {**WIDE_FIGURE, **FOLLOWS_BULK},
    }
    layout["yaxis"] = {"title": {"text": f"missing {QUANTITY_BY_UNIT.get(unit, RATE_QUANTITY)} [{unit}]"}}
    traces: list[dict[str, Any]] = []
    for i, curve in enumerate(curves):
        number, start = str(i + 1) if i else "", i * (width + PANEL_GAP_SHARE_OF_WIDTH)
        title = f"{COVARIATE_WORDS.get(curve.against, curve.against)}<br>[{curve.x_unit}]"
        domain = [start, min(start + width, 1.0)]
        layout[f"xaxis{number}"] = {"title": {"text": title}, "domain": domain, "anchor": "y", "nticks": 5}
        zero = {"mode": "lines", "line": {"color": GREY, "width": 1}, "hoverinfo": "skip", "showlegend": False}
        panel = [{"x": _short(curve.x[[0, -1]]), "y": [0.0, 0.0], **zero}]
        panel += _line(curve.x, curve.as_given, curve.std, "as given", ORANGE, ORANGE_BAND_FILL)
        if curve.repaired is not None and curve.repaired_std is not None:
            panel += _line(curve.x, curve.repaired, curve.repaired_std, added, BLUE, BLUE_BAND_FILL)
        for values, name, dash in ((curve.with_background, BACKGROUND_LABEL, "dot"), (curve.law, LAW_LABEL, "dash")):
            if values is not None:
                line = {"mode": "lines", "line": {"color": TEXT_COLOUR, "width": 2, "dash": dash}}
                panel.append({"x": _short(curve.x), "y": _short(values), "name": name, "legendgroup": name, **line})
        traces += [{"showlegend": i == 0, "type": "scatter", **trace, "xaxis": f"x{number}"} for trace in panel]
    return {"data": traces, "layout": layout}


def _line(x: FloatArray, mean: FloatArray, std: FloatArray, name: str, colour: str, shade: str) -> list[dict[str, Any]]:
    low, high = mean - BAND_STANDARD_ERRORS * std, mean + BAND_STANDARD_ERRORS * std
    outline = {"x": _short(np.concatenate([x, x[::-1]])), "y": _short(np.concatenate([high, low[::-1]]))}
    band = {**BAND_STYLE, **outline, "fillcolor": shade, "fill": "toself", "legendgroup": name, "showlegend": False}
    look = {"mode": "lines+markers", "line": {"color": colour, "width": 2}, "marker": {"color": colour, "size": 5}}
    return [band, {"x": _short(x), "y": _short(mean), "name": name, "legendgroup": name, **look}]


def _short(values: FloatArray) -> list[float]:
    """Values rounded to few digits, still finer than the pixels of a screen."""
    return [float(f"{value:.5g}") for value in values]
