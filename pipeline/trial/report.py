"""Report of one trial: outcome, swing of the load, estimated length, forces, and the arm's motion within its limits."""

from collections.abc import Sequence

import numpy as np

from armdyn.document import Document, KeyFigure, NextStep, ResultLevel, Section
from armdyn.recording.channels import FloatArray
from pipeline.report.feasibility import joint_motion_sections, limit_margin_section
from pipeline.report.next_experiment import investigation_section
from pipeline.report.theme import number_text, percent_text
from pipeline.report.trial import (
    SwingTrace,
    estimate_section,
    force_section,
    gripper_section,
    swing_section,
    timing_section,
)
from pipeline.trial.experiment import Experiment
from pipeline.trial.result import TrialResult


def trial_report(experiment: Experiment, result: TrialResult, subtitle: str, executed: SwingTrace | None) -> Document:
    """Report of a finished trial; for a stopped trial it lacks the sections of phases that were not reached.

    Args:
        experiment: finished protocol.
        result: outcome of the trial.
        subtitle: description of the trial.
        executed: true motion of the swing; None if it is unknown.
    """
    sections: list[Section] = []
    figures = _estimate_figures(result)
    phases = [(span.phase.value, span.start, span.end) for span in experiment.phases]
    plan, settings, investigation = experiment.task.swing, experiment.settings, result.investigation
    if plan is not None:
        planned = SwingTrace(plan.time, plan.x, plan.load[:, 0], plan.load[:, 1])
        sections.append(swing_section(planned, executed, settings.task.box, settings.load_radius))
    if investigation is not None and investigation.stages:
        sections.append(investigation_section(investigation))
    if result.estimates:
        sections.append(estimate_section(result.estimates, result.length_guess, result.true_length, phases))
    force = experiment.channel("load_force")
    if len(force) > 1:
        sections.append(force_section(force.time, force.value, _predicted(experiment), settings.force_noise, phases))
        least = float(np.nanmin(force.value))
        taut = "taut" if least > 0.0 else "the string went slack"
        figures.append(KeyFigure("Least tension", number_text(least, "N"), taut))
    reference, actual = experiment.channel("reference.x"), experiment.channel("gripper_x")
    if len(reference) and len(actual):  # otherwise the phase ended before it began
        wanted = np.interp(actual.time, reference.time, reference.value)
        sections.append(gripper_section(actual.time, wanted, actual.value, phases))
        error = float(np.sqrt(np.nanmean((actual.value - wanted) ** 2)))
        figures.append(KeyFigure("Gripper error", number_text(error, "m", 2), "rms along the line"))
    names, limits = experiment.description.joint_names, experiment.description.limits
    time = experiment.channel(f"q.{names[0]}").time
    if len(time):
        q, v = (np.column_stack([experiment.channel(f"{kind}.{name}").value for name in names]) for kind in "qv")
        sections += joint_motion_sections(names, time, q, v, limits)
    if experiment.task.feasibility and (margins := experiment.task.feasibility.margins):
        sections.append(limit_margin_section(margins))
        tightest = max(margins, key=lambda margin: margin.used_share)
        figures.append(
            KeyFigure("Tightest limit", percent_text(tightest.used_share), f"{tightest.limit}, {tightest.joint}")
        )
    if result.timing:
        sections.append(timing_section(list(result.timing.values())))
    return Document(
        title="Trial: learn the string, swing the load",
        level=ResultLevel.GOOD if result.success else ResultLevel.BAD,
        verdict=result.message[:1].upper() + result.message[1:],
        sections=sections,
        subtitle=subtitle,
        key_figures=figures,
        notes=_notes(experiment, result),
        next_steps=_next_steps(result),
    )


def _next_steps(result: TrialResult) -> tuple[NextStep, ...]:
    if result.repair_command is None:
        return ()
    return (
        NextStep("Find what the model lacks", f"{result.repair_command} --report repair.html"),
        NextStep("Then try again with what was found", "armdyn trial --model repaired.toml"),
    )


def _notes(experiment: Experiment, result: TrialResult) -> Sequence[str]:
    notes = ["The box is not the paper's, which gives none: it was chosen so that the paper's table comes out."]
    if not experiment.settings.estimate:
        notes.append("Nothing was learnt in this trial: the swing was planned with the guess.")
    return [*notes, *(note[:1].upper() + note[1:] + "." for note in result.notes)]


def _estimate_figures(result: TrialResult) -> list[KeyFigure]:
    if not result.estimates:
        return []
    last, truth = result.estimates[-1], result.true_length
    note = f"± {number_text(last.std, 'm', 2)}, from a guess of {number_text(result.length_guess, 'm')}"
    figures = [KeyFigure("Estimated length", f"{last.value:.4f} m", note)]
    if truth is not None:
        apart = f"{abs(last.value - truth) / last.std:.1f} reported standard deviations" if last.std > 0 else ""
        figures.append(KeyFigure("Error", number_text(last.value - truth, "m", 2), apart))
    return figures


def _predicted(experiment: Experiment) -> FloatArray:
    """Forces predicted by the model with the last estimate along the measured path; nan before the path begins."""
    recorded, start = experiment.channel("load_force"), experiment.estimator.start
    predicted = np.full(len(recorded), np.nan)
    if start is not None:
        model = experiment.estimator.model
        values = model.predict(experiment.measurement.run(), model.theta()).values
        first = int(np.searchsorted(recorded.time, start - 1e-9))
        predicted[first:] = values[: len(recorded) - first]
    return predicted
