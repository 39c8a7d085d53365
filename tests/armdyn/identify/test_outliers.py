"""One sample in a hundred that is wrong neither hides an effect nor moves a value."""

from dataclasses import replace

import numpy as np
import pytest
from worlds.baxter import generate
from worlds.mistakes import spoilt
from worlds.pendulum import REALISTIC, Setup, record

from armdyn.arm.model import arm_model
from armdyn.effects.catalogue import CATALOGUE
from armdyn.front import compare, diagnose, repair
from armdyn.identify.sentence import Verdict
from armdyn.model_file import base_pendulum
from armdyn.run import Channel

FRICTION = "pivot_viscous_friction"
CHOICE = [CATALOGUE[name] for name in (FRICTION, "sensor_delay", "sensor_gain", "string_mass")]
LOAD = ("load_force", "gripper_x")


def swing(hidden=True, seed=1):
    setup = Setup(hidden={FRICTION: REALISTIC[FRICTION]} if hidden else {}, duration=8.0, encoder_noise=1e-4)
    run = record("a.csv", setup, np.random.default_rng(seed))
    return replace(run, noise={})  # nobody stated the noise


def spiked(run, at=400, by=47.0):
    force = run.channels["load_force"]
    value = force.value.copy()
    value[at] += by
    return replace(run, channels={**run.channels, "load_force": Channel(force.time, value, "N")})


@pytest.mark.parametrize("at", [0, 400])
def test_one_spike_of_47_newton_does_not_hide_friction(at):
    found = diagnose(base_pendulum(), [spiked(swing(), at)], effects=CHOICE)
    assert found.verdict is Verdict.EFFECT_MISSING
    assert found.ranked_effects[0].effect == FRICTION
    assert found.remarks.endswith("Left out as outliers: 1 of load_force.")


def test_one_sample_in_a_hundred_neither_hides_friction_nor_moves_a_value():
    clean, bad = swing(seed=0), spoilt(swing(seed=0), LOAD, 0.01, 0)
    found, truth = (repair(base_pendulum(), [run], effects=CHOICE) for run in (bad, clean))
    assert [effect.name for effect in found.model.effects] == [FRICTION]
    for name, parameter in truth.model.parameters.items():
        if parameter.scope == "shared":
            assert abs(found.model.value(name) - parameter.value) < parameter.std
    assert "Left out as outliers" in found.remarks


def test_one_sample_in_a_hundred_makes_no_effect_up():
    clean, bad = swing(hidden=False), spoilt(swing(hidden=False), LOAD, 0.01, 1)
    assert diagnose(base_pendulum(), [bad], effects=CHOICE).verdict is Verdict.EXPLAINED
    found, truth = (compare(base_pendulum(), [run]).parameters["length"] for run in (bad, clean))
    assert abs(found.value - truth.value) < truth.std


def test_spikes_in_a_fast_recording_are_left_out_before_samples_are_averaged():
    setup = Setup(duration=5.0, force_noise=9e-3)
    slow = record("a.csv", setup, np.random.default_rng(0))
    time = np.arange(0.0, 4.9, 1e-3)
    force = np.interp(time, slow.channels["load_force"].time, slow.channels["load_force"].value)
    force += 9e-3 * np.random.default_rng(1).normal(size=len(time))
    fast = replace(slow, channels={**slow.channels, "load_force": Channel(time, force, "N")})
    bad = spoilt(fast, ("load_force",), 0.01, 3)
    found = compare(base_pendulum(), [bad])
    truth = compare(base_pendulum(), [fast])
    assert found.channels["load_force"].rmse == pytest.approx(truth.channels["load_force"].rmse, rel=0.05)


def test_wrong_torques_and_positions_of_an_arm_hide_no_friction():
    run = generate("joint_viscous_friction", 1, 5, duration=8.0)
    bad = spoilt(run, [name for name in run.channels if name[0] in "qt"], 0.01, 3)
    choice = [CATALOGUE[name] for name in ("joint_viscous_friction", "torque_delay", "rotor_inertia")]
    found = diagnose(arm_model(robot="baxter"), [bad], effects=choice)
    assert found.verdict is Verdict.EFFECT_MISSING
    assert found.ranked_effects[0].effect == "joint_viscous_friction"
    assert sum(found.comparison.fit.problem.runs[0].outliers.values()) > 100
