"""Style of figures and numbers: colours, line styles, a template for plotly, stacked panels."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import plotly.graph_objects as go

from armdyn.recording.channels import FloatArray

# Okabe and Ito's palette: people with any kind of colour vision can tell its colours apart (jfly.uni-koeln.de, 2008).
BLUE, ORANGE, GREEN, VERMILLION, PURPLE, SKY = "#0072B2", "#E69F00", "#009E73", "#D55E00", "#CC79A7", "#56B4E9"
CURVE_COLOURS = (BLUE, ORANGE, GREEN, VERMILLION, PURPLE, SKY)
TEXT_COLOUR, GREY, PALE_GREY, GRID_COLOUR, PALE_BLUE_GREY = "#1F2933", "#7B8794", "#F4F6F8", "#E4E7EB", "#CBD2D9"
ORANGE_BAND_FILL = "rgba(230, 159, 0, 0.25)"
FAINT_FILL, HOVER_BACKGROUND, BLUE_BAND_FILL = (
    "rgba(31, 41, 51, 0.05)",
    "rgba(255, 255, 255, 0.95)",
    "rgba(0, 114, 178, 0.18)",
)

FONT = "system-ui, -apple-system, 'Segoe UI', Roboto, 'Helvetica Neue', Arial, sans-serif"

# A line style has the same meaning in every figure of every report.
MEASURED_STYLE = {"mode": "markers", "marker": {"color": GREY, "size": 3}}
MODEL_STYLE = ACTUAL_STYLE = {"mode": "lines", "line": {"color": BLUE, "width": 2}}
REFERENCE_STYLE = {"mode": "lines", "line": {"color": ORANGE, "width": 2, "dash": "dash"}}
TRUTH_STYLE = {"mode": "lines", "line": {"color": TEXT_COLOUR, "width": 1.5, "dash": "dot"}}
LIMIT_STYLE = {"mode": "lines", "line": {"color": VERMILLION, "width": 1.2, "dash": "dash"}}
BAND_STYLE = {"mode": "lines", "line": {"width": 0}, "fillcolor": BLUE_BAND_FILL, "hoverinfo": "skip"}

_AXIS = {
    "gridcolor": GRID_COLOUR,
    "linecolor": GREY,
    "zerolinecolor": GRID_COLOUR,
    "zerolinewidth": 1,
    "ticks": "outside",
    "tickcolor": GREY,
    "ticklen": 4,
    "title": {"standoff": 8, "font": {"size": 13}},
    "automargin": True,
    "exponentformat": "power",  # no "µ" before a unit that has its own
}

PLOTLY_TEMPLATE: Mapping[str, Any] = {
    "layout": {
        "font": {"family": FONT, "size": 13, "color": TEXT_COLOUR},
        "colorway": list(CURVE_COLOURS),
        "paper_bgcolor": "white",
        "plot_bgcolor": "white",
        "margin": {"l": 72, "r": 16, "t": 58, "b": 48},
        "legend": {"orientation": "h", "x": 0, "xanchor": "left", "y": 1, "yanchor": "top", "yref": "container"},
        "hovermode": "x unified",
        "hoverlabel": {"font": {"family": FONT, "size": 12}, "bgcolor": HOVER_BACKGROUND},
        "xaxis": _AXIS,
        "yaxis": _AXIS,
        "annotationdefaults": {"font": {"size": 12}, "showarrow": False},
        "bargap": 0.25,
        "bargroupgap": 0.06,
    }
}
"""Template of plotly that every figure of a page uses."""

DARK_COLOURS = {
    TEXT_COLOUR: "#E4E9EF",
    GREY: "#93A1B0",
    PALE_GREY: "#1A212A",
    GRID_COLOUR: "#2B3540",
    PALE_BLUE_GREY: "#4A5766",
    "white": "#12171D",
    BLUE: "#56A9E8",
    GREEN: "#2DB98F",
    VERMILLION: "#F08A4B",
    BLUE_BAND_FILL: "rgba(86, 169, 232, 0.22)",
    FAINT_FILL: "rgba(228, 233, 239, 0.06)",
    HOVER_BACKGROUND: "rgba(26, 33, 42, 0.95)",
}
"""Replacement of each colour on a dark screen; other colours stay the same."""

TIME_AXIS = "time [s]"
LINKED_TIME_AXES = {"time_axis": True}
"""Layout metadata of a figure over time: the time axes of all such figures of a page zoom together."""
WIDE_FIGURE = {"wide": True}
"""Layout metadata of a figure with many panels, which a narrow screen scrolls instead of shrinking it."""
FOLLOWS_BULK = {"bulk": True}
"""Layout metadata of a figure of measured values: its axes follow the bulk of them, and what lies outside is said."""
ASIDE: Mapping[str, Any] = {"meta": {"aside": True}}
"""Style of a curve that may widen an axis that follows the bulk to three times its length, and no further."""
NamedIntervals = Sequence[tuple[str, float, float]]
"""Names of intervals of time, such as phases of a trial, each with its start and end [s]."""


_SMALL = {"m": "mm", "m/s": "mm/s", "N": "mN", "s": "ms", "rad": "mrad", "N m": "mN m"}


def number_text(value: float, unit: str = "", digits: int = 3) -> str:
    """A number with its unit as text, in `digits` significant digits, such as ``0.312 mm`` for 0.000312 m."""
    if not math.isfinite(value):
        return "–"
    if unit in _SMALL and 0.0 < abs(value) < 0.0995:
        value, unit = value * 1e3, _SMALL[unit]
    return f"{_significant(value, digits)} {unit}".rstrip().replace("-", "−")


def percent_text(share: float) -> str:
    """A share as text in percent, such as ``95 %`` for 0.953."""
    return f"{100 * share:.0f} %" if math.isfinite(share) else "–"


def _significant(value: float, digits: int) -> str:
    if value == 0.0:
        return "0"
    decimals = max(0, digits - 1 - math.floor(math.log10(abs(value))))
    return f"{value:.{min(decimals, 12)}f}"


def stacked_figure(rows: Mapping[str, float], height: int, phases: NamedIntervals = ()) -> go.Figure:
    """An empty figure over time with several panels, one below the other.

    Args:
        rows: title of each vertical axis with its unit, and its share of the height, from the top; the shares sum to 1.
        height: height of the figure [px].
        phases: intervals of time that are named above the panels; every second one is shaded.
    """
    gap, top = 0.06, 1.0
    layout: dict[str, Any] = {"height": height, "meta": LINKED_TIME_AXES}
    for i, (title, share) in enumerate(rows.items()):
        bottom = max(0.0, top - share * (1.0 - gap * (len(rows) - 1)))
        layout[f"yaxis{i + 1 if i else ''}"] = {"title": {"text": title}, "domain": [bottom, top], "anchor": "x"}
        top = bottom - gap
    layout["xaxis"] = {"title": {"text": TIME_AXIS}, "anchor": f"y{len(rows) if len(rows) > 1 else ''}"}
    if phases:  # the same stretch of time in every figure
        layout["xaxis"]["range"] = [phases[0][1], phases[-1][2]]
    figure = go.Figure(layout=layout)
    for i, (name, start, end) in enumerate(phases):
        label = {"text": name, "font": {"size": 11, "color": GREY}, "x": (start + end) / 2, "y": 1}
        figure.add_annotation(label, xref="x", yref="paper", yanchor="bottom")
        if i % 2 == 0:
            figure.add_shape(
                type="rect", xref="x", yref="paper", x0=start, x1=end, y0=0, y1=1, fillcolor=PALE_GREY, line_width=0,
                layer="below",
            )  # fmt: skip
    return figure


def add_band(
    figure: go.Figure, time: FloatArray, middle: FloatArray, half: FloatArray, name: str, axis: str = "y"
) -> None:
    """Add a shaded band to a figure.

    Args:
        figure: figure over time.
        time: times (n,) [s].
        middle: middle of the band (n,).
        half: half width of the band (n,).
        name: name in the legend.
        axis: vertical axis of the panel, "y" for the first.
    """
    both = np.concatenate([time, time[::-1]])
    edge = np.concatenate([middle + half, (middle - half)[::-1]])
    figure.add_scatter(x=both, y=edge, fill="toself", name=name, yaxis=axis, **BAND_STYLE)


MAX_PLOTTED_POINTS = 3000
"""Largest number of drawn points of a curve; more points would only make the page larger."""


def thinned_signal(
    time: FloatArray, value: FloatArray, most: int = MAX_PLOTTED_POINTS
) -> tuple[FloatArray, FloatArray]:
    """Times and values of a signal, thinned to about `most` samples: the two extremes of each interval of samples."""
    if len(value) > most:
        width = 2 * -(-len(value) // most)
        whole = len(value) // width * width
        stretches = value[:whole].reshape(-1, width)
        extremes = np.sort([stretches.argmin(axis=1), stretches.argmax(axis=1)], axis=0)
        kept = np.append((extremes + width * np.arange(len(stretches))).T.ravel(), len(value) - 1)
        time, value = time[kept], value[kept]
    return time, value
