r"""Gradient of a sum over the samples of a rollout with respect to the recorded inputs, by one reverse pass.

With s_{k+1} = f(s_k, w_k) and y_k = h(s_k, w_k) the sum S = sum_k c_k' y_k has the gradient

    dS/dw_k = (df/dw_k)' lambda_{k+1} + (dh/dw_k)' c_k,      lambda_k = (df/ds_k)' lambda_{k+1} + (dh/ds_k)' c_k,

at the cost of about one rollout, however many numbers describe the inputs (Griewank & Walther, Evaluating Derivatives,
2nd ed., §3.2). It is the exact derivative of the Runge-Kutta scheme of `simulate`, not of the differential equation.
"""

from functools import lru_cache

import casadi as ca
import numpy as np
from scipy.sparse import csr_matrix

from armdyn.codegen import PreallocatedFunction, compile_functions
from armdyn.physics.recorded import InputPath
from armdyn.physics.simulate import STEPS_PER_CALL, System, state_after_step
from armdyn.smoothing.even import first_derivative


class Adjoint:
    """Computes gradients of weighted sums of a simulation's outputs, by integration backwards in time.

    Args:
        system: the equations.
        name: identifier of the equations, for the cache of compiled code.
        channels: the outputs whose weighted sum is differentiated.
    """

    def __init__(self, system: System, name: str, channels: tuple[str, ...]) -> None:
        self._system = system
        self._impulse = system.output_with_impulse_rate in channels
        self._force = channels.index(str(system.output_with_impulse_rate)) if self._impulse else 0
        rows = [system.outputs.index(channel) for channel in channels] + [len(system.outputs)] * self._impulse
        self._back = PreallocatedFunction(compile_functions(f"adjoint_{name}", {"back": _back(system, rows)})["back"])

    def gradient(
        self, path: InputPath, theta: np.ndarray, states: np.ndarray, weights: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Gradient of the weighted sum of outputs with respect to the inputs.

        Args:
            path: the inputs of the rollout, on its grid of K nodes.
            theta: (p,) parameters in the order of the system's names.
            states: (K, n) states of the rollout; the state at the start is fixed.
            weights: (K, c) weights, one column for each channel.

        Returns:
            (i, K) derivatives by the inputs at the nodes, and (i, K-1) by those halfway between the nodes. In a
            compliant pendulum the last input is the gripper's jerk.
        """
        s = self._system
        K = path.nodes.shape[1]
        if self._impulse:
            impulse = _slope_matrix(K).T @ weights[:, self._force] / path.dt
            if s.impulse_vibration is not None:
                impulse = s.impulse_vibration.adjoint(impulse, theta, path.dt)
            weights = np.column_stack([weights, impulse])
        inputs, step = (
            part[:, ::-1] for part in path.padded_steps(s.input_count, STEPS_PER_CALL)
        )  # from the last node back
        padded = step.shape[1]
        first = padded - K
        inputs = inputs.reshape(3, -1, padded)[:, : s.input_count].reshape(-1, padded)  # without derivatives by a lag
        state = np.hstack([np.tile(states[-1:].T, first), states.T[:, ::-1]])
        weight = np.hstack([np.zeros((weights.shape[1], first)), weights.T[:, ::-1]])
        gradient, co = np.empty((3 * s.input_count, padded)), np.zeros((s.state_count, 1))
        for begin in range(0, padded, STEPS_PER_CALL):
            block = slice(begin, begin + STEPS_PER_CALL)
            co, part = self._back(co, state[:, block], inputs[:, block], step[:, block], weight[:, block], theta)
            gradient[:, block] = part
        gradient = gradient[:, first:][:, ::-1]
        here, between, there = np.split(gradient, 3)
        at_nodes = here.copy()
        at_nodes[:, 1:] += there[:, :-1]
        return at_nodes, between[:, :-1].copy()


def _back(system: System, rows: list[int]) -> ca.Function:
    """One block of steps back in time: adjoint states, and gradients by the inputs at both nodes and halfway."""
    n, width = system.state_count, system.input_count
    s, co, theta, dt = ca.SX.sym("s", n), ca.SX.sym("co", n), ca.SX.sym("theta", len(system.names)), ca.SX.sym("dt")
    w, c = ca.SX.sym("w", 3 * width), ca.SX.sym("c", len(rows))
    here, middle, there = ca.vertsplit(w, width)
    following = state_after_step(system, s, (here, middle, there), theta, dt)
    total = ca.dot(co, following) + ca.dot(c, system.output(s, here, theta)[rows])
    step = ca.Function(
        "step", [co, s, w, dt, c, theta], [ca.densify(ca.gradient(total, s)), ca.densify(ca.gradient(total, w))]
    )
    over = step.mapaccum("over", STEPS_PER_CALL)
    co0, P = ca.MX.sym("co", n), ca.MX.sym("theta", len(system.names))
    S, W = ca.MX.sym("s", n, STEPS_PER_CALL), ca.MX.sym("w", 3 * width, STEPS_PER_CALL)
    DT, C = ca.MX.sym("dt", 1, STEPS_PER_CALL), ca.MX.sym("c", len(rows), STEPS_PER_CALL)
    costates, gradient = over(co0, S, W, DT, C, ca.repmat(P, 1, STEPS_PER_CALL))
    return ca.Function("back", [co0, S, W, DT, C, P], [costates[:, -1], gradient])


@lru_cache(maxsize=4)
def _slope_matrix(size: int) -> csr_matrix:
    """(size, size) matrix that takes even samples to their first derivative, for a step of 1."""
    return csr_matrix(first_derivative(np.eye(size), 1.0))
