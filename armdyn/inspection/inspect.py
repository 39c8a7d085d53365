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
from armdyn.inspection.kinematics import degree_checks, rate_checks, without_inconsistent_rates
from armdyn.inspection.missing_effects import MissingEffects
from armdyn.inspection.mistakes import arm_mistakes
from armdyn.inspection.signals import (
    SIGNAL_CHECKS,
    changes_beyond_noise,
    encoder_step_times,
    range_checks,
    wrapped_angle_checks,
)
from armdyn.inspection.swing import SampledSwingRun, pendulum_mistakes
from armdyn.inspection.together import SampledArmRuns, SampledRuns
from armdyn.inspection.wrench import wrench_checks
from armdyn.model import Model
from armdyn.recording.channels import MIN_COMPARED_CHANNEL_SAMPLES, WRENCH_CHANNELS, channel_kind
from armdyn.recording.checks import check_run, check_stamps, check_steps
from armdyn.recording.gaps import channels_between, gaps_of
from armdyn.recording.spikes import without_saturation, without_spikes
from armdyn.run import Run
from armdyn.threads import one_thread

MAX_COMPARED_SECONDS = 60.0
"""Longest part of a recording, s, from its middle, that an inspection compares with the model."""
MAX_RECORDINGS_COMPARED_TOGETHER = 12
"""Largest number of recordings of an arm that are compared with the model together, for the memory of their sums."""
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
        effects: effects that the model may lack, which are not mistakes of a recording; None means all possible ones.
        adding: effects that are going to be added to the model, whose values recordings may state.
    """
    if effects is None:
        effects = available_effects(model) if model is not None else ()
    effects, runs = tuple(effects), with_distinct_names(runs)
    if model is not None:
        runs = [model.with_model_channels(run) for run in runs]
    each = [(run, *signal_checks(run)) for run in runs]
    if model is not None:
        model = _adapted(model, runs, [check for _, _, checks in each for check in checks])
    compare = COMPARISONS.get(model.base) if model is not None else None
    found: list[Check] = []
    physical: list[Check] = []
    if compare is not None:
        comparable = {
            run.name: mended for run, mended, checks in each if mended is not None and _is_comparable(mended, checks)
        }
        physical = list(compare(model, [_comparable_piece(run) for run in comparable.values()], effects))
    for run, mended, checks in each:
        found += checks
        if mended is None:
            continue
        found += (check for check in physical if check.run == run.name)
        if compare is None or not any(channel_kind(name).measured for name in mended.channels):
            turned = list(degree_checks(mended, model.robot)) if model is not None and model.robot is not None else []
            found += turned or range_checks(mended)
            for check in turned:
                mended = (check.correction or Correction()).applied_to(mended)
        for check in physical:
            mended = (check.correction or Correction()).applied_to(mended) if check.run == run.name else mended
        refuses = check_steps if model is None else partial(check_run, model, adding=adding)
        found += [*rate_checks(mended), *_refused(mended, refuses)]
    beside = CHECKS_OF_OTHER_JOINTS.get(model.base) if model is not None else None
    return Inspection(tuple(runs), sorted_by_severity([*found, *(beside(model, runs) if beside else ())]))


def require_usable(inspection: Inspection) -> None:
    """Refuse recordings that are not what they are declared to be.

    Raises:
        WrongRecordingError: a recording is unusable; the error has the inspection.
    """
    if not inspection.usable:
        raise WrongRecordingError(inspection)


def signal_checks(run: Run) -> tuple[Run | None, list[Check]]:
    """The recording with unwrapped angles, None if its time stamps are unusable, and findings on its signals."""
    refused = _refused(run, check_stamps)
    if refused:
        return None, refused
    turned = list(wrapped_angle_checks(run))
    for check in turned:
        run = (check.correction or Correction()).applied_to(run)
    return run, [*turned, *(check for look in SIGNAL_CHECKS for check in look(run))]


def _adapted(model: Model, runs: Sequence[Run], checks: Iterable[Check]) -> Model | None:
    """The model with what recordings determine of it; None where recordings that are wrong determine nothing."""
    try:
        return model.adapted_to(runs)
    except InputError:
        if any(check.severity is Severity.WRONG for check in checks):
            return None
        raise


def _is_comparable(run: Run, checks: Iterable[Check]) -> bool:
    """Whether a recording can be compared: it moves, and its signals alone show no mistake that is not corrected."""
    wrong = (check for check in checks if check.severity is Severity.WRONG and check.kind != "wrapped")
    return bool(run.channels) and not any(check.kind == "no_motion" for check in checks) and not any(wrong)


def _comparable_piece(run: Run) -> Run:
    """The longest sound part of a recording, for a comparison with a model."""
    piece = longest_piece(run, MAX_COMPARED_SECONDS)
    piece = without_spikes(piece, piece.channels)
    piece = without_saturation(piece, [name for name in piece.channels if channel_kind(name).measured])
    return without_inconsistent_rates(piece)


def _refused(run: Run, check: Callable[[Run], None]) -> list[Check]:
    """Findings for what a comparison would refuse, reported before the comparison."""
    try:
        check(run)
    except InputError as error:
        said, _, remedy = str(error).removeprefix(f"{run.source or run.name}: ").rpartition(": ")
        return [Check("unusable", Severity.WRONG, run.name, (), said, remedy)]
    return []


def _arm_checks(model: ArmModel, runs: Sequence[Run], effects: tuple[Effect, ...]) -> Iterator[Check]:
    """Findings from comparing recordings with an arm's model, all together; empty where that is not possible."""
    of_torques = (e for e in effects if e.acts_on in model.stages and not _needs_wrench(e))
    missing = MissingEffects(model, tuple(of_torques))
    sampled = [SampledArmRun(missing, run) for run in runs if _has_all(run, model) and model.force_channels(run)]
    for first in range(0, len(sampled), MAX_RECORDINGS_COMPARED_TOGETHER):
        together = SampledArmRuns(tuple(sampled[first : first + MAX_RECORDINGS_COMPARED_TOGETHER]))
        yield from physics.mistake_checks(together, arm_mistakes)
    for run in runs:
        if model.sensors and _has_all(run, model):
            yield from wrench_checks(model, run)


def _needs_wrench(effect: Effect) -> bool:
    """Whether only the wrench of a force/torque sensor shows an effect, so that torques are compared without it."""
    return effect.acts_on == "wrench" or not WRENCH_CHANNELS.keys().isdisjoint(effect.needs)


def _has_all(run: Run, model: ArmModel) -> bool:
    """Whether a recording has what a comparison with an arm needs; the comparison itself reports what is missing."""
    try:
        return not _too_few(run, [*model.predicted_channels(run), *(f"q.{j}" for j in model.arm.joints)])
    except InputError:
        return False


def _pendulum_checks(model: Model, runs: Sequence[Run], _: tuple[Effect, ...]) -> Iterator[Check]:
    """Findings from comparing each recording with a pendulum's model; empty where that is not possible."""
    for swing in (SampledSwingRun(model, run) for run in runs):
        if swing.channels and not _too_few(swing.run, swing.channels):
            yield from physics.mistake_checks(SampledRuns((swing,)), pendulum_mistakes)


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
            said += "and is not a joint of the model"
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


COMPARISONS: Mapping[str, Callable[[Any, Sequence[Run], tuple[Effect, ...]], Iterable[Check]]] = {
    "arm": _arm_checks, "pendulum": _pendulum_checks,
}  # fmt: skip
"""Function that compares recordings with a model, by the model's base."""
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
