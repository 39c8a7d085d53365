"""What changed on which day, and every parameter over time: sections of the report of a batch."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import plotly.graph_objects as go

from pipeline.batch.history import DAY, Event, History, between
from pipeline.batch.run import Row
from pipeline.report.page import Chart, Section, Table
from pipeline.report.theme import BLUE, GREEN, GREY, INK, ORANGE, PURPLE, RAW, SHADE, SKY, VERMILLION

COLOURS = (BLUE, ORANGE, GREEN, VERMILLION, PURPLE, SKY)
MOST_EVENTS = 12
"""That have a figure of their own; all are in the table."""
MOST_PARAMETERS = 60
"""That have a figure over time."""
MOST_ROWS = 200
"""Of a table; all rows are in the Parquet file."""


def event_sentence(event: Event, found: History) -> str:
    """What changed, in one line."""
    steps = [f"{s.parameter} {s.before:.4g} → {s.after:.4g} {found.units[s.parameter]}" for s in event.steps[:3]]
    more = f" and {len(event.steps) - 3} more" if len(event.steps) > 3 else ""
    return f"{event.robot}, {between(event)}: {', '.join(steps)}{more}"


@dataclass(frozen=True)
class ChangeSection(Section):
    """Steps, with a figure each, and drifts."""

    title: ClassVar[str] = "What changed"

    found: History

    def sentence(self) -> str:
        """What the marks are worth."""
        test = self.found.found
        text = (
            f"{test.tested} series of a parameter over time were tested. In a batch where nothing changes, a change is "
            f"marked with a probability of {100 * test.false_alarms:.2g} %, and a drift likewise."
        )
        return text + (f" {test.too_short} series are too short or never vary." if test.too_short else "")

    def charts(self) -> Sequence[Chart]:
        """The clearest parameter of each event."""
        return [self._chart(event) for event in self.found.events[:MOST_EVENTS]]

    def _chart(self, event: Event) -> Chart:
        step = event.steps[0]
        series, rows = self.found.series[event.robot, step.parameter], self.found.rows[event.robot, step.parameter]
        std = series.std if series.std is not None else np.zeros_like(series.value)
        figure = go.Figure(layout={"height": 300, "hovermode": "closest", "showlegend": False, "margin": {"t": 34}})
        figure.add_scatter(
            x=1e3 * series.time, y=series.value, mode="markers", marker={"color": BLUE, "size": 6},
            error_y={"type": "data", "array": std, "color": GREY, "thickness": 1, "width": 0},
            text=[row.item.run.name for row in rows],
        )  # fmt: skip
        own = sorted(
            (s for s in self.found.found.steps if (s.robot, s.parameter) == (event.robot, step.parameter)),
            key=lambda s: s.index,
        )
        edges = [0, *(s.index for s in own), len(series.time)]
        for i, level in enumerate([own[0].before, *(s.after for s in own)]):
            ends = 1e3 * series.time[[edges[i], edges[i + 1] - 1]]
            figure.add_scatter(x=ends, y=[level] * 2, mode="lines", line={"color": INK, "width": 1.5, "dash": "dot"})
        for s in own:
            figure.add_vrect(
                x0=1e3 * s.last_before, x1=1e3 * s.first_after, fillcolor=SHADE, line_width=1, line_color=BLUE
            )
        figure.update_layout(**time_axes(_quantity(step.parameter, self.found)))
        return Chart(figure, f"{event_sentence(event, self.found)}. Bars: one standard deviation; dotted: medians.")

    def tables(self) -> Sequence[Table]:
        """Every step, every drift."""
        steps = [
            [
                event.robot, between(event), _plain(s.parameter), f"{s.before:.4g}", f"{s.after:.4g}",
                self.found.units[s.parameter], f"≤ {s.chance:.2g}",
            ]
            for event in self.found.events
            for s in event.steps
        ]  # fmt: skip
        drifts = [
            [
                d.robot, _plain(d.parameter), f"{DAY * d.slope:+.3g}", f"{self.found.units[d.parameter]} per day",
                f"≤ {d.chance:.2g}",
            ]
            for d in self.found.found.drifts
        ]  # fmt: skip
        tables = []
        if steps:
            caption = "Chance: probability of a mark as clear as this one in a batch where nothing changes."
            header = ["robot", "when", "parameter", "before", "after", "unit", "chance"]
            tables.append(Table(header, steps[:MOST_ROWS], caption))
        if drifts:
            caption = "Slow changes, such as wear, without a day: best straight line (Theil and Sen)."
            tables.append(Table(["robot", "parameter", "drift", "unit", "chance"], drifts[:MOST_ROWS], caption))
        return tables


@dataclass(frozen=True)
class TimeSection(Section):
    """A figure per parameter, all robots in it, those that changed in colour."""

    title: ClassVar[str] = "Parameters over time"

    found: History

    @property
    def _parameters(self) -> list[str]:
        """Those that changed first, then as the models have them."""
        changed = [s.parameter for s in self.found.found.steps]
        return list(dict.fromkeys([*changed, *(name for _, name in self.found.series)]))[:MOST_PARAMETERS]

    def sentence(self) -> str:
        """How to read the figures."""
        total = len({name for _, name in self.found.series})
        text = "Each point is the fit of one recording alone. Robots whose parameter changed are in colour."
        return text + (f" Shown: {MOST_PARAMETERS} of {total} parameters." if total > MOST_PARAMETERS else "")

    def tabs(self) -> Mapping[str, str]:
        """A tab per parameter."""
        return {name: _plain(name) for name in self._parameters}

    def charts(self) -> Sequence[Chart]:
        """One per parameter."""
        several = len(self._parameters) > 1
        return [Chart(self._figure(name), tab=name if several else "") for name in self._parameters]

    def _figure(self, name: str) -> go.Figure:
        figure = go.Figure(layout={"height": 380, "hovermode": "closest"})
        changed = list(dict.fromkeys(s.robot for s in self.found.found.steps if s.parameter == name))[: len(COLOURS)]
        robots = [robot for robot, parameter in self.found.series if parameter == name]
        quiet = [robot for robot in robots if robot not in changed]
        if quiet:  # one curve for all of them, with gaps
            series = [self.found.series[robot, name] for robot in quiet]
            gap = np.array([np.nan])
            figure.add_scatter(
                x=1e3 * np.concatenate([part for s in series for part in (s.time, gap)]),
                y=np.concatenate([part for s in series for part in (s.value, gap)]),
                text=[t for r in quiet for t in (*(hover(row) for row in self.found.rows[r, name]), "")],
                name="no change" if changed else "all robots", mode="lines+markers",
                line={"color": RAW, "width": 1}, marker={"color": RAW, "size": 4},
            )  # fmt: skip
        for robot, colour in zip(changed, COLOURS, strict=False):
            s = self.found.series[robot, name]
            figure.add_scatter(
                x=1e3 * s.time, y=s.value, name=robot, mode="lines+markers", line={"color": colour, "width": 1.5},
                marker={"color": colour, "size": 6}, text=[row.item.run.name for row in self.found.rows[robot, name]],
            )  # fmt: skip
        figure.update_layout(**time_axes(_quantity(name, self.found)))
        return figure


def _quantity(parameter: str, found: History) -> str:
    """``torque [N m]`` for ``joint_coulomb_friction.torque[elbow]``: short enough for an axis."""
    name = parameter.partition("[")[0].rpartition(".")[2].replace("_", " ")
    return f"{name} [{found.units[parameter]}]"


def hover(row: Row) -> str:
    """What stands beside the pointer."""
    return f"{row.item.robot}: {row.item.run.name}"


def time_axes(title: str) -> dict[str, Any]:
    """Time across, the rest upwards."""
    return {"xaxis": {"type": "date"}, "yaxis": {"title": {"text": title}}}


def _plain(parameter: str) -> str:
    """``payload mass (wrist_3)`` for ``payload.mass[wrist_3]``."""
    name, bracket, joint = parameter.partition("[")
    text = name.replace(".", " ").replace("_", " ")
    return f"{text} ({joint.removesuffix(']')})" if bracket else text
