"""Bad input to the commands: one line, exit status 2, and every file stays as it was, however it came to be read."""

import os
import shlex

import numpy as np
import pytest
from faults.samples import csv
from robots import joint, link, robot

from armdyn import atomic
from armdyn.errors import InputError
from armdyn.read_files import refuse_overwriting_inputs, register_input

MODEL = 'base = "pendulum"\neffects = []\n'
GOOD = csv(rows=300)
SPEC = '[[recordings]]\nmodel = "m.toml"\nruns = ["a.csv"]\n'
BATCH = "batch spec.toml --output out --workers 1"
MESH = (
    "solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\nendsolid a\n"
)
FORMS = ("%d%d", "%Y_%Y", "%Q", "%", "no letters", "(?P<a>%d%f%f")
YEARS = ("0001-01-01T00:00:00+14:00", "9999-12-31T23:59:59-12:00")  # beyond the calendar
CHANGED = [  # file, what is in it, command
    ("b.csv", GOOD.replace("load_force [mN]", "gripper_v [mm/s]"), "repair m.toml b.csv --output n.toml --json -"),
    ("b.csv", GOOD[: GOOD.index("\n")] + "".join(f"\n{0.01 * i:.2f},{0.01 * (i % 9)},800" for i in range(300)) + "\n",
     "repair m.toml b.csv --output n.toml --json -"),
    *(("m.toml", text, "compare m.toml a.csv") for text in (
        'base = "pendulum"\neffects = ["quadratic_dragg"]\n', 'base = "pendulm"\n', "base = \n", "effects = []\n",
        *(f'base = "pendulum"\n[parameters]\n{wrong}\n' for wrong in (
            "lenght = { value = 1.0 }", "length = { value = -1.0 }", "length = { value = 1.0, std = nan }",
            'length = { value = 1.0, prior = "9.0 +/- 0.1" }',
        )),
    )),
    *(("spec.toml", f'{SPEC}[time]\nform = "{form}"\n', BATCH) for form in FORMS),
    *(("spec.toml", f'{SPEC}times = {{"a.csv" = {year}}}\n', BATCH) for year in YEARS),
    *(("a.toml", f"recorded = {year}\n", "compare m.toml a.csv") for year in YEARS),
]  # fmt: skip
WRONG = (
    "diagnose m.toml a.csv --held-out a.csv", "diagnose m.toml .", "diagnose m.toml absent.csv",
    "repair m.toml a.csv --output nowhere/n.toml", "repair m.toml a.csv --output a.csv",
    "compare m.toml a.csv --report m.toml", "compare m.toml a.csv --report r --json r", "compare m.toml a.csv copy.csv",
    "compare m.toml a.csv --held-out copy.csv", "repair m.toml a.csv --exam copy.csv",
    "diagnose m.toml a.csv --exam a.csv", "trial --out a.csv", "trial --json nowhere/x.json", "new pendulum a.csv",
    "new pendulum n.toml --set mass=80", "new pendulum n.toml --set 'masss=80 g'",
    "new arm n.toml --robot baxter --joints right_s7", "effects --effects absent.py",
)  # fmt: skip
LOOPS = (  # links in a circle
    "compare m.toml loop.csv", "compare loop.csv a.csv", "inspect loop.csv", "check loop.csv", "view loop.csv",
    "compare m.toml a.csv --effects loop.csv", "export loop.csv --output m.py", "import loop.csv --output runs",
    "trial --model loop.csv", "compare m.toml a.csv --json loop.csv",
)  # fmt: skip
ADDRESSES = ("ws://127.0.0.1:99999", "ws://127.0.0.1:-1", "ws://[::1", "ws://" + "a" * 300)
READ = (  # what was read, also indirectly or under another name, is not an output
    "compare m.toml a.csv --json a.toml", "compare m.toml a.csv --json link.json",
    "compare m.toml a.csv --json hard.json", "compare m.toml a.csv --report a.toml",
    "repair m.toml a.csv --output a.toml", "inspect a.csv --json a.toml", "new arm a.urdf --urdf a.urdf",
    "new arm n.toml --urdf a.urdf --json a.urdf", "new arm n.toml --urdf a.urdf --json arm.stl",
    "batch spec.toml --output out --json m.toml", "batch spec.toml --output out --json a.toml",
    "trial --model model.toml --out . --seed 1", "watch arm.toml q.csv --calibrate q.csv --log hard.urdf",
    "watch arm.toml q.csv --calibrate q.csv --json hard.urdf", "export arm.toml --output hard.urdf --force",
)  # fmt: skip
PIPES = (
    "compare m.toml pipe", "inspect pipe", "import pipe --output runs", "compare pipe a.csv",
    "new arm q.toml --urdf pipe", "check pipe --robot ur5", "view pipe", "compare m.toml a.csv --effects pipe",
)  # fmt: skip


@pytest.fixture
def folder(tmp_path):
    """A pendulum's model and recording, an arm with a mesh, a batch of one; links to some, and a circle of links."""
    for name in ("m.toml", "model.toml"):
        (tmp_path / name).write_text(MODEL)
    for name in ("a.csv", "copy.csv"):
        (tmp_path / name).write_text(GOOD)
    (tmp_path / "a.toml").write_text('description = "a swing"\n')
    (tmp_path / "spec.toml").write_text(SPEC)
    (tmp_path / "arm.toml").write_text('base = "arm"\nurdf = "a.urdf"\njoints = ["j"]\neffects = []\n')
    rows = (f"{i / 50},{np.sin(i / 30)},{9.81 * np.cos(i / 30)}\n" for i in range(1000))
    (tmp_path / "q.csv").write_text("time [s],q.j [rad],tau.j [N m]\n" + "".join(rows))
    (tmp_path / "arm.stl").write_text(MESH)
    shape = '<visual><geometry><mesh filename="arm.stl"/></geometry></visual>'
    (tmp_path / "a.urdf").write_text(robot('<link name="base"/>', link("arm", shape=shape), joint("j", "base", "arm")))
    for name, target in (("link.json", "a.toml"), ("loop.csv", "other.csv"), ("other.csv", "loop.csv")):
        (tmp_path / name).symlink_to(target)
    for name, other in (("a.toml", "hard.json"), ("a.urdf", "hard.urdf")):
        os.link(tmp_path / name, tmp_path / other)
    return tmp_path


@pytest.fixture
def said(refused, folder):
    """The one line that a command says, which leaves the folder as it was."""

    def contents():
        return {p.name: p.is_file() and p.read_bytes() for p in folder.iterdir() if p.name != ".lock"}

    def of(command):
        before = contents()
        line = refused(*shlex.split(command))
        assert contents() == before
        return line

    return of


@pytest.mark.parametrize(
    ("file", "text", "command"), CHANGED, ids=[f"{f}: {t.split(chr(10))[-2]}" for f, t, _ in CHANGED]
)
def test_a_bad_file_is_refused(said, folder, file, text, command, complains):
    (folder / file).write_text(text)
    complains.line(said(command))


@pytest.mark.parametrize("command", [*WRONG, *LOOPS, *READ, *(f"record --ros {a} --output r.mcap" for a in ADDRESSES)])
def test_a_bad_argument_is_refused(said, command, complains):
    complains.line(said(command))


@pytest.mark.parametrize("command", PIPES)
def test_a_named_pipe_keeps_nobody_waiting(folder, refused, command):
    os.mkfifo(folder / "pipe")
    refused(*command.split())


def test_a_search_over_the_whole_disk_does_not_begin(said, folder, monkeypatch, complains):
    monkeypatch.setattr("pipeline.batch.spec.MAX_BATCH_FILES", 20)
    for number in range(30):
        (folder / f"{number}.txt").touch()
    (folder / "spec.toml").write_text(f'[[recordings]]\nmodel = "m.toml"\nruns = ["{folder}/**/*.csv"]\n')
    complains.line(said(BATCH))


@pytest.mark.parametrize("step", ["1e-322", "5e-324", "1e-300", "1e-12"])
@pytest.mark.parametrize("model", [(), ("m.toml",)])
def test_stamps_that_no_sensor_gives_are_said_by_inspect(folder, armdyn, step, model):
    rows = "\n".join(f"{i * float(step)!r},{0.1 * (-1) ** i},{0.01 * i}" for i in range(80))
    (folder / "b.csv").write_text(f"time [s],swing_angle [rad],gripper_x [m]\n{rows}\n")
    status, out, _ = armdyn("inspect", *model, "b.csv")
    assert status == 1
    assert "which no sensor does" in out


def test_a_command_may_write_twice_and_a_repair_into_its_own_model(folder, armdyn):
    assert armdyn("add", "m.toml", "linear_drag", "a.csv")[0] == 0
    assert "linear_drag" in (folder / "m.toml").read_text()
    with refuse_overwriting_inputs():
        for text in ("one", "two"):
            atomic.write_text(folder / "new.txt", text)
            assert (folder / "new.txt").read_text() == text


def test_what_other_languages_read_counts_and_a_program_of_ones_own_is_free(tmp_path, complains):
    file = tmp_path / "a.bin"
    file.write_text("old")
    with refuse_overwriting_inputs():
        register_input(file)
        with complains(InputError):
            atomic.write_text(file, "new")
    assert file.read_text() == "old"
    atomic.write_text(file, "new")
