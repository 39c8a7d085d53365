"""Rollouts of a composed pendulum with exact sensitivities, in blocks of compiled Runge-Kutta steps."""

from typing import NamedTuple

import casadi as ca
import numpy as np

from armdyn.codegen import Buffered, compiled
from armdyn.pendulum.dynamics import OUTPUTS, Dynamics
from armdyn.pendulum.path import GripperPath
from armdyn.pendulum.physics import Expression
from armdyn.pendulum.readout import differentiated_columns
from armdyn.pendulum.trailing import TrailingPath

BLOCK = 128
"""Steps per compiled call; a run of any length is a sequence of blocks, the last one cut."""


class Rollout(NamedTuple):
    """A simulated run; derivatives are with respect to (theta, angle at the start, p at the start), m = p + 2.

    Attributes:
        states: (K, n) angle rad, momentum kg m^2/s, and what else moves (see `Dynamics`).
        state_sensitivities: (n, m) of the last state.
        outputs: (K, c) one column per channel of the simulator, before lag, delay and sampling.
        sensitivities: (K, c, m) of the outputs.
    """

    states: np.ndarray
    state_sensitivities: np.ndarray
    outputs: np.ndarray
    sensitivities: np.ndarray


class Simulator:
    """Integrates one composition by the classical Runge-Kutta method; sensitivities are those of the integrator.

    Args:
        dynamics: the equations.
        name: identifier of the composition, for the cache of compiled code.
        channels: the outputs that are wanted, of `dynamics.OUTPUTS`; fewer are faster.
        trails: whether the gripper trails the path.
    """

    def __init__(
        self, dynamics: Dynamics, name: str, channels: tuple[str, ...] = OUTPUTS, *, trails: bool = False
    ) -> None:
        self.channels = channels
        self.parameters = len(dynamics.names)
        self._dynamics, self._trails = dynamics, trails
        self._active = _active(dynamics, trails)
        self._impulse = dynamics.yields and "load_force" in channels
        rows = [OUTPUTS.index(name) for name in channels] + [len(OUTPUTS)] * self._impulse
        built = compiled(
            f"simulate_{name}",
            {
                "steps": _steps(dynamics, self._active, rows, trails),
                "start": _start(dynamics, self._active, trails),
            },
        )
        self._steps, self._start = Buffered(built["steps"]), Buffered(built["start"])

    def rollout(
        self, path: GripperPath | TrailingPath, theta: np.ndarray, angle: float = 0.0, p: float = 0.0
    ) -> Rollout:
        """Simulate along a gripper path.

        Args:
            path: on its grid of K nodes; a `TrailingPath` where the gripper trails.
            theta: (p,) in the order of the dynamics' names.
            angle: at the first node, rad.
            p: swing rate seen from rest in space at the first node, rad/s; 0 for a load at rest.
        """
        nodes, middle = self._inputs(path)
        rows = len(nodes)
        K, m, n = nodes.shape[1], self.parameters + 2, self._dynamics.states
        padded = -(-K // BLOCK) * BLOCK
        inputs = np.zeros((3 * rows, padded))
        inputs[:rows, :K] = nodes
        inputs[rows : 2 * rows, : K - 1] = middle
        inputs[2 * rows :, : K - 1] = nodes[:, 1:]
        step = np.zeros((1, padded))  # zero beyond the end: there the state stays
        step[0, : K - 1] = path.dt
        columns = len(self.channels) + self._impulse
        states = np.empty((padded, n))
        outputs = np.empty((padded, columns))
        sensitivities = np.empty((padded, m, columns))
        state, sensitivity = self._start(angle, p, nodes[:, 0], theta)
        for first in range(0, padded, BLOCK):
            block = slice(first, first + BLOCK)
            before, y, dy, state, sensitivity = self._steps(state, sensitivity, inputs[:, block], step[:, block], theta)
            states[block], outputs[block] = before.T, y.T
            sensitivities[block] = dy.T.reshape(BLOCK, m, columns)
        last = np.zeros((n, m))
        last[:, self._active] = sensitivity
        outputs, by_theta = outputs[:K], sensitivities[:K].transpose(0, 2, 1)
        if self._impulse:
            outputs, by_theta = self._with_impulse(outputs, by_theta, path.dt)
        return Rollout(states[:K], last, outputs, by_theta)

    def _inputs(self, path: GripperPath | TrailingPath) -> tuple[np.ndarray, np.ndarray]:
        """Inputs of the dynamics at the nodes and halfway between, with their derivatives where the gripper trails."""
        parts = [path.inputs]
        if self._dynamics.yields:
            parts.append(path.jerk)
        if isinstance(path, TrailingPath):
            parts.append(path.inputs_by_lag)
            if self._dynamics.yields:
                parts.append(path.jerk_by_lag)
        if len(parts) == 1:
            return path.inputs
        nodes, middle = zip(*parts, strict=True)
        return np.vstack(nodes), np.vstack(middle)

    def _with_impulse(self, outputs: np.ndarray, by_theta: np.ndarray, dt: float) -> tuple[np.ndarray, np.ndarray]:
        """Outputs and derivatives without the last column, whose time derivative has been added to the force."""
        force = self.channels.index("load_force")
        outputs, by_theta = outputs.copy(), by_theta.copy()
        outputs[:, force] += differentiated_columns(outputs[:, -1:], dt)[:, 0]
        by_theta[:, force] += differentiated_columns(by_theta[:, -1], dt)
        return outputs[:, :-1], by_theta[:, :-1]


def _steps(dynamics: Dynamics, active: list[int], rows: list[int], trails: bool) -> ca.Function:
    """One block of steps, with the outputs before each step and their derivatives.

    The derivatives S of the state obey the integrator's own chain rule, stage by stage, and only for the columns in
    `active`: a parameter of a sensor never moves the load. Where the gripper trails, the inputs are followed by their
    derivatives with respect to its lag.
    """
    parameters, n = len(dynamics.names), dynamics.states
    width = dynamics.inputs * (2 if trails else 1)
    s, S = ca.SX.sym("s", n), ca.SX.sym("S", n, len(active))
    theta, dt = ca.SX.sym("theta", parameters), ca.SX.sym("dt")
    w = ca.SX.sym("w", 3 * width)
    here, middle, there = ca.vertsplit(w, width)
    point, given = ca.SX.sym("point", n), ca.SX.sym("given", width)
    rate = dynamics.derivative(point, given[: dynamics.inputs], theta)
    by_state = ca.jacobian(rate, point)
    by_theta = ca.horzcat(_by_theta(rate, given, theta, dynamics, trails), ca.SX(n, 2))
    slope = ca.Function("slope", [point, given, theta], [rate, by_state, by_theta[:, active]])

    total, total_S = 0, 0
    stage_s, stage_S = s, S
    for inputs, reach, weight in ((here, 1 / 2, 1), (middle, 1 / 2, 2), (middle, 1, 2), (there, 0, 1)):
        k, A, B = slope(stage_s, inputs, theta)
        K = A @ stage_S + B
        total, total_S = total + weight * k, total_S + weight * K
        stage_s, stage_S = s + reach * dt * k, S + reach * dt * K
    following, following_S = s + dt / 6 * total, S + dt / 6 * total_S

    y = dynamics.output(s, here[: dynamics.inputs], theta)[rows]
    dy = ca.horzcat(_by_theta(y, here, theta, dynamics, trails), ca.SX(y.numel(), 2))
    dy[:, active] += ca.jacobian(y, s) @ S
    stage = ca.Function(
        "stage", [s, S, w, dt, theta], [following, ca.densify(following_S), s, ca.densify(y), ca.densify(dy)]
    )
    over = stage.mapaccum("over", BLOCK, 2)
    s0, S0, P = ca.MX.sym("s", n), ca.MX.sym("S", n, len(active)), ca.MX.sym("theta", parameters)
    W, DT = ca.MX.sym("w", 3 * width, BLOCK), ca.MX.sym("dt", 1, BLOCK)
    after, sensitivity, before, Y, dY = over(s0, S0, W, DT, ca.repmat(P, 1, BLOCK))
    return ca.Function("steps", [s0, S0, W, DT, P], [before, Y, dY, after[:, -1], sensitivity[:, -len(active) :]])


def _by_theta(
    expression: Expression, given: Expression, theta: Expression, dynamics: Dynamics, trails: bool
) -> Expression:
    """Derivative with respect to theta, through the trailing gripper as well."""
    direct = ca.jacobian(expression, theta)
    if not trails:
        return direct
    inputs, by_lag = given[: dynamics.inputs], given[dynamics.inputs :]
    _, _, lag = dynamics.timing(theta)
    return direct + ca.jtimes(expression, inputs, by_lag) @ ca.jacobian(lag, theta)


def _active(dynamics: Dynamics, trails: bool) -> list[int]:
    """Columns of (theta, angle, p) on which the motion depends, not only the readings."""
    theta, s = ca.SX.sym("theta", len(dynamics.names)), ca.SX.sym("s", dynamics.states)
    w = ca.SX.sym("w", dynamics.inputs)
    moving = ca.vertcat(dynamics.derivative(s, w, theta), dynamics.initial(s[0], s[1], w, theta))
    if trails:
        moving = ca.vertcat(moving, dynamics.timing(theta)[2])
    depends = ca.which_depends(moving, theta, 1, False)
    return [*(i for i, moves in enumerate(depends) if moves), len(depends), len(depends) + 1]


def _start(dynamics: Dynamics, active: list[int], trails: bool) -> ca.Function:
    """State at the start and its derivatives."""
    angle, p = ca.SX.sym("angle"), ca.SX.sym("p")
    given = ca.SX.sym("w", dynamics.inputs * (2 if trails else 1))
    theta = ca.SX.sym("theta", len(dynamics.names))
    state = dynamics.initial(angle, p, given[: dynamics.inputs], theta)
    by_theta = _by_theta(state, given, theta, dynamics, trails)
    sensitivity = ca.horzcat(by_theta, ca.jacobian(state, ca.vertcat(angle, p)))[:, active]
    return ca.Function("start", [angle, p, given, theta], [ca.densify(state), ca.densify(sensitivity)])
