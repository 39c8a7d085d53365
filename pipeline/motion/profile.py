"""Motions along the line that consist of phases of constant jerk."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Sequence
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from pipeline.motion.limits import LIMIT_ROUNDING_TOLERANCE, LineLimits
from pipeline.motion.trajectory import LineState
from urdf.robot import Array

MAX_SAMPLE_SPACING_SECONDS = 2.5e-3
"""Largest time between the samples at which a motion is compared with limits that depend on the position [s]."""
MAX_SPEED_EXCESS_BETWEEN_SAMPLES = 5e-4
"""Largest excess of the speed limit between two samples, as a share of the limit."""
MAX_PROFILE_SAMPLES = 4000
"""Largest number of samples at which a motion is compared with its limits; in a motion of more than 10 s, which is
slow, they are less than 1 mm apart."""


class JerkProfile:
    """A motion along the line in phases of constant jerk; after the last phase the acceleration stays constant.

    Args:
        state: state at the begin.
        durations: duration of each phase [s]; phases of duration 0 are dropped.
        jerks: jerk in each phase [m/s^3].

    Attributes:
        start: time at which each phase begins, and the duration of the motion at the end [s].
        states: state at the begin of each phase, and at the end.
        jerks: jerk in each phase, and 0 at the end [m/s^3].
    """

    def __init__(self, state: LineState, durations: Sequence[float], jerks: Sequence[float]) -> None:
        start, states, kept = [0.0], [state], []
        t, (s, v, a) = 0.0, state
        for h, j in zip(durations, jerks, strict=True):
            if h > 0.0:
                t, s, v, a = t + h, *_advanced(s, v, a, j, h)
                start.append(t)
                states.append(LineState(s, v, a))
                kept.append(j)
        self.start, self.states, self.jerks = tuple(start), tuple(states), (*kept, 0.0)

    @property
    def duration(self) -> float:
        """Duration of all phases together [s]."""
        return self.start[-1]

    @property
    def end(self) -> LineState:
        """State at the end of the last phase."""
        return self.states[-1]

    def state_at(self, time: float) -> LineState:
        """State at a time since the begin of the motion [s]."""
        k = max(bisect_right(self.start, time) - 1, 0)
        return LineState(*_advanced(*self.states[k], self.jerks[k], time - self.start[k]))

    def sample(self, time: ArrayLike) -> tuple[Array, Array, Array]:
        """Positions [m], speeds [m/s] and accelerations [m/s^2] at times since the begin of the motion: (n,) each."""
        time = np.asarray(time, dtype=float)
        start, states, jerks = self._arrays
        phase = np.maximum(np.searchsorted(start, time, side="right") - 1, 0)
        h, j = time - start[phase], jerks[phase]
        s, v, a = states[phase].T
        return s + h * (v + h * (a / 2.0 + h * j / 6.0)), v + h * (a + h * j / 2.0), a + h * j

    def section(self, begin: float = 0.0, end: float = math.inf) -> JerkProfile:
        """The part of the motion between two times [s], as a motion that begins at time 0."""
        left = [max(min(b, end) - max(a, begin), 0.0) for a, b in pairwise(self.start)]
        return JerkProfile(self.state_at(min(begin, self.duration)), left, self.jerks[:-1])

    def extremes(self) -> list[LineState]:
        """States among which are the extremes of position, speed and acceleration: at phase ends, v = 0 and a = 0."""
        states = list(self.states)
        for (s, v, a), j, (begin, end) in zip(self.states, self.jerks, pairwise(self.start), strict=False):
            for h in (-a / j if j else -1.0, *_zeros(j / 2.0, a, v)):
                if 0.0 < h < end - begin:
                    states.append(LineState(*_advanced(s, v, a, j, h)))
        return states

    def respects(self, limits: LineLimits) -> bool:
        """Whether the motion stays on the line and within its limits of speed and acceleration, except for rounding.

        The motion is checked at its extremes, at the nodes of the limits, and at evenly spaced times. Between these
        instants a speed limit may be exceeded by the share `MAX_SPEED_EXCESS_BETWEEN_SAMPLES`.
        """
        extremes = self.extremes()
        # Most motions that break a limit break it at an extreme; most others stay far from every limit.
        if not all(limits.allows(state) for state in extremes):
            return False
        s, v, a = zip(*extremes, strict=True)
        lower, upper = min(s), max(s)
        slow = max(map(abs, v)) <= limits.min_speed_between(lower, upper)
        if slow and max(map(abs, a)) <= limits.min_acceleration_between(lower, upper):
            return True
        # A function with a second derivative of at most 2 J rises by at most 2 J h^2 / 8 between samples.
        spacing = min(
            MAX_SAMPLE_SPACING_SECONDS,
            math.sqrt(4.0 * MAX_SPEED_EXCESS_BETWEEN_SAMPLES * limits.min_speed_limit / limits.jerk),
        )
        count = int(min(np.ceil(self.duration / spacing), MAX_PROFILE_SAMPLES)) + 1
        even = np.linspace(0.0, self.duration, count)
        return limits.respected_by(
            *self.sample(np.concatenate([even, self._passes(even, limits.s)])), LIMIT_ROUNDING_TOLERANCE
        )

    def _passes(self, time: Array, nodes: Array) -> Array:
        """Times at which the motion passes the nodes of the limits, by linear interpolation between samples."""
        s = self.sample(time)[0]
        turns = np.flatnonzero(np.diff(np.sign(np.diff(s)))) + 1
        found = []
        for first, last in pairwise([0, *turns.tolist(), s.size - 1]):
            stretch, when = s[first : last + 1], time[first : last + 1]
            if stretch[-1] < stretch[0]:
                stretch, when = stretch[::-1], when[::-1]
            inside = nodes[np.searchsorted(nodes, stretch[0], "right") : np.searchsorted(nodes, stretch[-1], "left")]
            found.append(np.interp(inside, stretch, when))
        return np.concatenate(found)

    @cached_property
    def _arrays(self) -> tuple[Array, Array, Array]:
        return np.array(self.start), np.array(self.states), np.array(self.jerks)


def _advanced(s: float, v: float, a: float, j: float, h: float) -> tuple[float, float, float]:
    """The state after a time `h` of constant jerk `j`."""
    return s + h * (v + h * (a / 2.0 + h * j / 6.0)), v + h * (a + h * j / 2.0), a + h * j


def _zeros(square: float, linear: float, constant: float) -> tuple[float, ...]:
    """Real zeros of a quadratic polynomial, without cancellation."""
    discriminant = linear * linear - 4.0 * square * constant
    if discriminant < 0.0:
        return ()
    half = -(linear + math.copysign(math.sqrt(discriminant), linear)) / 2.0
    return tuple(n / d for n, d in ((half, square), (constant, half)) if d != 0.0)
