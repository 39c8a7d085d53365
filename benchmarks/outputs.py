"""Is a file ever lost: an output over an input by every road, a full disk, a kill in the middle of writing?

    python benchmarks/outputs.py [--kills N] [--json FILE]

Counts the files that were changed although the command was refused, the commands that did not end with one line and
status 2, and the files that are neither the old nor a whole new one.
"""

import argparse
import contextlib
import hashlib
import io
import json
import os
import random
import resource
import signal
import subprocess
import sys
import time
import tomllib
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from unittest import mock

import numpy as np

from armdyn.run import Run, write_run_csv
from pipeline.cli import main as armdyn

URDF = """<robot name="toy"><link name="base"/><link name="arm"><inertial><origin xyz="0.2 0 0"/><mass value="2"/>
<inertia ixx="0.02" iyy="0.03" izz="0.03" ixy="0" ixz="0" iyz="0"/></inertial>
<visual><geometry><mesh filename="arm.stl"/></geometry></visual></link>
<joint name="j" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 1 0"/>
<limit lower="-2" upper="2" velocity="2" effort="20"/></joint></robot>"""
MESH = (
    "solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\nendsolid a\n"
)
OUTPUTS = (
    ("a.toml", "compare m.toml a.csv --json {}"), ("m.toml", "compare m.toml a.csv --report {}"),
    ("a.csv", "diagnose m.toml a.csv --report {}"), ("a.toml", "repair m.toml a.csv --output {}"),
    ("a.csv", "inspect a.csv --json {}"), ("a.toml", "discover m.toml a.csv --output {}"),
    ("a.csv", "next m.toml a.csv --output {}"), ("arm.stl", "new arm n.toml --urdf a.urdf --json {}"),
    ("a.urdf", "new arm {} --urdf a.urdf"), ("a.urdf", "excite --urdf a.urdf --output {}"),
    ("line.csv", "check line.csv --json {}"), ("a.urdf", "export arm.toml --output {} --force"),
    ("a.urdf", "watch arm.toml q.csv --calibrate q.csv --log {}"), ("q.csv", "watch arm.toml q.csv --json {}"),
    ("a.toml", "batch spec.toml --output out --workers 1 --json {}"),
)  # fmt: skip
"""An input of a command, and the command that is to write over it."""
ROADS = ("same", "relative", "link", "hard link")
GROWING = (
    "compare m.toml a.csv --json o.json --report o.html", "repair m.toml a.csv --output o.toml --report o.html",
    "inspect a.csv --json o.json", "excite --urdf a.urdf --seconds 5 --output o.csv", "export arm.toml --output o.py",
    "watch arm.toml q.csv --calibrate q.csv --log o.csv --json o.json", "batch spec.toml --output out --workers 1",
    "import f.csv --map map.toml --output o", "new arm o.toml --urdf a.urdf", "ik build --out o.npz",
)  # fmt: skip
"""Commands for full disks and kills; their outputs begin with an o."""
LIMITS = (0, 900, 20_000)
"""Size that a file may have before its disk is full [bytes]."""


def make_inputs(folder: Path) -> None:
    """A pendulum and an arm of one joint with recordings, a line, a batch, and a foreign table."""
    t = np.arange(2000) / 100
    x = 0.05 * np.sin(3 * t) * np.minimum(t, 1.0)
    force = 0.785 + 0.01 * np.cos(5 * t)
    write_run_csv(Run.from_arrays(t, {"gripper_x": x, "load_force": force}, description="swing"), folder / "a.csv")
    q, a = 0.8 * np.sin(2 * t), -3.2 * np.sin(2 * t)
    tau = (0.03 + 2 * 0.04) * a - 2 * 9.81 * 0.2 * np.cos(q) + 0.05 * np.random.default_rng(0).normal(size=t.size)
    write_run_csv(Run.from_arrays(t, {"q.j": q, "tau.j": tau}), folder / "q.csv")
    (folder / "line.csv").write_text("time [s],s [m]\n" + "".join(f"{k / 50},{0.001 * k}\n" for k in range(50)))
    (folder / "f.csv").write_text(
        "t,pos,eff\n" + "".join(f"{i},{j:.5f},{k:.5f}\n" for i, j, k in zip(t, q, tau, strict=True))
    )
    (folder / "map.toml").write_text(
        'time = { column = "t", unit = "s" }\n[columns]\npos = { channel = "q.j", unit = "rad" }\n'
        'eff = { channel = "tau.j", unit = "N m" }\n'
    )
    (folder / "m.toml").write_text('base = "pendulum"\neffects = []\n')
    (folder / "arm.toml").write_text('base = "arm"\nurdf = "a.urdf"\njoints = ["j"]\neffects = []\n')
    (folder / "spec.toml").write_text('[[recordings]]\nmodel = "m.toml"\nruns = ["a.csv"]\n')
    (folder / "a.urdf").write_text(URDF)
    (folder / "arm.stl").write_text(MESH)


def digests(folder: Path) -> dict[str, str]:
    """Digest of every file of a folder itself."""
    return {p.name: hashlib.sha256(p.read_bytes()).hexdigest() for p in folder.iterdir() if p.is_file()}


def called(command: str) -> tuple[int, str]:
    """Exit status of a command in this process, and what it wrote to standard error."""
    err = io.StringIO()
    with (
        mock.patch.object(sys, "argv", ["armdyn", *command.split()]), mock.patch.dict(os.environ),
        contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(err),
    ):  # fmt: skip
        try:
            armdyn()
        except SystemExit as stop:
            return int(stop.code or 0), err.getvalue()
    return 0, err.getvalue()


@contextlib.contextmanager
def fresh_folder() -> Iterator[Path]:
    """A folder with the inputs, which is the working directory."""
    before = Path.cwd()
    with TemporaryDirectory() as scratch:
        make_inputs(Path(scratch))
        os.chdir(scratch)
        try:
            yield Path(scratch)
        finally:
            os.chdir(before)


def over_inputs() -> Iterator[tuple[str, str]]:
    """What is wrong with each command that is to write over one of its inputs; empty where it is refused."""
    for source, command in OUTPUTS:
        for road in ROADS:
            with fresh_folder() as folder:
                (folder / "sub").mkdir()
                name = (
                    source
                    if road == "same"
                    else f"sub/../{source}"
                    if road == "relative"
                    else f"other{Path(source).suffix}"
                )
                if road == "link":
                    (folder / name).symlink_to(source)
                elif road == "hard link":
                    os.link(source, name)
                before = digests(folder)
                status, err = called(command.format(name))
                after = digests(folder)
                lost = [key for key in before if after.get(key) != before[key]]
                wrong = (
                    f"changed {lost}"
                    if lost
                    else ""
                    if (status, err.count("\n")) == (2, 1)
                    else f"status {status}: {err}"
                )
                yield f"{command.format(name)} ({road} as {source})", wrong


def start(folder: Path, command: str, limit: int | None = None) -> "subprocess.Popen[str]":
    """Start a command in a process of its own, whose files may have at most `limit` bytes."""

    def limited() -> None:
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        if limit is not None:
            resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))

    return subprocess.Popen(
        [sys.executable, "-c", "from pipeline.cli import main; main()", *command.split()], cwd=folder, text=True,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, preexec_fn=limited, start_new_session=True,
    )  # fmt: skip


def not_whole(path: Path) -> bool:
    """Whether a file that was written is not complete."""
    try:
        text = path.read_text(encoding="utf-8") if path.suffix != ".npz" else ""
        if path.suffix == ".toml":
            tomllib.loads(text)
        elif path.suffix == ".json":
            [json.loads(part) for part in (text.splitlines() if text[:2] != "{\n" else [text])]
        elif path.suffix == ".csv":
            return not text.endswith("\n")
        elif path.suffix == ".html":
            return not text.rstrip().endswith("</html>")
        elif path.suffix == ".npz":
            np.load(path)["s"]
        elif path.suffix == ".py":
            compile(text, str(path), "exec")
    except (OSError, ValueError, KeyError, SyntaxError):
        return True
    return False


def full_disks() -> Iterator[tuple[str, str]]:
    """What is wrong with each command on a full disk: an old file that is lost, half a file, not one line, status 3."""
    for command in GROWING:
        for limit in LIMITS:
            with fresh_folder() as folder:
                before = digests(folder)
                process = start(folder, command, limit)
                _, err = process.communicate()
                after = digests(folder)
                lost = [key for key in before if after.get(key) != before[key]]
                half = [p.name for p in folder.rglob("o*") if p.is_file() and p.stat().st_size and not_whole(p)]
                said = [line for line in err.splitlines() if line.startswith("armdyn: ")]
                fine = process.returncode == 0 or (process.returncode == 2 and len(said) == 1)
                wrong = (
                    f"lost {lost}"
                    if lost
                    else f"half {half}"
                    if half
                    else ""
                    if fine
                    else f"status {process.returncode}: {err}"
                )
                yield f"{command} (room {limit})", wrong


def kills(number: int) -> Iterator[tuple[str, str]]:
    """What is wrong after each kill -9: a file that is neither the old nor a whole new one."""
    draw = random.Random(0)
    for i in range(number):
        command = GROWING[i % len(GROWING)]
        with fresh_folder() as folder:
            for word in command.split():
                if word.startswith("o.") and word != "o":
                    Path(word).write_text("old")
            before, old = digests(folder), hashlib.sha256(b"old").hexdigest()
            process = start(folder, command)
            written = draw.random() < 0.5  # half of the kills when the first output appears, the others at any time
            end = time.monotonic() + (60.0 if written else draw.uniform(0.5, 6.0))
            while time.monotonic() < end and process.poll() is None:
                if written and digests_of_outputs(folder) != {name: d for name, d in before.items() if name[0] == "o"}:
                    break
                time.sleep(0.002)
            with contextlib.suppress(ProcessLookupError):  # it has ended by itself
                os.killpg(process.pid, signal.SIGKILL)
            process.communicate()
            after = digests(folder)
            lost = [key for key in before if key[0] != "o" and after.get(key) != before[key]]
            half = [p.name for p in folder.glob("o*") if p.is_file() and "unfinished" not in p.name
                    and after[p.name] != old and not_whole(p)]  # fmt: skip
            yield f"{command} (killed {i})", f"lost {lost}" if lost else f"half {half}" if half else ""


def digests_of_outputs(folder: Path) -> dict[str, str]:
    """Digests of the files whose names begin with an o or a dot."""
    found = {}
    for path in folder.iterdir():
        with contextlib.suppress(OSError):
            if path.name[0] in "o." and path.is_file():
                found[path.name] = hashlib.sha256(path.read_bytes()).hexdigest()
    return found


def main() -> None:
    """Try everything, and print what is wrong and the counts."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=30)
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    counts: dict[str, dict[str, int]] = {}
    for name, tries in (("over inputs", over_inputs()), ("full disks", full_disks()), ("kills", kills(given.kills))):
        counts[name] = {"tried": 0, "wrong": 0}
        for what, wrong in tries:
            counts[name]["tried"] += 1
            counts[name]["wrong"] += bool(wrong)
            if wrong:
                print(f"WRONG {what}: {wrong}", flush=True)
        print(name, counts[name], flush=True)
    if given.json is not None:
        given.json.write_text(json.dumps(counts, indent=1))


if __name__ == "__main__":
    main()
