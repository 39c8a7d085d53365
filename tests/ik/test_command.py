"""`armdyn ik` as a user or a script calls it."""

import json

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

import ik
from armdyn.errors import InputError
from pipeline.commands.ik import register


@pytest.fixture
def run():
    app = typer.Typer()
    register(app)
    return lambda *arguments: CliRunner().invoke(app, ["ik", *map(str, arguments)])


@pytest.fixture
def saved(table, tmp_path):
    path = tmp_path / "table.npz"
    table.save(path)
    return path


def test_show_prints_the_contracts_json_and_nothing_else(run, saved, table) -> None:
    result = run("show", saved, "--json", "-")
    content = json.loads(result.stdout)
    assert list(content)[:12] == [
        "schema",
        "robot",
        "joints",
        "tool_link",
        "tool_offset",
        "s",
        "q",
        "dq_ds",
        "tool_position",
        "tool_quaternion",
        "speed_limit",
        "joint_margin",
    ]
    assert content["schema"] == "armdyn.ik/1"
    assert content["tool_link"] == "right_gripper"
    assert content["tool_offset"] == [0.0, 0.0, 0.03]
    assert np.array_equal(content["q"], table.q)
    assert content["joint_margin"] == table.joint_margin
    nodes = len(content["s"])
    assert all(len(content[key]) == nodes for key in ("q", "dq_ds", "tool_position", "tool_quaternion", "speed_limit"))


def test_json_tool_poses_are_reached_by_the_json_postures(run, saved, yourdf) -> None:
    content = json.loads(run("show", saved, "--json", "-").stdout)
    for node in range(0, len(content["s"]), 100):
        yourdf.update_cfg(dict(zip(content["joints"], content["q"][node], strict=True)))
        pose = yourdf.get_transform(content["tool_link"], "base")
        tool = pose[:3, 3] + pose[:3, :3] @ content["tool_offset"]
        assert tool == pytest.approx(content["tool_position"][node], abs=1e-9)
        x, y, z, w = content["tool_quaternion"][node]
        down = [2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)]
        assert pose[:3, 2] == pytest.approx(down, abs=1e-9)


def test_build_writes_a_table_that_show_reads(run, tmp_path) -> None:
    built = run("build", "--out", tmp_path / "new.npz", "--json", tmp_path / "new.json")
    assert built.exit_code == 0
    assert "core speed" in built.stdout
    shown = run("show", tmp_path / "new.npz")
    assert "joint margin 0.6" in shown.stdout
    assert json.loads((tmp_path / "new.json").read_text())["robot"] == "baxter"


def test_report_is_one_page_with_every_joint(run, saved, tmp_path, baxter) -> None:
    assert run("show", saved, "--report", tmp_path / "ik.html").exit_code == 0
    page = (tmp_path / "ik.html").read_text()
    assert all(name in page for name in baxter.joint_names)
    assert "Torque at rest" in page


def test_bad_files_are_bad_input(run, saved, tmp_path) -> None:
    saved.write_bytes(b"not a table")
    assert isinstance(run("show", saved).exception, ik.StaleTableError)
    assert isinstance(run("show", tmp_path / "none.npz").exception, InputError)
    assert "unknown robot 'baxtre'" in str(run("build", "--robot", "baxtre").exception)
