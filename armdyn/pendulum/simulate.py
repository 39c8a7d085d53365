"""Rollouts of a composed pendulum with exact sensitivities, in blocks of compiled Runge-Kutta steps."""

from typing import NamedTuple

import casadi as ca
import numpy as np

from armdyn.codegen import Buffered, compiled
from armdyn.pendulum.dynamics import INPUT_SIZE, OUTPUTS, STATE_SIZE, Dynamics
from armdyn.pendulum.path import GripperPath

BLOCK = 128
"""Steps per compiled call; a run of any length is a sequence of blocks, the last one cut."""


class Rollout(NamedTuple):
    """A simulated run; derivatives are with respect to (theta, angle at the start, p at the start), m = p + 2.

    Attributes:
        states: (K, 2) angle rad and momentum kg m^2/s.
        state_sensitivities: (2, m) of the last state.
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
    """

    def __init__(self, dynamics: Dynamics, name: str, channels: tuple[str, ...] = OUTPUTS) -> None:
        self.channels = channels
        self.parameters = len(dynamics.names)
        self._active = _active(dynamics)
        built = compiled(
            f"simulate_{name}",
            {"steps": _steps(dynamics, self._active, channels), "start": _start(dynamics, self._active)},
        )
        self._steps, self._start = Buffered(built["steps"]), Buffered(built["start"])

    def rollout(self, path: GripperPath, theta: np.ndarray, angle: float = 0.0, p: float = 0.0) -> Rollout:
        """Simulate along a gripper path.

        Args:
            path: on its grid of K nodes.
            theta: (p,) in the order of the dynamics' names.
            angle: at the first node, rad.
            p: swing rate seen from rest in space at the first node, rad/s; 0 for a load at rest.
        """
        nodes, middle = path.inputs
        K, m = nodes.shape[1], self.parameters + 2
        padded = -(-K // BLOCK) * BLOCK
        inputs = np.zeros((3 * INPUT_SIZE, padded))
        inputs[:INPUT_SIZE, :K] = nodes
        inputs[INPUT_SIZE : 2 * INPUT_SIZE, : K - 1] = middle
        inputs[2 * INPUT_SIZE :, : K - 1] = nodes[:, 1:]
        step = np.zeros((1, padded))  # zero beyond the end: there the state stays
        step[0, : K - 1] = path.dt
        states = np.empty((padded, STATE_SIZE))
        outputs = np.empty((padded, len(self.channels)))
        sensitivities = np.empty((padded, m, len(self.channels)))
        state, sensitivity = self._start(angle, p, nodes[:, 0], theta)
        for first in range(0, padded, BLOCK):
            block = slice(first, first + BLOCK)
            before, y, dy, state, sensitivity = self._steps(state, sensitivity, inputs[:, block], step[:, block], theta)
            states[block], outputs[block] = before.T, y.T
            sensitivities[block] = dy.T.reshape(BLOCK, m, len(self.channels))
        last = np.zeros((STATE_SIZE, m))
        last[:, self._active] = sensitivity
        return Rollout(states[:K], last, outputs[:K], sensitivities[:K].transpose(0, 2, 1))


def _steps(dynamics: Dynamics, active: list[int], channels: tuple[str, ...]) -> ca.Function:
    """One block of steps, with the outputs before each step and their derivatives.

    The derivatives S of the state obey the integrator's own chain rule, stage by stage, and only for the columns in
    `active`: a parameter of a sensor never moves the load.
    """
    parameters = len(dynamics.names)
    s, S = ca.SX.sym("s", STATE_SIZE), ca.SX.sym("S", STATE_SIZE, len(active))
    theta, dt = ca.SX.sym("theta", parameters), ca.SX.sym("dt")
    w = ca.SX.sym("w", 3 * INPUT_SIZE)
    here, middle, there = ca.vertsplit(w, INPUT_SIZE)
    point, at = ca.SX.sym("point", STATE_SIZE), ca.SX.sym("at", INPUT_SIZE)
    rate = dynamics.derivative(point, at, theta)
    by_state, by_theta = ca.jacobian(rate, point), ca.horzcat(ca.jacobian(rate, theta), ca.SX(STATE_SIZE, 2))
    slope = ca.Function("slope", [point, at, theta], [rate, by_state, by_theta[:, active]])

    total, total_S = 0, 0
    stage_s, stage_S = s, S
    for inputs, reach, weight in ((here, 1 / 2, 1), (middle, 1 / 2, 2), (middle, 1, 2), (there, 0, 1)):
        k, A, B = slope(stage_s, inputs, theta)
        K = A @ stage_S + B
        total, total_S = total + weight * k, total_S + weight * K
        stage_s, stage_S = s + reach * dt * k, S + reach * dt * K
    following, following_S = s + dt / 6 * total, S + dt / 6 * total_S

    y = dynamics.output(s, here, theta)[[OUTPUTS.index(name) for name in channels]]
    dy = ca.horzcat(ca.jacobian(y, theta), ca.SX(y.numel(), 2))
    dy[:, active] += ca.jacobian(y, s) @ S
    stage = ca.Function(
        "stage", [s, S, w, dt, theta], [following, ca.densify(following_S), s, ca.densify(y), ca.densify(dy)]
    )
    over = stage.mapaccum("over", BLOCK, 2)
    s0, S0, P = ca.MX.sym("s", STATE_SIZE), ca.MX.sym("S", STATE_SIZE, len(active)), ca.MX.sym("theta", parameters)
    W, DT = ca.MX.sym("w", 3 * INPUT_SIZE, BLOCK), ca.MX.sym("dt", 1, BLOCK)
    after, sensitivity, before, Y, dY = over(s0, S0, W, DT, ca.repmat(P, 1, BLOCK))
    return ca.Function("steps", [s0, S0, W, DT, P], [before, Y, dY, after[:, -1], sensitivity[:, -len(active) :]])


def _active(dynamics: Dynamics) -> list[int]:
    """Columns of (theta, angle, p) on which the motion depends, not only the readings."""
    theta, s, w = ca.SX.sym("theta", len(dynamics.names)), ca.SX.sym("s", STATE_SIZE), ca.SX.sym("w", INPUT_SIZE)
    moving = ca.vertcat(dynamics.derivative(s, w, theta), dynamics.initial(s[0], s[1], w, theta))
    depends = ca.which_depends(moving, theta, 1, False)
    return [*(i for i, moves in enumerate(depends) if moves), len(depends), len(depends) + 1]


def _start(dynamics: Dynamics, active: list[int]) -> ca.Function:
    """State at the start and its derivatives."""
    angle, p, w = ca.SX.sym("angle"), ca.SX.sym("p"), ca.SX.sym("w", INPUT_SIZE)
    theta = ca.SX.sym("theta", len(dynamics.names))
    state = dynamics.initial(angle, p, w, theta)
    sensitivity = ca.jacobian(state, ca.vertcat(theta, angle, p))[:, active]
    return ca.Function("start", [angle, p, w, theta], [ca.densify(state), ca.densify(sensitivity)])
