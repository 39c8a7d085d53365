"""One joint with any effects, as the functions that a prediction needs.

What is linear in its parameter, with a factor that only the motion decides, is kept apart and evaluated once per run.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import casadi as ca
import numpy as np

from armdyn.arm.memory import InternalStates
from armdyn.arm.physics import Base, Expression, Joint, Link, Neighbour, Told
from armdyn.arm.rigid import inertial_parameters
from armdyn.arm.vectorised import OverTime
from armdyn.codegen import Buffered
from armdyn.effects.effect import Effect, columns_of
from armdyn.errors import InputError
from armdyn.parameter import RecordedColumn
from armdyn.readout import Sensor

INPUTS = (
    "time", "position", "velocity", "acceleration", "direction", "load", "inner q", "inner v", "inner a", "on",
    *("told torque", "told rate", "told total", "told velocity", "voltage"),
)  # fmt: skip
DIRECTION, LOAD, TOLD = (INPUTS.index(name) for name in ("direction", "load", "told torque"))


class Term:
    """A torque over time: linear columns times their parameters, and the rest.

    Args:
        expression: of inputs and parameters.
        inputs: (15 + c,) symbols in the order of `INPUTS`, then those of `recorded`.
        theta: (k,) symbols.
        remembered: states of the joint's effects, on which the expression may depend.
        recorded: c further recorded quantities that the joint's effects read.

    Attributes:
        linear: indices of the parameters with columns of their own.
        nonlinear: indices of the other parameters that the term depends on.
        loaded: whether it depends on the load.
        empty: whether it is always zero.
        recorded: as given.
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
        state = ca.vertcat(theta, inputs[LOAD], z)
        self._remembered = remembered if z.numel() and ca.depends_on(expression, z) else None
        through = remembered.depends if self._remembered is not None else np.zeros(theta.numel(), dtype=bool)
        used = [i for i in range(theta.numel()) if derivative[0, i].nnz() or through[i]]
        self.linear = tuple(i for i in used if not (through[i] or ca.depends_on(derivative[0, i], state)))
        self.nonlinear = tuple(i for i in used if i not in self.linear)
        rest = ca.substitute(expression, _part(theta, self.linear), ca.SX.zeros(len(self.linear)))
        rest = ca.simplify(rest)
        self.loaded = bool(ca.depends_on(expression, inputs[LOAD]))
        self.has_rest = bool(self.nonlinear) or not rest.is_zero()
        self.empty = not self.linear and not self.has_rest
        self._columns = OverTime(_part(derivative.T, self.linear), inputs, theta)
        outputs = [rest, *(ca.jacobian(rest, theta)[0, i] for i in self.nonlinear), ca.jacobian(rest, inputs[LOAD])]
        if self._remembered is not None:
            outputs += ca.horzsplit(ca.jacobian(rest, z))
            inputs = ca.vertcat(inputs, z)
        self._rest = OverTime(ca.vertcat(*outputs), inputs, theta)

    def columns(self, inputs: np.ndarray, size: int) -> np.ndarray:
        """(n, linear) columns over (15 + c, n) inputs; `size` is the number of parameters."""
        if not self.linear:
            return np.zeros((inputs.shape[1], 0))
        return self._columns(inputs, np.zeros(size)).T

    def rest(self, inputs: np.ndarray, theta: np.ndarray) -> np.ndarray:
        """(n, 2 + nonlinear) over (15 + c, n) inputs: the rest, its derivatives by `nonlinear`, that by the load.

        It depends on the entries `nonlinear` of (k,) `theta` only.
        """
        if self._remembered is None:
            return self._rest(inputs, theta).T
        z, derivatives = self._remembered.over(inputs, theta)
        everything = self._rest(np.vstack([inputs, z]), theta)
        rest, by_state = everything[: 2 + len(self.nonlinear)], everything[2 + len(self.nonlinear) :]
        rest[1:-1] += np.einsum("mn,mkn->kn", by_state, derivatives[:, list(self.nonlinear)])
        return rest.T


class Change:
    """What effects change of something described: the inertial parameters of a link, or gravity in the base's frame.

    Args:
        names: ``"<effect>.<quantity>"`` in the order of theta (k,).
        expression: (m,) of `described` and `theta`.
        described: symbols of what the description says.
        theta: (k,) symbols.
        null: (k,) values at which the effects are absent.

    Attributes:
        names: as given.
        depends: (k,) bool, the parameters that change it.
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
        self._function, self._null = Buffered(ca.Function("change", [described, theta], outputs)), np.array(null)
        self.names = tuple(names)
        self.depends = np.array([bool(ca.depends_on(expression, theta[i])) for i in range(theta.numel())])

    def at(self, described: np.ndarray, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(m,) what the effects add to what is described, and (m, k) its derivatives."""
        # What is described is what the same function gives at the null values: no effect, no change at all.
        before = self._function(described, self._null)[0][:, 0].copy()
        after, derivatives = self._function(described, theta)
        return after[:, 0] - before, derivatives.copy()


def base_change(effects: Sequence[Effect]) -> Change:
    """How effects on the base, in the order in which they act, change gravity, (3,) m/s^2."""
    names = [f"{e.name}.{short}" for e in effects for short in e.quantities]
    gravity, theta = ca.SX.sym("g", 3), ca.SX.sym("theta", len(names))
    base = Base(gravity)
    for e in effects:
        base = e.apply(base, dict(zip(names, ca.vertsplit(theta), strict=True)))
    return Change(names, base.gravity, gravity, theta, [q.null for e in effects for q in e.quantities.values()])


@dataclass(frozen=True, eq=False)
class JointFunctions:
    """One joint with its effects.

    Attributes:
        names: ``"<effect>.<quantity>"`` in the order of theta (k,).
        torque: beyond the load; what is not linear has a term for each effect, so that it is evaluated when needed.
        inner_torque: on the inner neighbour's drive.
        offset: of the sensor's reading.
        sensor: its gain, lag and delay.
        link: of the (10,) inertial parameters, by the (4, 4) factor of the described pseudo-inertia; None where no
            effect acts on the link.
        remembers: whether an effect has states of its own.
    """

    names: tuple[str, ...]
    torque: tuple[Term, ...]
    inner_torque: Term
    offset: Term
    sensor: Sensor
    link: Change | None
    remembers: bool

    @property
    def of_before(self) -> bool:
        """Whether a torque depends on what was before: on states, a lag or a delay."""
        return self.remembers or self.sensor.lags or self.sensor.delays


def depends_on_before(effect: Effect) -> bool:
    """Whether an effect of an arm makes a torque, or its reading, depend on what was before."""
    return effect.reach != "base" and compose_joint([effect]).of_before


def compose_joint(effects: Sequence[Effect]) -> JointFunctions:
    """Apply `effects`, in the order given, to a joint.

    Raises:
        InputError: an effect lets gain, lag, delay or link change with the motion.
    """
    return _composed(tuple(e.on() for e in effects))  # on whichever joints it acts, it does the same to each


@lru_cache(maxsize=256)
def _composed(effects: tuple[Effect, ...]) -> JointFunctions:
    names = tuple(f"{e.name}.{short}" for e in effects for short in e.quantities)
    theta = ca.SX.sym("theta", len(names))
    by_name = dict(zip(names, ca.vertsplit(theta), strict=True)) if names else {}
    columns = columns_of(effects)
    inputs, shape = ca.SX.sym("w", len(INPUTS) + len(columns)), ca.SX.sym("U", 4, 4)
    symbols = ca.vertsplit(inputs)
    time, q, v, a, direction, load, *inner, on = symbols[:TOLD]
    told = Told(*symbols[TOLD : len(INPUTS)])
    recorded = dict(zip(columns, symbols[len(INPUTS) :], strict=True))
    zero, one, before = ca.SX(0), ca.SX(1), ca.SX.sym("torque")
    joint = Joint(
        time,
        q,
        v,
        a,
        direction,
        load,
        Neighbour(*inner),
        Link(shape, ca.SX(4, 4)),
        zero,
        zero,
        one,
        zero,
        on=on,
        told=told,
    )
    added = []
    for e in effects:
        joint = e.apply(replace(joint, torque=before), by_name, recorded)
        added.append(ca.substitute(joint.torque, before, 0))
        if not ca.is_equal(ca.jacobian(joint.torque, before), ca.SX(1)):
            raise InputError(f"effect '{e.name}': what it does to the joint's torque must be added, by 'with_torque'")
    remembered = InternalStates(joint.memory, inputs, load, theta)
    parameters = inertial_parameters(joint.link.pseudo_inertia)
    sensor = ca.vertcat(joint.gain, joint.lag, joint.delay)
    if ca.depends_on(ca.vertcat(parameters, sensor), ca.vertcat(inputs, remembered.symbols)):
        raise InputError(
            f"effects {', '.join(e.name for e in effects)}: gain, lag, delay and link of a joint can depend on "
            "parameters only: write what changes with the motion as a torque or an offset"
        )
    null = [q.null for e in effects for q in e.quantities.values()]
    return JointFunctions(
        names=names,
        torque=_terms(added, inputs, theta, remembered, columns),
        inner_torque=Term(joint.inner_torque, inputs, theta, remembered, columns),
        offset=Term(joint.offset, inputs, theta, remembered, columns),
        sensor=Sensor(theta, joint.gain, joint.lag, joint.delay),
        link=Change(names, parameters, shape, theta, null) if ca.depends_on(parameters, theta) else None,
        remembers=bool(joint.memory),
    )


def _terms(
    added: Sequence[Expression],
    inputs: Expression,
    theta: Expression,
    remembered: InternalStates,
    columns: tuple[RecordedColumn, ...],
) -> tuple[Term, ...]:
    """One term for all that is linear, and one for each expression that is not."""
    terms = [Term(expression, inputs, theta, remembered, columns) for expression in added]
    linear = [expression for expression, term in zip(added, terms, strict=True) if not term.has_rest]
    rest = [term for term in terms if term.has_rest]
    return (Term(sum(linear, ca.SX(0)), inputs, theta, remembered, columns), *rest)


def _part(vector: Expression, indices: Sequence[int]) -> Expression:
    """The entries `indices` of a symbolic vector."""
    return ca.vertcat(*(vector[i] for i in indices)) if indices else ca.SX(0, 1)
