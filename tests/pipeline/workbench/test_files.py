"""Files dropped onto the page: each is taken in by its own door, or refused in one sentence."""

from pathlib import Path

import numpy as np
import pytest

import urdf
from armdyn.errors import InputError
from armdyn.model_file import read_model
from armdyn.run import read_run
from pipeline.workbench.files import is_passing, new_folder, pendulum, place_for, taken_in


@pytest.fixture
def folder():
    with new_folder() as name:
        yield Path(name)


def test_a_run_is_taken_as_it_is(folder, files):
    _, run, _ = files
    path = folder / "a.csv"
    path.write_bytes(run.read_bytes())
    found = taken_in(path)
    assert (found.kind, found.path) == ("run", path)
    assert "of 7 joints, 6.0 s" in found.said


def test_foreign_columns_are_taken_as_their_names_and_units_suggest(folder):
    time = np.arange(200) * 0.01
    rows = [f"{1000 * t:.0f},{30 * np.sin(t):.3f},{5 * np.cos(t):.3f}" for t in time]
    path = folder / "log.csv"
    path.write_text("timestamp_ms,joint1_pos,joint1_torque\n" + "\n".join(rows) + "\n")
    found = taken_in(path, ["elbow"])
    assert found.kind == "run"
    assert "joint1_pos as q.elbow" in found.said
    run = read_run(found.path)
    assert np.abs(run.channels["q.elbow"].value).max() < 1.0  # degrees became radians
    assert run.channels["q.elbow"].time[-1] == pytest.approx(1.99)


def test_a_urdf_becomes_a_model_of_its_arm(folder):
    path = folder / "ur5.urdf"
    path.write_bytes(urdf.load("ur5", meshes=False).urdf_path.read_bytes())
    found = taken_in(path)
    assert found.kind == "model"
    assert len(read_model(found.path).joints) == 6
    assert is_passing(path)


def test_a_pendulum_is_started_with_what_is_known(folder):
    model = read_model(pendulum(folder, "80 g +/- 0.4 g", ""))
    assert model.value("mass") == pytest.approx(0.08)
    assert model.parameters["mass"].prior.std == pytest.approx(4e-4)
    with pytest.raises(InputError, match="mass: "):
        pendulum(folder, "80 bananas", "")


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("a.csv", b""),
        ("a.csv", b"\x00\x01\x02"),
        ("a.csv", b"time [s],load_force [N]\n0,1\n0,1\n"),
        ("a.mcap", b"no mcap"),
        ("a.urdf", b"<robot"),
        ("a.toml", b"base = 'bicycle'"),
        ("a.toml", b"="),
        ("a.parquet", b"PAR1"),
        ("a.docx", b"x"),
    ],
)
def test_what_cannot_be_used_is_one_sentence(folder, name, content):
    path = folder / name
    path.write_bytes(content)
    with pytest.raises(InputError) as problem:
        taken_in(path)
    assert "\n" not in str(problem.value)


@pytest.mark.parametrize("name", ["../../etc/passwd.csv", "..\\..\\x.csv", "/tmp/x.csv", "a\0b.csv"])
def test_a_dropped_file_stays_in_its_folder(folder, name):
    assert place_for(folder, name).parent == folder


def test_a_name_of_dots_is_refused(folder):
    with pytest.raises(InputError, match="no name of a file"):
        place_for(folder, "..")
