"""Report of the check of a motion: violated limits, margins, and the joints over time within their limits."""

from collections.abc import Sequence
from dataclasses import replace
from html import escape

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from armdyn.document import Chart, Column, Document, KeyFigure, ResultLevel, Section, Table, attribute_columns
from armdyn.recording.channels import FloatArray
from pipeline.motion.feasibility.verdict import FeasibilityReport, LimitMargin
from pipeline.report.theme import ACTUAL_STYLE, LIMIT_STYLE, LINKED_TIME_AXES, TIME_AXIS, number_text, percent_text
from urdf.robot import Limits

MAX_VIOLATION_ROWS = 50
"""Largest number of violations that a table lists; the JSON lists all."""
LIMIT_TABLE_CAPTION = (
    "The tightest limit of each kind comes first. Share of the limit: for a position from the middle of its range to "
    "its bound, else from 0. Singularity: the smallest singular value of the tool's Jacobian, 0 where the tool cannot "
    "move one way."
)
MAX_LIMIT_CURVE_POINTS = 1500
"""Largest number of drawn samples of a curve of a limit's used share."""


def feasibility_document(report: FeasibilityReport, title: str) -> Document:
    """Document of the feasibility check of a motion: violations and margins as tables, without figures."""
    margins = [margin for margin in report.margins if margin.limit != "line" or margin.used_share > 1.0]
    level = ResultLevel.GOOD if report.feasible else ResultLevel.BAD
    sections = [_violation_section(report), limit_margin_section(margins), *_tracking_sections(report)]
    return Document(title, report.sentence, sections, level, notes=report.notes)


def feasibility_report(report: FeasibilityReport, title: str) -> Document:
    """Report of the feasibility check of a motion: its document, key figures, used share of each limit over time."""
    tightest = report.tightest
    at = f"{tightest.joint}, {tightest.time:.2f} s"
    figures = [
        KeyFigure("limits looked at", str(len(report.margins))),
        KeyFigure(f"tightest: {_words(tightest.limit)}", percent_text(tightest.used_share), at),
    ]
    for limit, name in (("torque", "largest share of a torque"), ("self_collision", "closest to itself")):
        chosen = [margin for margin in report.margins if margin.limit == limit]
        if chosen:
            worst = max(chosen, key=lambda margin: margin.used_share)
            value = (
                number_text(worst.value, worst.unit) if limit == "self_collision" else percent_text(worst.used_share)
            )
            figures.append(KeyFigure(name, value, worst.joint))
    document = feasibility_document(report, title)
    violations, *others = document.sections
    return replace(document, sections=[violations, limit_use_section(report), *others], key_figures=figures)


def _violation_section(report: FeasibilityReport) -> Section:
    if report.feasible:
        return Section("Violations", "No limit is broken.")
    listed = report.violations[:MAX_VIOLATION_ROWS]
    more = f" The first {MAX_VIOLATION_ROWS} are listed." if len(report.violations) > MAX_VIOLATION_ROWS else ""
    columns = [
        Column("quantity", [_words(v.limit) for v in listed]),
        Column("joint", [v.joint for v in listed]),
        Column("at [s]", [v.time for v in listed], ".3f"),
        *attribute_columns(listed, value=".4g", bound=".4g", unit=""),
    ]
    times = f"{len(report.violations)} times" if len(report.violations) > 1 else "once"
    sentence = f"The motion breaks a limit {times}.{more}"
    return Section("Violations", sentence, tables=[Table(columns)])


def _tracking_sections(report: FeasibilityReport) -> list[Section]:
    """Section with a table of how joints follow the motion in simulation; none without servos."""
    if not report.tracking:
        return []
    worst = max(report.tracking, key=lambda one: one.largest)
    sentence = f"In closed loop {worst.joint} is farthest from the motion, {number_text(worst.largest, worst.unit)}."
    columns = [
        Column("joint", [one.joint for one in report.tracking]),
        *attribute_columns(report.tracking, largest=".3g", rms=".3g", unit=""),
        Column("at its limit", [percent_text(one.saturated) for one in report.tracking]),
    ]
    return [Section("Tracking of the servos", sentence, tables=[Table(columns)])]


def limit_margin_section(margins: Sequence[LimitMargin]) -> Section:
    """Section with a table of the margins to all limits; the smallest margin of each kind of limit comes first."""
    by_use = sorted(margins, key=lambda margin: -margin.used_share)
    tightest, broken = by_use[0], sum(margin.used_share > 1.0 for margin in margins)
    first = {margin.limit: margin for margin in reversed(by_use)}
    ordered = sorted(by_use, key=lambda margin: first[margin.limit] is not margin)
    whose = f"{_words(tightest.limit)} of {tightest.joint}"
    sentence = f"All {len(margins)} limits were kept; the tightest is the {whose}, "
    sentence += f"of which {percent_text(tightest.used_share)} was used."
    if broken:
        sentence = (
            f"Limits broken: {broken} of {len(margins)}; worst the {whose}, "
            f"{number_text(tightest.value, tightest.unit)} against {number_text(tightest.bound, tightest.unit)} "
            f"at {tightest.time:.2f} s."
        )
    used = [margin.used_share for margin in ordered]
    columns = [
        Column("quantity", [_words(margin.limit) for margin in ordered]),
        Column("joint", [margin.joint for margin in ordered]),
        Column("value nearest its limit", [margin.value for margin in ordered], ".3g"),
        Column("limit", [margin.bound for margin in ordered], ".3g"),
        *attribute_columns(ordered, unit=""),
        Column("at [s]", [margin.time for margin in ordered], ".2f"),
        Column("share of the limit", list(map(percent_text, used)), bar_lengths=used, bar_coloured_by_length=True),
    ]
    return Section("Limits", sentence, tables=[Table(columns, LIMIT_TABLE_CAPTION)])


def limit_use_section(report: FeasibilityReport) -> Section:
    """Section with a figure of used shares over time: a curve for each kind of limit with an upper and lower bound."""
    figure = go.Figure(layout={"height": 380, "meta": LINKED_TIME_AXES})
    shown = [b for b in report.series if b.limit != "line" and b.time.size > 1]
    for bounded in shown:
        if not bounded.is_two_sided:
            continue
        used, joint = bounded.used_share.max(axis=1), bounded.used_share.argmax(axis=1)
        chunk = -(-used.size // MAX_LIMIT_CURVE_POINTS)  # only the peak of each curve is drawn
        peaks = np.array([i + int(np.argmax(used[i : i + chunk])) for i in range(0, used.size, chunk)])
        figure.add_scatter(
            x=bounded.time[peaks], y=100 * used[peaks], name=_words(bounded.limit), mode="lines",
            text=[bounded.names[k] for k in joint[peaks]], hovertemplate="%{y:.0f} % %{text}",
        )  # fmt: skip
    if shown:
        ends = [min(b.time[0] for b in shown), max(b.time[-1] for b in shown)]
        figure.add_scatter(x=ends, y=[100, 100], name="limit", hoverinfo="skip", **LIMIT_STYLE)
    figure.update_xaxes(title_text=TIME_AXIS)
    figure.update_yaxes(title_text="used [%]")
    return Section(
        "Limits over time",
        "At 100 % a limit is reached; each line is the joint that uses most of it.",
        [Chart(figure, "Position counts from the middle of a joint's range, everything else from 0.")],
    )


def _words(limit: str) -> str:
    return limit.replace("_", " ")


def joint_motion_sections(
    names: Sequence[str], time: FloatArray, q: FloatArray, v: FloatArray, limits: Limits
) -> list[Section]:
    """Two sections, on positions and on velocities: a figure of every joint within its limits, and the closest joint.

    Args:
        names: names of the joints (j,).
        time: times of the samples (n,) [s].
        q: positions (n, j) [rad or m].
        v: velocities (n, j) [rad/s or m/s].
        limits: limits of the joints.
    """
    middle, half = (limits.upper + limits.lower) / 2, (limits.upper - limits.lower) / 2
    kinds = (
        ("positions", q, limits.lower, limits.upper, "rad", np.abs(q - middle).max(axis=0) / half,
         "of the way from the middle of its range to its end"),
        ("velocities", v, -limits.velocity, limits.velocity, "rad/s", np.abs(v).max(axis=0) / limits.velocity,
         "of its speed limit"),
    )  # fmt: skip
    sections = []
    for kind, value, lower, upper, unit, used, what in kinds:
        worst = int(np.argmax(used))
        sentence = (
            f"Every joint stays within its limits; {names[worst]} comes closest, {percent_text(used[worst])} {what}."
        )
        if used[worst] > 1.0:
            sentence = f"{names[worst]} goes beyond its limit: {percent_text(used[worst])} {what}."
        chart = Chart(_small_multiples(names, time, value, lower, upper, unit), "Dashed: limits.")
        sections.append(Section(f"Joint {kind}", sentence, [chart]))
    return sections


def _small_multiples(
    names: Sequence[str], time: FloatArray, value: FloatArray, lower: FloatArray, upper: FloatArray, unit: str
) -> go.Figure:
    """One panel per joint: `value` (n, j) between `lower` and `upper` (j,)."""
    count, rows = len(names), -(-len(names) // 2)
    figure = make_subplots(
        rows, 2, shared_xaxes="all", horizontal_spacing=0.1, vertical_spacing=0.42 / (rows + 0.42 * (rows - 1)),
        subplot_titles=[f"<b>{escape(name)}</b>" for name in names],
        specs=[[{}, {} if 2 * row + 1 < count else None] for row in range(rows)],
    )  # fmt: skip
    for i, name in enumerate(names):
        at = {"row": i // 2 + 1, "col": i % 2 + 1}
        figure.add_scatter(x=time, y=value[:, i], name=escape(name), **ACTUAL_STYLE, **at)
        for bound in (lower[i], upper[i]):
            figure.add_scatter(x=time[[0, -1]], y=[bound] * 2, name="limit", hoverinfo="skip", **LIMIT_STYLE, **at)
        pad = 0.12 * (upper[i] - lower[i])
        figure.update_yaxes(title_text=f"[{unit}]", range=[lower[i] - pad, upper[i] + pad], nticks=5, **at)
        if i + 2 >= count:
            figure.update_xaxes(title_text=TIME_AXIS, showticklabels=True, **at)
    figure.for_each_annotation(lambda title: title.update(x=title.x - 0.225, xanchor="left", font_size=12))
    figure.update_layout(
        height=92 + 118 * rows, meta=LINKED_TIME_AXES, showlegend=False, hovermode="x", margin={"t": 34}
    )
    return figure
