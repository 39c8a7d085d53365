"""Simulate a physics by compiled Runge-Kutta or Rosenbrock steps, with exact derivatives by the parameters."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import casadi as ca
import numpy as np

from armdyn.codegen import PreallocatedFunction, compile_functions
from armdyn.parameter import RecordedColumn
from armdyn.physics.definition import Expression
from armdyn.physics.dry import MOMENTUM_ROW, DryFriction
from armdyn.physics.recorded import InputPath
from armdyn.physics.rosenbrock import rosenbrock_step
from armdyn.physics.vibration import Vibration
from armdyn.readout import SensorReadout
from armdyn.smoothing.even import first_derivative

STEPS_PER_BLOCK = 16
"""Number of integration steps in one compiled block."""
STEPS_PER_CALL = 8 * STEPS_PER_BLOCK
"""Number of integration steps in one call of a compiled function; longer runs take several calls."""


@dataclass(frozen=True, eq=False, kw_only=True)
class System:
    """Continuous equations in states s, inputs w and parameters theta, as the simulator needs them.

    Attributes:
        names: names of the parameters in the order of theta.
        state_count: number of states s.
        start_value_count: number of start values of the motion.
        input_count: number of inputs w.
        recorded_columns: further recorded quantities that effects read: the last entries of w.
        outputs: names of the rows of `output`.
        derivative: ``(s, w, theta) -> (states,)`` rates of the states, without dry friction.
        output: ``(s, w, theta) -> (outputs,)`` outputs, followed by the impulse where there is one.
        initial: ``(start, ..., w, theta) -> s`` start state, with `start_value_count` arguments before w.
        sensors: sensor of each output, by its name.
        output_with_impulse_rate: output to which the time derivative of the impulse is added; None where there is no
            impulse.
        impulse_vibration: vibration that filters the impulse before; None without one.
        input_lag: ``theta -> ()`` lag of the inputs behind the recording, s; None without a lag.
        dry_friction: dry friction, which also holds a load at rest; None without it.
        stiff: whether a state decays so fast that steps must be implicit; such a system has no dry friction.
    """

    names: tuple[str, ...]
    state_count: int
    start_value_count: int
    input_count: int
    outputs: tuple[str, ...]
    derivative: ca.Function
    output: ca.Function
    initial: ca.Function
    sensors: Mapping[str, SensorReadout]
    output_with_impulse_rate: str | None = None
    impulse_vibration: Vibration | None = None
    input_lag: ca.Function | None = None
    dry_friction: DryFriction | None = None
    recorded_columns: tuple[RecordedColumn, ...] = ()
    stiff: bool = False


class Rollout(NamedTuple):
    """A simulated run, with its derivatives by the m parameters and start values.

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
    """Integrates equations by the classical Runge-Kutta method, or Rodas, with the exact derivatives of this method.

    Args:
        system: the equations.
        name: identifier of the equations, for the cache of compiled code.
        channels: outputs that are computed; None means all. Fewer are faster.

    Attributes:
        system: the equations.
        active_columns: indices in the vector (theta, start) of the parameters and initial states on which the motion
            depends.
        output_count: number of outputs, including the impulse of each step where there is one.
        steps: a block of steps, ``(state, its derivatives by active_columns, inputs, step lengths in s, theta) ->
            (state, its derivatives, states before each step, outputs, their derivatives)``.
    """

    def __init__(self, system: System, name: str, channels: tuple[str, ...] | None = None) -> None:
        self.channels = system.outputs if channels is None else channels
        self.parameters = len(system.names)
        self.system = system
        self.active_columns = _active(system)
        self._impulse = system.output_with_impulse_rate in self.channels
        self.output_count = len(self.channels) + self._impulse
        rows = [system.outputs.index(name) for name in self.channels] + [len(system.outputs)] * self._impulse
        steps = _repeated(_step(system, self.active_columns, rows), "steps", STEPS_PER_BLOCK)
        self.steps = compile_functions(f"simulate_{name}", {"steps": steps})["steps"]
        self._start = PreallocatedFunction(_start(system, self.active_columns))
        self._advance = PreallocatedFunction(_repeated(self.steps, "block", STEPS_PER_CALL // STEPS_PER_BLOCK))

    def rollout(self, path: InputPath, theta: np.ndarray, *start: float) -> Rollout:
        """Simulate the motion along recorded inputs.

        Args:
            path: inputs on a grid of K nodes, with their derivatives by the lag where they have one.
            theta: (p,) parameters in the order of the system's names.
            start: start values at the first node; values that are not given are 0.
        """
        found = self.rollout_with_impulse(path, theta, *start)
        outputs, sensitivities = self.with_impulse_force(found.outputs, found.sensitivities, theta, path.dt)
        return found._replace(outputs=outputs, sensitivities=sensitivities)

    def rollout_with_impulse(self, path: InputPath, theta: np.ndarray, *start: float) -> Rollout:
        """Simulate as `rollout` does, but with the impulse, whose time derivative is a force, as the last output."""
        fine, shown = path.refined, slice(None, None, path.steps_per_interval)
        inputs, step = fine.padded_steps(self.system.input_count, STEPS_PER_CALL)
        starts, (width, padded) = self.system.start_value_count, inputs.shape
        K, m, n, columns = fine.nodes.shape[1], self.parameters + starts, self.system.state_count, self.output_count
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
        last[:, self.active_columns] = sensitivity
        return Rollout(states[:K][shown], last, outputs[:K][shown], sensitivities[:K][shown].transpose(0, 2, 1))

    def with_impulse_force(
        self, outputs: np.ndarray, by_theta: np.ndarray, theta: np.ndarray, dt: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Add the impulse's time derivative to the force, in (K, c) outputs and their (K, c, m) derivatives."""
        if not self._impulse:
            return outputs, by_theta
        force = self.channels.index(str(self.system.output_with_impulse_rate))
        outputs, by_theta = outputs.copy(), by_theta.copy()
        impulse, impulse_by_theta = outputs[:, -1], by_theta[:, -1]
        if self.system.impulse_vibration is not None:
            impulse, impulse_by_theta = self.system.impulse_vibration.response(impulse, impulse_by_theta, theta, dt)
        outputs[:, force] += first_derivative(impulse[:, None], dt)[:, 0]
        by_theta[:, force] += first_derivative(impulse_by_theta, dt)
        return outputs[:, :-1], by_theta[:, :-1]


def _step(system: System, active: list[int], rows: list[int]) -> ca.Function:
    """One step, with the outputs before it and their derivatives; see `Simulator.steps`.

    The derivatives S of the state obey the integrator's own chain rule, stage by stage, and only for the columns in
    `active`: a parameter of a sensor never moves the load. The inputs are followed by their derivatives by a lag, if
    they have one.
    """
    parameters, n, width = len(system.names), system.state_count, _width(system)
    s, S, w = ca.SX.sym("s", n), ca.SX.sym("S", n, len(active)), ca.SX.sym("w", 3 * width)
    theta, dt = ca.SX.sym("theta", parameters), ca.SX.sym("dt")
    here, middle, there = ca.vertsplit(w, width)

    def with_derivatives(function: Callable[..., Expression], states: int, moments: int) -> Callable[..., Expression]:
        """Turn a function of states, inputs, theta and a number into one of states with S appended."""
        points = [ca.SX.sym(f"s{k}", n) for k in range(states)]
        given, number = [ca.SX.sym(f"w{k}", width) for k in range(moments)], ca.SX.sym("number")
        value = function(*points, *(moment[: system.input_count] for moment in given), theta, number)
        by_theta = ca.horzcat(_by_theta(value, theta, system, *given), ca.SX(n, system.start_value_count))[:, active]
        by_states = [ca.jacobian(value, point) for point in points]
        slopes = ca.Function("slopes", [*points, *given, theta, number], [value, by_theta, *by_states])

        def of(*arguments: Expression) -> Expression:
            found, total, *by_state = slopes(*(z[:, 0] for z in arguments[:states]), *arguments[states:])
            for by_point, z in zip(by_state, arguments[:states], strict=True):
                total += by_point @ z[:, 1:]
            return ca.horzcat(found, total)

        return of

    following = state_after_step(system, ca.horzcat(s, S), (here, middle, there), theta, dt, with_derivatives)
    y = system.output(s, here[: system.input_count], theta)[rows]
    dy = ca.horzcat(_by_theta(y, theta, system, here), ca.SX(y.numel(), system.start_value_count))
    dy[:, active] += ca.jacobian(y, s) @ S
    results = [following[:, 0], following[:, 1:], s, y, dy]
    return ca.Function("step", [s, S, w, dt, theta], ca.cse([ca.densify(result) for result in results]))


def _repeated(steps: ca.Function, name: str, times: int) -> ca.Function:
    """A block of repeated steps; see `Simulator.steps`."""
    s, S, w, dt, theta = (ca.MX.sym("given", *steps.size_in(i)) for i in range(5))
    w, dt = (ca.MX.sym("given", each.size1(), times * each.size2()) for each in (w, dt))
    after, sensitivity, *outputs = steps.mapaccum("over", times, 2)(s, S, w, dt, ca.repmat(theta, 1, times))
    return ca.Function(name, [s, S, w, dt, theta], [after[:, -1], sensitivity[:, -S.size2() :], *outputs])


def state_after_step(
    system: System,
    z: Expression,
    inputs: tuple[Expression, ...],
    theta: Expression,
    dt: Expression,
    lifted: Callable[..., Callable[..., Expression]] = lambda function, *_: function,
) -> Expression:
    """The state after one integration step.

    Args:
        system: the equations.
        z: (n, ...) state at the start of the step in the first column.
        inputs: inputs at the start of the step, halfway and at its end.
        theta: parameters.
        dt: length of the step, s.
        lifted: makes a function of states, inputs, theta and a number apply to all columns of z.
    """
    (here, middle, there), dry = inputs, system.dry_friction
    if system.stiff:

        def implicit(s: Expression, *given: Expression) -> Expression:
            *moments, p, h = given
            return rosenbrock_step(system.derivative, s, tuple(moments), p, h)

        return lifted(implicit, 1, 3)(z, here, middle, there, theta, dt)
    direction = 0 if dry is None else dry.sliding_direction(z[:, 0], here[: system.input_count], theta, dt)
    moving = lifted(lambda s, w, p, way: _rates(system, s, w, p, way), 1, 1)
    following = runge_kutta_step(lambda s, w: moving(s, w, theta, direction), z, inputs, dt)
    if dry is None:
        return following
    held = following
    if dry.has_friction_states:
        resting = lifted(lambda s, w, p, _: _rates_at_rest(system, dry, s, w, p), 1, 1)
        held = runge_kutta_step(lambda s, w: resting(s, w, theta, 0), z, inputs, dt)
    return lifted(dry.corrected_state, 3, 2)(z, following, held, here, there, theta, dt)


def runge_kutta_step(
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
    return (
        rate if system.dry_friction is None else system.dry_friction.rates_with_friction(rate, direction, s, w, theta)
    )


def _rates_at_rest(system: System, dry: DryFriction, s: Expression, w: Expression, theta: Expression) -> Expression:
    """Rates of the states that change while dry friction holds the load; 0 for the others."""
    rate = system.derivative(dry.state_at_rest(s, w, theta), w, theta)
    rate[: MOMENTUM_ROW + 1] = 0
    return rate


def _width(system: System) -> int:
    """Number of inputs, with their derivatives by a lag where they have one."""
    return system.input_count * (1 if system.input_lag is None else 2)


def _by_theta(expression: Expression, theta: Expression, system: System, *given: Expression) -> Expression:
    """Derivative with respect to theta, including the dependence through lagged inputs."""
    by_theta = ca.jacobian(expression, theta)
    if system.input_lag is None:
        return by_theta
    by_parameters = ca.jacobian(system.input_lag(theta), theta)
    for moment in given:
        inputs, by_lag = moment[: system.input_count], moment[system.input_count :]
        by_theta += ca.jtimes(expression, inputs, by_lag) @ by_parameters
    return by_theta


def _active(system: System) -> list[int]:
    """Columns of (theta, start) on which the motion, and not only the readings, depends."""
    theta, s = ca.SX.sym("theta", len(system.names)), ca.SX.sym("s", system.state_count)
    w = ca.SX.sym("w", system.input_count)
    start = ca.vertsplit(ca.SX.sym("start", system.start_value_count)) if system.start_value_count else []
    moving = ca.vertcat(system.derivative(s, w, theta), system.initial(*start, w, theta))
    if system.input_lag is not None:
        moving = ca.vertcat(moving, system.input_lag(theta))
    if system.dry_friction is not None:
        moving = ca.vertcat(moving, system.dry_friction.friction_force(s, w, theta))
    depends = ca.which_depends(moving, theta, 1, False)
    return [
        *(i for i, moves in enumerate(depends) if moves),
        *range(len(depends), len(depends) + system.start_value_count),
    ]


def _start(system: System, active: list[int]) -> ca.Function:
    """State at the start, and its derivatives."""
    start = [ca.SX.sym(f"start{i}") for i in range(system.start_value_count)]
    given = ca.SX.sym("w", _width(system))
    theta = ca.SX.sym("theta", len(system.names))
    state = system.initial(*start, given[: system.input_count], theta)
    by_theta = _by_theta(state, theta, system, given)
    sensitivity = ca.horzcat(by_theta, ca.jacobian(state, ca.vertcat(ca.SX(0, 1), *start)))[:, active]
    return ca.Function("start", [*start, given, theta], [ca.densify(state), ca.densify(sensitivity)])
