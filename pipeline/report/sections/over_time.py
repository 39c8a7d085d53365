"""Figures over time: stacked rows that share their axis and the phases behind them."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import plotly.graph_objects as go

from armdyn.channels import FloatArray
from pipeline.report.theme import BAND, LINKED_TIME, TIME_AXIS, Phase, phase_marks


def stacked(rows: Sequence[str], heights: Sequence[float], phases: Sequence[Phase], height: int) -> go.Figure:
    """An empty figure with one row per vertical axis.

    Args:
        rows: title of each vertical axis, with its unit, from the top.
        heights: share of each row; they add up to 1.
        phases: shaded behind all rows.
        height: px.
    """
    gap = 0.06
    inner = 1.0 - gap * (len(rows) - 1)
    layout: dict[str, Any] = {"height": height, "meta": LINKED_TIME, **phase_marks(phases)}
    layout["xaxis"] = {"title": {"text": TIME_AXIS}, "anchor": f"y{len(rows) if len(rows) > 1 else ''}"}
    if phases:  # the same stretch of time in every figure
        layout["xaxis"] |= {"range": [phases[0].start, phases[-1].end]}
    top = 1.0
    for i, (title, share) in enumerate(zip(rows, heights, strict=True), start=1):
        bottom = max(0.0, top - share * inner)
        layout[f"yaxis{i if i > 1 else ''}"] = {"title": {"text": title}, "domain": [bottom, top], "anchor": "x"}
        top = bottom - gap
    return go.Figure(layout=layout)


def add_band(
    figure: go.Figure, time: FloatArray, middle: FloatArray, half: FloatArray, name: str, axis: str = "y"
) -> None:
    """A shaded band of `half` above and below `middle`, (n,) each."""
    both = np.concatenate([time, time[::-1]])
    edge = np.concatenate([middle + half, (middle - half)[::-1]])
    figure.add_scatter(x=both, y=edge, fill="toself", name=name, yaxis=axis, **BAND)
