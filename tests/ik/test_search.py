"""Searching a line: what the search promises."""

from dataclasses import replace

import numpy as np
import pytest

import ik
import urdf
from ik.search import LineRequirements, axis_aligned_rotation, search_line


@pytest.mark.slow
def test_a_search_finds_a_fast_free_line_within_the_limits() -> None:
    robot = urdf.load("ur5")
    said: list[str] = []
    found = search_line(robot, LineRequirements(s_min=-0.1, s_max=0.1, core=(-0.05, 0.05)), progress=said.append)
    assert any("m/s with" in sentence for sentence in said)
    assert found.core_speed >= found.line.core_speed
    assert found.line.origin[0] > 0
    assert found.clearance > 0
    # Searching beats choosing by eye, half a metre in front of the arm, on both counts together.
    by_eye = replace(found.line, origin=np.array([0.5, 0.0, 0.3]), direction=np.array([0.0, 1.0, 0.0]), core_speed=1.0)
    tables = [ik.build_line_table(robot, line) for line in (found.line, by_eye)]
    core = np.linspace(-0.05, 0.05, 51)
    ours, theirs = (t.speed_limit_at(core).min() * min(1.0, t.joint_margin / 0.5) for t in tables)
    assert ours > 1.2 * theirs
    collisions = urdf.CollisionModel(robot)
    assert all(collisions.touching(q) is None for q in tables[0].q[::20])


def test_a_line_longer_than_the_arm_is_not_found(complains) -> None:
    with complains(ik.UnreachableError):
        search_line(urdf.load("ur5"), LineRequirements(s_min=-2.0, s_max=2.0, core=(-1.0, 1.0)))


def test_the_nearest_right_angled_orientation_is_a_rotation() -> None:
    rng = np.random.default_rng(0)
    for _ in range(50):
        rotation, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        rotation *= np.sign(np.linalg.det(rotation))
        nearest = axis_aligned_rotation(rotation)
        assert np.linalg.det(nearest) == pytest.approx(1.0)
        assert sorted(np.abs(nearest).ravel()) == [0.0] * 6 + [1.0] * 3
    tilted = np.array([[0.0, -1.0, 0.02], [-1.0, 0.0, 0.01], [0.01, 0.02, -1.0]])
    assert axis_aligned_rotation(tilted).tolist() == [[0.0, -1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]
