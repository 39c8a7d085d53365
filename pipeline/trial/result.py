"""Outcome of a trial: its numbers, the recording, and the robot's model."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from armdyn.control.task import SwingPlan
from armdyn.errors import ArmdynError, InputError
from armdyn.model_file import ModelFile, write_model_file
from armdyn.pendulum.model import PendulumModel
from armdyn.pendulum.path import gripper_path
from armdyn.quoting import shell_quoted_command
from armdyn.recording.units import KnownQuantity
from pipeline.answers_motion import investigation_json
from pipeline.fields import attributes_as_json
from pipeline.nodes.learning import LengthEstimate
from pipeline.nodes.scheduler import NodeTiming
from pipeline.record import Recorder
from pipeline.trial.ending import TrialEnding
from pipeline.trial.experiment import Experiment, Phase, PhaseSpan, recorded_channels
from pipeline.trial.investigation import Investigation
from pipeline.trial.rig import TrialRig
from pipeline.trial.settings import ProtocolSettings


@dataclass(frozen=True)
class TrialResult(TrialEnding):
    """Outcome of one trial: its ending, and its numbers.

    Attributes:
        length_guess: length of the string that was assumed at the start [m].
        true_length: true length [m]; None if it is unknown.
        length_estimate: length with which the swing was planned [m].
        length_std: standard deviation of the length [m]; 0 if it was not estimated.
        estimates: every update of the estimator.
        peak: largest magnitudes during the estimation of the length, or during the swing for a trial without it: "x",
            "v" and "a" of the gripper [m, m/s, m/s^2], "swing_angle" of the model [rad]; None if unknown.
        minimum_tension: smallest measured force before the end of the swing [N]; None if no force was measured.
        feasible: whether the planned swing passed the feasibility check; None for no plan.
        swing: planned swing; None for no plan.
        model: model with the last estimate.
        timing: computing times of the nodes.
        cycle_seconds: mean time in which SAC predicts the state and chooses an action [s].
        recording: MCAP file; None if no file was kept.
        signal: number of the signal that ended the trial; None for no signal.
        missed_cycles: number of cycles that the control loop left out because it was late; 0 with a simulated clock.
        notes: sentences on left-out readings and missed cycles; empty for none.
        investigation: result of the investigation before the trial; None for no investigation.
    """

    length_guess: float
    true_length: float | None
    length_estimate: float
    length_std: float
    estimates: tuple[LengthEstimate, ...]
    peak: Mapping[str, float | None]
    minimum_tension: float | None
    feasible: bool | None
    swing: SwingPlan | None
    model: PendulumModel
    timing: dict[str, NodeTiming]
    cycle_seconds: float
    recording: Path | None
    signal: int | None = None
    missed_cycles: int = 0
    notes: tuple[str, ...] = ()
    investigation: Investigation | None = None

    @property
    def repair_command(self) -> str | None:
        """Command line that repairs the model after a failed trial; None after success or a signal, or without data."""
        if self.success or not self.estimates or self.recording is None or self.signal is not None:
            return None
        kept = self.recording.parent
        return shell_quoted_command("repair", kept / "model.toml", kept / "trial.csv", "--output", "repaired.toml")

    def as_json(self) -> dict[str, Any]:
        """The outcome as JSON ``armdyn.trial/1``."""
        updates, solution = [e.seconds for e in self.estimates], self.swing.solution if self.swing else None
        return {
            "schema": "armdyn.trial/1",
            **attributes_as_json(
                self,
                "success message length_guess length_true= length_estimate length_std",
                length_true=self.true_length,
            ),
            "estimates": [[e.time, e.value, e.std] for e in self.estimates],
            **attributes_as_json(self, "peak minimum_tension"),
            "feasible": bool(self.feasible),
            "planning": {
                "iterations": len(solution.iterations) if solution else 0, "cost": solution.cost if solution else None,
            },
            "seconds": {
                "estimation_cycle": self.cycle_seconds,
                "estimator_update": sum(updates) / len(updates) if updates else 0.0,
                "planning": solution.seconds if solution else 0.0,
            },
            "parameters": {name: attributes_as_json(p, "value std unit") for name, p in self.model.parameters.items()},
            **attributes_as_json(self, "recording missed_cycles"),
            **({"notes": list(self.notes)} if self.notes else {}),
            **({"investigation": investigation_json(self.investigation)} if self.investigation else {}),
        }  # fmt: skip


def trial_result(
    experiment: Experiment,
    ending: TrialEnding,
    true_length: float | None,
    recording: Path | None,
    investigation: Investigation | None = None,
) -> TrialResult:
    """Outcome of a finished trial.

    Args:
        experiment: finished protocol.
        ending: ending of the protocol.
        true_length: true length of the string [m]; None if it is unknown.
        recording: MCAP file; None if no file was kept.
        investigation: result of the investigation before the trial; None for no investigation.
    """
    history, report, cycles = experiment.estimator.history, experiment.task.feasibility, experiment.sac.seconds
    force = experiment.channel("load_force").value
    cycle = experiment.scheduler.timing[experiment.drive.name]
    late = (f"the loop was late: {cycle.skipped} of {cycle.skipped + cycle.steps} cycles were missed",)
    return TrialResult(
        **vars(ending),
        length_guess=experiment.settings.length_guess,
        true_length=true_length,
        length_estimate=experiment.estimator.model.value("length"),
        length_std=history[-1].std if history else 0.0,
        estimates=tuple(history),
        peak=_peaks(experiment),
        minimum_tension=float(force.min()) if len(force) else None,
        feasible=None if report is None else report.feasible,
        swing=experiment.task.swing,
        model=experiment.estimator.model,
        timing=experiment.scheduler.timing,
        cycle_seconds=float(np.mean(cycles)) if cycles else 0.0,
        recording=recording,
        signal=experiment.interrupted,
        missed_cycles=cycle.skipped,
        notes=experiment.measurement.notes + experiment.estimator.left_out + (late if cycle.skipped else ()),
        investigation=investigation,
    )


def _peaks(experiment: Experiment) -> dict[str, float | None]:
    """Largest magnitudes of the gripper's motion while learning, or during the swing where nothing was learnt."""
    span = experiment.span(Phase.LEARN if experiment.settings.estimate else Phase.SWING)
    peaks: dict[str, float | None] = dict.fromkeys(("x", "v", "a", "swing_angle"))
    if span is not None:
        for name in ("x", "v", "a"):
            channel = experiment.channel(f"reference.{name}")
            inside = (channel.time >= span.start) & (channel.time <= span.end)
            peaks[name] = float(np.max(np.abs(channel.value[inside]))) if inside.any() else None
        peaks["swing_angle"] = _largest_angle(experiment, span)
    return peaks


def _largest_angle(experiment: Experiment, span: PhaseSpan) -> float | None:
    """Largest swing angle [rad] of the model with the last estimate along the measured path; None where unknown."""
    if experiment.estimator.start is None:
        swing = experiment.task.swing
        return float(np.max(np.abs(swing.angle))) if swing else None
    try:
        run = experiment.measurement.run()
    except InputError:  # the trial ended before anything was measured
        return None
    path, model = gripper_path(run), experiment.estimator.model
    try:
        angles = model.rollout(path, model.theta(), channels=("load_force",)).states[:, 0]
    except ArithmeticError:  # the model cannot be computed, which also ended the trial
        return None
    angles = angles[: int((span.end - span.start) / path.dt)]
    return float(np.max(np.abs(angles))) if len(angles) and np.isfinite(angles).all() else None


@contextmanager
def open_recording(rig: TrialRig, folder: Path, settings: ProtocolSettings, name: str = "trial") -> Iterator[Recorder]:
    """Recorder of a trial for a ``with`` block; after an exception in the block the recording is completed, too.

    Args:
        rig: robot with its description.
        folder: folder of the recording.
        settings: settings with noise and mass, which the recording contains.
        name: name of the file, without its ending.
    """
    recorder = rig.recorder(
        folder / f"{name}.mcap",
        recorded_channels(rig.arm.joint_names),
        description=rig.description,
        noise={"load_force": settings.force_noise},
        known={"mass": KnownQuantity(settings.mass, settings.mass_std, "kg")},
    )
    try:
        yield recorder
    except BaseException:
        with suppress(ArmdynError, OSError):  # an error while completing it must not hide the first one
            recorder.close()
        raise


def finish_recording(experiment: Experiment, ending: TrialEnding, recorder: Recorder, folder: Path) -> TrialEnding:
    """Complete the recording of a trial, and write the model to ``model.toml``.

    Args:
        experiment: finished protocol.
        ending: ending of the protocol.
        recorder: recorder to close.
        folder: folder of the model file.

    Returns:
        The ending; its message also contains failures to write.
    """
    unfinished = ""
    try:
        recorder.close()
    except (ArmdynError, OSError) as error:
        unfinished = str(error)
    problems = [problem for problem in (recorder.failure, unfinished) if problem]
    try:
        write_model_file(folder / "model.toml", ModelFile(experiment.estimator.model, {}))
    except (ArmdynError, OSError) as error:
        problems.append(f"the model was not written: {error}")
    if not problems:
        return ending
    new = [problem for problem in problems if problem not in ending.message]
    return replace(ending, message="; ".join([ending.message, *new]), unwritten=problems[0])
