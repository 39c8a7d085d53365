"""A drive that smooths the torque which it stores is recognised in recordings that come from MuJoCo and scipy."""

import numpy as np
import pytest
from hidden_effects.generated_arm import generate

from armdyn.arm.drive import Torque, smoothing_drives
from armdyn.arm.model import arm_model
from armdyn.arm.motion import measured_motion
from armdyn.arm.prepared import FREQUENCIES, _inside, position_noise
from armdyn.preparation import of_all_runs, sentence


def drives_of(seed):
    robot = generate(seed)
    run = robot.runs()[0]
    model = arm_model(robot.name) if "/" in robot.name else arm_model(robot=robot.name)
    motion = measured_motion(run, model.arm.joints)
    brought_in = position_noise(model.arm.model, motion)
    torques = {
        f"tau.{joint}": Torque(j, *_inside(run, f"tau.{joint}", motion), brought_in[j])
        for j, joint in enumerate(model.arm.joints)
    }
    return robot, model, run, smoothing_drives(torques, model.arm.model, motion, FREQUENCIES)


@pytest.mark.parametrize("seed", [16, 17, 26])
def test_the_cut_off_and_the_noise_below_it_are_found(seed):
    robot, _, _, found = drives_of(seed)
    drive = robot.worlds[0].drive
    assert [one.cutoff for one in found.values()] == pytest.approx([drive.smoothing] * len(drive.noise), rel=0.05)
    noise = np.array([one.noise for one in found.values()])
    assert np.median(noise / drive.noise) == pytest.approx(1.0, rel=0.15)


@pytest.mark.parametrize("seed", [1, 9, 12])
def test_a_torque_that_was_not_smoothed_is_taken_as_it_is(seed):
    robot, _, _, found = drives_of(seed)
    assert not any(np.isfinite(one.cutoff) for one in found.values())
    noise = np.array([one.noise for one in found.values()])
    assert noise / robot.worlds[0].drive.noise[: len(noise)] == pytest.approx(np.ones(len(noise)), rel=0.2)


def test_what_is_compared_ends_well_below_the_cut_off_and_is_said():
    robot, model, run, _ = drives_of(16)
    prepared = model.prepared(run)
    done = of_all_runs([prepared.done])
    assert all(one.cutoff <= 0.55 * robot.worlds[0].drive.smoothing for one in done.values())
    assert "The drives smoothed their torques below" in sentence(done)
