"""Figures of an arm's motion: measured, simulated and commanded positions of its joints."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from armdyn.arm.closed_loop.rollout import SimulatedPositionError
from armdyn.document import Chart, Section
from armdyn.identify.tables import ROLE_WORDS, ROLLOUT_WORDS
from armdyn.recording.channel_names import channel_short_name
from armdyn.recording.channels import FloatArray
from pipeline.report.theme import (
    ACTUAL_STYLE,
    ASIDE,
    FOLLOWS_BULK,
    GREY,
    MEASURED_STYLE,
    ORANGE,
    TIME_AXIS,
    WIDE_FIGURE,
    thinned_signal,
)

MOTION_TITLE = "Motion"
MOTION_CHART_HEIGHT_PIXELS = 380
"""Height of the figure of a joint's motion [px]."""
ERROR_PANEL_SHARE_OF_HEIGHT, PANEL_GAP_SHARE_OF_HEIGHT = 0.42, 0.06
"""Shares of a figure's height: of the lower panel with the error, and of the gap below the panel with positions."""


def motion_charts(found: Sequence[SimulatedPositionError], kind: str = "tau") -> list[Chart]:
    """A figure of each joint's simulated motion, in the last of the runs that are most independent of the fit.

    Args:
        found: simulated motion of joints in runs.
        kind: kind of the joints' channels whose tabs show the figures.
    """
    if not found:
        return []
    role = next(role for role in ROLE_WORDS if any(r.role == role for r in found))
    name = [r.run for r in found if r.role == role][-1]
    by_joint = {r.joint: r for r in found if (r.role, r.run) == (role, name)}  # the longest windows of several kinds
    captions = {
        joint: f"{joint} in {name} ({ROLE_WORDS[role]}), simulated in {ROLLOUT_WORDS[r.kind]}."
        for joint, r in by_joint.items()
    }
    return [Chart(_picture(r), captions[joint], f"{kind}.{joint}") for joint, r in by_joint.items()]


def with_motion_charts(
    sections: Sequence[Section], found: Sequence[SimulatedPositionError], channels: Collection[str] = ()
) -> list[Section]:
    """Sections of a document, with figures added to the section on the motion, under the tabs of other channels."""
    charts = motion_charts(found, "q" if any(name.startswith("q.") for name in channels) else "tau")
    tabs = {chart.tab: channel_short_name(chart.tab) for chart in charts}
    return [replace(s, charts=charts, tabs=tabs) if s.title == MOTION_TITLE and charts else s for s in sections]


def _picture(of: SimulatedPositionError) -> dict[str, Any]:
    """Figure of positions above and their errors below over time; `go.Figure`, whose checks are slow, is avoided."""
    layout: dict[str, Any] = {
        "height": MOTION_CHART_HEIGHT_PIXELS,
        "margin": {"t": 30},
        "hovermode": "closest",
        "meta": {**WIDE_FIGURE, **FOLLOWS_BULK},
    }
    layout["xaxis"] = {"title": {"text": TIME_AXIS}, "anchor": "y2"}
    top, bottom = (
        ERROR_PANEL_SHARE_OF_HEIGHT + PANEL_GAP_SHARE_OF_HEIGHT,
        ERROR_PANEL_SHARE_OF_HEIGHT - PANEL_GAP_SHARE_OF_HEIGHT,
    )
    layout["yaxis"] = {"title": {"text": f"position [{of.unit}]"}, "domain": [top, 1.0]}
    layout["yaxis2"] = {"title": {"text": f"error [{of.unit}]"}, "domain": [0.0, bottom], "anchor": "x"}
    told = {"mode": "lines", "line": {"color": ORANGE, "width": 1.5, "dash": "dash"}}
    traces = [
        *([_line(of, of.told, "commanded", told)] if of.told is not None else []),
        _line(of, of.measured, "measured", MEASURED_STYLE),
        _line(of, of.simulated, "the model", {**ACTUAL_STYLE, **ASIDE}),
    ]
    if of.told is not None:
        traces.append(_line(of, of.told - of.measured, "commanded", {**told, "showlegend": False}, "y2"))
    zero = {"mode": "lines", "line": {"color": GREY, "width": 1}, "hoverinfo": "skip", "showlegend": False}
    traces.append(_line(of, np.zeros(len(of.time)), "measured", zero, "y2"))
    traces.append(_line(of, of.simulated - of.measured, "the model", {**ACTUAL_STYLE, "showlegend": False}, "y2"))
    return {"data": traces, "layout": layout}


def _line(
    of: SimulatedPositionError, value: FloatArray, name: str, look: Mapping[str, Any], axis: str = "y"
) -> dict[str, Any]:
    there = np.isfinite(value)
    time, shown = thinned_signal(of.time[there], value[there])
    drawn = {"x": time.round(4).tolist(), "y": [float(f"{v:.5g}") for v in shown.tolist()]}
    return {"type": "scatter", "name": name, "legendgroup": name, "yaxis": axis, **drawn, **look}
