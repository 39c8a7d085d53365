"""Mistakes in recordings as imperfect as real ones are: found with the right kind, mended to the sound twin's story."""

from dataclasses import replace

import numpy as np
import pytest
from worlds import imperfect_arm, imperfect_mistakes, imperfect_pendulum, mistakes

from armdyn.arm.model import arm_model
from armdyn.inspection.check import Severity
from armdyn.inspection.inspect import inspect_runs
from armdyn.pendulum.model import pendulum_model
from armdyn.run import Channel

CLOCK, DRIFT = 0.03, 2e-3  # s, and share: to which a clock is fitted


@pytest.mark.parametrize(
    "seed", [6010, pytest.param(6015, marks=pytest.mark.slow)], ids=["driven, an encoder", "driven, a load cell alone"]
)
def test_mistakes_with_a_moving_gripper_are_named_and_its_clock_is_fitted(seed):
    world = imperfect_pendulum.world(seed, "names")
    run, model = world.runs[0], pendulum_model(*world.guess)
    assert not inspect_runs([run], model).checks
    for mistake in imperfect_mistakes.of_pendulum(run, np.random.default_rng(seed)):
        found = inspect_runs([mistake.run], model)
        assert {check.kind for check in found.wrong} <= mistake.kinds, mistake.name
        assert found.wrong, mistake.name
        if mistake.name.startswith("gripper's clock"):
            (reading, *_) = found.corrected()[run.name].readings.values()
            wrong, right = mistake.run.channels["gripper_x"].time, run.channels["gripper_x"].time
            pace = (wrong[-1] - wrong[0]) / (right[-1] - right[0]) - 1.0
            assert reading.delay == pytest.approx(right[0] - wrong[0], abs=CLOCK)
            assert reading.clock_rate_error == pytest.approx(-pace, abs=DRIFT)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [703])
def test_mistakes_with_an_arm_are_named(seed):
    robot, case = imperfect_arm.ROBOTS[seed % 3], list(imperfect_arm.CASES)[seed * 7 % len(imperfect_arm.CASES)]
    run, plant = imperfect_arm.generate(robot, case, seed, duration=12.0).train[0], mistakes.Plant(robot)
    model = arm_model(robot=robot, joints=plant.joints)
    assert not [check for check in inspect_runs([run], model).checks if check.severity is not Severity.NOTE]
    for mistake in imperfect_mistakes.of_arm(run, plant, np.random.default_rng(seed)):
        found = inspect_runs([mistake.run], model)
        assert any(check.kind in mistake.kinds for check in found.checks), mistake.name
        assert {check.kind for check in found.wrong} <= mistake.kinds, mistake.name
        assert mistake.undone or not found.corrected(), mistake.name


@pytest.mark.parametrize("turn", [2.0 * np.pi, 360.0])
def test_a_joint_that_is_counted_anew_after_a_turn_is_unwound(turn):
    world = imperfect_pendulum.world(6010, "names")
    run = world.runs[0]
    angle = run.channels["swing_angle"]
    size = turn * (0.3 + 0.02 * angle.time)  # goes round while it swings
    wound = (size + angle.value + 0.5 * turn) % turn - 0.5 * turn
    run = replace(run, channels={**run.channels, "swing_angle": Channel(angle.time, wound, "rad")})
    found = inspect_runs([run])
    (check,) = found.wrong
    assert check.kind == "wrapped"
    mended = found.corrected()[run.name].applied_to(run).channels["swing_angle"].value
    np.testing.assert_allclose(np.diff(mended), np.diff(size + angle.value), atol=1e-9)


def test_values_that_runs_do_not_determine_are_not_called_implausible():
    from armdyn.effects.catalogue import CATALOGUE
    from armdyn.inspection.plausible import implausible_values

    model = arm_model(robot="ur5").with_effect(CATALOGUE["torque_offset"])
    name = f"torque_offset.torque[{model.joints[0]}]"
    for std, told in ((None, True), (1.0, True), (300.0, False)):
        said = implausible_values(model.with_parameters({name: model.parameters[name].with_value(500.0, std)}))
        assert bool(said) is told
