"""`armdyn import` as a user meets it."""

import json
import re
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


def test_nothing_is_written_over_without_force_and_the_recording_never(armdyn, refused, table, complains):
    for arguments in (("--guess",), ("--map", "runs/map.toml")):
        command = ("import", table, "--output", "runs", *arguments)
        assert armdyn(*command)[0] == 0
        complains.line(refused(*command))
        assert armdyn(*command, "--force")[0] == 0
    before = table.read_bytes()
    complains.line(refused("import", table, "--output", ".", "--map", "runs/map.toml", "--force"))
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


@pytest.mark.parametrize(("spare", "last"), [(8, "odd_7"), (9, "odd_7 and 1 more")])
def test_columns_left_out_are_named_up_to_a_number(armdyn, table, spare, last):
    lines = table.read_text().splitlines()
    names = "".join(f",odd_{i}" for i in range(spare))
    table.write_text("\n".join([lines[0] + names, *(line + ",0.5" * spare for line in lines[1:])]))
    code, said, _ = armdyn("import", table, "--output", "runs", "--guess")
    assert code == 0
    assert f"left out: odd_0, odd_1, odd_2, odd_3, odd_4, odd_5, odd_6, {last}\n" in said


def test_what_nobody_answered_is_asked_until_somebody_has(armdyn, table, tmp_path):
    guess = ("import", table, "--output", "runs", "--guess")
    table.write_text(table.read_text().replace("joint_1_torque", "joint_1_current", 1))
    armdyn(*guess)
    mapping = tmp_path / "runs/map.toml"
    again = ("import", table, "--output", "runs", "--map", mapping, "--force")
    assert mapping.read_text().count("check = ") == 1
    said = "tau.joint_1 was made of 'joint_1_current': the torque constant and the gear"
    assert said in " ".join(armdyn(*again)[1].split())
    assert armdyn("inspect", "runs/log.csv", "--json", "j.json")[0] == 0
    (check,) = json.loads(Path("j.json").read_text())["recording_checks"]
    assert (check["kind"], check["severity"]) == ("unanswered_check", "suspect")
    assert "[asked] in runs/log.toml" in check["remedy"]
    mapping.write_text(re.sub(r", check = .*? }", " }", mapping.read_text()))
    assert armdyn(*again)[0] == 0
    assert read_run("runs/log.csv").asked == {}
