"""Nobody is left behind: processes that work for another end with it, however it ends and whatever they are doing."""

import multiprocessing
import os
import signal
import sys

import pytest
from descendants import PATIENCE, becomes, linux, marked, of_mark

from ik.child_processes import is_running, worker_pool
from ik.workers import FailedWorkItem, map_in_processes

METHODS = [name for name in ("fork", "spawn", "forkserver") if name in multiprocessing.get_all_start_methods()]

CODE = """
import sys
from ik.child_processes import worker_pool
from descendants import computes, waits
if __name__ == "__main__":
    with worker_pool(3, sys.argv[1]) as pool:
        for work in (waits, computes, waits):
            pool.submit(work, 0)
        print("begun", flush=True)
        pool.submit(waits, 0).result()
"""


@linux
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("number", [signal.SIGKILL, pytest.param(signal.SIGTERM, marks=pytest.mark.slow)])
def test_workers_end_with_a_parent_that_is_killed_whatever_they_compute(tmp_path, method, number):
    (tmp_path / "parent.py").write_text(CODE)
    with marked(sys.executable, "parent.py", method, cwd=tmp_path) as (parent, mark):
        assert parent.stdout.readline() == "begun\n"
        assert becomes(lambda: len(of_mark(mark)) >= 4)
        parent.send_signal(number)
        parent.wait(PATIENCE)
        assert becomes(lambda: not of_mark(mark))


def pause(seconds):
    signal.pause() if seconds else None
    return os.getpid()


def test_a_pool_that_is_interrupted_ends_its_workers_at_once():
    def interrupted():
        with worker_pool(2) as pool:
            running.extend(pool.submit(pause, 1) for _ in range(6))
            while len(pool._processes) < 2:
                pass
            workers.extend(pool._processes)
            raise KeyboardInterrupt

    running, workers = [], []
    with pytest.raises(KeyboardInterrupt):
        interrupted()
    # By number: the pool's own thread collects its workers too, and `Process.is_alive` does not know who was first.
    assert becomes(lambda: not any(is_running(worker) for worker in workers))


class Dies:
    """Stands in for work: ends its process without a word at an odd number, at 1 once and at 3 whenever it is asked."""

    def __init__(self, mark):
        self.mark = mark

    def __call__(self, number):
        if number == 3 or (number == 1 and not self.mark.exists()):
            self.mark.touch()
            os._exit(1)
        return 10 * number


def test_work_of_which_processes_die_is_tried_again_alone_and_then_lost(tmp_path):
    done = dict(map_in_processes(Dies(tmp_path / "died"), range(6), 2, "fork"))
    assert {item: result for item, result in done.items() if item != 3} == {0: 0, 1: 10, 2: 20, 4: 40, 5: 50}
    assert done[3] == FailedWorkItem("the process that worked on it died 2 times")


def test_work_that_a_user_stops_ends_at_once():
    done = []
    for item, _ in map_in_processes(abs, range(1000), 2, "fork", stopped=lambda: len(done) >= 5):
        done.append(item)
    assert 5 <= len(done) < 20
