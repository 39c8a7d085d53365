"""Raw registers of servos: the counts are packed here as the makers' manuals say, into bytes of the register's size."""

import struct
from pathlib import Path

import numpy as np
import pytest

from armdyn.arm.drives import chosen_drives
from armdyn.arm.known_drives import KNOWN_DRIVES
from armdyn.errors import InputError
from armdyn.run import read_run
from pipeline.imports import read_foreign
from pipeline.imports.conversion import run_from_recording
from pipeline.imports.guess import guess_map, map_unambiguous_columns
from pipeline.imports.joints import JointRange, RobotJoints
from pipeline.imports.register_entries import DriveKinds
from pipeline.imports.registers import REGISTERS, decoded

from .conftest import JOINTS, TIME

ROBOT = RobotJoints(JOINTS, ranges={joint: JointRange(False, 3.2, 5.0) for joint in JOINTS})
Q = np.stack([1.5 * np.sin(2 * TIME), -1.2 + 0.9 * np.cos(3 * TIME)], axis=-1)
V = np.stack([3.0 * np.cos(2 * TIME), -2.7 * np.sin(3 * TIME)], axis=-1)
LOAD, AMPERES = 0.4 * np.cos(TIME + 1.0), 0.5 * np.sin(3 * TIME)
COUNTS = 4096 / (2 * np.pi)


def two(x):
    """Two's complement of 2 bytes, read without a sign."""
    return [struct.unpack("<H", struct.pack("<h", int(value)))[0] for value in np.round(x)]


def four(x):
    return [struct.unpack("<I", struct.pack("<i", int(value)))[0] for value in np.round(x)]


def bit(number):
    return lambda x: [abs(int(value)) + (int(value < 0) << number) for value in np.round(x)]


def table(path, columns):
    rows = zip(*columns.values(), strict=True)
    path.write_text("\n".join([",".join(columns), *(",".join(map(str, row)) for row in rows)]) + "\n")
    (foreign,) = read_foreign(path)
    return foreign


LOGS = {
    # kind: words of the registers, how each is packed, and counts per SI unit
    "xl330-m288": {
        "Present_Position": (four, Q * COUNTS + 2048), "Goal_Position": (four, (Q + 0.1) * COUNTS + 2048),
        "Present_Velocity": (four, V * 60 / (2 * np.pi) / 0.229), "Present_PWM": (two, LOAD * 885),
        "Present_Current": (two, AMPERES * 1000), "Present_Input_Voltage": (two, 50 + 0 * TIME),
    },
    "xm430-w350": {
        "Present_Position": (four, Q * COUNTS + 2048), "Goal_Position": (four, (Q + 0.1) * COUNTS + 2048),
        "Present_Velocity": (two, V * 60 / (2 * np.pi) / 0.229), "Present_PWM": (two, LOAD * 885),
        "Present_Current": (two, AMPERES * 1000 / 2.69), "Present_Input_Voltage": (two, 50 + 0 * TIME),
    },
    "sts3215": {
        "Present_Position": (bit(15), Q * COUNTS + 2048), "Goal_Position": (bit(15), (Q + 0.1) * COUNTS + 2048),
        "Present_Velocity": (bit(15), V * COUNTS), "Present_Load": (bit(10), LOAD * 1000),
        "Present_Current": (bit(15), AMPERES * 1000 / 6.5), "Present_Voltage": (two, 50 + 0 * TIME),
    },
    "mx106": {
        "Present_Position": (two, Q * COUNTS + 2048), "Goal_Position": (two, (Q + 0.1) * COUNTS + 2048),
        "Present_Speed": (bit(10), V * 60 / (2 * np.pi) / 0.114), "Present_PWM": (two, LOAD * 885),
        "Present_Current": (two, AMPERES * 1000 / 3.36), "Present_Voltage": (two, 50 + 0 * TIME),
    },
}  # fmt: skip


def logged(kind, header="{register}_{number}"):
    columns = {"time": TIME}
    for register, (pack, x) in LOGS[kind].items():
        for i, joint in enumerate(JOINTS):
            name = header.format(register=register, number=i + 1, joint=joint)
            columns[name] = pack(x[:, i] if x.ndim == 2 else x)
    return columns


@pytest.mark.parametrize("header", ["{register}_{number}", "{joint}.{register}", "ID{number}/{register}", "m{number}"])
@pytest.mark.parametrize("kind", LOGS)
def test_registers_are_in_si_units_with_their_signs(kind, header, tmp_path):
    if header == "m{number}":  # the maker's names, written by others
        columns = {name.lower().replace("position", "pos"): value for name, value in logged(kind).items()}
    else:
        columns = logged(kind, header)
    foreign = table(tmp_path / "log.csv", columns)
    run = run_from_recording(foreign, map_unambiguous_columns(foreign, ROBOT, DriveKinds.of([f"{kind}=all"]))).run
    for i, joint in enumerate(JOINTS):
        for channel, true, step in (
            ("q", Q[:, i], 1 / COUNTS), ("q_cmd", Q[:, i] + 0.1, 1 / COUNTS), ("v", V[:, i], 0.025),
            ("duty", LOAD, 0.0012), ("current", AMPERES, 0.0066), ("voltage", 5.0 + 0 * TIME, 0.01),
        ):  # fmt: skip
            np.testing.assert_allclose(run.channels[f"{channel}.{joint}"].value, true, atol=0.52 * step)
    assert any(note.startswith("raw negative numbers") for note in run.warnings)
    assert any("2048 taken as the joint's zero" in note for note in run.warnings)


def test_a_speed_in_fifties_of_counts_is_told_by_the_positions_slope(tmp_path):
    columns = logged("sts3215")
    for i in range(2):
        columns[f"Present_Velocity_{i + 1}"] = bit(15)(V[:, i] * COUNTS / 50)
    foreign = table(tmp_path / "log.csv", columns)
    found = guess_map([foreign], ROBOT, drives=DriveKinds.of(["sts3215=all"]))
    assert found.entries["Present_Velocity_1"].scale == pytest.approx(50 / 4096)
    assert not found.entries["Present_Velocity_1"].check
    run = run_from_recording(foreign, found).run
    np.testing.assert_allclose(run.channels["v.shoulder"].value, V[:, 0], atol=0.52 * 50 / COUNTS)


def test_a_log_whose_signs_somebody_has_read_already_remains(tmp_path):
    columns = logged("xl330-m288") | {f"Present_Velocity_{i + 1}": np.round(V[:, i] * 41.7).astype(int) for i in (0, 1)}
    foreign = table(tmp_path / "log.csv", columns)
    run = run_from_recording(foreign, map_unambiguous_columns(foreign, ROBOT, DriveKinds.of(["xl330=all"]))).run
    np.testing.assert_allclose(run.channels["v.elbow"].value, V[:, 1], atol=0.02)


@pytest.mark.parametrize("what", ["degrees", "speeds of nothing", "of too many bits"])
def test_numbers_that_are_no_register_are_asked_about(what, tmp_path, complains):
    columns = logged("sts3215")
    if what == "degrees":  # as LeRobot writes them
        columns |= {f"Present_Position_{i + 1}": np.rad2deg(Q[:, i]) for i in (0, 1)}
    elif what == "of too many bits":
        columns["Present_Position_1"] = [70000 + i for i in range(len(TIME))]
    else:
        columns["Present_Velocity_1"] = bit(15)(V[:, 1] * COUNTS)
    foreign = table(tmp_path / "log.csv", columns)
    drives = DriveKinds.of(["sts3215=all"])
    wrong = f"Present_{'Velocity' if what == 'speeds of nothing' else 'Position'}_1"
    assert guess_map([foreign], ROBOT, drives=drives).entries[wrong].check
    if wrong == "Present_Velocity_1":  # a speed may be left out, which is said
        assert "v.shoulder" not in map_unambiguous_columns(foreign, ROBOT, drives).entries
    else:
        with complains(InputError):
            map_unambiguous_columns(foreign, ROBOT, drives)


def test_motors_that_count_from_elsewhere_are_asked_about(tmp_path):
    columns = {name.replace("_1", "_11").replace("_2", "_12"): value for name, value in logged("xl330-m288").items()}
    found = guess_map([table(tmp_path / "log.csv", columns)], ROBOT, drives=DriveKinds.of(["xl330=all"]))
    assert found.entries["Present_Position_12"].channel == "q.elbow"
    assert "motors 11 to 12" in found.entries["Present_Position_12"].check


def test_joints_may_have_different_drives(tmp_path):
    columns = {**logged("xm430-w350"), **{k: v for k, v in logged("sts3215").items() if k.endswith("2")}}
    drives = DriveKinds.of(["xm430-w350=shoulder", "sts3215=elbow"])
    found = guess_map([table(tmp_path / "log.csv", columns)], ROBOT, drives=drives).entries
    assert found["Present_Current_1"].scale == 2.69
    assert found["Present_Current_2"].scale == 6.5
    assert "Present_PWM_2" not in found  # no register of a Feetech


def test_a_position_of_many_turns_is_no_wrapped_one():
    registers = REGISTERS["xl330"]["present", "position"]
    assert decoded(np.array([0.0, 40000.0]), registers.negative)[0].tolist() == [0.0, 40000.0]
    assert decoded(np.array([3.0, 2.0**32 - 5.0]), registers.negative)[0].tolist() == [3.0, -5.0]


@pytest.mark.parametrize("text", ["sts3215", "ax999=all", "sts3215:position=all", "sts3215=wrist"])
def test_registers_of_no_known_drive_are_one_line(text, tmp_path, complains):
    foreign = table(tmp_path / "log.csv", logged("sts3215"))
    with complains(InputError):
        guess_map([foreign], ROBOT, drives=DriveKinds.of([text]))


def test_a_log_without_registers_is_not_read_as_one(tmp_path, complains):
    columns = {"time": TIME} | {f"observation.state/{joint}.pos": 50.0 * Q[:, i] for i, joint in enumerate(JOINTS)}
    foreign = table(tmp_path / "log.csv", columns)
    with complains(InputError):
        guess_map([foreign], ROBOT, drives=DriveKinds.of(["sts3215=all"]))
    # LeRobot's positions are degrees or shares of the joint's range: no drive says which.
    assert all(entry.check for entry in guess_map([foreign], ROBOT).entries.values())


def test_every_series_with_registers_is_of_a_known_drive():
    for series in REGISTERS:
        assert any(kind == series or kind.startswith(f"{series}-") for kind in KNOWN_DRIVES)
        assert chosen_drives([f"{next(k for k in KNOWN_DRIVES if k.startswith(series))}=all"], JOINTS)


def test_the_command_proposes_a_mapping_that_says_how_the_registers_are_read(armdyn, refused, complains, tmp_path):
    table(tmp_path / "log.csv", {"t": TIME} | {k: v for k, v in logged("sts3215").items() if k != "time"})
    command = ("import", "log.csv", "--output", "runs")
    assert armdyn(*command, "--guess", "--drive", "sts3215=all")[0] == 0
    mapping = Path("runs/map.toml").read_text(encoding="utf-8")
    assert 'unit = "turn", offset = "-180 deg", scale = 0.000244140625, negative = "bit 15"' in mapping
    assert armdyn(*command, "--map", "runs/map.toml")[0] == 0
    status, said, _ = armdyn(*command, "--drive", "sts3215=all", "--force")
    assert status == 0
    assert "--drive sts3215=all" in said  # in the proposed command
    np.testing.assert_allclose(read_run("runs/log.csv").channels["q.joint_2"].value, Q[:, 1], atol=1e-3)
    complains.line(refused(*command, "--map", "runs/map.toml", "--drive", "sts3215=all"))
    Path("runs/map.toml").write_text(mapping.replace("bit 15", "bit 99", 1), encoding="utf-8")
    complains.line(refused(*command, "--map", "runs/map.toml", "--force"))


def test_commands_of_a_file_of_their_own_may_be_registers(armdyn, tmp_path):
    told = {k: v[::5] for k, v in logged("xl330-m288").items() if k == "time" or k.startswith("Goal_Position")}
    table(tmp_path / "told.csv", told)
    table(tmp_path / "log.csv", {k: v for k, v in logged("xl330-m288").items() if not k.startswith("Goal")})
    both = ("import", "log.csv", "--commands", "told.csv", "--output", "runs", "--drive", "xl330=all")
    for more in ((), ("--guess",)):
        assert armdyn(*both, *more)[0] == 0
    told = read_run("runs/log.csv").channels["q_cmd.joint_1"]
    np.testing.assert_allclose(told.value, Q[::5, 0] + 0.1, atol=1e-3)
    assert told.unit == "rad"
