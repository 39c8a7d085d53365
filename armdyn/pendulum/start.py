r"""How a load may have swung when a recording, or a later piece of it, began.

A free swing of amplitude A passes the angle phi at the rate phi' = ± sqrt(2 g/l (cos phi - cos A)). Which orbit it was
and where on it the recording began is what a load cell does not say and a fit cannot guess: at angle and rate 0 every
derivative with respect to the start vanishes by symmetry.
"""

from collections.abc import Iterable

import numpy as np

from armdyn.channels import MIN_SAMPLES, Channel
from armdyn.gaps import between, in_pieces, told
from armdyn.pendulum.path import run_path
from armdyn.pendulum.physics import STANDARD_GRAVITY
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


def seen_from_rest(
    run: Run, length: float, plane: Iterable[tuple[float, float]] | np.ndarray
) -> list[dict[str, float]]:
    """Starts of angle (rad) and rate phi' (rad/s) as parameters, which are seen from rest in space."""
    speed = float(run_path(run).v[0]) / length
    return [
        {"initial_angle": float(angle), "initial_rate": float(rate - speed * np.cos(angle))} for angle, rate in plane
    ]


def phase_plane(length: float) -> np.ndarray:
    """(C, 2) angles (rad) and rates (rad/s) of a swing, hanging at rest first, then orbits of growing energy.

    Args:
        length: pivot to the load's centre, m.
    """
    pace = np.sqrt(STANDARD_GRAVITY / length)
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


def rates_near(length: float) -> np.ndarray:
    """(7,) rad/s by which a rate from a noisy angle may be off, 0 first; `length` m."""
    return np.sqrt(STANDARD_GRAVITY / length) * np.array([0.0, -0.03, 0.03, -0.1, 0.1, -0.3, 0.3])


def pieces(run: Run) -> tuple[Run, ...]:
    """The run, cut where the gripper moved while no position was recorded; see `Run.warnings` and `Run.began`."""
    gripper = run.channels.get("gripper_x")
    if gripper is None:
        return (run,)
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
