"""What the report of a trial is told."""

import numpy as np

from armdyn.document import Document, Level, NextStep, Section
from pipeline.report.motion import EstimateTrace, ForceTrace, GripperTrace, JointTrace
from pipeline.report.next_experiment import investigation_section
from pipeline.report.theme import Span
from pipeline.report.trial import SwingPicture, SwingTrace, TrialReportData, trial_report
from pipeline.trial.experiment import Experiment
from pipeline.trial.result import TrialResult


def report_of(
    experiment: Experiment, result: TrialResult, subtitle: str, command: str = "", executed: SwingTrace | None = None
) -> Document:
    """The report of a trial that has run.

    Args:
        experiment: that has run.
        result: what it came to.
        subtitle: what was run.
        command: how to run it again.
        executed: the swing as it was; None where nobody saw it.
    """
    feasibility = experiment.task.feasibility
    return trial_report(
        TrialReportData(
            level=Level.GOOD if result.success else Level.BAD,
            verdict=result.message[:1].upper() + result.message[1:],
            subtitle=subtitle,
            command=command,
            phases=tuple(Span(span.phase.value, span.start, span.end) for span in experiment.course.phases),
            notes=_notes(experiment, result),
            estimates=(_estimate(result),) if result.estimates else (),
            force=_force(experiment),
            gripper=_gripper(experiment),
            swing=_swing(experiment, executed),
            joints=_joints(experiment),
            margins=feasibility.margins if feasibility else (),
            nodes=tuple(result.timing.values()),
            next_steps=_next_steps(result),
            investigation=_investigation(result),
        )
    )


def _next_steps(result: TrialResult) -> tuple[NextStep, ...]:
    if result.repair_command is None:
        return ()
    return (
        NextStep("Find what the model lacks", f"{result.repair_command} --report repair.html"),
        NextStep("Then try again with what was found", "armdyn trial --model repaired.toml"),
    )


def _investigation(result: TrialResult) -> Section | None:
    found = result.investigation
    return investigation_section(found) if found is not None and found.stages else None


def _notes(experiment: Experiment, result: TrialResult) -> tuple[str, ...]:
    notes = ["The box is not the paper's, which gives none: it was chosen so that the paper's table comes out."]
    if not experiment.settings.estimate:
        notes.append("Nothing was learnt in this trial: the swing was planned with the guess.")
    notes += [note[:1].upper() + note[1:] + "." for note in result.notes]
    return tuple(notes)


def _estimate(result: TrialResult) -> EstimateTrace:
    return EstimateTrace(
        name="length",
        unit="m",
        time=np.array([e.time for e in result.estimates]),
        value=np.array([e.value for e in result.estimates]),
        std=np.array([e.std for e in result.estimates]),
        guess=result.length_guess,
        truth=result.length_true,
    )


def _force(experiment: Experiment) -> ForceTrace | None:
    """Measured force, and what the model with the last estimate says along the measured path."""
    recorded = experiment.channel("load_force")
    if len(recorded) < 2:
        return None
    predicted = np.full(len(recorded), np.nan)
    start = experiment.estimator.start
    if start is not None:
        model = experiment.estimator.model
        values = model.predict(experiment.measurement.run(), model.theta()).values
        first = int(np.searchsorted(recorded.time, start - 1e-9))
        predicted[first:] = values[: len(recorded) - first]
    return ForceTrace(recorded.time, recorded.value, predicted, noise=experiment.settings.force_noise)


def _gripper(experiment: Experiment) -> GripperTrace | None:
    reference, actual = experiment.channel("reference.x"), experiment.channel("gripper_x")
    if not (len(reference) and len(actual)):  # ended before it began
        return None
    return GripperTrace(actual.time, np.interp(actual.time, reference.time, reference.value), actual.value)


def _swing(experiment: Experiment, executed: SwingTrace | None) -> SwingPicture | None:
    plan, settings = experiment.task.swing, experiment.settings
    if plan is None:
        return None
    planned = SwingTrace(plan.time, plan.x, plan.load[:, 0], plan.load[:, 1])
    return SwingPicture(planned, executed, settings.task.box, settings.load_radius)


def _joints(experiment: Experiment) -> JointTrace | None:
    names, limits = experiment.description.joint_names, experiment.description.limits
    time = experiment.channel(f"q.{names[0]}").time
    if not len(time):
        return None
    position, velocity = (np.column_stack([experiment.channel(f"{k}.{n}").value for n in names]) for k in "qv")
    return JointTrace(names, time, position, velocity, limits.lower, limits.upper, limits.velocity)
