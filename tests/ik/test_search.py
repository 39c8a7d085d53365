"""Lines that were searched for: on other arms, with the promises that the search makes."""

import numpy as np
import pytest
import yourdfpy

import ik
import urdf
from ik.search import Demand, search_line, upright_rotation

OTHERS = ("ur5", "panda", "talos_arm")


@pytest.fixture(scope="module", params=OTHERS)
def other(request):
    robot = urdf.load(request.param)
    return robot, ik.build_line_table(robot)


def test_tools_of_other_arms_are_on_their_lines_between_nodes_by_yourdfpy(other) -> None:
    robot, table = other
    model = yourdfpy.URDF.load(str(robot.urdf_path), load_meshes=False)
    s = np.random.default_rng(3).uniform(robot.line.s_min, robot.line.s_max, 20)
    for at, q in zip(s, table.posture(s).q, strict=True):
        model.update_cfg(dict(zip(robot.joint_names, q, strict=True)))
        pose = model.get_transform(robot.tool_frame, model.base_link)
        assert np.abs(pose[:3, 3] - robot.line.position(at)).max() < 1e-9
        assert np.abs(pose[:3, :3] - robot.line.rotation).max() < 1e-8


def test_derivatives_of_other_arms_agree_with_differences_of_fourth_order(other) -> None:
    _, table = other
    step, q = table.s[1] - table.s[0], table.q
    differences = (8 * (q[3:-1] - q[1:-3]) - (q[4:] - q[:-4])) / (12 * step)
    assert np.abs(differences - table.dq_ds[2:-2]).max() < 1e-8


def test_lines_found_keep_what_the_settings_say_of_them(other) -> None:
    robot, table = other
    assert table.speed_limit_at(np.linspace(*robot.line.core, 301)).min() >= robot.line.core_speed
    assert table.joint_margin > 0.45
    assert table.torque_share.max() < 1.0
    collisions = urdf.CollisionModel(robot)
    assert all(collisions.touching(q) is None for q in table.q[::40])


@pytest.mark.slow
def test_a_search_finds_a_fast_free_line_within_the_limits() -> None:
    robot = urdf.load("ur5")
    said: list[str] = []
    demand = Demand(s_min=-0.1, s_max=0.1, core=(-0.05, 0.05))
    found = search_line(robot, demand, progress=said.append)
    assert any("m/s with" in sentence for sentence in said)
    assert found.core_speed >= found.line.core_speed
    assert found.line.origin[0] > 0
    assert found.clearance > 0
    collisions = urdf.CollisionModel(robot)
    # Searching beats choosing by eye, half a metre in front of the arm, on both counts together.
    naive = urdf.Line(
        np.array([0.5, 0.0, 0.3]), np.array([0.0, 1.0, 0.0]), found.line.rotation, -0.1, 0.1, (-0.05, 0.05), 1.0
    )
    by_eye = ik.build_line_table(robot, naive)
    table = ik.build_line_table(robot, found.line)
    worth = [
        t.speed_limit_at(np.linspace(-0.05, 0.05, 51)).min() * min(1.0, t.joint_margin / 0.5) for t in (table, by_eye)
    ]
    assert worth[0] > 1.2 * worth[1]
    assert all(collisions.touching(q) is None for q in table.q[::20])


def test_a_line_longer_than_the_arm_is_not_found() -> None:
    with pytest.raises(ik.UnreachableError, match="no line of 4 m"):
        search_line(urdf.load("ur5"), Demand(s_min=-2.0, s_max=2.0, core=(-1.0, 1.0)))


def test_the_nearest_right_angled_orientation_is_a_rotation() -> None:
    rng = np.random.default_rng(0)
    for _ in range(50):
        rotation, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        rotation *= np.sign(np.linalg.det(rotation))
        nearest = upright_rotation(rotation)
        assert np.linalg.det(nearest) == pytest.approx(1.0)
        assert sorted(np.abs(nearest).ravel()) == [0.0] * 6 + [1.0] * 3
    tilted = np.array([[0.0, -1.0, 0.02], [-1.0, 0.0, 0.01], [0.01, 0.02, -1.0]])
    assert upright_rotation(tilted).tolist() == [[0.0, -1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]
