"""A joint that a model leaves out moves in it as it was recorded; torques by Pinocchio on the whole description."""

import numpy as np
import pinocchio as pin
import pytest

import armdyn
from armdyn.arm.model import arm_model
from armdyn.inspection.inspect import inspect_runs
from armdyn.run import Run

from ...robots import joint, link, robot

NAMES = ("j1", "j2", "j3")
TIME = 0.01 * np.arange(1500)


def recorded(tmp_path, held=()):
    """A URDF of three joints and a run of it; joints that are `held` stay at 0.8 rad."""
    chain = (link("l0"), *(link(f"l{k}") for k in (1, 2, 3)))
    joints = (joint("j1", "l0", "l1", "0 0 1"), joint("j2", "l1", "l2"), joint("j3", "l2", "l3"))
    # Each link's weight is beside its joint, so that it matters where the joint is.
    xml = robot(*chain, *joints).replace("<mass", '<origin xyz="0.02 0 0.15"/><mass')
    (tmp_path / "a.urdf").write_text(xml)
    phase = np.outer(TIME, [0.7, 1.1, 1.7])
    q, v, a = 0.8 * np.sin(phase), 0.8 * np.cos(phase), -0.8 * np.sin(phase)
    rate = np.array([0.7, 1.1, 1.7])
    v, a = v * rate, a * rate**2
    for i, name in enumerate(NAMES):
        if name in held:
            q[:, i], v[:, i], a[:, i] = 0.8, 0.0, 0.0
    model = pin.buildModelFromXML(xml)
    data = model.createData()
    tau = np.array([pin.rnea(model, data, *row) for row in zip(q, v, a, strict=True)])
    tau += 0.005 * np.random.default_rng(0).standard_normal(tau.shape)
    return Run.from_arrays(TIME, {"q": q, "tau": tau}, joints=NAMES, name="a.csv")


@pytest.mark.parametrize("left_out", NAMES)
@pytest.mark.parametrize("still", [False, True])
def test_torques_are_explained_with_any_joint_left_out_that_moves_or_stands_elsewhere(left_out, still, tmp_path):
    run = recorded(tmp_path, held=(left_out,) if still else ())
    others = [name for name in NAMES if name != left_out]
    model = arm_model(tmp_path / "a.urdf", joints=others)
    found = armdyn.compare(model, [run])
    assert set(found.channels) == {f"tau.{name}" for name in others}
    assert all(channel.chi2_per_sample < 2.0 for channel in found.channels.values())
    (check,) = [check for check in inspect_runs([run], model).checks if check.kind == "joint_left_out"]
    assert check.channels == (f"q.{left_out}",)
    assert check.severity.key == "note"


def test_a_joint_that_not_all_recordings_have_is_told_and_not_moved(tmp_path):
    run = recorded(tmp_path)
    lacks = Run("b.csv", {name: channel for name, channel in run.channels.items() if name != "q.j3"})
    model = arm_model(tmp_path / "a.urdf", joints=NAMES[:2])
    (check,) = [check for check in inspect_runs([run, lacks], model).checks if check.kind == "joint_left_out"]
    assert (check.run, check.severity.key) == ("a.csv", "suspect")
    assert "holds it at its zero" in check.sentence


def test_a_joint_that_the_description_lacks_is_told(tmp_path):
    run = recorded(tmp_path)
    lift = Run("a.csv", {**run.channels, "q.lift": run.channels["q.j2"]})
    (check,) = [c for c in inspect_runs([lift], arm_model(tmp_path / "a.urdf")).checks if c.kind == "joint_left_out"]
    assert "not a joint of the model nor of its description" in check.sentence


def test_effects_of_a_joint_that_is_carried_are_not_asked_for(tmp_path):
    run = recorded(tmp_path)
    model = arm_model(tmp_path / "a.urdf", joints=NAMES[:2]).adapted_to([run])
    assert model.arm.joints == NAMES
    assert model.joints == NAMES[:2]
    for reach in ("every", "turning", "coupled", "last"):
        assert "j3" not in model.arm.reachable_joints(reach)
