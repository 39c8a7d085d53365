"""A real dask cluster of separate processes, one of whose workers is killed on the way."""

import time

import numpy as np
import pytest
from dask_cluster import dask_cluster, free_port

from armdyn.errors import InputError
from ik.volume import build_volume

pytest.importorskip("distributed")


@pytest.fixture
def cluster(tmp_path):
    with dask_cluster(tmp_path) as started:
        yield started


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
    assert report.table.unfinished_blocks() == []
    alone = build_volume(baxter, small, tmp_path / "alone.zarr").table
    assert np.array_equal(np.asarray(report.table.q[:]), np.asarray(alone.q[:]), equal_nan=True)


def test_a_scheduler_that_does_not_answer_is_bad_input(baxter, small, tmp_path, monkeypatch, complains) -> None:
    monkeypatch.setattr("ik.workers.DASK_CONNECT_TIMEOUT_SECONDS", 0.5)
    started = time.monotonic()
    with complains(InputError):
        build_volume(baxter, small, tmp_path / "none.zarr", scheduler=f"tcp://127.0.0.1:{free_port()}")
    assert time.monotonic() - started < 30
