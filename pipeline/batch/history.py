"""The parameters of a batch over time: a series per robot and parameter, and its changes with their dates."""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import TypeAlias

import numpy as np

from pipeline.batch.change import ParameterChangeTestResult, ParameterStep, SeriesKey, find_changes
from pipeline.batch.run import BatchRow
from pipeline.batch.series import ParameterSeries
from pipeline.batch.spec import BatchSpec

UNIX_EPOCH = datetime(1970, 1, 1)
DAY_SECONDS = 86400.0


ChangeEvent: TypeAlias = tuple[ParameterStep, ...]
"""Steps of one robot's parameters at about the same time, the clearest first."""


@dataclass(frozen=True)
class ParameterHistory:
    """The parameters of a batch over time, and their changes.

    Attributes:
        series: fitted values over time, by robot and parameter.
        rows: recordings of each series in the order of time, by robot and parameter.
        units: unit of each parameter.
        found: result of the test for changes.
        events: significant steps, grouped by robot and time, in the order of time.
    """

    series: dict[SeriesKey, ParameterSeries]
    rows: dict[SeriesKey, list[BatchRow]]
    units: dict[str, str]
    change_test: ParameterChangeTestResult
    events: tuple[ChangeEvent, ...]


def parameter_history(spec: BatchSpec, rows: Sequence[BatchRow]) -> ParameterHistory:
    """Collect the parameters over time from the rows of a batch, and test them for changes."""
    several = {item.robot for item in spec.items if len({i.model for i in spec.items if i.robot == item.robot}) > 1}
    points: dict[SeriesKey, list[tuple[float, float, float, BatchRow]]] = {}
    units: dict[str, str] = {}
    for row in rows:
        item, time = row.item, row.item.recording_time.time
        if time is None:
            continue
        robot = f"{item.robot} ({spec.relative_name(item.model)})" if item.robot in several else item.robot
        for name, parameter in (row.outcome.parameters or {}).items():
            if parameter["fitted"] and parameter["value"] is not None and parameter["std"] is not None:
                units[name] = parameter["unit"]
                point = ((time - UNIX_EPOCH).total_seconds(), parameter["value"], parameter["std"], row)
                points.setdefault((robot, name), []).append(point)
    series, of = {}, {}
    for key, found in points.items():
        found.sort(key=lambda point: point[0])
        times, value, std = (np.array([point[i] for point in found], dtype=float) for i in range(3))
        series[key], of[key] = ParameterSeries(times, value, std), [point[3] for point in found]
    changes = find_changes(series, spec.false_alarms)
    return ParameterHistory(series, of, units, changes, _events(changes.steps))


def _events(steps: Sequence[ParameterStep]) -> tuple[ChangeEvent, ...]:
    """Group steps of one robot whose periods overlap, within a day, to events in the order of time."""
    events: list[list[ParameterStep]] = []
    for step in steps:
        for event in events:
            first = event[0]
            if (
                step.robot == first.robot
                and step.last_before <= first.first_after + DAY_SECONDS
                and first.last_before <= step.first_after + DAY_SECONDS
            ):
                event.append(step)
                break
        else:
            events.append([step])
    return tuple(map(tuple, sorted(events, key=lambda event: (event[0].first_after, event[0].robot))))


def utc_datetime(seconds: float) -> datetime:
    """Convert a time in seconds since 1970 to a date and time in UTC."""
    return UNIX_EPOCH + timedelta(seconds=seconds)


def step_period_text(step: ParameterStep) -> str:
    """The period in which a parameter changed, such as ``between 2026-05-03 and 2026-05-04``.

    If the period lies within one day, the text has the times of day.
    """
    first, last = utc_datetime(step.last_before), utc_datetime(step.first_after)
    if first.date() == last.date():
        return f"on {first:%Y-%m-%d} between {first:%H:%M} and {last:%H:%M}"
    return f"between {first:%Y-%m-%d} and {last:%Y-%m-%d}"
