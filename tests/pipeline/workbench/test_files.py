"""Files dropped onto the page: each is taken in by its own door, or refused in one sentence."""

import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import pytest

import urdf
from armdyn.errors import InputError
from armdyn.model_file import read_model
from armdyn.run import read_run
from pipeline.workbench.files import (
    PAGE_FOLDER_PREFIX,
    WritableFileCheck,
    dropped_file_path,
    is_in_page_folder,
    new_page_folder,
    read_dropped,
    remove_abandoned_page_folders,
    remove_page_folders,
    write_pendulum_model,
)


@pytest.fixture
def folder():
    with new_page_folder() as name:
        yield Path(name)


def test_a_run_a_foreign_recording_and_a_urdf_become_what_they_are(folder, files):
    own, foreign, arm = folder / "a.csv", folder / "log.csv", folder / "ur5.urdf"
    own.write_bytes(files[1].read_bytes())
    found = read_dropped(own)
    assert (found.kind, found.path) == ("run", own)
    assert "of 7 joints, 6.0 s" in found.said

    time = np.arange(200) * 0.01
    rows = [f"{1000 * t:.0f},{30 * np.sin(t):.3f},{5 * np.cos(t):.3f}" for t in time]
    foreign.write_text("timestamp_ms,joint1_pos,joint1_torque\n" + "\n".join(rows) + "\n")
    found = read_dropped(foreign, ["elbow"])
    assert found.kind == "run"
    assert "joint1_pos as q.elbow" in found.said
    q = read_run(found.path).channels["q.elbow"]
    assert np.abs(q.value).max() < 1.0  # degrees became radians
    assert q.time[-1] == pytest.approx(1.99)

    arm.write_bytes(urdf.load("ur5", meshes=False).urdf_path.read_bytes())
    found = read_dropped(arm)
    assert found.kind == "model"
    assert len(read_model(found.path).joints) == 6
    assert is_in_page_folder(arm)


def test_a_pendulum_is_started_with_what_is_known(folder, complains):
    model = read_model(write_pendulum_model(folder, "80 g +/- 0.4 g", ""))
    assert model.value("mass") == pytest.approx(0.08)
    assert model.parameters["mass"].prior.std == pytest.approx(4e-4)
    with complains(InputError):
        write_pendulum_model(folder, "80 bananas", "")


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("a.csv", b""), ("a.csv", b"\x00\x01\x02"), ("a.csv", b"time [s],load_force [N]\n0,1\n0,1\n"),
        ("a.mcap", b"no mcap"), ("a.urdf", b"<robot"), ("a.toml", b"base = 'bicycle'"), ("a.toml", b"="),
        ("a.parquet", b"PAR1"), ("a.docx", b"x"),
    ],
)  # fmt: skip
def test_what_cannot_be_used_is_one_sentence(folder, name, content, complains):
    (folder / name).write_bytes(content)
    with complains(InputError):
        read_dropped(folder / name)


@pytest.mark.parametrize("name", ["../../etc/passwd.csv", "..\\..\\x.csv", "/tmp/x.csv", "a\0b.csv", ".."])
def test_a_dropped_file_stays_in_its_folder_or_is_refused(folder, name, complains):
    if name == "..":
        with complains(InputError):
            dropped_file_path(folder, name)
    else:
        assert dropped_file_path(folder, name).parent == folder


def test_a_page_writes_below_its_folder_and_over_nothing_but_what_it_wrote_and_nobody_changed(tmp_path, complains):
    work = tmp_path / "desk"
    (work / "deep").mkdir(parents=True)
    (work / "link").symlink_to(tmp_path)
    writable = WritableFileCheck(work)
    for there in (work / "m.toml", work / "deep/m.toml", work / "deep/../m.toml"):
        writable.check(there, over=False)
    for elsewhere in (tmp_path / "m.toml", work / "../m.toml", work / "link/m.toml", Path("/etc/m.toml"), work / "/m"):
        with complains(InputError):
            writable.check(elsewhere, over=True)

    mine, other, linked = (work / name for name in ("mine.toml", "other.toml", "linked.toml"))
    for file in (mine, other):
        file.write_text("a = 1")
    linked.symlink_to(other)
    writable.register(mine)
    writable.check(mine, over=True)
    with complains(InputError):
        writable.check(mine, over=False)
    for file in (other, linked, work / "deep"):
        with complains(InputError):
            writable.check(file, over=True)
    mine.write_text("a = 2")
    with complains(InputError):
        writable.check(mine, over=True)


def test_what_a_killed_workbench_left_is_removed_and_what_another_uses_stays(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    ended = subprocess.Popen([sys.executable, "-c", ""])
    ended.wait()
    left, used = (tmp_path / f"{PAGE_FOLDER_PREFIX}{number}-abc" for number in (ended.pid, os.getppid()))
    with new_page_folder() as own:
        for folder in (left, used):
            folder.mkdir()
            (folder / "a.csv").write_text("")
        remove_abandoned_page_folders()
        assert [left.exists(), used.exists(), Path(own).exists()] == [False, True, True]
        remove_page_folders()
        assert [used.exists(), Path(own).exists()] == [True, False]
