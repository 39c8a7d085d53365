import os
import signal

import numpy as np
import pytest

from armdyn.errors import InputError, TaskFailedError
from pipeline.nodes.background import BackgroundWorker, ProcessWorker


class Counter:
    """Work that remembers how often it was done."""

    def __init__(self):
        self.count = 0

    def work(self, values):
        self.count += 1
        return self.count, os.getpid(), 2.0 * np.asarray(values)


@pytest.fixture
def collected(until):
    """What a worker has done, as soon as it has."""

    def wait(worker, done):
        until(lambda: worker.collect() or done)
        return done

    return wait


@pytest.fixture
def process():
    worker = ProcessWorker()
    yield worker
    worker.stop()


def test_at_once_is_done_before_it_returns():
    worker, counter, found = BackgroundWorker(), Counter(), []
    worker.register("double", counter.work)
    worker.request("double", [1.0], found.append)
    assert found[0][:2] == (1, os.getpid())
    assert not worker.is_pending("double")


def test_another_process_works_and_remembers(process, collected):
    counter, found = Counter(), []
    process.register("double", counter.work)
    process.start()
    for _ in range(2):
        process.request("double", [1.5], found.append)
        assert process.is_pending("double")
        before = len(found)
        while len(found) == before:
            assert collected(process, found)
            process.collect()
    assert [(f[0], f[2][0]) for f in found] == [(1, 3.0), (2, 3.0)]
    assert found[0][1] != os.getpid()
    assert counter.count == 0
    assert not process.is_pending("double")


@pytest.mark.parametrize("error", [InputError("a sentence of ours"), SystemExit(0), None])
def test_what_the_work_raises_is_raised_in_the_loop_and_a_process_that_was_killed_is_a_sentence(
    process, collected, error, complains
):
    def work(_argument):
        if error is not None:
            raise error
        os.kill(os.getpid(), signal.SIGKILL)

    process.register("odd", work)
    process.start()
    process.request("odd", None, lambda _result: None)
    with complains(TaskFailedError):
        collected(process, [])
    assert error is None or not process.is_pending("odd")


def test_ctrl_c_in_the_terminal_is_left_to_the_loop(process, collected):
    found = []
    process.register("pid", lambda _argument: os.getpid())
    process.start()
    process.request("pid", None, found.append)
    os.kill(collected(process, found)[0], signal.SIGINT)
    process.request("pid", None, found.append)
    while len(found) < 2:
        process.collect()
