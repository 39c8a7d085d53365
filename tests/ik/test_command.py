"""`armdyn ik` as a user or a script calls it."""

import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

import ik
from armdyn.errors import InputError
from pipeline.console.app import application


@pytest.fixture
def run():
    app = application(["ik"])
    return lambda *arguments: CliRunner().invoke(app, ["ik", *map(str, arguments)])


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
    along = ("q", "dq_ds", "tool_position", "tool_quaternion", "speed_limit", "acceleration_limit", "margin")
    for key in (*along, "torque_acceleration_range", "torque_share", "manipulability"):
        assert len(content[key]) == nodes
    assert min(content["margin"]) == pytest.approx(table.joint_margin)


def test_json_tool_poses_are_reached_by_the_json_postures(run, saved, baxter, tool_poses) -> None:
    content = json.loads(run("show", saved, "--json", "-").stdout)
    rotation, position = tool_poses(baxter, content["q"][::100])
    assert np.abs(position - content["tool_position"][::100]).max() < 1e-9
    assert np.abs(rotation - Rotation.from_quat(content["tool_quaternion"][::100]).as_matrix()).max() < 1e-9


def test_build_writes_a_table_that_show_reads(run, tmp_path) -> None:
    built = run("build", "--out", tmp_path / "new.npz", "--json", tmp_path / "new.json")
    assert built.exit_code == 0
    assert "core speed" in built.stdout
    shown = run("show", tmp_path / "new.npz")
    assert "joint margin: 0.6" in shown.stdout
    assert json.loads((tmp_path / "new.json").read_text())["robot"] == "baxter"


def test_bad_files_are_bad_input(run, saved, tmp_path) -> None:
    saved.write_bytes(b"not a table")
    assert isinstance(run("show", saved).exception, ik.StaleTableError)
    assert isinstance(run("show", tmp_path / "none.npz").exception, InputError)
    assert "unknown robot 'baxtre'" in str(run("build", "--robot", "baxtre").exception)


def test_a_path_of_ones_own_is_built_shown_and_reported(run, tmp_path) -> None:
    path = tmp_path / "circle.toml"
    path.write_text(
        'kind = "circle"\ncentre = [0.55, -0.31, -0.15]\nradius = 0.1\nnormal = [0, 0, 1]\nstart = [0, -1, 0]\n'
        "tool_rpy = [3.141592653589793, 0, 3.141592653589793]\n"
    )
    assert "say where to write the table with --out" in str(run("build", "--path", path).exception)
    assert run("build", "--path", path, "--out", tmp_path / "circle.npz").exit_code == 0
    shown = run(
        "show", tmp_path / "circle.npz", "--report", tmp_path / "circle.html", "--json", tmp_path / "circle.json"
    )
    assert "path: circle" in shown.stdout
    content = json.loads((tmp_path / "circle.json").read_text())
    assert content["path"]["kind"] == "circle"
    assert np.ptp(np.array(content["tool_position"])[:, 0]) == pytest.approx(0.2, abs=1e-6)
    page = (tmp_path / "circle.html").read_text()
    assert "Joint margins" in page
    assert "right_gripper_base_link" in page


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["build", "--search", "--path", "x.toml"], "--search and --path exclude each other"),
        (["build", "--search", "--core=-1,1"], "--core: -1,1 m does not lie within --extent"),
        (["build", "--search", "--direction", "0,0"], "--direction: '0,0' has 2 numbers; give 3"),
        (["build", "--search", "--extent", "a,b"], "--extent: 'a' is not a number"),
        (["build", "--robot", "baxter", "--joints", "right_s0,right_s1", "--search"], "2 joints cannot hold a tool"),
        (["volume", "--low", "0,0,0", "--high", "0,1,1", "--out", "v.zarr"], "span nothing"),
    ],
)
def test_bad_arguments_are_one_line(run, arguments, sentence) -> None:
    error = run(*arguments).exception
    assert isinstance(error, InputError)
    assert sentence in str(error)


def test_a_volume_is_built_and_continued_from_the_command_line(run, tmp_path) -> None:
    arguments = ["volume", "--low=0.5,-0.4,-0.2", "--high=0.6,-0.2,-0.1", "--counts", "11,20,10", "--processes", "1"]
    arguments += ["--out", tmp_path / "v.zarr", "--json", "-"]
    first, second = (json.loads(run(*arguments).stdout) for _ in range(2))
    assert first["schema"] == "armdyn.volume/1"
    assert (first["solved"], first["resumed"]) == (2200, 0)
    assert (second["solved"], second["resumed"]) == (0, 2200)
    assert first["reached"] == 1.0
    assert first["neighbours_apart"] == 0.0
