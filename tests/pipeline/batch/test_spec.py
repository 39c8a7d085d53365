"""What a SPEC names is found, and what is wrong with it is said in one line."""

from datetime import datetime
from pathlib import Path

import pytest

from armdyn.errors import InputError
from pipeline.batch.spec import read_spec
from pipeline.batch.times import RecordingTimeRules, RecordingTimeSource

GOOD = '[[recordings]]\nmodel = "m.toml"\nruns = ["*.csv"]\n'


@pytest.fixture
def folder(tmp_path):
    for robot in ("left", "right[2]"):
        (tmp_path / "robots" / robot).mkdir(parents=True)
        (tmp_path / "robots" / robot / "model.toml").write_text("")
        for day in (4, 5):
            (tmp_path / "robots" / robot / f"log_2026-05-0{day}.csv").write_text("")
    (tmp_path / "m.toml").write_text("")
    (tmp_path / "a.csv").write_text("")
    (tmp_path / "a.toml").write_text("recorded = 2026-06-01")
    return tmp_path


def read(folder, text):
    (folder / "spec.toml").write_text(text)
    return read_spec(folder / "spec.toml")


def test_a_robots_folder_joins_its_model_and_its_logs(folder):
    spec = read(folder, '[[recordings]]\nmodel = "robots/{robot}/model.toml"\nruns = "robots/{robot}/*.csv"\n')
    assert [
        (item.robot, item.model.parent.name, item.run.parent.name, item.recording_time.time.day) for item in spec.items
    ] == [(robot, robot, robot, day) for robot in ("left", "right[2]") for day in (4, 5)]
    assert spec.task == "compare"


def test_every_model_meets_every_recording_once_also_one_that_is_missing(folder):
    text = '[[recordings]]\nmodel = "robots/*/model.toml"\nruns = ["a.csv", "*.csv", "gone.csv"]\n'
    assert [item.run.name for item in read(folder, text).items] == ["a.csv", "gone.csv"] * 2


@pytest.mark.parametrize(
    "text",
    [
        "", "recordings = 3", "[[recordings]]\nmodell = 'm.toml'", "[[recordings]]\nmodel = 'm.toml'",
        GOOD.replace("m.toml", "n.toml"), GOOD.replace("m.toml", "n*.toml"), GOOD.replace("*.csv", "*.mcap"),
        GOOD.replace('["*.csv"]', "[3]"), GOOD.replace("*.csv", "{robot}.csv"), f"task = 'repare'\n{GOOD}",
        f"taks = 'repair'\n{GOOD}", f"[changes]\nfalse_alarms = 2\n{GOOD}",
        f"[changes]\nfalse_alarms = true\n{GOOD}", f"[time]\nfrom = 'file'\n{GOOD}",
        f"[time]\nform = 'log'\n{GOOD}", f"time = 3\n{GOOD}", GOOD + "times = { 'b.csv' = 2026-05-04 }",
        GOOD + "times = { 'a.csv' = 5 }", "[[recordings]",
    ],
)  # fmt: skip
def test_a_wrong_spec_is_refused_in_one_line(folder, text, complains):
    with complains(InputError):
        read(folder, text)


def when(name, clock=None, given=()):
    return (clock or RecordingTimeRules()).find_time(Path("/lab") / name, Path("/lab"), dict(given))


@pytest.mark.parametrize(
    ("name", "time"),
    [
        ("log_2026-05-04.csv", datetime(2026, 5, 4)),
        ("2026_05_04_run7.mcap", datetime(2026, 5, 4)),
        ("run7-20260504T143005.csv", datetime(2026, 5, 4, 14, 30, 5)),
        ("2026-05-04-14-30-05.csv", datetime(2026, 5, 4, 14, 30, 5)),
        ("rosbag2_2026_05_04-14_30_05_0.csv", datetime(2026, 5, 4, 14, 30, 5)),
        ("2026-05-04 14.30.csv", datetime(2026, 5, 4, 14, 30)),
        ("2026-05-04/run_3.csv", datetime(2026, 5, 4)),
        ("2026-05-04/run_2026-05-05.csv", datetime(2026, 5, 5)),
    ],
)
def test_a_date_in_the_name_is_read(name, time):
    assert (when(name).time, when(name).source) == (time, RecordingTimeSource.NAME)


UNDATED = ["run_7.csv", "serial_12345678.csv", "04-05-2026.csv", "2026-13-45.csv", "202605041.csv", "2026-05.csv"]


@pytest.mark.parametrize(
    ("name", "says"), [*((name, "no time in") for name in UNDATED), ("2026-05-04_to_2026-05-09.csv", "several dates")]
)
def test_what_is_no_date_or_could_be_two_is_not_guessed(name, says):
    assert when(name).time is None
    assert says in when(name).problem


def test_a_form_reads_other_dates_and_says_where_it_fails():
    clock = RecordingTimeRules(date_format="log_%d%m%y_%H%M")
    assert when("log_040526_1430.csv", clock).time == datetime(2026, 5, 4, 14, 30)
    assert "not of the form log_%d%m%y_%H%M" in when("log_4.csv", clock).problem


def test_the_spec_counts_more_than_the_sidecar_and_that_more_than_the_name(folder):
    (item,) = read(folder, GOOD).items
    assert (item.recording_time.time, item.recording_time.source) == (datetime(2026, 6, 1), RecordingTimeSource.SIDECAR)
    (item,) = read(folder, GOOD + "times = { 'a.csv' = 2026-05-04T12:00:00+02:00 }").items
    assert (item.recording_time.time, item.recording_time.source) == (
        datetime(2026, 5, 4, 10),
        RecordingTimeSource.SPEC,
    )
    (item,) = read(folder, '[time]\nfrom = "name"\n' + GOOD).items
    assert item.recording_time.time is None
