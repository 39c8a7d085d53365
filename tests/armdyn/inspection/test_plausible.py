from dataclasses import replace

import numpy as np
import pytest
from hidden_effects import mistakes, sound_recordings

import armdyn
from armdyn.arm.model import arm_model
from armdyn.effects.catalogue import CATALOGUE
from armdyn.inspection.check import WrongRecordingError
from armdyn.inspection.plausible import implausible, require_plausible
from armdyn.pendulum.model import pendulum_model


@pytest.mark.parametrize(
    ("effect", "values"),
    [
        ("payload", {"payload.mass[panda_joint7]": 6336.0}),
        ("link_inertia", {"link_inertia.mass[panda_joint3]": 4.0}),
        ("base_tilt", {"base_tilt.roll": 3.0}),
        ("torque_offset", {"torque_offset.torque[panda_joint2]": -184.6}),
        ("torque_delay", {"torque_delay.time[panda_joint2]": 3e7}),
    ],
)
def test_what_nothing_has_is_said(effect, values):
    model = arm_model(robot="panda", joints=mistakes.Plant("panda").joints, effects=[CATALOGUE[effect]])
    assert implausible(model) == []
    wide = {name: replace(model.parameters[name], value=value, upper=np.inf) for name, value in values.items()}
    found = implausible(model.with_parameters(wide))
    assert [check.kind for check in found] == ["implausible_model"]
    assert "check your recording" in found[0].sentence


def test_what_a_user_told_the_model_is_no_verdict():
    model = arm_model(robot="panda", joints=mistakes.Plant("panda").joints, effects=[CATALOGUE["base_tilt"]])
    on_a_wall = model.with_values({"base_tilt.roll": 1.57})
    require_plausible(on_a_wall, [], on_a_wall)
    with pytest.raises(WrongRecordingError, match="lean by 90 degrees"):
        require_plausible(on_a_wall, [], model)


def test_a_length_at_the_end_of_its_range_is_said():
    assert implausible(pendulum_model(0.35, 0.1)) == []
    assert [check.channels for check in implausible(pendulum_model(5.0, 0.1))] == [("length",)]


def test_wrong_recordings_end_a_comparison_and_trusted_ones_do_not():
    joints = mistakes.Plant("panda").joints
    model = arm_model(robot="panda", joints=joints)
    sound = sound_recordings.arm("panda", "as described", 0, duration=6.0)
    wrong = mistakes.scaled(sound.run, [f"tau.{j}" for j in joints], 1e3)
    with pytest.raises(WrongRecordingError) as caught:
        armdyn.compare(model, [wrong])
    assert caught.value.inspection.wrong[0].kind == "torque_unit"
    assert armdyn.compare(model, [wrong], trust_data=True).fit.chi2_per_sample > 1.0


def test_a_run_is_cut_where_samples_are_missing():
    joints = mistakes.Plant("panda").joints
    model = arm_model(robot="panda", joints=joints)
    sound = sound_recordings.arm("panda", "as described", 0, duration=8.0)
    found = armdyn.compare(model, [mistakes.without(sound.run, 4.0, 5.2)])
    assert [run.name for run in found.fit.problem.runs] == [f"{sound.run.name}#1", f"{sound.run.name}#2"]
    assert any("cut there" in text for text in found.left_out)
