"""`armdyn ik` and `armdyn arm` as a user or a script calls them; what else they answer is among the golden answers."""

import json

import numpy as np
import pytest
from command import called
from robots import joint, link, robot
from scipy.spatial.transform import Rotation

pytestmark = pytest.mark.usefixtures("armdyn")


def answer(*arguments) -> dict:
    status, out, _ = called(*arguments, "--json", "-")
    assert status == 0
    return json.loads(out)


def test_json_is_the_table_whose_tool_poses_are_reached_by_its_postures(saved, table, baxter, tool_poses) -> None:
    content = answer("ik", "show", saved)
    assert np.array_equal(content["q"], table.q)
    rotation, position = tool_poses(baxter, content["q"][::100])
    assert np.abs(position - content["tool_position"][::100]).max() < 1e-9
    assert np.abs(rotation - Rotation.from_quat(content["tool_quaternion"][::100]).as_matrix()).max() < 1e-9


def test_a_path_of_ones_own_is_built_shown_and_reported(refused, tmp_path, complains) -> None:
    (tmp_path / "circle.toml").write_text(
        'kind = "circle"\ncentre = [0.55, -0.31, -0.15]\nradius = 0.1\nnormal = [0, 0, 1]\nstart = [0, -1, 0]\n'
        "tool_rpy = [3.141592653589793, 0, 3.141592653589793]\n"
    )
    complains.line(refused("ik", "build", "--path", "circle.toml"))
    assert called("ik", "build", "--path", "circle.toml", "--out", "circle.npz")[0] == 0
    content = answer("ik", "show", "circle.npz", "--report", "circle.html")
    assert content["path"]["kind"] == "circle"
    assert np.ptp(np.array(content["tool_position"])[:, 0]) == pytest.approx(0.2, abs=1e-6)
    page = (tmp_path / "circle.html").read_text()
    assert "Joint margins" in page
    assert "right_gripper_base_link" in page


SEARCH = ["ik", "build", "--search"]
BAD = [
    [*SEARCH, "--path", "x.toml"], [*SEARCH, "--core=-1,1"], [*SEARCH, "--direction", "0,0"],
    [*SEARCH, "--extent", "a,b"], [*SEARCH, "--joints", "right_s0,right_s1"],
    ["ik", "volume", "--low", "0,0,0", "--high", "0,1,1", "--out", "v.zarr"],
    ["arm", "show", "--at", "10,20,30,40,50,60,70"], ["arm", "show", "--urdf", "none.urdf"],
]  # fmt: skip


@pytest.mark.parametrize("arguments", BAD)
def test_bad_arguments_are_one_line(refused, arguments, complains) -> None:
    complains.line(refused(*arguments))


def test_a_volume_is_built_and_continued_from_the_command_line() -> None:
    arguments = ["ik", "volume", "--low=0.5,-0.4,-0.2", "--high=0.6,-0.2,-0.1", "--counts", "11,20,10"]
    first, second = (answer(*arguments, "--processes", "1", "--out", "v.zarr") for _ in range(2))
    assert first["schema"] == "armdyn.volume/1"
    assert (first["solved"], first["resumed"]) == (2200, 0)
    assert (second["solved"], second["resumed"]) == (0, 2200)
    assert first["reached"] == 1.0
    assert first["neighbours_apart"] == 0.0


def test_a_sliding_joint_has_metres_and_newtons(tmp_path) -> None:
    limit = '<limit lower="0" upper="1" velocity="0.5" effort="90"/>'
    slide = joint("lift", "base", "carriage", "0 0 1", "prismatic", limit)
    (tmp_path / "slide.urdf").write_text(robot('<link name="base"/>', link("carriage", 2.0), slide))
    content = answer("arm", "show", "--urdf", "slide.urdf", "--at", "0.5", "--velocity", "0.2")
    assert content["units"] == {"position": ["m"], "torque": ["N"], "energy": "J", "speed": "m/s", "force": "N"}
    assert content["gravity"] == pytest.approx([2 * 9.81])
    assert content["kinetic_energy"] == pytest.approx(0.5 * 2 * 0.2**2)
    assert np.array(content["regressor"]) @ content["parameters"] == pytest.approx([2 * 9.81])
    assert content["speed_ellipsoid"]["along_xyz"] == pytest.approx([0.0, 0.0, 0.5])
    assert content["force_ellipsoid"]["along_xyz"] == [None, None, pytest.approx(90 - 2 * 9.81)]
