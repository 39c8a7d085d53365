"""Effects with a place that nobody knows: a stop, an edge that rubs, the end of some play."""

import numpy as np
import pytest
from worlds import thresholds

from armdyn.arm.model import arm_model
from armdyn.effects.catalogue import CATALOGUE
from armdyn.identify.repair import add, repair
from armdyn.identify.studies import make_study
from armdyn.identify.thresholds import likeliest_thresholds
from armdyn.pendulum.model import pendulum_model

SURELY = 3.0
OTHERS = {
    "pendulum": ("quadratic_drag", "pivot_coulomb_friction", "sensor_bias"),
    "arm": ("joint_coulomb_friction", "joint_spring", "torque_gain", "torque_offset"),
}


def _study(one):
    model = pendulum_model(0.35, 0.1) if one.robot == "pendulum" else arm_model(robot="baxter")
    beside = [CATALOGUE[name] for name in OTHERS[one.robot]]
    return make_study(model, one.runs[:2], one.runs[2:], [*beside, *thresholds.effects(one.robot)])


def _is_told(found, one):
    assert [effect.label for effect in found.effects] == one.labels
    for name, value in one.true.items():
        told = found.parameters[name]
        assert abs(told.value - value) < SURELY * (told.std or 0.0), name


@pytest.mark.parametrize("hidden", ["cover_rub", "tired_gauge"])
def test_a_threshold_of_an_arms_joint_is_found_with_its_place(hidden):
    one = thresholds.of_arm(hidden, 5, seconds=8.0)
    _is_told(repair(_study(one)).model_without_background, one)


def test_a_threshold_of_a_pendulum_is_found_with_its_place():
    one = thresholds.of_pendulum("tired_cell", 5, seconds=8.0)
    _is_told(repair(_study(one)).model_without_background, one)


@pytest.mark.parametrize("make", [thresholds.of_pendulum, thresholds.of_arm])
def test_without_a_threshold_none_is_named(make):
    assert repair(_study(make("", 5, seconds=5.0))).model_without_background.effects == ()


def test_the_place_of_an_effect_that_is_asked_for_is_fitted():
    one = thresholds.of_arm("stop", 5, seconds=8.0)
    stop = next(effect for effect in thresholds.effects("arm") if effect.name == "stop")
    _is_told(add(_study(one), [stop.on("right_e1")]).model_without_background, one)


def test_a_threshold_that_nothing_shows_is_not_told_and_of_equal_ones_the_declared_one_is():
    one, sizes = np.ones(3), np.array([1.0, 2.0, 0.5])

    def evidence(at):
        near = -((at[0] - 4.3) ** 2)  # between two of the tried ones
        return np.array([near, 7.0, float(at[2] > 0.0)])  # nothing shows; all above 0 are equal

    found = likeliest_thresholds(
        evidence, np.array([0.0, 1.0, 1.0]), sizes, -np.inf * one, np.array([np.inf, np.inf, 4.0])
    )
    assert found[0] == pytest.approx(4.3, abs=0.13)
    assert np.isnan(found[1])
    assert found[2] == 1.0
