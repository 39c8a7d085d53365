"""A servo arm in MuJoCo moves as the model does: laws of every kind, delays, limits, play and sagging supplies."""

import mujoco
import numpy as np
import pytest
from worlds.servo_arm import EFFECTS, generate
from worlds.servo_in_mujoco import errors_in_mujoco, stretches

from armdyn.arm.closed_loop.rollout import simulated_positions
from armdyn.effects.catalogue import CATALOGUE, find
from armdyn.errors import InputError
from pipeline.exports.mujoco_file import mujoco_text
from pipeline.exports.mujoco_start import begin
from pipeline.exports.parts import MUJOCO_SLOTS, held_effects

IN_MUJOCO = tuple(
    effect
    for effect in EFFECTS
    if effect in held_effects(CATALOGUE.values(), MUJOCO_SLOTS) and effect != "joint_stribeck_friction"
)
AS_THE_MODEL = 1.05
"""Largest error of the file's motion over that of the model's own roll-out."""


def rms(errors):
    return float(np.sqrt(np.mean(np.square(errors))))


def own_errors(model, run):
    return np.vstack([simulated_positions(model, model.theta(), w) - w.q for w in stretches(model, run)])


# Told positions, velocities and torques, some with dry friction, supplies that sag or loops that are stiff.
@pytest.mark.parametrize("seed", [0, 1, 4, 8, 9, 12])
def test_an_exported_arm_is_as_far_from_its_recording_at_the_files_own_step_as_the_model_is(seed):
    made = generate(seed, IN_MUJOCO)
    text, notes = mujoco_text(made.truth)
    run = made.runs[-1]
    assert rms(errors_in_mujoco(text, made.truth, run)) < AS_THE_MODEL * rms(own_errors(made.truth, run))
    assert [note for note in notes if "supply" in note] == [
        f"supply of {name}: its gain is that at 12 V" for name, s in made.truth.drives.items() if s.supply
    ]


def test_a_delay_is_exported_with_the_half_step_by_which_mujoco_reads_commands_too_early():
    truth = generate(4, IN_MUJOCO).truth  # told positions
    arm = mujoco.MjModel.from_xml_string(mujoco_text(truth)[0])
    late = [truth.servo(joint).delay for joint in truth.joints]
    assert (arm.actuator_delay - arm.opt.timestep / 2).tolist() == pytest.approx(late)


def test_a_loop_that_is_too_stiff_for_runge_kutta_is_integrated_implicitly():
    methods = [
        mujoco.MjModel.from_xml_string(mujoco_text(generate(seed, IN_MUJOCO).truth)[0]).opt.integrator
        for seed in (8, 12)  # told velocities, torques
    ]
    assert methods == [mujoco.mjtIntegrator.mjINT_IMPLICITFAST, mujoco.mjtIntegrator.mjINT_RK4]


def test_stribeck_friction_moves_an_arm_in_mujoco_as_in_the_model_and_needs_no_control():
    made = generate(1, IN_MUJOCO)  # told positions
    plain, run = made.truth, made.runs[-1]
    model = plain.with_effect(find("joint_stribeck_friction"))
    largest = {name: model.servo(name).gain.value * 5e-3 for name in model.joints}
    model = model.with_values({f"joint_stribeck_friction.torque[{name}]": size for name, size in largest.items()})
    model = model.with_values({f"joint_stribeck_friction.speed[{name}]": 0.2 for name in model.joints})
    text, notes = mujoco_text(model)
    assert not any("stribeck" in note for note in notes)
    assert mujoco.MjModel.from_xml_string(text).nu == len(model.joints)
    there = errors_in_mujoco(text, model, run)
    told_apart = rms(own_errors(model, run) - own_errors(plain, run))
    assert rms(there - own_errors(model, run)) < 0.15 * told_apart


def test_the_play_of_a_joint_is_a_second_joint_in_mujoco():
    made = generate(0, ("joint_coulomb_friction",))
    joint, run = made.truth.joints[1], made.runs[-1]
    model = made.truth.with_effect(find("backlash").on(joint)).with_values({f"backlash.play[{joint}]": 0.02})
    tight, loose = (own_errors(one, run) for one in (made.truth, model))
    text, notes = mujoco_text(model)
    assert np.abs(loose - tight).max() > 0.015
    assert np.abs(errors_in_mujoco(text, model, run) - loose).max() < 0.002
    assert f"play of {joint}: its link stands at {joint} + {joint}_play" in notes


@pytest.fixture(scope="module")
def delayed():
    """A Panda, whose fourth joint cannot stand at 0, with delayed position servos and nothing else."""
    truth = generate(4, ("joint_viscous_friction",)).truth
    return mujoco.MjModel.from_xml_string(mujoco_text(truth)[0]), truth


def test_a_delayed_arm_begins_without_a_kick_from_the_files_keyframe(delayed):
    arm, truth = delayed
    data = mujoco.MjData(arm)
    mujoco.mj_resetDataKeyframe(arm, data, 0)
    assert np.ptp(data.ctrl) > 0.01  # the joint that cannot stand at 0
    assert data.ctrl.tolist() == data.qpos.tolist()
    mujoco.mj_forward(arm, data)
    assert np.abs(data.actuator_force).max() < 1e-9 * min(truth.servo(j).gain.value for j in truth.joints)


def test_a_delayed_arm_begins_without_a_kick_at_any_posture_and_a_reset_alone_kicks_it(delayed):
    arm, truth = delayed
    data, posture = mujoco.MjData(arm), dict.fromkeys(truth.joints, -0.3)
    forces = []
    for start in (lambda: begin(arm, data, posture), lambda: mujoco.mj_resetData(arm, data)):
        start()
        data.qpos[:], data.ctrl[:] = -0.3, -0.3
        mujoco.mj_forward(arm, data)
        forces.append(np.abs(data.actuator_force).max())
    assert forces[0] < 1e-9 * forces[1]


def test_a_start_of_a_joint_that_the_file_lacks_is_one_line(delayed, complains):
    arm, _ = delayed
    with complains(InputError):
        begin(arm, mujoco.MjData(arm), {"elbow": 0.1})
