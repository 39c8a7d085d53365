"""Every kind of file that comes from outside, spoiled at random and read: an answer, or one line that names the file.

A file that is read badly is kept in ``corpus/<kind>``; every later campaign reads it again and spoils it further.
"""

import hashlib
import os
import random
import resource
import signal
import tempfile
import threading
import traceback
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from faults.mutation import encoded, spoiled_bytes, spoiled_text
from faults.samples import ARM, EFFECT, LINE_CSV, MODEL, PATHS, SETTINGS, SIDECAR, crane, csv, mcap, npz, toy_urdf

import urdf
from armdyn.arm.model import arm_model
from armdyn.effects.user import load_effects
from armdyn.errors import ArmdynError
from armdyn.front import compare
from armdyn.identify.prepare import ready
from armdyn.model_file import base_pendulum, model_text, read_model_file
from armdyn.physics.user import load_base
from armdyn.run import read_run
from armdyn.run_checks import check_run
from ik import PathTable
from ik.pathfile import read_path
from pipeline.motion.feasibility.read import read_trajectory
from urdf.quiet import quiet

CORPUS = Path(__file__).parent / "corpus"
LONGEST, LARGEST = 10.0, 2 * 2**20
"""s of this process, and kB of memory, that one file may cost."""
PATIENCE = 120.0
"""s on the clock after which it waits for something that never comes."""
LONGEST_LINE = 1500
"""Characters of what is said."""


@dataclass(frozen=True)
class Door:
    """A kind of file.

    Attributes:
        name: of its file, which says the kind.
        seeds: good ones.
        read: reads it, and goes as far as a command would before it computes.
        beside: other files that it needs, by name.
        binary: whether bytes are spoiled rather than text.
        inside: makes files that are well formed and wrong inside; None where text does that.
    """

    name: str
    seeds: Sequence[bytes]
    read: Callable[[Path], object]
    beside: tuple[tuple[str, str], ...] = ()
    binary: bool = False
    inside: Callable[[random.Random], bytes] | None = None


@cache
def _pendulum() -> object:
    return base_pendulum()


def _read_recording(path: Path) -> None:
    run = read_run(path)
    for model in (_pendulum(), _toy_arm()):
        if any(name.startswith("tau.") for name in run.channels) == (model is _toy_arm()):
            check_run(model, run)
            ready(model, run)


@cache
def _toy_arm() -> object:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "toy.urdf"
        path.write_text(toy_urdf())
        return arm_model(path)


def _compare_recording(path: Path) -> None:
    run = read_run(path)
    model = _toy_arm() if any(name.startswith("tau.") for name in run.channels) else _pendulum()
    compare(model, [run])


def _read_model(path: Path) -> None:
    file = read_model_file(path)
    text = model_text(file, path.parent)
    (path.parent / "again.toml").write_text(text, encoding="utf-8")
    assert read_model_file(path.parent / "again.toml").model.names == file.model.names


def _read_urdf(path: Path) -> None:
    urdf.load(path, meshes=False)


def _read_sidecar(path: Path) -> None:
    run = read_run(path.with_suffix(".csv"))
    check_run(_pendulum(), run)


@cache
def _baxter() -> urdf.Robot:
    return urdf.load("baxter")


@cache
def doors() -> dict[str, Door]:
    """Every kind, by name."""
    toy = ("toy.urdf", toy_urdf())
    text = [
        Door("a.csv", (csv().encode(), csv(joints=True).encode()), _read_recording),
        Door("a.toml", (SIDECAR.encode(),), _read_sidecar, (("a.csv", csv()),)),
        Door("model.toml", (MODEL.encode(), ARM.encode()), _read_model, (toy,)),
        Door("arm.urdf", (toy_urdf().encode(),), _read_urdf),
        Door("robot.toml", (SETTINGS.encode(),), _read_urdf, (toy,)),
        Door("path.toml", tuple(path.encode() for path in PATHS), read_path),
        Door("line.csv", (LINE_CSV.encode(),), lambda path: read_trajectory(path, _baxter())),
        Door("effect.py", (EFFECT.encode(),), load_effects),
        Door("base.py", (crane(),), load_base),
    ]
    binary = [
        Door("a.mcap", (mcap(),), _read_recording, binary=True, inside=mcap),
        Door("table.npz", (npz(),), lambda path: PathTable.load(path, _baxter()), binary=True, inside=npz),
    ]
    return {door.name: door for door in (*text, *binary)}


WEIGHTS = {"a.csv": 6, "a.toml": 5, "model.toml": 5, "arm.urdf": 6, "robot.toml": 5, "path.toml": 4, "line.csv": 3,
           "effect.py": 3, "base.py": 1, "a.mcap": 4, "table.npz": 3}  # fmt: skip
"""How often each kind is tried."""


def spoiled(seed: int) -> tuple[Door, bytes]:
    """The file that belongs to a seed, made of a good one or of one that was read badly once."""
    rng = random.Random(seed)
    door = doors()[rng.choices(list(WEIGHTS), list(WEIGHTS.values()))[0]]
    if door.inside is not None and rng.random() < 0.5:
        return door, door.inside(rng)
    good = rng.choice((*door.seeds, *kept(door.name)))
    if door.binary or rng.random() < 0.05:
        return door, spoiled_bytes(good, rng)
    return door, encoded(spoiled_text(good.decode("utf-8", errors="replace"), rng), rng)


def kept(name: str) -> tuple[bytes, ...]:
    """The corpus of one kind."""
    return tuple(path.read_bytes() for path in sorted((CORPUS / name).glob("*")))


def keep(door: Door, data: bytes) -> Path:
    """Put a file into the corpus."""
    path = CORPUS / door.name / hashlib.sha256(data).hexdigest()[:12]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(data)
    return path


def deep(door: Door) -> Callable[[Path], object]:
    """What a command does with such a file, once it is read."""
    if door.name in ("a.csv", "a.mcap"):
        return _compare_recording
    if door.name == "a.toml":
        return lambda path: _compare_recording(path.with_suffix(".csv"))
    if door.name == "model.toml":
        return _compare_model
    return door.read


def _compare_model(path: Path) -> None:
    model = read_model_file(path).model
    recording = path.parent / "model.csv"
    recording.write_text(csv(joints=model.base == "arm"), encoding="utf-8")
    compare(model, [recording])


class Late(BaseException):
    """The time is up; no `except Exception` may take it."""


def tried(door: Door, data: bytes, folder: Path, read: Callable[[Path], object] | None = None) -> tuple[str, str]:
    """Read a file.

    Returns:
        ``"read"``, ``"refused"`` or what is wrong with how it was read; and what was said.
    """
    for name, text in door.beside:
        (folder / name).write_text(text, encoding="utf-8")
    path = folder / door.name
    path.write_bytes(data)
    memory, said, verdict = _memory(), "", "read"
    with quiet() as printed, warnings.catch_warnings(record=True) as warned, _limited():
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
    elif verdict == "refused" and not any(name in said for name in (door.name, path.stem, *dict(door.beside))):
        verdict = "file not named"
    elif verdict in ("read", "refused") and _memory() - memory > LARGEST:
        verdict = "memory"
    elif verdict in ("read", "refused") and printed.text:
        verdict, said = "prints", printed.text
    elif verdict == "refused" and warned:
        verdict, said = "warns", f"{warned[0].message} ({warned[0].filename}, line {warned[0].lineno})"
    return verdict, said


def _memory() -> int:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


@contextmanager
def _limited() -> Iterator[None]:
    """Raise `Late` after `LONGEST` s of this process, however busy the machine is, or `PATIENCE` s on the clock."""

    def late(*_: object) -> None:
        raise Late

    before = [(number, signal.signal(number, late)) for number in (signal.SIGPROF, signal.SIGVTALRM)]
    signal.setitimer(signal.ITIMER_PROF, LONGEST)
    watch = threading.Timer(PATIENCE, os.kill, (os.getpid(), signal.SIGVTALRM))
    watch.start()
    try:
        yield
    finally:
        watch.cancel()
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        for number, handler in before:
            signal.signal(number, handler)
