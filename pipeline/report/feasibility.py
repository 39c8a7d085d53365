"""The report of a feasibility check."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar

import numpy as np
import plotly.graph_objects as go

from pipeline.motion.feasibility.verdict import Bounded, FeasibilityReport, Margin
from pipeline.report.page import Chart, KeyFigure, Level, Report, Section, Table
from pipeline.report.theme import LIMIT, LINKED_TIME, TIME_AXIS, number, percent

if TYPE_CHECKING:
    from numpy.typing import NDArray


@dataclass(frozen=True)
class MarginSection(Section):
    """All limits, the tightest first."""

    title: ClassVar[str] = "Limits"

    margins: Sequence[Margin]

    def sentence(self) -> str:
        """Whether every limit was kept."""
        broken = [margin for margin in self.margins if margin.used > 1.0]
        if broken:
            worst = max(broken, key=lambda margin: margin.used)
            return (
                f"Limits broken: {len(broken)} of {len(self.margins)}; worst the {worst.limit} of {worst.joint}, "
                f"{number(worst.value, worst.unit)} against {number(worst.bound, worst.unit)} at {worst.time:.2f} s."
            )
        tightest = max(self.margins, key=lambda margin: margin.used)
        return (
            f"All {len(self.margins)} limits were kept; the tightest is the {tightest.limit} of {tightest.joint}, "
            f"of which {percent(tightest.used)} was used."
        )

    def tables(self) -> Sequence[Table]:
        """A row per limit."""
        ordered = sorted(self.margins, key=lambda margin: -margin.used)
        rows = [
            [m.limit, m.joint, f"{m.value:.3g}", f"{m.bound:.3g}", m.unit, f"{m.time:.2f}", percent(m.used)]
            for m in ordered
        ]
        header = ["limit", "of", "closest", "bound", "unit", "at [s]", "used"]
        return [Table(header, rows, shares=[margin.used for margin in ordered])]


MOST_ROWS = 50
"""Violations that a table lists; the file given with --json has them all."""

MOST_POINTS = 1500
"""Samples per line of a figure."""


@dataclass(frozen=True)
class ViolationSection(Section):
    """Every limit that is broken."""

    title: ClassVar[str] = "Violations"

    report: FeasibilityReport

    def sentence(self) -> str:
        """How many, or that there are none."""
        if self.report.feasible:
            return "No limit is broken."
        more = f" The first {MOST_ROWS} are listed." if len(self.report.violations) > MOST_ROWS else ""
        return f"{len(self.report.violations)} stretches of the motion break a limit.{more}"

    def tables(self) -> Sequence[Table]:
        """A row per stretch, with its worst instant."""
        rows = [
            [_words(v.limit), v.joint, f"{v.time:.3f}", f"{v.value:.4g}", f"{v.bound:.4g}", v.unit]
            for v in self.report.violations[:MOST_ROWS]
        ]
        header = ["limit", "of", "at [s]", "value", "bound", "unit"]
        return [Table(header, rows)] if rows else []


@dataclass(frozen=True)
class UsedSection(Section):
    """How much of each limit is used, over time."""

    title: ClassVar[str] = "Limits over time"

    report: FeasibilityReport

    def sentence(self) -> str:
        """How to read the figure."""
        return "At 100 % a limit is reached; each line is the joint that uses most of it."

    def charts(self) -> Sequence[Chart]:
        """One line per limit that has two sides and varies."""
        figure = go.Figure()
        shown = [b for b in self.report.series if b.limit != "line" and b.time.size > 1]
        ends = [min(b.time[0] for b in shown), max(b.time[-1] for b in shown)] if shown else []
        for bounded in shown:
            if bounded.is_two_sided:
                time, used, who = _most_used(bounded)
                figure.add_scatter(
                    x=time,
                    y=100 * used,
                    name=_words(bounded.limit),
                    text=who,
                    mode="lines",
                    hovertemplate="%{y:.0f} % %{text}",
                )
        if ends:
            figure.add_scatter(x=ends, y=[100, 100], name="limit", hoverinfo="skip", **LIMIT)
        figure.update_layout(
            height=380, meta=LINKED_TIME, xaxis={"title": {"text": TIME_AXIS}}, yaxis={"title": {"text": "used [%]"}}
        )
        return [Chart(figure, "Position counts from the middle of a joint's range, everything else from 0.")]


def feasibility_page(report: FeasibilityReport, title: str, command: str = "") -> Report:
    """The whole page about one check.

    Args:
        report: of the check.
        title: heading.
        command: how to make the page again.
    """
    tightest = report.tightest
    figures = [KeyFigure("limits looked at", str(len(report.margins)))]
    figures.append(
        KeyFigure(
            f"tightest: {_words(tightest.limit)}", percent(tightest.used), f"{tightest.joint}, {tightest.time:.2f} s"
        )
    )
    for limit, name in (("torque", "largest share of a torque"), ("self_collision", "closest to itself")):
        chosen = [margin for margin in report.margins if margin.limit == limit]
        if chosen:
            worst = max(chosen, key=lambda margin: margin.used)
            value = number(worst.value, worst.unit) if limit == "self_collision" else percent(worst.used)
            figures.append(KeyFigure(name, value, worst.joint))
    margins = [replace(m, limit=_words(m.limit)) for m in report.margins if m.limit != "line" or m.used > 1.0]
    return Report(
        title=title,
        level=Level.GOOD if report.feasible else Level.BAD,
        verdict=report.sentence,
        sections=[ViolationSection(report), UsedSection(report), MarginSection(margins)],
        key_figures=figures,
        command=command,
    )


def _most_used(bounded: Bounded) -> tuple[NDArray[np.float64], NDArray[np.float64], list[str]]:
    """Time, largest share used by any column, and which column it is; thinned without losing the peaks."""
    shares = bounded.shares()
    used, column = shares.max(axis=1), shares.argmax(axis=1)
    chunk = -(-used.size // MOST_POINTS)
    starts = np.arange(0, used.size, chunk)
    peaks = np.array([start + int(np.argmax(used[start : start + chunk])) for start in starts])
    return bounded.time[peaks], used[peaks], [bounded.names[k] for k in column[peaks]]


def _words(limit: str) -> str:
    return limit.replace("_", " ")
