"""The reports of motions: whether one is feasible, and what one that was designed is expected to tell."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import plotly.graph_objects as go

from armdyn.document import Chart, Document, KeyFigure, Level, Section, Table
from pipeline.answers_motion import expectation_rows, factor, peak_rows, sentence
from pipeline.motion.feasibility.verdict import Bounded, FeasibilityReport, Margin
from pipeline.report.motion import JointTrace, position_section, velocity_section
from pipeline.report.theme import BLUE, GREY, LIMIT, LINKED_TIME, ORANGE, TIME_AXIS, number, percent

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pipeline.motion.excitation import Excitation


def margin_section(margins: Sequence[Margin]) -> Section:
    """Whether every limit was kept: the tightest of each kind, then all others."""
    by_use = sorted(margins, key=lambda margin: -margin.used)
    tightest, broken = by_use[0], sum(margin.used > 1.0 for margin in margins)
    first = {margin.limit: margin for margin in reversed(by_use)}
    ordered = [m for m in by_use if first[m.limit] is m] + [m for m in by_use if first[m.limit] is not m]
    sentence = (
        f"All {len(margins)} limits were kept; the tightest is the {tightest.limit} of {tightest.joint}, "
        f"of which {percent(tightest.used)} was used."
    )
    if broken:
        sentence = (
            f"Limits broken: {broken} of {len(margins)}; worst the {tightest.limit} of {tightest.joint}, "
            f"{number(tightest.value, tightest.unit)} against {number(tightest.bound, tightest.unit)} "
            f"at {tightest.time:.2f} s."
        )
    rows = [
        [m.limit, m.joint, f"{m.value:.3g}", f"{m.bound:.3g}", m.unit, f"{m.time:.2f}", percent(m.used)]
        for m in ordered
    ]
    header = ["limit", "of", "closest", "bound", "unit", "at [s]", "used"]
    return Section("Limits", sentence, tables=[Table.of(header, rows, shares=[margin.used for margin in ordered])])


MOST_ROWS = 50
"""Violations that a table lists; the file given with --json has them all."""

MOST_POINTS = 1500
"""Samples per line of a figure."""


def violation_section(report: FeasibilityReport) -> Section:
    """Every limit that is broken: a row per stretch, with its worst instant."""
    if report.feasible:
        return Section("Violations", "No limit is broken.")
    more = f" The first {MOST_ROWS} are listed." if len(report.violations) > MOST_ROWS else ""
    rows = [
        [_words(v.limit), v.joint, f"{v.time:.3f}", f"{v.value:.4g}", f"{v.bound:.4g}", v.unit]
        for v in report.violations[:MOST_ROWS]
    ]
    return Section(
        "Violations",
        f"{len(report.violations)} stretches of the motion break a limit.{more}",
        tables=[Table.of(["limit", "of", "at [s]", "value", "bound", "unit"], rows)],
    )


def used_section(report: FeasibilityReport) -> Section:
    """How much of each limit is used, over time: one line per limit that has two sides and varies."""
    figure = go.Figure()
    shown = [b for b in report.series if b.limit != "line" and b.time.size > 1]
    for bounded in shown:
        if bounded.is_two_sided:
            time, used, who = _most_used(bounded)
            figure.add_scatter(
                x=time, y=100 * used, name=_words(bounded.limit), text=who, mode="lines",
                hovertemplate="%{y:.0f} % %{text}",
            )  # fmt: skip
    if shown:
        ends = [min(b.time[0] for b in shown), max(b.time[-1] for b in shown)]
        figure.add_scatter(x=ends, y=[100, 100], name="limit", hoverinfo="skip", **LIMIT)
    figure.update_layout(
        height=380, meta=LINKED_TIME, xaxis={"title": {"text": TIME_AXIS}}, yaxis={"title": {"text": "used [%]"}}
    )
    return Section(
        "Limits over time",
        "At 100 % a limit is reached; each line is the joint that uses most of it.",
        [Chart(figure, "Position counts from the middle of a joint's range, everything else from 0.")],
    )


def feasibility_document(report: FeasibilityReport, title: str) -> Document:
    """What there is to say about one check."""
    margins = [replace(m, limit=_words(m.limit)) for m in report.margins if m.limit != "line" or m.used > 1.0]
    return Document(
        title,
        report.sentence,
        [violation_section(report), margin_section(margins)],
        Level.GOOD if report.feasible else Level.BAD,
    )


def feasibility_page(report: FeasibilityReport, title: str) -> Document:
    """The same with key figures and with the share of each limit over time."""
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
    document = feasibility_document(report, title)
    violations, *others = document.sections
    return replace(document, sections=[violations, used_section(report), *others], key_figures=figures)


def _most_used(bounded: Bounded) -> tuple[NDArray[np.float64], NDArray[np.float64], list[str]]:
    """Time, largest share used by any column, and which column it is; thinned without losing the peaks."""
    used, column = bounded.used.max(axis=1), bounded.used.argmax(axis=1)
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


def expected_section(found: Excitation, most: int) -> Section:
    """What a recording of the motion is expected to tell, by unknown, or by effect where they are more than `most`."""
    goal = found.goal
    noise = goal.columns.noise
    sentence = (
        f"Expected of a recording at {goal.columns.rate:g} Hz whose torques have a noise of "
        f"{number(float(noise.min()))} to {number(float(noise.max()))} N m, 0.2 % of each joint's limit; less noise "
        "makes all figures better alike."
    )
    return Section("What it tells", sentence, tables=[Table.of(*expectation_rows(found, most))])


def expected_chart(found: Excitation) -> Chart:
    """The same as a bar per unknown or hidden effect and motion."""
    goal = found.goal
    contenders = [("this motion", found.expected, BLUE), ("best random", found.random, GREY)]
    contenders.append(("least condition number", found.conditioned, ORANGE))
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
    return Chart(figure, "Higher is better." if goal.rivals else "Lower is better.")


def motion_section(found: Excitation) -> Section:
    """How far, how fast and how strongly every joint moves."""
    series = found.series
    again = f", run through {series.repeats} times" if series.repeats > 1 else ""
    return Section(
        "The motion",
        f"A Fourier series of {series.harmonics} harmonics over {series.period:.4g} s{again}; it starts and ends "
        "at rest, with a continuous acceleration.",
        tables=[
            Table.of(
                *peak_rows(found), "In rad, s and N m, or m and N for joints that slide; in brackets: of the limit."
            )
        ],
    )


def excitation_document(found: Excitation, most: int, notes: Sequence[str] = ()) -> Document:
    """What the motion is expected to tell, and how it moves the arm.

    Args:
        found: the motion.
        most: unknowns that are listed one by one.
        notes: what else a reader must know.
    """
    left_out = [f"taken as known: {name}, {why}" for name, why in found.goal.left_out.items()]
    hopeless = [f"no motion can tell: {what}" for what in found.goal.inseparable]
    return Document(
        f"A motion of {found.goal.columns.arm.robot.name} to record",
        sentence(found),
        [expected_section(found, most), motion_section(found)],
        Level.GOOD,
        notes=[*left_out, *hopeless, *notes],
    )


def excitation_page(found: Excitation) -> Document:
    """The same with figures, and with the shares of all limits."""
    motion, limits = found.trajectory, found.goal.columns.arm.robot.limits
    thin = slice(None, None, -(-len(motion) // MOST_SAMPLES))
    trace = JointTrace(
        motion.joint_names, motion.time[thin], motion.q[thin], motion.v[thin], limits.lower, limits.upper,
        limits.velocity,
    )  # fmt: skip
    margins = [replace(m, limit=_words(m.limit)) for m in found.check.margins]
    document = excitation_document(found, MOST_UNKNOWNS)
    tells, moves = document.sections
    return replace(
        document,
        sections=[
            replace(tells, charts=[expected_chart(found)]), moves, position_section(trace), velocity_section(trace),
            used_section(found.check), margin_section(margins),
        ],
        key_figures=_key_figures(found),
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
