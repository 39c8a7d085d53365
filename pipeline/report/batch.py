"""The report of a batch: what changed on which day, parameters over time, errors, what could not be used."""

import shlex
from collections import Counter
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
import plotly.graph_objects as go

from armdyn.identify.sentence import totals
from pipeline.batch.history import DAY, Event, History, between
from pipeline.batch.run import Done, Row
from pipeline.batch.spec import Spec
from pipeline.batch.times import TimeFrom
from pipeline.report.page import Chart, KeyFigure, Level, NextStep, Report, Section, Table
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
        tables.append(Table(header, steps[:MOST_ROWS], caption))
    if drifts:
        caption = "Slow changes, such as wear, without a day: best straight line (Theil and Sen)."
        tables.append(Table(["robot", "parameter", "drift", "unit", "chance"], drifts[:MOST_ROWS], caption))
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


def batch_report(spec: Spec, done: Done, found: History, command: str = "") -> Report:
    """The report."""
    bad = [row for row in done.rows if row.outcome.problem]
    explained = verdicts(done.rows).get("explained", 0)
    notes = [times_sentence(done.rows)]
    return Report(
        title=f"Batch: {spec.task} for {len(done.rows)} recordings",
        level=Level.CAUTION if found.events or bad or done.left else Level.GOOD,
        verdict=summary(done, found),
        sections=[
            change_section(found),
            *([time_section(found)] if found.series else []),
            error_section(done.rows),
            robot_section(done.rows),
            *([bad_section(spec, bad)] if bad else []),
        ],
        subtitle=f"{len({row.item.robot for row in done.rows})} robots, rows in batch.parquet",
        key_figures=(
            KeyFigure("Recordings", str(len(done.rows)), f"{done.worked} done this time"),
            KeyFigure("Explained", str(explained), "only noise is left"),
            KeyFigure(
                "Changes", str(len(found.events)), f"{100 * found.found.false_alarms:.2g} % chance of a false one"
            ),
            KeyFigure("Not usable", str(len(bad)), "see below" if bad else ""),
        ),
        notes=notes,
        command=command,
        next_steps=_next_steps(spec, done.rows),
    )


def verdicts(rows: Sequence[Row]) -> dict[str, int]:
    """How often each verdict was given; recordings that could not be used have none."""
    return dict(Counter(row.outcome.verdict for row in rows if row.outcome.verdict).most_common())


def summary(done: Done, found: History) -> str:
    """A sentence or two."""
    robots = {row.item.robot for row in done.rows}
    text = f"{len(done.rows)} recordings of {len(robots)} robots"
    parts = [f"{count} {name.replace('_', ' ')}" for name, count in verdicts(done.rows).items()]
    bad = sum(bool(row.outcome.problem) for row in done.rows)
    parts += [f"{bad} could not be used"] if bad else []
    text += f": {', '.join(parts)}." if parts else "."
    changed = list(dict.fromkeys(event.robot for event in found.events))
    if changed:
        shown = ", ".join(changed[:6]) + (f" and {len(changed) - 6} more" if len(changed) > 6 else "")
        text += f" {len(found.events)} {'change' if len(found.events) == 1 else 'changes'}: {shown}."
    elif found.found.tested:
        text += " No parameter changed on a day."
    drifting = len({d.robot for d in found.found.drifts})
    text += f" Parameters of {drifting} {'robot drifts' if drifting == 1 else 'robots drift'}." if drifting else ""
    return text + (f" {done.left} recordings are left." if done.left else "")


def times_sentence(rows: Sequence[Row]) -> str:
    """Where the times came from: they are never guessed silently."""
    counts = Counter(row.item.when.source for row in rows)
    parts = [
        f"{counts[source]} from {source.value}" for source in TimeFrom if counts[source] and source.value != "nowhere"
    ]
    text = f"Times of recordings: {', '.join(parts) or 'none is known'}."
    if counts[TimeFrom.NOWHERE]:
        problems = Counter(row.item.when.problem for row in rows if row.item.when.time is None)
        why = "; ".join(f"{count} because of '{problem}'" for problem, count in problems.most_common(3))
        text += f" {counts[TimeFrom.NOWHERE]} have none and stand in no figure over time: {why}."
    return text


def _next_steps(spec: Spec, rows: Sequence[Row]) -> tuple[NextStep, ...]:
    if spec.task != "compare":
        return ()
    left = Counter(row.item.robot for row in rows if row.outcome.verdict not in ("", "explained"))
    if not left:
        return ()
    robot = left.most_common(1)[0][0]
    mine = [row for row in rows if row.item.robot == robot and row.outcome.verdict not in ("", "explained")]
    runs = [_typed(row.item.run) for row in mine if row.item.model == mine[0].item.model][:3]
    command = [
        "armdyn",
        "repair",
        _typed(mine[0].item.model),
        *runs,
        "--output",
        "repaired.toml",
        "--report",
        "repair.html",
    ]
    return (NextStep(f"What the model of {robot} lacks", shlex.join(command)),)


def error_section(rows: Sequence[Row]) -> Section:
    """What the models leave, over time: a point per recording, a figure per unit."""
    errors: dict[str, list[tuple[datetime, float, Row]]] = {}
    for row in rows:
        channels = row.outcome.channels or {}
        if row.item.when.time is None or any(channel["rmse"] is None for channel in channels.values()):
            continue
        rmse = {name: float(channel["rmse"]) for name, channel in channels.items()}
        for unit, error in totals(rmse, {name: channel["unit"] for name, channel in channels.items()}).items():
            errors.setdefault(unit, []).append((row.item.when.time, error, row))
    return Section(
        "Errors over time",
        "Root mean square error of every recording's own fit; of several channels the root of their summed "
        "squares. A jump that no parameter shows is something that the model lacks.",
        [_error_chart(unit, points) for unit, points in errors.items()],
    )


def _error_chart(unit: str, points: Sequence[tuple[datetime, float, Row]]) -> Chart:
    figure = go.Figure(layout={"height": 320, "hovermode": "closest"})
    for name, colour, wanted in (("explained", RAW, True), ("something is left", VERMILLION, False)):
        mine = [point for point in points if (point[2].outcome.verdict == "explained") is wanted]
        if mine:
            figure.add_scatter(
                x=[time for time, _, _ in mine], y=[value for _, value, _ in mine], mode="markers", name=name,
                marker={"color": colour, "size": 5}, text=[hover(row) for _, _, row in mine],
            )  # fmt: skip
    figure.update_layout(**time_axes(f"error [{unit}]"))
    figure.update_yaxes(rangemode="tozero")
    return Chart(figure)


def robot_section(rows: Sequence[Row]) -> Section:
    """A row per robot, with counts."""
    table = []
    for robot in list(dict.fromkeys(row.item.robot for row in rows))[:MOST_ROWS]:
        mine = [row for row in rows if row.item.robot == robot]
        good = [row for row in mine if row.outcome.verdict]
        times = sorted(row.item.when.time for row in mine if row.item.when.time is not None)
        effects = Counter(effect for row in good for effect in row.outcome.effects)
        table.append([
            robot, str(len(mine)), str(sum(row.outcome.verdict == "explained" for row in good)),
            str(len(mine) - len(good)), f"{times[0]:%Y-%m-%d} to {times[-1]:%Y-%m-%d}" if times else "no time",
            ", ".join(name if n == len(good) else f"{name} ({n})" for name, n in effects.most_common(8)),
        ])  # fmt: skip
    header = ["robot", "recordings", "explained", "not usable", "time", "effects of the model"]
    caption = "In brackets: recordings in which an effect was added, where it is not all."
    return Section("Robots", tables=[Table(header, table, caption)])


def bad_section(spec: Spec, bad: Sequence[Row]) -> Section:
    """Recordings that could not be used, each with what to do."""
    rows = [[row.item.robot, spec.name(row.item.run), row.outcome.problem] for row in bad[:MOST_ROWS]]
    sentence = f"{len(bad)} recordings could not be used; none of them stopped the batch."
    return Section("Not usable", sentence, tables=[Table(["robot", "recording", "what is wrong"], rows)])


def _typed(path: Path) -> str:
    """A path as it is typed where the batch was started."""
    here = Path.cwd()
    return str(path.relative_to(here) if path.is_relative_to(here) else path)
