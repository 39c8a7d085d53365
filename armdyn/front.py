"""Functions for scripts and notebooks, one call each: load, save, predict, simulate, inspect, fit, compare, repair."""

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np

from armdyn.arm.closed_loop.rollout import can_simulate_motion, simulated_positions, simulation_windows
from armdyn.arm.model import ArmModel
from armdyn.checked_study import AnyModel, CheckedStudy, ModelWithCatalogue, Runs, model_file_of, read_runs
from armdyn.discovery.result import Discovery
from armdyn.effects.catalogue import find_several
from armdyn.effects.effect import Effect
from armdyn.errors import InputError
from armdyn.identify import repair as repairs
from armdyn.identify.compare import Comparison
from armdyn.identify.diagnose import Diagnosis
from armdyn.identify.repair import Repair, require_fit
from armdyn.identify.sentence import Verdict
from armdyn.inspection.check import Inspection
from armdyn.inspection.inspect import inspect_runs
from armdyn.model import Model
from armdyn.model_file import read_model, write_model_file
from armdyn.recording.checks import check_run
from armdyn.run import Channel, Run, read_run

load = read_model


def save(model: Model | Repair, path: str | Path, *, force: bool = False) -> None:
    """Write a model to a file, which `load` and every command read.

    Args:
        model: the model; or a repair, whose model is written with its errors, which a check of motions needs.
        path: file to write, in TOML.
        force: replace an existing file.

    Raises:
        InputError: the file exists, or cannot be written; the fit of the repair is lost.
    """
    if Path(path).exists() and not force:
        raise InputError(f"{path} exists: choose another file, or replace it with force=True")
    if isinstance(model, Repair) and model.verdict is Verdict.LOST:
        raise InputError("the fit of this repair is lost: there is no repaired model to write")
    write_model_file(path, model_file_of(model))


def predict(model: AnyModel, run: Run | str | Path) -> Run:
    """Predict what the sensors of a recording should have read, by the model with its values as they are.

    An arm's torques follow from its recorded motion. A pendulum, or a base of your own, is simulated along the recorded
    inputs, from the state that the first samples show. Nothing is fitted: `compare` fits.

    Args:
        model: the model or a repair, or its file.
        run: the recording, or its file.

    Returns:
        The predicted channels, at the time stamps of the recording, such as ``tau.elbow`` or ``swing_angle``.

    Raises:
        InputError: a file cannot be read, or the recording has no channel that the model predicts.
    """
    known, read = _model_and_run(model, run)
    return Run(f"{read.name} predicted", _predicted_channels(known, read))


def residual(model: AnyModel, run: Run | str | Path) -> Run:
    """What the model, with its values as they are, leaves of what a recording measured: measured less predicted.

    Of a force/torque sensor it is the compensated wrench: what acts on the tool besides its weight and its inertia.

    Args:
        model: the model or a repair, or its file.
        run: the recording, or its file.

    Returns:
        The channels that the model predicts, without their prediction, at the time stamps of the recording.

    Raises:
        InputError: as `predict`.
    """
    known, read = _model_and_run(model, run)
    left = {
        name: Channel(c.time, read.channels[name].value - c.value, c.unit)
        for name, c in _predicted_channels(known, read).items()
    }
    return Run(f"{read.name} residual", left)


def simulate(model: AnyModel, run: Run | str | Path) -> Run:
    """Simulate the motion of a recording from its first state, by the model with its values as they are.

    An arm moves in closed loop with its drives where the recording has their commands, else by the recorded torques:
    without a controller its motion drifts away from the recorded one. For other models this is what `predict` does.

    Args:
        model: the model or a repair, or its file.
        run: the recording, or its file.

    Returns:
        The simulated channels, for an arm the positions ``q.<joint>``, at the time stamps of the recording.

    Raises:
        InputError: a file cannot be read, or a joint has neither torque nor command.
    """
    known, read = _model_and_run(model, run)
    arm = known.capability(ArmModel)
    if arm is None:
        return Run(f"{read.name} simulated", _predicted_channels(known, read))
    if not can_simulate_motion(arm, read):
        raise InputError(
            f"{read.name}: a simulation needs 'tau' of every joint, or its command and a drive with a known gain"
        )
    (whole,) = simulation_windows(read, arm.arm.joints, np.inf)
    with np.errstate(all="ignore"):  # a motion without a controller may run away
        moved = simulated_positions(arm, arm.theta(), whole)
    if not np.isfinite(moved).all():
        raise InputError(f"{read.name}: the simulated motion runs away: nothing resists these torques")
    channels = {
        f"q.{j}": Channel(whole.time, q, read.channels[f"q.{j}"].unit)
        for j, q in zip(arm.arm.joints, moved.T, strict=True)
    }
    return Run(f"{read.name} simulated", channels)


def _predicted_channels(model: Model, run: Run) -> dict[str, Channel]:
    """Predicted channels of a run, from the start state that its first samples show."""
    predicted = model.predict(run, model.with_values(model.guess_start_state(run)).theta())
    return {
        name: Channel(predicted.time[rows], predicted.values[rows], run.channels[name].unit)
        for name, rows in predicted.slices.items()
    }


def _model_and_run(model: AnyModel, run: Run | str | Path) -> tuple[Model, Run]:
    known = model_file_of(model).model
    read = known.with_model_channels(run if isinstance(run, Run) else read_run(run))
    known = known.adapted_to([read])
    check_run(known, read)
    return known, read


def fit(model: AnyModel, runs: Runs, *, trust_data: bool = False) -> Model:
    """Fit a model to recordings and return it with the fitted values and their standard deviations.

    Args:
        model: the model or a repair, or its file.
        runs: recordings, or their files.
        trust_data: go on where a recording contradicts its declaration.

    Raises:
        InputError: a file cannot be read, or the runs cannot be compared with the model.
        WrongRecordingError: a recording contradicts its declaration; see `inspect`.
        TaskFailedError: the fit has failed.
    """
    return require_fit(repairs.add(CheckedStudy.of(model, runs, effects=(), trusted=trust_data).study, ())).model


def inspect(runs: Runs, model: AnyModel | None = None) -> Inspection:
    """Check whether recordings are what they are declared to be: units, signs, columns, clocks, gaps.

    Args:
        runs: recordings, or their files.
        model: model of the recorded system, or its file; without it only the signals are checked.

    Raises:
        InputError: a file cannot be read, or the model comes first.
    """
    if isinstance(runs, Model):
        raise InputError("inspect(runs, model): give the recordings first, as they can be inspected without a model")
    read = read_runs(runs)
    return inspect_runs(read) if model is None else ModelWithCatalogue.of(model).inspect(read)


def compare(
    model: AnyModel, runs: Runs, held_out: Runs = (), exam: Runs = (), *, trust_data: bool = False
) -> Comparison:
    """Fit a model and find where it fails.

    Args:
        model: the model or a repair, or its file.
        runs: recordings to fit, or their files.
        held_out: recordings that are not fitted.
        exam: recordings that are used for nothing else: their error is computed at the very end.
        trust_data: go on where a recording contradicts its declaration.

    Raises:
        InputError: a file cannot be read, or the runs cannot be compared with the model.
        WrongRecordingError: a recording contradicts its declaration; see `inspect`.
    """
    return CheckedStudy.of(model, runs, held_out, exam, effects=(), trusted=trust_data).compare()


def diagnose(
    model: AnyModel,
    runs: Runs,
    held_out: Runs = (),
    effects: Iterable[Effect] | None = None,
    *,
    trust_data: bool = False,
) -> Diagnosis:
    """Find which effect a model lacks.

    Args:
        model: the model or a repair, or its file.
        runs: recordings to fit, or their files.
        held_out: recordings that help to choose effects, but are never fitted.
        effects: effects to choose from; by default the catalogue and the base's own.
        trust_data: go on where a recording contradicts its declaration.

    Raises:
        InputError: a file cannot be read, or the runs cannot be compared with the model.
        WrongRecordingError: a recording contradicts its declaration; see `inspect`.
    """
    return CheckedStudy.of(model, runs, held_out, effects=effects, trusted=trust_data).diagnose()


def add(
    model: AnyModel,
    effects: str | Effect | Iterable[str | Effect],
    runs: Runs,
    held_out: Runs = (),
    exam: Runs = (),
    *,
    trust_data: bool = False,
) -> Repair:
    """Add effects to a model, one after the other, whether or not the recordings need them, and refit it.

    Args:
        model: the model or a repair, or its file.
        effects: one or several effects, or their names, such as ``"rotor_inertia+joint_spring:elbow,wrist"``.
        runs: recordings to fit, or their files.
        held_out: recordings that are not fitted; the error on them is reported at every step.
        exam: recordings that are used for nothing else; the error on them is reported at every step.
        trust_data: go on where a recording contradicts its declaration.

    Raises:
        InputError: a file cannot be read, the runs cannot be compared, or an effect does not apply to such a model.
        UnknownNameError: there is no such effect.
        WrongRecordingError: a recording contradicts its declaration; see `inspect`.
    """
    known = ModelWithCatalogue.of(model)
    each = [effects] if isinstance(effects, str | Effect) else effects
    wanted = [one for e in each for one in ((e,) if isinstance(e, Effect) else find_several(e, known.catalogue))]
    known = replace(known, catalogue=tuple({e.name: e.on() for e in (*known.catalogue, *wanted)}.values()))
    adding = "+".join(e.name for e in wanted)
    return CheckedStudy.of(known, runs, held_out, exam, adding=adding, trusted=trust_data).add(wanted)


def repair(
    model: AnyModel,
    runs: Runs,
    held_out: Runs = (),
    effects: Iterable[Effect] | None = None,
    exam: Runs = (),
    *,
    trust_data: bool = False,
) -> Repair:
    """Find the effects that a model lacks and add them, until the remaining error is noise or no effect reduces it.

    Args:
        model: the model or a repair, or its file.
        runs: recordings to fit, or their files.
        held_out: recordings that help to choose effects, but are never fitted.
        effects: effects to choose from; by default the catalogue and the base's own.
        exam: recordings that are used for nothing else; the error on them is reported at every step.
        trust_data: go on where a recording contradicts its declaration.

    Raises:
        InputError: a file cannot be read, or the runs cannot be compared with the model.
        WrongRecordingError: a recording contradicts its declaration; see `inspect`.
    """
    return CheckedStudy.of(model, runs, held_out, exam, effects=effects, trusted=trust_data).repair()


def discover(
    model: AnyModel,
    runs: Runs,
    held_out: Runs = (),
    effects: Iterable[Effect] | None = None,
    *,
    trust_data: bool = False,
) -> Discovery:
    """Find a formula for the force that a model lacks; `Discovery.write` writes it as a file of effects.

    Args:
        model: the model or a repair, or its file.
        runs: recordings to fit, or their files.
        held_out: recordings that help to choose the formula, but are never fitted.
        effects: effects that are known already; by default the catalogue and the base's own.
        trust_data: go on where a recording contradicts its declaration.

    Raises:
        InputError: a file cannot be read, the runs cannot be compared, or there are no terms for such a model.
        WrongRecordingError: a recording contradicts its declaration; see `inspect`.
    """
    return CheckedStudy.of(model, runs, held_out, effects=effects, trusted=trust_data).discover()
