"""From a robot and a grid to a volume on disk, continued where it was left."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from armdyn.errors import InputError
from ik.chain import Chain
from ik.volume.block import BlockSolver, Solved
from ik.volume.grid import Grid, Status
from ik.volume.run import in_processes, on_cluster
from ik.volume.skeleton import build_skeleton
from ik.volume.store import VolumeTable
from urdf import CollisionModel, Robot

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class VolumeReport:
    """What was done.

    Attributes:
        table: the volume.
        solved: targets solved this time.
        resumed: targets that were there already.
        seconds: this time took [s], the skeleton included.
        skeleton_seconds: of that, the skeleton [s].
    """

    table: VolumeTable
    solved: int
    resumed: int
    seconds: float
    skeleton_seconds: float


def build_volume(
    robot: Robot,
    grid: Grid,
    path: str | Path,
    *,
    processes: int = 1,
    scheduler: str | None = None,
    collisions: bool = False,
    progress: Progress | None = None,
    clock: Callable[[], float] = time.perf_counter,
) -> VolumeReport:
    """Solve every target of a grid on one consistent branch and keep the postures in a zarr directory.

    A directory that an interrupted run left is continued; a finished one is returned as it is.

    Args:
        robot: the arm; its home posture picks the branch.
        grid: the targets.
        path: the zarr directory.
        processes: how many processes of this machine work.
        scheduler: address of a dask scheduler whose workers do it instead.
        collisions: whether each posture is checked for touching something; the skeleton always is.
        progress: told how many targets of how many are done.
        clock: tells the time [s].

    Raises:
        InputError: the directory cannot be written, or zarr, dask or the scheduler is missing.
        StaleTableError: the directory holds another volume.
        UnreachableError: no target can be held.
        TaskFailedError: workers kept dying.
    """
    if processes < 1:
        raise InputError(f"volume: {processes} processes cannot work; give 1 or more")
    target, started = Path(path), clock()
    extra: dict[str, Any] = {"collisions": collisions}
    touching = CollisionModel(robot)
    if target.exists():
        table = VolumeTable.open(target, robot, extra)
        if table.grid.describe() != grid.describe():
            raise InputError(f"{target}: holds a volume of other targets; choose another directory, or remove it")
    else:
        skeleton = build_skeleton(robot, grid.coarse(), lambda q: touching.touching(q) is None)
        table = VolumeTable.create(target, robot, grid, skeleton, extra)
    skeleton_seconds = clock() - started
    solver = BlockSolver(Chain.of(robot), robot.limits.lower, robot.limits.upper, grid, table.skeleton)
    if collisions:
        solver = CheckedSolver(**vars(solver), robot=robot)
    blocks = table.missing()
    left = sum(int(np.prod([stop - start for start, stop in block.ranges])) for block in blocks)
    resumed = done = grid.targets - left
    if progress is not None:
        progress(done, grid.targets)
    answers = in_processes(solver, blocks, processes) if scheduler is None else on_cluster(solver, blocks, scheduler)
    for block, solved in answers:
        table.write(block, solved.q, solved.status)
        done += solved.status.size
        if progress is not None:
            progress(done, grid.targets)
    return VolumeReport(table, left, resumed, clock() - started, skeleton_seconds)


@dataclass(frozen=True)
class CheckedSolver(BlockSolver):
    """A block solver that also looks for collisions.

    Attributes:
        robot: the arm.
    """

    robot: Robot

    def __call__(self, block: Any) -> Solved:
        """Postures of a block; those at which the arm touches something keep their posture and say so."""
        solved = super().__call__(block)
        touching = CollisionModel(self.robot)
        status = solved.status.copy()
        for index in np.argwhere(status == Status.REACHED):
            at = tuple(index)
            if touching.touching(solved.q[at]) is not None:
                status[at] = Status.TOUCHING
        return Solved(solved.q, status)
