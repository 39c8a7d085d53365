"""Who solves the blocks: this process, a pool of processes, or a dask cluster."""

from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import get_context

from armdyn.errors import InputError, TaskFailedError
from ik.volume.block import BlockSolver, Solved
from ik.volume.grid import Block

RESTARTS = 3  # of a pool whose worker died
RETRIES = 3  # of a block whose dask worker died
CONNECT = 10.0  # s to wait for a scheduler


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
        try:
            for block, solved in _pooled(solver, left, processes):
                left.remove(block)
                yield block, solved
        except BrokenProcessPool:
            continue
        return
    raise TaskFailedError(
        f"volume: worker processes died {RESTARTS + 1} times, {len(left)} blocks are left; "
        "free some memory and run the same command again to continue"
    )


def _pooled(solver: BlockSolver, blocks: Sequence[Block], processes: int) -> Iterator[tuple[Block, Solved]]:
    # Spawned, not forked: a forked copy of a process with threads can hang.
    with ProcessPoolExecutor(processes, get_context("spawn"), _keep, (solver,)) as pool:
        futures = {pool.submit(_solve_kept, block): block for block in blocks}
        try:
            for future in as_completed(futures):
                yield futures[future], future.result()
        finally:
            pool.shutdown(wait=False, cancel_futures=True)


_kept: list[BlockSolver] = []  # of a worker process, sent once when it starts


def _keep(solver: BlockSolver) -> None:
    _kept[:] = [solver]


def _solve_kept(block: Block) -> Solved:
    return _kept[0](block)


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
    try:
        from distributed import Client, KilledWorker
        from distributed import as_completed as done
    except ImportError as error:
        raise InputError("--scheduler needs dask: run 'pip install armdyn[volume]'") from error
    try:
        client = Client(scheduler, timeout=CONNECT, set_as_default=False)
    except (OSError, ValueError) as error:
        raise InputError(f"{scheduler}: no dask scheduler answers there; start one with 'dask scheduler'") from error
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
