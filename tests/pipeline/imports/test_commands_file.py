"""Commands in a file of their own, with another rate, beside the file of measurements."""

import json
from pathlib import Path

import numpy as np
import pytest

from armdyn.errors import InputError
from armdyn.recording.channels import Channel
from armdyn.run import read_run
from pipeline.imports.commands import with_commands

from .conftest import JOINTS

TIME = 100.0 + 0.02 * np.arange(500)
TOLD = 99.09 + 0.2 * np.arange(60)
"""Ten times slower, from before the first measurement to after the last."""


def angles(time):
    return np.stack([1.2 * np.sin(0.8 * time), 0.7 * np.cos(1.3 * time)], axis=-1)


def written(path, time, values, header):
    lines = [f"{t:.6f},{','.join(f'{x:.9f}' for x in row)}" for t, row in zip(time, values, strict=True)]
    Path(path).write_text("\n".join([header, *lines]) + "\n", encoding="utf-8")


@pytest.fixture
def files(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    written("measured.csv", TIME, angles(TIME - 0.03), "t [s],q.shoulder [rad],q.elbow [rad]")
    written("commands.csv", TOLD, angles(TOLD), "t [s],q_cmd.shoulder [rad],q_cmd.elbow [rad]")


@pytest.mark.usefixtures("files")
@pytest.mark.parametrize("kind", ["q_cmd", "q"])
def test_commands_hold_until_the_next_one_and_are_not_interpolated(kind, armdyn):
    """A file of commands may call them positions: they are what was told all the same."""
    path = Path("commands.csv")
    path.write_text(path.read_text(encoding="utf-8").replace("q_cmd", kind), encoding="utf-8")
    status, out, _ = armdyn("import", "measured.csv", "--commands", "commands.csv", "--output", "runs")
    assert status == 0
    assert "commands: 60 messages came, all are used" in out
    run = read_run("runs/measured.csv")
    begin = TOLD[4]  # the last one before the first measurement
    for i, joint in enumerate(JOINTS):
        told = run.channels[f"q_cmd.{joint}"]
        at = TIME[:400]
        before = TOLD[np.searchsorted(TOLD, at, side="right") - 1]
        np.testing.assert_allclose(told.zero_order_hold_values(at - begin), angles(before)[:, i], atol=1e-8)
        assert told.time[-1] <= TIME[-1] - begin
        np.testing.assert_allclose(run.channels[f"q.{joint}"].time, TIME - begin, atol=1e-6)


def test_an_early_command_is_told_at_most_a_step_before_the_first_measurement():
    measured = {"q.a": Channel(np.linspace(10.0, 12.0, 50), np.zeros(50), "rad")}
    time = np.append(0.0, 10.5 + 0.1 * np.arange(15))
    found, notes = with_commands(measured, {"q_cmd.a": Channel(time, np.arange(16.0), "rad")}, "told")
    assert found["q_cmd.a"].time[0] == pytest.approx(9.9)
    assert found["q_cmd.a"].zero_order_hold_values(np.array([10.0, 10.49, 10.5])).tolist() == [0.0, 0.0, 1.0]
    assert notes == []


def test_what_was_not_told_is_said():
    measured = {"q.a": Channel(np.linspace(0.0, 10.0, 500), np.zeros(500), "rad")}
    told = {"q_cmd.a": Channel(2.0 + 0.1 * np.arange(30), np.zeros(30), "rad")}
    found, notes = with_commands(measured, told, "told")
    assert len(found["q_cmd.a"]) == 30
    assert notes == [
        "told: the first q_cmd.a comes 2 s after the first measurement",
        "told: the last q_cmd.a holds for the last 5.1 s",
    ]


@pytest.mark.parametrize(
    ("name", "time"),
    [("q_cmd.a", TIME + 1e3), ("q_cmd.a", TIME - 1e3), ("q.a", TIME), ("voltage.a", TIME)],
    ids=["later", "earlier", "in both", "no command"],
)
def test_commands_that_do_not_belong_to_the_measurements_are_refused(name, time, complains):
    told = {name: Channel(time, np.zeros(len(time)), "V" if name == "voltage.a" else "rad")}
    measured = {"q.a": Channel(TIME, np.zeros(len(TIME)), "rad")}
    if name == "q.a":
        told, measured = {"q_cmd.a": told["q.a"]}, {**measured, "q_cmd.a": told["q.a"]}
    with complains(InputError):
        with_commands(measured, told, "told")


@pytest.mark.usefixtures("files")
def test_a_mapping_has_a_table_for_the_file_of_commands(armdyn, refused, complains):
    written("log.csv", 1e3 * TIME, np.rad2deg(angles(TIME)), "time_ms,shoulder_pos,elbow_pos")
    written("sent.csv", TOLD, angles(TOLD), "stamp,shoulder,elbow")
    both = ("import", "log.csv", "--commands", "sent.csv", "--output", "runs")
    assert armdyn(*both, "--guess", "--json", "J")[0] == 0
    answer = json.loads(Path("J").read_text(encoding="utf-8"))
    assert answer["commands"]["time"] == {"column": "stamp", "unit": "s", "check": ""}
    for joint in JOINTS:
        told = answer["commands"]["columns"][joint]
        assert told["channel"] == f"q_cmd.{joint}"
        assert told["unit"] == "deg"
        assert told["check"].endswith("in another unit?")  # the commands are in rad
    mapping = Path("runs/map.toml")
    text, _, commands = mapping.read_text(encoding="utf-8").partition("[commands]")
    mapping.write_text(text + "[commands]" + commands.replace('unit = "deg"', 'unit = "rad"'), encoding="utf-8")
    assert armdyn(*both, "--map", mapping)[0] == 0
    told = read_run("runs/log.csv").channels["q_cmd.elbow"]
    np.testing.assert_allclose(told.value[1], angles(TOLD[5:6])[0, 1], atol=1e-6)
    complains.line(refused("import", "log.csv", "--map", mapping, "--output", "runs", "--force"))
    mapping.write_text(text, encoding="utf-8")
    complains.line(refused(*both, "--map", mapping, "--force"))
    mapping.write_text(text + "[commands]\nrows = 1\n", encoding="utf-8")
    complains.line(refused(*both, "--map", mapping, "--force"))


@pytest.mark.usefixtures("files")
def test_commands_are_of_one_recording_and_no_recording_of_their_own(refused, complains):
    complains.line(refused("import", "measured.csv", "commands.csv", "--output", "runs"))
    complains.line(refused("import", "measured.csv", "measured.csv", "--commands", "commands.csv", "--output", "runs"))
    written("late.csv", TOLD + 500.0, angles(TOLD), "t [s],q_cmd.shoulder [rad],q_cmd.elbow [rad]")
    complains.line(refused("import", "measured.csv", "--commands", "late.csv", "--output", "runs"))
    written("torques.csv", TOLD, angles(TOLD), "t [s],current.shoulder [A],current.elbow [A]")
    complains.line(refused("import", "measured.csv", "--commands", "torques.csv", "--output", "runs"))
