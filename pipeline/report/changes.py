"""What changed on which day, and every parameter over time: sections of the report of a batch."""

from typing import Any

import numpy as np
import plotly.graph_objects as go

from armdyn.document import Chart, Section, Table
from pipeline.batch.history import DAY, Event, History, between
from pipeline.batch.run import Row
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


def change_section(history: History) -> Section:
    """Steps, with a figure each of their clearest parameter, and drifts; what the marks are worth."""
    test = history.found
    text = (
        f"{test.tested} series of a parameter over time were tested. In a batch where nothing changes, a change is "
        f"marked with a probability of {100 * test.false_alarms:.2g} %, and a drift likewise."
    )
    text += f" {test.too_short} series are too short or never vary." if test.too_short else ""
    charts = [_event_chart(event, history) for event in history.events[:MOST_EVENTS]]
    return Section("What changed", text, charts, _change_tables(history))


def _event_chart(event: Event, history: History) -> Chart:
    step = event.steps[0]
    series, rows = history.series[event.robot, step.parameter], history.rows[event.robot, step.parameter]
    std = series.std if series.std is not None else np.zeros_like(series.value)
    figure = go.Figure(layout={"height": 300, "hovermode": "closest", "showlegend": False, "margin": {"t": 34}})
    figure.add_scatter(
        x=1e3 * series.time, y=series.value, mode="markers", marker={"color": BLUE, "size": 6},
        error_y={"type": "data", "array": std, "color": GREY, "thickness": 1, "width": 0},
        text=[row.item.run.name for row in rows],
    )  # fmt: skip
    own = sorted(
        (s for s in history.found.steps if (s.robot, s.parameter) == (event.robot, step.parameter)),
        key=lambda s: s.index,
    )
    edges = [0, *(s.index for s in own), len(series.time)]
    for i, level in enumerate([own[0].before, *(s.after for s in own)]):
        ends = 1e3 * series.time[[edges[i], edges[i + 1] - 1]]
        figure.add_scatter(x=ends, y=[level] * 2, mode="lines", line={"color": INK, "width": 1.5, "dash": "dot"})
    for s in own:
        figure.add_vrect(x0=1e3 * s.last_before, x1=1e3 * s.first_after, fillcolor=SHADE, line_width=1, line_color=BLUE)
    figure.update_layout(**time_axes(_quantity(step.parameter, history)))
    return Chart(figure, f"{event_sentence(event, history)}. Bars: one standard deviation; dotted: medians.")


def _change_tables(history: History) -> list[Table]:
    """Every step, every drift."""
    steps = [
        [
            event.robot, between(event), _plain(s.parameter), f"{s.before:.4g}", f"{s.after:.4g}",
            history.units[s.parameter], f"≤ {s.chance:.2g}",
        ]
        for event in history.events
        for s in event.steps
    ]  # fmt: skip
    drifts = [
        [
            d.robot, _plain(d.parameter), f"{DAY * d.slope:+.3g}", f"{history.units[d.parameter]} per day",
            f"≤ {d.chance:.2g}",
        ]
        for d in history.found.drifts
    ]  # fmt: skip
    tables = []
    if steps:
        caption = "Chance: probability of a mark as clear as this one in a batch where nothing changes."
        header = ["robot", "when", "parameter", "before", "after", "unit", "chance"]
        tables.append(Table.of(header, steps[:MOST_ROWS], caption))
    if drifts:
        caption = "Slow changes, such as wear, without a day: best straight line (Theil and Sen)."
        tables.append(Table.of(["robot", "parameter", "drift", "unit", "chance"], drifts[:MOST_ROWS], caption))
    return tables


def time_section(history: History) -> Section:
    """A figure and a tab per parameter, all robots in it; those parameters first that changed."""
    changed = [s.parameter for s in history.found.steps]
    names = list(dict.fromkeys([*changed, *(name for _, name in history.series)]))
    shown = names[:MOST_PARAMETERS]
    text = "Each point is the fit of one recording alone. Robots whose parameter changed are in colour."
    text += f" Shown: {MOST_PARAMETERS} of {len(names)} parameters." if len(names) > MOST_PARAMETERS else ""
    charts = [Chart(_figure_over_time(name, history), tab=name if len(shown) > 1 else "") for name in shown]
    return Section("Parameters over time", text, charts, tabs={name: _plain(name) for name in shown})


def _figure_over_time(name: str, history: History) -> go.Figure:
    figure = go.Figure(layout={"height": 380, "hovermode": "closest"})
    changed = list(dict.fromkeys(s.robot for s in history.found.steps if s.parameter == name))[: len(COLOURS)]
    robots = [robot for robot, parameter in history.series if parameter == name]
    quiet = [robot for robot in robots if robot not in changed]
    if quiet:  # one curve for all of them, with gaps
        series = [history.series[robot, name] for robot in quiet]
        gap = np.array([np.nan])
        figure.add_scatter(
            x=1e3 * np.concatenate([part for s in series for part in (s.time, gap)]),
            y=np.concatenate([part for s in series for part in (s.value, gap)]),
            text=[t for r in quiet for t in (*(hover(row) for row in history.rows[r, name]), "")],
            name="no change" if changed else "all robots", mode="lines+markers",
            line={"color": RAW, "width": 1}, marker={"color": RAW, "size": 4},
        )  # fmt: skip
    for robot, colour in zip(changed, COLOURS, strict=False):
        s = history.series[robot, name]
        figure.add_scatter(
            x=1e3 * s.time, y=s.value, name=robot, mode="lines+markers", line={"color": colour, "width": 1.5},
            marker={"color": colour, "size": 6}, text=[row.item.run.name for row in history.rows[robot, name]],
        )  # fmt: skip
    figure.update_layout(**time_axes(_quantity(name, history)))
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
