"""`armdyn import` as a user meets it."""

import json
from pathlib import Path

import numpy as np
import pytest

from armdyn.run import read_run

from .conftest import TIME


@pytest.fixture
def table(tmp_path, joints):
    q, v, tau = joints
    path = tmp_path / "log.csv"
    header = "t,joint_1_pos,joint_1_vel,joint_1_torque"
    np.savetxt(path, np.column_stack([TIME, 90 * q[:, 0], 90 * v[:, 0], tau[:, 0]]), delimiter=",", header=header,
               comments="")  # fmt: skip
    return path


def test_guess_then_import_makes_a_run_that_can_be_read(armdyn, table):
    status, out, _ = armdyn("import", table, "--output", "runs", "--guess")
    assert status == 0
    assert "armdyn import" in out
    assert "--map runs/map.toml" in out
    status, out, _ = armdyn("import", table, "--output", "runs", "--map", "runs/map.toml", "--json", "answer.json")
    assert status == 0
    assert "runs/log.csv: q, v, tau of 1 joints, 3.0 s, 100 samples per second" in out
    assert "next: armdyn new arm M.toml --urdf ROBOT.urdf" in out
    run = read_run("runs/log.csv")
    assert run.joints == ("joint_1",)
    assert run.channels["q.joint_1"].unit == "rad"
    answer = json.loads(Path("answer.json").read_text())
    assert answer["schema"] == "armdyn.import/1"
    assert answer["runs"][0]["channels"]["q.joint_1"]["samples"] == len(TIME)


def test_nothing_is_written_over_without_force(armdyn, table):
    armdyn("import", table, "--output", "runs", "--guess")
    status, _, err = armdyn("import", table, "--output", "runs", "--guess")
    assert status == 2
    assert "--force" in err
    arguments = ("import", table, "--output", "runs", "--map", "runs/map.toml")
    assert armdyn(*arguments)[0] == 0
    assert armdyn(*arguments)[0] == 2
    assert armdyn(*arguments, "--force")[0] == 0


def test_the_recording_itself_is_never_replaced(armdyn, table):
    armdyn("import", table, "--output", "runs", "--guess")
    before = table.read_bytes()
    status, _, err = armdyn("import", table, "--output", ".", "--map", "runs/map.toml", "--force")
    assert status == 2
    assert "would take the place" in err
    assert table.read_bytes() == before


def test_a_column_that_one_of_several_files_lacks_is_optional(armdyn, table, tmp_path):
    """And the unit is that of all files: the second one moves so little that it alone would be taken as rad."""
    lines = table.read_text().splitlines()
    rows = [line.split(",") for line in lines[1:]]
    second = tmp_path / "second.csv"
    second.write_text(
        "\n".join([lines[0].rpartition(",")[0], *(f"{t},{float(q) / 40},{float(v) / 40}" for t, q, v, _ in rows)])
        + "\n"
    )
    assert armdyn("import", second, table, "--output", "runs", "--guess")[0] == 0
    assert 'channel = "q.joint_1", unit = "deg"' in Path("runs/map.toml").read_text()
    status, out, _ = armdyn("import", table, second, "--output", "runs", "--map", "runs/map.toml")
    assert status == 0
    assert "no column 'joint_1_torque', which others have: no tau.joint_1" in out
    assert set(read_run("runs/second.csv").channels) == {"q.joint_1", "v.joint_1"}
    assert "tau.joint_1" in read_run("runs/log.csv").channels
    assert armdyn("import", second, "--output", "alone", "--map", "runs/map.toml")[0] == 2
