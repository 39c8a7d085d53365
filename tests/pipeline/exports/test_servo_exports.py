"""A servo arm in MuJoCo moves as the model does: laws of every kind, delays, limits and sagging supplies."""

import mujoco
import numpy as np
import pytest
from worlds.servo_arm import EFFECTS, generate
from worlds.servo_in_mujoco import errors_in_mujoco, stretches

from armdyn.arm.closed_loop.rollout import simulated_positions
from armdyn.effects.catalogue import find
from pipeline.exports.mujoco_file import mujoco_text
from pipeline.exports.parts import EXPRESSIBLE_EFFECTS


@pytest.mark.parametrize("seed", [0, 8, 12])  # told positions, velocities, torques
def test_an_exported_arm_is_as_far_from_its_recording_in_mujoco_as_the_model_is(seed):
    made = generate(seed, tuple(effect for effect in EFFECTS if effect in EXPRESSIBLE_EFFECTS["mujoco"]))
    text, notes = mujoco_text(made.truth)
    run = made.runs[-1]
    own = [
        simulated_positions(made.truth, made.truth.theta(), window) - window.q for window in stretches(made.truth, run)
    ]
    there = errors_in_mujoco(text, made.truth, run, 5e-4)
    assert np.sqrt(np.mean(there**2)) < 1.05 * np.sqrt(np.mean(np.vstack(own) ** 2))
    arm = mujoco.MjModel.from_xml_string(text)
    late = [made.truth.servo(joint).delay for joint in made.truth.joints]
    assert arm.actuator_delay.tolist() == pytest.approx(late)
    assert [note for note in notes if "supply" in note] == [
        f"supply of {name}: its gain is that at 12 V" for name, s in made.truth.drives.items() if s.supply
    ]


def test_the_play_of_a_joint_is_a_second_joint_in_mujoco():
    made = generate(0, ("joint_coulomb_friction",))
    joint, run = made.truth.joints[1], made.runs[-1]
    model = made.truth.with_effect(find("backlash").on(joint)).with_values({f"backlash.play[{joint}]": 0.02})
    (window,) = stretches(model, run)
    tight, loose = (simulated_positions(one, one.theta(), window) for one in (made.truth, model))
    text, notes = mujoco_text(model)
    there = errors_in_mujoco(text, model, run, 5e-4) + window.q
    moving = window.time > window.begin + 3.0  # MuJoCo begins in the middle of the play
    assert np.abs(loose - tight)[moving].max() > 0.015
    assert np.abs(there - loose)[moving].max() < 0.001
    assert f"play of {joint}: its link stands at {joint} + {joint}_play" in notes
