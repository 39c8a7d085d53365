"""Programs that are killed, meet a full disk, or run twice at once leave every file as it was, or whole and new."""

import json
import os
import random
import resource
import signal
import subprocess
import sys
import time
import tomllib
from pathlib import Path

import numpy as np
import pytest
from faults.samples import csv

import urdf
from armdyn.run import read_run
from ik.volume import VolumeTable

REPAIR = ("repair", "m.toml", "a.csv", "--output", "out.toml", "--report", "r.html", "--json", "j.json")
INSPECT = ("inspect", "a.csv", "--json", "j.json")
CORNERS = ("--low", "0.7,-0.4,-0.2", "--high", "0.9,-0.2,-0.1", "--counts", "30,30,10")
VOLUME = ("ik", "volume", *CORNERS, "--out", "v.zarr", "--processes", "1")
BUILD = ("ik", "build", "--out", "t.npz")
KILLS = 12  # of each program, at instants that are drawn


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "m.toml").write_text('base = "pendulum"\neffects = []\n')
    (tmp_path / "a.csv").write_text(csv(rows=200))
    return tmp_path


def started(folder, arguments, limit=None):
    def limited():
        if limit is not None:
            resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))

    command = [sys.executable, "-c", "from pipeline.cli import main; main()", *arguments]
    return subprocess.Popen(
        command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, preexec_fn=limited,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
    )  # fmt: skip


def ended(process):
    out, err = process.communicate(timeout=600)
    assert "Traceback" not in err
    return process.returncode, out, err


def check_whole(folder):
    """Whatever is there under its own name can be read."""
    for path in folder.rglob("*"):
        hidden = any(part.startswith(".armdyn-") for part in path.relative_to(folder).parts)
        if not path.is_file() or hidden or ".zarr" in str(path):
            continue
        if path.suffix == ".toml":
            tomllib.loads(path.read_text())
        elif path.suffix == ".json":
            json.loads(path.read_text())
        elif path.suffix == ".html":
            assert path.read_text().rstrip().endswith("</html>")
        elif path.suffix == ".npz":
            with np.load(path) as file:
                assert all(file[name] is not None for name in file.files)


def killed(folder, arguments, seed, seconds):
    """Kill a program at an instant that follows from a seed; True where it was not yet done."""
    process = started(folder, arguments)
    time.sleep(random.Random(seed).uniform(0.2, seconds))
    process.send_signal(signal.SIGKILL)
    return process.wait() == -signal.SIGKILL


def seconds_of(folder, arguments):
    begun = time.perf_counter()
    status, _, err = ended(started(folder, arguments))
    assert status == 0, err
    return time.perf_counter() - begun


@pytest.mark.slow
def test_a_killed_repair_leaves_whole_files(folder):
    lasts = seconds_of(folder, REPAIR)
    old = {name: (folder / name).read_text() for name in ("out.toml", "r.html", "j.json")}
    stopped = sum(killed(folder, REPAIR, seed, lasts + 0.5) for seed in range(KILLS))
    assert stopped > KILLS // 4
    check_whole(folder)
    assert (folder / "out.toml").read_text() == old["out.toml"]  # the same model again
    assert ended(started(folder, REPAIR))[0] == 0


@pytest.mark.slow
def test_a_killed_volume_is_continued_and_ends_the_same(folder):
    lasts = seconds_of(folder, VOLUME)
    whole = VolumeTable.open(folder / "v.zarr")
    expected, status = np.asarray(whole.q[:]), np.asarray(whole.status[:])
    (folder / "v.zarr").rename(folder / "whole.zarr")
    stopped = 0
    for seed in range(KILLS):
        stopped += killed(folder, VOLUME, seed, lasts + 0.5)
        if (folder / "v.zarr").exists():
            table = VolumeTable.open(folder / "v.zarr")  # refuses what is half written
            if not table.unfinished_blocks():
                (folder / "v.zarr").rename(folder / f"done{seed}.zarr")
    assert stopped > KILLS // 4
    assert ended(started(folder, VOLUME))[0] == 0
    again = VolumeTable.open(folder / "v.zarr")
    np.testing.assert_array_equal(np.asarray(again.q[:]), expected)
    np.testing.assert_array_equal(np.asarray(again.status[:]), status)


@pytest.mark.slow
@pytest.mark.parametrize("arguments", [REPAIR, BUILD, VOLUME], ids=" ".join)
def test_a_full_disk_is_one_line_and_leaves_what_was_there(folder, arguments):
    for name in ("out.toml", "r.html", "j.json", "t.npz"):
        (folder / name).write_text("old")
    before = {path: path.read_text() for path in folder.iterdir() if path.is_file()}
    for limit in (100, 3000, 20_000):
        status, _, err = ended(started(folder, arguments, limit))
        said = [line for line in err.splitlines() if line.startswith("armdyn:")]
        assert status == 2, err
        assert len(said) == 1
        assert all(word not in said[0] for word in ("Error(", "[Errno"))
        assert not [path for path in folder.rglob(".armdyn-*") if path.is_file()]
    kept = {path: path.read_text() for path in before}
    assert {path for path in kept if kept[path] != before[path]} <= {folder / "out.toml"}


@pytest.mark.slow
def test_a_trial_whose_disk_is_full_does_not_begin_or_goes_on_and_loses_the_recording_alone(folder):
    trial = ("trial", "--no-estimation", "--out", "t")
    status, _, err = ended(started(folder, trial, 100))  # not even the head of the recording
    assert (status, len(err.strip().splitlines())) == (2, 1)
    status, out, err = ended(started(folder, trial, 20_000))
    assert status == 2
    assert "slack" in out  # the default guess, without an estimate
    assert [line for line in err.splitlines() if line.startswith("armdyn: ")] == [err.splitlines()[-1]]
    assert "could not be written any further" in err
    assert len(read_run(folder / "t" / "trial.mcap", recover=True).channels["gripper_x"]) > 5


def test_two_programs_with_one_output_both_end_and_leave_one_whole_file(folder):
    both = [started(folder, INSPECT) for _ in range(2)]
    assert [ended(process)[0] for process in both] == [0, 0]
    check_whole(folder)
    assert not list(folder.glob(".armdyn-*"))


@pytest.mark.slow
def test_two_volumes_into_one_directory_both_end_with_the_whole_volume(folder):
    both = [started(folder, VOLUME) for _ in range(2)]
    ends = [ended(process) for process in both]
    assert [status for status, _, _ in ends] == [0, 0], ends
    assert not VolumeTable.open(folder / "v.zarr", urdf.load("baxter")).unfinished_blocks()
    assert not list(Path(folder).glob(".armdyn-*"))


@pytest.mark.slow
def test_two_first_runs_share_one_cache(folder, monkeypatch):
    monkeypatch.setenv("ARMDYN_CACHE", str(folder / "cache"))
    (folder / "line.csv").write_text("time [s],s [m]\n" + "".join(f"{k / 50},{0.001 * k}\n" for k in range(50)))
    both = [started(folder, ("check", "line.csv")) for _ in range(2)]
    ends = [ended(process) for process in both]
    assert [status for status, _, _ in ends] == [ends[0][0]] * 2
    assert len(list((folder / "cache").rglob("*.npz"))) == 1
    check_whole(folder)
