"""A load on a string with any effects: its stages at whatever expressions a formulation has for its motion.

The continuous equations (`dynamics`) and the variational integrator (`variational`) ask the same stages for the
Lagrangian in the load's Cartesian position, the forces and the readings, and the tension follows from them, so that no
effect can enter one and be forgotten in another.
"""

from collections.abc import Mapping, Sequence
from types import MappingProxyType

import casadi as ca

from armdyn.effects.catalogue import natural_order
from armdyn.effects.effect import Effect, columns_of
from armdyn.errors import InputError
from armdyn.parameter import RecordedColumn
from armdyn.pendulum.physics import Expression, Gripper, Load, Sensor, String, Tension
from armdyn.physics.definition import Moment

STAGES = ("gripper", "string", "load", "tension", "sensor")
"""What effects may act on, in the order in which nature applies them."""
BASE_PARAMETERS = ("length", "mass", "gravity")
RIGID = 1e-12
"""m/N; added to a compliance by which is divided."""


class Composition:
    """A pendulum with `effects`, in their natural order whatever the order in which they were added.

    Attributes:
        names: parameters in the order of theta.
        theta: (p,) symbols of the parameters, of which all expressions below are made.
        compliance: (2,) of the string and of the gripper, m/N.
        bounce: (2,) of the load on its string: 1/w^2, s^2, and damping ratio; None where the string is rigid.
        sensor_lag: (3,) of the readings of force, angle and rate, s.
        sensor_delay: (3,) of these, s.
        gripper_lag: by which the gripper trails its measured position, s.
        transverse: (3,) swing across the line at the start, see `physics.Load`.
        heavy: whether the string has mass.
        rubs: whether there is dry friction.
        yields: whether string or gripper give way to the tension.
        crosses: whether the load swings across the line as well.
        trails: whether the gripper trails its measured position.
        remembers: number of states that effects bring.
        recorded: symbols of the further recorded quantities that effects read.

    Raises:
        InputError: a state of an effect, or a recorded quantity, acts otherwise than by a force, a torque or a reading,
            or a length depends on the swing rate.
    """

    def __init__(self, effects: Sequence[Effect]) -> None:
        self._effects = natural_order(effects)
        self.names = BASE_PARAMETERS + tuple(p.name for item in self._effects for p in item.parameters())
        self.theta = ca.SX.sym("theta", len(self.names))
        self._by_name = dict(zip(self.names, ca.vertsplit(self.theta), strict=True))
        x, v, z, phi, rate, pull = (ca.SX.sym(s) for s in ("x", "v", "z", "phi", "rate", "T"))
        self.recorded = {column: ca.SX.sym("recorded") for column in columns_of(self._effects)}
        at = self.at(ca.SX.sym("t"), self.recorded)
        gripper, string = gripper_at(at, x, v, z, phi), string_at(at, phi, rate)
        load = load_at(at, ca.SX.sym("q", 3), ca.SX.sym("qd", 3), phi, rate)
        tension, sensor = tension_at(at, pull, phi, rate, string.length, ca.SX.sym("a")), sensor_at(at, pull, phi, rate)
        self.compliance = ca.vertcat(string.compliance, gripper.compliance)
        damping = string.damped / (string.compliance + RIGID)
        self.bounce = None if string.compliance.is_zero() else ca.vertcat(string.compliance * load.mass, damping)
        self.sensor_lag, self.sensor_delay, self.gripper_lag = sensor.lag, sensor.delay, gripper.lag
        self.transverse = ca.densify(load.transverse)
        self.heavy, self.rubs = not string.mass.is_zero(), not string.dry.is_zero()
        self.yields, self.crosses = not self.compliance.is_zero(), not load.transverse.is_zero()
        self.trails, self.remembers = not gripper.lag.is_zero(), len(at.memory)
        elsewhere = ca.vertcat(
            gripper.position, string.length, string.mass, load.mass, load.inertia, gripper.tilt, tension,
            self.compliance, load.transverse, sensor.lag, sensor.delay, gripper.lag, *(m.start for m in at.memory),
        )  # fmt: skip
        changing = [*(m.symbol for m in at.memory), *self.recorded.values()]
        if gripper.memory or (changing and ca.depends_on(elsewhere, ca.vertcat(*changing))):
            raise InputError(
                "an effect lets a state of its own, or a recorded column, act otherwise than by a force, a torque or a "
                "reading"
            )
        if ca.depends_on(string.length, rate):
            raise InputError("an effect lets the string's length depend on the swing rate")

    def at(self, time: Expression, recorded: Mapping[RecordedColumn, Expression] = MappingProxyType({})) -> Moment:
        """A moment, s since the start of the run, at which the stages of this module can be asked for.

        What effects read and is not among `recorded` has its usual value.
        """
        return Moment(time, self._by_name, {}, self._effects, self._by_name, recorded)


def gripper_at(at: Moment, x: Expression, v: Expression, z: Expression, phi: Expression) -> Gripper:
    """The gripper, with effects, at measured position m, velocity m/s and height m and at swing angle phi rad."""
    return at.stage("gripper", Gripper(at.time, x, v, z, phi, ca.vertcat(x, 0, z)))


def string_at(at: Moment, phi: Expression, rate: Expression) -> String:
    """The string, with effects, at swing angle phi rad and rate rad/s."""
    return at.stage("string", String(at.time, phi, rate, at["mass"], at["length"], at["gravity"]))


def load_at(at: Moment, q: Expression, qd: Expression, phi: Expression, rate: Expression) -> Load:
    """The load, with effects, at position q (3,) m and velocity qd (3,) m/s."""
    return at.stage("load", Load(at.time, at["mass"], q, qd, phi, rate))


def tension_at(
    at: Moment, value: Expression, phi: Expression, rate: Expression, length: Expression, acceleration: Expression
) -> Expression:
    """The string's pull, N, after effects on its formula; `acceleration` of the gripper along its line, m/s^2."""
    return at.stage("tension", Tension(value, phi, rate, at["mass"], length, acceleration, at["gravity"])).value


def sensor_at(at: Moment, tension: Expression, phi: Expression, rate: Expression) -> Sensor:
    """The sensors, with effects, of the string's pull N, angle rad and rate rad/s."""
    return at.stage("sensor", Sensor(at.time, tension, phi, tension, phi, rate))


def lagrangian(gripper: Gripper, string: String, load: Load, g: Expression, gd: Expression) -> tuple[Expression, ...]:
    """Kinetic and potential energy, J, of load and string; g (3,) m and gd (3,) m/s of the string's upper end.

    A uniform string has the kinetic energy of a rod whose ends move as gripper and load do.
    """
    q, qd = load.position, load.velocity
    kinetic = (
        load.mass * ca.sumsqr(qd) / 2
        + load.inertia * load.rate**2 / 2
        + string.mass * (ca.sumsqr(qd) + ca.sumsqr(gd) + ca.dot(qd, gd)) / 6
    )
    up = upwards(gripper)
    return kinetic, string.gravity * (load.mass * ca.dot(up, q) + string.mass * ca.dot(up, q + g) / 2)


def upwards(gripper: Gripper) -> Expression:
    """Unit vector against gravity, (3,) in the frame of the line."""
    return ca.vertcat(-ca.sin(gripper.tilt), 0, ca.cos(gripper.tilt))


def direction(phi: Expression) -> Expression:
    """Unit vector from the pivot to the load, (3,)."""
    return ca.vertcat(-ca.sin(phi), 0, -ca.cos(phi))


def quasi_static(
    composition: Composition, at: Moment, position: Expression, length: Expression, phi: Expression
) -> tuple[Expression, Expression]:
    """The string's upper end (3,) m and its length m where what is compliant gives way to the weight, for control.

    Compliance enters to first order: the pull is the weight's component along the string.
    """
    if not composition.yields:
        return position, length
    string, gripper = ca.vertsplit(composition.compliance)
    pull = at["gravity"] * at["mass"] * ca.cos(phi)
    return position - ca.vertcat(gripper * pull * ca.sin(phi), 0, 0), length + string * pull
