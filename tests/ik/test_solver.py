"""Inverse kinematics of unrelated targets, and the reasons where there is no answer."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

import ik
import urdf
from armdyn.errors import InputError
from ik.solver import IkSolver
from ik.unreachable_targets import find_unreachable_targets


@pytest.fixture(scope="module")
def solver(baxter) -> IkSolver:
    return IkSolver(baxter)


@pytest.fixture(scope="module")
def collisions(baxter) -> urdf.CollisionModel:
    return urdf.CollisionModel(baxter)


def poses_of(robot: urdf.Robot, postures):
    poses = [robot.tool_pose(q) for q in postures]
    return np.array([pose.rotation for pose in poses]), np.array([pose.translation for pose in poses])


def test_random_cold_targets_are_reached_within_the_joint_limits_and_others_missed_by_what_is_left(
    baxter, solver
) -> None:
    rng = np.random.default_rng(3)
    rotation, position = poses_of(baxter, rng.uniform(baxter.limits.lower, baxter.limits.upper, (600, 7)))
    answers = solver.solve(rotation, position)
    assert answers.reached.mean() >= 0.995
    assert baxter.limits.margin(answers.q).min() >= 0.0
    found_rotation, found_position = poses_of(baxter, answers.q[answers.reached])
    assert np.abs(found_position - position[answers.reached]).max() < 1e-8
    assert np.abs(found_rotation - rotation[answers.reached]).max() < 1e-8
    _, position = poses_of(baxter, [baxter.home])
    answers = solver.solve(baxter.line.rotation[None], position + np.array([2.0, 0.0, 0.0]))
    assert not answers.reached[0]
    assert 1.0 < answers.distance[0] < 2.0


def test_postures_of_one_target_differ_and_all_hold_it(baxter, solver) -> None:
    target = baxter.line.position(0.0)
    postures = solver.alternative_postures(baxter.line.rotation, target)
    assert len(postures) > 5
    assert np.ptp(postures, axis=0).max() > 0.5
    assert max(np.abs(baxter.tool_pose(q).translation - target).max() for q in postures) < 1e-8


def test_targets_that_are_not_finite_or_of_another_shape_are_refused(solver, complains) -> None:
    with complains(InputError):
        solver.solve(np.eye(3)[None], np.array([[np.nan, 0.0, 0.0]]))
    with complains(InputError):
        solver.solve(np.eye(3), np.zeros(3))


def shifted(robot: urdf.Robot, x: float, z: float, s_min: float, s_max: float) -> urdf.Line:
    return replace(robot.line, origin=np.array([x, -0.31, z]), s_min=s_min, s_max=s_max)


def test_every_target_of_baxters_line_can_be_held(baxter, collisions) -> None:
    assert find_unreachable_targets(baxter, baxter.line, np.linspace(-0.3, 0.55, 30), collisions) == ()


def test_targets_beyond_reach_are_named_with_their_distance(baxter, collisions, complains) -> None:
    line = shifted(baxter, 0.55, -0.18, -0.3, 0.9)
    misses = find_unreachable_targets(baxter, line, np.array([0.2, 0.8, 0.9]), collisions)
    assert [miss.s for miss in misses] == [0.8, 0.9]
    assert {miss.reason for miss in misses} == {"it is beyond the arm's reach"}
    # 0.1 m further away is missed by about 0.1 m more, because the arm is stretched along the line.
    assert 0.05 < misses[1].distance - misses[0].distance < 0.1
    with complains(ik.UnreachableError):
        ik.build_line_table(baxter, line)


def test_a_target_that_only_limits_forbid_names_the_joint(baxter, collisions) -> None:
    q = np.array([0.3, 0.2, 0.1, 1.0, 0.2, 1.2, 0.1])
    above = np.where(np.arange(7) == 3, -0.2, 0.5)
    narrow = replace(baxter, limits_or_none=replace(baxter.limits, lower=q - 0.5, upper=q + above))
    pose = baxter.tool_pose(q)
    line = replace(baxter.line, origin=pose.translation, rotation=pose.rotation)
    (miss,) = find_unreachable_targets(narrow, line, np.zeros(1), collisions)
    # Not exactly 0.2 rad: the elbow can stretch a little less where it swings to the side.
    assert "joint 'right_e1' would pass its limit by 0.1" in miss.sentence


def test_a_target_inside_the_torso_names_the_links_that_touch(baxter, collisions) -> None:
    (miss,) = find_unreachable_targets(baxter, shifted(baxter, 0.12, -0.30, -0.3, 0.55), np.array([0.0]), collisions)
    assert "torso would touch" in miss.sentence


def test_a_home_posture_far_from_the_line_still_finds_it(baxter) -> None:
    elsewhere = replace(baxter, home=np.array([1.2, 0.5, 0.0, 0.3, 0.0, -0.5, 0.0]))
    found = ik.build_line_table(elsewhere, replace(baxter.line, s_min=-0.05, s_max=0.05))
    pose = elsewhere.tool_pose(found.posture(0.0).q)
    assert np.abs(pose.translation - baxter.line.position(0.0)).max() < 1e-9
    assert np.linalg.norm(pin.log3(pose.rotation.T @ baxter.line.rotation)) < 1e-9
