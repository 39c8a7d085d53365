"""Rollouts of a physics with exact sensitivities, in blocks of compiled Runge-Kutta steps."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import casadi as ca
import numpy as np

from armdyn.codegen import BufferedFunction, compile_functions
from armdyn.parameter import RecordedColumn
from armdyn.physics.definition import Expression
from armdyn.physics.dry import MOMENTUM, DryFriction
from armdyn.physics.recorded import InputPath
from armdyn.physics.vibration import Vibration
from armdyn.readout import SensorReadout
from armdyn.smoothing.even import slope

STEPS_PER_BLOCK = 16
"""Number of steps that are compiled together; pieces of a motion are short."""
STEPS_PER_CALL = 8 * STEPS_PER_BLOCK
"""Steps per call; a run of any length is a sequence of blocks, the last one cut."""


@dataclass(frozen=True, eq=False, kw_only=True)
class System:
    """Continuous equations in states s, inputs w and parameters theta, as the simulator needs them.

    Attributes:
        names: names of the parameters in the order of theta.
        states: number of states s.
        starts: number of start values of the motion.
        inputs: number of inputs w.
        columns: further recorded quantities that effects read, the last ones of w.
        outputs: names of the rows of `output`.
        derivative: ``(s, w, theta) -> (states,)`` rates of the states, without dry friction.
        output: ``(s, w, theta) -> (outputs,)`` outputs, followed by the impulse where there is one.
        initial: ``(start, ..., w, theta) -> s`` start state, with one argument for each of `starts`.
        sensors: by output, its sensor.
        impulse_adds_to: output to which the time derivative of the impulse is added; None where there is no impulse.
        impulse_rings: vibration that the impulse passes first; None where there is none.
        input_lag: ``theta -> ()`` lag of the inputs behind the recording, s; None where they have none.
        dry: dry friction, which also holds a load at rest; None where there is none.
    """

    names: tuple[str, ...]
    states: int
    starts: int
    inputs: int
    outputs: tuple[str, ...]
    derivative: ca.Function
    output: ca.Function
    initial: ca.Function
    sensors: Mapping[str, SensorReadout]
    impulse_adds_to: str | None = None
    impulse_rings: Vibration | None = None
    input_lag: ca.Function | None = None
    dry: DryFriction | None = None
    columns: tuple[RecordedColumn, ...] = ()


class Rollout(NamedTuple):
    """A simulated run; derivatives are with respect to theta and the values at the start, m of them.

    Attributes:
        states: (K, n) states.
        state_sensitivities: (n, m) derivatives of the last state.
        outputs: (K, c) outputs, one column per channel of the simulator, before lag, delay and sampling.
        sensitivities: (K, c, m) derivatives of the outputs.
    """

    states: np.ndarray
    state_sensitivities: np.ndarray
    outputs: np.ndarray
    sensitivities: np.ndarray


class Simulator:
    """Integrates one system by the classical Runge-Kutta method; sensitivities are those of the integrator.

    Args:
        system: the equations.
        name: identifier of the composition, for the cache of compiled code.
        channels: the wanted outputs; None means all. Fewer are faster.

    Attributes:
        system: the equations.
        active: columns of (theta, start) on which the motion depends.
        columns: number of outputs, including the impulse.
        steps: a block of steps, ``(state, derivatives by active, inputs, steps in s, theta) -> (state, derivatives,
            states before each step, outputs, their derivatives)``.
    """

    def __init__(self, system: System, name: str, channels: tuple[str, ...] | None = None) -> None:
        self.channels = system.outputs if channels is None else channels
        self.parameters = len(system.names)
        self.system = system
        self.active = _active(system)
        self._impulse = system.impulse_adds_to in self.channels
        self.columns = len(self.channels) + self._impulse
        rows = [system.outputs.index(name) for name in self.channels] + [len(system.outputs)] * self._impulse
        steps = _repeated(_step(system, self.active, rows), "steps", STEPS_PER_BLOCK)
        self.steps = compile_functions(f"simulate_{name}", {"steps": steps})["steps"]
        self._start = BufferedFunction(_start(system, self.active))
        self._advance = BufferedFunction(_repeated(self.steps, "block", STEPS_PER_CALL // STEPS_PER_BLOCK))

    def rollout(self, path: InputPath, theta: np.ndarray, *start: float) -> Rollout:
        """Simulate along recorded inputs.

        Args:
            path: inputs on a grid of K nodes, with their derivatives by the lag where they have one.
            theta: (p,) parameters in the order of the system's names.
            start: start values at the first node; missing ones are 0.
        """
        found = self.integrated(path, theta, *start)
        outputs, sensitivities = self.with_impulse(found.outputs, found.sensitivities, theta, path.dt)
        return found._replace(outputs=outputs, sensitivities=sensitivities)

    def integrated(self, path: InputPath, theta: np.ndarray, *start: float) -> Rollout:
        """A rollout as by `rollout`, with the impulse as a last output, because its slope needs neighbours."""
        fine, shown = path.fine, slice(None, None, path.parts)
        inputs, step = fine.packed(self.system.inputs, STEPS_PER_CALL)
        starts, (width, padded) = self.system.starts, inputs.shape
        K, m, n, columns = fine.nodes.shape[1], self.parameters + starts, self.system.states, self.columns
        states, outputs = np.empty((padded, n)), np.empty((padded, columns))
        sensitivities = np.empty((padded, m, columns))
        state, sensitivity = self._start(*start, *[0.0] * (starts - len(start)), inputs[: width // 3, 0], theta)
        for first in range(0, padded, STEPS_PER_CALL):
            block = slice(first, first + STEPS_PER_CALL)
            along = inputs[:, block], step[:, block], theta
            state, sensitivity, before, y, dy = self._advance(state, sensitivity, *along)
            states[block], outputs[block] = before.T, y.T
            sensitivities[block] = dy.T.reshape(STEPS_PER_CALL, m, columns)
        last = np.zeros((n, m))
        last[:, self.active] = sensitivity
        return Rollout(states[:K][shown], last, outputs[:K][shown], sensitivities[:K][shown].transpose(0, 2, 1))

    def with_impulse(
        self, outputs: np.ndarray, by_theta: np.ndarray, theta: np.ndarray, dt: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Outputs (K, c) and derivatives (K, c, m) of `integrated`, with the impulse's derivative in the force."""
        if not self._impulse:
            return outputs, by_theta
        force = self.channels.index(str(self.system.impulse_adds_to))
        outputs, by_theta = outputs.copy(), by_theta.copy()
        impulse, impulse_by_theta = outputs[:, -1], by_theta[:, -1]
        if self.system.impulse_rings is not None:
            impulse, impulse_by_theta = self.system.impulse_rings.passed(impulse, impulse_by_theta, theta, dt)
        outputs[:, force] += slope(impulse[:, None], dt)[:, 0]
        by_theta[:, force] += slope(impulse_by_theta, dt)
        return outputs[:, :-1], by_theta[:, :-1]


def _step(system: System, active: list[int], rows: list[int]) -> ca.Function:
    """One step, with the outputs before it and their derivatives; see `Simulator.steps`.

    The derivatives S of the state obey the integrator's own chain rule, stage by stage, and only for the columns in
    `active`: a parameter of a sensor never moves the load. Where the inputs have a lag, their derivatives by it follow
    them.
    """
    parameters, n, width = len(system.names), system.states, _width(system)
    s, S, w = ca.SX.sym("s", n), ca.SX.sym("S", n, len(active)), ca.SX.sym("w", 3 * width)
    theta, dt = ca.SX.sym("theta", parameters), ca.SX.sym("dt")
    here, middle, there = ca.vertsplit(w, width)

    def with_derivatives(function: Callable[..., Expression], states: int, moments: int) -> Callable[..., Expression]:
        """Turn a function of states, inputs, theta and a number into one of states with S appended."""
        points = [ca.SX.sym(f"s{k}", n) for k in range(states)]
        given, number = [ca.SX.sym(f"w{k}", width) for k in range(moments)], ca.SX.sym("number")
        value = function(*points, *(moment[: system.inputs] for moment in given), theta, number)
        by_theta = ca.horzcat(_by_theta(value, theta, system, *given), ca.SX(n, system.starts))[:, active]
        by_states = [ca.jacobian(value, point) for point in points]
        slopes = ca.Function("slopes", [*points, *given, theta, number], [value, by_theta, *by_states])

        def of(*arguments: Expression) -> Expression:
            found, total, *by_state = slopes(*(z[:, 0] for z in arguments[:states]), *arguments[states:])
            for by_point, z in zip(by_state, arguments[:states], strict=True):
                total += by_point @ z[:, 1:]
            return ca.horzcat(found, total)

        return of

    following = advanced(system, ca.horzcat(s, S), (here, middle, there), theta, dt, with_derivatives)
    y = system.output(s, here[: system.inputs], theta)[rows]
    dy = ca.horzcat(_by_theta(y, theta, system, here), ca.SX(y.numel(), system.starts))
    dy[:, active] += ca.jacobian(y, s) @ S
    results = [following[:, 0], following[:, 1:], s, y, dy]
    return ca.Function("step", [s, S, w, dt, theta], ca.cse([ca.densify(result) for result in results]))


def _repeated(steps: ca.Function, name: str, times: int) -> ca.Function:
    """A block of repeated steps; see `Simulator.steps`."""
    s, S, w, dt, theta = (ca.MX.sym("given", *steps.size_in(i)) for i in range(5))
    w, dt = (ca.MX.sym("given", each.size1(), times * each.size2()) for each in (w, dt))
    after, sensitivity, *outputs = steps.mapaccum("over", times, 2)(s, S, w, dt, ca.repmat(theta, 1, times))
    return ca.Function(name, [s, S, w, dt, theta], [after[:, -1], sensitivity[:, -S.size2() :], *outputs])


def advanced(
    system: System,
    z: Expression,
    inputs: tuple[Expression, ...],
    theta: Expression,
    dt: Expression,
    lifted: Callable[..., Callable[..., Expression]] = lambda function, *_: function,
) -> Expression:
    """The state after one step of the simulation.

    Args:
        system: the equations.
        z: (n, ...) state at the start of the step in the first column.
        inputs: inputs at the start of the step, halfway and at its end.
        theta: parameters.
        dt: length of the step, s.
        lifted: turns a function of states, inputs, theta and a number into one of all columns of z.
    """
    (here, _, there), dry = inputs, system.dry
    direction = 0 if dry is None else dry.direction(z[:, 0], here[: system.inputs], theta, dt)
    moving = lifted(lambda s, w, p, way: _rates(system, s, w, p, way), 1, 1)
    following = runge_kutta(lambda s, w: moving(s, w, theta, direction), z, inputs, dt)
    if dry is None:
        return following
    held = following
    if dry.followed:
        resting = lifted(lambda s, w, p, _: _rates_at_rest(system, dry, s, w, p), 1, 1)
        held = runge_kutta(lambda s, w: resting(s, w, theta, 0), z, inputs, dt)
    return lifted(dry.corrected, 3, 2)(z, following, held, here, there, theta, dt)


def runge_kutta(
    rate: Callable[[Expression, Expression], Expression], z: Expression, inputs: tuple[Expression, ...], dt: Expression
) -> Expression:
    """One step of the classical Runge-Kutta method.

    Args:
        rate: rate of z, as a function of z and the inputs.
        z: value at the start of the step.
        inputs: inputs at the start of the step, halfway and at its end.
        dt: length of the step, s.
    """
    here, middle, there = inputs
    total, stage = 0, z
    for given, reach, weight in ((here, 1 / 2, 1), (middle, 1 / 2, 2), (middle, 1, 2), (there, 0, 1)):
        k = rate(stage, given)
        total, stage = total + weight * k, z + reach * dt * k
    return z + dt / 6 * total


def _rates(system: System, s: Expression, w: Expression, theta: Expression, direction: Expression) -> Expression:
    """Rates of the states, with dry friction against a sliding in `direction`."""
    rate = system.derivative(s, w, theta)
    return rate if system.dry is None else system.dry.slowed(rate, direction, s, w, theta)


def _rates_at_rest(system: System, dry: DryFriction, s: Expression, w: Expression, theta: Expression) -> Expression:
    """Rates of the states that change while dry friction holds the load; 0 for the others."""
    rate = system.derivative(dry.at_rest(s, w, theta), w, theta)
    rate[: MOMENTUM + 1] = 0
    return rate


def _width(system: System) -> int:
    """Number of inputs, with their derivatives by a lag where they have one."""
    return system.inputs * (1 if system.input_lag is None else 2)


def _by_theta(expression: Expression, theta: Expression, system: System, *given: Expression) -> Expression:
    """Derivative with respect to theta, including the dependence through lagged inputs."""
    by_theta = ca.jacobian(expression, theta)
    if system.input_lag is None:
        return by_theta
    by_parameters = ca.jacobian(system.input_lag(theta), theta)
    for moment in given:
        inputs, by_lag = moment[: system.inputs], moment[system.inputs :]
        by_theta += ca.jtimes(expression, inputs, by_lag) @ by_parameters
    return by_theta


def _active(system: System) -> list[int]:
    """Columns of (theta, start) on which the motion, and not only the readings, depends."""
    theta, s = ca.SX.sym("theta", len(system.names)), ca.SX.sym("s", system.states)
    w = ca.SX.sym("w", system.inputs)
    start = ca.vertsplit(ca.SX.sym("start", system.starts)) if system.starts else []
    moving = ca.vertcat(system.derivative(s, w, theta), system.initial(*start, w, theta))
    if system.input_lag is not None:
        moving = ca.vertcat(moving, system.input_lag(theta))
    if system.dry is not None:
        moving = ca.vertcat(moving, system.dry.size(s, w, theta))
    depends = ca.which_depends(moving, theta, 1, False)
    return [*(i for i, moves in enumerate(depends) if moves), *range(len(depends), len(depends) + system.starts)]


def _start(system: System, active: list[int]) -> ca.Function:
    """State at the start, and its derivatives."""
    start = [ca.SX.sym(f"start{i}") for i in range(system.starts)]
    given = ca.SX.sym("w", _width(system))
    theta = ca.SX.sym("theta", len(system.names))
    state = system.initial(*start, given[: system.inputs], theta)
    by_theta = _by_theta(state, theta, system, given)
    sensitivity = ca.horzcat(by_theta, ca.jacobian(state, ca.vertcat(ca.SX(0, 1), *start)))[:, active]
    return ca.Function("start", [*start, given, theta], [ca.densify(state), ca.densify(sensitivity)])
