"""Check whether recordings are what they are declared to be."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from armdyn.arm.carried import movable_joints, moving_joints_outside_arm_model
from armdyn.arm.model import ArmModel
from armdyn.effects.effect import Effect
from armdyn.effects.user import available_effects
from armdyn.errors import InputError
from armdyn.identify.prepare import with_distinct_names
from armdyn.inspection import physics
from armdyn.inspection.arm import SampledArmRun
from armdyn.inspection.check import (
    Check,
    Inspection,
    Severity,
    WrongRecordingError,
    rounded,
    sorted_by_severity,
)
from armdyn.inspection.correction import Correction
from armdyn.inspection.holds import sticking_spans
from armdyn.inspection.kinematics import rate_checks, without_inconsistent_rates
from armdyn.inspection.mistakes import arm_mistakes
from armdyn.inspection.signals import (
    SIGNAL_CHECKS,
    changes_beyond_noise,
    encoder_step_times,
    range_checks,
    wrapped_angle_checks,
)
from armdyn.inspection.swing import SampledSwingRun, pendulum_mistakes
from armdyn.model import Model
from armdyn.recording.channels import MIN_COMPARED_CHANNEL_SAMPLES, channel_kind
from armdyn.recording.checks import check_run, check_stamps, check_steps
from armdyn.recording.gaps import channels_between, gaps_of
from armdyn.recording.spikes import without_saturation, without_spikes
from armdyn.run import Run
from armdyn.threads import one_thread

MAX_COMPARED_SECONDS = 60.0
"""Longest part of a recording, s, from its middle, that an inspection compares with the model."""
MIN_COMPARED_SAMPLES = 60
"""Least number of samples of every channel for a comparison of a recording with the model."""


@one_thread
def inspect_runs(
    runs: Sequence[Run],
    model: Model | None = None,
    effects: Iterable[Effect] | None = None,
    adding: Sequence[Effect] = (),
) -> Inspection:
    """Inspect recordings: check their signals, and compare them with a model.

    Args:
        runs: the recordings.
        model: model of the robot; without it only signals are checked, units against ranges, and rates against
            positions.
        effects: effects that the model may lack, which are no mistake of a recording; None means all possible ones.
        adding: effects that are going to be added to the model, whose values recordings may state.
    """
    if effects is None:
        effects = available_effects(model) if model is not None else ()
    effects, runs = tuple(effects), with_distinct_names(runs)
    if model is not None:
        runs = [model.with_model_channels(run) for run in runs]
        model = model.adapted_to(runs)
    found = [check for run in runs for check in checks_of_run(run, model, effects, adding)]
    beside = CHECKS_OF_OTHER_JOINTS.get(model.base) if model is not None else None
    return Inspection(tuple(runs), sorted_by_severity([*found, *(beside(model, runs) if beside else ())]))


def require_usable(inspection: Inspection) -> None:
    """Refuse recordings that are not what they are declared to be.

    Raises:
        WrongRecordingError: a recording is unusable; the error has the inspection.
    """
    if not inspection.usable:
        raise WrongRecordingError(inspection)


def checks_of_run(
    run: Run, model: Model | None = None, effects: tuple[Effect, ...] = (), adding: Sequence[Effect] = ()
) -> list[Check]:
    """All checks of one recording, for a model that can have `effects` and is about to get those of `adding`."""
    refused = _refused(run, check_stamps)
    if refused:
        return refused
    turned = list(wrapped_angle_checks(run))
    for check in turned:
        run = (check.correction or Correction()).applied_to(run)
    found = [*turned, *(check for look in SIGNAL_CHECKS for check in look(run))]
    still = any(check.kind == "no_motion" for check in found)
    mended = run
    compare = COMPARISONS.get(model.base) if model is not None else None
    if compare is None:
        found += range_checks(run)
    elif run.channels and not still:
        piece = longest_piece(run, MAX_COMPARED_SECONDS)
        piece = without_spikes(piece, piece.channels)
        piece = without_saturation(piece, [name for name in piece.channels if channel_kind(name).measured])
        for check in compare(model, without_inconsistent_rates(piece), effects):
            found.append(replace(check, run=run.name))
            mended = (check.correction or Correction()).applied_to(mended)
    refuses = check_steps if model is None else partial(check_run, model, adding=adding)
    return [*found, *rate_checks(mended), *_refused(mended, refuses)]


def _refused(run: Run, check: Callable[[Run], None]) -> list[Check]:
    """Findings for what a comparison would refuse, reported before the comparison."""
    try:
        check(run)
    except InputError as error:
        said, _, remedy = str(error).removeprefix(f"{run.source or run.name}: ").rpartition(": ")
        return [Check("unusable", Severity.WRONG, run.name, (), said, remedy)]
    return []


def _arm_checks(model: ArmModel, run: Run, effects: tuple[Effect, ...]) -> Iterable[Check]:
    """Findings from comparing a recording with an arm's model; empty where that is not possible."""
    try:
        used = [*model.predicted_channels(run), *(f"q.{j}" for j in model.arm.joints)]
    except InputError:
        return ()  # the comparison reports what is missing
    if _too_few(run, used):
        return ()
    return physics.mistake_checks(
        SampledArmRun(model, run, tuple(e for e in effects if e.acts_on in model.stages)), arm_mistakes
    )


def _pendulum_checks(model: Model, run: Run, _: tuple[Effect, ...]) -> Iterable[Check]:
    """Findings from comparing a recording with a pendulum's model; empty where that is not possible."""
    swing = SampledSwingRun(model, run)
    return (
        physics.mistake_checks(swing, pendulum_mistakes) if swing.channels and not _too_few(run, swing.channels) else ()
    )


def _too_few(run: Run, names: Iterable[str]) -> bool:
    return any(len(run.channels[name]) < MIN_COMPARED_SAMPLES for name in names)


def _joints_beside(model: ArmModel, runs: Sequence[Run]) -> Iterator[Check]:
    """Find joints that are not the model's but move in its recordings."""
    held = moving_joints_outside_arm_model(model.arm, runs)
    unknown = {joint for run in runs for joint in run.joints} - set(movable_joints(model.arm))
    for run in runs:
        for joint in run.joints:
            position = run.channels[f"q.{joint}"]
            said = f"q.{joint} moves by {rounded(float(np.ptp(position.value)))} {position.unit}, "
            said += "and is no joint of the model"
            if joint in model.arm.carried:
                severity, more = Severity.NOTE, ", which moves it as recorded and explains no torque of it"
                remedy = "nothing to do; to explain its torque, make the model with it: 'armdyn new arm --joints ...'"
            elif joint in held:
                severity, more = Severity.SUSPECT, ", which holds it at its zero, as not all recordings have it"
                remedy = "compare recordings without it apart, or record it in all of them"
            elif joint in unknown and changes_beyond_noise(position):
                severity, more = Severity.NOTE, " nor of its description"
                remedy = "nothing to do, unless it carries the arm or its tool: then take a description that has it"
            else:
                continue
            yield Check("joint_left_out", severity, run.name, (f"q.{joint}",), said + more, remedy)


COMPARISONS: Mapping[str, Callable[[Any, Run, tuple[Effect, ...]], Iterable[Check]]] = {
    "arm": _arm_checks, "pendulum": _pendulum_checks,
}  # fmt: skip
"""Function that compares a recording with a model, by the model's base."""
CHECKS_OF_OTHER_JOINTS: Mapping[str, Callable[[Any, Sequence[Run]], Iterable[Check]]] = {"arm": _joints_beside}


def longest_piece(run: Run, seconds: float) -> Run:
    """The longest part of a run without a gap, a step or a sticking joint, cut to at most `seconds`."""
    begin = min(float(c.time[0]) for c in run.channels.values())
    end = max(float(c.time[-1]) for c in run.channels.values())
    spans = sorted([*gaps_of(run), *((t, t) for t in encoder_step_times(run)), *sticking_spans(run)])
    if not spans and end - begin <= seconds:
        return run
    edges = [begin, *(t for span in spans for t in span), end]
    edges = [max(edges[: i + 1]) for i in range(len(edges))]
    first, last = max(zip(edges[::2], edges[1::2], strict=True), key=lambda piece: piece[1] - piece[0])
    if last - first > seconds:
        middle = 0.5 * (first + last)
        first, last = middle - 0.5 * seconds, middle + 0.5 * seconds
    return replace(run, channels=channels_between(run, first, last, MIN_COMPARED_CHANNEL_SAMPLES))
