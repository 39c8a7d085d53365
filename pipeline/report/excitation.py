"""Report of a motion that was designed to identify an arm: expected standard deviations, and the joints' motion."""

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np
import plotly.graph_objects as go

from armdyn.document import MAX_CARD_ROWS, Chart, Column, Document, KeyFigure, ResultLevel, Section, Table
from armdyn.experiments.columns import WRENCH_NOISE
from armdyn.experiments.goal import MotionGoal
from armdyn.experiments.recorded import ArmQuestion
from pipeline.answers_motion import (
    compare_with_other_motions,
    determinable_parameter_indices,
    excitation_sentence,
    joint_peaks,
    rival_separations,
    std_ratios_to_designed_motion,
)
from pipeline.motion.excitation import Excitation
from pipeline.report.feasibility import joint_motion_sections, limit_margin_section, limit_use_section
from pipeline.report.theme import BLUE, GREY, ORANGE, number_text

MAX_TABLE_ROWS_OF_UNKNOWNS = 400
"""Largest number of rows of the table of unknowns; the JSON lists all unknowns."""
MAX_CURVE_SAMPLES = 2000
"""Largest number of drawn samples of a joint's curve."""
BASELINE_MOTIONS = ("best random", "least condition number")
"""Names of the motions with which a designed motion is compared."""


def excitation_document(found: Excitation, most: int, notes: Sequence[str] = ()) -> Document:
    """Document of a designed motion: expected standard deviations of the unknowns, and peaks of the joints' motion.

    Args:
        found: the designed motion.
        most: largest number of unknowns that are listed one by one; where there are more, effects are listed instead.
        notes: further sentences for the reader.
    """
    goal, series = found.goal, found.series
    again = f", run through {series.repeats} times" if series.repeats > 1 else ""
    moves = (
        f"A Fourier series of {series.harmonics} harmonics over {series.period:.4g} s{again}; it starts and ends "
        "at rest, with a continuous acceleration."
    )
    left_out = [f"taken as known: {name}, {why}" for name, why in goal.effects_taken_as_known.items()]
    hopeless = [f"no motion can tell: {what}" for what in goal.inseparable]
    return Document(
        f"A motion of {goal.columns.arm.robot.name} to record",
        excitation_sentence(found),
        [
            Section("What it tells", _premise(goal), tables=[_expectation_table(found, most)]),
            Section("The motion", moves, tables=[_peak_table(found)]),
        ],
        ResultLevel.GOOD,
        notes=[*left_out, *hopeless, *notes],
    )


def _premise(goal: MotionGoal) -> str:
    """The recording of which figures are expected, in a sentence."""
    if goal.columns.earlier is not None:
        return (
            f"Expected of the recordings that there are and one of this motion, at {goal.columns.rate:g} Hz, with the "
            "same channels and as much noise as the fit leaves."
        )
    noise, sensors = goal.columns.noise[: len(goal.columns.arm.joints)], ", ".join(goal.columns.model.sensors)
    sensed = (
        f", and the wrench of {sensors} one of {WRENCH_NOISE[0]:g} N and {WRENCH_NOISE[-1]:g} N m" if sensors else ""
    )
    return (
        f"Expected of a recording at {goal.columns.rate:g} Hz whose torques have a noise of "
        f"{number_text(float(noise.min()))} to {number_text(float(noise.max()))} N m, 0.2 % of each joint's limit"
        f"{sensed}; less noise makes all figures better alike."
    )


def next_motion_document(asked: ArmQuestion, found: Excitation | None, notes: Sequence[str]) -> Document:
    """Document of `armdyn next` for an arm: the diagnosis of its recordings, and the motion that tells what it lacks.

    Args:
        asked: what the recordings leave open.
        found: the designed motion; None where nothing is open.
        notes: further sentences for the reader.
    """
    return _after(asked, None if found is None else excitation_document(found, MAX_CARD_ROWS, notes), notes)


def next_motion_report(asked: ArmQuestion, found: Excitation | None, notes: Sequence[str]) -> Document:
    """Report of `armdyn next` for an arm; see `next_motion_document` and `excitation_report`."""
    return _after(asked, None if found is None else excitation_report(found), notes)


def _after(asked: ArmQuestion, motion: Document | None, notes: Sequence[str]) -> Document:
    said = asked.sentence if motion is None else f"{asked.sentence} Next: {motion.verdict}"
    document = Document("", "", notes=list(notes)) if motion is None else motion
    return replace(document, title="The next experiment", verdict=said, level=ResultLevel.GOOD)


def excitation_report(found: Excitation) -> Document:
    """Report of a designed motion: its document with figures, and with the used share of every limit of the arm."""
    motion, thin = found.trajectory, slice(None, None, -(-len(found.trajectory) // MAX_CURVE_SAMPLES))
    limits = found.goal.columns.arm.robot.limits
    figures = [KeyFigure("time", f"{motion.time[-1]:g} s"), KeyFigure("energy", number_text(found.energy, "J"))]
    if found.goal.rivals:
        smallest = rival_separations(found)[:, 0].min()
        figures.insert(0, KeyFigure("separation", f"{smallest:.3g}", "standard deviations"))
    else:
        better = [
            KeyFigure(f"than {name}", f"{gain:.2g} ×", "smaller standard deviations")
            for name, other, gain in zip(
                BASELINE_MOTIONS, (found.random, found.conditioned), std_ratios_to_designed_motion(found), strict=True
            )
            if other is not None
        ]
        figures = [*better, *figures]
    document = excitation_document(found, MAX_TABLE_ROWS_OF_UNKNOWNS)
    tells, moves = document.sections
    return replace(
        document,
        sections=[
            replace(tells, charts=[_expectation_chart(found)]),
            moves,
            *joint_motion_sections(motion.joint_names, motion.time[thin], motion.q[thin], motion.v[thin], limits),
            limit_use_section(found.feasibility),
            limit_margin_section(found.feasibility.margins),
        ],
        key_figures=figures,
    )


def _expectation_table(found: Excitation, most: int) -> Table:
    """Expected results of the designed and the other motions, by unknown; by effect for more than `most` unknowns."""
    goal = found.goal
    if goal.rivals:
        hidden = [f"{case.effect} on {case.joint}" if case.joint else case.effect for case in goal.separations]
        names = ("standard deviations from the rival", *BASELINE_MOTIONS)
        return Table([Column("if there is", hidden), *_columns(names, rival_separations(found).T)])
    rows, unknowns = determinable_parameter_indices(found), [goal.columns.unknowns[i] for i in goal.wanted]
    if len(unknowns) > most:
        effects = {p.effect: [k for k in rows if unknowns[k].effect == p.effect] for p in unknowns}
        ratios = np.transpose([std_ratios_to_designed_motion(found, own) for own in effects.values()])
        counted = Column("unknowns", [len(own) for own in effects.values()])
        others = _columns(("random / this", "condition number / this"), ratios)
        return Table([Column("effect (mean of its unknowns)", list(effects)), counted, *others])
    own, *std = compare_with_other_motions(found, "std").T
    told = [
        f"{std:.3g} {p.unit}" if k in rows else "no motion tells"
        for k, (p, std) in enumerate(zip(unknowns, own, strict=True))
    ]
    blank = [np.where(np.isin(np.arange(len(unknowns)), rows), values, np.nan) for values in std]
    return Table([
        Column("unknown", [p.name for p in unknowns]),
        Column("standard deviation", told),
        *_columns(BASELINE_MOTIONS, blank),
    ])  # fmt: skip


def _columns(names: Iterable[str], values: Iterable[np.ndarray]) -> list[Column]:
    """Columns of numbers by motion; an empty column belongs to a motion that was not made, and is left out."""
    return [
        Column(name, [float(v) if np.isfinite(v) else None for v in column], ".3g")
        for name, column in zip(names, values, strict=True)
    ]


def _peak_table(found: Excitation) -> Table:
    rows = joint_peaks(found)
    columns = [Column("joint", [row["joint"] for row in rows])]
    for name, key in (("from", "lowest"), ("to", "highest")):
        columns.append(Column(name, [row[key] for row in rows], ".3g"))
    for name in ("speed", "acceleration", "torque"):
        texts = [f"{row[name]['value']:.3g} ({100 * row[name]['share']:.0f} %)" for row in rows]
        columns.append(Column(name, texts))
    return Table(columns, "In rad, s and N m, or m and N for joints that slide; in brackets: of the limit.")


def _expectation_chart(found: Excitation) -> Chart:
    goal = found.goal
    figure = go.Figure(layout={"height": 460, "xaxis": {"tickangle": -45}, "barmode": "group"})
    if goal.rivals:
        labels, values = [f"{case.effect} {case.joint}".strip() for case in goal.separations], rival_separations(found)
    else:
        rows = determinable_parameter_indices(found)
        unknowns = [goal.columns.unknowns[goal.wanted[k]] for k in rows]
        labels = [p.name for p in unknowns]
        values = compare_with_other_motions(found, "std")[rows] / np.array([[p.typical] for p in unknowns])
    for name, colour, bars in zip(("this motion", *BASELINE_MOTIONS), (BLUE, GREY, ORANGE), values.T, strict=True):
        if np.isfinite(bars).any():
            figure.add_bar(x=labels, y=bars, name=name, marker={"color": colour})
    title = "separation [standard deviations]" if goal.rivals else "standard deviation / typical size"
    figure.update_yaxes(title_text=title, type="log")
    return Chart(figure, "Higher is better." if goal.rivals else "Lower is better.")
