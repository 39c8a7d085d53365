"""Small files that become large, or never end, are refused before they do; `benchmarks/bombs.py` tries real ones."""

import io
import os
import struct
import zipfile
import zlib

import numpy as np
import pytest
from scipy.io import savemat

import urdf
from armdyn.errors import InputError
from armdyn.model_file import base_pendulum
from armdyn.recording.checks import check_run
from armdyn.recording.mcap_records import intact_records
from armdyn.run import read_run
from pipeline.imports import read_foreign
from urdf.bounds import MAX_LINE_BYTES, MAX_TEXT_MESH_BYTES
from urdf.toml_tables import TomlFileError, parse_toml_text

BALL = '<geom size="0.1" mass="1"/>'
PICTURE = struct.pack(">II", 13, 0)[:4] + b"IHDR" + struct.pack(">IIBBBBB", 20_000, 20_000, 8, 2, 0, 0, 0)
SHEET = (
    '<worksheet xmlns="http://schemas.openxmlformats.org/spreadsheetml/2006/main"><sheetData>{}</sheetData></worksheet>'
)


def in_mjcf(inside="", body=""):
    return f'<mujoco>{inside}<worldbody><body><joint name="j"/>{BALL}{body}</body></worldbody></mujoco>'


MJCF = {
    "a pipe": in_mjcf('<include file="pipe"/>'),
    "a pipe in an include": in_mjcf('<include file="inner.xml"/>'),
    "a mesh that is a pipe": in_mjcf('<asset><mesh name="m" file="pipe"/></asset>'),
    "a mesh in a folder": in_mjcf('<compiler meshdir="meshes"/><asset><mesh name="m" file="endless.stl"/></asset>'),
    "a device": in_mjcf('<include file="/dev/zero"/>'),
    "a texture": in_mjcf('<asset><texture name="t" type="2d" builtin="flat" width="30000" height="3e4"/></asset>'),
    "a cube of textures": in_mjcf('<asset><texture name="t" builtin="flat" width="4000"/></asset>'),
    "a picture": in_mjcf('<asset><texture name="t" type="2d" file="t.png"/></asset>'),
    "a height field": in_mjcf('<asset><hfield name="h" nrow="40000" ncol="40000" size="1 1 1 1"/></asset>'),
    "keys": in_mjcf('<size nkey="1000000000"/>'),
    "user data": in_mjcf('<size nuser_body="1000000000"/>'),
    "a numeric": in_mjcf('<custom><numeric name="n" size="1000000000" data="1"/></custom>'),
    "copies": in_mjcf("", f'<replicate count="100000000" offset="1 0 0">{BALL}</replicate>'),
    "copies of copies": in_mjcf(
        "", f'<replicate count="1000"><replicate count="1000" offset="1 0 0">{BALL}</replicate></replicate>'
    ),
    "a soft body": in_mjcf("", '<flexcomp name="f" type="grid" count="300 300 300" spacing="1 1 1" dim="3"/>'),
}


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "meshes").mkdir()
    for pipe in ("pipe", "meshes/endless.stl"):
        os.mkfifo(tmp_path / pipe)
    (tmp_path / "inner.xml").write_text('<mujocoinclude><include file="pipe"/></mujocoinclude>')
    (tmp_path / "t.png").write_bytes(b"\x89PNG\r\n\x1a\n" + PICTURE + zlib.compress(bytes(100)))
    return tmp_path


@pytest.mark.parametrize("name", MJCF)
def test_what_mujoco_would_wait_for_or_allocate_is_counted_before(folder, complains, name):
    (folder / "r.xml").write_text(MJCF[name])
    with complains(urdf.UrdfError):
        urdf.load(folder / "r.xml")


def test_a_robot_in_parts_with_copies_and_pictures_is_read(folder):
    """What is counted is what MuJoCo makes: the same elements within the limits are taken."""
    (folder / "inner.xml").write_text('<mujocoinclude><size nkey="3"/></mujocoinclude>')
    small = '<include file="inner.xml"/><asset><texture name="t" builtin="flat" width="16" height="16"/></asset>'
    (folder / "r.xml").write_text(in_mjcf(small, f'<replicate count="3" offset="1 0 0">{BALL}</replicate>'))
    assert urdf.load(folder / "r.xml").joint_names == ("j",)


def test_a_mesh_of_text_is_refused_by_its_size(folder, complains):
    with (folder / "m.obj").open("wb") as mesh:
        mesh.truncate(MAX_TEXT_MESH_BYTES + 1)
    (folder / "r.urdf").write_text(
        '<robot name="r"><link name="a"/><link name="b"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" '
        'ixy="0" ixz="0" iyz="0"/></inertial><collision><geometry><mesh filename="m.obj"/></geometry></collision>'
        "</link>"
        '<joint name="j" type="continuous"><parent link="a"/><child link="b"/></joint></robot>'
    )
    with complains(urdf.UrdfError):
        urdf.load(folder / "r.urdf", meshes=False)


@pytest.mark.parametrize("read", [read_run, read_foreign])
@pytest.mark.parametrize("rows", ["1" * (MAX_LINE_BYTES + 1), "0\n" * 5_000_001], ids=["a long line", "many rows"])
def test_a_table_is_measured_before_it_is_split(folder, complains, read, rows):
    (folder / "a.csv").write_text(f"time [s],load_force [N]\n0,{rows}\n")
    with complains(InputError):
        read(folder / "a.csv")


def test_a_column_that_no_sensor_gives_is_refused(folder, complains):
    rows = "".join(f"{i / 100},{(1 + i % 7) * 1e-308}\n" for i in range(60))
    (folder / "a.csv").write_text(f"time [s],load_force [N]\n{rows}")
    with complains(InputError):
        check_run(base_pendulum(), read_run(folder / "a.csv"))


def workbook(column, rows):
    stream = io.BytesIO()
    cells = "".join(f'<row><c r="{column}{i + 1}"><v>1</v></c></row>' for i in range(rows))
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("xl/worksheets/sheet1.xml", SHEET.format(cells))
    return stream.getvalue()


@pytest.mark.parametrize(("column", "rows"), [("XFD", 10), ("BXX", 11_000)])
def test_empty_cells_of_a_workbook_count(folder, complains, column, rows):
    (folder / "a.xlsx").write_bytes(workbook(column, rows))
    with complains(InputError):
        read_foreign(folder / "a.xlsx")


def test_numbers_inside_structures_of_matlab_count(folder, complains):
    cells = np.empty((1, 25), dtype=object)
    for i in range(25):
        cells[0, i] = np.zeros(1_000_000)
    savemat(folder / "a.mat", {"log": {"samples": cells}}, do_compression=True)
    assert (folder / "a.mat").stat().st_size < 1_000_000
    with complains(InputError):
        read_foreign(folder / "a.mat")


def test_records_of_a_chunk_count(monkeypatch, complains):
    monkeypatch.setattr("armdyn.recording.mcap_records.MAX_RECORDING_ROWS", 1000)
    content = bytes(9 * 1001)  # of no kind, and without content
    data = struct.pack("<QQQI", 0, 0, len(content), 0) + struct.pack("<IQ", 0, len(content)) + content
    head = b"\x89MCAP0\r\n" + b"\x01" + struct.pack("<Q", 8) + bytes(8)
    with complains(InputError):
        list(intact_records(head + b"\x06" + struct.pack("<Q", len(data)) + data, []))


@pytest.mark.parametrize("name", ["a.", "''.\"\"."])
def test_a_key_of_very_many_names_is_refused_at_once(name):
    with pytest.raises(TomlFileError, match="nested too deeply"):
        parse_toml_text(f"{name * 100_000}a = 1\n")
