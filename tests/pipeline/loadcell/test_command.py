import io
import json
import os
import signal
import sys
import time
import tomllib
from functools import partial

import numpy as np
import pytest

from pipeline.loadcell.calibration import Calibration
from pipeline.loadcell.cell import LoadCell
from pipeline.loadcell.emulator import EmulatedCell, EmulatedPort
from pipeline.loadcell.faults import LoadCellFault

from .cells import calibration

PATIENT = ["--silent-after", "30"]  # these tests run on busy machines


@pytest.fixture
def armdyn(armdyn, monkeypatch, tmp_path):
    """The command, with settings of its own."""
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "settings"))
    return partial(armdyn, "loadcell")


class Operator(io.TextIOBase):
    """Somebody who hangs the next weight and then presses Enter."""

    def __init__(self, cell, forces):
        self._cell, self._forces = cell, iter(forces)

    def readline(self, _size=-1):
        self._cell.set_force(next(self._forces))
        time.sleep(0.2)
        return "\n"


@pytest.fixture
def source():
    with EmulatedCell(np.random.default_rng(11), rate=400.0, scale=-7e-6) as cell:
        yield cell


def calibrated(armdyn, source, monkeypatch, forces, *options):
    monkeypatch.setattr(sys, "stdin", Operator(source, forces))
    return armdyn("calibrate", source.port, "--samples", 60, *options)


def test_a_person_calibrates_a_cell_and_monitors_it(armdyn, source, monkeypatch, tmp_path):
    status, out, err = calibrated(armdyn, source, monkeypatch, [0.0, 0.981, 1.962], "--json", tmp_path / "c.json")
    assert status == 0, err
    assert "Leave the cell empty" in err
    assert "Hang 200 g" in err
    file = tmp_path / "settings" / "armdyn" / "loadcell.toml"
    assert f"written to {file}" in out
    stored = tomllib.loads(file.read_text())
    for name, true in (("offset", source.offset), ("scale", source.scale)):
        assert abs(stored[name]["value"] - true) < 6 * stored[name]["std"]
    result = json.loads((tmp_path / "c.json").read_text())
    assert result["schema"] == "armdyn.loadcell_calibration/1"
    assert result["scale"] == stored["scale"]
    assert [weight["weight"] for weight in result["weights"]] == ["0 g", "100 g", "200 g"]

    source.set_force(0.5)
    status, out, _ = armdyn("monitor", source.port, "--seconds", 0.5, "--json", "-", *PATIENT)
    assert status == 0
    seen = json.loads(out)
    assert seen["schema"] == "armdyn.loadcell_monitor/1"
    assert seen["reliable"]
    assert seen["samples"] > 0
    assert seen["force"]["mean"] == pytest.approx(0.5, abs=2e-3)
    assert set(seen["faults"]) == {fault.name.lower() for fault in LoadCellFault}


@pytest.mark.parametrize(
    ("forces", "says"),
    [
        ([0.3, 0.3, 0.3], "was the weight changed"),
        ([0.0, 1.962, 0.981], "do not follow the weights"),
        ([0.0, 0.981, 3.0], "do not lie on a line"),
        ([0.0, 0.981, -1e3], "end of its range"),
    ],
)
def test_nonsense_is_refused_and_an_old_calibration_kept(armdyn, source, monkeypatch, tmp_path, forces, says):
    out_file = tmp_path / "old.toml"
    out_file.write_text("old")
    status, _, err = calibrated(armdyn, source, monkeypatch, forces, "--out", out_file)
    assert status == 1
    assert says in err.splitlines()[-1]
    assert out_file.read_text() == "old"


def test_a_cable_pulled_during_calibration_ends_it(armdyn, source, monkeypatch):
    class Clumsy(Operator):
        def readline(self, _size=-1):
            source.close()
            return "\n"

    monkeypatch.setattr(sys, "stdin", Clumsy(source, []))
    status, _, err = armdyn("calibrate", source.port)
    assert status == 1
    assert err.endswith(f"armdyn: load cell: {LoadCellFault.DISCONNECTED.value}\n")


@pytest.fixture
def at_reading(monkeypatch):
    """Has something happen when the cell is read for the fifth time."""

    def arrange(happen):
        read, calls = LoadCell.read, []

        def watched(cell):
            calls.append(cell)
            if len(calls) == 5:
                happen()
            return read(cell)

        monkeypatch.setattr(LoadCell, "read", watched)

    return arrange


def test_ctrl_c_ends_monitoring_in_the_usual_way_of_an_emulated_cell_that_was_calibrated(armdyn, at_reading, tmp_path):
    status, out, _ = armdyn("calibrate", "emulated", "--samples", 40, "--weights", "200 g", "--json", "-")
    assert status == 0
    file = tmp_path / "settings" / "armdyn" / "loadcell-emulated.toml"
    assert json.loads(out)["file"] == str(file)
    assert Calibration.load(file).source == "armdyn loadcell calibrate emulated: 0 g, 200 g; 40 samples each"
    at_reading(lambda: os.kill(os.getpid(), signal.SIGINT))
    status, _, _ = armdyn("monitor", "emulated", "--json", tmp_path / "m.json", *PATIENT)
    assert status == 0
    assert json.loads((tmp_path / "m.json").read_text())["samples"] > 0


def test_monitoring_ends_with_status_1_when_the_cable_is_pulled(armdyn, source, at_reading, tmp_path):
    at_reading(source.close)
    arguments = ["--calibration", write_calibration(tmp_path), "--json", tmp_path / "m.json"]
    status, _, err = armdyn("monitor", source.port, *arguments, *PATIENT)
    assert status == 1
    assert err == f"armdyn: {source.port}: {LoadCellFault.DISCONNECTED.value}\n"
    seen = json.loads((tmp_path / "m.json").read_text())
    assert seen["active"] == ["disconnected"]
    assert seen["events"][-1]["sentence"] == LoadCellFault.DISCONNECTED.value


def write_calibration(folder):
    calibration(84213.0, -7e-6, 2.8e-4).save(folder / "c.toml")
    return folder / "c.toml"


@pytest.mark.parametrize(
    "arguments",
    [
        ["monitor", "PORT"], ["monitor", "/dev/ttyNONE", "--calibration", "FILE"],
        ["monitor", "PORT", "--calibration", "FOREIGN"], ["monitor", "PORT", "--seconds", "0"], ["monitor"],
        ["calibrate", "/dev/ttyNONE"], ["calibrate", "PORT", "--weights", "heavy"],
        ["calibrate", "PORT", "--samples", "3"], ["calibrate", "PORT", "--baud", "0"],
    ],
)  # fmt: skip
def test_bad_input_is_one_line_and_status_2(armdyn, refused, tmp_path, arguments, complains):
    del armdyn  # which has settings of its own
    (tmp_path / "foreign.toml").write_text("name = 3")
    with EmulatedPort() as wire:
        places = {"PORT": wire.port, "FILE": write_calibration(tmp_path), "FOREIGN": tmp_path / "foreign.toml"}
        complains.line(refused("loadcell", *(places.get(argument, argument) for argument in arguments)))
