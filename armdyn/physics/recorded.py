"""The recorded inputs of a simulation on an even grid, with rates and accelerations."""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.interpolate import BPoly

from armdyn.errors import InputError
from armdyn.parameter import RecordedColumn
from armdyn.run import Channel, Run
from armdyn.smoothing.even import grid_size, halfway, smoothed_motion

MAX_STEP_RATIO = 1.5
"""Largest ratio of a coarse sensor's steps: where they are not all its resolution, one is twice that."""
MIN_GRID_STEP, MAX_GRID_STEP = 0.005, 0.01
"""Grid steps, s; at 0.01 s a Runge-Kutta step of a 0.15 m pendulum is exact to 1e-7."""


@dataclass(frozen=True, eq=False)
class InputPath:
    """Inputs of a simulation on an even grid of K nodes.

    Attributes:
        start: time of the first node, s.
        dt: grid step, s.
        nodes: (i, K) inputs at the nodes.
        middle: (i, K-1) inputs halfway between.
        by_lag: derivatives of both by a lag of the inputs behind the recording; None where they have no lag.
        extra: further recorded quantities by name, see `Run.extra`.
        ends: (i, K-1) inputs at the end of each step, where they may jump at the nodes; None where no input jumps.
        parts: number of integration steps between two nodes; one where the inputs have a lag.
    """

    start: float
    dt: float
    nodes: np.ndarray
    middle: np.ndarray
    by_lag: tuple[np.ndarray, np.ndarray] | None = None
    extra: Mapping[str, Channel] = field(default_factory=dict)
    ends: np.ndarray | None = None
    parts: int = 1

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

    def packed(self, count: int, block: int) -> tuple[np.ndarray, np.ndarray]:
        """(3 r, N) the rows of `rows` for every step, and (1, N) lengths of the steps, s, for a multiple N of `block`.

        Steps from the last node on have no length, and the inputs there.
        """
        nodes, middle, ends = self.rows(count)
        size = -(-nodes.shape[1] // block) * block
        steps = np.where(np.arange(size) < nodes.shape[1] - 1, self.dt, 0.0)[None]
        last = nodes[:, -1:]
        filled = [np.hstack([part, np.tile(last, size - part.shape[1])]) for part in (nodes, middle, ends)]
        return np.vstack(filled), steps

    def part(self, first: int, last: int | None = None) -> "InputPath":
        """The part of the path from one node to another, by default to its end."""
        nodes, middle = slice(first, None if last is None else last + 1), slice(first, last)
        cut = None if self.by_lag is None else (self.by_lag[0][:, nodes], self.by_lag[1][:, middle])
        ends = None if self.ends is None else self.ends[:, middle]
        start, inputs = self.start + self.dt * first, (self.nodes[:, nodes], self.middle[:, middle])
        return InputPath(start, self.dt, *inputs, cut, self.extra, ends, self.parts)

    @property
    def fine(self) -> "InputPath":
        """The path with a node at each integration step, along the parabola through beginning, middle and end."""
        if self.parts == 1:
            return self
        assert self.by_lag is None
        begin, end = self.nodes[:, :-1], self.nodes[:, 1:] if self.ends is None else self.ends

        def at(shift: float) -> np.ndarray:
            shares = ((k + shift) / self.parts for k in range(self.parts))
            cut = [begin + s * (end - begin) + 2 * s * (1 - s) * (2 * self.middle - begin - end) for s in shares]
            return np.stack(cut, axis=2).reshape(len(begin), -1)

        nodes = np.hstack([at(0.0), self.nodes[:, -1:]])
        return InputPath(self.start, self.dt / self.parts, nodes, at(0.5), None, self.extra, at(1.0))

    def with_columns(self, columns: Sequence[RecordedColumn]) -> "InputPath":
        """The path with further quantities as its last inputs, which have no lag."""
        if not columns:
            return self
        between = self.time[:-1] + self.dt / 2
        nodes, middle = (np.vstack([c.interpolate(self.extra, time) for c in columns]) for time in (self.time, between))
        by_lag = None
        if self.by_lag is not None:
            own, others = self.by_lag, (np.zeros_like(nodes), np.zeros_like(middle))
            by_lag = np.vstack([own[0], others[0]]), np.vstack([own[1], others[1]])
        inputs = np.vstack([self.nodes, nodes]), np.vstack([self.middle, middle])
        ends = None if self.ends is None else np.vstack([self.ends, nodes[:, 1:]])
        return InputPath(self.start, self.dt, *inputs, by_lag, self.extra, ends)


def recorded_inputs(
    run: Run, inputs: Iterable[str], held: Collection[str], outputs: Iterable[str], step: float
) -> InputPath:
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
    since = grid - grid[0] + elapsed(run, grid[0])
    nodes, middle, ends = [since[None]], [(since[None, 1:] + since[None, :-1]) / 2], [since[None, 1:]]
    for name, channel in driving.items():
        if name in steady:
            level = np.zeros((3, len(grid) - 1))
            level[0] = channel.mean_held(grid)
            nodes.append(np.column_stack([level, level[:, -1]]))
            middle.append(level)
            ends.append(level)
            continue
        motion = smoothed_input(run, name, channel.time, channel.value, dt)
        if channel.time[0] != start or motion.shape[1] != len(grid):
            own = channel.time[0] + dt * np.arange(motion.shape[1])
            curve = BPoly.from_derivatives(own, motion.T)
            motion = np.vstack([curve(np.minimum(grid, own[-1]), nu=k) for k in range(3)])
        nodes.append(motion)
        middle.append(halfway(motion, dt))
        ends.append(motion[:, 1:])
    return InputPath(start, dt, np.vstack(nodes), np.vstack(middle), extra=run.extra, ends=np.vstack(ends))


def smoothed_input(run: Run, name: str, time: np.ndarray, value: np.ndarray, dt: float) -> np.ndarray:
    """(3, K) value, rate and acceleration from (n,) samples with the noise and spread of the channel `name`."""
    exact, spread = run.noise.get(name) == 0.0, run.spread.get(name, 0.0)
    return smoothed_motion(time, value, dt, exact=exact, spread=spread)


def elapsed(run: Run, start: float) -> float:
    """Time from the beginning of a recording to `start`, s; 0 for a run that is no later piece of a recording."""
    return 0.0 if run.began is None else start - run.began


def moves_in_steps(channel: Channel) -> bool:
    """Whether a signal is constant except for single jumps of unequal sizes; no measured signal is.

    The steps of a coarse sensor that hardly moves all have the size of its resolution.
    """
    jumps = np.diff(channel.value)
    there = jumps != 0.0
    sizes = np.abs(jumps[there])
    return bool(len(sizes) > 1 and not np.any(there[1:] & there[:-1]) and sizes.max() > MAX_STEP_RATIO * sizes.min())
