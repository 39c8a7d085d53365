"""Paths in SE(3) and the tables of them."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import ik
import urdf
from armdyn.errors import InputError
from ik.pathfile import path_from_description

DOWN = np.diag([-1.0, 1.0, -1.0])


def circle(follow: bool = False) -> ik.CirclePath:
    end = 0.12 * (np.pi / 2 if follow else 2 * np.pi)
    return ik.CirclePath(np.array([0.55, -0.31, -0.15]), np.array([0.0, 0.0, 1.0]), np.array([0.0, -1.0, 0.0]), 0.12,
                         DOWN, s_min=0.0, s_max=end, follow=follow)  # fmt: skip


def spline(turning: bool) -> ik.SplinePath:
    points = np.array(
        [[0.55, -0.5, -0.2], [0.6, -0.4, -0.15], [0.55, -0.3, -0.1], [0.5, -0.2, -0.12], [0.55, -0.1, -0.2]]
    )
    angles = np.linspace(0.0, 0.5, 5) ** 2 if turning else np.zeros(5)
    about = Rotation.from_rotvec(np.outer(angles, [0.3, 0.2, 1.0])).as_matrix()
    return ik.SplinePath(points, about @ DOWN)


LINE = urdf.Line(np.array([0.5, -0.3, -0.1]), np.array([0.0, 0.6, 0.8]), DOWN, -0.1, 0.2, (-0.05, 0.1), 0.5)
PATHS = {
    "line": LINE, "circle": circle(), "turning circle": circle(True), "spline": spline(False),
    "turning spline": spline(True),
}  # fmt: skip


def twist_by_differences(path: ik.Path, s: np.ndarray, step: float) -> np.ndarray:
    (before, start), (after, end) = path.pose(s - step), path.pose(s + step)
    turned = Rotation.from_matrix(np.einsum("ijb,kjb->bik", after, before)).as_rotvec().T
    return np.concatenate((end - start, turned)) / (2 * step)


@pytest.mark.parametrize("path", PATHS.values(), ids=PATHS)
def test_a_path_is_one_by_arc_length_whose_twists_are_its_derivatives_and_it_can_be_made_again(path: ik.Path) -> None:
    s = np.random.default_rng(0).uniform(path.s_min + 0.01, path.s_max - 0.01, 30)
    assert np.abs(twist_by_differences(path, s, 1e-5) - path.twist(s)).max() < 1e-7
    rate = (path.twist(s + 1e-6) - path.twist(s - 1e-6)) / 2e-6
    assert np.abs(rate - path.twist_rate(s)).max() < 1e-5
    s = np.linspace(path.s_min, path.s_max, 50)
    assert np.linalg.norm(path.twist(s)[:3], axis=0) == pytest.approx(1.0, abs=1e-12)
    again = path_from_description(path.describe())
    for one, other in zip((*path.pose(s), path.twist(s)), (*again.pose(s), again.twist(s)), strict=True):
        assert np.abs(one - other).max() < 1e-14


def test_a_spline_passes_through_its_poses() -> None:
    path = spline(True)
    s = np.linspace(0.0, path.s_max, 4001)
    rotation, position = path.pose(s)
    for point, turned in zip(path.points, path.rotations, strict=True):
        nearest = int(np.linalg.norm(position.T - point, axis=1).argmin())
        assert np.linalg.norm(position[:, nearest] - point) < 2e-4
        assert np.abs(rotation[:, :, nearest] - turned).max() < 1e-3


@pytest.mark.parametrize("kind", ["circle", "turning spline"])
def test_the_tool_stays_on_the_path_between_nodes_by_yourdfpy(
    kind: str, baxter, tool_poses, tmp_path, complains
) -> None:
    path = PATHS[kind]
    ik.build_path_table(baxter, path).save(tmp_path / "path.npz")
    table = ik.PathTable.load(tmp_path / "path.npz", baxter)
    s = np.random.default_rng(1).uniform(path.s_min, path.s_max, 30)
    expected_rotation, expected_position = path.pose(s)
    rotation, position = tool_poses(baxter, table.posture(s).q)
    assert np.abs(position.T - expected_position).max() < 1e-9
    assert np.abs(rotation.transpose(1, 2, 0) - expected_rotation).max() < 1e-9
    step, q = table.s[1] - table.s[0], table.q
    differences = (8 * (q[3:-1] - q[1:-3]) - (q[4:] - q[:-4])) / (12 * step)
    # A rotation spline's third derivative jumps at its points, where differences of fourth order are less exact.
    assert np.abs(differences - table.dq_ds[2:-2]).max() < (1e-8 if kind == "circle" else 1e-5)
    with complains(ik.StaleTableError):
        ik.LineTable.load(tmp_path / "path.npz", baxter)


FILES = {
    "line": 'kind = "line"\norigin = [0.5, -0.3, -0.1]\ndirection = [0, 2, 0]\nrange = [-0.1, 0.1]\n'
    "tool_rpy = [0, 0, 0]\n",
    "circle": 'kind = "circle"\ncentre = [0.5, 0, 0]\nradius = 0.1\nnormal = [0, 0, 2]\nstart = [1, 0, 0.1]\n'
    "range_deg = [0, 90]\ntool_rpy = [0, 0, 0]\n",
    "spline": 'kind = "spline"\npoints = [[0, 0, 0], [0.1, 0, 0], [0.2, 0.1, 0]]\ntool_rpy = [0, 0, 0]\n',
}


def test_a_path_is_read_from_a_file(tmp_path) -> None:
    lengths = {}
    for kind, text in FILES.items():
        (tmp_path / "path.toml").write_text(text)
        path = ik.read_path(tmp_path / "path.toml")
        lengths[kind] = path.s_max - path.s_min
    assert lengths["line"] == pytest.approx(0.2)
    assert lengths["circle"] == pytest.approx(0.1 * np.pi / 2)
    assert 0.241 < lengths["spline"] < 0.25


BAD = [
    "kind = ", 'kind = "helix"', 'kind = "line"', FILES["line"].replace("[0, 2, 0]", "[0, 0, 0]"),
    FILES["line"].replace("[-0.1, 0.1]", "[0.1, -0.1]"), FILES["circle"].replace("0.1\nnormal", "-0.1\nnormal"),
    FILES["spline"].replace("[0.1, 0, 0]", "[0, 0, 0]"), FILES["spline"].replace("[0.1, 0, 0]", "[0.1, 0]"),
]  # fmt: skip


@pytest.mark.parametrize("text", BAD)
def test_bad_path_files_are_refused_in_one_line(tmp_path, text: str, complains) -> None:
    (tmp_path / "path.toml").write_text(text)
    with complains(InputError):
        ik.read_path(tmp_path / "path.toml")
