"""Good files of every kind that comes from outside, and some that are well formed and wrong inside."""

import io
import json
import random
import tempfile
import warnings
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

import urdf
from ik import default_table
from ik.table_archive import write_arrays
from pipeline.batch.work import JobOutcome

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
[background]
width = 0.3
values = { "joint_viscous_friction.coefficient[j1]" = 0.01, "torque_offset.torque[j0]" = -0.02 }
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
    writer.add_metadata("armdyn.sidecar", {"toml": str(wrong(SIDECAR))})
    for k in range(60):
        for topic, field, value in (("/gripper", "x", 0.05 * np.sin(k / 9)), ("/load", "force", 0.8 + 0.01 * (k % 3))):
            message = wrong({str(wrong("time")): wrong(k / 50), str(wrong(field)): wrong(float(value))})
            writer.add_message(ids[topic], k, json.dumps(message).encode(), k)
    writer.finish()
    return stream.getvalue()


@cache
def _table() -> tuple[dict[str, object], dict[str, np.ndarray]]:
    from ik.table import ARRAY_AXES
    from ik.table_archive import read_arrays

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "t.npz"
        default_table(urdf.load("baxter")).save(path)
        about, arrays = read_arrays(path, ARRAY_AXES)
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


LINE_CSV = "time [s],s [m]\n" + "".join(f"{k / 50},{0.1 * np.sin(k / 50):.6f}\n" for k in range(50))


def crane() -> bytes:
    return (Path(__file__).parents[2] / "examples" / "crane.py").read_bytes()


def foreign_csv(separator: str = ",", rows: int = 60) -> str:
    """A log as somebody else's program writes it."""
    time = np.arange(rows) / 50
    columns = {"timestamp_ms": 1000 * time, "J1 pos (deg)": 20 * np.sin(time), "J2 pos (deg)": 10 * np.cos(time),
               "J1 trq": 2 * np.cos(2 * time), "J2 trq": np.sin(3 * time), "state": np.floor(time)}  # fmt: skip
    table = "\n".join(separator.join(f"{value:.5f}" for value in row) for row in zip(*columns.values(), strict=True))
    return separator.join(columns) + "\n" + table + "\n"


def list_csv(rows: int = 60) -> str:
    """A log with lists in its cells, and the registers of a servo."""
    time = np.arange(rows) / 50
    lines = [
        f"{t:.3f},\"['j1', 'j0']\",\"[{np.sin(t):.5f}, {t:.5f}]\",[{t:.2f};0.1],{int(2e3 + 5e2 * t)},{65535 - i}"
        for i, t in enumerate(time)
    ]
    return "\n".join(["t,name,position,q_cmd [rad],Present_Position_2,Present_Current_2", *lines]) + "\n"


MAP = """time = { column = "timestamp_ms", unit = "ms" }
[columns]
"J1 pos" = { channel = "q.j0", unit = "deg", sign = -1, offset = "90 deg" }
"J1 trq" = { channel = "tau.j0", unit = "A", torque_constant = "0.12 N m/A", gear_ratio = 100 }
"J2 pos" = { channel = "q.j1", unit = "deg" }
"state" = { channel = "duty.j1", unit = "1", scale = 0.001, negative = "bit 10" }
[commands]
time = { column = "timestamp_ms", unit = "ms" }
[commands.columns]
"J1 pos" = { channel = "q_cmd.j0", unit = "deg", late = "-3 ms" }
"""
CALIBRATION = """date = 2026-05-04T14:30:00
source = "PORT"
offset = { value = 84213.4, std = 1.2, unit = "count" }
scale = { value = 2.3e-6, std = 1e-9, unit = "N/count" }
noise = { value = 0.003, unit = "N" }
"""
SPEC = """task = "compare"
[[recordings]]
model = "m.toml"
runs = ["a.csv"]
times = { "a.csv" = 2026-05-04T14:30:00 }
[changes]
false_alarms = 0.01
"""
OUTCOME = {
    "verdict": "explained", "sentence": "s", "problem": "", "passing": False, "explained": 0.9,
    "effects": ["quadratic_drag"], "chi2_per_sample": 1.0, "intervals_hold": True,
    "channels": {"load_force": {"unit": "N", "rmse": 0.003, "noise_std": 0.003}},
    "parameters": {"mass": {"unit": "kg", "value": 0.08, "std": 0.001}}, "duration": 5.0, "seconds": 0.3,
}  # fmt: skip
JOURNAL = "".join(JobOutcome(f"k{i}", **OUTCOME).line + "\n" for i in range(3))


def parquet(rng: random.Random | None = None) -> bytes:
    """A table with the channels of the toy arm; with a generator, with columns of other kinds and sizes."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    rows = 60
    time = np.arange(rows) / 50
    columns: dict[str, Sequence[Any] | np.ndarray] = {
        "time": time,
        "q.j0 [rad]": np.sin(time),
        "tau.j0 [N m]": np.cos(3 * time),
    }
    if rng is not None:
        odd: tuple[Sequence[Any] | np.ndarray, ...] = (
            np.full(rows, np.nan), np.full(rows, 1e300), np.arange(rows) * 10**15, ["text"] * rows, [None] * rows,
            [[1.0, 2.0]] * rows, [[1.0]] * (rows - 1) + [[]], np.zeros(rows, dtype="M8[ns]"), np.full(rows, np.inf),
            [b"x" * 100] * rows, time[::-1].copy(), np.zeros(rows, dtype=bool), [{"a": 1}] * rows,
        )  # fmt: skip
        columns[rng.choice([*columns, "other", "a" * 500, ""])] = rng.choice(odd)
        if rng.random() < 0.2:
            columns = {name: values[:0] for name, values in columns.items()}
        elif rng.random() < 0.1:
            columns = {name: np.zeros(6_000_000) for name in columns}
    stream = io.BytesIO()
    pq.write_table(pa.table(columns), stream, compression="zstd")
    return stream.getvalue()
