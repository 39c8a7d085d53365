"""Figures and tables of the report of a batch: changes by day, and parameters and errors over time."""

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import plotly.graph_objects as go

from armdyn.document import Chart, Column, Section, Table, attribute_columns
from pipeline.batch.history import DAY_SECONDS, ChangeEvent, ParameterHistory, step_period_text
from pipeline.batch.run import BatchRow
from pipeline.report.theme import BLUE, BLUE_BAND_FILL, CURVE_COLOURS, GREY, PALE_BLUE_GREY, TEXT_COLOUR, VERMILLION

MAX_CHANGE_CHARTS = 12
"""Largest number of changes that have a figure; the table lists all changes."""
MAX_PARAMETER_CHARTS = 60
"""Largest number of parameters that have a figure over time."""
MAX_TABLE_ROWS = 200
"""Largest number of rows of a table in the report of a batch; the Parquet file has all rows."""


def parameter_change_section(history: ParameterHistory) -> Section:
    """Section on sudden changes and slow drifts of parameters: two tables, and a figure for each sudden change."""
    test = history.change_test
    text = (
        f"{test.tested} series of a parameter over time were tested. In a batch where nothing changes, a change is "
        f"marked with a probability of {100 * test.false_alarms:.2g} %, and a drift likewise."
    )
    text += f" {test.untested_series_count} series are too short or never vary." if test.untested_series_count else ""
    charts = [_event_chart(event, history) for event in history.events[:MAX_CHANGE_CHARTS]]
    steps = [(event, step) for event in history.events for step in event][:MAX_TABLE_ROWS]
    drifts = test.drifts[:MAX_TABLE_ROWS]
    tables = [
        Table(
            [
                Column("robot", [step.robot for _, step in steps]),
                Column("when", [step_period_text(event[0]) for event, _ in steps]),
                Column("parameter", [_plain(step.parameter) for _, step in steps]),
                *attribute_columns([step for _, step in steps], before=".4g", after=".4g"),
                Column("unit", [history.units[step.parameter] for _, step in steps]),
                Column("chance", [f"≤ {step.chance:.2g}" for _, step in steps]),
            ],
            "Chance: probability of a mark as clear as this one in a batch where nothing changes.",
        ),
        Table(
            [
                Column("robot", [drift.robot for drift in drifts]),
                Column("parameter", [_plain(drift.parameter) for drift in drifts]),
                Column("drift", [DAY_SECONDS * drift.slope for drift in drifts], "+.3g"),
                Column("unit", [f"{history.units[drift.parameter]} per day" for drift in drifts]),
                Column("chance", [f"≤ {drift.chance:.2g}" for drift in drifts]),
            ],
            "Slow changes, such as wear, without a day: best straight line (Theil and Sen).",
        ),
    ]
    return Section("What changed", text, charts, [table for table in tables if len(table)])


def _event_chart(event: ChangeEvent, history: ParameterHistory) -> Chart:
    first, *_ = event
    name = first.parameter
    series = history.series[first.robot, name]
    figure = _over_time(_quantity(name, history), 300, showlegend=False, margin={"t": 34})
    bars = {"type": "data", "array": series.std, "color": GREY, "thickness": 1, "width": 0}
    _add_points(figure, "", history.rows[first.robot, name], 1e3 * series.time, series.value, BLUE, error_y=bars)
    mine = (s for s in history.change_test.steps if (s.robot, s.parameter) == (first.robot, name))
    own = sorted(mine, key=lambda s: s.index)
    edges = pairwise([0, *(s.index for s in own), len(series.time)])
    for (begin, end), level in zip(edges, [own[0].before, *(s.after for s in own)], strict=True):
        dotted = {"color": TEXT_COLOUR, "width": 1.5, "dash": "dot"}
        figure.add_scatter(x=1e3 * series.time[[begin, end - 1]], y=[level] * 2, mode="lines", line=dotted)
    for s in own:
        figure.add_vrect(
            x0=1e3 * s.last_before, x1=1e3 * s.first_after, fillcolor=BLUE_BAND_FILL, line_width=1, line_color=BLUE
        )
    steps = [f"{s.parameter} {s.before:.4g} → {s.after:.4g} {history.units[s.parameter]}" for s in event[:3]]
    more = f" and {len(event) - 3} more" if len(event) > 3 else ""
    what = f"{first.robot}, {step_period_text(first)}: {', '.join(steps)}{more}"
    return Chart(figure, f"{what}. Bars: one standard deviation; dotted: medians.")


def parameter_history_section(history: ParameterHistory) -> Section:
    """Section with a figure of each parameter over time for all robots; parameters that changed come first."""
    changed = [s.parameter for s in history.change_test.steps]
    names = list(dict.fromkeys([*changed, *(name for _, name in history.series)]))
    shown = names[:MAX_PARAMETER_CHARTS]
    text = "Each point is the fit of one recording alone. Robots whose parameter changed are in colour."
    text += f" Shown: {MAX_PARAMETER_CHARTS} of {len(names)} parameters." if len(names) > MAX_PARAMETER_CHARTS else ""
    charts = [Chart(_figure_over_time(name, history), tab=name if len(shown) > 1 else "") for name in shown]
    return Section("Parameters over time", text, charts, tabs={name: _plain(name) for name in shown})


def _figure_over_time(name: str, history: ParameterHistory) -> go.Figure:
    figure = _over_time(_quantity(name, history), 380)
    changed = list(dict.fromkeys(s.robot for s in history.change_test.steps if s.parameter == name))[
        : len(CURVE_COLOURS)
    ]
    quiet = [robot for robot, parameter in history.series if parameter == name and robot not in changed]
    if quiet:  # one curve for all segments, with gaps
        series = [history.series[robot, name] for robot in quiet]
        gap = np.array([np.nan])
        figure.add_scatter(
            x=1e3 * np.concatenate([part for s in series for part in (s.time, gap)]),
            y=np.concatenate([part for s in series for part in (s.value, gap)]),
            text=[text for robot in quiet for text in (*map(_hover, history.rows[robot, name]), "")],
            name="no change" if changed else "all robots", mode="lines+markers",
            line={"color": PALE_BLUE_GREY, "width": 1}, marker={"color": PALE_BLUE_GREY, "size": 4},
        )  # fmt: skip
    for robot, colour in zip(changed, CURVE_COLOURS, strict=False):
        of, line = history.series[robot, name], {"color": colour, "width": 1.5}
        rows = history.rows[robot, name]
        _add_points(figure, robot, rows, 1e3 * of.time, of.value, colour, mode="lines+markers", line=line)
    return figure


def error_history_chart(unit: str, points: Sequence[tuple[float, BatchRow]]) -> Chart:
    """Figure of the errors of recordings over time; recordings that the model explains have another colour.

    Args:
        unit: unit of the errors.
        points: error and result of each recording.
    """
    figure = _over_time(f"error [{unit}]", 320)
    for name, colour, wanted in (("explained", PALE_BLUE_GREY, True), ("not explained", VERMILLION, False)):
        mine = [(error, row) for error, row in points if (row.outcome.verdict == "explained") is wanted]
        if mine:
            errors, rows = zip(*mine, strict=True)
            _add_points(figure, name, rows, [row.item.recording_time.time for row in rows], errors, colour)
    figure.update_yaxes(rangemode="tozero")
    return Chart(figure)


def _over_time(title: str, height: int, **layout: Any) -> go.Figure:
    figure = go.Figure(layout={"height": height, "hovermode": "closest", "xaxis": {"type": "date"}, **layout})
    return figure.update_yaxes(title_text=title)


def _add_points(
    figure: go.Figure, name: str, rows: Sequence[BatchRow], days: Any, values: Any, colour: str, **look: Any
) -> None:
    look = {"mode": "markers", "marker": {"color": colour, "size": 5}, **look}
    figure.add_scatter(x=days, y=values, name=name, text=list(map(_hover, rows)), **look)


def _hover(row: BatchRow) -> str:
    return f"{row.item.robot}: {row.item.run.name}"


def _quantity(parameter: str, found: ParameterHistory) -> str:
    """Short title of an axis, such as ``torque [N m]`` for ``joint_coulomb_friction.torque[elbow]``."""
    name = parameter.partition("[")[0].rpartition(".")[2].replace("_", " ")
    return f"{name} [{found.units[parameter]}]"


def _plain(parameter: str) -> str:
    """A parameter's name in plain words, such as ``payload mass (wrist_3)`` for ``payload.mass[wrist_3]``."""
    name, bracket, joint = parameter.partition("[")
    text = name.replace(".", " ").replace("_", " ")
    return f"{text} ({joint.removesuffix(']')})" if bracket else text
