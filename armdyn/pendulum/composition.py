"""Apply effects to a load on a string: symbolic stages that the equations of motion evaluate.

The continuous equations (`dynamics`) and the variational integrator (`variational`) use the same stages for the
Lagrangian in the load's Cartesian position, the forces and the readings, and the tension follows from them. So an
effect cannot enter one of them and be forgotten in another.
"""

from collections.abc import Mapping, Sequence
from types import MappingProxyType

import casadi as ca

from armdyn.effects.catalogue import catalogue_order
from armdyn.effects.effect import Effect, recorded_columns
from armdyn.errors import InputError
from armdyn.parameter import RecordedColumn
from armdyn.pendulum.physics import Expression, Gripper, Load, Sensor, String, Tension
from armdyn.physics.definition import Moment

PENDULUM_STAGES = ("gripper", "string", "load", "tension", "sensor")
"""Names of a pendulum's stages, on which effects may act, in their physical order."""
BASE_PARAMETERS = ("length", "mass", "gravity")
ADDED_COMPLIANCE = 1e-12
"""Compliance, m/N, added to a compliance in a denominator, so that it is not zero."""


class PendulumComposition:
    """Symbolic expressions of a pendulum with effects, which act in their physical order.

    Attributes:
        names: names of the parameters in the order of theta.
        theta: (p,) symbols of the parameters; all expressions below are functions of them.
        compliance: (2,) compliances of the string and of the gripper, m/N.
        bounce_vibration: (2,) vibration of the load on its string: 1/w^2, s^2, and damping ratio; None for a rigid
            string.
        sensor_lag: (3,) lags of the readings of force, angle and rate, s.
        sensor_delay: (3,) delays of these readings, s.
        gripper_lag: lag of the gripper behind its measured position, s.
        transverse: (3,) moments of the swing across the line at the start, see `physics.Load`.
        string_has_mass: whether the string has mass.
        has_dry_friction: whether there is dry friction.
        is_compliant: whether the string or the gripper yields elastically to the tension.
        swings_across_line: whether the load also swings across the line.
        gripper_has_lag: whether the real gripper lags behind its measured position.
        added_state_count: number of states that effects add.
        recorded: symbols of the further recorded quantities that effects read.

    Raises:
        InputError: a state of an effect, or a recorded quantity, changes something other than a force, a torque or a
            reading, or a length depends on the swing rate.
    """

    def __init__(self, effects: Sequence[Effect]) -> None:
        self._effects = catalogue_order(effects)
        self.names = BASE_PARAMETERS + tuple(p.name for item in self._effects for p in item.parameters())
        self.theta = ca.SX.sym("theta", len(self.names))
        self._by_name = dict(zip(self.names, ca.vertsplit(self.theta), strict=True))
        x, v, z, phi, rate, pull = (ca.SX.sym(s) for s in ("x", "v", "z", "phi", "rate", "T"))
        self.recorded = {column: ca.SX.sym("recorded") for column in recorded_columns(self._effects)}
        at = self.moment(ca.SX.sym("t"), self.recorded)
        gripper, string = gripper_stage(at, x, v, z, phi), string_stage(at, phi, rate)
        load = load_stage(at, ca.SX.sym("q", 3), ca.SX.sym("qd", 3), phi, rate)
        tension, sensor = (
            tension_with_effects(at, pull, phi, rate, string.length, ca.SX.sym("a")),
            sensor_stage(at, pull, phi, rate),
        )
        self.compliance = ca.vertcat(string.compliance, gripper.compliance)
        damping = string.damped / (string.compliance + ADDED_COMPLIANCE)
        self.bounce_vibration = (
            None if string.compliance.is_zero() else ca.vertcat(string.compliance * load.mass, damping)
        )
        self.sensor_lag, self.sensor_delay, self.gripper_lag = sensor.lag, sensor.delay, gripper.lag
        self.transverse = ca.densify(load.transverse)
        self.string_has_mass, self.has_dry_friction = not string.mass.is_zero(), not string.dry.is_zero()
        self.is_compliant, self.swings_across_line = not self.compliance.is_zero(), not load.transverse.is_zero()
        self.gripper_has_lag, self.added_state_count = not gripper.lag.is_zero(), len(at.added_states)
        elsewhere = ca.vertcat(
            gripper.position, string.length, string.mass, load.mass, load.inertia, gripper.tilt, tension,
            self.compliance, load.transverse, sensor.lag, sensor.delay, gripper.lag,
            *(m.start for m in at.added_states),
        )  # fmt: skip
        changing = [*(m.symbol for m in at.added_states), *self.recorded.values()]
        if gripper.added_states or (changing and ca.depends_on(elsewhere, ca.vertcat(*changing))):
            raise InputError(
                "an effect lets a state of its own, or a recorded column, act otherwise than by a force, a torque or a "
                "reading"
            )
        if ca.depends_on(string.length, rate):
            raise InputError(
                "an effect makes the string's length depend on the swing rate, which the equations lack: leave it out"
            )

    def moment(self, time: Expression, recorded: Mapping[RecordedColumn, Expression] = MappingProxyType({})) -> Moment:
        """Arguments with which the stages are evaluated at `time`, s since the start of the run.

        A recorded quantity that effects read has its usual value if it is not in `recorded`.
        """
        return Moment(time, self._by_name, {}, self._effects, self._by_name, recorded)


def gripper_stage(at: Moment, x: Expression, v: Expression, z: Expression, phi: Expression) -> Gripper:
    """The gripper's stage with effects, for position x, m, velocity v, m/s, height z, m, and swing angle phi, rad."""
    return at.stage("gripper", Gripper(at.time, x, v, z, phi, ca.vertcat(x, 0, z)))


def string_stage(at: Moment, phi: Expression, rate: Expression) -> String:
    """The string's stage with effects, for swing angle phi, rad, and swing rate, rad/s."""
    return at.stage("string", String(at.time, phi, rate, at["mass"], at["length"], at["gravity"]))


def load_stage(at: Moment, q: Expression, qd: Expression, phi: Expression, rate: Expression) -> Load:
    """The load's stage with effects, for position q (3,), m, velocity qd (3,), m/s, angle phi, rad, and rate, rad/s."""
    return at.stage("load", Load(at.time, at["mass"], q, qd, phi, rate))


def tension_with_effects(
    at: Moment, value: Expression, phi: Expression, rate: Expression, length: Expression, acceleration: Expression
) -> Expression:
    """The tension, N, with effects on its formula, at a gripper's `acceleration` along its line, m/s^2."""
    return at.stage("tension", Tension(value, phi, rate, at["mass"], length, acceleration, at["gravity"])).value


def sensor_stage(at: Moment, tension: Expression, phi: Expression, rate: Expression) -> Sensor:
    """The sensors' stage with effects, for a tension, N, swing angle, rad, and swing rate, rad/s."""
    return at.stage("sensor", Sensor(at.time, tension, phi, tension, phi, rate))


def kinetic_and_potential_energy(
    gripper: Gripper, string: String, load: Load, g: Expression, gd: Expression
) -> tuple[Expression, ...]:
    """Kinetic and potential energy, J, of load and string; g (3,), m, is the string's upper end and gd its velocity.

    A uniform string has the kinetic energy of a rod whose ends move as gripper and load do.
    """
    q, qd = load.position, load.velocity
    kinetic = (
        load.mass * ca.sumsqr(qd) / 2
        + load.inertia * load.rate**2 / 2
        + string.mass * (ca.sumsqr(qd) + ca.sumsqr(gd) + ca.dot(qd, gd)) / 6
    )
    up = up_direction(gripper)
    return kinetic, string.gravity * (load.mass * ca.dot(up, q) + string.mass * ca.dot(up, q + g) / 2)


def up_direction(gripper: Gripper) -> Expression:
    """Unit vector (3,) against gravity, in the frame of the line."""
    return ca.vertcat(-ca.sin(gripper.tilt), 0, ca.cos(gripper.tilt))


def string_direction(phi: Expression) -> Expression:
    """Unit vector (3,) from the pivot to the load."""
    return ca.vertcat(-ca.sin(phi), 0, -ca.cos(phi))


def quasi_static_string(
    composition: PendulumComposition, at: Moment, position: Expression, length: Expression, phi: Expression
) -> tuple[Expression, Expression]:
    """The string's upper end (3,), m, and its length, m, with compliant parts displaced by the load's weight.

    It is an approximation for control, of first order in the compliance: the tension is the weight's component along
    the string.
    """
    if not composition.is_compliant:
        return position, length
    string, gripper = ca.vertsplit(composition.compliance)
    pull = at["gravity"] * at["mass"] * ca.cos(phi)
    return position - ca.vertcat(gripper * pull * ca.sin(phi), 0, 0), length + string * pull
