"""The gripper's path in a run, recorded or still being recorded."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from typing import Any

import numpy as np

from armdyn.pendulum.dynamics import OUTPUTS
from armdyn.pendulum.path import GripperPath, fixed_path, smoothed_path
from armdyn.physics.motion import grid_size
from armdyn.physics.recorded import COARSEST_GRID, FINEST_GRID
from armdyn.run import Run


@dataclass(frozen=True, eq=False)
class GrowingRun(Run):
    """A run that is still being recorded, with the gripper's path smoothed as it grew.

    Attributes:
        path: on a grid that starts at the first sample.
    """

    path: GripperPath = field(kw_only=True)

    def __reduce__(self) -> tuple[Callable[..., Run], tuple[Any, ...]]:
        _make, arguments = super().__reduce__()
        return partial(GrowingRun, began=self.began, path=self.path), arguments


def run_path(run: Run) -> GripperPath:
    """The gripper's path in a run: smoothed where only positions were measured, at rest where there is no gripper."""
    return run.path if isinstance(run, GrowingRun) else _recorded_path(run)


@lru_cache(maxsize=64)
def _recorded_path(run: Run) -> GripperPath:
    path = _path_of(run)
    return path if run.began is None else replace(path, elapsed=path.start - run.began)


def _path_of(run: Run) -> GripperPath:
    ends = [(c.time[0], c.time[-1]) for name, c in run.channels.items() if name in OUTPUTS or name == "gripper_x"]
    start, end = min(e[0] for e in ends), max(e[1] for e in ends)
    if "gripper_x" not in run.channels:
        interval = min(float(np.median(np.diff(run.channels[n].time))) for n in OUTPUTS if n in run.channels)
        return fixed_path(start, end, float(np.clip(interval, FINEST_GRID, COARSEST_GRID)))
    x = run.channels["gripper_x"]
    dt = float(np.clip(np.median(np.diff(x.time)), FINEST_GRID, COARSEST_GRID))
    grid = x.time[0] + dt * np.arange(grid_size(x.time[0], x.time[-1], dt))
    height = None
    if "gripper_z" in run.channels:
        z = run.channels["gripper_z"]
        level = np.interp(grid, z.time, z.value)
        smooth = smoothed_path(grid, level - level[0], dt, exact=run.noise.get("gripper_z") == 0.0)
        height = np.vstack([smooth.x, smooth.v, smooth.a])
    given = [run.channels[n] for n in ("gripper_v", "gripper_a") if n in run.channels]
    if len(given) == 2:
        position, speed, acceleration = (np.interp(grid, c.time, c.value) for c in (x, *given))
        return GripperPath(float(grid[0]), dt, position, speed, acceleration, height)
    along = smoothed_path(x.time, x.value, dt, exact=run.noise.get("gripper_x") == 0.0)
    return GripperPath(along.start, dt, along.x, along.v, along.a, height)
