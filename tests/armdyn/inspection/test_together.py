"""Mistakes are judged over all recordings of an arm together, against a model with every effect."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from worlds import mistakes, sound_recordings

from armdyn.arm.model import arm_model
from armdyn.inspection.check import Severity
from armdyn.inspection.evidence import ChannelReadings, EffectSizes, ReadingSums, evidence
from armdyn.inspection.inspect import inspect_runs
from armdyn.run import Channel

from ..arm import urdfs


def _model(robot):
    return arm_model(robot=robot, joints=mistakes.Plant(robot).joints)


@pytest.fixture(scope="module")
def three_runs():
    """Recordings of a UR5 with series-elastic drives, whose torques vibrate, and own torque constants."""
    return [sound.run for sound in sound_recordings.owned("ur5", 6)]


def test_own_torque_constants_are_no_other_unit(three_runs):
    model = _model("ur5")
    factors = dict(zip(model.joints, (0.58, 1.4, 0.59, 1.6, 0.7, 1.2), strict=True))
    owned = [
        replace(run, channels={n: Channel(c.time, factors.get(n[4:], 1.0) * c.value, c.unit) if n[:4] == "tau." else c
                               for n, c in run.channels.items()})
        for run in three_runs
    ]  # fmt: skip
    assert inspect_runs(owned, model).usable


def test_a_mistake_of_a_logger_is_told_of_all_its_recordings(three_runs):
    model = _model("ur5")
    wrong = [mistakes.scaled(run, [f"tau.{j}" for j in model.joints], 1e3) for run in three_runs]
    found = inspect_runs(wrong, model)
    assert [check.kind for check in found.wrong] == ["torque_unit"] * 3
    assert {check.run for check in found.wrong} == {run.name for run in wrong}
    assert "over 3 recordings together" in found.sentence
    for run, right in zip(wrong, three_runs, strict=True):
        mended = found.corrected()[run.name].applied_to(run)
        np.testing.assert_allclose(mended.channels["tau.elbow_joint"].value, right.channels["tau.elbow_joint"].value)


def test_a_mistake_of_one_recording_is_told_of_that_one(three_runs):
    first, second, third = three_runs
    negated = mistakes.scaled(second, ["q.elbow_joint"], -1.0)
    found = inspect_runs([first, negated, third], _model("ur5"))
    assert [(check.kind, check.run) for check in found.wrong] == [("position_sign", second.name)]


def test_zeros_of_several_joints_are_found_at_once():
    sound = sound_recordings.arm("panda", "payload", 705).run
    wrong = mistakes.moved(mistakes.moved(sound, "q.panda_joint2", np.pi), "q.panda_joint6", np.pi)
    found = inspect_runs([wrong], _model("panda"))
    assert {(c.kind, c.channels) for c in found.wrong} == {
        ("position_offset", ("q.panda_joint2",)), ("position_offset", ("q.panda_joint6",)),
    }  # fmt: skip
    mended = found.corrected()[wrong.name].applied_to(wrong)
    for name in ("q.panda_joint2", "q.panda_joint6"):
        np.testing.assert_allclose(mended.channels[name].value, sound.channels[name].value, atol=1e-9)


@pytest.mark.parametrize(
    ("robot", "real", "seed", "offsets"),
    [
        ("panda", "payload", 705, {"q.panda_joint2": 0.7, "q.panda_joint4": -0.9}),
        ("panda", "as described", 1, {"q.panda_joint2": 1.3, "q.panda_joint6": -1.2}),
        ("baxter", "payload", 3, {"q.right_s1": 0.9, "q.right_e1": 1.2}),
        ("panda", "as described", 2, {"q.panda_joint2": 1.25}),
    ],
)
def test_zeros_that_are_off_by_any_angle_are_doubted_and_not_corrected(robot, real, seed, offsets):
    wrong = sound_recordings.arm(robot, real, seed).run
    for name, offset in offsets.items():
        wrong = mistakes.moved(wrong, name, offset)
    found = inspect_runs([wrong], _model(robot))
    assert not found.corrected()
    doubted = [check for check in found.wrong if check.kind == "position_offset"]
    assert doubted
    assert all("this recording does not tell which" in check.sentence for check in doubted)
    assert {name for name in offsets if name in doubted[0].sentence}


@pytest.mark.parametrize("turns", [-1.0, 1.0])
def test_a_corrected_angle_is_within_half_a_turn(turns):
    sound = sound_recordings.arm("panda", "as described", 0).run
    wrong = mistakes.moved(sound, "q.panda_joint4", np.pi / 2 + 2.0 * np.pi * turns)
    found = inspect_runs([wrong], _model("panda"))
    mended = found.corrected()[wrong.name].applied_to(wrong)
    right = sound.channels["q.panda_joint4"].value
    np.testing.assert_allclose(mended.channels["q.panda_joint4"].value, right, atol=1e-9)


@pytest.mark.parametrize("factor", [0.4, 2.5])
def test_a_wrong_time_base_is_found_by_accelerations(factor):
    sound = sound_recordings.arm("ur5", "as described", 2).run
    slow = {
        name: Channel(factor * c.time, c.value, c.unit)
        for name, c in sound.channels.items()
        if not name.startswith("v.")
    }
    (check,) = inspect_runs([replace(sound, channels=slow)], _model("ur5")).wrong
    assert check.kind == "rate"
    assert check.correction is None


def test_rates_that_all_have_one_factor_tell_of_the_time_base():
    sound = sound_recordings.arm("ur5", "as described", 2).run
    slow = {name: Channel(2.5 * c.time, c.value, c.unit) for name, c in sound.channels.items()}
    (check,) = (c for c in inspect_runs([replace(sound, channels=slow)]).checks if c.kind == "rate")
    assert "2.5 times too far apart" in check.sentence


def test_rows_that_were_written_again_are_found():
    sound = sound_recordings.arm("ur5", "as described", 2).run
    kept = np.random.default_rng(0).random(len(sound.channels["q.elbow_joint"])) > 0.2
    kept[0] = True
    row = np.maximum.accumulate(np.where(kept, np.arange(len(kept)), 0))
    again = {name: Channel(c.time, c.value[row], c.unit) for name, c in sound.channels.items()}
    found = inspect_runs([replace(sound, channels=again)]).with_severity(Severity.SUSPECT)
    assert [check.kind for check in found] == ["repeated_samples"]
    assert not [c for c in inspect_runs([sound]).checks if c.kind == "repeated_samples"]


def test_vibrating_torques_are_not_low_passed():
    sound = sound_recordings.arm("baxter", "as described", 1).run
    rng = np.random.default_rng(0)
    noisy = {
        name: Channel(c.time, c.value + 2.0 * np.std(c.value) * rng.standard_normal(len(c)), c.unit)
        if name.startswith("tau.") else c
        for name, c in sound.channels.items()
    }  # fmt: skip
    assert inspect_runs([replace(sound, channels=noisy)], _model("baxter")).usable


def test_recordings_with_common_effects_have_the_evidence_of_one_long_recording():
    rng = np.random.default_rng(0)
    columns, measured = rng.standard_normal((1, 80, 3)), rng.standard_normal((1, 80))
    sizes = EffectSizes(np.array([0, 0, 1]), np.array([-np.inf, 0.0, -1.0]), np.array([np.inf, np.inf, 1.0]))

    def sums(part):
        one = np.ones(1)
        return ChannelReadings(
            measured[:, part], np.zeros((1, 80))[:, part], columns[:, part], sizes, one, 0.0 * one, 1e-6 * one
        ).sums

    halves = ReadingSums.joined([sums(slice(0, 40)), sums(slice(40, 80))])
    equations = halves.equations
    np.testing.assert_allclose(equations.gram.sum(axis=0), sums(slice(None)).equations.gram[0])
    found = evidence(halves)
    assert found.sizes[1] >= 0.0
    assert abs(found.sizes[2]) <= 1.0
    absent = evidence(halves, np.array([False, False, True]))
    assert absent.sizes[2] == 0.0


@pytest.mark.parametrize("joint", ["swing", "elbow"])
def test_a_wrong_sign_is_found_however_far_apart_the_moments_of_a_fast_motion_are(tmp_path, joint):
    model = urdfs.arm(tmp_path, urdfs.DOUBLE)
    robot, joints = model.arm.model, model.arm.joints

    def torque(q, v, a):
        data = robot.createData()
        rigid = np.array([pin.rnea(robot, data, *row) for row in zip(q, v, a, strict=True)])
        return rigid + np.tanh(v / 1e-2) + 0.3 * v

    run = urdfs.recorded(joints, ["rad", "rad"], torque, n=12000, noise=0.02)
    assert inspect_runs([run], model).usable
    turned = run.channels[f"tau.{joint}"]
    turned = replace(turned, value=-turned.value)
    (check, *_) = inspect_runs([replace(run, channels={**run.channels, f"tau.{joint}": turned})], model).wrong
    assert (check.kind, check.channels) == ("torque_sign", (f"tau.{joint}",))
