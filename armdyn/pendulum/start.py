r"""Find the motion of a load at the start of a recording, and the parts of a recording that can be compared.

A free swing of amplitude A passes the angle phi at the rate phi' = ± sqrt(2 g/l (cos phi - cos A)). A load cell does
not contain the orbit and the phase at the start, and a fit cannot guess them: at angle and rate 0 every derivative with
respect to the start vanishes by symmetry.
"""

from collections.abc import Iterable

import numpy as np

from armdyn.pendulum.path import gripper_path
from armdyn.recording.channels import MIN_COMPARED_CHANNEL_SAMPLES, Channel
from armdyn.recording.gaps import channels_between, runs_of_parts, time_spans_in_words
from armdyn.recording.noise import noise_std_from_differences
from armdyn.run import Run

TRIED_SWING_AMPLITUDES_RADIANS = (0.06, 0.2, 0.45, 0.8, 1.2, 1.7, 2.3, 2.8, 3.05)
"""Amplitudes of swings that are tried as the motion at the start, rad; a few Gauss-Newton steps over one period bridge
their distance."""
TRIED_PHASES_PER_AMPLITUDE = 8
"""Number of phases of a swing that are tried for each amplitude."""
TRIED_FULL_ROTATION_RATE_RATIOS = (1.2,)
"""Rates at the lowest point of full rotations that are tried, over the rate that just reaches the upright."""
MAX_INTERPOLATED_GAP_SECONDS = 0.25
"""Longest gap in the gripper's positions, s, over which a spline interpolates motions of up to 1.5 Hz to 2 %."""
MAX_STILL_DISPLACEMENT_METRES = 1e-3
"""Largest displacement of the gripper, m, over a gap of its positions for which it counts as at rest."""
HELD_LOAD_SHARE_OF_SWING_RANGE = 0.03
"""Range of the motion of a load held by a hand, as a share of the swing's range."""
HELD_LOAD_RANGE_NOISE_STDS = 5.0
"""Range of the measured motion of a load held by a hand, in standard deviations of the noise."""
MIN_SAMPLES_AFTER_RELEASE = 3
"""Number of successive samples away from the held position from which the load counts as released; fewer are a
glitch."""
MIN_CAUGHT_RANGE_TO_DECREASE_RATIO = 3.5
"""Ratio of a swing's last range to its decrease in the period before, from which the load was caught by hand; dry
friction stops a swing with a ratio of at most 1.75."""


def start_parameters(
    run: Run, length: float, plane: Iterable[tuple[float, float]] | np.ndarray
) -> list[dict[str, float]]:
    """Start parameters of a run for each angle, rad, and swing rate, rad/s, in `plane`.

    The rate of a start parameter is relative to a frame at rest, so that the motion of the gripper is subtracted.
    """
    speed = float(gripper_path(run).v[0]) / length
    return [
        {"initial_angle": float(angle), "initial_rate": float(rate - speed * np.cos(angle))} for angle, rate in plane
    ]


def possible_start_states(pace: float) -> np.ndarray:
    """(C, 2) start angles, rad, and rates, rad/s, to try: at rest first, then swings of growing energy.

    Args:
        pace: angular frequency of small swings, rad/s.
    """
    starts = [(0.0, 0.0)]
    for amplitude in TRIED_SWING_AMPLITUDES_RADIANS:
        for phase in 2 * np.pi * np.arange(TRIED_PHASES_PER_AMPLITUDE) / TRIED_PHASES_PER_AMPLITUDE:
            # Even steps along the orbit of a pendulum in sin(phi/2) = k sin(psi).
            k = np.sin(amplitude / 2)
            starts.append((2 * np.arcsin(k * np.cos(phase)), -2 * pace * k * np.sin(phase)))
    for whirl in TRIED_FULL_ROTATION_RATE_RATIOS:
        for angle in 2 * np.pi * (np.arange(TRIED_PHASES_PER_AMPLITUDE // 2) / (TRIED_PHASES_PER_AMPLITUDE // 2) - 0.5):
            rate = 2 * pace * np.sqrt(whirl**2 - np.sin(angle / 2) ** 2)
            starts += [(angle, rate), (angle, -rate)]
    return np.array(starts)


def possible_rate_errors(pace: float) -> np.ndarray:
    """(7,) errors, rad/s, that a rate from a noisy angle may have, 0 first; `pace` is 2 pi over the period, rad/s."""
    return pace * np.array([0.0, -0.03, 0.03, -0.1, 0.1, -0.3, 0.3])


def swing_channel(run: Run) -> str | None:
    """Name of the channel that measures the swing: angle, else rate; None if neither was measured."""
    return next((name for name in ("swing_angle", "swing_rate") if name in run.channels), None)


def free_swing_part(run: Run, swing: float) -> Run:
    """The part of a run in which a load below a fixed pivot swings freely; the run's warnings state what is left out.

    People start recording while they hold the load, or let it hang and push it, and stop after they have caught it. A
    free swing never stays in one place for half a period, except near the upright, which an inverted pendulum leaves as
    cosh(2 pi t / T), and where dry friction stops it: friction takes as much from every half swing, and stops a swing
    smaller than half of that.

    Args:
        run: run below a fixed pivot; it is returned unchanged where neither angle nor rate was measured.
        swing: period T, s.
    """
    name = swing_channel(run)
    if name is None:
        return run
    time, value = run.channels[name].time, run.channels[name].value
    near = max(
        HELD_LOAD_RANGE_NOISE_STDS * noise_std_from_differences(time, value),
        HELD_LOAD_SHARE_OF_SWING_RANGE * float(np.ptp(value)),
    )
    left, caught = _moves_at(value, near), len(value) - 1 - _moves_at(value[::-1], near)
    away = np.zeros(2)  # range of the rest position at the beginning and at the end
    if name == "swing_angle":  # a rate does not show that
        ends, swung = (
            (value[: MIN_SAMPLES_AFTER_RELEASE + 1], value[-MIN_SAMPLES_AFTER_RELEASE - 1 :]),
            value[left : max(left, caught) + 1],
        )
        away = np.abs([np.median(one) - np.median(swung) for one in ends])
    longest = swing * np.maximum(0.5, np.arccosh(1.0 + near / np.maximum(np.pi - away, 1e-6)) / np.pi)
    begin, end, said = -np.inf, np.inf, list[str]()
    if time[left] - time[0] > longest[0]:
        # A person who pushes a hanging load, or holds it elsewhere, has let go after half a swing.
        begin = time[left] + (0.0 if away[0] > 2.0 * near else 0.5 * swing)
        said.append(f"the load is held, or hangs, until {time[left]:.4g} s; what comes after {begin:.4g} s is compared")
    if time[-1] - time[caught] > longest[1]:
        stop = time[caught] - 0.5 * swing
        before, last = (_range(time, value, end - swing, end) for end in (stop - swing, stop))
        # An apparent rest may be a small swing, which has passed through twice that range.
        if stop > time[0] + 2.0 * swing and last > max(
            4.0 * near, MIN_CAUGHT_RANGE_TO_DECREASE_RATIO * (before - last)
        ):
            end = stop
            said.append(f"the load is caught at {time[caught]:.4g} s; what comes before {end:.4g} s is compared")
    if not said or min(time[-1], end) - max(time[0], begin) < swing:
        return run
    return runs_of_parts(run, [channels_between(run, begin, end)], f"{name}: {', and '.join(said)}")[0]


def _range(time: np.ndarray, value: np.ndarray, begin: float, end: float) -> float:
    """Range of the values from `begin` to `end`, s; 0 where there are none."""
    inside = value[(time > begin) & (time <= end)]
    return float(np.ptp(inside)) if len(inside) else 0.0


def _moves_at(value: np.ndarray, near: float) -> int:
    """Index of the first sample that leaves the range `near` of the first ones and stays out; glitches do not."""
    away = np.abs(value - np.median(value[: MIN_SAMPLES_AFTER_RELEASE + 1])) > near
    left = np.convolve(away, np.ones(MIN_SAMPLES_AFTER_RELEASE), "valid") == MIN_SAMPLES_AFTER_RELEASE
    return int(np.argmax(left)) if left.any() else 0


def cut_at_gripper_gaps(run: Run) -> tuple[Run, ...]:
    """Cut a run where the gripper moved while its position was not recorded; the first part's warnings say so."""
    gripper = run.channels["gripper_x"]
    before = np.flatnonzero(np.diff(gripper.time) > MAX_INTERPOLATED_GAP_SECONDS)
    before = before[[_moved(gripper, int(i)) for i in before]] if len(before) else before
    if not len(before):
        return (run,)
    starts = [-np.inf, *gripper.time[before + 1]]
    ends = [*gripper.time[before], np.inf]
    parts = [channels_between(run, start, end) for start, end in zip(starts, ends, strict=True)]
    whole = [
        channels
        for channels in parts
        if min(len(channel) for channel in channels.values()) >= MIN_COMPARED_CHANNEL_SAMPLES
    ]
    gaps = time_spans_in_words((gripper.time[i], gripper.time[i + 1]) for i in before)
    said = f"gripper_x: it moved while no position was recorded, {gaps}; what follows is a run of its own"
    return runs_of_parts(run, whole, said)


def _moved(gripper: Channel, before: int) -> bool:
    """Whether the gripper moved during the gap that follows sample `before`."""
    near = (gripper.time > gripper.time[before] - MAX_INTERPOLATED_GAP_SECONDS) & (
        gripper.time < gripper.time[before + 1] + MAX_INTERPOLATED_GAP_SECONDS
    )
    return bool(np.ptp(gripper.value[near]) > MAX_STILL_DISPLACEMENT_METRES)
