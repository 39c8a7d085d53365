"""In which direction a joint moves, as far as a recording tells."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d
from worlds.baxter import JOINTS, generate
from worlds.drive import Hidden, Lump, on_link
from worlds.plant import perfect

from armdyn.arm.model import arm_model
from armdyn.arm.motion import measured_motion, without_idle_torques
from armdyn.arm.prepared import samples_inside_motion, samples_with_known_direction
from armdyn.effects.catalogue import CATALOGUE


def test_a_turning_joint_leaves_out_the_samples_of_which_nobody_knows_the_sign():
    run = generate(None, 1.0, 0)
    motion, torque = measured_motion(run, JOINTS), run.channels["tau.right_e0"]
    time = torque.time[samples_inside_motion(torque, motion)]
    left_out = ~samples_with_known_direction(motion, JOINTS.index("right_e0"), time, 10.0)
    speed = np.abs(motion.joints[JOINTS.index("right_e0")].curve(time, 1)[:, 0])
    assert 0 < left_out.mean() < 0.02
    assert speed[left_out].max() < 0.01  # rad/s


def test_a_joint_at_rest_has_no_friction_whose_sign_is_noise():
    run = generate(None, 1.0, 0)
    q, steps = run.channels["q.right_e0"], np.random.default_rng(0).standard_normal(len(run.channels["q.right_e0"]))
    dithering = gaussian_filter1d(1e-5 * np.cumsum(steps) / np.sqrt(len(q)), 5.0)  # rad, smooth: no noise is seen in it
    at_rest = replace(run, channels={**run.channels, "q.right_e0": replace(q, value=0.3 + dithering)})
    rests, moves = (measured_motion(one, JOINTS).direction(JOINTS.index("right_e0"), q.time) for one in (at_rest, run))
    assert np.abs(rests).max() < 0.1
    assert np.mean(np.abs(moves) > 0.99) > 0.95


def _held(run, joint, begin, end):
    """The run with a joint that rests from the fraction `begin` to `end` of the recording, with an encoder's noise."""
    q = run.channels[f"q.{joint}"]
    share, value = np.linspace(0.0, 1.0, len(q)), q.value.copy()
    rests = (share > begin) & (share < end)
    at = value[np.flatnonzero(rests)[0]]
    value[rests] = at + 4e-4 * np.random.default_rng(0).standard_normal(int(rests.sum()))  # rad
    value[share >= end] += at - value[np.flatnonzero(share >= end)[0]]
    return replace(run, channels={**run.channels, f"q.{joint}": replace(q, value=value)})


def test_rests_are_left_out_of_a_joint_that_moves_however_long_it_rests_but_not_of_one_that_hardly_moves():
    run, joint = generate(None, 1.0, 0), JOINTS.index("right_e0")
    time = run.channels["tau.right_e0"].time
    share = np.linspace(0.0, 1.0, len(time))
    moves, stands = (measured_motion(_held(run, "right_e0", begin, 0.99), JOINTS) for begin in (0.3, 0.02))
    inside = (share > 0.35) & (share < 0.55)
    assert not moves.joints[joint].mostly_rests
    assert np.mean(samples_with_known_direction(moves, joint, time, 10.0)[inside]) < 0.1
    assert stands.joints[joint].mostly_rests
    assert np.mean(samples_with_known_direction(stands, joint, time, 10.0)[inside]) > 0.9
    assert np.mean(stands.direction(joint, time[inside]) == 0.0) > 0.9


def test_before_a_rest_at_the_end_a_smoothed_torque_is_left_out_as_at_the_end_of_a_recording(baxter):
    resting, channel = _held(generate(None, 1.0, 0), "right_e0", 0.8, 1.0), "tau.right_e0"
    ready, recorded = baxter.prepare_run(resting), resting.channels[channel].time
    cutoff = ready.preparations[channel].cutoff
    known = samples_with_known_direction(measured_motion(resting, JOINTS), JOINTS.index("right_e0"), recorded, cutoff)
    assert 0.5 / cutoff <= recorded[known][-1] - ready.channels[channel].time[-1] < 1.5 / cutoff


def test_after_a_quick_stop_nobody_knows_a_sign():
    run, joint = generate(None, 1.0, 0), JOINTS.index("right_e0")
    q = run.channels["q.right_e0"]
    stop = 0.5 * float(q.time[0] + q.time[-1])
    before = np.minimum(q.time - stop, 0.0)
    braked = np.where(before > -0.1, -2.0 * before**2, 0.02 + 0.4 * (before + 0.1) - 0.04)  # from 0.4 rad/s in 0.1 s
    ramp = braked + 2e-4 * np.random.default_rng(0).standard_normal(len(q))  # rad
    stopped = replace(run, channels={**run.channels, "q.right_e0": replace(q, value=ramp)})
    motion = measured_motion(stopped, JOINTS)
    swings = motion.joints[joint].curve(q.time, 1)[:, 0]
    assert (
        np.min(swings[q.time > stop]) < -3.0 * motion.joints[joint].smoothed_velocity_noise_std
    )  # the smoothed velocity overshoots
    assert np.min(motion.direction(joint, q.time)[q.time > stop]) > -0.99


HEAVY = {
    "rotor_inertia": Hidden("rotor_inertia", "panda_joint4", {"inertia": 5.0}),
    "payload": on_link("payload", "panda_joint7", Lump(8.0, (0.02, -0.03, 0.1))),
}


@pytest.mark.parametrize("effect", HEAVY)
def test_what_is_heavier_than_described_makes_more_noise_of_the_positions(effect: str) -> None:
    hidden = HEAVY[effect]
    world = perfect("panda", "multisine", 3, duration=30.0, rate=250.0)
    world = replace(world, drive=replace(world.drive, position_noise=3e-4, noise=np.full(7, 1e-4)))
    noise = np.random.default_rng(0).standard_normal((3, len(world.stamps), 7))
    values = {f"{effect}.{short}[{hidden.joint}]": value for short, value in hidden.values.items()}
    model = arm_model(robot="panda").with_effect(CATALOGUE[effect].on(hidden.joint)).with_values(values)
    ready = model.prepare_run(world.recorded([hidden], noise, effect))
    found, there = model.predict(ready, model.theta()), model.noise(ready, model.theta())
    left = {c: ready.channels[c].value - found.values[rows] for c, rows in found.slices.items()}
    described, known = (np.array([np.mean((r / std[c]) ** 2) for c, r in left.items()]) for std in (ready.noise, there))
    most = described.argmax()
    assert described[most] > 5.0
    assert 0.5 < known[most] < 1.5
    assert known.max() < 1.5


def test_a_constant_torque_of_a_resting_joint_is_left_out_but_not_that_of_a_moving_one():
    run = generate(None, 1.0, 0)
    tau, q = run.channels["tau.right_e0"], run.channels["q.right_e0"]
    silent = replace(run, channels={**run.channels, "tau.right_e0": replace(tau, value=np.full(len(tau), 0.5))})
    assert "tau.right_e0" in without_idle_torques(silent, JOINTS).channels
    noise = 1e-5 * np.random.default_rng(0).standard_normal(len(q))
    rests = replace(silent, channels={**silent.channels, "q.right_e0": replace(q, value=0.3 + noise)})
    assert set(rests.channels) - set(without_idle_torques(rests, JOINTS).channels) == {"tau.right_e0"}
