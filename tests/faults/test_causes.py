"""What had no words of its own, each as its class: paths that lead nowhere, pipes, dates, addresses, stamps."""

import os
import shutil
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parents[2] / "examples" / "pendulum"
BATCH = ("batch", "spec.toml", "--output", "out", "--workers", "1")


@pytest.fixture
def folder(armdyn, tmp_path):
    for ending in ("csv", "toml"):
        shutil.copy(EXAMPLES / f"swing_1.{ending}", tmp_path / f"a.{ending}")
    assert armdyn("new", "pendulum", "m.toml")[0] == 0
    return tmp_path


LOOP = "loop.csv"
FOR_LOOPS = [
    ("compare", "m.toml", LOOP), ("compare", LOOP, "a.csv"), ("inspect", LOOP), ("check", LOOP), ("view", LOOP),
    ("compare", "m.toml", "a.csv", "--effects", LOOP), ("export", LOOP, "--output", "m.py"),
    ("import", LOOP, "--output", "runs"),
    ("trial", "--model", LOOP), ("compare", "m.toml", "a.csv", "--json", LOOP),
]  # fmt: skip


@pytest.mark.parametrize("command", FOR_LOOPS, ids=lambda words: " ".join(words))
def test_links_in_a_circle_are_named(folder, refused, command, complains):
    (folder / LOOP).symlink_to("other.csv")
    (folder / "other.csv").symlink_to(LOOP)
    complains.line(refused(*command))


@pytest.mark.parametrize("form", ["%d%d", "%Y_%Y", "%Q", "%", "no letters", "(?P<a>%d%f%f"])
def test_a_form_that_no_date_has_is_refused(folder, refused, form, complains):
    recordings = '[[recordings]]\nmodel = "m.toml"\nruns = ["a.csv"]\n'
    (folder / "spec.toml").write_text(f'{recordings}[time]\nform = "{form}"\n')
    complains.line(refused(*BATCH))


@pytest.mark.parametrize("year", ["0001-01-01T00:00:00+14:00", "9999-12-31T23:59:59-12:00"])
def test_a_time_beyond_the_calendar_is_refused(folder, refused, year, complains):
    given = f'times = {{"a.csv" = {year}}}\n'
    (folder / "spec.toml").write_text(f'[[recordings]]\nmodel = "m.toml"\nruns = ["a.csv"]\n{given}')
    complains.line(refused(*BATCH))
    (folder / "a.toml").write_text(f"recorded = {year}\n")
    complains.line(refused("compare", "m.toml", "a.csv"))


def test_a_search_over_the_whole_disk_does_not_begin(folder, refused, monkeypatch, complains):
    monkeypatch.setattr("pipeline.batch.spec.MAX_BATCH_FILES", 20)
    for number in range(30):
        (folder / f"{number}.txt").touch()
    (folder / "spec.toml").write_text(f'[[recordings]]\nmodel = "m.toml"\nruns = ["{folder}/**/*.csv"]\n')
    complains.line(refused(*BATCH))


@pytest.mark.parametrize("address", ["ws://127.0.0.1:99999", "ws://127.0.0.1:-1", "ws://[::1", "ws://" + "a" * 300])
def test_an_address_that_is_none_is_refused(refused, address, complains):
    complains.line(refused("record", "--ros", address, "--output", "r.mcap"))


PIPES = [
    ("compare", "m.toml", "pipe"), ("inspect", "pipe"), ("import", "pipe", "--output", "runs"),
    ("compare", "pipe", "a.csv"),
    ("new", "arm", "q.toml", "--urdf", "pipe"), ("check", "pipe", "--robot", "ur5"), ("view", "pipe"),
    ("compare", "m.toml", "a.csv", "--effects", "pipe"),
]  # fmt: skip


@pytest.mark.parametrize("command", PIPES, ids=lambda words: " ".join(words))
def test_a_named_pipe_keeps_nobody_waiting(folder, refused, command):
    os.mkfifo(folder / "pipe")
    refused(*command)


@pytest.mark.parametrize("step", ["1e-322", "5e-324", "1e-300", "1e-12"])
@pytest.mark.parametrize("model", [(), ("m.toml",)])
def test_stamps_that_no_sensor_gives_are_said_by_inspect(folder, armdyn, step, model):
    rows = "\n".join(f"{i * float(step)!r},{0.1 * (-1) ** i},{0.01 * i}" for i in range(80))
    (folder / "b.csv").write_text(f"time [s],swing_angle [rad],gripper_x [m]\n{rows}\n")
    status, out, _ = armdyn("inspect", *model, "b.csv")
    assert status == 1
    assert "which no sensor does" in out
