"""Cells that hold lists, as LeRobot's data sets, rosbag scripts and numpy write them to CSV."""

import json
from pathlib import Path

import numpy as np
import pyarrow
import pytest
from pyarrow import parquet

from armdyn.errors import InputError
from armdyn.run import read_run
from pipeline.imports import read_foreign
from pipeline.imports.conversion import run_from_recording
from pipeline.imports.guess import guess_map, map_unambiguous_columns
from pipeline.imports.joints import JointRange, RobotJoints

from .conftest import JOINTS, TIME, motion

ROBOT = RobotJoints(JOINTS, ranges={joint: JointRange(False, 3.0, 50.0) for joint in JOINTS})
WRITTEN = {
    "JSON": lambda row: f'"{json.dumps(row.tolist())}"',
    "numpy": lambda row: f"[{row[0]} {row[1]}]",
    "numpy, over two lines": lambda row: f'"[ {row[0]}\n {row[1]}]"',
    "semicolons": lambda row: f"[{row[0]};{row[1]}]",
    "not in quotes": lambda row: f"[{row[0]}, {row[1]}]",
    "Python's array": lambda row: f"\"array('d', {row.tolist()})\"",
    "numpy's repr": lambda row: f'"array({row.tolist()}, dtype=float32)"',
    "a tuple": lambda row: f'"({row[0]}, {row[1]})"',
}


def table(path, header, *columns):
    path.write_text(
        "\n".join([header, *(f"{t:.2f},{','.join(cells)}" for t, *cells in zip(TIME, *columns, strict=True))]) + "\n"
    )
    (foreign,) = read_foreign(path)
    return foreign


@pytest.mark.parametrize("way", WRITTEN)
def test_a_list_in_a_cell_is_a_column_for_each_joint(way, tmp_path):
    q, told = motion()[0], motion()[0] + 0.1
    lists = [[WRITTEN[way](row) for row in x] for x in (np.rad2deg(q), np.rad2deg(told))]
    foreign = table(tmp_path / "a.csv", "time,q [deg],q_cmd [deg]", *lists)
    run = run_from_recording(foreign, map_unambiguous_columns(foreign, ROBOT)).run
    for i, joint in enumerate(JOINTS):
        np.testing.assert_allclose(run.channels[f"q.{joint}"].value, q[:, i], atol=1e-12)
        np.testing.assert_allclose(run.channels[f"q_cmd.{joint}"].value, told[:, i], atol=1e-12)


def test_states_and_actions_of_a_lerobot_table_are_positions_and_commands_whose_unit_is_asked(tmp_path):
    q = np.rad2deg(motion()[0])
    lists = [[f'"{row.tolist()}"' for row in x] for x in (q, q + 2.0)]
    found = guess_map([table(tmp_path / "a.csv", "timestamp,observation.state,action", *lists)], ROBOT)
    assert {name: entry.channel for name, entry in found.entries.items()} == {
        f"{column}/{i}": f"{kind}.{joint}"
        for column, kind in (("observation.state", "q"), ("action", "q_cmd"))
        for i, joint in enumerate(JOINTS)
    }
    assert {entry.check for entry in found.entries.values()} == {"degrees, radians or a share of the joint's range?"}


@pytest.mark.parametrize("counts", [4096, 4095])
def test_positions_in_steps_of_a_servos_encoder_are_degrees_without_a_question(counts, tmp_path):
    step = 360.0 / counts
    q = step * np.round(np.rad2deg(motion()[0]) / step)
    shares = 200.0 / 1713 * np.round(np.rad2deg(motion()[0]) * 1713 / 200.0)  # of a range of 1713 counts
    for values, asks in ((q, False), (shares, True)):
        lists = [[f'"{row.tolist()}"' for row in x] for x in (values, values + 2.0)]
        found = guess_map([table(tmp_path / "a.csv", "timestamp,observation.state,action", *lists)], ROBOT)
        assert {entry.unit for entry in found.entries.values()} == {"deg"}
        assert {bool(entry.check) for entry in found.entries.values()} == {asks}


def test_a_column_of_names_says_which_joint_an_entry_is_in_any_order(tmp_path):
    """Two drivers take turns, as on a topic of joint states: each writes its own joints, in its own order."""
    q = motion()[0]
    names = [["elbow", "shoulder"] if i % 2 else ["hand", "shoulder"] for i in range(len(TIME))]
    values = [[q[i, 1] if i % 2 else 0.5, q[i, 0]] for i in range(len(TIME))]
    columns = [[f'"{row}"' for row in names], [f'"{row}"' for row in values], ["[]"] * len(TIME)]
    foreign = table(tmp_path / "a.csv", "time,name,position,effort", *columns)
    assert list(foreign.columns) == ["time", "position/hand", "position/shoulder", "position/elbow"]
    assert "'effort' holds empty lists: left out" in foreign.notes
    run = run_from_recording(foreign, guess_map([foreign], ROBOT)).run
    np.testing.assert_allclose(run.channels["q.shoulder"].value, q[:, 0], atol=1e-12)
    np.testing.assert_allclose(run.channels["q.elbow"].value, q[1::2, 1], atol=1e-12)
    np.testing.assert_allclose(run.channels["q.elbow"].time, TIME[1::2], atol=1e-12)


def test_an_empty_cell_and_a_nan_are_missing_samples(tmp_path):
    cells = [f'"[{t}, {2 * t}]"' for t in TIME]
    cells[3], cells[5], cells[7] = "", '"[NaN, 0.1]"', '"[0.07, null]"'
    foreign = table(tmp_path / "a.csv", "time,q [rad]", cells)
    assert np.flatnonzero(np.isnan(foreign.columns["q.0"].value)).tolist() == [3, 5]
    assert np.flatnonzero(np.isnan(foreign.columns["q.1"].value)).tolist() == [3, 7]


WRONG = {"ragged": '"[0.1, 0.2, 0.3]"', "text": '"[0.1, open]"', "no list": "stopped", "too small": "[]x"}


@pytest.mark.parametrize("kind", WRONG)
def test_a_list_that_is_not_like_the_others_is_one_line_with_its_row(kind, tmp_path, complains):
    cells = [f'"[{t}, {2 * t}]"' for t in TIME]
    cells[40] = WRONG[kind]
    with complains(InputError):
        table(tmp_path / "a.csv", "time,q [rad]", cells)


def test_lists_in_parquet_are_called_by_the_names_beside_them(tmp_path):
    q, path = motion()[0], tmp_path / "a.parquet"
    rows = {"time": TIME, "name": [list(JOINTS)] * len(TIME), "position": [list(row) for row in q]}
    rows["effort"] = [[0.0] * (i % 3) for i in range(len(TIME))]
    parquet.write_table(pyarrow.table(rows), path)
    (foreign,) = read_foreign(path)
    assert list(foreign.columns) == ["time", *(f"position/{joint}" for joint in JOINTS)]
    assert "'effort' holds lists of numbers of different lengths: left out" in foreign.notes
    np.testing.assert_array_equal(foreign.columns["position/elbow"].value, q[:, 1])


@pytest.mark.parametrize("name", ["a\x07b", "a" * 300, "new in every row"])
def test_names_that_no_joint_has_are_refused(name, tmp_path, complains):
    rows = [f"{0.01 * i:.2f},\"['{name + str(i) * name.startswith('new')}']\",[{i}]" for i in range(2500)]
    path = tmp_path / "a.csv"
    path.write_text("\n".join(["time,name,position", *rows]) + "\n", encoding="utf-8")
    with complains(InputError):
        read_foreign(path)


def test_lists_are_imported_by_the_command(armdyn, refused, complains):
    rows = [f'{t:.2f},"[{t}, {2 * t}]"' for t in TIME]
    log = Path("log.csv")
    log.write_text("\n".join(["t,q [rad]", *rows]) + "\n", encoding="utf-8")
    status, out, _ = armdyn("import", "log.csv", "--output", "runs")
    assert status == 0
    assert "'q' holds lists: 'q.0' to 'q.1'" in out
    np.testing.assert_allclose(read_run("runs/log.csv").channels["q.1"].value, 2 * TIME)
    log.write_text(log.read_text(encoding="utf-8") + '3.00,"[1.0]"\n', encoding="utf-8")
    complains.line(refused("import", "log.csv", "--output", "runs", "--force"))
