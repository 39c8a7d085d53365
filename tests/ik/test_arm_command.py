"""`armdyn arm show` as a user or a script calls it."""

import json

import numpy as np
import pytest
from typer.testing import CliRunner

from armdyn.errors import InputError
from pipeline.console.app import application


@pytest.fixture
def run():
    app = application(["arm"])
    return lambda *arguments: CliRunner().invoke(app, ["arm", "show", *map(str, arguments)])


def test_home_is_shown_with_units(run, baxter) -> None:
    shown = run().stdout
    assert all(name in shown for name in baxter.joint_names)
    assert "N m" in shown
    assert "speed of the tool [m/s]" in shown


def test_json_is_complete_and_consistent(run, baxter) -> None:
    content = json.loads(run("--at", "0,0,0,1,0,1,0", "--velocity", "1,0,0,1,0,0,0", "--json", "-").stdout)
    assert content["schema"] == "armdyn.arm/1"
    assert content["units"]["torque"] == ["N m"] * 7
    v, inertia = np.array(content["v"]), np.array(content["inertia"])
    assert content["kinetic_energy"] == pytest.approx(v @ inertia @ v / 2)
    torque = np.array(content["regressor"]) @ content["parameters"]
    assert torque == pytest.approx(np.array(content["coriolis"]) @ v + content["gravity"])
    assert len(content["parameter_names"]) == len(content["parameters"]) == 70
    assert content["defects"] == list(baxter.defects)


def test_a_sliding_joint_has_metres_and_newtons(run, tmp_path) -> None:
    path = tmp_path / "slide.urdf"
    path.write_text(
        '<robot name="slide"><link name="base"/><link name="carriage"><inertial><mass value="2"/><inertia ixx="0.01" '
        'iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link><joint name="lift" type="prismatic"><parent '
        'link="base"/><child link="carriage"/><axis xyz="0 0 1"/><limit lower="0" upper="1" velocity="0.5" '
        'effort="90"/></joint></robot>'
    )
    content = json.loads(run("--urdf", path, "--at", "0.5", "--json", "-").stdout)
    assert content["units"] == {
        "position": ["m"], "torque": ["N"], "energy": "J", "speed": "m/s", "force": "N"
    }  # fmt: skip
    assert content["gravity"] == pytest.approx([2 * 9.81])
    assert content["speed_ellipsoid"]["along_xyz"] == pytest.approx([0.0, 0.0, 0.5])
    assert content["force_ellipsoid"]["along_xyz"] == [None, None, pytest.approx(90 - 2 * 9.81)]


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--at", "0,x"], "--at: 'x' is not a number"),
        (["--at", "10,20,30,40,50,60,70"], "these look like degrees"),
        (["--robot", "baxtre"], "did you mean 'baxter'"),
        (["--urdf", "none.urdf"], "cannot be read"),
    ],
)
def test_bad_arguments_are_one_line(run, arguments, sentence) -> None:
    error = run(*arguments).exception
    assert isinstance(error, InputError)
    assert sentence in str(error)
    assert "\n" not in str(error)
