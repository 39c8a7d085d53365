"""Every kind of file that comes from outside: good ones, spoiled ones, and how each is read."""

import json
import signal
import tempfile
import traceback
import warnings
from collections.abc import Callable
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

from faults.samples import (
    ARM,
    CALIBRATION,
    EFFECT,
    JOURNAL,
    LINE_CSV,
    MAP,
    MODEL,
    PATHS,
    SETTINGS,
    SIDECAR,
    SPEC,
    crane,
    csv,
    foreign_csv,
    list_csv,
    mcap,
    npz,
    parquet,
    toy_urdf,
)  # fmt: skip
from faults.strategies import encoded, spoiled_bytes, spoiled_text
from hypothesis import strategies as st

import urdf
from armdyn.arm.model import arm_model
from armdyn.effects.user import load_effects
from armdyn.errors import ArmdynError
from armdyn.front import compare
from armdyn.identify.prepare import prepare_runs
from armdyn.model_file import base_pendulum, model_text, read_model_file
from armdyn.physics.user import load_base
from armdyn.recording.checks import check_run
from armdyn.run import read_run
from ik import PathTable
from ik.pathfile import read_path
from pipeline.batch.run import Journal
from pipeline.batch.spec import read_spec
from pipeline.imports import read_foreign
from pipeline.imports.conversion import run_from_recording
from pipeline.imports.guess import guess_map, map_unambiguous_columns
from pipeline.imports.joints import RobotJoints
from pipeline.imports.mapping import column_map_toml, read_map
from pipeline.imports.register_entries import DriveKinds
from pipeline.loadcell.calibration import Calibration
from pipeline.motion.feasibility.read import read_trajectory
from urdf.library_output import captured_output

CORPUS = Path(__file__).parent / "corpus"
LONGEST = 20.0  # s of this process that one file may cost
LONGEST_LINE = 1500  # characters of what is said


@dataclass(frozen=True)
class Door:
    """A kind of file."""

    name: str  # of its file, which says the kind
    seeds: tuple[bytes, ...]  # good ones
    read: Callable[[Path], object]  # reads it, and goes as far as a command would before it computes
    deep: Callable[[Path], object] | None = None  # does what a command does with it; `read` where it is not given
    beside: dict[str, str] = field(default_factory=dict)  # other files that it needs, by name
    # makes files, of a `random.Random`, that are well formed and wrong inside; None for text
    inside: Callable | None = None

    @property
    def spoiled(self):
        """Strategy for bad files of this kind."""
        good = st.sampled_from((*self.seeds, *kept(self.name)))
        if self.inside is not None:
            return spoiled_bytes(good) | st.randoms(use_true_random=False).map(self.inside)
        text = spoiled_text(good.map(lambda data: data.decode("utf-8", errors="replace")))
        return st.one_of(*[encoded(text)] * 9, spoiled_bytes(good))


@cache
def kept(name):
    """Files of a kind that were once read badly."""
    return tuple(path.read_bytes() for path in sorted((CORPUS / name).glob("*")))


@cache
def pendulum():
    return base_pendulum()


@cache
def toy_arm():
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "toy.urdf"
        path.write_text(toy_urdf())
        return arm_model(path)


@cache
def baxter():
    return urdf.load("baxter")


def _model_for(run):
    return toy_arm() if any(name.startswith("tau.") for name in run.channels) else pendulum()


def read_recording(path):
    run = read_run(path)
    check_run(_model_for(run), run)
    prepare_runs(_model_for(run), [run])


def compare_recording(path):
    run = read_run(path)
    compare(_model_for(run), [run])


def read_model(path):
    file = read_model_file(path)
    (path.parent / "again.toml").write_text(model_text(file, path.parent), encoding="utf-8")
    assert read_model_file(path.parent / "again.toml").model.names == file.model.names


def compare_model(path):
    model = read_model_file(path).model
    recording = path.parent / "model.csv"
    recording.write_text(csv(joints=model.base == "arm"), encoding="utf-8")
    compare(model, [recording])


def guess_and_import(path):
    """What is guessed is written as a mapping, and that is what is read back."""
    for foreign in read_foreign(path):
        raw = any(name.startswith("Present_") for name in foreign.columns)
        drives = DriveKinds.of(["xl330=all"] if raw else [])
        mapping = guess_map([foreign], RobotJoints(("j0", "j1", "j2")), drives=drives)
        (path.parent / "guessed.toml").write_text(column_map_toml(mapping, f"of {path}"), encoding="utf-8")
        run_from_recording(foreign, read_map(path.parent / "guessed.toml")[""])


def import_mapped(path):
    (foreign,) = read_foreign(path.parent / "foreign.csv")
    for mapping in read_map(path).values():
        run_from_recording(foreign, mapping, commands=foreign if mapping.commands is not None else None)


def import_known(path):
    for foreign in read_foreign(path):
        run_from_recording(foreign, map_unambiguous_columns(foreign))


def read_journal(path):
    journal = Journal(path)
    journal.close()
    return json.dumps([outcome.channels for outcome in journal.outcomes.values()])


@cache
def doors():
    """Every kind, by name."""
    toy = {"toy.urdf": toy_urdf()}
    recordings = (csv().encode(), csv(joints=True).encode())
    settings = {"m.toml": MODEL, "a.csv": csv()}
    every = [
        Door("a.csv", recordings, read_recording, compare_recording),
        Door("a.toml", (SIDECAR.encode(),), lambda path: read_recording(path.with_suffix(".csv")),
             lambda path: compare_recording(path.with_suffix(".csv")), {"a.csv": csv()}),
        Door("model.toml", (MODEL.encode(), ARM.encode()), read_model, compare_model, toy),
        Door("arm.urdf", (toy_urdf().encode(),), lambda path: urdf.load(path, meshes=False)),
        Door("robot.toml", (SETTINGS.encode(),), lambda path: urdf.load(path, meshes=False), beside=toy),
        Door("path.toml", tuple(path.encode() for path in PATHS), read_path),
        Door("line.csv", (LINE_CSV.encode(),), lambda path, robot=baxter(): read_trajectory(path, robot)),
        Door("effect.py", (EFFECT.encode(),), load_effects),
        Door("base.py", (crane(),), load_base),
        Door("foreign.csv", (foreign_csv().encode(), foreign_csv(";").encode(), list_csv().encode()), guess_and_import),
        Door("map.toml", (MAP.encode(),), import_mapped, beside={"foreign.csv": foreign_csv()}),
        Door("calibration.toml", (CALIBRATION.encode(),), Calibration.load),
        Door("spec.toml", (SPEC.encode(),), read_spec, beside=settings),
        Door("outcomes.jsonl", (JOURNAL.encode(),), read_journal),
        Door("a.mcap", (mcap(),), read_recording, compare_recording, inside=mcap),
        Door("table.npz", (npz(),), lambda path, robot=baxter(): PathTable.load(path, robot), inside=npz),
        Door("b.parquet", (parquet(),), import_known, inside=parquet),
    ]  # fmt: skip
    return {door.name: door for door in every}


class Late(BaseException):
    """The time is up; no `except Exception` may take it."""


def tried(door, data, folder, read=None):
    """Read a file.

    Returns:
        ``"read"``, ``"refused"`` or what is wrong with how it was read; and what was said.
    """
    for name, text in door.beside.items():
        (folder / name).write_text(text, encoding="utf-8")
    path = folder / door.name
    path.write_bytes(data)
    said, verdict = "", "read"
    with captured_output() as printed, warnings.catch_warnings(record=True) as warned, _limited():
        warnings.simplefilter("always")
        try:
            (read or door.read)(path)
        except (ArmdynError, urdf.UrdfError) as error:
            verdict, said = "refused", str(error)
        except Late:
            verdict, said = "hang", traceback.format_exc()
        except BaseException as error:
            verdict, said = f"traceback: {type(error).__name__}", traceback.format_exc()
    if verdict == "refused" and ("\n" in said or not said.strip() or len(said) > LONGEST_LINE):
        verdict = "not one line"
    elif verdict == "refused" and not any(Path(name).stem in said for name in (door.name, *door.beside)):
        verdict = "file not named"
    elif verdict in ("read", "refused") and printed.text:
        verdict, said = "prints", printed.text
    elif verdict == "refused" and warned:
        verdict, said = "warns", f"{warned[0].message} ({warned[0].filename}, line {warned[0].lineno})"
    return verdict, said


@contextmanager
def _limited():
    """Raise `Late` after `LONGEST` s of this process, however busy the machine is."""

    def late(*_):
        raise Late

    before = signal.signal(signal.SIGPROF, late)
    signal.setitimer(signal.ITIMER_PROF, LONGEST)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)
