"""Recorded inputs on an even grid: smoothed, with rate and acceleration."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.interpolate import BPoly

from armdyn.errors import InputError
from armdyn.physics.motion import grid_size, halfway, smoothed_motion
from armdyn.run import Run

FINEST_GRID, COARSEST_GRID = 0.005, 0.01
"""s; at 0.01 s a Runge-Kutta step of a 0.15 m pendulum is exact to 1e-7."""


class Path(Protocol):
    """Recorded inputs on an even grid of K nodes."""

    @property
    def start(self) -> float:
        """Time of the first node, s."""

    @property
    def dt(self) -> float:
        """Grid step, s."""

    def rows(self, *, with_jerk: bool) -> tuple[np.ndarray, np.ndarray]:
        """Inputs of a simulation at the nodes (rows, K) and halfway between (rows, K-1)."""


@dataclass(frozen=True, eq=False)
class RecordedInputs:
    """Inputs of a simulation on an even grid; a `Path`.

    Attributes:
        start: time of the first node, s.
        dt: grid step, s.
        nodes: (1 + 3 i, K) time since the start, then value, rate and acceleration of each of i inputs.
        middle: (1 + 3 i, K-1) the same halfway between.
    """

    start: float
    dt: float
    nodes: np.ndarray
    middle: np.ndarray

    @property
    def time(self) -> np.ndarray:
        """(K,) s."""
        return np.asarray(self.start + self.dt * np.arange(self.nodes.shape[1]))

    def rows(self, *, with_jerk: bool) -> tuple[np.ndarray, np.ndarray]:
        """See `Path`; there is no jerk."""
        del with_jerk
        return self.nodes, self.middle


def recorded_inputs(run: Run, inputs: Iterable[str], outputs: Iterable[str], step: float) -> RecordedInputs:
    """The inputs of a run, from where the outputs begin to where an input ends; without inputs over the outputs.

    Args:
        run: with the channels.
        inputs: names of the channels that drive the motion.
        outputs: names of those that are predicted, as far as the run has them.
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
    dt = min(step, float(np.clip(interval, FINEST_GRID, COARSEST_GRID)))
    if not end > start + 4 * dt:
        raise InputError(f"{run.name}: {', '.join(driving)} were not recorded at the same time: record them together")
    grid = start + dt * np.arange(grid_size(start, end, dt))
    since = grid - grid[0] + (0.0 if run.began is None else grid[0] - run.began)
    nodes, middle = [since[None]], [(since[None, 1:] + since[None, :-1]) / 2]
    for name, channel in driving.items():
        motion = smoothed_motion(channel.time, channel.value, dt, exact=run.noise.get(name) == 0.0)
        if channel.time[0] != start or motion.shape[1] != len(grid):
            own = channel.time[0] + dt * np.arange(motion.shape[1])
            curve = BPoly.from_derivatives(own, motion.T)
            motion = np.vstack([curve(np.minimum(grid, own[-1]), nu=k) for k in range(3)])
        nodes.append(motion)
        middle.append(halfway(motion, dt))
    return RecordedInputs(start, dt, np.vstack(nodes), np.vstack(middle))
