"""Checks that a recording must pass before it is compared with a model: clock, positions, stated values.

A well-formed file may still be useless: milliseconds declared as seconds, a clock that was set during the recording,
one impossible sample of an encoder. A simulation over such a time span would need gigabytes, so the file is refused
here.
"""

from collections.abc import Iterable, Sequence

import numpy as np

from armdyn.effects.effect import Effect, recorded_columns
from armdyn.errors import InputError, UnknownNameError, error_location
from armdyn.model import Model
from armdyn.parameter import RecordedColumn
from armdyn.recording.sidecar import KNOWN_POSITIVE_VALUE_UNITS
from armdyn.recording.units import si_factor
from armdyn.run import Run
from urdf.bounds import MIN_NONZERO_INPUT_MAGNITUDE

MAX_SIMULATION_STEPS_PER_SAMPLE = 40
"""Largest average number of simulation steps per sample, which limits the memory: with more steps (0.2 s per sample of
a load or an arm) the samples do not describe the motion."""
SMALL_SIMULATION_STEPS = 40_000
"""Number of steps of a small simulation: a recording of this length, 200 s of a load or an arm, may have any gaps."""
MIN_SAMPLE_INTERVAL_SECONDS = 2e-5
"""Interval between samples, s, below which the unit of time is wrong: load cells and joints are sampled at 10 kHz at
most."""
REPEATED_SAMPLE_INTERVAL_SECONDS = 5e-7
"""Interval, s, below which two samples are one sample with two stamps."""
IMPOSSIBLE_STEP_AND_SPEED_BY_UNIT = {"rad": (10.0, 300.0), "m": (1.0, 50.0)}
"""Step between samples, and speed per s, that no joint or gripper exceeds both; an angle that wraps around after a turn
(6.3 rad) makes a smaller step."""


def check_run(model: Model, run: Run, adding: Sequence[Effect] = ()) -> None:
    """Refuse a recording that this model cannot use.

    Args:
        model: the model of the comparison.
        run: the recording.
        adding: effects that the model is about to get; their values may be stated as well.

    Raises:
        InputError: it names the file, the channel or value and the time, what is wrong and what to do.
    """
    with error_location(run.source or run.name):
        _check_known(model, run, adding)
        check_stamps(run)
        _check_span(run, model.step)
        _check_further(run, recorded_columns((*model.effects, *adding)))
        check_steps(run)
        _check_sizes(run)


def _check_sizes(run: Run) -> None:
    """Refuse a channel whose values are not 0, but all too small for a sensor."""
    for name, channel in run.channels.items():
        largest = float(np.abs(channel.value).max(initial=0.0))
        if name not in run.base_channels and 0.0 < largest < MIN_NONZERO_INPUT_MAGNITUDE:
            raise InputError(f"'{name}' is {largest:.3g} {channel.unit} at most, which no sensor gives: check its unit")


def _check_known(model: Model, run: Run, adding: Sequence[Effect]) -> None:
    for effect in adding:
        if model.can_add_effect(effect):
            model = model.with_effect(effect)
    for name, known in run.known.items():
        if name not in model.parameters:
            if name in KNOWN_POSITIVE_VALUE_UNITS:
                continue  # quantities of a hanging load are written with every recording, also of an arm
            raise _unknown(model, name)
        with error_location(f"[known] {name}"):
            si_factor(known.unit, model.parameters[name].unit)


def _unknown(model: Model, name: str) -> InputError:
    from armdyn.effects.catalogue import CATALOGUE

    effect = name.partition(".")[0]
    if effect in CATALOGUE and not model.joints_having_effect(effect):
        return InputError(
            f"[known] {name}: this model lacks the effect '{effect}': add it with 'armdyn add', or remove the line"
        )
    return UnknownNameError("quantity in [known]", name, model.names)


def check_stamps(run: Run) -> None:
    """Refuse time stamps that no sensor gives.

    Raises:
        InputError: it names the channel, what is wrong and what to do.
    """
    for name, channel in run.channels.items():
        if len(channel) < 2 or name in run.base_channels:  # a user's own channel may have any rate
            continue
        steps = np.diff(channel.time)
        typical, least = float(np.median(steps)), int(np.argmin(steps))
        if typical < MIN_SAMPLE_INTERVAL_SECONDS:
            raise InputError(
                f"time: '{name}' has a sample every {typical:.3g} s, which no sensor does: check the unit of 'time', "
                "such as 'time [s]'"
            )
        if steps[least] < REPEATED_SAMPLE_INTERVAL_SECONDS:
            raise InputError(
                f"time: '{name}' has two samples {steps[least]:.3g} s apart at {channel.time[least]:.9g} s: "
                "remove one of them"
            )


def _check_span(run: Run, step: float) -> None:
    """Refuse a recording that is too long for its number of samples, with simulation steps of `step` s."""
    channels = {name: c for name, c in run.channels.items() if len(c) > 1}
    if not channels:
        return
    names = list(channels)
    start, end = (np.array([c.time[i] for c in channels.values()]) for i in (0, -1))
    if end.max() - start.min() <= step * max(
        SMALL_SIMULATION_STEPS, MAX_SIMULATION_STEPS_PER_SAMPLE * max(map(len, channels.values()))
    ):
        return
    for name, channel in channels.items():
        span, steps = float(channel.time[-1] - channel.time[0]), np.diff(channel.time)
        if span <= step * max(SMALL_SIMULATION_STEPS, MAX_SIMULATION_STEPS_PER_SAMPLE * len(channel)):
            continue
        longest = int(np.argmax(steps))
        if steps[longest] > 0.5 * span:
            raise InputError(
                f"time: '{name}' jumps by {steps[longest]:.6g} s after {channel.time[longest]:.9g} s: "
                "cut the recording there into two files"
            )
        raise InputError(
            f"time: '{name}' has a sample every {np.median(steps):.3g} s over {span:.6g} s, too few to show a motion "
            f"in steps of {step:.3g} s: check the unit of 'time' (milliseconds are 'time [ms]'), record faster, or "
            "give a slow base of your own a longer 'period'"
        )
    first, last = names[int(np.argmin(start))], names[int(np.argmax(end))]
    raise InputError(
        f"time: '{first}' begins at {start.min():.9g} s and '{last}' ends at {end.max():.9g} s: "
        "record all channels with one clock"
    )


def _check_further(run: Run, columns: Iterable[RecordedColumn]) -> None:
    """Refuse further quantities in another unit than effects read, or that do not overlap the channels in time."""
    for column in columns:
        column.interpolate(run.extra, np.zeros(0))
    start = min((channel.time[0] for channel in run.channels.values()), default=-np.inf)
    end = max((channel.time[-1] for channel in run.channels.values()), default=np.inf)
    for name, channel in run.extra.items():
        if channel.time[0] > end or channel.time[-1] < start:
            raise InputError(
                f"time: '{name}' was recorded from {channel.time[0]:.9g} to {channel.time[-1]:.9g} s, all else from "
                f"{start:.9g} to {end:.9g} s: record all with one clock"
            )


def check_steps(run: Run) -> None:
    """Refuse successive positions that no joint or gripper can have.

    Raises:
        InputError: it names the channel, the place, what is wrong and what to do.
    """
    for name, channel in run.channels.items():
        bound = IMPOSSIBLE_STEP_AND_SPEED_BY_UNIT.get(channel.unit)
        if bound is None or name.partition(".")[0] not in ("q", "swing_angle", "gripper_x", "gripper_z"):
            continue
        step, interval = np.diff(channel.value), np.diff(channel.time)
        beyond = np.flatnonzero((np.abs(step) > bound[0]) & (np.abs(step) > bound[1] * interval))
        if beyond.size:
            i = int(beyond[0])
            raise InputError(
                f"'{name}' goes from {channel.value[i]:.6g} to {channel.value[i + 1]:.6g} {channel.unit} within "
                f"{interval[i]:.3g} s at {channel.time[i + 1]:.6g} s, which nothing does: empty the cells where the "
                "sensor failed, or check the unit"
            )
