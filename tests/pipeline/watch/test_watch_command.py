"""The command: recordings, lines on standard input, a page; and what it refuses."""

import io
import json
import signal
import socket
import struct
import subprocess
import sys
import urllib.error
import urllib.request
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from watch_work import model, samples, work

from armdyn.arm.model import arm_model
from armdyn.model_file import ModelFile, write_model_file
from armdyn.recording.channels import Channel
from armdyn.run import Run, write_run_csv
from armdyn.watch.channels import WatchedChannels
from armdyn.watch.fault_free import statistics_of_recordings
from armdyn.watch.watch import Watch
from pipeline.watch.log import SampleLog
from pipeline.watch.page import LivePage

CONTACT = np.array([2.0, 5.0, 1.0, 0.3, -0.8, 0.0])


def write(arm, recording, file):
    stamps, q, tau = recording
    channels = {f"q.{joint}": Channel(stamps, q[:, i], "rad") for i, joint in enumerate(arm.joints)}
    channels |= {f"tau.{joint}": Channel(stamps, tau[:, i], "N m") for i, joint in enumerate(arm.joints)}
    write_run_csv(Run(file.name, channels), file)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A model, sound recordings, a contact and a load."""
    arm, here = model(), tmp_path_factory.mktemp("work")
    write_model_file(here / "m.toml", ModelFile(arm, {"robot": "ur5"}))
    for k in range(3):
        write(arm, work(arm, 100 + k), here / f"sound_{k}.csv")
    (here / "day").mkdir()
    write(arm, work(arm, 0, 16.0, begin=10.0, until=11.0, outside=CONTACT), here / "day" / "a_contact.csv")
    write(arm, work(arm, 1, load=0.5, begin=20.0), here / "day" / "b_load.csv")
    write(arm, work(arm, 2, 16.0), here / "day" / "c_after.csv")
    return here


@pytest.fixture(scope="module")
def calibrated(folder):
    return [word for k in range(3) for word in ("--calibrate", str(folder / f"sound_{k}.csv"))]


def lines(text):
    return [json.loads(line) for line in text.splitlines()]


def test_a_folder_of_logs_becomes_a_line_per_event_and_says_what_to_do(folder, calibrated, armdyn, tmp_path):
    words = ("watch", folder / "m.toml", folder / "day", *calibrated, "--log", "kept.csv", "--json", "events.json")
    status, out, _ = armdyn(*words)
    assert status == 0
    found = lines((tmp_path / "events.json").read_text())
    assert {event["schema"] for event in found} == {"armdyn.watch/1"}
    end = found.pop()
    assert (end["event"], end["watched"]) == ("summary", pytest.approx(16 + 60 + 16, abs=4.0))
    assert end["skipped"] == sum(end["reasons"].values()) > 0
    by_run = {Path(event["run"]).name: event["event"] for event in found if event["event"] != "not_told"}
    assert by_run == {"a_contact.csv": "recovered", "b_load.csv": "load_changed"}
    assert {event["false_alarms_per_hour"] for event in found} == {0.01}
    assert "the tool carries +0." in out
    assert f"to repair the model from here on: armdyn repair {folder}/m.toml kept_2.csv" in out
    assert f"armdyn repair {folder}/m.toml {folder}/day/c_after.csv" in out
    rows = sum(len((tmp_path / name).read_text().splitlines()) - 1 for name in ("kept.csv", "kept_2.csv"))
    assert rows == 250 * (16 + 60 + 16)


def test_a_batch_with_sound_recordings_has_a_column_of_events(folder, armdyn, tmp_path):
    (folder / "lab.toml").write_text(
        'trust_data = true\n[[recordings]]\nmodel = "m.toml"\nruns = ["day/a_*.csv", "sound_0.csv"]\n'
        'calibrate = ["sound_*.csv"]\n'
    )
    assert armdyn("batch", folder / "lab.toml", "--output", "lab", "--workers", "1")[0] == 0
    touched, sound = pq.read_table(tmp_path / "lab" / "batch.parquet").to_pylist()
    assert any("something outside acts on the arm" in event for event in touched["events"])
    assert sound["events"] == []


def test_lines_of_standard_input_are_samples(folder, calibrated, armdyn, monkeypatch):
    text = (folder / "day" / "a_contact.csv").read_text().splitlines()
    text[100] = "what is this"
    text[200] = text[200].replace(text[200].split(",")[3], "", 1)
    monkeypatch.setattr("sys.stdin", io.StringIO("\n".join(text)))
    status, out, _ = armdyn("watch", folder / "m.toml", "-", *calibrated[:4], "--json", "-")
    assert status == 0
    *found, end = lines(out)
    assert [event["event"] for event in found][-2:] == ["outside_torque", "recovered"]
    assert end["reasons"].keys() == {"no time", "no position", SETTLING}


ARM = arm_model(robot="ur5").joints
HEADS = ["time [s]", *(f"q.{joint} [rad]" for joint in ARM), *(f"tau.{joint} [N m]" for joint in ARM)]
SETTLING = "filters settle after a start, a gap or a jump"


def table(heads=HEADS, *, step=0.004, count=1000, separator=",", cell=lambda _i, _k, value: repr(value), begin=0.0):
    """Lines of a robot that swings slowly, whose cells a function may change; the first column is the time."""
    rows = [
        separator.join(
            cell(i, k, value) for k, value in enumerate([begin + step * i, *[0.1 * float(np.sin(step * i))] * 12])
        )
        for i in range(count)
    ]
    return "\n".join([separator.join(heads), *rows, ""])


def without(*columns):
    return table([head for k, head in enumerate(HEADS) if k not in columns])


def said(text):
    """Cells that are this text: from column 1 on."""
    return lambda _, k, value: text if k else repr(value)


def only(columns, text):
    return lambda _, k, value: text if k in columns else repr(value)


NAMED = [head.replace("elbow", "ellbow") for head in HEADS]
DEAF = {
    "nothing": "", "blank lines": "\n\n\n", "heads alone": table(count=0), "one sample": table(count=1),
    "fewer samples than settle": table(count=100), "no words": "hello\n", "binary": "\x00\x01\x02\n",
    "torques nan": table(cell=only(range(7, 13), "nan")), "one torque nan": table(cell=only([9], "nan")),
    "positions nan": table(cell=only(range(1, 7), "nan")), "one position nan": table(cell=only([2], "nan")),
    "all nan": table(cell=said("nan")), "empty cells": table(cell=said("")), "text": table(cell=said("off")),
    "infinite": table(cell=said("inf")), "null": table(cell=said("null")), "no time": table(cell=only([0], "")),
    "time nan": table(cell=only([0], "nan")), "constant time": table(step=0.0), "falling time": table(step=-0.004),
    "ms as s": table(step=4.0), "us as s": table(step=4000.0), "ns as s": table(step=4e6, begin=1.7e18),
    "s as ms": table([HEADS[0].replace("[s]", "[ms]"), *HEADS[1:]]), "one sample a second": table(step=1.0),
    "two samples a second": table(step=0.5), "epoch of ms": table(step=4.0, begin=1.7e12),
    "wrong names": table(NAMED), "no torques": without(*range(7, 13)), "no positions": without(*range(1, 7)),
    "one joint left out": without(3, 9), "no heads": table().partition("\n")[2],
    "semicolons": table(separator=";"), "tabs": table(separator="\t"),
    "decimal commas": table(cell=lambda _i, _k, value: f"{value:.4f}".replace(".", ",")),
    "quoted commas": table(cell=lambda _i, _k, value: '"' + f"{value:.4f}".replace(".", ",") + '"'),
    "no units": table([head.partition(" ")[0] for head in HEADS]),
    "degrees as radians": table(cell=lambda i, k, value: repr(value * 5e4 * (-1) ** i) if 0 < k < 7 else repr(value)),
    "torques of 1e200": table(cell=only(range(7, 13), "1e200")), "a line without end": "0," * 2**20,
    "half the cells": table(cell=lambda _, k, value: repr(value) if k < 6 else "").replace(",,,,,,,", ""),
}  # fmt: skip
"""Forty ways to be deaf."""


@pytest.fixture(scope="module")
def own_error(tmp_path_factory):
    """A model that says its error, so that it needs no recordings."""
    arm, here = model(), tmp_path_factory.mktemp("deaf")
    history = ({"rmse": {f"tau.{joint}": 0.2 for joint in arm.joints}},)
    write_model_file(here / "m.toml", ModelFile(arm, {"robot": "ur5"}, history=history))
    return here / "m.toml"


@pytest.mark.parametrize("way", DEAF)
def test_who_hears_nothing_is_not_content(own_error, armdyn, monkeypatch, way):
    monkeypatch.setattr("sys.stdin", io.StringIO(DEAF[way]))
    status, out, told = armdyn("watch", own_error, "-")
    assert status in (1, 2)
    assert "Nothing happened" not in out
    assert ("Nothing was watched" in out) if status == 1 else ("armdyn:" in told)


def test_a_byte_order_mark_is_none_of_a_column(own_error, armdyn, monkeypatch):
    monkeypatch.setattr("sys.stdin", io.StringIO("\ufeff" + table()))
    assert armdyn("watch", own_error, "-")[0] == 0


def test_the_page_shows_residuals_with_their_limits_and_events(complains):
    arm = model()
    runs = [work(arm, seed) for seed in (100, 101)]
    watch = Watch(arm, statistics_of_recordings(arm, [lambda run=run: samples(run) for run in runs]), 0.01)
    with LivePage(watch, None) as page:
        for sample in samples(work(arm, 0, 16.0, begin=10.0, outside=CONTACT)):
            page.take(watch.process_sample(*sample))
        assert b"armdyn watch" in urllib.request.urlopen(page.address).read()
        state = json.loads(urllib.request.urlopen(page.address + "state").read())
        strange = urllib.request.Request(page.address + "state", headers={"Host": "elsewhere.example"})
        with complains(urllib.error.HTTPError):
            urllib.request.urlopen(strange)
    assert (state["channels"], state["units"]) == (list(arm.joints), ["N m"] * 6)
    assert state["state"].startswith("watching at 16.0 s; watched 15.")
    assert "outside_torque" in {event["event"] for event in state["events"]}
    stamp, residual, mean, limit = state["points"][-1]
    assert stamp > 15.0
    assert abs(residual[1] - mean[1]) > limit[1]


def test_the_page_stays_after_a_recording_and_says_nothing_of_closed_connections(folder, calibrated, tmp_path):
    words = ["watch", folder / "m.toml", folder / "day" / "c_after.csv", *calibrated, "--page", "--no-browser"]
    program = "from pipeline.cli import main; main()"
    running = subprocess.Popen(
        [sys.executable, "-W", "ignore", "-c", program, *map(str, words)], cwd=tmp_path, text=True,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    )  # fmt: skip
    try:
        assert running.stdout is not None
        said = next(line for line in running.stdout if "stays until Ctrl-C" in line)
        address = said.split()[0]
        for _ in range(3):
            with socket.create_connection(("127.0.0.1", int(address.split(":")[-1].strip("/")))) as rude:
                rude.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
                rude.sendall(b"GET /state HTTP/1.1\r\nHost: localhost:1\r\n\r\n")
        assert json.loads(urllib.request.urlopen(address + "state").read())["state"].startswith("ended; ")
        running.send_signal(signal.SIGINT)
        _, errors = running.communicate(timeout=30)
    finally:
        running.kill()
    assert (running.returncode, errors) == (0, "")


def test_what_it_cannot_watch_is_refused(folder, calibrated, refused, tmp_path, monkeypatch, complains):
    (tmp_path / "p.toml").write_text('base = "pendulum"\n')
    day, sound = folder / "day", folder / "sound_0.csv"
    for words in ((), ("-", "--ros", "ws://127.0.0.1:1"), (day,), (tmp_path,)):
        complains.line(refused("watch", folder / "m.toml", *words))
    complains.line(refused("watch", tmp_path / "p.toml", sound))
    monkeypatch.setattr("sys.stdin", io.StringIO("time [s],q.shoulder_pan_joint [rad]\n0,0\n"))
    said = refused("watch", folder / "m.toml", "-", *calibrated[:2], "--json", "-")
    assert "its first line has no q.shoulder_lift_joint" in said


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no such device here")
def test_a_full_disk_costs_the_log_and_not_the_watch(folder, calibrated, armdyn):
    words = ("watch", folder / "m.toml", folder / "day" / "a_contact.csv", *calibrated, "--log", "/dev/full")
    status, out, err = armdyn(*words)
    assert status == 2
    assert "something outside acts on the arm" in out
    assert err == (
        "armdyn: the watch went on to its end, but full could not be written any further: No space left on device; "
        "make room, or choose another place\n"
    )


def test_no_part_of_a_log_writes_over_a_file(tmp_path):
    (tmp_path / "day_2.csv").write_text("kept")
    log = SampleLog(tmp_path / "day.csv", WatchedChannels.of(arm_model(robot="ur5")))
    log.write((0.0, np.zeros(6), np.zeros(6)))
    assert len((tmp_path / "day.csv").read_text().splitlines()) == 2  # at once, in case the power fails
    log.next_file()
    log.close()
    assert log.file == tmp_path / "day_3.csv"
    assert (tmp_path / "day_2.csv").read_text() == "kept"
