"""Build a volume of postures on disk, by this process, a pool of processes or a dask cluster."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from armdyn.errors import InputError, TaskFailedError
from ik.volume.blocks import BlockSolver
from ik.volume.grid import Grid
from ik.volume.skeleton import build_skeleton
from ik.volume.store import VolumeTable
from ik.workers import Lost, in_processes, on_cluster
from urdf import Robot

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class VolumeReport:
    """A volume, the numbers of targets that this call solved and that were solved already, and its duration [s]."""

    table: VolumeTable
    solved: int
    resumed: int
    seconds: float


def build_volume(
    robot: Robot,
    grid: Grid,
    path: str | Path,
    *,
    processes: int = 1,
    scheduler: str | None = None,
    collisions: bool = False,
    progress: Progress | None = None,
) -> VolumeReport:
    """Solve every target of a grid on one consistent branch and keep the postures in a zarr directory.

    The robot's home posture picks the branch. A directory that an interrupted run left is continued; a finished one is
    returned as it is. So many processes of this machine work, or the workers of the dask scheduler at an address. With
    `collisions` each posture is checked for touching something; the skeleton always is. `progress` is called with the
    number of finished targets and of all.

    Raises:
        InputError: the directory cannot be written, or zarr, dask or the scheduler is missing.
        StaleTableError: the directory contains another volume.
        UnreachableError: no target can be held.
        TaskFailedError: workers died repeatedly.
    """
    if processes < 1:
        raise InputError(f"volume: {processes} processes cannot work; give 1 or more")
    target, started = Path(path), time.perf_counter()
    if target.exists():
        table = VolumeTable.open(target, robot, collisions)
    else:
        table = VolumeTable.create(target, robot, grid, build_skeleton(robot, grid.coarse()), collisions)
    if table.grid.describe() != grid.describe():
        raise InputError(f"{target}: holds a volume of other targets; choose another directory, or remove it")
    solver = BlockSolver(robot, grid, table.skeleton, collisions)
    blocks = table.missing()
    left = sum(grid.positions(block)[..., 0].size for block in blocks)
    resumed = done = grid.targets - left
    say = progress or (lambda _done, _targets: None)
    say(done, grid.targets)
    if scheduler is not None:
        answers = on_cluster(solver, blocks, scheduler, "volume")
    elif processes > 1:  # spawned, not forked: a forked copy of a process with threads can hang
        answers = in_processes(solver, blocks, processes, "spawn")
    else:
        answers = ((block, solver(block)) for block in blocks)
    for block, solved in answers:
        if isinstance(solved, Lost):
            raise TaskFailedError(
                f"volume: block {block}: {solved.reason}; free some memory and run the same command again to continue"
            )
        table.write(block, solved)
        done += solved.status.size
        say(done, grid.targets)
    return VolumeReport(table, left, resumed, time.perf_counter() - started)
