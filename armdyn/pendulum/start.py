r"""How a load may have swung when a recording, or a later piece of it, began.

A free swing of amplitude A passes the angle phi at the rate phi' = ± sqrt(2 g/l (cos phi - cos A)). Which orbit it was
and where on it the recording began is what a load cell does not say and a fit cannot guess: at angle and rate 0 every
derivative with respect to the start vanishes by symmetry.
"""

from collections.abc import Iterable

import numpy as np

from armdyn.pendulum.path import run_path
from armdyn.recording.channels import MIN_SAMPLES, Channel
from armdyn.recording.differences import quiet_std
from armdyn.recording.gaps import between, in_pieces, told
from armdyn.run import Run

AMPLITUDES = (0.06, 0.2, 0.45, 0.8, 1.2, 1.7, 2.3, 2.8, 3.05)
"""rad; neighbours are so far apart as a few Gauss-Newton steps over one period bridge."""
PHASES = 8
"""Places on each orbit."""
WHIRLS = (1.2,)
"""Rates at the lowest point, over that which just reaches the upright."""
BLIND = 0.25
"""s; longest gap in the gripper's positions over which a spline interpolates motions of up to 1.5 Hz to 2 %."""
STILL = 1e-3
"""m that the gripper is displaced around a gap in which it rested."""
HELD = 0.03
"""Of the range of a swing, within which a hand holds a load still."""
LOUD = 5.0
"""Standard deviations of the noise, within which a held load seems still."""
AWAY = 3
"""Samples in a row that have left where it was held: no glitch."""
CAUGHT = 3.5
"""Range of a swing when it stops, over what it loses in a period, from which on it was caught: 1.75 at most where dry
friction stops it."""


def seen_from_rest(
    run: Run, length: float, plane: Iterable[tuple[float, float]] | np.ndarray
) -> list[dict[str, float]]:
    """Starts of angle (rad) and rate phi' (rad/s) as parameters, which are seen from rest in space."""
    speed = float(run_path(run).v[0]) / length
    return [
        {"initial_angle": float(angle), "initial_rate": float(rate - speed * np.cos(angle))} for angle, rate in plane
    ]


def phase_plane(pace: float) -> np.ndarray:
    """(C, 2) angles (rad) and rates (rad/s) of a swing, hanging at rest first, then orbits of growing energy.

    Args:
        pace: of small swings, rad/s.
    """
    starts = [(0.0, 0.0)]
    for amplitude in AMPLITUDES:
        for phase in 2 * np.pi * np.arange(PHASES) / PHASES:
            # Even steps along the orbit of a pendulum in sin(phi/2) = k sin(psi).
            k = np.sin(amplitude / 2)
            starts.append((2 * np.arcsin(k * np.cos(phase)), -2 * pace * k * np.sin(phase)))
    for whirl in WHIRLS:
        for angle in 2 * np.pi * (np.arange(PHASES // 2) / (PHASES // 2) - 0.5):
            rate = 2 * pace * np.sqrt(whirl**2 - np.sin(angle / 2) ** 2)
            starts += [(angle, rate), (angle, -rate)]
    return np.array(starts)


def rates_near(pace: float) -> np.ndarray:
    """(7,) rad/s by which a rate from a noisy angle may be off, 0 first; `pace` of small swings, rad/s."""
    return pace * np.array([0.0, -0.03, 0.03, -0.1, 0.1, -0.3, 0.3])


def swing_shown(run: Run) -> str | None:
    """Name of the channel that shows the swing itself: the angle, else the rate; None where neither was measured."""
    return next((name for name in ("swing_angle", "swing_rate") if name in run.channels), None)


def free_swing(run: Run, swing: float) -> Run:
    """The part of a run in which a load below a fixed pivot swings freely; see `Run.warnings`.

    People record while they still hold the load, or let it hang and push it, and until they catch it. No free swing
    stays where it is for half a period, but near the upright, which an inverted pendulum leaves as cosh(2 pi t / T),
    and where dry friction stops it, which takes as much from every half swing and stops what is less than half of that.

    Args:
        run: below a fixed pivot; returned as it is where neither angle nor rate was measured.
        swing: period T, s.
    """
    name = swing_shown(run)
    if name is None:
        return run
    time, value = run.channels[name].time, run.channels[name].value
    near = max(LOUD * quiet_std(time, value), HELD * float(np.ptp(value)))
    left, caught = _moves_at(value, near), len(value) - 1 - _moves_at(value[::-1], near)
    away = np.zeros(2)  # from rest, at the beginning and at the end
    if name == "swing_angle":  # a rate does not show that
        ends, swung = (value[: AWAY + 1], value[-AWAY - 1 :]), value[left : max(left, caught) + 1]
        away = np.abs([np.median(one) - np.median(swung) for one in ends])
    longest = swing * np.maximum(0.5, np.arccosh(1.0 + near / np.maximum(np.pi - away, 1e-6)) / np.pi)
    begin, end, said = -np.inf, np.inf, list[str]()
    if time[left] - time[0] > longest[0]:
        # Who pushes what hangs, or holds it nobody knows where, has let go after half a swing.
        begin = time[left] + (0.0 if away[0] > 2.0 * near else 0.5 * swing)
        said.append(f"the load is held, or hangs, until {time[left]:.4g} s; what comes after {begin:.4g} s is compared")
    if time[-1] - time[caught] > longest[1]:
        stop = time[caught] - 0.5 * swing
        before, last = (_range(time, value, end - swing, end) for end in (stop - swing, stop))
        # What seems still may be a small swing, which came through twice that range.
        if stop > time[0] + 2.0 * swing and last > max(4.0 * near, CAUGHT * (before - last)):
            end = stop
            said.append(f"the load is caught at {time[caught]:.4g} s; what comes before {end:.4g} s is compared")
    if not said or min(time[-1], end) - max(time[0], begin) < swing:
        return run
    return in_pieces(run, [between(run, begin, end)], f"{name}: {', and '.join(said)}")[0]


def _range(time: np.ndarray, value: np.ndarray, begin: float, end: float) -> float:
    """Of the values from `begin` to `end`, s; 0 where there are none."""
    inside = value[(time > begin) & (time <= end)]
    return float(np.ptp(inside)) if len(inside) else 0.0


def _moves_at(value: np.ndarray, near: float) -> int:
    """Number of the first sample that is no longer `near` the first ones, nor any of the next, which glitches are."""
    away = np.abs(value - np.median(value[: AWAY + 1])) > near
    left = np.convolve(away, np.ones(AWAY), "valid") == AWAY
    return int(np.argmax(left)) if left.any() else 0


def pieces(run: Run) -> tuple[Run, ...]:
    """The run, cut where the gripper moved while no position was recorded; see `Run.warnings` and `Run.began`."""
    gripper = run.channels["gripper_x"]
    before = np.flatnonzero(np.diff(gripper.time) > BLIND)
    before = before[[_moved(gripper, int(i)) for i in before]] if len(before) else before
    if not len(before):
        return (run,)
    starts = [-np.inf, *gripper.time[before + 1]]
    ends = [*gripper.time[before], np.inf]
    parts = [between(run, start, end) for start, end in zip(starts, ends, strict=True)]
    whole = [channels for channels in parts if min(len(channel) for channel in channels.values()) >= MIN_SAMPLES]
    gaps = told((gripper.time[i], gripper.time[i + 1]) for i in before)
    said = f"gripper_x: it moved while no position was recorded, {gaps}; what follows is a run of its own"
    return in_pieces(run, whole, said)


def _moved(gripper: Channel, before: int) -> bool:
    """Whether the gripper moved around the gap that follows sample `before`."""
    near = (gripper.time > gripper.time[before] - BLIND) & (gripper.time < gripper.time[before + 1] + BLIND)
    return bool(np.ptp(gripper.value[near]) > STILL)
