"""A real dask cluster of separate processes, one of whose workers is killed on the way."""

import socket
import subprocess
import sys
import time
from collections.abc import Iterator

import numpy as np
import pytest

from armdyn.errors import InputError
from ik.volume import build_volume

pytest.importorskip("distributed")


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@pytest.fixture
def cluster(tmp_path) -> Iterator[tuple[str, list[subprocess.Popen]]]:
    """A scheduler and two workers, each a process of its own."""
    address = f"tcp://127.0.0.1:{free_port()}"

    def start(*arguments: str) -> subprocess.Popen:
        command = [sys.executable, "-m", "dask", *arguments]
        return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, cwd=tmp_path)

    worker = ("worker", address, "--nthreads", "1", "--no-nanny", "--no-dashboard", "--death-timeout", "60")
    processes = [start("scheduler", "--port", address.rpartition(":")[2], "--no-dashboard")]
    processes += [start(*worker), start(*worker)]
    try:
        yield address, processes
    finally:
        for process in processes:
            process.kill()
        for process in processes:
            process.wait()


@pytest.mark.slow
def test_a_volume_survives_the_death_of_a_worker(cluster, baxter, small, tmp_path) -> None:
    from distributed import Client

    address, (_, first, second) = cluster
    with Client(address, timeout=60, set_as_default=False) as client:
        client.wait_for_workers(2, timeout=60)

    def kill_one(done: int, _total: int) -> None:
        if done and first.poll() is None:
            first.kill()

    report = build_volume(baxter, small, tmp_path / "cluster.zarr", scheduler=address, progress=kill_one)
    assert first.wait() != 0
    assert second.poll() is None
    assert report.table.missing() == []
    alone = build_volume(baxter, small, tmp_path / "alone.zarr").table
    assert np.array_equal(np.asarray(report.table.q[:]), np.asarray(alone.q[:]), equal_nan=True)


def test_a_scheduler_that_does_not_answer_is_bad_input(baxter, small, tmp_path, monkeypatch) -> None:
    monkeypatch.setattr("ik.volume.build.CONNECT", 0.5)
    started = time.monotonic()
    with pytest.raises(InputError, match="no dask scheduler answers there"):
        build_volume(baxter, small, tmp_path / "none.zarr", scheduler=f"tcp://127.0.0.1:{free_port()}")
    assert time.monotonic() - started < 30
