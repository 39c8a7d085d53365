"""Rollouts of a composed pendulum with exact sensitivities, in blocks of compiled Runge-Kutta steps."""

from typing import NamedTuple

import casadi as ca
import numpy as np

from armdyn.codegen import Buffered, compiled
from armdyn.pendulum.dynamics import INPUT_SIZE, OUTPUTS, STATE_SIZE, Dynamics
from armdyn.pendulum.path import GripperPath
from armdyn.pendulum.physics import Expression

BLOCK = 128
"""Steps per compiled call; a run of any length is a sequence of blocks, the last one cut."""


class Rollout(NamedTuple):
    """A simulated run; derivatives are with respect to (theta, angle at the start, p at the start), m = p + 2.

    Attributes:
        states: (K, 2) angle rad and momentum kg m^2/s.
        state_sensitivities: (2, m) of the last state.
        outputs: (K, 3) in the order of `dynamics.OUTPUTS`, before lag, delay and sampling.
        sensitivities: (K, 3, m) of the outputs.
    """

    states: np.ndarray
    state_sensitivities: np.ndarray
    outputs: np.ndarray
    sensitivities: np.ndarray


class Simulator:
    """Integrates one composition by the classical Runge-Kutta method; sensitivities are those of the integrator."""

    def __init__(self, dynamics: Dynamics, name: str) -> None:
        self.dynamics = dynamics
        self.parameters = len(dynamics.names)
        built = compiled(f"simulate_{name}", {"steps": _steps(dynamics), "start": _start(dynamics)})
        self._steps, self._start = Buffered(built["steps"]), Buffered(built["start"])

    def rollout(self, path: GripperPath, theta: np.ndarray, angle: float = 0.0, p: float = 0.0) -> Rollout:
        """Simulate along a gripper path.

        Args:
            path: on its grid of K nodes.
            theta: (p,) in the order of the dynamics' names.
            angle: at the first node, rad.
            p: swing rate seen from rest in space at the first node, rad/s; 0 for a load at rest.
        """
        nodes, middle = path.inputs()
        K, m = nodes.shape[1], self.parameters + 2
        padded = -(-K // BLOCK) * BLOCK
        inputs = np.zeros((3 * INPUT_SIZE, padded))
        inputs[:INPUT_SIZE, :K] = nodes
        inputs[INPUT_SIZE : 2 * INPUT_SIZE, : K - 1] = middle
        inputs[2 * INPUT_SIZE :, : K - 1] = nodes[:, 1:]
        step = np.zeros((1, padded))  # zero beyond the end: there the state stays
        step[0, : K - 1] = path.dt
        states = np.empty((padded, STATE_SIZE))
        outputs = np.empty((padded, len(OUTPUTS)))
        sensitivities = np.empty((padded, m, len(OUTPUTS)))
        state, sensitivity = self._start(angle, p, nodes[:, 0], theta)
        for first in range(0, padded, BLOCK):
            block = slice(first, first + BLOCK)
            before, y, dy, state, sensitivity = self._steps(
                state, sensitivity, inputs[:, block], step[:, block], theta
            )
            states[block], outputs[block] = before.T, y.T
            sensitivities[block] = dy.T.reshape(BLOCK, m, len(OUTPUTS))
        return Rollout(states[:K], sensitivity.copy(), outputs[:K], sensitivities[:K].transpose(0, 2, 1))


def _steps(dynamics: Dynamics) -> ca.Function:
    """One block of steps, with the outputs before each step."""
    parameters = len(dynamics.names)
    m = parameters + 2
    s, S, theta, dt = ca.SX.sym("s", STATE_SIZE), ca.SX.sym("S", STATE_SIZE, m), ca.SX.sym("theta", parameters), ca.SX.sym("dt")
    w = ca.SX.sym("w", 3 * INPUT_SIZE)
    here, middle, there = ca.vertsplit(w, INPUT_SIZE)
    f = dynamics.derivative
    k1 = f(s, here, theta)
    k2 = f(s + dt / 2 * k1, middle, theta)
    k3 = f(s + dt / 2 * k2, middle, theta)
    k4 = f(s + dt * k3, there, theta)
    following = s + dt / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    y = dynamics.output(s, here, theta)

    def total(expression: Expression) -> Expression:
        direct = ca.horzcat(ca.jacobian(expression, theta), ca.SX.zeros(expression.numel(), 2))
        return ca.densify(ca.jacobian(expression, s) @ S + direct)

    stage = ca.Function("stage", [s, S, w, dt, theta], [following, total(following), s, ca.densify(y), total(y)])
    over = stage.mapaccum("over", BLOCK, 2)
    s0, S0, P = ca.MX.sym("s", STATE_SIZE), ca.MX.sym("S", STATE_SIZE, m), ca.MX.sym("theta", parameters)
    W, DT = ca.MX.sym("w", 3 * INPUT_SIZE, BLOCK), ca.MX.sym("dt", 1, BLOCK)
    after, sensitivity, before, Y, dY = over(s0, S0, W, DT, ca.repmat(P, 1, BLOCK))
    return ca.Function("steps", [s0, S0, W, DT, P], [before, Y, dY, after[:, -1], sensitivity[:, -m:]])


def _start(dynamics: Dynamics) -> ca.Function:
    """State at the start and its derivatives."""
    angle, p, w = ca.SX.sym("angle"), ca.SX.sym("p"), ca.SX.sym("w", INPUT_SIZE)
    theta = ca.SX.sym("theta", len(dynamics.names))
    state = dynamics.initial(angle, p, w, theta)
    sensitivity = ca.jacobian(state, ca.vertcat(theta, angle, p))
    return ca.Function("start", [angle, p, w, theta], [ca.densify(state), ca.densify(sensitivity)])
