"""The swing in the plane of the line: planned, executed, string and box."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import plotly.graph_objects as go

from armdyn.channels import FloatArray
from pipeline.box import Box
from pipeline.report.page import Chart, Section
from pipeline.report.theme import ACTUAL, BLUE, FAINT, GREY, INK, REFERENCE, number


@dataclass(frozen=True)
class SwingTrace:
    """Gripper and load in the vertical plane of the line during the swing.

    Attributes:
        time: (n,) [s].
        gripper_x: (n,) [m] along the line.
        load_x: (n,) [m] along the line.
        load_z: (n,) [m] over the line, negative below.
    """

    time: FloatArray
    gripper_x: FloatArray
    load_x: FloatArray
    load_z: FloatArray


@dataclass(frozen=True)
class SwingPicture:
    """The planned swing and what became of it.

    Attributes:
        planned: from the optimiser.
        executed: as measured or simulated; None where the swing was not run.
        box: None where there is none.
        load_radius: [m].
        snapshots: how many positions of the string are drawn.
    """

    planned: SwingTrace
    executed: SwingTrace | None
    box: Box | None
    load_radius: float = 0.014
    snapshots: int = 9


@dataclass(frozen=True)
class SwingSection(Section):
    """Paths of gripper and load, with snapshots of the string."""

    title: ClassVar[str] = "Swing"

    swing: SwingPicture

    def sentence(self) -> str:
        """How far the executed load was from the planned one where the plan ends."""
        executed, planned = self.swing.executed, self.swing.planned
        if executed is None:
            return "The swing was planned and not executed."
        end = float(planned.time[-1])
        if executed.time[-1] < end:
            return f"The swing was stopped after {executed.time[-1] - executed.time[0]:.2f} s, before the plan's end."
        across = np.interp(end, executed.time, executed.load_x) - planned.load_x[-1]
        up = np.interp(end, executed.time, executed.load_z) - planned.load_z[-1]
        return (
            f"Where the plan ends the load was {number(float(np.hypot(across, up)), 'm', 2)} from its planned place "
            f"({number(float(across), 'm', 2)} along the line, {number(float(up), 'm', 2)} up)."
        )

    def charts(self) -> Sequence[Chart]:
        """The picture, to scale."""
        swing = self.swing
        shown = swing.executed or swing.planned
        figure = go.Figure(layout={"height": 520, "hovermode": "closest"})
        _add_strings(figure, shown, swing.snapshots, swing.load_radius)
        if swing.box is not None:
            _add_box(figure, swing.box)
        figure.add_scatter(
            x=shown.gripper_x, y=0 * shown.gripper_x, name="gripper", mode="lines", line={"color": INK, "width": 3}
        )
        if swing.executed is not None:
            figure.add_scatter(x=swing.executed.load_x, y=swing.executed.load_z, name="load, executed", **ACTUAL)
        figure.add_scatter(x=swing.planned.load_x, y=swing.planned.load_z, name="load, planned", **REFERENCE)
        figure.update_layout(
            xaxis={"title": {"text": "along the line [m]"}},
            yaxis={"title": {"text": "height over the line [m]"}, "scaleanchor": "x"},
        )
        kind = "executed" if swing.executed is not None else "planned"
        return [Chart(figure, f"To scale. Thin lines: the string at {swing.snapshots} equally spaced times, {kind}.")]


def _add_strings(figure: go.Figure, trace: SwingTrace, count: int, radius: float) -> None:
    """The string as one broken line, and the load as discs of its true size."""
    times = np.linspace(trace.time[0], trace.time[-1], count)
    gripper, x, z = (np.interp(times, trace.time, path) for path in (trace.gripper_x, trace.load_x, trace.load_z))
    gap = np.full(count, np.nan)
    line: dict[str, Any] = {"color": GREY, "width": 1}
    figure.add_scatter(
        x=np.stack([gripper, x, gap], axis=1).ravel(),
        y=np.stack([0 * z, z, gap], axis=1).ravel(),
        name="string",
        mode="lines",
        line=line,
        hoverinfo="skip",
    )
    for i in range(count):
        disc = {"type": "circle", "x0": x[i] - radius, "x1": x[i] + radius, "y0": z[i] - radius, "y1": z[i] + radius}
        figure.add_shape(**disc, line=line, fillcolor=BLUE, opacity=0.25 + 0.6 * i / max(count - 1, 1), layer="below")


def _add_box(figure: go.Figure, box: Box) -> None:
    near, far = box.near_wall, box.near_wall + box.width
    rim, floor = -box.rim, -box.rim - box.height
    figure.add_scatter(
        x=[near, near, far, far],
        y=[rim, floor, floor, rim],
        name="box",
        mode="lines",
        line={"color": INK, "width": 4},
        fill="toself",
        fillcolor=FAINT,
    )
