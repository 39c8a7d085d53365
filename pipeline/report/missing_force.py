"""The first picture of every report about a fit: what the model cannot explain, against what it may depend on."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import plotly.graph_objects as go

from armdyn.channels import FloatArray
from armdyn.document import Chart, Section
from armdyn.identify.force_law import QUANTITIES, law
from armdyn.identify.missing_force import ForceCurve, pooled
from pipeline.report.theme import BAND, BLUE, GREY, ORANGE, SHADE, SHADE_GIVEN, WIDE, short_name

TITLE = "The missing force"
HINT = (
    "What the model cannot explain, averaged. Over the speed, a step at zero is dry friction, a straight line viscous "
    "friction; a flat line at zero means that nothing is missing there."
)
WIDTH = 2.0
"""Standard errors on either side that a band shows."""
GAP = 0.025
"""Between two panels, as a share of the figure's width."""
HEIGHT = 330
SPOKEN = {"load": "predicted load", "pivot_acceleration": "pivot acceleration"}


class Picture(NamedTuple):
    """The missing force of one joint, or of a model without joints.

    Attributes:
        tab: the channel under whose tab it stands; empty for a model without joints.
        figure: a row of panels, one for each quantity, as plotly's data and layout.
        caption: the law, where it is clear.
    """

    tab: str
    figure: Mapping[str, Any]
    caption: str


def missing_force_sections(curves: Sequence[ForceCurve], added: str = "") -> list[Section]:
    """One section, with a picture for each joint; none where the missing force is not known.

    Args:
        curves: the joint that lacks most first.
        added: what the repaired model has besides, for the legend.
    """
    pictures = missing_force_pictures(curves, added)
    charts = [Chart(go.Figure(picture.figure), picture.caption, picture.tab) for picture in pictures]
    tabs = {picture.tab: short_name(picture.tab) for picture in pictures if picture.tab}
    return [Section(TITLE, HINT, charts, tabs=tabs)] if charts else []


def missing_force_pictures(curves: Iterable[ForceCurve], added: str = "") -> list[Picture]:
    """All runs together, the joint that lacks most first; see `missing_force_sections`."""
    by_joint: dict[str | None, list[ForceCurve]] = {}
    for curve in pooled(curves):
        by_joint.setdefault(curve.joint, []).append(curve)
    return [
        Picture("" if joint is None else f"tau.{joint}", _row(mine, added or "repaired"), _caption(mine))
        for joint, mine in by_joint.items()
    ]


def _caption(curves: Sequence[ForceCurve]) -> str:
    found, whose = law(curves), f" for {curves[0].joint}" if curves[0].joint else ""
    text = f"Here {found.sentence}." if found is not None else f"None of the simple laws is clear{whose}."
    return f"{text} Shaded: ± {WIDTH:g} standard errors of the mean."


def _row(curves: Sequence[ForceCurve], added: str) -> dict[str, Any]:
    """Panels side by side that share the vertical axis."""
    unit, count = curves[0].unit, len(curves)
    width = (1.0 - GAP * (count - 1)) / count
    layout: dict[str, Any] = {"height": HEIGHT, "margin": {"t": 40}, "hovermode": "closest", "meta": WIDE}
    layout["yaxis"] = {"title": {"text": f"missing {QUANTITIES[unit]} [{unit}]"}}
    traces: list[dict[str, Any]] = []
    for i, curve in enumerate(curves):
        number = str(i + 1) if i else ""
        start = i * (width + GAP)
        layout[f"xaxis{number}"] = {
            "title": {"text": f"{SPOKEN.get(curve.against, curve.against)} [{curve.x_unit}]"},
            "domain": [start, min(start + width, 1.0)],
            "anchor": "y",
            "nticks": 5,
        }
        zero = {"mode": "lines", "line": {"color": GREY, "width": 1}, "hoverinfo": "skip", "showlegend": False}
        panel = [{"x": _short(curve.x[[0, -1]]), "y": [0.0, 0.0], **zero}]
        panel += _line(curve.x, curve.as_given, curve.std, "as given", (ORANGE, SHADE_GIVEN))
        if curve.repaired is not None and curve.repaired_std is not None:
            panel += _line(curve.x, curve.repaired, curve.repaired_std, added, (BLUE, SHADE))
        traces += [{"showlegend": i == 0, "type": "scatter", **trace, "xaxis": f"x{number}"} for trace in panel]
    return {"data": traces, "layout": layout}


def _line(
    x: FloatArray, mean: FloatArray, std: FloatArray, name: str, colours: tuple[str, str]
) -> list[dict[str, Any]]:
    """Means and their band."""
    colour, shade = colours
    low, high = mean - WIDTH * std, mean + WIDTH * std
    outline = {"x": _short(np.concatenate([x, x[::-1]])), "y": _short(np.concatenate([high, low[::-1]]))}
    band = {**BAND, **outline, "fillcolor": shade, "fill": "toself", "legendgroup": name, "showlegend": False}
    look = {"mode": "lines+markers", "line": {"color": colour, "width": 2}, "marker": {"color": colour, "size": 5}}
    return [band, {"x": _short(x), "y": _short(mean), "name": name, "legendgroup": name, **look}]


def _short(values: FloatArray) -> list[float]:
    """Finer than a screen, in few digits."""
    return [float(f"{value:.5g}") for value in values]
