"""A drive that smooths the torque which it stores is recognised in recordings that come from MuJoCo and scipy."""

from functools import cache

import numpy as np
import pytest
from scipy.signal import butter, filtfilt
from worlds.generated_arm import generate

from armdyn.arm.drive import drive_low_passes
from armdyn.arm.model import arm_model
from armdyn.arm.prepared import POSITION_NOISE_FREQUENCIES_HZ, recorded_torques
from armdyn.readout import LowPassSampler

robot_of = cache(generate)


def drives_of(seed, cut=None):
    robot = robot_of(seed)
    runs = robot.runs()[:1] if cut is None else robot.cut(robot.rate, *cut).runs()
    model = arm_model(robot.name) if "/" in robot.name else arm_model(robot=robot.name)
    arm = model.arm
    found = drive_low_passes(
        [recorded_torques(run, arm.model, arm.joints) for run in runs], arm.model, POSITION_NOISE_FREQUENCIES_HZ
    )
    return robot, model, runs, found


def test_the_cut_off_and_the_noise_below_it_are_found():
    robot, _, _, found = drives_of(16)
    drive = robot.worlds[0].drive
    assert [one.cutoff for one in found.values()] == pytest.approx([drive.smoothing] * len(drive.noise), rel=0.05)
    noise = np.array([one.noise for one in found.values()])
    assert np.median(noise / drive.noise) == pytest.approx(1.0, rel=0.15)


def test_short_recordings_show_together_what_none_shows_alone():
    robot, model, runs, found = drives_of(16, (12.0, 6))
    assert [one.cutoff for one in found.values()] == pytest.approx([robot.worlds[0].drive.smoothing] * 7, rel=0.1)
    cutoffs = [done.cutoff for run in runs for done in model.prepare_run(run, runs).processing.values()]
    assert max(cutoffs) <= 0.55 * robot.worlds[0].drive.smoothing


def test_a_joint_that_turns_round_too_often_to_tell_has_the_low_pass_of_the_others():
    robot, _, _, found = drives_of(40)
    drive, creeping = robot.worlds[0].drive, found["tau.panda_joint2"]
    assert len(found) == 7
    assert {one.cutoff for one in found.values()} == {creeping.cutoff}
    assert creeping.cutoff < 1.2 * drive.smoothing
    assert creeping.noise / drive.noise[1] == pytest.approx(1.0, rel=0.5)


def test_a_torque_that_was_not_smoothed_is_taken_as_it_is():
    robot, _, _, found = drives_of(1)
    assert not any(np.isfinite(one.cutoff) for one in found.values())
    noise = np.array([one.noise for one in found.values()])
    assert noise / robot.worlds[0].drive.noise[: len(noise)] == pytest.approx(np.ones(len(noise)), rel=0.2)


def test_what_steps_is_predicted_as_the_drive_smoothed_it():
    time, rate, cutoff = np.arange(0.0, 20.0, 0.004), 250.0, 8.0
    steps = np.sign(np.sin(2.3 * time))[:, None]
    recorded = filtfilt(*butter(2, cutoff / (0.5 * rate)), steps, axis=0)
    at, everything = np.arange(1.0, 19.0, 0.1), np.ones(len(time), dtype=bool)

    def sampled(signal, below):
        low = LowPassSampler(time, 0.5 * cutoff, at, everything, below)
        return low.matrix(0.0) @ low.coefficients(signal)

    measured = sampled(recorded, None)
    error, without = (np.sqrt(np.mean((sampled(steps, below) - measured) ** 2)) for below in (cutoff, None))
    assert error < 0.1 * without
