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
    assert armdyn(*again, "--confirm")[0] == 0
    assert read_run("runs/log.csv").asked == {}
    mapping.write_text(re.sub(r", check = .*? }", " }", mapping.read_text()))
    assert armdyn(*again)[0] == 0
    assert read_run("runs/log.csv").asked == {}


def test_of_more_motors_than_the_arm_has_joints_those_that_move_are_taken(armdyn, joints):
    """And each question is asked once, for all its channels."""
    still = np.zeros((len(TIME), 3))
    columns = [np.column_stack([still, values[:, :2]]) for values in joints]
    header = ",".join(["time [s]", *(f"motor_state[{i}].{kind}" for kind in ("q", "dq", "tau_est") for i in range(5))])
    np.savetxt("log.csv", np.column_stack([TIME, *columns]), delimiter=",", header=header, comments="")
    limits = '<limit lower="-9" upper="9" effort="50" velocity="9"/>'
    parts = "".join(
        f'<link name="l{i}"><inertial><mass value="1"/><inertia ixx=".1" iyy=".1" izz=".1" ixy="0" ixz="0" iyz="0"/>'
        f'</inertial></link><joint name="{name}" type="revolute"><parent link="l{i - 1}"/><child link="l{i}"/>'
        f'<axis xyz="0 0 1"/>{limits}</joint>'
        for i, name in enumerate(("hip", "calf"), 1)
    )
    Path("leg.urdf").write_text(f'<robot name="leg"><link name="l0"/>{parts}</robot>')
    assert armdyn("import", "log.csv", "--output", "runs", "--guess", "--urdf", "leg.urdf")[0] == 0
    text = Path("runs/map.toml").read_text()
    for i, joint in enumerate(("hip", "calf"), 3):
        for kind, channel in (("q", "q"), ("dq", "v"), ("tau_est", "tau")):
            assert f'"motor_state[{i}].{kind}" = {{ channel = "{channel}.{joint}"' in text
    assert "5 numbers for 2 joints: is number 3 that of hip?" in text
    armdyn("import", "log.csv", "--output", "runs", "--map", "runs/map.toml", "--urdf", "leg.urdf")
    armdyn("inspect", "runs/log.csv", "--json", "j.json")
    asked = [c for c in json.loads(Path("j.json").read_text())["recording_checks"] if c["kind"] == "unanswered_check"]
    assert sorted(len(check["channels"]) for check in asked) in ([2, 4], [6], [2, 2, 2])
