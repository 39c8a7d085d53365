"""Build a volume, the inverse kinematics of a 3-D grid, on disk, in one or several processes or on a dask cluster."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from armdyn.errors import InputError, TaskFailedError
from ik.volume.blocks import BlockSolver
from ik.volume.grid import TargetGrid
from ik.volume.skeleton import build_skeleton
from ik.volume.store import VolumeTable
from ik.workers import FailedWorkItem, map_in_processes, map_on_cluster
from urdf import Robot

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class VolumeBuildResult:
    """Result of `build_volume`.

    Attributes:
        table: the volume.
        solved: number of targets that this call solved.
        resumed: number of targets that earlier calls had solved.
        seconds: duration of this call [s].
    """

    table: VolumeTable
    solved: int
    resumed: int
    seconds: float


def build_volume(
    robot: Robot,
    grid: TargetGrid,
    path: str | Path,
    *,
    processes: int = 1,
    scheduler: str | None = None,
    collisions: bool = False,
    progress: Progress | None = None,
) -> VolumeBuildResult:
    """Solve the inverse kinematics of every target of a grid, and store the postures in a zarr directory.

    The postures vary smoothly from target to target, starting near the robot's home posture. The directory of an
    interrupted call is continued; a finished one is returned unchanged.

    Args:
        robot: the arm.
        grid: the targets.
        path: the zarr directory.
        processes: number of processes on this computer.
        scheduler: address of a dask scheduler whose workers compute instead, such as ``"tcp://host:8786"``.
        collisions: whether to check every posture for collisions; the coarse grid is always checked.
        progress: function that is called with the number of finished targets and the number of all targets.

    Raises:
        InputError: the directory cannot be written, or zarr, dask or the scheduler is missing.
        StaleTableError: the directory contains another volume.
        UnreachableError: no target can be reached.
        TaskFailedError: worker processes died repeatedly.
    """
    if processes < 1:
        raise InputError(f"volume: {processes} processes cannot work; give 1 or more")
    target, started = Path(path), time.perf_counter()
    if target.exists():
        table = VolumeTable.open(target, robot, collisions)
    else:
        table = VolumeTable.create(target, robot, grid, build_skeleton(robot, grid.coarse_grid()), collisions)
    if table.grid.describe() != grid.describe():
        raise InputError(f"{target}: holds a volume of other targets; choose another directory, or remove it")
    solver = BlockSolver(robot, grid, table.skeleton, collisions)
    blocks = table.unfinished_blocks()
    left = sum(grid.positions(block)[..., 0].size for block in blocks)
    resumed = done = grid.targets - left
    say = progress or (lambda _done, _targets: None)
    say(done, grid.targets)
    if scheduler is not None:
        answers = map_on_cluster(solver, blocks, scheduler, "volume")
    elif processes > 1:  # spawned, not forked: a forked copy of a process with threads can hang
        answers = map_in_processes(solver, blocks, processes, "spawn")
    else:
        answers = ((block, solver(block)) for block in blocks)
    for block, solved in answers:
        if isinstance(solved, FailedWorkItem):
            raise TaskFailedError(
                f"volume: block {block}: {solved.reason}; free some memory and run the same command again to continue"
            )
        table.write(block, solved)
        done += solved.status.size
        say(done, grid.targets)
    return VolumeBuildResult(table, left, resumed, time.perf_counter() - started)
