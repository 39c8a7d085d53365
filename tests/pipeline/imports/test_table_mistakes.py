"""Tables, MATLAB's arrays and sheets with mistakes of every kind: the run, or a question, or one line."""

import zipfile
from datetime import datetime, timedelta

import numpy as np
import pytest
from scipy.io import savemat

from armdyn.errors import InputError
from pipeline.imports import read_foreign
from pipeline.imports.conversion import run_from_recording
from pipeline.imports.guess import guess_map
from pipeline.imports.mapping import column_map_toml, read_map
from pipeline.imports.pendulum import fit_circle

from .said import ALONE, ASK, NAMES, RIGHT, TRUE, N, at, check_against_truth, truth


def rows(*columns, separator=",", digits="%.6f"):
    return "\n".join(separator.join(digits % x for x in row) for row in zip(*columns, strict=True))


Q, V, TAU = truth(TRUE)
ALL = (TRUE, *Q.T, *TAU.T)
HEAD = "t,q1,q2,q3,tau1,tau2,tau3"
BLANKS = HEAD.replace(",", " ")
UNITS_BELOW = "s,deg,deg,deg,Nm,Nm,Nm"
IN_DEGREES = (TRUE, *np.rad2deg(Q).T, *TAU.T)
HEAD_OF_A_RUN = ",".join(["time [s]", *(f"q.{n} [rad]" for n in NAMES), *(f"tau.{n} [N m]" for n in NAMES)])
MONDAY = datetime(2026, 5, 4, 10, 59, 59)
DATED = "\n".join(
    f"{(MONDAY + timedelta(seconds=float(t))).isoformat()},{row}"
    for t, row in zip(TRUE, rows(*ALL[1:]).splitlines(), strict=True)
)
TABLES = {
    "dates": (f"{HEAD}\n{DATED}\n", "", RIGHT),
    "times of the day": (f"{HEAD}\n{DATED}\n".replace("2026-05-04T", ""), "", RIGHT),
    "turns": (f"t,q1 [rev],q2 [rev],q3 [rev],tau1,tau2,tau3\n{rows(TRUE, *(Q.T / (2 * np.pi)), *TAU.T)}\n", "", RIGHT),
    "a spreadsheet's missing cells": (f"{HEAD}\n{rows(*ALL)}\n".replace("\n0.500000", "\n#N/A"), "", RIGHT),
    "as usual": (f"{HEAD}\n{rows(*ALL)}\n", "", RIGHT),
    "without a last newline": (f"{HEAD}\n{rows(*ALL)}", "", RIGHT),
    "cut in a number": (f"{HEAD}\n{rows(*ALL)}"[:-4], "", RIGHT),
    "cut in a row": (f"{HEAD}\n{rows(*ALL)}"[:-24], "", RIGHT),
    "comments above": (f"# by a logger\n# on Monday\n{HEAD}\n{rows(*ALL)}\n", "", RIGHT),
    "comments in between": (f"{HEAD}\n{rows(*(c[:100] for c in ALL))}\n# paused\n{rows(*(c[100:] for c in ALL))}\n", "", RIGHT),  # noqa: E501
    "numpy's header": (f"# {BLANKS}\n{rows(*ALL, separator=' ', digits='%.18e')}\n", "", RIGHT),
    "numpy's header with commas over blanks": (f"# {HEAD}\n{rows(*ALL, separator=' ')}\n", "", RIGHT),
    "Octave's header": (f"% made by Octave 8\n% {BLANKS}\n{rows(*ALL, separator=' ')}\n", "", RIGHT),
    "lines above": (f"Robot: A\nDate: Monday\n\n{HEAD}\n{rows(*ALL)}\n", "", RIGHT),
    "a line above with as many commas": (f"Robot,A,,,,,\n{HEAD}\n{rows(*ALL)}\n", "", RIGHT),
    "units below": (f"{HEAD}\n{UNITS_BELOW}\n{rows(*IN_DEGREES)}\n", "", RIGHT),
    "units in brackets below": (f"{HEAD}\n[s],[deg],[deg],[deg],[Nm],[Nm],[Nm]\n{rows(*IN_DEGREES)}\n", "", RIGHT),
    "tabs": (HEAD.replace(",", "\t") + f"\n{rows(*ALL, separator=chr(9))}\n", "", RIGHT),
    "decimal commas": (HEAD.replace(",", ";") + f"\n{rows(*ALL, separator=';')}\n".replace(".", ","), "", RIGHT),
    "decimal commas under a comment": ("# x\n" + HEAD.replace(",", ";") + f"\n{rows(*ALL, separator=';')}\n".replace(".", ","), "", RIGHT),  # noqa: E501
    "no stamps": (f"{HEAD[2:]}\n{rows(*ALL[1:])}\n", "100 Hz", RIGHT),
    "no stamps and no rate": (f"{HEAD[2:]}\n{rows(-ALL[1], *ALL[2:4], -ALL[4], *ALL[5:])}\n", "", "rate"),
    "no header": (f"{rows(*ALL)}\n", "", ASK),
    "no header, as MATLAB saves": ("\n".join("   " + line.replace(" ", "   ") for line in rows(*ALL, separator=" ", digits="%.7e").split("\n")) + "\n", "", ASK),  # noqa: E501
    "no header under a comment": (f"# by a logger\n{rows(*ALL)}\n", "", ASK),
    "neither header nor stamps": (f"{rows(*ALL[1:])}\n", "100 Hz", ASK),
    "no header and too many columns": (f"{rows(*ALL, TRUE)}\n", "", "has no header"),
    "energies": (f"t,q1,q2,q3,energy1 [J],energy2 [J],energy3 [J]\n{rows(*ALL)}\n", "", "none"),
    "energies by their unit": (f"t,q1,q2,q3,tau1 (J),tau2 (J),tau3 (J)\n{rows(*ALL)}\n", "", "none"),
    "energies by their name": (f"t,q1,q2,q3,E_kin,E_pot,kinetic_energy\n{rows(*ALL)}\n", "", "none"),
    "a stamp that goes back once": (f"{HEAD}\n{rows(at([50], -1.0)(TRUE.copy()), *ALL[1:])}\n", "", RIGHT),
    "a stamp ahead once": (f"{HEAD}\n{rows(at([50], 9e5)(TRUE.copy()), *ALL[1:])}\n", "", RIGHT),
    "a row twice": (f"{HEAD}\n{rows(*(np.insert(c, 50, c[50]) for c in ALL))}\n", "", RIGHT),
}  # fmt: skip


@pytest.mark.parametrize("kind", TABLES)
def test_tables_of_every_kind_become_the_run_or_ask(kind, tmp_path, complains):
    """`none`: what is not a torque becomes none; other words: what the one line says."""
    text, rate, outcome = TABLES[kind]
    (tmp_path / "a.csv").write_text(text)
    (foreign,) = read_foreign(tmp_path / "a.csv")
    if outcome not in (RIGHT, ASK, "none"):
        with complains(InputError):
            guess_map([foreign], ALONE, rate)
        return
    mapping = guess_map([foreign], ALONE, rate)
    assert all((bool(entry.check)) == (outcome == ASK) for entry in mapping.entries.values())
    found = run_from_recording(foreign, mapping)
    (account,) = found.accounts
    assert account.came == account.kept + sum(account.left_out.values())
    assert N - 1 <= account.kept <= N
    assert {name.partition(".")[0] for name in found.run.channels} == {"q"} if outcome == "none" else {"q", "tau"}
    check_against_truth(found.run, 1e-3)


def test_a_header_that_stands_there_again_is_no_other_joint(tmp_path):
    for head in (f"{HEAD},tau3", f"{HEAD_OF_A_RUN},tau.j3 [N m]"):
        (tmp_path / "a.csv").write_text(f"{head}\n{rows(*ALL, TRUE)}\n")
        (foreign,) = read_foreign(tmp_path / "a.csv")
        mapping = guess_map([foreign], ALONE)
        assert {e.channel.partition(".")[2] for e in mapping.entries.values()} == set(NAMES)
        assert any("stands in the header again" in note for note in foreign.notes)


MATLAB = {
    "vectors and matrices": ({"t": TRUE, "q": Q, "tau": TAU, "name": "x", "gain": 3.0}, ""),
    "columns": ({"t": TRUE[:, None], "q": Q, "tau": TAU}, ""),
    "matrices that lie": ({"t": TRUE, "q": Q.T, "tau": TAU.T}, ""),
    "a structure": ({"out": {"time": TRUE, "q": Q, "tau": TAU}}, ""),
    "structures in structures": ({"log": {"t": TRUE, "arm": {"q": Q, "tau": TAU}}}, ""),
    "other lengths": ({"t": TRUE, "q": Q, "tau": TAU, "spectrum": np.ones(77)}, ""),
    "no stamps": ({"q": Q, "tau": TAU, "fs": 100.0}, "100 Hz"),
}


def save_hdf5(path, content):
    """A file as MATLAB's ``save(..., '-v7.3')`` writes it: HDF5 behind a header, matrices transposed."""
    h5py = pytest.importorskip("h5py")

    def write(group, values):
        for name, value in values.items():
            if isinstance(value, dict):
                write(group.create_group(name), value)
            elif isinstance(value, str):
                stored = group.create_dataset(name, data=np.frombuffer(value.encode("utf-16-le"), "u2")[:, None])
                stored.attrs["MATLAB_class"] = np.bytes_("char")
            else:
                group.create_dataset(name, data=np.atleast_2d(np.asarray(value)).T)

    with h5py.File(path, "w", userblock_size=512) as file:
        write(file, content)
        file.create_group("#refs#")["cell"] = np.arange(3.0)
        file["elsewhere"] = h5py.ExternalLink("/dev/zero", "/a")
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")


@pytest.mark.parametrize("save", [savemat, save_hdf5])
@pytest.mark.parametrize("kind", MATLAB)
def test_matlabs_arrays_are_columns(kind, save, tmp_path):
    content, rate = MATLAB[kind]
    save(tmp_path / "a.mat", content)
    (foreign,) = read_foreign(tmp_path / "a.mat")
    found = run_from_recording(foreign, guess_map([foreign], ALONE, rate))
    assert set(found.run.channels) == {f"{kind}.{name}" for kind in ("q", "tau") for name in NAMES}
    check_against_truth(found.run)


def test_an_hdf5_file_that_declares_more_than_a_machine_holds_is_one_line(tmp_path, complains):
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "a.mat", "w", userblock_size=512) as file:
        file.create_dataset("q", (10**6, 10**6), "f8", chunks=(1000, 1000))
    with complains(InputError):
        read_foreign(tmp_path / "a.mat")


NO_MATLAB = [
    b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM" + bytes(400),
    b"not MATLAB's" * 50,
    b"",
]


@pytest.mark.parametrize("content", NO_MATLAB)
def test_what_is_no_matlab_file_is_one_line(content, tmp_path, complains):
    (tmp_path / "a.mat").write_bytes(content)
    with complains(InputError):
        read_foreign(tmp_path / "a.mat")


def test_a_pendulum_by_video_or_phone(tmp_path):
    """Tracker and phyphox: the angle is the angle, a rate is a rate."""
    swing = 0.4 * np.sin(4 * TRUE)
    rate = 1.6 * np.cos(4 * TRUE)
    tracker = "mass A\nt\tx\ty\tθ\n" + rows(TRUE, np.sin(swing), -np.cos(swing), swing, separator="\t")
    phone = '"Time (s)","Gyroscope x (rad/s)","Gyroscope y (rad/s)"\n' + rows(TRUE, 0.01 * rate, rate, digits="%.9E")
    counts = "time_ms,encoder_counts\n" + rows(1e3 * TRUE, 4096 / (2 * np.pi) * swing, digits="%.0f")
    for text, channels in ((tracker, {"swing_angle"}), (phone, {"swing_rate"}), (counts, {"swing_angle"})):
        (tmp_path / "a.txt").write_text(text, encoding="utf-8")
        mapping = guess_map(read_foreign(tmp_path / "a.txt"))
        assert {entry.channel for entry in mapping.entries.values()} == channels
        assert all(entry.check for entry in mapping.entries.values())


@pytest.mark.parametrize("up", [1.0, -1.0])
@pytest.mark.parametrize("swing_size", [0.4, 3.0])
def test_the_place_of_a_load_in_a_picture_becomes_its_swing(up, swing_size, tmp_path):
    """Pixels, y up or down, some lost; the pivot is found within its own standard deviations."""
    rng = np.random.default_rng(1)
    swing, radius = swing_size * np.sin(4 * TRUE), 350.0
    x, y = 300.0 - radius * np.sin(swing), 200.0 - up * radius * np.cos(swing)
    x, y = (place + 0.5 * rng.standard_normal(len(TRUE)) for place in (x, y))
    x[5:9] = np.nan
    (tmp_path / "a.txt").write_text("t,x,y\n" + rows(TRUE, x, y))
    (foreign,) = read_foreign(tmp_path / "a.txt")
    mapping = guess_map([foreign])
    (tmp_path / "map.toml").write_text(column_map_toml(mapping))
    angle = run_from_recording(foreign, read_map(tmp_path / "map.toml")[""]).run.channels["swing_angle"]
    np.testing.assert_allclose(angle.value, np.interp(angle.time, TRUE, swing), atol=5 * 0.5 / radius)
    circle = fit_circle(x, y)
    assert abs(circle.radius - radius) < 4 * circle.radius_std < 0.02 * radius
    assert not any(entry.check for entry in mapping.entries.values())


@pytest.mark.parametrize(("header", "newtons"), [("load (g)", 9.80665e-3), ("weight_kg", 9.80665), ("force_N", 1.0)])
def test_a_load_cell_may_read_as_a_scale_does(header, newtons, tmp_path):
    force = 80.0 + 3.0 * np.sin(8 * TRUE)
    (tmp_path / "a.txt").write_text(f"t,angle (rad),{header}\n" + rows(TRUE, 0.3 * np.sin(4 * TRUE), force))
    (foreign,) = read_foreign(tmp_path / "a.txt")
    found = run_from_recording(foreign, guess_map([foreign])).run.channels["load_force"]
    np.testing.assert_allclose(found.value, newtons * force, rtol=1e-6)


def test_a_short_arc_and_a_pivot_that_moves_are_questions(tmp_path):
    rng = np.random.default_rng(1)
    swing = 0.02 * np.sin(4 * TRUE)
    moving = 0.4 * np.sin(3 * TRUE)
    for x, y in (
        (100 * np.sin(swing), -100 * np.cos(swing)),
        (50 * np.sin(TRUE) + 100 * np.sin(moving), -100 * np.cos(moving)),
    ):
        noise = 0.5 * rng.standard_normal((2, len(TRUE)))
        (tmp_path / "a.txt").write_text("t,x,y\n" + rows(TRUE, x + noise[0], y + noise[1]))
        (entry,) = guess_map(read_foreign(tmp_path / "a.txt")).entries.values()
        assert entry.check


SHEET = """<worksheet xmlns="http://schemas.openxmlformats.org/spreadsheetml/2006/main"><sheetData>{}</sheetData></worksheet>"""
STRINGS = """<sst xmlns="http://schemas.openxmlformats.org/spreadsheetml/2006/main">{}</sst>"""


def test_the_first_sheet_of_a_workbook_is_a_table(tmp_path, complains):
    names = HEAD.split(",")
    head = "".join(f'<c r="{chr(65 + i)}1" t="s"><v>{i}</v></c>' for i in range(len(names)))
    lines = [
        "".join(f'<c r="{chr(65 + i)}{k}"><v>{x:.9f}</v></c>' for i, x in enumerate(row))
        for k, row in enumerate(zip(*ALL, strict=True), start=2)
    ]
    with zipfile.ZipFile(tmp_path / "a.xlsx", "w") as archive:
        body = "".join(f"<row>{line}</row>" for line in (head, *lines))
        archive.writestr("xl/worksheets/sheet1.xml", SHEET.format(body))
        archive.writestr("xl/sharedStrings.xml", STRINGS.format("".join(f"<si><t>{n}</t></si>" for n in names)))
    (foreign,) = read_foreign(tmp_path / "a.xlsx")
    check_against_truth(run_from_recording(foreign, guess_map([foreign], ALONE)).run)
    (tmp_path / "a.xlsx").write_bytes(b"?")
    with complains(InputError):
        read_foreign(tmp_path / "a.xlsx")


def test_a_missing_recording_is_said_with_its_neighbours(tmp_path, complains):
    (tmp_path / "bag_1").mkdir()
    with complains(InputError) as caught:
        read_foreign(tmp_path / "bag_9")
    assert "no such file (its folder has bag_1)" in str(caught.value)
