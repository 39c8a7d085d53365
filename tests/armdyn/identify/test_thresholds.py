"""Effects with a place that nobody knows: a stop, an edge that rubs, the end of some play."""

from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from worlds import thresholds

from armdyn.arm.model import arm_model
from armdyn.effects.catalogue import CATALOGUE
from armdyn.effects.effect import effect
from armdyn.identify.repair import add, repair
from armdyn.identify.studies import make_study
from armdyn.identify.thresholds import likeliest_thresholds
from armdyn.parameter import quantity
from armdyn.pendulum.model import pendulum_model
from armdyn.physics import Equations, Expression, Stage, constant, physics, state
from armdyn.physics.model import physics_model
from armdyn.run import Channel, Run

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


@dataclass(frozen=True)
class Runner(Stage):
    """A sled, on which friction and a buffer act."""

    place: Expression
    speed: Expression
    push: Expression = 0


@effect("rub", acts_on="runner", summary="dry friction", source="Coulomb 1785")
def rub(runner, size=quantity("m/s^2", typical=0.1, lower=0.0)):
    return replace(runner, push=runner.push - size * ca.tanh(runner.speed / 0.002))


@effect("buffer", acts_on="runner", summary="a spring behind an edge", source="Hooke 1678")
def buffer(runner, size=quantity("1/s^2", typical=3.0, lower=0.0), edge=quantity("m", typical=0.03)):
    return replace(runner, push=runner.push - size * ca.fmax(0, runner.place - edge))


@physics(
    "sled", summary="", source="", outputs={"q.sled": "m"}, inputs={"extra.push": "m/s^2"}, period=2.0,
    parameters=(constant("square", "1/s^2", 8.0, lower=0.1),),
    states=(state("place", "m", typical=0.1), state("speed", "m/s", typical=0.3)),
)  # fmt: skip
def sled(at):
    runner = at.stage("runner", Runner(at["place"], at["speed"]))
    pushed = at.input("extra.push").value + runner.push - at["square"] * at["place"]
    return Equations({"place": at["speed"], "speed": pushed}, {"q.sled": at["place"]})


EDGE = 0.12


def _sled_run(seed):
    """Truth by scipy: dry friction of 0.5 m/s^2, and a buffer of 6 1/s^2 behind the edge."""
    rng, time = np.random.default_rng(seed), np.arange(0.0, 12.0, 0.01)
    pace, phase = 2.8 * rng.uniform(0.3, 1.2, 3), rng.uniform(0.0, 6.0, 3)

    def push(t):
        return 0.8 * np.sum(np.sin(np.multiply.outer(t, pace) + phase), axis=-1)

    def rates(t, s):
        return [s[1], push(t) - 8.3 * s[0] - 0.5 * np.tanh(s[1] / 0.002) - 6.0 * max(0.0, s[0] - EDGE)]

    place = solve_ivp(rates, (0.0, 12.0), (0.2, 0.0), "LSODA", time, rtol=1e-8, atol=1e-10, max_step=0.01).y[0]
    channels = {"q.sled": Channel(time, place + 1e-4 * rng.normal(size=len(time)), "m")}
    return Run(f"{seed}.csv", {**channels, "extra.push": Channel(time, push(time), "m/s^2")})


def test_a_place_that_friction_hides_is_looked_for_beside_the_friction():
    study = make_study(physics_model(sled), [_sled_run(1), _sled_run(2)], [], [rub, buffer])
    motion = study.motion
    hidden = motion.threshold_values["buffer.edge"]
    assert study.move_thresholds(motion.base | motion.problem.mask_of_unknowns(["rub.size"])) == ["buffer.edge"]
    found = motion.threshold_values["buffer.edge"]
    assert abs(found - EDGE) < 0.04 < 0.08 < abs(hidden - EDGE)
    assert study.problem.null[study.problem.mask_of_unknowns(["buffer.edge"])] == found
    both = study.fit_base_with_effects(study.candidates)
    assert both.values[study.problem.mask_of_unknowns(["buffer.edge"])] == pytest.approx(EDGE, abs=1e-3)
