"""Does a small or hostile file take the computer's memory or time: thirty bombs, each read by a command of its own.

    python benchmarks/bombs.py [--only WORD] [--json FILE]

Of each: exit status, lines, peak memory, processor time. A bomb is defused where the command ends with one line and
status 2, within 1 GB and 10 s of processor time (waiting for a pipe counts as time).
"""

import argparse
import bz2
import io
import json
import os
import resource
import signal
import struct
import subprocess
import sys
import time
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

LARGEST_MEMORY = 1e9
LONGEST = 10.0
WAIT = 25.0
"""Time after which a command is killed [s]."""


def xlsx(rows: int, column: str) -> bytes:
    """A workbook whose every row has one cell, in a column far to the right."""
    stream = io.BytesIO()
    cells = "".join(f'<row><c r="{column}{i + 1}"><v>1</v></c></row>' for i in range(rows))
    space = 'xmlns="http://schemas.openxmlformats.org/spreadsheetml/2006/main"'
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("xl/worksheets/sheet1.xml", f"<worksheet {space}><sheetData>{cells}</sheetData></worksheet>")
    return stream.getvalue()


def sheet_of_zeros(mib: int, part: str = "xl/worksheets/sheet1.xml") -> bytes:
    """A workbook one part of which expands to many spaces."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(part, b" " * (mib << 20))
    return stream.getvalue()


def mat_structure(rows: int, inner: int) -> bytes:
    """A MATLAB file with a structure array of many vectors."""
    from scipy.io import savemat

    stream = io.BytesIO()
    each = np.empty((1, rows), dtype=object)
    for i in range(rows):
        each[0, i] = np.zeros(inner)
    savemat(stream, {"log": {"samples": each}}, do_compression=True)
    return stream.getvalue()


def mat_zeros(number: int) -> bytes:
    """A MATLAB file with a vector of zeros."""
    from scipy.io import savemat

    stream = io.BytesIO()
    savemat(stream, {"a": np.zeros(number)}, do_compression=True)
    return stream.getvalue()


def mat_nested(depth: int) -> bytes:
    """A MATLAB file with structures in one another."""
    from scipy.io import savemat

    value: object = np.zeros(100)
    for _ in range(depth):
        value = {"a": value}
    stream = io.BytesIO()
    savemat(stream, {"s": value}, do_compression=True)
    return stream.getvalue()


def parquet(rows: int, columns: int) -> bytes:
    """A Parquet file whose columns are one number, run-length encoded."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    stream = io.BytesIO()
    part = pa.DictionaryArray.from_arrays(pa.array(np.zeros(rows, dtype=np.int8)), pa.array([1.0]))
    pq.write_table(pa.table({f"c{i}": part for i in range(columns)}), stream, compression="zstd", row_group_size=rows)
    return stream.getvalue()


def parquet_lists(rows: int, inner: int) -> bytes:
    """A Parquet file whose cells are long lists."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    stream = io.BytesIO()
    values = pa.array(np.zeros(rows * inner))
    lists = pa.ListArray.from_arrays(pa.array(np.arange(0, rows * inner + 1, inner, dtype=np.int32)), values)
    pq.write_table(pa.table({"time": np.arange(rows) / 100, "position": lists}), stream, compression="zstd")
    return stream.getvalue()


def parquet_text(rows: int, letters: int) -> bytes:
    """A Parquet file whose cells are one long text."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    stream = io.BytesIO()
    part = pa.DictionaryArray.from_arrays(pa.array(np.zeros(rows, dtype=np.int8)), pa.array(["x" * letters]))
    pq.write_table(pa.table({"time": np.arange(rows) / 100, "name": part}), stream, compression="zstd")
    return stream.getvalue()


def npz(number: int) -> bytes:
    """An archive of NumPy with one long array of zeros."""
    stream = io.BytesIO()
    np.savez_compressed(stream, s=np.zeros(number), about=np.array("{}"))
    return stream.getvalue()


def npy_claim() -> bytes:
    """An archive of NumPy whose array says that it has 2^40 numbers."""
    stream, head = io.BytesIO(), io.BytesIO()
    np.lib.format.write_array_header_1_0(head, {"descr": "<f8", "fortran_order": False, "shape": (2**40,)})
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("s.npy", head.getvalue() + bytes(800))
        archive.writestr("about.npy", head.getvalue())
    return stream.getvalue()


def ros1_record(fields: dict[str, bytes], data: bytes) -> bytes:
    """A record of a ROS 1 bag."""
    head = b"".join(struct.pack("<I", len(k) + 1 + len(v)) + k.encode() + b"=" + v for k, v in fields.items())
    return struct.pack("<I", len(head)) + head + struct.pack("<I", len(data)) + data


def bag(chunks: int, mib: int) -> bytes:
    """A ROS 1 bag with chunks of zeros."""
    packed = bz2.compress(bytes(mib << 20))
    head = {"op": b"\x05", "compression": b"bz2", "size": struct.pack("<I", mib << 20)}
    return b"#ROSBAG V2.0\n" + chunks * ros1_record(head, packed)


def mcap(chunks: int, mib: int) -> bytes:
    """An MCAP file with chunks of zeros."""
    import zstandard

    packed = zstandard.ZstdCompressor().compress(bytes(mib << 20))
    data = struct.pack("<QQQI", 0, 0, mib << 20, 0) + struct.pack("<I", 4) + b"zstd" + struct.pack("<Q", len(packed))
    record = b"\x06" + struct.pack("<Q", len(data) + len(packed)) + data + packed
    head = b"\x01" + struct.pack("<Q", 8) + bytes(8)
    return b"\x89MCAP0\r\n" + head + chunks * record + b"\x89MCAP0\r\n"


def zstd(mib: int) -> bytes:
    """Compressed zeros."""
    import zstandard

    return zstandard.ZstdCompressor().compress(bytes(mib << 20))


def urdf(inside: str = "", head: str = "") -> str:
    """A URDF with one joint."""
    return (
        f'<?xml version="1.0"?>{head}<robot name="r"><link name="a"/><link name="b"><inertial><mass value="1"/>'
        '<inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial>'
        f'{inside}</link><joint name="j" type="revolute"><parent link="a"/><child link="b"/><axis xyz="0 1 0"/>'
        '<limit lower="-1" upper="1" velocity="1" effort="10"/></joint></robot>'
    )


def mjcf(inside: str, body: str = "") -> str:
    """An MJCF with one hinge."""
    return (
        f'<mujoco>{inside}<worldbody><body name="a"><joint name="j"/><geom size="0.1" mass="1"/>{body}</body>'
        "</worldbody></mujoco>"
    )


def laughs(element: str) -> str:
    """Entities that expand to 10^9 letters."""
    parts = "".join(f'<!ENTITY l{i + 1} "{f"&l{i};" * 10}">' for i in range(9))
    return f'<!DOCTYPE {element} [<!ENTITY l0 "ha">{parts}]>'


def stl(claimed: int, triangles: int) -> bytes:
    """A binary STL that says that it has many triangles."""
    return bytes(80) + struct.pack("<I", claimed) + bytes(50 * triangles)


def png(side: int) -> bytes:
    """A black picture."""

    def part(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    packer = zlib.compressobj(9)
    rows = b"".join(packer.compress(bytes(1 + 3 * side)) for _ in range(side)) + packer.flush()
    return (
        b"\x89PNG\r\n\x1a\n"
        + part(b"IHDR", struct.pack(">IIBBBBB", side, side, 8, 2, 0, 0, 0))
        + part(b"IDAT", rows)
        + part(b"IEND", b"")
    )


NEW_URDF, NEW_MJCF = "new arm m.toml --urdf r.urdf", "new arm m.toml --mjcf r.xml"
COMPARE = "compare m.toml a.csv"
MESH = '<collision><geometry><mesh filename="{}"/></geometry></collision>'
Bomb = tuple[str, dict[str, "Callable[[], bytes | str]"]]
TO_GUESS, ASSET = "import a.{} --output o --guess", "<asset>{}</asset>"
COPIES = '<replicate count="{}" offset="1 0 0">{}</replicate>'
TEXTURE = '<texture name="t{}" type="2d" builtin="flat" width="30000" height="30000"/>'
BALL = '<geom size="0.1"/>'
SPIKE = "".join(f"{i / 100},{1e200 if i == 50 else 0.8}\n" for i in range(300))


def robot(inside: str, **files: "Callable[[], bytes | str]") -> Bomb:
    """A URDF that refers to other files."""
    return NEW_URDF, {"r.urdf": lambda: urdf(inside), **{k.replace("_", "."): v for k, v in files.items()}}


def simulated(inside: str = "", body: str = "", **files: "Callable[[], bytes | str]") -> Bomb:
    """An MJCF that refers to other files."""
    return NEW_MJCF, {"r.xml": lambda: mjcf(inside, body), **{k.replace("_", "."): v for k, v in files.items()}}


BOMBS: dict[str, Bomb] = {
    "csv: a line of 200 MB": (COMPARE, {"a.csv": lambda: "time [s],load_force [N]\n0," + "1" * 200_000_000 + "\n"}),
    "csv: a header of 200 MB": (COMPARE, {"a.csv": lambda: "x," * 100_000_000 + "\n"}),
    "csv: cells": (
        COMPARE, {"a.csv": lambda: "time [s]," + "a," * 1898 + "a\n" + (1899 * "0," + "0\n") * 66_000},
    ),
    "csv: 250 MB of quotes": (COMPARE, {"a.csv": lambda: 'time [s],load_force [N]\n"' + "0\n" * 125_000_000}),
    "csv: a number of 1e200": (COMPARE, {"a.csv": lambda: "time [s],load_force [N]\n" + SPIKE}),
    "foreign csv: lists": (
        TO_GUESS.format("csv"), {"a.csv": lambda: "t,p\n" + ('0,"[' + "1," * 99_999 + '1]"\n') * 1000},
    ),
    "foreign csv: cells": (
        TO_GUESS.format("csv"),
        {"a.csv": lambda: ",".join(f"a{i}" for i in range(1900)) + "\n" + ("0," * 1899 + "0\n") * 66_000},
    ),
    "foreign csv: quotes": (TO_GUESS.format("csv"), {"a.csv": lambda: 't,p\n0,"' + "0\n" * 125_000_000}),
    "xlsx: empty columns": (TO_GUESS.format("xlsx"), {"a.xlsx": lambda: xlsx(60_000, "BXX")}),
    "xlsx: a sheet of 4 GB": (TO_GUESS.format("xlsx"), {"a.xlsx": lambda: sheet_of_zeros(4000)}),
    "xlsx: texts of 60 MB": (TO_GUESS.format("xlsx"), {"a.xlsx": lambda: xlsx_texts(60)}),
    "mat: a structure": (TO_GUESS.format("mat"), {"a.mat": lambda: mat_structure(300, 1_000_000)}),
    "mat: cells": (TO_GUESS.format("mat"), {"a.mat": lambda: mat_structure(2_000_000, 1)}),
    "mat: zeros": (TO_GUESS.format("mat"), {"a.mat": lambda: mat_zeros(200_000_000)}),
    "mat: nested": (TO_GUESS.format("mat"), {"a.mat": lambda: mat_nested(60)}),
    "parquet: columns": (TO_GUESS.format("parquet"), {"a.parquet": lambda: parquet(4_000_000, 1500)}),
    "parquet: lists": (TO_GUESS.format("parquet"), {"a.parquet": lambda: parquet_lists(50_000, 1500)}),
    "parquet: texts": (TO_GUESS.format("parquet"), {"a.parquet": lambda: parquet_text(4_000_000, 100_000)}),
    "npz: zeros": ("ik show a.npz", {"a.npz": lambda: npz(600_000_000)}),
    "npz: says 8 TB": ("ik show a.npz", {"a.npz": npy_claim}),
    "bag: chunks of 500 MB": (TO_GUESS.format("bag"), {"a.bag": lambda: bag(40, 500)}),
    "bag: chunks of 60 MB": (TO_GUESS.format("bag"), {"a.bag": lambda: bag(400, 60)}),
    "mcap: chunks of 60 MB": (COMPARE.replace(".csv", ".mcap"), {"a.mcap": lambda: mcap(400, 60)}),
    "db3: 4 GB": (TO_GUESS.format("db3"), {"a.db3": lambda: zstd(4000)}),
    "toml: nested": (COMPARE, {"a.toml": lambda: "a = " + "[" * 100_000 + "]" * 100_000}),
    "toml: dotted": (COMPARE, {"a.toml": lambda: "a." * 400_000 + "a = 1\n"}),
    "toml: quoted": (COMPARE, {"a.toml": lambda: "''.\"\"." * 100_000 + "a = 1\n"}),
    "toml: many tables": (COMPARE, {"m.toml": lambda: "".join("[" + "a." * 90 + f"b{i}]\n" for i in range(4000))}),
    "urdf: entities": (NEW_URDF, {"r.urdf": lambda: urdf("<visual>&l9;</visual>", laughs("robot"))}),
    "urdf: nested": robot("<a>" * 500_000 + "</a>" * 500_000),
    "urdf: many links": robot("</link>" + '<link name="l"/>' * 1_000_000 + '<link name="z">'),
    "urdf: a mesh's count": robot(MESH.format("m.stl"), m_stl=lambda: stl(4_000_000_000, 100)),
    "urdf: an stl of 60 MB": robot(MESH.format("m.stl"), m_stl=lambda: stl(1_250_000, 1_250_000)),
    "urdf: an obj of 60 MB": robot(MESH.format("m.obj"), m_obj=lambda: "v 0 0 0\n" * 3 + "f 1 2 3\n" * 7_000_000),
    "urdf: an obj of 20 MB": robot(MESH.format("m.obj"), m_obj=lambda: "v 0 0 0\n" * 3 + "f 1 2 3\n" * 2_500_000),
    "urdf: a dae of entities": robot(MESH.format("m.dae"), m_dae=lambda: laughs("COLLADA") + "<COLLADA>&l9;</COLLADA>"),
    "mjcf: a pipe": simulated('<include file="pipe"/>'),
    "mjcf: a mesh that is a pipe": simulated(ASSET.format('<mesh name="m" file="pipe.stl"/>')),
    "mjcf: includes itself": simulated('<include file="r.xml"/>'),
    "mjcf: an endless file": simulated('<include file="/dev/zero"/>'),
    "mjcf: a pipe of an include": simulated('<include file="i.xml"/>', i_xml=lambda: mjcf('<include file="pipe"/>')),
    "mjcf: textures": simulated(ASSET.format(TEXTURE.format(0) + TEXTURE.format(1))),
    "mjcf: a picture": simulated(ASSET.format('<texture name="t" type="2d" file="t.png"/>'), t_png=lambda: png(20_000)),
    "mjcf: keys": simulated('<size nkey="1000000000"/>'),
    "mjcf: user data": simulated('<size nuserdata="1000000000" nuser_body="100000000"/>'),
    "mjcf: a numeric": simulated('<custom><numeric name="n" size="1000000000" data="1"/></custom>'),
    "mjcf: memory": simulated('<size memory="500G"/>'),
    "mjcf: a height field": simulated(ASSET.format('<hfield name="h" nrow="40000" ncol="40000" size="1 1 1 1"/>')),
    "mjcf: copies": simulated("", COPIES.format(100_000_000, BALL)),
    "mjcf: copies of copies": simulated("", COPIES.format(1000, COPIES.format(1000, COPIES.format(1000, BALL)))),
    "mjcf: a soft body": simulated(
        "", '<flexcomp name="f" type="grid" count="300 300 300" spacing="1 1 1" dim="3"/>'
    ),
    "mjcf: entities": (NEW_MJCF, {"r.xml": lambda: laughs("mujoco") + mjcf("<custom>&l9;</custom>")}),
    "effects: 4 GB of zeros": (f"{COMPARE} --effects e.py", {"e.py": lambda: "x = bytes(4 * 10**9)\n"}),
    "map: nested": (
        "import f.csv --map map.toml --output o",
        {"map.toml": lambda: "[columns]\nx = " + "{a=" * 50_000, "f.csv": lambda: "t,p\n0,1\n"},
    ),
    "spec: many files": (
        "batch spec.toml --output o", {"spec.toml": lambda: '[[recordings]]\nmodel = "m.toml"\nruns = ["/**/*"]\n'},
    ),
}  # fmt: skip
"""The command, and the files that it reads."""


def xlsx_texts(mib: int) -> bytes:
    """A workbook with many texts."""
    stream = io.BytesIO()
    space = 'xmlns="http://schemas.openxmlformats.org/spreadsheetml/2006/main"'
    text = "<si><t>ab</t></si>"
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("xl/sharedStrings.xml", f"<sst {space}>" + text * ((mib << 20) // len(text)) + "</sst>")
        archive.writestr("xl/worksheets/sheet1.xml", f"<worksheet {space}><sheetData/></worksheet>")
    return stream.getvalue()


def try_bomb(command: str, files: "dict[str, Callable[[], bytes | str]]") -> dict[str, float | int | str]:
    """Exit status, lines, peak memory [bytes] and processor time [s] of a command that reads a bomb."""
    with TemporaryDirectory() as scratch:
        folder = Path(scratch)
        (folder / "m.toml").write_text('base = "pendulum"\neffects = []\n')
        (folder / "a.csv").write_text(
            "time [s],load_force [N]\n" + "".join(f"{i / 100},{0.8 + 0.01 * (i % 7)}\n" for i in range(300))
        )
        for pipe in ("pipe", "pipe.stl"):
            os.mkfifo(folder / pipe)
        for name, make in files.items():
            content = make()
            (folder / name).write_bytes(content if isinstance(content, bytes) else content.encode())
            del content
        begun = time.monotonic()
        process = subprocess.Popen(
            [sys.executable, "-c", "from pipeline.cli import main; main()", *command.split()], cwd=folder,
            stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, start_new_session=True,
            preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (4 << 30, 4 << 30)),
        )  # fmt: skip
        peak = 0
        while process.poll() is None and time.monotonic() - begun < WAIT:
            peak = max(peak, memory_of_session(process.pid))
            time.sleep(0.01)
        late = process.poll() is None
        if late:
            os.killpg(process.pid, signal.SIGKILL)
        assert process.stderr is not None
        said = process.stderr.read().decode(errors="replace").strip()
        _, status, used = (process.pid, process.wait(), time.monotonic() - begun)
    return {"status": status, "lines": said.count("\n") + 1, "memory": peak, "seconds": used, "said": said[:300]}


def memory_of_session(session: int) -> int:
    """Resident memory of a process and those that it started [bytes]."""
    total = 0
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                fields = (entry / "stat").read_text().rpartition(")")[2].split()
                if int(fields[3]) == session:
                    total += int(fields[21]) * os.sysconf("SC_PAGE_SIZE")
            except (OSError, IndexError, ValueError):
                continue
    return total


def main() -> None:
    """Try every bomb, and print those that went off."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default="")
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    found = {name: try_bomb(*bomb) for name, bomb in BOMBS.items() if given.only in name}
    for name, one in found.items():
        fine = (
            one["status"] == 2 and one["lines"] == 1 and one["memory"] <= LARGEST_MEMORY and one["seconds"] <= LONGEST
        )
        figures = f"status {one['status']}, {one['lines']} lines, {one['memory'] / 1e6:.0f} MB, {one['seconds']:.1f} s"
        print(f"{'      ' if fine else 'WRONG '}{name}: {figures}: {one['said']}", flush=True)
    if given.json is not None:
        given.json.write_text(json.dumps(found, indent=1))


if __name__ == "__main__":
    main()
