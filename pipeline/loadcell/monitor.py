"""Statistics of a load cell's samples, shown as tables and written as JSON."""

import math
from collections import deque
from collections.abc import Iterable
from statistics import fmean, stdev
from typing import Any

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from pipeline.fields import attributes_as_json, finite_or_none
from pipeline.loadcell.faults import LoadCellFaultEvent, LoadCellStatus
from pipeline.loadcell.fit import CalibrationFit
from pipeline.robot.protocol import ForceSample

STATISTICS_WINDOW_SECONDS = 1.0
"""Time over which the latest mean and standard deviation are computed [s]."""
MAX_KEPT_EVENTS = 1000
"""Largest number of fault events that are stored."""


class ForceStatistics:
    """Collects statistics of a load cell's samples, and its fault events, in constant memory.

    Attributes:
        events: the latest `MAX_KEPT_EVENTS` fault events, oldest first.
        samples: number of samples.
        mean: mean of all forces [N].
        minimum: smallest force [N].
        maximum: largest force [N].
    """

    def __init__(self) -> None:
        self.events: deque[LoadCellFaultEvent] = deque(maxlen=MAX_KEPT_EVENTS)
        self.samples = 0
        self.mean, self.minimum, self.maximum = math.nan, math.inf, -math.inf
        self._squares = 0.0
        self._latest: deque[ForceSample] = deque()

    def add(self, samples: Iterable[ForceSample], events: Iterable[LoadCellFaultEvent]) -> None:
        """Add samples and fault events that have arrived since the last call."""
        self.events.extend(events)
        for sample in samples:
            self.samples += 1
            # Welford, Technometrics 4, 419, 1962: a plain sum of squares loses the small noise of a large force.
            before = sample.force - (0.0 if self.samples == 1 else self.mean)
            self.mean = sample.force if self.samples == 1 else self.mean + before / self.samples
            self._squares += before * (sample.force - self.mean)
            self.minimum, self.maximum = min(self.minimum, sample.force), max(self.maximum, sample.force)
            self._latest.append(sample)
            while self._latest[0].time < sample.time - STATISTICS_WINDOW_SECONDS:
                self._latest.popleft()

    @property
    def std(self) -> float:
        """Standard deviation of all samples of force [N]; nan before the second sample."""
        return math.sqrt(self._squares / (self.samples - 1)) if self.samples > 1 else math.nan

    @property
    def latest(self) -> tuple[float, float, float]:
        """Latest force, its mean and deviation over the last `STATISTICS_WINDOW_SECONDS` [N]; nan without samples."""
        forces = [sample.force for sample in self._latest]
        if not forces:
            return math.nan, math.nan, math.nan
        return forces[-1], fmean(forces), stdev(forces) if len(forces) > 1 else math.nan


def calibration_table(fit: CalibrationFit) -> RenderableType:
    """Table of the weights and results of a load cell's calibration, for the screen."""
    # The backslash prevents that a unit in brackets is read as a style.
    table = Table("weight", r"force \[N]", "counts", r"residual \[mN]", r"noise \[counts]", "left out")
    for plateau, residual in zip(fit.measurements, fit.residuals, strict=True):
        table.add_row(
            plateau.weight.text,
            f"{plateau.weight.force:.4f}",
            f"{plateau.mean:.1f} ± {plateau.mean_std:.1f}",
            f"{1e3 * residual:+.2f}",
            f"{plateau.noise:.1f}",
            str(plateau.outliers),
        )
    summary = (
        f"offset {fit.offset:.1f} ± {fit.offset_std:.1f} counts, scale {1e6 * fit.scale:.5g} ± "
        f"{1e6 * fit.scale_std:.2g} µN/count, noise {1e3 * fit.noise:.2g} mN"
    )
    return Group(table, Text(summary))


def monitor_table(seen: ForceStatistics, status: LoadCellStatus, start: float) -> RenderableType:
    """Table of a load cell's forces and faults for the screen; times in it count from `start` [s]."""
    force, mean, std = seen.latest
    table = Table(show_header=False, min_width=60)
    table.add_row("force", f"{force:8.4f} N")
    table.add_row("last second", f"{mean:8.4f} N ± {1e3 * std:.2f} mN")
    table.add_row("rate", f"{status.rate:6.1f} Hz, {status.samples} samples")
    table.add_row("now", "\n".join(f"[red]{fault.value}[/]" for fault in status.active) or "[green]in order[/]")
    counts = [f"{fault.name.lower()} {count}" for fault, count in status.counts.items() if count]
    table.add_row("faults", ", ".join(counts) or "none")
    for event in list(seen.events)[-5:]:
        what = event.fault.name.lower() + ("" if event.began else " is over")
        table.add_row(f"{event.time - start:.2f} s", what)
    return table


def calibration_json(fit: CalibrationFit, rate: float) -> dict[str, Any]:
    """JSON output of the command `loadcell calibrate`; `rate` is the rate of samples [Hz]."""
    return {
        "schema": "armdyn.loadcell_calibration/1",
        **fit.quantities(),
        "rate": rate,
        "weights": [
            {
                "weight": plateau.weight.text,
                "force": plateau.weight.force,
                "counts": plateau.mean,
                "counts_std": plateau.mean_std,
                **attributes_as_json(plateau, "noise residual= samples outliers", residual=residual),
            }
            for plateau, residual in zip(fit.measurements, fit.residuals, strict=True)
        ],
    }


def monitor_json(seen: ForceStatistics, status: LoadCellStatus, start: float) -> dict[str, Any]:
    """JSON output of the command `loadcell monitor`; times in it count from `start` [s]."""
    force = {"mean": seen.mean, "min": seen.minimum, "max": seen.maximum, "std": seen.std}
    return {
        "schema": "armdyn.loadcell_monitor/1",
        **attributes_as_json(status, "reliable connected samples rate"),
        "force": {"unit": "N", **{name: finite_or_none(value) for name, value in force.items()}},
        "active": [fault.name.lower() for fault in status.active],
        "faults": {fault.name.lower(): count for fault, count in status.counts.items()},
        "events": [
            {
                "time": event.time - start,
                "fault": event.fault.name.lower(),
                **attributes_as_json(event, "began count"),
                "sentence": event.fault.value,
            }
            for event in seen.events
        ],
    }
