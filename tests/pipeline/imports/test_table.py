"""CSV of any dialect, Parquet and LeRobot's data sets; mappings that say every problem; guesses that fit."""

import json

import numpy as np
import pyarrow
import pytest
from pyarrow import parquet

from armdyn.errors import InputError
from pipeline.imports import read_foreign
from pipeline.imports.conversion import run_of
from pipeline.imports.guess import guess_map
from pipeline.imports.joints import Joints
from pipeline.imports.mapping import known_columns, map_text, read_map

from .conftest import TIME

GERMAN = "Zeit_ms;J1 Pos (deg);J2 Pos (deg);J1 Vel;J2 Vel;J1 Cur (A);J2 Cur (A);J1 Target Pos;Kommentar\n"


@pytest.fixture
def german(tmp_path, joints):
    """Degrees and decimal commas, as a spreadsheet saves them; a time in ms since 1970."""
    q, v, tau = joints
    lines = [
        ";".join(f"{x:.6f}".replace(".", ",") for x in (1.7e12 + 1e3 * t, *np.rad2deg(q[i]), *np.rad2deg(v[i]),
                                                         *(tau[i] / [12.0, 6.0]), 0.0)) + ";gut\n"
        for i, t in enumerate(TIME)
    ]  # fmt: skip
    path = tmp_path / "german.csv"
    path.write_text(GERMAN + "".join(lines), encoding="cp1252")
    return path


MAP = """
description = "tested"
time = { column = "Zeit_ms", unit = "ms" }
[known]
mass = "80 g +/- 0.4 g"
[columns]
"J1 Pos" = { channel = "q.shoulder", unit = "deg" }
"J2 Pos" = { channel = "q.elbow", unit = "deg", sign = -1, offset = "90 deg" }
"J1 Vel" = { channel = "v.shoulder", unit = "deg/s", gear_ratio = 2 }
"J1 Cur" = { channel = "tau.shoulder", torque_constant = "0.12 N m/A", gear_ratio = 100 }
"""


def mapped(tmp_path, text):
    path = tmp_path / "map.toml"
    path.write_text(text)
    return read_map(path)


def test_a_mapping_converts_degrees_signs_offsets_gears_and_currents(german, tmp_path, joints):
    (foreign,) = read_foreign(german)
    run = run_of(foreign, mapped(tmp_path, MAP))
    q, v, tau = joints
    np.testing.assert_allclose(run.channels["q.shoulder"].value, q[:, 0], atol=1e-7)
    np.testing.assert_allclose(run.channels["q.elbow"].value, np.pi / 2 - q[:, 1], atol=1e-7)
    np.testing.assert_allclose(run.channels["v.shoulder"].value, v[:, 0] / 2, atol=1e-7)
    np.testing.assert_allclose(run.channels["tau.shoulder"].value, tau[:, 0], atol=1e-5)
    np.testing.assert_allclose(run.channels["q.shoulder"].time, TIME, atol=1e-6)
    assert run.known["mass"].value == pytest.approx(0.08)
    assert run.description == "tested"
    assert any("'Kommentar' holds text" in note for note in run.warnings)


def test_every_problem_of_a_mapping_file_is_told_at_once(tmp_path):
    text = """
    tme = "t"
    [columns]
    "a" = { channel = "q.elbow", unit = "deg", sign = 2 }
    "b" = { channel = "torque.elbow" }
    "c" = { channel = "q.wrist", gear_ratio = 0, unti = "deg" }
    "d" = "q.hand"
    """
    with pytest.raises(InputError) as caught:
        mapped(tmp_path, text)
    message = str(caught.value)
    assert "6 problems" in message
    for part in ("'tme'", "'a': sign = 2", "'b': unknown channel", "'c': unknown key 'unti'", "gear_ratio = 0", "'d'"):
        assert part in message


def test_every_problem_of_the_columns_is_told_at_once(german, tmp_path):
    text = """
    time = { column = "Zeit_ms", unit = "N" }
    [columns]
    "J1 Poss" = { channel = "q.shoulder", unit = "deg" }
    "J2 Pos" = { channel = "q.elbow", unit = "kg" }
    "J1 Vel" = { channel = "v.shoulder" }
    "J1 Cur" = { channel = "tau.shoulder" }
    "J2 Cur" = { channel = "tau.shoulder", torque_constant = "1 N m/A" }
    """
    (foreign,) = read_foreign(german)
    with pytest.raises(InputError) as caught:
        run_of(foreign, mapped(tmp_path, text))
    message = str(caught.value)
    for part in (
        "6 problems",
        "'Zeit_ms': 'N' is of another kind",
        "unknown column 'J1 Poss': did you mean 'J1 Pos'?",
        "'J2 Pos': 'kg' is of another kind",
        "'J1 Vel': its unit is not known",
        "'J1 Cur': is a current: add torque_constant",
        "both tau.shoulder",
    ):
        assert part in message


def test_a_guess_finds_degrees_milliseconds_currents_and_the_robots_names(german, tmp_path):
    (foreign,) = read_foreign(german)
    found = guess_map([foreign], Joints(("base_to_upper", "upper_to_lower")))
    assert (found.time, found.time_unit) == ("Zeit_ms", "ms")
    by_column = {name: (entry.channel, entry.unit) for name, entry in found.entries.items()}
    assert by_column == {
        "J1 Pos": ("q.base_to_upper", "deg"),
        "J2 Pos": ("q.upper_to_lower", "deg"),
        "J1 Vel": ("v.base_to_upper", "deg/s"),
        "J2 Vel": ("v.upper_to_lower", "deg/s"),
        "J1 Cur": ("tau.base_to_upper", "A"),
        "J2 Cur": ("tau.upper_to_lower", "A"),
    }
    again = mapped(tmp_path, map_text(found, "two\nlines"))
    assert {name: entry.channel for name, entry in again.entries.items()} == {n: c for n, (c, _) in by_column.items()}
    assert run_of(foreign, again).joints == ("base_to_upper", "upper_to_lower")


@pytest.mark.parametrize(
    ("labels", "scale", "joint", "unit"),
    [
        (("actual_q_0", "actual_qd_0", "actual_current_0"), 1.0, "joint_0", "rad"),  # Universal Robots' RTDE
        (("q0", "dq0", "tau_J0"), 1.0, "joint_0", "rad"),
        (("joint_elbow/pos", "joint_elbow/vel", "joint_elbow/effort"), 180 / np.pi, "elbow", "deg"),
        (("Joint 3 Position", "Joint 3 Velocity", "Joint 3 Torque"), 180 / np.pi, "joint_3", "deg"),
    ],
)
def test_common_names_are_understood(labels, scale, joint, unit, tmp_path, joints):
    q, v, tau = joints
    table = np.column_stack([TIME, scale * q[:, 0], scale * v[:, 0], tau[:, 0]])
    path = tmp_path / "a.csv"
    np.savetxt(path, table, delimiter=",", header=",".join(["timestamp", *labels]), comments="")
    (foreign,) = read_foreign(path)
    found = guess_map([foreign])
    assert (found.time, found.time_unit) == ("timestamp", "s")
    entries = [found.entries[label] for label in labels]
    assert [entry.channel for entry in entries] == [f"q.{joint}", f"v.{joint}", f"tau.{joint}"]
    assert [entry.unit for entry in entries[:2]] == [unit, f"{unit}/s"]


def test_a_parquet_file_of_channels_needs_no_mapping(tmp_path, joints):
    path = tmp_path / "a.parquet"
    stamps = np.datetime64("2026-01-01") + (TIME * 1e9).astype("timedelta64[ns]")
    parquet.write_table(pyarrow.table({"time": stamps, "q.a [deg]": np.rad2deg(joints[0][:, 0])}), path)
    (foreign,) = read_foreign(path)
    run = run_of(foreign, known_columns(foreign))
    np.testing.assert_allclose(run.channels["q.a"].value, joints[0][:, 0])
    np.testing.assert_allclose(run.channels["q.a"].time, TIME, atol=1e-9)


@pytest.mark.parametrize("version", [2, 3])
def test_episodes_of_a_lerobot_data_set(version, tmp_path, joints):
    """Positions in degrees under LeRobot's names, currents as a feature of its own; two episodes."""
    names = ["shoulder_pan.pos", "elbow_flex.pos"]
    (tmp_path / "meta").mkdir()
    features = {
        "observation.state": {"dtype": "float32", "shape": [2], "names": names},
        "observation.current": {"dtype": "float32", "shape": [2], "names": {"motors": names}},
        "action": {"dtype": "float32", "shape": [2], "names": names},
    }
    (tmp_path / "meta/info.json").write_text(json.dumps({"fps": 100, "features": features}))
    q, _, tau = joints
    rows = pyarrow.table(
        {
            "observation.state": [list(row) for row in np.tile(np.rad2deg(q), (2, 1))],
            "observation.current": [list(row) for row in np.tile(tau, (2, 1))],
            "action": [list(row) for row in np.zeros((600, 2))],
            "timestamp": np.tile(TIME, 2).astype(np.float32),
            "frame_index": np.tile(np.arange(300), 2),
            "episode_index": np.repeat([0, 1], 300),
            "task_index": np.zeros(600, int),
        }
    )
    data = tmp_path / "data/chunk-000"
    data.mkdir(parents=True)
    if version == 3:
        parquet.write_table(rows, data / "file-000.parquet")
    else:
        for i in range(2):
            parquet.write_table(rows.slice(300 * i, 300), data / f"episode_{i:06d}.parquet")
    recordings = read_foreign(tmp_path)
    assert [r.name for r in recordings] == [f"{tmp_path.name}_episode_{i:06d}" for i in range(2)]
    found = guess_map(recordings)
    assert {name: entry.channel for name, entry in found.entries.items()} == {
        "observation.state/shoulder_pan.pos": "q.shoulder_pan",
        "observation.state/elbow_flex.pos": "q.elbow_flex",
        "observation.current/shoulder_pan.pos": "tau.shoulder_pan",
        "observation.current/elbow_flex.pos": "tau.elbow_flex",
    }
    for recording in recordings:
        run = run_of(recording, found)
        np.testing.assert_allclose(run.channels["q.elbow_flex"].value, q[:, 1], atol=1e-6)
        np.testing.assert_allclose(run.channels["q.elbow_flex"].time, TIME, atol=1e-6)
        np.testing.assert_allclose(run.channels["tau.elbow_flex"].value, tau[:, 1], atol=1e-6)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "is empty"),
        ("a;b\n", "a header and no row"),
        ("a,b\n1,2\n3\n", "row 3 has 1 cells where the header has 2"),
        ("1,2\n3,4\n", "first row holds numbers"),
        ("a,b\nx,y\n", "no column holds numbers"),
    ],
)
def test_a_broken_table_says_what_is_wrong(text, says, tmp_path):
    path = tmp_path / "a.csv"
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        read_foreign(path)
    assert says in str(caught.value)


def test_time_that_goes_back_is_refused_and_repeated_rows_are_left_out(tmp_path):
    time = np.array([0.0, 0.1, 0.1, *np.arange(0.2, 2.0, 0.1)])
    path = tmp_path / "a.csv"
    for stamps, says in ((time, "1 rows with the time of the row before"), (time[::-1], "goes back")):
        np.savetxt(path, np.column_stack([stamps, np.sin(stamps)]), delimiter=",", header="time,load_force [N]",
                   comments="")  # fmt: skip
        (foreign,) = read_foreign(path)
        if says.startswith("1"):
            run = run_of(foreign, known_columns(foreign))
            assert len(run.channels["load_force"]) == len(time) - 1
            assert any(says in note for note in run.warnings)
        else:
            with pytest.raises(InputError, match=says):
                run_of(foreign, known_columns(foreign))


def test_of_three_columns_that_are_alike_the_first_is_taken_and_somebody_is_asked(tmp_path, joints):
    path = tmp_path / "a.csv"
    table = np.column_stack([TIME, *(k * joints[0][:, 0] for k in (1, 2, 3))])
    np.savetxt(path, table, delimiter=",", header="time,cart x [m],trolley x [m],carriage x [m]", comments="")
    ((column, entry),) = guess_map(read_foreign(path)).entries.items()
    assert (column, entry.channel) == ("cart x", "gripper_x")
    assert "CHECK: or is it 'trolley x'?" in entry.why
