"""Motion from noisy positions and other recorded inputs, on an even grid: smoothed, with rate and acceleration.

Positions are smoothed by cross-validation and differentiated without phase shift.
"""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.interpolate import BPoly, make_interp_spline
from scipy.linalg import solveh_banded

from armdyn.errors import InputError
from armdyn.parameter import RecordedColumn
from armdyn.run import Channel, Run
from armdyn.smoothing import MIN_SMOOTHED_SAMPLES, best_smoothing, difference_penalty, smoothed

WHITTAKER_ORDER = 4
"""Order of the penalised differences: piecewise-constant jerk costs nothing in the limit."""
MIN_STRENGTH = 1.0 / (2.0 * np.sin(0.1 * np.pi)) ** 8
"""Smoothing that halves a motion at a tenth of the sampling rate: no gripper is faster, but an encoder's steps are."""
STRENGTHS_TRIED = MIN_STRENGTH * np.logspace(0, 8, 17)
"""Smoothing strengths that are tried, in samples^8; neighbours are a factor of 3.2 apart."""


def smoothed_motion(
    time: np.ndarray, x: np.ndarray, dt: float, *, exact: bool = False, spread: float = 0.0
) -> np.ndarray:
    """(3, K) position, velocity and acceleration from noisy positions, on an even grid that starts at the first stamp.

    It is penalised least squares (Whittaker 1923; Eilers, Anal. Chem. 2003): the minimum of |y - x|^2 + lambda |D^4
    x|^2 with the strength that `best_strength` finds. Stamps that are not on the grid, such as slow or uneven ones, get
    the spline of `armdyn.smoothing`, which needs no grid.

    Args:
        time: (n,) increasing time stamps, s.
        x: (n,) positions.
        dt: grid step, s.
        exact: whether the positions have no noise.
        spread: variance of the stamps over which each position was averaged, s^2; see `Run.spread`.
    """
    if len(time) < WHITTAKER_ORDER + 2:
        raise InputError(f"a recorded motion has {len(time)} samples: {WHITTAKER_ORDER + 2} or more are needed")
    grid = time[0] + dt * np.arange(grid_size(time[0], time[-1], dt))
    if not (len(grid) == len(time) and np.allclose(grid, time, atol=1e-3 * dt, rtol=0)):
        motion = np.vstack(_off_grid(time, x, np.minimum(grid, time[-1]), exact=exact))
    else:
        smooth = x if exact else penalised(x, best_strength(x))
        motion = np.vstack([smooth, *differentiated(smooth, dt)])
    if spread > 0.0:  # the mean of a curved stretch lies inside the curve
        jerk = slope(motion[2], dt)
        motion = motion - spread / 2.0 * np.vstack([motion[2], jerk, slope(jerk, dt)])
    return motion


def _off_grid(
    time: np.ndarray, x: np.ndarray, grid: np.ndarray, *, exact: bool
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(3, K) position, velocity and acceleration at `grid`, (K,), from positions at any stamps."""
    if exact or len(time) < MIN_SMOOTHED_SAMPLES:
        spline = make_interp_spline(time, x, 5)
        return spline(grid), spline(grid, 1), spline(grid, 2)
    curve = smoothed(time, x, best_smoothing(time, x))
    return curve(grid)[:, 0], curve(grid, 1)[:, 0], curve(grid, 2)[:, 0]


def grid_size(start: float, end: float, dt: float) -> int:
    """Number of nodes of a uniform grid that covers [start, end]."""
    return max(2, int(np.ceil((end - start) / dt - 1e-9)) + 1)


def halfway(motion: np.ndarray, dt: float) -> np.ndarray:
    """(3, K-1) position, velocity and acceleration halfway between nodes (3, K), by quintic Hermite interpolation."""
    (x0, v0, a0), (x1, v1, a1) = motion[:, :-1], motion[:, 1:]
    return np.vstack(
        [
            (x0 + x1) / 2 + dt * (v0 - v1) * 5 / 32 + dt**2 * (a0 + a1) / 64,
            15 / 8 * (x1 - x0) / dt - 7 / 16 * (v0 + v1) + dt * (a1 - a0) / 32,
            3 / 2 * (v1 - v0) / dt - (a0 + a1) / 4,
        ]
    )


def best_strength(y: np.ndarray) -> float:
    """The smoothing strength with the least generalised cross-validation error (Craven & Wahba 1979).

    The error is n |r|^2 / (n - tr H)^2. It needs no noise level: requiring a residual of the size of a stated noise
    does not smooth at all where the statement is 30 % too low. The trace of the smoother H is that of the periodic one,
    with eigenvalues 1/(1 + lambda (2 sin(w/2))^8).
    """
    n = len(y)
    eigenvalues = (2.0 * np.sin(np.pi * np.arange(n) / (2.0 * n))) ** (2 * WHITTAKER_ORDER)

    def validation_error(strength: float) -> float:
        residual = y - penalised(y, strength)
        return float(residual @ residual) / (1.0 - float(np.mean(1.0 / (1.0 + strength * eigenvalues)))) ** 2

    best = 4 * int(np.argmin([validation_error(strength) for strength in STRENGTHS_TRIED[::4]]))
    near = STRENGTHS_TRIED[max(0, best - 3) : best + 4]
    return float(near[int(np.argmin([validation_error(strength) for strength in near]))])


def penalised(y: np.ndarray, strength: float) -> np.ndarray:
    """(n,) minimiser of |y - x|^2 + strength |D^4 x|^2."""
    bands = strength * difference_penalty(len(y), WHITTAKER_ORDER, WHITTAKER_ORDER + 1)
    bands[0] += 1.0
    return solveh_banded(bands, y, lower=True, check_finite=False)


def differentiated(x: np.ndarray, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """First and second derivatives of even samples, by fourth-order differences (third-order at the two ends)."""
    padded = np.concatenate([_extrapolated(x[:5])[::-1], x, _extrapolated(x[:-6:-1])])
    m2, m1, c, p1, p2 = (padded[i : len(padded) - 4 + i] for i in range(5))
    return (m2 - 8 * m1 + 8 * p1 - p2) / (12 * dt), (-m2 + 16 * m1 - 30 * c + 16 * p1 - p2) / (12 * dt**2)


def slope(x: np.ndarray, dt: float) -> np.ndarray:
    """First derivative of even samples, or of columns of them, as `differentiated`, but also for fewer than five."""
    return differentiated(x, dt)[0] if len(x) >= 5 else np.gradient(x, dt, axis=0)


def _extrapolated(near: np.ndarray) -> np.ndarray:
    """Two samples beyond the end, nearest first, on the quartic through the five samples `near` (nearest first)."""
    a, b, c, d, e = near
    first = 5 * a - 10 * b + 10 * c - 5 * d + e
    second = 5 * first - 10 * a + 10 * b - 5 * c + d
    return np.array([first, second])


MAX_STEP_RATIO = 1.5
"""Largest ratio of a coarse sensor's steps: where they are not all its resolution, one is twice that."""
MIN_GRID_STEP, MAX_GRID_STEP = 0.005, 0.01
"""Grid steps, s; at 0.01 s a Runge-Kutta step of a 0.15 m pendulum is exact to 1e-7."""


@dataclass(frozen=True, eq=False)
class Path:
    """Inputs of a simulation on an even grid of K nodes.

    Attributes:
        start: time of the first node, s.
        dt: grid step, s.
        nodes: (i, K) inputs at the nodes.
        middle: (i, K-1) inputs halfway between.
        by_lag: derivatives of both by a lag of the inputs behind the recording; None where they have no lag.
        extra: further recorded quantities by name, see `Run.extra`.
        ends: (i, K-1) inputs at the end of each step, where they may jump at the nodes; None where no input jumps.
    """

    start: float
    dt: float
    nodes: np.ndarray
    middle: np.ndarray
    by_lag: tuple[np.ndarray, np.ndarray] | None = None
    extra: Mapping[str, Channel] = field(default_factory=dict)
    ends: np.ndarray | None = None

    @property
    def time(self) -> np.ndarray:
        """(K,) times of the nodes, s."""
        return np.asarray(self.start + self.dt * np.arange(self.nodes.shape[1]))

    def rows(self, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The first `count` inputs at the nodes, halfway between, at the steps' ends; then their derivatives by lag.

        Where an input jumps at a node, the value after the jump is used.
        """
        nodes, middle = self.nodes[:count], self.middle[:count]
        if self.by_lag is not None:
            at_nodes, between = self.by_lag
            nodes, middle = np.vstack([nodes, at_nodes[:count]]), np.vstack([middle, between[:count]])
        return nodes, middle, nodes[:, 1:] if self.ends is None else self.ends[:count]

    def part(self, first: int, last: int | None = None) -> "Path":
        """The part of the path from one node to another, by default to its end."""
        nodes, middle = slice(first, None if last is None else last + 1), slice(first, last)
        cut = None if self.by_lag is None else (self.by_lag[0][:, nodes], self.by_lag[1][:, middle])
        ends = None if self.ends is None else self.ends[:, middle]
        return Path(self.start + self.dt * first, self.dt, self.nodes[:, nodes], self.middle[:, middle], cut, ends=ends)

    def with_columns(self, columns: Sequence[RecordedColumn]) -> "Path":
        """The path with further quantities as its last inputs, which have no lag."""
        if not columns:
            return self
        between = self.time[:-1] + self.dt / 2
        nodes, middle = (np.vstack([c.over(self.extra, time) for c in columns]) for time in (self.time, between))
        by_lag = None
        if self.by_lag is not None:
            own, others = self.by_lag, (np.zeros_like(nodes), np.zeros_like(middle))
            by_lag = np.vstack([own[0], others[0]]), np.vstack([own[1], others[1]])
        inputs = np.vstack([self.nodes, nodes]), np.vstack([self.middle, middle])
        ends = None if self.ends is None else np.vstack([self.ends, nodes[:, 1:]])
        return Path(self.start, self.dt, *inputs, by_lag, self.extra, ends)


def recorded_inputs(
    run: Run, inputs: Iterable[str], held: Collection[str], outputs: Iterable[str], step: float
) -> Path:
    """Time since the start of a run, then value, rate and acceleration of each input.

    The grid starts with the outputs and ends where an input ends; without inputs it covers the outputs.

    Args:
        run: the run with the channels.
        inputs: names of the channels that drive the motion.
        held: inputs that keep their value until the next sample; so does an input that `moves_in_steps`.
        outputs: names of the predicted channels, as far as the run has them.
        step: longest grid step, s.

    Raises:
        InputError: the inputs do not overlap.
    """
    driving = {name: run.channels[name] for name in inputs}
    measured = [run.channels[name] for name in outputs if name in run.channels]
    if driving:
        start = max(*(float(c.time[0]) for c in driving.values()), min(float(c.time[0]) for c in measured))
        end = min(float(c.time[-1]) for c in driving.values())
    else:
        start, end = min(float(c.time[0]) for c in measured), max(float(c.time[-1]) for c in measured)
    interval = min(float(np.median(np.diff(c.time))) for c in (*driving.values(), *measured))
    dt = min(step, max(interval, MIN_GRID_STEP / MAX_GRID_STEP * step))
    steady = [name for name, channel in driving.items() if name in held or moves_in_steps(channel)]
    for every in (float(np.median(np.diff(driving[name].time))) for name in steady):
        dt = every / np.ceil(every / dt - 1e-6) if every > dt else dt  # the motion has a kink where a command steps
    if not end > start + 4 * dt:
        raise InputError(f"{run.name}: {', '.join(driving)} were not recorded at the same time: record them together")
    grid = start + dt * np.arange(grid_size(start, end, dt))
    since = grid - grid[0] + (0.0 if run.began is None else grid[0] - run.began)
    nodes, middle, ends = [since[None]], [(since[None, 1:] + since[None, :-1]) / 2], [since[None, 1:]]
    for name, channel in driving.items():
        if name in steady:
            level = np.zeros((3, len(grid) - 1))
            level[0] = channel.mean_held(grid)
            nodes.append(np.column_stack([level, level[:, -1]]))
            middle.append(level)
            ends.append(level)
            continue
        motion = smoothed_motion(
            channel.time, channel.value, dt, exact=run.noise.get(name) == 0.0, spread=run.spread.get(name, 0.0)
        )
        if channel.time[0] != start or motion.shape[1] != len(grid):
            own = channel.time[0] + dt * np.arange(motion.shape[1])
            curve = BPoly.from_derivatives(own, motion.T)
            motion = np.vstack([curve(np.minimum(grid, own[-1]), nu=k) for k in range(3)])
        nodes.append(motion)
        middle.append(halfway(motion, dt))
        ends.append(motion[:, 1:])
    return Path(start, dt, np.vstack(nodes), np.vstack(middle), extra=run.extra, ends=np.vstack(ends))


def moves_in_steps(channel: Channel) -> bool:
    """Whether a signal is constant except for single jumps of unequal sizes; no measured signal is.

    The steps of a coarse sensor that hardly moves all have the size of its resolution.
    """
    jumps = np.diff(channel.value)
    there = jumps != 0.0
    sizes = np.abs(jumps[there])
    return bool(len(sizes) > 1 and not np.any(there[1:] & there[:-1]) and sizes.max() > MAX_STEP_RATIO * sizes.min())
