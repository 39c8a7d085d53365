"""From a robot and a grid to a volume on disk, by this process, a pool of processes or a dask cluster."""

import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from armdyn.errors import InputError, TaskFailedError
from ik.children import worker_pool
from ik.cluster import dask_client
from ik.volume.blocks import BlockSolver, Solved
from ik.volume.grid import Block, Grid
from ik.volume.skeleton import build_skeleton
from ik.volume.store import VolumeTable
from urdf import Robot

RESTARTS = 3  # of a pool whose worker died
RETRIES = 3  # of a block whose dask worker died


def in_processes(solver: BlockSolver, blocks: Sequence[Block], processes: int) -> Iterator[tuple[Block, Solved]]:
    """Solve blocks on this machine, in the order in which they get done.

    Args:
        solver: solves one.
        blocks: what to solve.
        processes: how many at once; 1 does it here.

    Raises:
        TaskFailedError: workers died again and again.
    """
    if processes == 1:
        for block in blocks:
            yield block, solver(block)
        return
    left = list(blocks)
    for _ in range(RESTARTS + 1):
        # Spawned, not forked: a forked copy of a process with threads can hang.
        with suppress(BrokenProcessPool), worker_pool(processes, "spawn") as pool:
            futures = {pool.submit(solver, block): block for block in left}
            for future in as_completed(futures):
                solved = future.result()
                left.remove(futures[future])
                yield futures[future], solved
            return
    raise TaskFailedError(
        f"volume: worker processes died {RESTARTS + 1} times, {len(left)} blocks are left; "
        "free some memory and run the same command again to continue"
    )


def on_cluster(solver: BlockSolver, blocks: Sequence[Block], scheduler: str) -> Iterator[tuple[Block, Solved]]:
    """Solve blocks on a dask cluster, in the order in which they get done; blocks of lost workers go to others.

    Args:
        solver: solves one; it is sent with every block, so that no worker's loss loses it.
        blocks: what to solve.
        scheduler: address, such as ``tcp://host:8786``.

    Raises:
        InputError: dask is missing, or the scheduler does not answer.
        TaskFailedError: a block failed on several workers.
    """
    client = dask_client(scheduler, "volume")
    from distributed import KilledWorker
    from distributed import as_completed as done

    with client:
        futures = {client.submit(solver, block, pure=False, retries=RETRIES): block for block in blocks}
        waiting = done(list(futures), loop=client.loop)
        try:
            for future in waiting:
                block = futures.pop(future)
                yield block, future.result()
                future.release()
        except KilledWorker as error:
            raise TaskFailedError(
                f"volume: dask gave up ({error}), {len(futures) + 1} blocks are left; "
                "run the same command again to continue"
            ) from error
        finally:
            client.cancel(list(futures))


Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class VolumeReport:
    """What was done.

    Attributes:
        table: the volume.
        solved: targets solved this time.
        resumed: targets that were there already.
        seconds: this time took [s], the skeleton included.
    """

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
    if progress is not None:
        progress(done, grid.targets)
    answers = in_processes(solver, blocks, processes) if scheduler is None else on_cluster(solver, blocks, scheduler)
    for block, solved in answers:
        table.write(block, solved)
        done += solved.status.size
        if progress is not None:
            progress(done, grid.targets)
    return VolumeReport(table, left, resumed, clock() - started)
