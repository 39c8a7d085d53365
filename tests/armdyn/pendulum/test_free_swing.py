"""What people do before and after a free swing is not a part of it; what friction does is."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from armdyn.pendulum.model import pendulum_model
from armdyn.pendulum.start import free_swing_part
from armdyn.run import Channel, Run

RATE, LENGTH, SWING = 60.0, 0.45, 1.35


def recorded(amplitude, seconds, *, viscous=0.0, coulomb=0.0, held=0.0, caught=0.0, pushed=False, rate=False):
    """A swing by equations of its own, held or hanging before it, caught after it; angle (rad) or rate (rad/s)."""
    time = np.arange(0.0, seconds, 1.0 / RATE)

    def change(t, s):
        push = 8.0 * amplitude if pushed and t < 0.25 else 0.0
        return [s[1], push - 9.81 / LENGTH * np.sin(s[0]) - viscous * s[1] - coulomb * np.tanh(s[1] / 1e-3)]

    start = [0.0 if pushed else amplitude, 0.0]
    states = solve_ivp(change, (0.0, seconds), start, "LSODA", time, max_step=0.01, rtol=1e-8).y
    value = states[1 if rate else 0]
    before = np.full(round(held * RATE), value[0])
    after = np.full(round(caught * RATE), 0.0 if rate else value[-1])
    whole = np.concatenate([before, value, after])
    whole += 2e-3 * np.random.default_rng(0).normal(size=len(whole))
    name, unit = ("swing_rate", "rad/s") if rate else ("swing_angle", "rad")
    return Run("a.csv", {name: Channel(np.arange(len(whole)) / RATE, whole, unit)})


def span(run):
    (channel,) = run.channels.values()
    return channel.time[0], channel.time[-1]


@pytest.mark.parametrize("rate", [False, True])
def test_a_load_that_is_held_is_compared_from_where_it_is_let_go(rate):
    run = recorded(0.5, 20.0, coulomb=0.1, held=2.0, rate=rate)
    found = free_swing_part(run, SWING)
    begin, end = span(found)
    assert 2.0 <= begin < 2.2 + rate * SWING / 2
    assert end == span(run)[1]
    assert "held" in found.warnings[0]


def test_a_load_that_hangs_is_compared_from_where_nobody_pushes_it():
    begin, _ = span(free_swing_part(recorded(0.5, 20.0, held=2.0, pushed=True), SWING))
    assert 2.25 < begin < 2.25 + SWING


@pytest.mark.parametrize("rate", [False, True])
def test_a_load_that_is_caught_is_compared_until_then(rate):
    run = recorded(0.5, 8.0, coulomb=0.1, caught=2.0, rate=rate)
    found = free_swing_part(run, SWING)
    begin, end = span(found)
    assert begin == 0.0
    assert 8.0 - SWING < end < 8.0
    assert "caught" in found.warnings[0]


@pytest.mark.parametrize(
    "friction", [{}, {"viscous": 0.1}, {"viscous": 1.0}, {"coulomb": 0.1}, {"coulomb": 0.5}, {"coulomb": 2.0}]
)
@pytest.mark.parametrize("amplitude", [0.1, 0.6, 2.0, 2.9])
def test_a_free_swing_is_whole(friction, amplitude):
    run = recorded(amplitude, 40.0, **friction)
    assert free_swing_part(run, SWING) is run


def test_a_load_that_leaves_the_upright_slowly_is_not_held():
    run = recorded(3.1, 40.0, viscous=0.1)
    assert free_swing_part(run, SWING) is run


def test_a_recording_at_rest_is_left_alone():
    rest = recorded(0.0, 5.0)
    assert free_swing_part(rest, SWING) is rest


def test_a_load_below_a_gripper_may_rest_at_first():
    run = recorded(0.5, 20.0, held=2.0)
    moved = Run("b.csv", {**run.channels, "gripper_x": Channel(np.arange(0.0, 22.0, 0.1), np.zeros(220), "m")})
    model = pendulum_model(LENGTH, 0.1)
    assert model.split_into_pieces(moved) == (moved,)
    assert span(model.split_into_pieces(run)[0])[0] >= 2.0
