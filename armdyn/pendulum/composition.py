"""A load on a string with any effects, as the functions that every formulation is derived from.

The effects are applied once, here, in the order in which nature applies them. What comes out is the
Lagrangian in the load's Cartesian position, the forces, and the readings; the continuous equations
(`dynamics`) and the variational integrator (`variational`) are both derived from these same functions, and the
tension with them, so that no effect can enter one and be forgotten in another.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca

from armdyn.effects.effect import Effect
from armdyn.pendulum.physics import Expression, Gripper, Load, Sensor, String

STANDARD_GRAVITY = 9.81
"""m/s^2."""

BASE_PARAMETERS = ("length", "mass")


@dataclass(frozen=True)
class Composition:
    """Functions of time t, angle phi and the parameter vector theta (order `names`).

    Attributes:
        names: parameters in the order of theta.
        attachment: ``(t, x, v, phi, theta) -> (3,)`` upper end of the string, m.
        length: ``(t, phi, theta) -> ()`` m.
        energies: ``(t, position, velocity, gripper, gripper_velocity, phi, rate, theta) -> kinetic, potential`` J.
        forces: same arguments ``-> force (3,) N, torque () N m`` that no potential accounts for.
        readings: ``(t, tension, phi, rate, theta) -> force N, angle rad, rate rad/s``.
        timing: ``theta -> lag, delay`` of the load cell, s.
    """

    names: tuple[str, ...]
    attachment: ca.Function
    length: ca.Function
    energies: ca.Function
    forces: ca.Function
    readings: ca.Function
    timing: ca.Function


def direction(phi: Expression) -> Expression:
    """Unit vector from the pivot to the load, (3,)."""
    return ca.vertcat(-ca.sin(phi), 0, -ca.cos(phi))


def compose(effects: Sequence[Effect]) -> Composition:
    """Apply `effects`, each to its stage and in the order given, to the pendulum."""
    names = BASE_PARAMETERS + tuple(p.name for item in effects for p in item.parameters())
    theta = ca.SX.sym("theta", len(names))
    by_name = dict(zip(names, ca.vertsplit(theta), strict=True))
    mass = by_name["mass"]
    t, x, v, phi, rate, tension = (ca.SX.sym(s) for s in ("t", "x", "v", "phi", "rate", "T"))
    q, qd, g, gd = (ca.SX.sym(s, 3) for s in ("q", "qd", "g", "gd"))
    none, nothing = ca.SX(0), ca.SX.zeros(3)

    def applied(stage: Expression, acts_on: str) -> Expression:
        for item in effects:
            if item.acts_on == acts_on:
                stage = item.apply(stage, by_name)
        return stage

    gripper: Gripper = applied(Gripper(t, x, v, phi, ca.vertcat(x, 0, 0)), "gripper")
    string: String = applied(String(t, phi, rate, mass, by_name["length"], none, none), "string")
    load: Load = applied(Load(t, mass, q, qd, phi, rate, nothing, none), "load")
    sensor: Sensor = applied(Sensor(t, tension, tension, phi, rate, none, none), "sensor")

    # A uniform string has the kinetic energy of a rod whose ends move as gripper and load do.
    kinetic = (
        load.mass * ca.sumsqr(qd) / 2
        + load.inertia * rate**2 / 2
        + string.mass * (ca.sumsqr(qd) + ca.sumsqr(gd) + ca.dot(qd, gd)) / 6
    )
    potential = STANDARD_GRAVITY * (load.mass * q[2] + string.mass * (q[2] + g[2]) / 2)
    mechanics = [t, q, qd, g, gd, phi, rate, theta]
    return Composition(
        names=names,
        attachment=ca.Function("attachment", [t, x, v, phi, theta], [gripper.position]),
        length=ca.Function("length", [t, phi, theta], [string.length]),
        energies=ca.Function("energies", mechanics, [kinetic, potential]),
        forces=ca.Function("forces", mechanics, [load.force, string.torque]),
        readings=ca.Function("readings", [t, tension, phi, rate, theta], [sensor.force, sensor.angle, sensor.rate]),
        timing=ca.Function("timing", [theta], [sensor.lag, sensor.delay]),
    )
