"""What the report of a trial is told."""

import numpy as np

from pipeline.report.page import Level, Report
from pipeline.report.trial import trial_report
from pipeline.report.trial_data import (
    BoxOutline,
    EstimateTrace,
    ForceTrace,
    GripperTrace,
    JointTrace,
    Margin,
    NodeTiming,
    SwingPicture,
    SwingTrace,
    TrialReportData,
)
from pipeline.trial.experiment import Experiment
from pipeline.trial.result import TrialResult


def report_of(experiment: Experiment, result: TrialResult, command: str = "") -> Report:
    """The report of a trial that has run."""
    c = experiment.settings
    hidden = ", ".join(f"{name} {value:g}" for name, value in experiment.robot.truth.hidden.items())
    level = Level.GOOD if result.success else Level.BAD
    feasibility = experiment.feasibility
    return trial_report(
        TrialReportData(
            level=level,
            verdict=result.message[:1].upper() + result.message[1:],
            subtitle=(
                f"Simulated Baxter, load {1e3 * c.mass:g} g on a string of {c.length:g} m, seed {c.seed}, "
                f"hidden: {hidden or 'nothing'}"
            ),
            command=command,
            phases=tuple(experiment.phases),
            notes=_notes(experiment),
            estimates=(_estimate(experiment),) if result.estimates else (),
            force=_force(experiment),
            gripper=_gripper(experiment),
            swing=_swing(experiment),
            joints=_joints(experiment),
            margins=tuple(
                Margin(m.limit, m.joint, m.value, m.bound, m.unit, m.used, m.time)
                for m in (feasibility.margins if feasibility else ())
            ),
            nodes=tuple(
                NodeTiming(name, _period(experiment, name), t.steps, t.mean, t.longest, t.overruns)
                for name, t in result.timing.items()
            ),
        )
    )


def _notes(experiment: Experiment) -> tuple[str, ...]:
    notes = ["The box is not the paper's, which gives none: it was chosen so that the paper's table comes out."]
    if not experiment.settings.estimate:
        notes.append("Nothing was learnt in this trial: the swing was planned with the guess.")
    return tuple(notes)


def _period(experiment: Experiment, name: str) -> float:
    return next(node.period for node in experiment.nodes if node.name == name)


def _estimate(experiment: Experiment) -> EstimateTrace:
    c, history = experiment.settings, experiment.estimator.history
    return EstimateTrace(
        name="length",
        unit="m",
        time=np.array([e.time for e in history]),
        value=np.array([e.value for e in history]),
        std=np.array([e.std for e in history]),
        guess=c.length_guess,
        truth=c.length,
    )


def _force(experiment: Experiment) -> ForceTrace | None:
    """Measured force, and what the model with the last estimate says along the measured path."""
    recorded = experiment.recorded["load_force"]
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


def _gripper(experiment: Experiment) -> GripperTrace:
    reference, actual = experiment.recorded["reference.x"], experiment.recorded["gripper_x"]
    return GripperTrace(actual.time, np.interp(actual.time, reference.time, reference.value), actual.value)


def _swing(experiment: Experiment) -> SwingPicture | None:
    plan, started = experiment.task.swing, experiment.task.started
    if plan is None:
        return None
    box, line = experiment.settings.plant.box, experiment.description.line
    planned = SwingTrace(plan.time, plan.x, plan.load[:, 0], plan.load[:, 1])
    executed = None
    if started is not None:
        history = experiment.robot.history()
        during = history.time >= started

        def along(points: np.ndarray) -> np.ndarray:
            return (points - line.origin) @ line.direction

        executed = SwingTrace(
            history.time[during] - started,
            along(history.pivot[during]),
            along(history.load[during]),
            history.load[during, 2] - line.origin[2],
        )
    outline = BoxOutline(box.near_wall, box.width, box.rim, box.height) if box else None
    return SwingPicture(planned, executed, outline, experiment.settings.plant.load_radius)


def _joints(experiment: Experiment) -> JointTrace:
    names, limits = experiment.description.joint_names, experiment.description.limits
    position, velocity = (np.column_stack([experiment.recorded[f"{k}.{n}"].value for n in names]) for k in "qv")
    return JointTrace(
        names,
        experiment.recorded[f"q.{names[0]}"].time,
        position,
        velocity,
        limits.lower,
        limits.upper,
        limits.velocity,
    )
