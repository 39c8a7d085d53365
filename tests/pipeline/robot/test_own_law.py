"""A user's own law in the simulated robot, against the solution of equations written down here."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from armdyn.errors import InputError

G, LENGTH, MASS = 9.81, 0.368, 0.08
FILE = '''
import casadi as ca
from armdyn import effect, quantity

@effect(summary="a spring", source="a test")
def leaf(string, stiffness=quantity("N m/rad^3", typical=0.5, upper=2), rest=quantity("rad", typical=0.1, null=0.1)):
    """M = -k (angle - rest)^3."""
    return string.with_torque(-stiffness * (string.angle - rest) ** 3)

@effect(summary="a force", source="a test")
def push(load, force=quantity("N", typical=0.1), place=quantity("m", typical=0.1, null=0.05)):
    """F = f along the line where the load is beyond a place, and half of it upwards."""
    f = ca.if_else(load.position[0] > place, force, 0)
    return load.with_force(ca.vertcat(f, 0, f / 2))

@effect(summary="friction", source="a test")
def rub(string, friction=quantity("N m", typical=1e-3, lower=0)):
    return string.with_dry_torque(friction)

@effect(summary="mass", source="a test")
def heavy(string, mass=quantity("kg", typical=1e-3, lower=0)):
    return string.with_mass(mass)

@effect(summary="play", source="a test")
def play(string, friction=quantity("N m", typical=1e-3)):
    string, z = string.with_state(lambda z: string.rate - z)
    return string.with_torque(friction * z)

@effect(summary="bent", source="a test")
def bent(gripper, height=quantity("m", typical=1e-3)):
    return gripper.with_position(gripper.position + ca.vertcat(0, 0, height))
'''


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    path = tmp_path_factory.mktemp("own") / "laws.py"
    path.write_text(FILE)
    return path


def solve(torque, time, angle):
    """Angle of m l^2 angle'' = -m g l sin(angle) + torque(angle)."""

    def rates(_, y):
        return y[1], -G / LENGTH * np.sin(y[0]) + torque(y[0]) / (MASS * LENGTH**2)

    return solve_ivp(rates, (0.0, time[-1]), (angle, 0.0), t_eval=time, rtol=1e-8, atol=1e-10, max_step=0.01).y[0]


def leaf(angle):
    return -0.5 * (angle - 0.1) ** 3


def push(angle):
    # The load is at -l sin(angle), and moves by l (-cos, sin) as the angle grows.
    return 0.05 * LENGTH * (-np.cos(angle) + np.sin(angle) / 2) if -LENGTH * np.sin(angle) > 0.05 else 0.0


@pytest.mark.parametrize(("law", "torque"), [("leaf", leaf), ("push=0.05", push)])
def test_a_swing_with_a_law_of_ones_own_follows_its_equation(still_pendulum, watch, file, law, torque):
    name, _, value = law.partition("=")
    swing = watch(still_pendulum(0.4, {f"{file}:{name}": float(value) if value else None}), 5.0)
    expected, plain = solve(torque, swing.time, 0.4), solve(lambda _: 0.0, swing.time, 0.4)
    error, effect = np.abs(swing.angle - expected).max(), np.abs(plain - expected).max()
    assert error < 6e-3 < effect / 6


def test_dry_friction_of_ones_own_is_that_of_the_plant(still_pendulum, watch, file):
    own = watch(still_pendulum(0.1, {f"{file}:rub": 2e-3}), 4.0)
    known = watch(still_pendulum(0.1, {"pivot_coulomb_friction": 2e-3}), 4.0)
    np.testing.assert_allclose(own.angle, known.angle, atol=1e-4)


@pytest.mark.parametrize(
    ("name", "value"), [("heavy", None), ("play", None), ("bent", None), ("leef", None), ("leaf", 3.0)]
)
def test_what_the_plant_cannot_have_is_said(plant, file, name, value, complains):
    with complains(InputError):
        plant({f"{file}:{name}": value})
