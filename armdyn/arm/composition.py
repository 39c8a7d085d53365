"""Apply effects to one joint of an arm, and derive the functions of its torque.

A term that is linear in its parameter, with a factor that depends on the motion alone, is evaluated once per run.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any

import casadi as ca
import numpy as np

from armdyn.arm.memory import InternalStates
from armdyn.arm.physics import Base, DriveCommands, Expression, Joint, Link, Neighbour
from armdyn.arm.rigid import inertial_parameters
from armdyn.codegen import PreallocatedFunction
from armdyn.effects.effect import Effect, recorded_columns
from armdyn.errors import InputError
from armdyn.numpy_code import numpy_lines, unknown_operations
from armdyn.parameter import RecordedColumn
from armdyn.readout import SensorReadout

JOINT_INPUTS = (
    "time", "position", "velocity", "acceleration", "direction", "load", "inner q", "inner v", "inner a", "on",
    *("told torque", "told rate", "told total", "told velocity", "voltage"),
)  # fmt: skip
DIRECTION_INPUT_INDEX, LOAD_INPUT_INDEX, COMMAND_INPUT_INDEX = (
    JOINT_INPUTS.index(name) for name in ("direction", "load", "told torque")
)


class VectorisedExpression:
    """Evaluates symbolic expressions over time with numpy: (m,) expressions of (15,) inputs and (k,) parameters.

    Raises:
        InputError: an expression contains an operation without a numpy counterpart.
    """

    def __init__(self, expressions: Any, inputs: Any, theta: Any) -> None:
        self._function = ca.Function("over_time", [inputs, theta], [ca.densify(expressions)])
        unknown = unknown_operations(self._function)
        if unknown:
            raise InputError(
                f"an effect uses CasADi operation {min(unknown)}, which cannot be evaluated over a run: write it with "
                "elementary functions"
            )

    @cached_property
    def _evaluate(self) -> Callable[[tuple[np.ndarray, np.ndarray], np.ndarray], None]:
        lines = numpy_lines(self._function, lambda i, j: f"given[{i}][{j}]", lambda _, j: f"result[{j}]")
        defined: dict[str, Any] = {"np": np}
        exec("\n    ".join(["def evaluate(given, result):", *lines, "return"]), defined)
        return defined["evaluate"]

    def __call__(self, inputs: np.ndarray, theta: np.ndarray) -> np.ndarray:
        """(m, n) values for (15, n) inputs and (k,) parameters."""
        result = np.zeros((self._function.size1_out(0), inputs.shape[1]))
        with np.errstate(all="ignore"):  # a fit may try values without finite results
            self._evaluate((inputs, theta), result)
        return result


class PartlyLinearTorque:
    """A torque over time, split into a part that is linear in some parameters and a nonlinear rest.

    Args:
        expression: the torque, of inputs and parameters.
        inputs: (15 + c,) symbols in the order of `JOINT_INPUTS`, then those of `recorded`.
        theta: (k,) symbols of the parameters.
        remembered: states of the joint's effects, on which the torque may depend.
        recorded: c further recorded quantities that the joint's effects read.

    Attributes:
        linear: indices of the parameters with linear columns.
        nonlinear: indices of the other parameters of the term.
        loaded: whether the torque depends on the torque of the rigid bodies.
        has_rest: whether the torque has a nonlinear rest.
        empty: whether the torque is always zero.
    """

    def __init__(
        self,
        expression: Expression,
        inputs: Expression,
        theta: Expression,
        remembered: InternalStates,
        recorded: tuple[RecordedColumn, ...] = (),
    ) -> None:
        self.recorded = recorded
        derivative, z = ca.jacobian(expression, theta), remembered.symbols
        state = ca.vertcat(theta, inputs[LOAD_INPUT_INDEX], z)
        self._remembered = remembered if z.numel() and ca.depends_on(expression, z) else None
        through = remembered.depends if self._remembered is not None else np.zeros(theta.numel(), dtype=bool)
        used = [i for i in range(theta.numel()) if derivative[0, i].nnz() or through[i]]
        self.linear = tuple(i for i in used if not (through[i] or ca.depends_on(derivative[0, i], state)))
        self.nonlinear = tuple(i for i in used if i not in self.linear)
        rest = ca.substitute(expression, _part(theta, self.linear), ca.SX.zeros(len(self.linear)))
        rest = ca.simplify(rest)
        self.loaded = bool(ca.depends_on(expression, inputs[LOAD_INPUT_INDEX]))
        self.has_rest = bool(self.nonlinear) or not rest.is_zero()
        self.empty = not self.linear and not self.has_rest
        self._columns = VectorisedExpression(_part(derivative.T, self.linear), inputs, theta)
        outputs = [
            rest,
            *(ca.jacobian(rest, theta)[0, i] for i in self.nonlinear),
            ca.jacobian(rest, inputs[LOAD_INPUT_INDEX]),
        ]
        if self._remembered is not None:
            outputs += ca.horzsplit(ca.jacobian(rest, z))
            inputs = ca.vertcat(inputs, z)
        self._rest = VectorisedExpression(ca.vertcat(*outputs), inputs, theta)

    def columns(self, inputs: np.ndarray, size: int) -> np.ndarray:
        """(n, linear) columns for (15 + c, n) inputs and `size` parameters."""
        return self._columns(inputs, np.zeros(size)).T

    def rest(self, inputs: np.ndarray, theta: np.ndarray) -> np.ndarray:
        """(n, 2 + nonlinear) the nonlinear rest, and its derivatives by the `nonlinear` parameters and by the load.

        Of (k,) `theta` only the entries `nonlinear` matter; `inputs` are (15 + c, n).
        """
        if self._remembered is None:
            return self._rest(inputs, theta).T
        z, derivatives = self._remembered.over(inputs, theta)
        everything = self._rest(np.vstack([inputs, z]), theta)
        rest, by_state = everything[: 2 + len(self.nonlinear)], everything[2 + len(self.nonlinear) :]
        rest[1:-1] += np.einsum("mn,mkn->kn", by_state, derivatives[:, list(self.nonlinear)])
        return rest.T


class InertialOrGravityChange:
    """Change of described values by effects: inertial parameters of a link, or gravity.

    Args:
        names: ``"<effect>.<quantity>"`` in the order of theta (k,).
        expression: (m,) changed values, of `described` and `theta`.
        described: symbols of the described values.
        theta: (k,) symbols of the parameters.
        null: (k,) values at which the effects are absent.

    Attributes:
        names: the given names.
        depends: (k,) bool, whether the change depends on each parameter.
    """

    def __init__(
        self,
        names: Sequence[str],
        expression: Expression,
        described: Expression,
        theta: Expression,
        null: Sequence[float],
    ) -> None:
        outputs = [ca.densify(expression), ca.densify(ca.jacobian(expression, theta))]
        self._function, self._null = (
            PreallocatedFunction(ca.Function("change", [described, theta], outputs)),
            np.array(null),
        )
        self.names = tuple(names)
        self.depends = np.array([bool(ca.depends_on(expression, theta[i])) for i in range(theta.numel())])

    def at(self, described: np.ndarray, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(m,) change of the (m,) described values, exactly zero at the null values, and (m, k) its derivatives."""
        before = self._function(described, self._null)[0][:, 0].copy()
        after, derivatives = self._function(described, theta)
        return after[:, 0] - before, derivatives.copy()


def gravity_change_by_effects(effects: Sequence[Effect]) -> InertialOrGravityChange:
    """Change of gravity, (3,) m/s^2, by effects on the base, in the order in which they act."""
    names = [f"{e.name}.{short}" for e in effects for short in e.quantities]
    gravity, theta = ca.SX.sym("g", 3), ca.SX.sym("theta", len(names))
    base = Base(gravity)
    for e in effects:
        base = e.apply(base, dict(zip(names, ca.vertsplit(theta), strict=True)))
    return InertialOrGravityChange(
        names, base.gravity, gravity, theta, [q.null for e in effects for q in e.quantities.values()]
    )


@dataclass(frozen=True, eq=False)
class JointTorqueFunctions:
    """Functions of the torque of one joint with its effects.

    Attributes:
        names: ``"<effect>.<quantity>"`` in the order of theta (k,).
        torque: torque of the drive beyond the load: one term for all linear effects, and one for each other effect.
        inner_torque: torque on the drive of the neighbour towards the base.
        offset: offset of the sensor's reading.
        sensor: gain, lag and delay of the reading.
        link: change of the link's (10,) inertial parameters, from the (4, 4) factor of the described pseudo-inertia;
            None if no effect acts on the link.
        load: the part of this change by bodies that are fixed to the link; None without one.
        remembers: whether an effect has states of its own.
    """

    names: tuple[str, ...]
    torque: tuple[PartlyLinearTorque, ...]
    inner_torque: PartlyLinearTorque
    offset: PartlyLinearTorque
    sensor: SensorReadout
    link: InertialOrGravityChange | None
    load: InertialOrGravityChange | None
    remembers: bool

    @property
    def depends_on_past(self) -> bool:
        """Whether a torque depends on the past: by states, a lag or a delay."""
        return self.remembers or self.sensor.lags or self.sensor.delays


def depends_on_past(effect: Effect) -> bool:
    """Whether an effect of an arm makes a torque, or its reading, depend on the past."""
    return effect.in_joint and torque_functions_with_effects([effect]).depends_on_past


def torque_functions_with_effects(effects: Sequence[Effect]) -> JointTorqueFunctions:
    """The functions of a joint's torque after effects, applied in the given order.

    Raises:
        InputError: an effect lets gain, lag, delay or link change with the motion.
    """
    return _composed(tuple(e.on() for e in effects))  # the same functions on every joint


@dataclass(frozen=True, eq=False)
class ComposedJoint:
    """One joint with its effects, as expressions: the one place where effects are applied to an arm's joint.

    Attributes:
        names: ``"<effect>.<quantity>"`` in the order of theta.
        inputs: (15 + c,) symbols in the order of `JOINT_INPUTS`, then those of c recorded quantities.
        theta: (k,) symbols of the parameters.
        before: the joint without effects.
        after: the joint with them; its torque is the sum of those `added`.
        added: torque of each effect.
        recorded: c recorded quantities that the effects read.
    """

    names: tuple[str, ...]
    inputs: Expression
    theta: Expression
    before: Joint
    after: Joint
    added: tuple[Expression, ...]
    recorded: tuple[RecordedColumn, ...]

    @cached_property
    def torques(self) -> ca.Function:
        """``(inputs, theta)`` to torque, torque on the neighbour towards the base, and gain and offset of the reading.

        Recorded quantities have their usual values.
        """
        joint, usual = self.after, [column.usual for column in self.recorded]
        inputs, recorded = ca.vertsplit(self.inputs, [0, len(JOINT_INPUTS), self.inputs.numel()])
        found = [joint.torque, joint.inner_torque, joint.gain, joint.offset]
        outputs = ca.substitute(found, [recorded], [ca.SX(usual)]) if usual else found
        return ca.Function("torques", [inputs, self.theta], outputs)

    @property
    def needs_more_than_an_instant(self) -> str:
        """Why torques are not a function of one instant; empty if they are."""
        if self.after.added_states:
            return "has a state of its own"
        time = self.before.time
        return "depends on time" if ca.depends_on(ca.vertcat(self.after.torque, self.after.inner_torque), time) else ""


@lru_cache(maxsize=256)
def composed_joint(effects: tuple[Effect, ...]) -> ComposedJoint:
    """A joint with effects, in the given order.

    Raises:
        InputError: an effect changes the joint's torque otherwise than by adding to it.
    """
    names = tuple(f"{e.name}.{short}" for e in effects for short in e.quantities)
    theta = ca.SX.sym("theta", len(names))
    by_name = dict(zip(names, ca.vertsplit(theta), strict=True)) if names else {}
    columns = recorded_columns(effects)
    inputs, shape = ca.SX.sym("w", len(JOINT_INPUTS) + len(columns)), ca.SX.sym("U", 4, 4)
    symbols = ca.vertsplit(inputs)
    time, q, v, a, direction, load, *inner, on = symbols[:COMMAND_INPUT_INDEX]
    told = DriveCommands(*symbols[COMMAND_INPUT_INDEX : len(JOINT_INPUTS)])
    recorded = dict(zip(columns, symbols[len(JOINT_INPUTS) :], strict=True))
    torque, link = ca.SX.sym("torque"), Link(shape, ca.SX(4, 4))
    before = joint = Joint(time, q, v, a, direction, load, Neighbour(*inner), link, on=on, told=told)
    added = []
    for e in effects:
        joint = e.apply(replace(joint, torque=torque), by_name, recorded)
        added.append(ca.substitute(joint.torque, torque, 0))
        if not ca.is_equal(ca.jacobian(joint.torque, torque), ca.SX(1)):
            raise InputError(f"effect '{e.name}': what it does to the joint's torque must be added, by 'with_torque'")
    after = replace(joint, torque=sum(added, ca.SX(0)))
    return ComposedJoint(names, inputs, theta, before, after, tuple(added), columns)


@lru_cache(maxsize=256)
def _composed(effects: tuple[Effect, ...]) -> JointTorqueFunctions:
    composed = composed_joint(effects)
    names, inputs, theta, joint = composed.names, composed.inputs, composed.theta, composed.after
    added, columns, shape = composed.added, composed.recorded, composed.before.link.shape
    remembered = InternalStates(joint.added_states, inputs, composed.before.load, theta)
    parameters = inertial_parameters(joint.link.pseudo_inertia)
    sensor = ca.vertcat(joint.gain, joint.lag, joint.delay)
    if ca.depends_on(ca.vertcat(parameters, sensor), ca.vertcat(inputs, remembered.symbols)):
        raise InputError(
            f"effects {', '.join(e.name for e in effects)}: gain, lag, delay and link of a joint can depend on "
            "parameters only: write what changes with the motion as a torque or an offset"
        )
    null = [q.null for e in effects for q in e.quantities.values()]
    load = inertial_parameters(joint.link.carried)
    bodies = [
        InertialOrGravityChange(names, part, shape, theta, null) if ca.depends_on(part, theta) else None
        for part in (parameters, load)
    ]
    return JointTorqueFunctions(
        names=names,
        torque=_terms(added, inputs, theta, remembered, columns),
        inner_torque=PartlyLinearTorque(joint.inner_torque, inputs, theta, remembered, columns),
        offset=PartlyLinearTorque(joint.offset, inputs, theta, remembered, columns),
        sensor=SensorReadout(theta, joint.gain, joint.lag, joint.delay),
        link=bodies[0],
        load=bodies[1],
        remembers=bool(joint.added_states),
    )


def _terms(
    added: Sequence[Expression],
    inputs: Expression,
    theta: Expression,
    remembered: InternalStates,
    columns: tuple[RecordedColumn, ...],
) -> tuple[PartlyLinearTorque, ...]:
    """One term for all that is linear, and one for each expression that is not."""
    terms = [PartlyLinearTorque(expression, inputs, theta, remembered, columns) for expression in added]
    linear = [expression for expression, term in zip(added, terms, strict=True) if not term.has_rest]
    rest = [term for term in terms if term.has_rest]
    return (PartlyLinearTorque(sum(linear, ca.SX(0)), inputs, theta, remembered, columns), *rest)


def _part(vector: Expression, indices: Sequence[int]) -> Expression:
    """The entries `indices` of a symbolic vector."""
    return ca.vertcat(*(vector[i] for i in indices)) if indices else ca.SX(0, 1)
