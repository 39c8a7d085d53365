"""Every kind of file that comes from outside, spoiled at random and read: an answer, or one line that names the file.

A file that is read badly is kept in ``corpus/<kind>``; every later campaign reads it again and spoils it further.
"""

import hashlib
import io
import json
import os
import random
import resource
import signal
import sys
import tempfile
import threading
import traceback
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from faults.mutation import encoded, spoiled_bytes, spoiled_text

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
from ik import PathTable, default_table
from ik.pathfile import read_path
from ik.tablefile import write_arrays
from pipeline.motion.feasibility.read import read_trajectory

CORPUS = Path(__file__).parent / "corpus"
LONGEST, LARGEST = 10.0, 2 * 2**20
"""s of this process, and kB of memory, that one file may cost."""
PATIENCE = 120.0
"""s on the clock after which it waits for something that never comes."""
LONGEST_LINE = 1500
"""Characters of what is said."""

TOY = """<robot name="toy">
<link name="base"/>
{links}
</robot>
"""
LINK = """<link name="l{k}"><inertial><origin xyz="0 0 0.1" rpy="0 0 0"/><mass value="1.5"/>
<inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.004"/></inertial>
<collision><geometry><cylinder radius="0.05" length="0.2"/></geometry></collision></link>
<joint name="j{k}" type="{kind}"><origin xyz="0 0 0.2" rpy="0 0 0"/><parent link="{parent}"/><child link="l{k}"/>
<axis xyz="{axis}"/><limit lower="-1.5" upper="1.5" effort="40" velocity="2"/>
<dynamics damping="0.1" friction="0"/></joint>"""


def toy_urdf() -> str:
    """An arm of three joints."""
    kinds = (("revolute", "0 0 1"), ("continuous", "0 1 0"), ("prismatic", "1 0 0"))
    links = [
        LINK.format(k=k, kind=kind, axis=axis, parent="base" if k == 0 else f"l{k - 1}")
        for k, (kind, axis) in enumerate(kinds)
    ]
    return TOY.format(links="\n".join(links))


SETTINGS = """name = "toy"
[urdf]
file = "toy.urdf"
[arm]
joints = ["j0", "j1", "j2"]
home = [0.1, 0.2, 0.3]
[tool]
frame = "l2"
offset = [0.0, 0.0, 0.1]
[[frames]]
name = "cell"
parent = "l2"
position = [0.0, 0.0, 0.05]
[limits]
acceleration = [5.0, 5.0, 5.0]
jerk = [50.0, 50.0, 50.0]
source = "measured"
[line]
origin = [0.3, 0.0, 0.4]
direction = [0.0, 1.0, 0.0]
tool_rpy = [0.0, 0.0, 0.0]
range = [-0.1, 0.1]
core = [-0.05, 0.05]
core_speed = 0.5
[[springs]]
joint = "j1"
sine = 1.0
cosine = 2.0
enabled = true
source = "fitted"
"""
SIDECAR = """description = "swing 3, 80 g ball"
[noise]
load_force = "3 mN"
gripper_x = "0.1 mm"
[known]
mass = "80 g +/- 0.4 g"
length = "0.368 m +/- 1 mm"
"""
MODEL = """base = "pendulum"
effects = ["quadratic_drag", "sensor_bias"]
[parameters]
length = { value = 0.3681, std = 0.0002, unit = "m", fitted = true, prior = "0.37 +/- 0.01" }
mass = { value = 80.0, unit = "g", fitted = false }
"quadratic_drag.coefficient" = { value = 0.0031, std = 0.0001, unit = "N s^2/m^2", fitted = true }
[[history]]
added = "quadratic_drag"
runs = ["a.csv"]
rmse = { load_force = 0.0034 }
chi2_per_sample = 1.02
"""
ARM = """base = "arm"
urdf = "toy.urdf"
joints = ["j0", "j1", "j2"]
tool = "l2"
effects = ["joint_viscous_friction:j0"]
"""
EFFECT = '''import casadi as ca
from armdyn.effects.effect import effect
from armdyn.parameter import quantity

@effect("rub", acts_on="load", summary="a rub", source="own")
def rub(load, c=quantity("N", typical=0.02, lower=0.0, summary="of the rub")):
    """Against the motion."""
    return load.with_force(-c * ca.tanh(load.rate / 0.1) * load.velocity)
'''
PATHS = (
    'kind = "line"\norigin = [0.6, -0.2, 0.1]\ndirection = [0, 1, 0]\nrange = [0.0, 0.1]\ntool_rpy = [3.14, 0, 3.14]\n',
    'kind = "circle"\ncentre = [0.6, -0.2, 0.1]\nradius = 0.1\nnormal = [0, 0, 1]\nstart = [1, 0, 0]\n'
    "range_deg = [0, 90]\nfollow = true\ntool_rpy = [3.14, 0, 3.14]\n",
    'kind = "spline"\npoints = [[0.6, -0.2, 0.1], [0.6, 0.0, 0.1], [0.65, 0.1, 0.15]]\ntool_rpy = [3.14, 0, 3.14]\n',
)


def csv(rows: int = 60, joints: bool = False) -> str:
    """A recording of a swing, or of the toy arm."""
    time = np.arange(rows) / 50
    if not joints:
        columns = {"time [s]": time, "gripper_x [m]": 0.05 * np.sin(3 * time)}
        columns["load_force [mN]"] = 785 + 20 * np.sin(5 * time + 0.3) + 3 * np.cos(977 * time)
    else:
        columns = {"time [s]": time}
        for k in range(3):
            columns[f"q.j{k} [{'m' if k == 2 else 'rad'}]"] = 0.3 * np.sin((1 + k) * time + k)
            columns[f"tau.j{k} [{'N' if k == 2 else 'N m'}]"] = 2 * np.cos((2 + k) * time) + 0.1 * np.cos(977 * time)
    table = "\n".join(",".join(f"{value:.6g}" for value in row) for row in zip(*columns.values(), strict=True))
    return ",".join(columns) + "\n" + table + "\n"


def mcap(rng: random.Random | None = None) -> bytes:
    """A recording as the pipeline writes it; with a generator, with mistakes inside its messages and labels."""
    from mcap.writer import CompressionType, Writer

    def wrong(good: object) -> object:
        bad = (None, True, "x", "nan", [], {}, -1, 1e308, float("nan"), 10**400, {"time": 1}, "1" * 1000)
        return rng.choice(bad) if rng is not None and rng.random() < 0.01 else good

    stream = io.BytesIO()
    compression = CompressionType.ZSTD if rng is None else rng.choice(list(CompressionType))
    writer = Writer(stream, compression=compression)
    writer.start(profile="armdyn")
    labels = {"/gripper": {"x": "gripper_x [m]"}, "/load": {"force": "load_force [N]"}}
    ids = {}
    for topic, fields in labels.items():
        schema = writer.register_schema(topic, "jsonschema", b"{}")
        metadata = {str(wrong(key)): str(wrong(label)) for key, label in fields.items()}
        ids[topic] = writer.register_channel(topic, "json", schema, metadata)
    sidecar = spoiled_text(SIDECAR, rng) if rng is not None and rng.random() < 0.3 else SIDECAR
    writer.add_metadata("armdyn.sidecar", {"toml": sidecar})
    for k in range(60):
        for topic, field, value in (("/gripper", "x", 0.05 * np.sin(k / 9)), ("/load", "force", 0.8 + 0.01 * (k % 3))):
            message = wrong({str(wrong("time")): wrong(k / 50), str(wrong(field)): wrong(float(value))})
            writer.add_message(ids[topic], k, json.dumps(message).encode(), k)
    writer.finish()
    return stream.getvalue()


@cache
def _table() -> tuple[dict[str, object], dict[str, np.ndarray]]:
    from ik.table import ARRAYS, TORQUES
    from ik.tablefile import read_arrays

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "t.npz"
        default_table(urdf.load("baxter")).save(path)
        about, arrays = read_arrays(path, (*ARRAYS, *TORQUES))
    return {key: value for key, value in about.items() if key != "format"}, arrays


def npz(rng: random.Random | None = None) -> bytes:
    """A table; with a generator, with other numbers under a digest that fits."""
    about, arrays = json.loads(json.dumps(_table()[0])), {name: a.copy() for name, a in _table()[1].items()}
    if rng is not None:
        name = rng.choice(list(arrays))
        array = arrays[name]
        changes: tuple[Callable[[np.ndarray], np.ndarray], ...] = (
            lambda a: a * rng.choice((100.0, 0.01, -1.0, 0.0, np.nan, np.inf)),
            lambda a: a[::-1].copy(),
            lambda a: a[:-1],
            lambda a: a.astype(rng.choice(("float32", "int64", "complex128", "S8", "bool"))),
            lambda a: a[None],
            lambda a: np.where(np.arange(a.size).reshape(a.shape) == rng.randrange(a.size), 1e9, a),
            lambda _: np.array("x"),
            lambda a: a[:0],
        )
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            arrays[name] = rng.choice(changes)(array)
        if rng.random() < 0.3:
            key = rng.choice(list(about))
            about[key] = rng.choice((None, 3, "x", [], {}, [3, "x"], {"kind": "line"}, ["right_s0"]))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "t.npz"
        write_arrays(path, about, arrays)
        return path.read_bytes()


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


LINE_CSV = "time [s],s [m]\n" + "".join(f"{k / 50},{0.1 * np.sin(k / 50):.6f}\n" for k in range(50))


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
        Door("base.py", (_crane(),), load_base),
    ]
    binary = [
        Door("a.mcap", (mcap(),), _read_recording, binary=True, inside=mcap),
        Door("table.npz", (npz(),), lambda path: PathTable.load(path, _baxter()), binary=True, inside=npz),
    ]
    return {door.name: door for door in (*text, *binary)}


def _crane() -> bytes:
    return (Path(__file__).parents[2] / "examples" / "crane.py").read_bytes()


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
    with _listened() as heard, warnings.catch_warnings(record=True) as warned, _limited():
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
    elif verdict in ("read", "refused") and heard:
        verdict, said = "prints", heard[0]
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


@contextmanager
def _listened() -> Iterator[list[str]]:
    """What is printed by whom it may be, also from C++."""
    heard: list[str] = []
    for stream in (sys.stdout, sys.stderr):
        stream.flush()
    with tempfile.TemporaryFile() as file:
        copies = [(os.dup(descriptor), descriptor) for descriptor in (1, 2)]
        for _, descriptor in copies:
            os.dup2(file.fileno(), descriptor)
        try:
            yield heard
        finally:
            for copy, descriptor in copies:
                os.dup2(copy, descriptor)
                os.close(copy)
            file.seek(0)
            if said := file.read(2000):
                heard.append(said.decode("utf-8", errors="replace"))
