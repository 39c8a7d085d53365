"""The reports of motions: whether one is feasible, and what one that was designed is expected to tell."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar

import numpy as np
import plotly.graph_objects as go

from pipeline.answers_motion import expectation_rows, factor, peak_rows, sentence
from pipeline.motion.feasibility.verdict import Bounded, FeasibilityReport, Margin
from pipeline.report.motion import JointTrace, PositionSection, VelocitySection
from pipeline.report.page import Chart, KeyFigure, Level, Report, Section, Table
from pipeline.report.theme import BLUE, GREY, LIMIT, LINKED_TIME, ORANGE, TIME_AXIS, number, percent

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pipeline.motion.excitation import Excitation


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


MOST_UNKNOWNS = 400
"""Rows of the table; the JSON has all."""
MOST_SAMPLES = 2000
"""Samples per line of a figure."""


@dataclass(frozen=True)
class ExpectedSection(Section):
    """What a recording of the motion is expected to tell."""

    title: ClassVar[str] = "What it tells"
    found: Excitation

    def sentence(self) -> str:
        """How to read it."""
        noise = self.found.goal.columns.noise
        low, high = float(noise.min()), float(noise.max())
        return (
            f"Expected of a recording at {self.found.goal.columns.rate:g} Hz whose torques have a noise of "
            f"{number(low)} to {number(high)} N m, 0.2 % of each joint's limit; less noise makes all figures better "
            "alike."
        )

    def charts(self) -> Sequence[Chart]:
        """A bar per unknown or hidden effect and motion."""
        goal = self.found.goal
        contenders = [("this motion", self.found.expected, BLUE), ("best random", self.found.random, GREY)]
        contenders.append(("least condition number", self.found.conditioned, ORANGE))
        figure = go.Figure(layout={"yaxis": {"type": "log"}, "xaxis": {"tickangle": -45}, "barmode": "group"})
        for name, expected, colour in contenders:
            if expected is None:
                continue
            if goal.rivals:
                labels = [f"{case.effect} {case.joint}".strip() for case in goal.hidden]
                values = np.sqrt(expected.separations)
            else:
                chosen = [k for k, i in enumerate(goal.wanted) if i not in goal.hopeless]
                unknowns = [goal.columns.unknowns[goal.wanted[k]] for k in chosen]
                labels = [p.name for p in unknowns]
                values = expected.std[chosen] / np.array([p.typical for p in unknowns])
            figure.add_bar(x=labels, y=values, name=name, marker={"color": colour})
        title = "separation [standard deviations]" if goal.rivals else "standard deviation / typical size"
        figure.update_layout(height=460, yaxis_title=title)
        return [Chart(figure, "Higher is better." if goal.rivals else "Lower is better.")]

    def tables(self) -> Sequence[Table]:
        """The same in numbers."""
        header, rows = expectation_rows(self.found, MOST_UNKNOWNS)
        return [Table(header, rows)]


@dataclass(frozen=True)
class MotionSection(Section):
    """How far, how fast and how strongly every joint moves."""

    title: ClassVar[str] = "The motion"
    found: Excitation

    def sentence(self) -> str:
        """Its form."""
        series = self.found.series
        again = f", run through {series.repeats} times" if series.repeats > 1 else ""
        return (
            f"A Fourier series of {series.harmonics} harmonics over {series.period:.4g} s{again}; it starts and ends "
            "at rest, with a continuous acceleration."
        )

    def tables(self) -> Sequence[Table]:
        """Peaks."""
        header, rows = peak_rows(self.found)
        return [Table(header, rows, "In rad, s and N m, or m and N for joints that slide; in brackets: of the limit.")]


def excitation_page(found: Excitation, command: str = "") -> Report:
    """The whole page.

    Args:
        found: the motion.
        command: how to make the page again.
    """
    motion, limits = found.trajectory, found.goal.columns.arm.robot.limits
    thin = slice(None, None, -(-len(motion) // MOST_SAMPLES))
    trace = JointTrace(
        motion.joint_names, motion.time[thin], motion.q[thin], motion.v[thin], limits.lower, limits.upper,
        limits.velocity,
    )  # fmt: skip
    margins = [replace(m, limit=m.limit.replace("_", " ")) for m in found.check.margins]
    notes = [f"Taken as known: {name}, {why}." for name, why in found.goal.left_out.items()]
    notes += [f"No motion can tell: {what}." for what in found.goal.inseparable]
    return Report(
        title=f"A motion of {found.goal.columns.arm.robot.name} to record",
        level=Level.GOOD,
        verdict=sentence(found),
        sections=[
            ExpectedSection(found), MotionSection(found), PositionSection(trace), VelocitySection(trace),
            UsedSection(found.check), MarginSection(margins),
        ],
        key_figures=_key_figures(found),
        notes=notes,
        command=command,
    )  # fmt: skip


def _key_figures(found: Excitation) -> list[KeyFigure]:
    figures = [KeyFigure("time", f"{found.trajectory.time[-1]:g} s"), KeyFigure("energy", number(found.energy, "J"))]
    if found.goal.rivals:
        smallest = min(found.expected.separations) ** 0.5
        return [KeyFigure("separation", f"{smallest:.3g}", "standard deviations"), *figures]
    others = (("best random", found.random), ("least condition number", found.conditioned))
    better = [
        KeyFigure(f"than {name}", f"{factor(found, e):.2g} ×", "smaller standard deviations")
        for name, e in others
        if e is not None
    ]
    return [*better, *figures]
