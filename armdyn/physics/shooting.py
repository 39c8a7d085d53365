"""Simulate pieces of a motion at once, each from its own start: multiple shooting (Bock & Plitt, IFAC 1984)."""

from dataclasses import replace
from functools import lru_cache
from typing import NamedTuple

import casadi as ca
import numpy as np

from armdyn.codegen import PreallocatedFunction
from armdyn.physics.recorded import InputPath
from armdyn.physics.simulate import STEPS_PER_BLOCK, Simulator, System

PIECES_PER_CALL = 64
"""Largest number of pieces that one call of a compiled function simulates."""


class SimulatedPieces(NamedTuple):
    """Simulation of J pieces over K nodes, with n states, c outputs and q parameters.

    A node between two pieces belongs to the later piece.

    Attributes:
        end_states: (J, n) states at the ends of the pieces.
        transition: (J, n, n) derivative of `end_states` by the states at the beginnings of the pieces.
        by_theta: (J, n, q) derivative of `end_states` by the parameters.
        outputs: (K, c) outputs before impulse, lag, delay and sampling; see `Simulator.rollout_with_impulse`.
        by_state: (K, c, n) derivative of `outputs` by the state at the beginning of the piece.
        outputs_by_theta: (K, c, q) derivatives of `outputs` by the parameters.
    """

    end_states: np.ndarray
    transition: np.ndarray
    by_theta: np.ndarray
    outputs: np.ndarray
    by_state: np.ndarray
    outputs_by_theta: np.ndarray


@lru_cache(maxsize=64)
def piece_simulator(system: System, name: str, channels: tuple[str, ...]) -> Simulator:
    """Simulator that starts at a full state vector and differentiates by it, for one piece of a motion."""
    states = [ca.SX.sym(f"s{i}") for i in range(system.state_count)]
    given, theta = ca.SX.sym("w", system.input_count), ca.SX.sym("theta", len(system.names))
    itself = ca.Function("initial", [*states, given, theta], [ca.vertcat(*states)])
    return Simulator(replace(system, start_value_count=system.state_count, initial=itself), name, channels)


@lru_cache(maxsize=256)
def _steps(simulator: Simulator, pieces: int) -> PreallocatedFunction:
    """The compiled steps of a number of pieces."""
    return PreallocatedFunction(simulator.steps.map(f"shots_{pieces}", "serial", pieces, [4], []))


def simulate_pieces(
    simulator: Simulator, path: InputPath, edges: np.ndarray, theta: np.ndarray, states: np.ndarray
) -> SimulatedPieces:
    """Simulate each piece of a motion from its own start state.

    Args:
        simulator: a `piece_simulator`.
        path: inputs of the motion.
        edges: (J + 1,) nodes of the path at which pieces begin and end.
        theta: (q,) parameters in the order of the system's names.
        states: (J, n) states at the beginnings of the pieces.
    """
    s, parts = simulator, path.steps_per_interval
    path, edges = path.refined, edges * parts
    J, n, q, c, K = len(states), states.shape[1], len(theta), s.output_count, edges[-1] - edges[0] + 1
    m = q + n
    nodes, middle, last = path.step_inputs(s.system.input_count)
    ends, slopes = np.empty((J, n)), np.zeros((J, n, m))
    outputs, sensitivities = np.empty((K, c)), np.empty((K, c, m))
    steps = np.diff(edges)
    begin = np.hstack([np.zeros((n, len(s.active_columns) - n)), np.eye(n)])
    for first in range(0, J, PIECES_PER_CALL):
        these = slice(first, min(first + PIECES_PER_CALL, J))
        size = these.stop - first
        at, lasts, advance = edges[:-1][these], steps[these], _steps(s, size)
        shown = lasts + (np.arange(size) == J - 1 - first)  # the last piece's end belongs to no other piece
        state, sensitivity = states[these].T, np.tile(begin, size)
        for done in range(0, int(shown.max()), STEPS_PER_BLOCK):
            step = done + np.arange(STEPS_PER_BLOCK)
            node = at[:, None] + step
            here = np.minimum(node, nodes.shape[1] - 1)
            now = np.minimum(here, middle.shape[1] - 1)
            inputs = np.concatenate([nodes[:, here], middle[:, now], last[:, now]]).reshape(-1, size * STEPS_PER_BLOCK)
            moving = np.where(step < lasts[:, None], path.dt, 0.0).reshape(1, -1)
            state, sensitivity, _, y, dy = advance(state, sensitivity, inputs, moving, theta)
            kept = step < shown[:, None]
            target = (node - edges[0])[kept]
            outputs[target] = y.T.reshape(size, STEPS_PER_BLOCK, c)[kept]
            by = dy.T.reshape(size, STEPS_PER_BLOCK, m, c)[kept]
            sensitivities[target] = by.transpose(0, 2, 1)
        ends[these] = state.T
        slopes[these][:, :, s.active_columns] = sensitivity.reshape(n, size, len(s.active_columns)).transpose(1, 0, 2)
    by_theta, by_state = sensitivities[::parts, :, :q], sensitivities[::parts, :, q:]
    return SimulatedPieces(ends, slopes[:, :, q:], slopes[:, :, :q], outputs[::parts], by_state, by_theta)
