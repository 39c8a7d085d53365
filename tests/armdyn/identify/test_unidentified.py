"""What a pendulum without a known mass tells: its drag per kilogram; values hold for the effect that is named."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import armdyn
from armdyn.effects.catalogue import CATALOGUE
from armdyn.run import Channel

G, LENGTH, DRAG, FRICTION = 9.81, 1.12, 0.02, 0.05
"""Gravity [m/s^2], length [m], drag over mass [1/m], and friction of the pivot over mass and length squared [1/s^2]."""


def swing(name, start, friction, seed):
    """A swing that scipy simulates and a camera sees, 30 times per second."""
    time, rng = np.arange(0.0, 30.0, 1.0 / 30.0), np.random.default_rng(seed)

    def slope(_, state):
        angle, rate = state
        turned = -G / LENGTH * np.sin(angle) - DRAG * LENGTH * rate * abs(rate) - friction * np.tanh(rate / 1e-3)
        return [rate, turned]

    angle = solve_ivp(slope, (0.0, time[-1]), (start, 0.0), t_eval=time, rtol=1e-8, atol=1e-10, max_step=0.01).y[0]
    return armdyn.Run(name, {"swing_angle": Channel(time, angle + rng.normal(0.0, 5e-4, time.size), "rad")})


@pytest.fixture(scope="module")
def swings():
    return [swing("a", 0.9, 0.0, 0), swing("b", 0.6, 0.0, 1)]


def test_a_drag_is_told_per_kilogram_where_the_mass_is_not_known(swings):
    found = armdyn.add(armdyn.pendulum.pendulum_model(length=1.0, mass=0.3), "quadratic_drag", swings)
    (one,) = found.after.unidentified_combinations
    words = one.quotients[0].split()
    assert words[:4] == ["quadratic_drag.coefficient", "/", "mass", "="]
    value, std = float(words[4]), float(words[6])
    assert abs(value - DRAG) < 4.0 * std < 0.02 * DRAG
    assert any("determine only quotients" in text for text in found.after.remarks)


def test_the_values_are_said_to_hold_for_the_effect_that_is_named(swings):
    given = armdyn.pendulum.pendulum_model(length=1.0, mass=0.3)
    rubbed = [swing("a", 0.9, FRICTION, 0), swing("b", 0.6, FRICTION, 1)]
    effects = [CATALOGUE[name] for name in ("quadratic_drag", "pivot_coulomb_friction", "pivot_load_friction")]
    found = armdyn.repair(given, rubbed, effects=effects)
    tied = [name for step in found.path for name in step.tied_with]
    assert tied
    _, parameters, *_ = found.document().sections
    assert parameters.sentence.startswith("The values hold if what acts is")
    _, parameters, *_ = armdyn.repair(given, swings, effects=effects[:1]).document().sections
    assert "The values hold" not in parameters.sentence
