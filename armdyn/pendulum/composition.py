"""A load on a string with any effects, as the functions that every formulation is derived from.

The effects are applied once, here, in the order in which nature applies them: whatever the order in which they were
added, the model is the same. What comes out is the Lagrangian in the load's Cartesian position, the forces, and the
readings; the continuous equations (`dynamics`) and the variational integrator (`variational`) are both derived from
these same functions, and the tension with them, so that no effect can enter one and be forgotten in another.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import casadi as ca

from armdyn.effects.catalogue import CATALOGUE
from armdyn.effects.effect import Effect
from armdyn.errors import InputError
from armdyn.pendulum.physics import STANDARD_GRAVITY as STANDARD_GRAVITY
from armdyn.pendulum.physics import Expression, Gripper, Load, Sensor, String, Tension

STAGES = ("gripper", "string", "load", "tension", "sensor")
"""What effects may act on, in the order in which nature applies them."""
BASE_PARAMETERS = ("length", "mass")
RIGID = 1e-12
"""m/N; added to a compliance by which is divided."""


@dataclass(frozen=True)
class Composition:
    """Functions of time t, angle phi and the parameter vector theta (order `names`).

    Attributes:
        names: parameters in the order of theta.
        attachment: ``(t, x, v, z, phi, theta) -> (3,)`` upper end of the string, m.
        length: ``(t, phi, theta) -> ()`` m.
        energies: ``(t, position, velocity, gripper, gripper_velocity, phi, rate, theta) -> kinetic, potential`` J.
        forces: same arguments and memory ``-> force (3,) N, torque () N m`` that no potential accounts for, and the
            size ``() N m`` of the dry friction against the swing.
        tension: ``(tension, phi, rate, acceleration, length, theta) -> tension`` N, of the string.
        readings: ``(t, tension, phi, rate, theta, memory) -> force N, angle rad, rate rad/s``.
        memory_rates: ``(t, ..., theta, memory, tension) -> (n,)`` rates of the states that effects bring, with the
            arguments of `energies` first.
        memory_start: ``theta -> (n,)`` what they are at the start of a run.
        timing: ``theta -> lag, delay of the load cell, lag of the gripper``, s.
        compliance: ``theta -> (2,)`` of the string and of the gripper, m/N.
        bounce: ``theta -> (2,)`` of the load on its string: 1/w^2, s^2, and damping ratio; None where it is rigid.
        string_weight: ``theta -> (3,)`` mass of the string times gravity, N, in the frame of the line.
        string_mass: ``theta -> ()`` kg.
        transverse: ``theta -> (3,)`` swing across the line at the start, see `physics.Load`.
        heavy: whether the string has mass.
        rubs: whether there is dry friction.
        yields: whether string or gripper give way to the tension.
        crosses: whether the load swings across the line as well.
        gripper_lag: ``theta -> ()`` s; None where the gripper does not trail its measured position.
    """

    names: tuple[str, ...]
    attachment: ca.Function
    length: ca.Function
    energies: ca.Function
    forces: ca.Function
    tension: ca.Function
    readings: ca.Function
    memory_rates: ca.Function
    memory_start: ca.Function
    timing: ca.Function
    compliance: ca.Function
    bounce: ca.Function | None
    string_weight: ca.Function
    string_mass: ca.Function
    transverse: ca.Function
    heavy: bool
    rubs: bool
    yields: bool
    crosses: bool
    gripper_lag: ca.Function | None

    @property
    def remembers(self) -> int:
        """Number of states that effects bring."""
        return int(self.memory_start.numel_out(0))


def direction(phi: Expression) -> Expression:
    """Unit vector from the pivot to the load, (3,)."""
    return ca.vertcat(-ca.sin(phi), 0, -ca.cos(phi))


def natural_order(effects: Iterable[Effect]) -> tuple[Effect, ...]:
    """Effects in the order in which nature applies them: by stage, then as the catalogue lists them, then by name."""
    place = {name: i for i, name in enumerate(CATALOGUE)}
    return tuple(sorted(effects, key=lambda e: (STAGES.index(e.acts_on), place.get(e.name, len(place)), e.name)))


def compose(effects: Sequence[Effect]) -> Composition:
    """Apply `effects`, each to its stage and in their natural order, to the pendulum."""
    effects = natural_order(effects)
    names = BASE_PARAMETERS + tuple(p.name for item in effects for p in item.parameters())
    theta = ca.SX.sym("theta", len(names))
    by_name = dict(zip(names, ca.vertsplit(theta), strict=True))
    mass = by_name["mass"]
    t, x, v, z, phi, rate, tension = (ca.SX.sym(s) for s in ("t", "x", "v", "z", "phi", "rate", "T"))
    q, qd, g, gd = (ca.SX.sym(s, 3) for s in ("q", "qd", "g", "gd"))

    def applied(stage: Expression, acts_on: str) -> Expression:
        for item in effects:
            if item.acts_on == acts_on:
                stage = item.apply(stage, by_name)
        return stage

    gripper: Gripper = applied(Gripper(t, x, v, z, phi, ca.vertcat(x, 0, z)), "gripper")
    string: String = applied(String(t, phi, rate, mass, by_name["length"]), "string")
    load: Load = applied(Load(t, mass, q, qd, phi, rate), "load")
    acceleration, length = ca.SX.sym("a"), ca.SX.sym("l")
    pull: Tension = applied(Tension(tension, phi, rate, mass, length, acceleration), "tension")
    sensor: Sensor = applied(Sensor(t, tension, phi, tension, phi, rate), "sensor")

    # A uniform string has the kinetic energy of a rod whose ends move as gripper and load do.
    kinetic = (
        load.mass * ca.sumsqr(qd) / 2
        + load.inertia * rate**2 / 2
        + string.mass * (ca.sumsqr(qd) + ca.sumsqr(gd) + ca.dot(qd, gd)) / 6
    )
    up = ca.vertcat(-ca.sin(gripper.tilt), 0, ca.cos(gripper.tilt))
    potential = STANDARD_GRAVITY * (load.mass * ca.dot(up, q) + string.mass * ca.dot(up, q + g) / 2)
    mechanics = [t, q, qd, g, gd, phi, rate, theta]
    compliance = ca.vertcat(string.compliance, gripper.compliance)
    bounce = ca.vertcat(string.compliance * load.mass, string.damped / (string.compliance + RIGID))
    brought = [m for stage in (string, load, pull, sensor) for m in stage.memory]
    memory, rates, starts = (ca.vertcat(*(m[i] for m in brought)) if brought else ca.SX(0, 1) for i in range(3))
    timing = [sensor.lag, sensor.delay, gripper.lag]
    elsewhere = [gripper.position, string.length, kinetic, potential, pull.value, compliance, load.transverse, starts]
    if gripper.memory or (brought and ca.depends_on(ca.vertcat(*elsewhere, *timing), memory)):
        raise InputError("an effect lets a state of its own act otherwise than by a force, a torque or a reading")
    return Composition(
        names=names,
        attachment=ca.Function("attachment", [t, x, v, z, phi, theta], [gripper.position]),
        length=ca.Function("length", [t, phi, theta], [string.length]),
        energies=ca.Function("energies", mechanics, [kinetic, potential]),
        forces=ca.Function("forces", [*mechanics, memory], [load.force, string.torque, string.dry]),
        tension=ca.Function("tension", [tension, phi, rate, acceleration, length, theta], [pull.value]),
        readings=ca.Function(
            "readings", [t, tension, phi, rate, theta, memory], [sensor.force, sensor.angle, sensor.rate]
        ),
        memory_rates=ca.Function("memory_rates", [*mechanics, memory, tension], [rates]),
        memory_start=ca.Function("memory_start", [theta], [starts]),
        timing=ca.Function("timing", [theta], timing),
        compliance=ca.Function("compliance", [theta], [ca.densify(compliance)]),
        bounce=None if string.compliance.is_zero() else ca.Function("bounce", [theta], [bounce]),
        string_weight=ca.Function("string_weight", [theta], [-STANDARD_GRAVITY * string.mass * up]),
        string_mass=ca.Function("string_mass", [theta], [string.mass]),
        transverse=ca.Function("transverse", [theta], [ca.densify(load.transverse)]),
        heavy=not string.mass.is_zero(),
        rubs=not string.dry.is_zero(),
        yields=not compliance.is_zero(),
        crosses=not load.transverse.is_zero(),
        gripper_lag=None if gripper.lag.is_zero() else ca.Function("gripper_lag", [theta], [gripper.lag]),
    )


def quasi_static(composition: Composition, *, trailing: bool) -> tuple[ca.Function, ca.Function]:
    """Attachment and length of a composition whose lag and compliance are treated to first order, for control.

    The gripper trails by lag times velocity if `trailing`, and what yields does so under the weight's component along
    the string.

    Returns:
        ``(t, x, v, z, phi, theta) -> (3,)`` and ``(t, phi, theta) -> ()``, as in `Composition`.
    """
    trailing = trailing and composition.gripper_lag is not None
    if not (composition.yields or trailing):
        return composition.attachment, composition.length
    t, x, v, z, phi = (ca.SX.sym(s) for s in ("t", "x", "v", "z", "phi"))
    theta = ca.SX.sym("theta", len(composition.names))
    string, gripper = ca.vertsplit(composition.compliance(theta))
    pull = STANDARD_GRAVITY * theta[composition.names.index("mass")] * ca.cos(phi)
    _, _, lag = composition.timing(theta)
    position = composition.attachment(t, x - lag * v if trailing else x, v, z, phi, theta)
    position -= ca.vertcat(gripper * pull * ca.sin(phi), 0, 0)
    length = composition.length(t, phi, theta) + string * pull
    return (
        ca.Function("attachment", [t, x, v, z, phi, theta], [position]),
        ca.Function("length", [t, phi, theta], [length]),
    )
