"""Report of a batch (one task for many recordings): changes by day, parameters and errors over time, unusable files."""

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from armdyn.document import Column, Document, KeyFigure, NextStep, ResultLevel, Section, Table
from armdyn.identify.sentence import total_errors
from armdyn.quoting import shell_quoted_command
from pipeline.batch.history import ParameterHistory
from pipeline.batch.run import BatchResult, BatchRow
from pipeline.batch.spec import BatchSpec
from pipeline.batch.times import RecordingTimeSource
from pipeline.report.changes import (
    MAX_TABLE_ROWS,
    error_history_chart,
    parameter_change_section,
    parameter_history_section,
)


def batch_report(spec: BatchSpec, done: BatchResult, found: ParameterHistory) -> Document:
    """Report of a batch: which parameters changed and when, errors over time, a table of robots, unusable recordings.

    Args:
        spec: task and recordings of the batch.
        done: results, one row for each recording.
        found: parameters over time, with their changes and drifts.
    """
    bad = [row for row in done.rows if row.outcome.problem]
    explained = verdict_counts(done.rows).get("explained", 0)
    chance = f"{100 * found.change_test.false_alarms:.2g} % chance of a false one"
    return Document(
        title=f"Batch: {spec.task} for {len(done.rows)} recordings",
        level=ResultLevel.CAUTION if found.events or bad or done.unfinished else ResultLevel.GOOD,
        verdict=_summary(done, found),
        sections=[
            parameter_change_section(found),
            *([parameter_history_section(found)] if found.series else []),
            _error_section(done.rows),
            _robot_section(done.rows),
            *([_bad_section(spec, bad)] if bad else []),
        ],
        subtitle=f"{len({row.item.robot for row in done.rows})} robots, rows in batch.parquet",
        key_figures=(
            KeyFigure("Recordings", str(len(done.rows)), f"{done.computed} done this time"),
            KeyFigure("Explained", str(explained), "only noise is left"),
            KeyFigure("Changes", str(len(found.events)), chance),
            KeyFigure("Not usable", str(len(bad)), "see below" if bad else ""),
        ),
        notes=[_times_sentence(done.rows)],
        next_steps=_next_steps(spec, done.rows),
    )


def verdict_counts(rows: Sequence[BatchRow]) -> dict[str, int]:
    """Number of recordings with each verdict; recordings that could not be used have no verdict."""
    return dict(Counter(row.outcome.verdict for row in rows if row.outcome.verdict).most_common())


def _summary(done: BatchResult, found: ParameterHistory) -> str:
    counts = [f"{count} {name.replace('_', ' ')}" for name, count in verdict_counts(done.rows).items()]
    if bad := sum(bool(row.outcome.problem) for row in done.rows):
        counts.append(f"{bad} could not be used")
    text = f"{len(done.rows)} recordings of {len({row.item.robot for row in done.rows})} robots"
    text += f": {', '.join(counts)}." if counts else "."
    if changed := list(dict.fromkeys(event[0].robot for event in found.events)):
        shown = ", ".join(changed[:6]) + (f" and {len(changed) - 6} more" if len(changed) > 6 else "")
        text += f" {len(found.events)} {'change' if len(found.events) == 1 else 'changes'}: {shown}."
    elif found.change_test.tested:
        text += " No parameter changed on a day."
    if drifting := len({d.robot for d in found.change_test.drifts}):
        text += f" Parameters of {drifting} {'robot drifts' if drifting == 1 else 'robots drift'}."
    return text + (f" {done.unfinished} recordings are left." if done.unfinished else "")


def _times_sentence(rows: Sequence[BatchRow]) -> str:
    """Sentence that names the source of the recordings' times; times are never guessed silently."""
    counts = Counter(row.item.recording_time.source for row in rows)
    nowhere = counts.pop(RecordingTimeSource.NOWHERE, 0)
    parts = [f"{counts[source]} from {source.value}" for source in RecordingTimeSource if counts[source]]
    text = f"Times of recordings: {', '.join(parts) or 'none is known'}."
    if nowhere:
        problems = Counter(row.item.recording_time.problem for row in rows if row.item.recording_time.time is None)
        why = "; ".join(f"{count} because of '{problem}'" for problem, count in problems.most_common(3))
        text += f" {nowhere} have none and stand in no figure over time: {why}."
    return text


def _next_steps(spec: BatchSpec, rows: Sequence[BatchRow]) -> list[NextStep]:
    failed = [row for row in rows if row.outcome.verdict not in ("", "explained")]
    if spec.task != "compare" or not failed:
        return []
    robot = Counter(row.item.robot for row in failed).most_common(1)[0][0]
    mine = [row.item for row in failed if row.item.robot == robot]
    files = [mine[0].model, *[item.run for item in mine if item.model == mine[0].model][:3]]
    here = Path.cwd()
    typed = [file.relative_to(here) if file.is_relative_to(here) else file for file in files]
    command = shell_quoted_command("repair", *typed, "--output", "repaired.toml", "--report", "repair.html")
    return [NextStep(f"What the model of {robot} lacks", command)]


def _error_section(rows: Sequence[BatchRow]) -> Section:
    errors: dict[str, list[tuple[float, BatchRow]]] = {}
    for row in rows:
        channels = row.outcome.channels or {}
        if row.item.recording_time.time is None or any(channel["rmse"] is None for channel in channels.values()):
            continue
        rmse = {name: float(channel["rmse"]) for name, channel in channels.items()}
        for unit, error in total_errors(rmse, {name: channel["unit"] for name, channel in channels.items()}).items():
            errors.setdefault(unit, []).append((error, row))
    return Section(
        "Errors over time",
        "Root mean square error of every recording's own fit; of several channels the root of their summed "
        "squares. A jump that no parameter shows is something that the model lacks.",
        [error_history_chart(unit, points) for unit, points in errors.items()],
    )


def _robot_section(rows: Sequence[BatchRow]) -> Section:
    table = []
    for robot in list(dict.fromkeys(row.item.robot for row in rows))[:MAX_TABLE_ROWS]:
        mine = [row for row in rows if row.item.robot == robot]
        good = [row for row in mine if row.outcome.verdict]
        times = sorted(row.item.recording_time.time for row in mine if row.item.recording_time.time is not None)
        effects = Counter(effect for row in good for effect in row.outcome.effects)
        table.append([
            robot, str(len(mine)), str(sum(row.outcome.verdict == "explained" for row in good)),
            str(len(mine) - len(good)), f"{times[0]:%Y-%m-%d} to {times[-1]:%Y-%m-%d}" if times else "no time",
            ", ".join(name if n == len(good) else f"{name} ({n})" for name, n in effects.most_common(8)),
        ])  # fmt: skip
    header = ["robot", "recordings", "explained", "not usable", "time", "effects of the model"]
    caption = "In brackets: recordings in which an effect was added, where it is not all."
    return Section("Robots", tables=[Table.of(header, table, caption)])


def _bad_section(spec: BatchSpec, bad: Sequence[BatchRow]) -> Section:
    listed = bad[:MAX_TABLE_ROWS]
    columns = [
        Column("robot", [row.item.robot for row in listed]),
        Column("recording", [spec.relative_name(row.item.run) for row in listed]),
        Column("what is wrong", [row.outcome.problem for row in listed]),
    ]
    sentence = f"{len(bad)} recordings could not be used; none of them stopped the batch."
    return Section("Not usable", sentence, tables=[Table(columns)])
