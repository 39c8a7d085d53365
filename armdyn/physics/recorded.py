"""The recorded inputs of a simulation: resampled to an even grid, with their rates and accelerations."""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.interpolate import BPoly

from armdyn.errors import InputError
from armdyn.parameter import RecordedColumn
from armdyn.run import Channel, Run
from armdyn.smoothing.even import grid_size, motion_at_midpoints, smoothed_motion

MAX_JUMP_SIZE_RATIO = 1.5
"""Largest ratio of the largest to the smallest jump of a signal that may be a slowly moving sensor with a coarse
resolution; a signal with unequal jumps is piecewise constant."""
MIN_GRID_STEP_SECONDS, MAX_GRID_STEP_SECONDS = 0.005, 0.01
"""Shortest and longest step of the grid, s; at 0.01 s a Runge-Kutta step of a 0.15 m pendulum is exact to 1e-7."""


@dataclass(frozen=True, eq=False)
class InputPath:
    """Inputs of a simulation on an even grid of K nodes.

    Attributes:
        start: time of the first node, s.
        dt: grid step, s.
        nodes: (i, K) inputs at the nodes.
        midpoints: (i, K-1) inputs halfway between the nodes.
        lag_derivatives: derivatives of `nodes` and of `midpoints` by the lag of the inputs behind the recording; None
            for inputs without a lag.
        extra: further recorded quantities by name, see `Run.extra`.
        inputs_at_interval_ends: (i, K-1) inputs at the end of each interval, before a jump at the node; None if no
            input jumps.
        steps_per_interval: number of integration steps between two nodes; 1 for inputs with a lag.
    """

    start: float
    dt: float
    nodes: np.ndarray
    midpoints: np.ndarray
    lag_derivatives: tuple[np.ndarray, np.ndarray] | None = None
    extra: Mapping[str, Channel] = field(default_factory=dict)
    inputs_at_interval_ends: np.ndarray | None = None
    steps_per_interval: int = 1

    @property
    def time(self) -> np.ndarray:
        """(K,) times of the nodes, s."""
        return np.asarray(self.start + self.dt * np.arange(self.nodes.shape[1]))

    def step_inputs(self, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The first `count` inputs (i, K) at the nodes, (i, K-1) halfway and (i, K-1) at the ends of the intervals.

        The derivatives by the lag, if any, are appended as further rows. At a node at which an input jumps, the first
        array contains the value after the jump.
        """
        nodes, middle = self.nodes[:count], self.midpoints[:count]
        if self.lag_derivatives is not None:
            at_nodes, between = self.lag_derivatives
            nodes, middle = np.vstack([nodes, at_nodes[:count]]), np.vstack([middle, between[:count]])
        return (
            nodes,
            middle,
            nodes[:, 1:] if self.inputs_at_interval_ends is None else self.inputs_at_interval_ends[:count],
        )

    def padded_steps(self, count: int, block: int) -> tuple[np.ndarray, np.ndarray]:
        """Inputs of all integration steps as (3 r, N), and (1, N) lengths of the steps, s; N is a multiple of `block`.

        The rows are the r rows of each array that `step_inputs` returns for `count` inputs. Steps after the last node
        fill up the last block: they have zero length and the inputs of the last node.
        """
        nodes, middle, ends = self.step_inputs(count)
        size = -(-nodes.shape[1] // block) * block
        steps = np.where(np.arange(size) < nodes.shape[1] - 1, self.dt, 0.0)[None]
        last = nodes[:, -1:]
        filled = [np.hstack([part, np.tile(last, size - part.shape[1])]) for part in (nodes, middle, ends)]
        return np.vstack(filled), steps

    def segment(self, first: int, last: int | None = None) -> "InputPath":
        """The part of the path from node `first` to node `last`, by default to its end."""
        nodes, middle = slice(first, None if last is None else last + 1), slice(first, last)
        cut = (
            None
            if self.lag_derivatives is None
            else (self.lag_derivatives[0][:, nodes], self.lag_derivatives[1][:, middle])
        )
        ends = None if self.inputs_at_interval_ends is None else self.inputs_at_interval_ends[:, middle]
        start, inputs = self.start + self.dt * first, (self.nodes[:, nodes], self.midpoints[:, middle])
        return InputPath(start, self.dt, *inputs, cut, self.extra, ends, self.steps_per_interval)

    @property
    def refined(self) -> "InputPath":
        """The path with a node at each integration step, interpolated by the parabola through each interval."""
        if self.steps_per_interval == 1:
            return self
        assert self.lag_derivatives is None
        begin, end = (
            self.nodes[:, :-1],
            self.nodes[:, 1:] if self.inputs_at_interval_ends is None else self.inputs_at_interval_ends,
        )

        def at(shift: float) -> np.ndarray:
            shares = ((k + shift) / self.steps_per_interval for k in range(self.steps_per_interval))
            cut = [begin + s * (end - begin) + 2 * s * (1 - s) * (2 * self.midpoints - begin - end) for s in shares]
            return np.stack(cut, axis=2).reshape(len(begin), -1)

        nodes = np.hstack([at(0.0), self.nodes[:, -1:]])
        return InputPath(self.start, self.dt / self.steps_per_interval, nodes, at(0.5), None, self.extra, at(1.0))

    def with_columns(self, columns: Sequence[RecordedColumn]) -> "InputPath":
        """The path with further recorded quantities as its last inputs, without a lag."""
        if not columns:
            return self
        between = self.time[:-1] + self.dt / 2
        nodes, middle = (np.vstack([c.interpolate(self.extra, time) for c in columns]) for time in (self.time, between))
        by_lag = None
        if self.lag_derivatives is not None:
            own, others = self.lag_derivatives, (np.zeros_like(nodes), np.zeros_like(middle))
            by_lag = np.vstack([own[0], others[0]]), np.vstack([own[1], others[1]])
        inputs = np.vstack([self.nodes, nodes]), np.vstack([self.midpoints, middle])
        ends = None if self.inputs_at_interval_ends is None else np.vstack([self.inputs_at_interval_ends, nodes[:, 1:]])
        return InputPath(self.start, self.dt, *inputs, by_lag, self.extra, ends)


def recorded_inputs(
    run: Run, inputs: Iterable[str], held: Collection[str], outputs: Iterable[str], step: float
) -> InputPath:
    """Inputs of a run on an even grid: the time, then value, rate and acceleration of each input channel.

    The grid starts with the outputs and ends where an input ends; without inputs it covers the outputs.

    Args:
        run: the run with the channels.
        inputs: names of the channels that drive the motion.
        held: inputs that keep their value until the next sample; so do piecewise constant inputs.
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
    dt = min(step, max(interval, MIN_GRID_STEP_SECONDS / MAX_GRID_STEP_SECONDS * step))
    steady = [name for name, channel in driving.items() if name in held or is_piecewise_constant(channel)]
    for every in (float(np.median(np.diff(driving[name].time))) for name in steady):
        dt = every / np.ceil(every / dt - 1e-6) if every > dt else dt  # the motion has a kink where a command steps
    if not end > start + 4 * dt:
        raise InputError(f"{run.name}: {', '.join(driving)} were not recorded at the same time: record them together")
    grid = start + dt * np.arange(grid_size(start, end, dt))
    since = grid - grid[0] + time_since_recording_began(run, grid[0])
    nodes, middle, ends = [since[None]], [(since[None, 1:] + since[None, :-1]) / 2], [since[None, 1:]]
    for name, channel in driving.items():
        if name in steady:
            level = np.zeros((3, len(grid) - 1))
            level[0] = channel.mean_zero_order_hold_values(grid)
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
        middle.append(motion_at_midpoints(motion, dt))
        ends.append(motion[:, 1:])
    return InputPath(
        start, dt, np.vstack(nodes), np.vstack(middle), extra=run.extra, inputs_at_interval_ends=np.vstack(ends)
    )


def smoothed_input(run: Run, name: str, time: np.ndarray, value: np.ndarray, dt: float) -> np.ndarray:
    """Smooth (n,) samples of the channel `name` of a run: (3, K) value, rate and acceleration at intervals `dt`, s."""
    exact, spread = run.noise.get(name) == 0.0, run.spread.get(name, 0.0)
    return smoothed_motion(time, value, dt, exact=exact, spread=spread)


def time_since_recording_began(run: Run, start: float) -> float:
    """Time, s, from the beginning of the recording to `start`, for a run that is a part of a recording; else 0."""
    return 0.0 if run.began is None else start - run.began


def is_piecewise_constant(channel: Channel) -> bool:
    """Whether a signal is constant except for single jumps of unequal sizes, as a command is.

    The jumps of a slowly changing measured signal all have the size of the sensor's resolution.
    """
    jumps = np.diff(channel.value)
    there = jumps != 0.0
    sizes = np.abs(jumps[there])
    return bool(
        len(sizes) > 1 and not np.any(there[1:] & there[:-1]) and sizes.max() > MAX_JUMP_SIZE_RATIO * sizes.min()
    )
