import numpy as np
import pytest

from armdyn.arm.model import arm_model
from armdyn.effects.catalogue import find
from armdyn.errors import InputError, TaskFailedError, UnknownNameError
from armdyn.experiments.goal import goal_to_determine, goal_to_separate
from armdyn.experiments.structure import independent_columns


def test_friction_can_be_determined_beside_everything_usual(shoulder, effects):
    goal = goal_to_determine(shoulder, effects("joint_viscous_friction"), 100.0)
    assert set(goal.nuisance_effects) == {"joint_coulomb_friction", "torque_offset", "rotor_inertia", "link_inertia"}
    assert not len(goal.unidentifiable)


def test_a_payload_is_looked_for_with_the_links_as_described(shoulder, effects):
    """It is one way of changing the last link, which no motion tells from it."""
    goal = goal_to_determine(shoulder, effects("payload"), 100.0)
    assert "link_inertia" in goal.effects_taken_as_known
    assert "link_inertia" not in {p.effect for p in goal.columns.unknowns}
    assert [goal.columns.unknowns[i].effect for i in goal.wanted] == ["payload"] * 4


def test_what_no_motion_determines_is_said(shoulder, effects):
    """The first joint's axis is vertical: only the sum of rotor and link inertia about it acts on it."""
    goal = goal_to_determine(shoulder, effects("rotor_inertia link_inertia"), 100.0)
    names = {goal.columns.unknowns[i].name for i in goal.unidentifiable}
    assert "rotor_inertia.inertia[right_s0]" in names
    friction = goal_to_determine(shoulder, effects("joint_coulomb_friction"), 100.0)
    assert not len(friction.unidentifiable)


def test_an_effect_on_some_joints_leaves_the_others_beside(shoulder):
    goal = goal_to_determine(shoulder, [find("joint_coulomb_friction:right_s1")], 100.0)
    assert [goal.columns.unknowns[i].joint for i in goal.wanted] == ["right_s1"]
    coulomb = [p.joint for p in goal.columns.unknowns if p.effect == "joint_coulomb_friction"]
    assert sorted(coulomb) == ["right_e0", "right_s0", "right_s1"]


def test_rivals_are_told_apart_joint_by_joint_and_both_ways(shoulder, effects):
    goal = goal_to_separate(shoulder, *effects("gravity_spring torque_offset"), 100.0)
    assert len(goal.separations) == 6
    assert all(case.directions.shape[1] == len(case.own) for case in goal.separations)


def test_a_payload_is_no_rival_of_the_link_that_holds_it(shoulder):
    last = find("link_inertia:right_e0")
    goal = goal_to_separate(shoulder, find("payload"), last, 100.0)
    assert [case.effect for case in goal.separations] == ["link_inertia"]
    assert len(goal.inseparable) == 1
    assert goal.inseparable[0].startswith("payload on right_e0")


def test_effects_that_no_motion_can_tell_apart_are_refused_with_the_reason(shoulder, complains):
    """About a vertical axis an inertia is all that a rotor has too."""
    coulomb = find("joint_coulomb_friction:right_s0")
    with complains(InputError):
        goal_to_separate(shoulder, coulomb, coulomb, 100.0)
    with complains(TaskFailedError):
        goal_to_separate(shoulder.with_only_effects([]), find("payload"), find("payload_twin", [_twin()]), 100.0)


def _twin():
    from dataclasses import replace

    return replace(find("payload"), name="payload_twin")


def test_an_effect_of_another_model_is_refused(shoulder, complains):
    with complains(InputError):
        goal_to_determine(shoulder, [find("linear_drag")], 100.0)
    with pytest.raises(UnknownNameError):
        goal_to_determine(shoulder, [find("payload:right_w9")], 100.0)


def test_base_parameters_span_all_others(shoulder, effects):
    goal = goal_to_determine(shoulder, effects("rotor_inertia link_inertia torque_offset"), 100.0)
    X, chosen = goal.random_state_rows, independent_columns(goal.random_state_rows)
    fitted, *_ = np.linalg.lstsq(X[:, chosen], X, rcond=None)
    assert np.linalg.norm(X - X[:, chosen] @ fitted) < 1e-6 * np.linalg.norm(X)
    assert np.linalg.matrix_rank(X[:, chosen]) == len(chosen) < X.shape[1]


def test_a_place_along_parallel_axes_is_told_by_no_motion(effects):
    """The torques of joints that turn about parallel axes do not depend on where along them a load is."""
    plane = arm_model(robot="baxter", joints=["right_s1", "right_e1", "right_w1"])
    goal = goal_to_determine(plane, effects("payload"), 100.0)
    assert [goal.columns.unknowns[i].name for i in goal.unidentifiable] == ["payload.z[right_w1]"]
    assert goal.unidentifiable[0] not in independent_columns(goal.random_state_rows)


def test_changes_of_a_link_that_the_noise_hides_at_any_speed_are_not_asked_for(shoulder):
    """Of the ten ways to change a link, few act on torques by more than their noise."""
    goal = goal_to_separate(shoulder, find("payload"), find("link_inertia:right_e0"), 100.0)
    (case,) = goal.separations
    assert 1 <= case.directions.shape[1] < 10
    assert case.directions.T @ case.directions == pytest.approx(np.eye(case.directions.shape[1]))
    shown = goal.random_state_rows[:, case.own] @ case.directions
    assert np.linalg.norm(shown, axis=0).min() > 5.0
