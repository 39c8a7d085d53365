"""Workers are killed, a user presses Ctrl-C: every recording is done, once."""

import collections
import json
import os
import signal
import subprocess
import sys
import time
import weakref

import pytest

from armdyn.run import read_run
from pipeline.batch.run import JOURNAL_FILE, run_batch
from pipeline.batch.spec import read_spec
from pipeline.batch.work import BatchJob, run_job

from .conftest import FEW

pq = pytest.importorskip("pyarrow.parquet")


def lines(folder):
    """Keys in the journal, as often as they were written."""
    path = folder / "out" / JOURNAL_FILE
    text = path.read_text() if path.exists() else ""
    return collections.Counter(json.loads(line)["key"] for line in text.splitlines())


def check_done_once(folder, done):
    assert len(done.rows) == FEW
    assert done.unfinished == 0
    assert not [row.outcome.problem for row in done.rows if row.outcome.problem]
    assert set(lines(folder).values()) == {1}
    assert len(lines(folder)) == FEW


def dies(job):
    """Stands for a recording that makes its process run out of memory."""
    if job.run.name == "log_2026-01-08.csv":
        os.kill(os.getpid(), signal.SIGKILL)
    from pipeline.batch.work import run_job

    return run_job(job)


def test_a_recording_that_kills_its_process_is_a_row_and_the_others_are_done(lab, monkeypatch):
    (lab / "out").mkdir()
    monkeypatch.setattr("pipeline.batch.run.run_job", dies)
    monkeypatch.setattr("pipeline.batch.run.START_METHOD", "fork")  # which knows this file's function
    done = run_batch(read_spec(lab / "spec.toml"), lab / "out", workers=1)
    bad = [row for row in done.rows if row.outcome.problem]
    assert {row.item.run.name for row in bad} == {"log_2026-01-08.csv"}
    assert all("died 2 times" in row.outcome.problem for row in bad)
    assert len(done.rows) == FEW


def started(folder, *arguments):
    return subprocess.Popen(
        [sys.executable, "-m", "pipeline.cli", "batch", "spec.toml", "--output", "out", "--workers", "1", *arguments],
        cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
    )  # fmt: skip


@pytest.mark.slow
def test_ctrl_c_keeps_what_is_finished_and_the_same_command_goes_on(lab):
    process = started(lab)
    while not lines(lab):
        assert process.poll() is None, process.communicate()
        time.sleep(0.02)
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "Traceback" not in err
    kept = len(lines(lab))
    assert 1 <= kept < FEW
    assert f"{kept} of {FEW} recordings are done and kept; continue with: armdyn batch spec.toml --output out" in err
    assert pq.read_table(lab / "out/batch.parquet").num_rows == kept
    done = run_batch(read_spec(lab / "spec.toml"), lab / "out", workers=1)
    assert done.computed == FEW - kept
    check_done_once(lab, done)


def test_a_worker_keeps_nothing_of_a_recording_that_is_done(lab, monkeypatch):
    seen = []

    def read(path):
        run = read_run(path)
        seen.append(weakref.ref(run))
        return run

    monkeypatch.setattr("armdyn.run.read_run", read)
    item = read_spec(lab / "spec.toml").items[0]
    outcome = run_job(BatchJob("key", "repair", item.model, "key of the model", item.run, None))
    assert outcome.verdict
    assert [one() for one in seen] == [None]
