"""The report of one trial: what was learnt, how well the arm followed, how the swing went, and the verdict."""

from dataclasses import dataclass

import numpy as np

from pipeline.motion.feasibility import Margin
from pipeline.nodes.scheduler import Timing
from pipeline.report.feasibility import MarginSection
from pipeline.report.investigation import InvestigationSection
from pipeline.report.learning import EstimateSection, EstimateTrace, ForceSection, ForceTrace
from pipeline.report.motion import (
    GripperSection,
    GripperTrace,
    JointTrace,
    PositionSection,
    TimingSection,
    VelocitySection,
)
from pipeline.report.page import KeyFigure, Level, NextStep, Report, Section
from pipeline.report.swing import SwingPicture, SwingSection
from pipeline.report.theme import Span, number, percent


@dataclass(frozen=True)
class TrialReportData:
    """Everything the report of one trial shows; a part that is None or empty is left out.

    Attributes:
        level: colour of the verdict.
        verdict: what happened, in a sentence.
        subtitle: robot, load, seed, hidden effects.
        command: how to run this trial again.
        phases: named stretches of time.
        notes: sentences to read first, such as warnings.
        key_figures: numbers beside those that follow from the other parts.
        estimates: the parameters learnt, the length first.
        force, gripper, swing, joints: recordings of the trial.
        margins: to the limits; the tightest need not come first.
        nodes: computing times.
        next_steps: what to do now.
        investigation: what the robot found out before the swing.
    """

    level: Level
    verdict: str
    subtitle: str = ""
    command: str = ""
    phases: tuple[Span, ...] = ()
    notes: tuple[str, ...] = ()
    key_figures: tuple[KeyFigure, ...] = ()
    estimates: tuple[EstimateTrace, ...] = ()
    force: ForceTrace | None = None
    gripper: GripperTrace | None = None
    swing: SwingPicture | None = None
    joints: JointTrace | None = None
    margins: tuple[Margin, ...] = ()
    nodes: tuple[Timing, ...] = ()
    next_steps: tuple[NextStep, ...] = ()
    investigation: InvestigationSection | None = None


def trial_report(data: TrialReportData) -> Report:
    """The report of one trial; ``trial_report(data).write(path)`` makes the file."""
    return Report(
        title="Trial: learn the string, swing the load",
        level=data.level,
        verdict=data.verdict,
        sections=_sections(data),
        subtitle=data.subtitle,
        key_figures=(*_key_figures(data), *data.key_figures),
        notes=data.notes,
        command=data.command,
        next_steps=data.next_steps,
    )


def _sections(data: TrialReportData) -> list[Section]:
    sections: list[Section] = []
    if data.swing is not None:
        sections.append(SwingSection(data.swing))
    if data.investigation is not None:
        sections.append(data.investigation)
    if data.estimates:
        white = data.force.residual_is_white if data.force is not None else None
        sections.append(EstimateSection(data.estimates, data.phases, white))
    if data.force is not None:
        sections.append(ForceSection(data.force, data.phases))
    if data.gripper is not None:
        sections.append(GripperSection(data.gripper, data.phases))
    if data.joints is not None:
        sections += [PositionSection(data.joints), VelocitySection(data.joints)]
    if data.margins:
        sections.append(MarginSection(data.margins))
    if data.nodes:
        sections.append(TimingSection(data.nodes))
    return sections


def _key_figures(data: TrialReportData) -> list[KeyFigure]:
    figures = []
    doubt = "; does not hold" if data.force is not None and data.force.residual_is_white is False else ""
    for trace in data.estimates[:1]:
        if trace.value.size:
            spread, guess = number(trace.std[-1], trace.unit, 2), number(trace.guess, trace.unit)
            value = f"{trace.value[-1]:.4f} {trace.unit}"
            figures.append(KeyFigure(f"Estimated {trace.name}", value, f"± {spread}{doubt}, from a guess of {guess}"))
            if trace.truth is not None:
                error = trace.value[-1] - trace.truth
                note = f"{abs(error) / trace.std[-1]:.1f} reported standard deviations" if trace.std[-1] > 0 else ""
                figures.append(KeyFigure("Error", number(error, trace.unit, 2), note))
    if data.force is not None:
        least = float(np.nanmin(data.force.measured))
        figures.append(
            KeyFigure("Least tension", number(least, "N"), "the string went slack" if least <= 0.0 else "taut")
        )
    if data.gripper is not None:
        error = float(np.sqrt(np.nanmean((data.gripper.actual - data.gripper.reference) ** 2)))
        figures.append(KeyFigure("Gripper error", number(error, "m", 2), "rms along the line"))
    if data.margins:
        tightest = max(data.margins, key=lambda margin: margin.used)
        figures.append(KeyFigure("Tightest limit", percent(tightest.used), f"{tightest.limit}, {tightest.joint}"))
    return figures
