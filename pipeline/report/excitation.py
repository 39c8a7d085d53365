"""The report of a motion that was designed to tell something: what it is expected to tell, beside other motions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import plotly.graph_objects as go

from pipeline.excitation_answer import expectation_rows, factor, peak_rows, sentence
from pipeline.motion.excitation import Excitation
from pipeline.report.feasibility import MarginSection, UsedSection
from pipeline.report.motion import JointTrace, PositionSection, VelocitySection
from pipeline.report.page import Chart, KeyFigure, Level, Report, Section, Table
from pipeline.report.theme import BLUE, GREY, ORANGE, number

MOST_UNKNOWNS = 400
"""Rows of the table; the JSON has all."""
MOST_POINTS = 2000
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
    thin = slice(None, None, -(-len(motion) // MOST_POINTS))
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
