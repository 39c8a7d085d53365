"""CSV of any dialect, Parquet and LeRobot's data sets; mappings that say every problem; guesses that fit."""

import json

import numpy as np
import pyarrow
import pytest
from pyarrow import parquet

from armdyn.errors import InputError
from pipeline.imports import read_foreign
from pipeline.imports.conversion import run_from_recording
from pipeline.imports.guess import guess_map, map_unambiguous_columns
from pipeline.imports.mapping import read_map

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
    return read_map(path)[""]


def test_a_mapping_makes_a_run_of_a_spreadsheet_with_what_goes_beside_it(german, tmp_path, joints):
    (foreign,) = read_foreign(german)
    run = run_from_recording(foreign, mapped(tmp_path, MAP)).run
    q, _, tau = joints
    np.testing.assert_allclose(run.channels["q.elbow"].value, np.pi / 2 - q[:, 1], atol=1e-7)
    np.testing.assert_allclose(run.channels["tau.shoulder"].value, tau[:, 0], atol=1e-5)
    np.testing.assert_allclose(run.channels["q.shoulder"].time, TIME, atol=1e-6)
    assert run.known["mass"].value == pytest.approx(0.08)
    assert run.description == "tested"
    assert any("'Kommentar' holds text" in note for note in run.warnings)


PROBLEMS = {
    "of the file": (
        """tme = "t"
    [columns]
    "a" = { channel = "q.elbow", unit = "deg", sign = 2 }
    "b" = { channel = "torque.elbow" }
    "c" = { channel = "q.wrist", gear_ratio = 0, unti = "deg" }
    "d" = "q.hand"
    """,
        ("'tme'", "'a': sign = 2", "'b': unknown channel", "'c': unknown key 'unti'", "gear_ratio = 0", "'d'"),
    ),
    "of its columns": (
        """time = { column = "Zeit_ms", unit = "N" }
    [columns]
    "J1 Poss" = { channel = "q.shoulder", unit = "deg" }
    "J2 Pos" = { channel = "q.elbow", unit = "kg" }
    "J1 Vel" = { channel = "v.shoulder" }
    "J1 Cur" = { channel = "tau.shoulder" }
    "J2 Cur" = { channel = "tau.shoulder", torque_constant = "1 N m/A" }
    """,
        ("'Zeit_ms': 'N' is of another kind", "unknown column 'J1 Poss': did you mean 'J1 Pos'?",
         "'J2 Pos': 'kg' is of another kind", "'J1 Vel': its unit is not known",
         "'J1 Cur': is a current: add torque_constant", "both tau.shoulder"),
    ),
}  # fmt: skip


@pytest.mark.parametrize(("text", "parts"), PROBLEMS.values(), ids=PROBLEMS)
def test_every_problem_of_a_mapping_is_told_at_once(german, tmp_path, text, parts):
    (foreign,) = read_foreign(german)
    with pytest.raises(InputError) as caught:
        run_from_recording(foreign, mapped(tmp_path, text))
    assert [part for part in ("6 problems", *parts) if part not in str(caught.value)] == []


def test_a_parquet_file_holds_channels_dates_and_lists(tmp_path, joints, complains):
    path = tmp_path / "a.parquet"
    stamps = np.datetime64("2026-01-01") + (TIME * 1e9).astype("timedelta64[ns]")
    lists = [list(row) if i != 7 else None for i, row in enumerate(joints[0])]
    table = {"time": stamps, "q.a [deg]": np.rad2deg(joints[0][:, 0]), "both": lists, "says": ["x"] * len(TIME)}
    parquet.write_table(pyarrow.table(table), path)
    (foreign,) = read_foreign(path)
    assert list(foreign.columns) == ["time", "q.a", "both/0", "both/1"]
    assert foreign.notes == ("'says' holds no numbers: left out",)
    np.testing.assert_array_equal(
        foreign.columns["both/1"].value, np.where(np.arange(300) == 7, np.nan, joints[0][:, 1])
    )
    run = run_from_recording(foreign, map_unambiguous_columns(foreign)).run
    np.testing.assert_allclose(run.channels["q.a"].value, joints[0][:, 0])
    np.testing.assert_allclose(run.channels["q.a"].time, TIME, atol=1e-9)
    parquet.write_table(pyarrow.table(table)[:0], path)
    with complains(InputError):
        read_foreign(path)


@pytest.mark.parametrize(("version", "stamped"), [(2, True), (3, True), (3, False)])
def test_episodes_of_a_lerobot_data_set(version, stamped, tmp_path, joints):
    """Positions in degrees under LeRobot's names, currents as a feature; two episodes, with stamps or frames."""
    q, _, tau = joints
    names, two = ["shoulder_pan.pos", "elbow_flex.pos"], lambda values: [list(row) for row in np.tile(values, (2, 1))]
    rows = pyarrow.table(
        {
            "observation.state": two(np.rad2deg(q)), "observation.current": two(tau), "action": two(0 * q),
            **({"timestamp": np.tile(TIME, 2).astype(np.float32)} if stamped else {}),
            "frame_index": np.tile(np.arange(300), 2), "episode_index": np.repeat([0, 1], 300),
            "task_index": np.zeros(600, int),
        }
    )  # fmt: skip
    features = {f: {"dtype": "float32", "shape": [2], "names": names} for f in rows.column_names[:3]}
    features["observation.current"]["names"] = {"motors": names}
    data = tmp_path / "data/chunk-000"
    data.mkdir(parents=True)
    (tmp_path / "meta").mkdir()
    (tmp_path / "meta/info.json").write_text(json.dumps({"fps": 100, "features": features}))
    if version == 3:
        parquet.write_table(rows, data / "file-000.parquet")
    else:
        for i in range(2):
            parquet.write_table(rows.slice(300 * i, 300), data / f"episode_{i:06d}.parquet")
    recordings = read_foreign(tmp_path)
    assert [r.name for r in recordings] == [f"{tmp_path.name}_episode_{i:06d}" for i in range(2)]
    assert set(recordings[0].columns) == {"timestamp", *(f"{f}/{n}" for f in features for n in names)}
    found = guess_map(recordings)
    assert {name: entry.channel for name, entry in found.entries.items()} == {
        f"observation.{feature}/{name}": f"{quantity}.{name[:-4]}"
        for feature, quantity in (("state", "q"), ("current", "tau")) for name in names
    }  # fmt: skip
    for recording in recordings:
        run = run_from_recording(recording, found).run
        np.testing.assert_allclose(run.channels["q.elbow_flex"].value, q[:, 1], atol=1e-6)
        np.testing.assert_allclose(run.channels["q.elbow_flex"].time, TIME, atol=1e-6)
        np.testing.assert_allclose(run.channels["tau.elbow_flex"].value, tau[:, 1], atol=1e-6)


@pytest.mark.parametrize(
    ("names", "said"),
    [
        (["a.pos"], "has 2 values of a frame"), (["a.pos", "b.pos", "c.pos"], "names 3"), (["a.pos", "a.pos"], "twice"),
        ({"motors": ["a.pos"]}, "names 1"),
    ],
)  # fmt: skip
def test_a_lerobot_data_set_whose_names_are_not_those_of_its_values(names, said, tmp_path, joints, complains):
    (tmp_path / "data").mkdir()
    (tmp_path / "meta").mkdir()
    feature = {"dtype": "float32", "shape": [2], "names": names}
    (tmp_path / "meta/info.json").write_text(json.dumps({"fps": 100, "features": {"observation.state": feature}}))
    rows = {
        "observation.state": [list(row) for row in joints[0]],
        "frame_index": range(300),
        "episode_index": [0] * 300,
    }
    parquet.write_table(pyarrow.table(rows), tmp_path / "data/file.parquet")
    with complains(InputError) as caught:
        read_foreign(tmp_path)
    assert said in str(caught.value)
    del rows["observation.state"]
    parquet.write_table(pyarrow.table(rows), tmp_path / "data/file.parquet")
    with complains(InputError) as caught:
        read_foreign(tmp_path)
    assert "observation.state has no values of a frame" in str(caught.value)


BACK = "time,load_force [N]\n" + "".join(f"{20 - i},{i}\n" for i in range(20))
BROKEN = ["", "a;b\n", "a,b\n1,2\n3\n", "a,b\nx,y\n", "a,b\n1,2\n3,4..5\n5,6\n", "a,b\n1,2\n3,1e300\n", BACK]


@pytest.mark.parametrize("text", BROKEN, ids=range(len(BROKEN)))
def test_a_broken_table_says_what_is_wrong(text, tmp_path, complains):
    (tmp_path / "a.csv").write_text(text)
    with complains(InputError):
        _ = [
            run_from_recording(foreign, map_unambiguous_columns(foreign))
            for foreign in read_foreign(tmp_path / "a.csv")
        ]


def test_words_among_numbers_are_missing_and_columns_of_text_are_told(tmp_path):
    rows = [f"{0.1 * i:.1f};{i},5;{'no signal' if i < 3 else i};elbow" for i in range(20)]
    path = tmp_path / "a.csv"
    path.write_text("\n".join(["t;pos (deg);pos (deg);name", *rows]))
    (foreign,) = read_foreign(path)
    assert list(foreign.columns) == ["t", "pos", "pos#3"]
    assert foreign.columns["pos"].unit == "deg"
    np.testing.assert_array_equal(foreign.columns["pos"].value, np.arange(20) + 0.5)
    np.testing.assert_array_equal(foreign.columns["pos#3"].value, [*[np.nan] * 3, *range(3, 20)])
    assert foreign.texts == {"name": "elbow"}
    assert foreign.notes == (
        "'pos' stands in the header again: that column is called 'pos#3'",
        "'pos#3': 3 cells are not numbers ('no signal', 'no signal', 'no signal'): taken as missing",
        "'name' holds text, such as 'elbow': left out",
    )
