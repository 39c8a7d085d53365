"""A drive that smooths the torque which it stores is recognised in recordings that come from MuJoCo and scipy."""

import numpy as np
import pytest
from scipy.signal import butter, filtfilt
from worlds.generated_arm import generate

from armdyn.arm.drive import smoothing_drives
from armdyn.arm.model import arm_model
from armdyn.arm.prepared import FREQUENCIES, recorded
from armdyn.readout import LowPassSampler
from armdyn.recording.preparation import of_all_runs, sentence


def drives_of(seed, cut=None):
    robot = generate(seed)
    runs = robot.runs()[:1] if cut is None else robot.cut(robot.rate, *cut).runs()
    model = arm_model(robot.name) if "/" in robot.name else arm_model(robot=robot.name)
    arm = model.arm
    found = smoothing_drives([recorded(run, arm.model, arm.joints) for run in runs], arm.model, FREQUENCIES)
    return robot, model, runs, found


@pytest.mark.parametrize("seed", [16, 17, 26])
def test_the_cut_off_and_the_noise_below_it_are_found(seed):
    robot, _, _, found = drives_of(seed)
    drive = robot.worlds[0].drive
    assert [one.cutoff for one in found.values()] == pytest.approx([drive.smoothing] * len(drive.noise), rel=0.05)
    noise = np.array([one.noise for one in found.values()])
    assert np.median(noise / drive.noise) == pytest.approx(1.0, rel=0.15)


def test_short_recordings_show_together_what_none_shows_alone():
    robot, model, runs, found = drives_of(16, (12.0, 6))
    assert [one.cutoff for one in found.values()] == pytest.approx([robot.worlds[0].drive.smoothing] * 7, rel=0.1)
    cutoffs = [done.cutoff for run in runs for done in model.prepare_run(run, runs).done.values()]
    assert max(cutoffs) <= 0.55 * robot.worlds[0].drive.smoothing


def test_a_joint_that_turns_round_too_often_to_tell_has_the_low_pass_of_the_others():
    robot, _, _, found = drives_of(40)
    drive, creeping = robot.worlds[0].drive, found["tau.panda_joint2"]
    assert len(found) == 7
    assert {one.cutoff for one in found.values()} == {creeping.cutoff}
    assert creeping.cutoff < 1.2 * drive.smoothing
    assert creeping.noise / drive.noise[1] == pytest.approx(1.0, rel=0.5)


@pytest.mark.parametrize("seed", [1, 9, 12])
def test_a_torque_that_was_not_smoothed_is_taken_as_it_is(seed):
    robot, _, _, found = drives_of(seed)
    assert not any(np.isfinite(one.cutoff) for one in found.values())
    noise = np.array([one.noise for one in found.values()])
    assert noise / robot.worlds[0].drive.noise[: len(noise)] == pytest.approx(np.ones(len(noise)), rel=0.2)


def test_what_is_compared_ends_well_below_the_cut_off_and_is_said():
    robot, model, (run,), _ = drives_of(16)
    prepared = model.prepare_run(run)
    done = of_all_runs([prepared.done])
    assert all(one.cutoff <= 0.55 * robot.worlds[0].drive.smoothing for one in done.values())
    assert "The drives smoothed their torques below" in sentence(done)


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
