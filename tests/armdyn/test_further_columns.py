"""Further columns of a recording, `extra.<name>`: read in any unit, kept by every format, refused in one line."""

import json
from pathlib import Path

import numpy as np
import pyarrow
import pytest

from armdyn.errors import InputError
from armdyn.run import Channel, Run, read_run, write_run_csv
from pipeline.record import Recorder

TIME = np.arange(50) / 100
ANGLE = 0.3 * np.sin(5.0 * TIME)


def write(folder: Path, column: str, cells: list[str]) -> Path:
    path = folder / "swing.csv"
    rows = (f"{t:.2f},{a:.6f},{cell}" for t, a, cell in zip(TIME, ANGLE, cells, strict=True))
    path.write_text("\n".join([f"time [s],swing_angle [rad],{column}", *rows]) + "\n", encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("unit", "si", "value"),
    [
        ("degC", "K", 294.15), ("K", "K", 21.0), ("1", "1", 21.0), ("percent", "1", 0.21), ("rpm", "rad/s", 2.199115),
        ("bar", "kg/m/s^2", 2.1e6), ("V", "V", 21.0),
    ],
)  # fmt: skip
def test_a_further_column_is_read_in_si_units_and_an_si_unit_keeps_its_name(tmp_path, unit, si, value):
    run = read_run(write(tmp_path, f"extra.quantity [{unit}]", ["21"] * 50))
    assert list(run.channels) == ["swing_angle"]
    assert run.extra["extra.quantity"].unit == si
    np.testing.assert_allclose(run.extra["extra.quantity"].value, value, rtol=1e-6)


def test_csv_gives_back_what_was_written(tmp_path):
    run = read_run(
        write(tmp_path, "extra.température [degC]", [f"{20 + t}" if i % 7 else "" for i, t in enumerate(TIME)])
    )
    write_run_csv(run, tmp_path / "again.csv")
    again = read_run(tmp_path / "again.csv")
    before, after = (r.extra["extra.température"] for r in (run, again))
    assert len(before) == 42
    np.testing.assert_array_equal(before.time, after.time)
    np.testing.assert_array_equal(before.value, after.value)


def test_mcap_gives_back_what_was_recorded(tmp_path):
    with Recorder(tmp_path / "run.mcap", {"swing_angle": "rad", "extra.temperature": "K"}) as recorder:
        for i, (t, a) in enumerate(zip(TIME, ANGLE, strict=True)):
            recorder.record("swing_angle", t, a)
            if i % 10 == 0:
                recorder.record("extra.temperature", t + 0.003, 290.0 + t)
    for name in ("run.mcap", "run.csv"):
        run = read_run(tmp_path / name)
        assert list(run.channels) == ["swing_angle"]
        np.testing.assert_array_equal(run.extra["extra.temperature"].value, 290.0 + TIME[::10])


def test_arrays_and_frames_hold_further_columns(complains):
    values = {"swing_angle": ANGLE, "extra.temperature [degC]": 20.0 + TIME, "extra.valve": TIME}
    run = Run.from_arrays(TIME, values, units={"extra.valve": "percent"})
    np.testing.assert_allclose(run.extra["extra.temperature"].value, 293.15 + TIME)
    frame = {"time": TIME, "swing_angle": ANGLE, "extra.temperature [degC]": 20.0 + TIME}
    assert Run.from_dataframe(frame).extra["extra.temperature"].unit == "K"
    with complains(InputError):
        Run.from_arrays(TIME, {"swing_angle": ANGLE, "extra.temperature": TIME})


def test_a_mapping_makes_a_further_column_of_any_other(armdyn):
    rows = (f"{t:.2f},{a:.6f},{20 + t}" for t, a in zip(TIME, ANGLE, strict=True))
    Path("log.csv").write_text("\n".join(["t,phi,oil", *rows]) + "\n")
    Path("map.toml").write_text(
        'time = { column = "t", unit = "s" }\n[columns]\nphi = { channel = "swing_angle", unit = "rad" }\n'
        'oil = { channel = "extra.oil", unit = "degC" }\n'
    )
    assert armdyn("import", "log.csv", "--output", "runs", "--map", "map.toml")[0] == 0
    np.testing.assert_allclose(read_run("runs/log.csv").extra["extra.oil"].value, 293.15 + TIME)


@pytest.mark.parametrize(
    ("column", "cells"),
    [
        ("extra. [K]", "21"), ("extra [K]", "21"), ("extra.my oil [K]", "21"), ("extra.temperature", "21"),
        ("extra.temperature []", "21"), ("extra.temperature [warm]", "21"), ("extra.loudness [dB]", "21"),
        ("extra.temperature [K]", "nan"), ("extra.temperature [K]", "1e300"), ("extra.temperature [K]", "hot"),
        ("temprature [K]", "21"), ("exta.temperature [K]", "21"), ("swing_angle [rad]", "21"),
    ],
)  # fmt: skip
def test_what_cannot_be_used_is_one_line(refused, tmp_path, column, cells, complains):
    complains.line(refused("inspect", write(tmp_path, column, [cells] * 50)))


def test_a_recording_of_further_columns_alone_may_belong_to_a_base_of_ones_own(tmp_path, complains):
    path = tmp_path / "alone.csv"
    path.write_text("\n".join(["time [s],extra.temperature [K]", *(f"{t},290" for t in TIME)]))
    assert not read_run(path).channels
    path.write_text("\n".join(["time [s]", *map(str, TIME)]))
    with complains(InputError):
        read_run(path)


def test_a_slow_sensor_beside_a_fast_one_does_no_harm(armdyn, tmp_path):
    """One number a second with steps of 0.5 K: no gap, no glitch, no counts that were lost."""
    time = np.arange(2000) / 100
    run = Run.from_arrays(time, {"swing_angle": 0.3 * np.sin(5.0 * time)}, noise={"swing_angle": 1e-3})
    slow = Channel(np.arange(0.0, 20.0, 1.0), 293.0 + np.round(np.arange(20) / 5.0) / 2.0, "K")
    with_it = Run("a.csv", {**run.channels, "extra.temperature": slow}, {}, run.noise)
    for name, one in (("a.csv", run), ("b.csv", with_it)):
        write_run_csv(one, tmp_path / name)
    answers = [json.loads(armdyn("inspect", name, "--json", "-")[1]) for name in ("a.csv", "b.csv")]
    kinds = [[check["kind"] for check in answer["recording_checks"]] for answer in answers]
    assert kinds[0] == kinds[1]


ROWS = np.arange(20) * 0.01
ANGLES = np.outer(np.linspace(-90.0, 90.0, 20), [1.0, 0.5])


def test_degrees_of_two_joints_become_radians():
    run = Run.from_arrays(ROWS, {"q": ANGLES, "tau.b": ANGLES[:, 0]}, joints=["a", "b"], units={"q": "deg"})
    assert run.joints == ("a", "b")
    np.testing.assert_allclose(run.channels["q.b"].value, np.deg2rad(ANGLES[:, 1]))
    assert run.channels["q.b"].unit == "rad"
    assert run.channels["tau.b"].unit == "N m"


def test_a_unit_in_the_name_counts_and_missing_samples_are_left_out():
    force = np.full(20, 800.0)
    force[3] = np.nan
    channel = Run.from_arrays(ROWS, {"load_force [mN]": force}).channels["load_force"]
    assert len(channel) == 19
    assert channel.value == pytest.approx(np.full(19, 0.8))
    assert ROWS[3] not in channel.time


def test_every_problem_is_told_at_once():
    with pytest.raises(InputError) as caught:
        Run.from_arrays(
            ROWS[::-1],
            {"q": ANGLES, "load_forc": ROWS, "swing_angle": ROWS[:5], "swing_rate": ["a"] * 20, "gripper_x [kg]": ROWS},
            joints=["a"],
            units={"tau": "N m"},
        )
    message = str(caught.value)
    assert message.startswith("7 problems: (1) ")
    for part in (
        "time does not increase at sample 1",
        "'q' has shape (20, 2)",
        "did you mean 'load_force'",
        "'swing_angle': has shape (5,)",
        "'swing_rate' does not hold numbers",
        "'kg' is of another kind",
        "a unit is given for 'tau'",
    ):
        assert part in message


class Frame:
    """The part of a data frame that is used: pandas', polars' and pyarrow's are alike in it."""

    def __init__(self, columns, index=None):
        self._columns, self.columns = columns, list(columns)
        if index is not None:
            self.index = index

    def __getitem__(self, name):
        return self._columns[name]


def test_a_data_frame_has_its_time_in_a_column():
    run = Run.from_dataframe(Frame({"time [ms]": 1e3 * ROWS, "q.a [deg]": ANGLES[:, 0]}), name="a")
    np.testing.assert_allclose(run.channels["q.a"].time, ROWS)
    assert run.name == "a"


def test_a_data_frame_may_have_its_time_in_the_index():
    dates = np.datetime64("2026-01-01T12:00:00") + (ROWS * 1e9).astype("timedelta64[ns]")
    run = Run.from_dataframe(Frame({"q.a": ANGLES[:, 0] / 100}, index=dates))
    np.testing.assert_allclose(run.channels["q.a"].time, ROWS, atol=1e-9)


def test_an_arrow_table_is_a_data_frame():
    run = Run.from_dataframe(pyarrow.table({"time": ROWS, "load_force": ROWS}))
    np.testing.assert_array_equal(run.channels["load_force"].value, ROWS)


def test_a_frame_without_time_says_so(complains):
    with complains(InputError):
        Run.from_dataframe(Frame({"q.a": ROWS}))
