r"""Derivatives of an arm's simulated motion by its parameters, by forward sensitivities.

The simulated motion satisfies rho(q, v, a; theta) = needed torque - drives' torque = 0. A change of a parameter changes
the motion by dq, dv, da with

    R_a da + R_v dv + R_q dq + R_theta = 0,            dq' = dv,  dv' = da        (variational equation),

R_x the derivatives of rho along the motion that was simulated; all parameters are integrated at once:

    (R_a + h/2 R_v + h^2/4 R_q) dv_next = (R_a - h/2 R_v - h^2/4 R_q) dv - h (R_q dq + R_theta),
    dq_next = dq + h/2 (dv + dv_next)                                                              (trapezoidal rule).

A joint that sticks does not move: its dv is 0 and its dq stays, until it slides again. Sticking begins and ends at zero
velocity, so that dq and dv are continuous there.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import casadi as ca
import numpy as np

from armdyn.arm.arm import Arm
from armdyn.arm.closed_loop.play import has_play, plays
from armdyn.arm.closed_loop.rollout import SimulatedWindow, SimulationWindow, drive_inputs
from armdyn.arm.closed_loop.simulator import UNLIMITED_TORQUE, DriveInputs, drive_law, model_without_values
from armdyn.arm.model import ArmModel
from armdyn.arm.physics import DriveCommands
from armdyn.arm.symbolic import rigid_torques, torques_added_by_effects
from armdyn.codegen import PreallocatedFunction, compile_functions
from armdyn.effects.effect import Effect

INPUTS = ("given", "q_cmd", "v_cmd", "limit", "on", "gain", "damping")
"""Inputs of a drive that may differ, in the order of those of `drive_law`; see `DriveInputs`."""
GRAVITY_DIFFERENCE = 1e-5
"""Change of an effect on the base in a difference quotient of gravity, in typical sizes."""
INPUT_DIFFERENCE = 1e-3
"""Change of the logarithm of a drive's gain, and of a delay, s, by which the drives' inputs are differentiated."""
MAX_STATE = 1e4
"""Position or velocity, rad or m, per s, beyond which a simulation has run away."""
SAMPLES_PER_CALL = 100
"""Number of samples of a motion in one call of a compiled function."""


def motion_slopes(
    model: ArmModel,
    theta: np.ndarray,
    motion: tuple[np.ndarray, np.ndarray],
    drives: DriveInputs,
    others: Sequence[DriveInputs],
    step: float,
    wanted: Sequence[int] | None = None,
) -> np.ndarray:
    """(n + 1, nj, k + m + 2 nj) derivatives of n + 1 simulated positions.

    They are those by the k wanted parameters, the changes of the motion under m other inputs of the drives, to first
    order in their difference, and the derivatives by the start positions and start velocities. Where a simulation has
    run away, they no longer change.

    Args:
        model: the arm with its effects.
        theta: (p,) parameters.
        motion: (n + 1, nj) simulated positions and velocities.
        drives: the drives over the n steps.
        others: slightly different inputs of the drives, such as those with another gain or delay.
        step: length of a step, s.
        wanted: indices of the k parameters; None means all.
    """
    columns = np.arange(len(theta)) if wanted is None else np.array(wanted, dtype=int)
    (q, v), n, size = motion, len(model.arm.joints), len(columns)
    count = len(q) - 1
    middle = [(part[1:] + part[:-1]) / 2.0 for part in (q, v)]
    away = ~(np.abs(np.hstack([q[1:], v[1:]])).max(axis=1) < MAX_STATE)
    if away.any():
        q, v = (np.where(np.abs(part) < MAX_STATE, part, 0.0) for part in (q, v))
        middle = [(part[1:] + part[:-1]) / 2.0 for part in (q, v)]
    sticks = (v[1:] == 0.0) | away[:, None]
    way = np.sign(v[1:])
    asked = drives.asked_at(*middle)
    total = drives.total + (np.cumsum(asked, axis=0) - asked) * step
    volts = np.zeros_like(asked) if drives.voltage is None else drives.voltage
    signals = np.hstack([*middle, np.diff(v, axis=0) / step, way, volts, total, *_inputs(drives)])
    links, by_links = model.arm.described.copy(), np.zeros((10 * n, len(theta)))
    for i, (change, derivatives) in model.changed_links(theta).items():
        links[i] += change
        by_links[10 * i : 10 * (i + 1)] = derivatives
    function = _compiled(model.arm, model.servo_joints, model.effects, model.names)
    found = _evaluated(function, signals, np.concatenate([links.ravel(), model.gravity_at(theta), theta]))
    by_q, by_v, by_a, of_links, of_gravity, of_theta, *rest = (part.reshape(count, n, -1) for part in found)
    by_total, asked_by_q, asked_by_v = (part[:, :, 0] for part in rest[:3])
    by_input, asked_by_input = rest[3 : 3 + len(INPUTS)], rest[3 + len(INPUTS) :]
    forces = np.zeros((count, n, size + len(others)))
    forces[:, :, :size] = of_theta[:, :, columns]
    for of, by in ((of_links, by_links[:, columns]), (of_gravity, _gravity_slopes(model, theta)[:, columns])):
        own = np.flatnonzero(by.any(axis=0))  # few parameters change links or the base
        forces[:, :, own] += of @ by[:, own]
    forces[:, :, size:] = _through_inputs(by_input, drives, others)
    integral = None
    if np.any(by_total):
        asked_more = np.zeros_like(forces)
        asked_more[:, :, size:] = _through_inputs(asked_by_input, drives, others)
        start = np.zeros((n, forces.shape[2]))
        for i, other in enumerate(others):
            start[:, size + i] = other.total - drives.total
        integral = _Integral(by_total, asked_by_q, asked_by_v, asked_more, start)
    return _integrated(by_q, by_v, by_a, forces, sticks, step, integral)


def _through_inputs(by_input: Sequence[np.ndarray], drives: DriveInputs, others: Sequence[DriveInputs]) -> np.ndarray:
    """(n, nj, m) changes of a torque under m other inputs, by its (n, nj, 1) derivatives by each of `INPUTS`."""
    found = np.zeros((*drives.given.shape, len(others)))
    for i, other in enumerate(others):
        for by, here, there in zip(by_input, _inputs(drives), _inputs(other), strict=True):
            found[:, :, i] += by[:, :, 0] * (there - here)
    return found


def _gravity_slopes(model: ArmModel, theta: np.ndarray) -> np.ndarray:
    """(3, p) difference quotients of the acceleration of free fall, which only effects on the base change."""
    found, at = np.zeros((3, len(theta))), model.gravity_at(theta)
    for i, p in enumerate(model.parameters.values()):
        if p.effect and not p.joint:
            changed = theta.copy()
            changed[i] += GRAVITY_DIFFERENCE * p.typical
            found[:, i] = (model.gravity_at(changed) - at) / (GRAVITY_DIFFERENCE * p.typical)
    return found


def _inputs(drives: DriveInputs) -> list[np.ndarray]:
    """(n, nj) inputs of the drives, in the order of `INPUTS`."""
    shape, limit = np.ones_like(drives.given), np.minimum(drives.limit, UNLIMITED_TORQUE)
    given = (drives.given, drives.q_cmd, drives.v_cmd, limit, drives.on)
    return [*given, drives.gain * shape, drives.damping * shape]


def _diagonal(values: np.ndarray) -> np.ndarray:
    """(m, n, n) diagonal matrices of (m, n) values."""
    return values[:, :, None] * np.eye(values.shape[1])


def _evaluated(function: PreallocatedFunction, signals: np.ndarray, values: np.ndarray) -> list[np.ndarray]:
    """Outputs of a function of `SAMPLES_PER_CALL` samples for (m, s) signals, each (m, k), row-major."""
    found = [np.empty((len(signals), len(output))) for output in function.outputs]
    for begin in range(0, len(signals), SAMPLES_PER_CALL):
        part = signals[begin : begin + SAMPLES_PER_CALL]
        inputs = np.vstack([part, np.repeat(part[-1:], SAMPLES_PER_CALL - len(part), axis=0)]).T
        for whole, output in zip(found, function(inputs, values), strict=True):
            whole[begin : begin + len(part)] = output.T[: len(part)]
    return found


@dataclass(frozen=True, eq=False)
class _Integral:
    """Integral action.

    Attributes:
        by_total: (m, n) R_total.
        by_q: (m, n) derivatives of the torques that are asked of the drives by positions.
        by_v: (m, n) those by velocities.
        by_force: (m, n, k) those by forces.
        start: (n, k) those of the sums of these torques at the start.
    """

    by_total: np.ndarray
    by_q: np.ndarray
    by_v: np.ndarray
    by_force: np.ndarray
    start: np.ndarray


def _integrated(
    by_q: np.ndarray,
    by_v: np.ndarray,
    by_a: np.ndarray,
    forces: np.ndarray,
    sticks: np.ndarray,
    step: float,
    integral: _Integral | None,
) -> np.ndarray:
    """(m + 1, n, k + 2 n) changes of positions by (m, n, k) forces and by the start, by the equation of the module."""
    count, n, size = forces.shape
    slides = 1.0 - sticks.astype(float)
    half = step / 2.0 * by_v + step**2 / 4.0 * by_q
    implicit = (by_a + half) * slides[:, :, None] * slides[:, None, :] + _diagonal(1.0 - slides)
    regular = np.abs(np.linalg.det(implicit)) > 0.0  # impossible values may cancel an inertia
    slides *= regular[:, None]
    implicit[~regular] = np.eye(n)
    inverse = np.linalg.inv(implicit) * slides[:, :, None] * slides[:, None, :]
    unit, inertia, stiffness = np.eye(n), inverse @ (by_a - half), -step * (inverse @ by_q)
    push, middle = -step * (inverse @ forces), step / 2.0
    rows = [[unit + middle * stiffness, middle * (unit + inertia)], [stiffness, inertia]]  # of dq and dv
    pushes = [middle * push, push]
    if integral is not None:  # the change of the integral is a third state
        through = -step * (inverse @ _diagonal(integral.by_total))
        rows = [[*rows[0], middle * through], [*rows[1], through]]
        keeps = np.broadcast_to(unit, by_a.shape)
        rows.append([step * _diagonal(integral.by_q), step * _diagonal(integral.by_v), keeps])
        pushes.append(step * integral.by_force)
    following, states = np.block(rows), np.zeros((count + 1, len(rows) * n, size + 2 * n))
    states[0, : 2 * n, size:] = np.eye(2 * n)
    if integral is not None:
        states[0, 2 * n :, :size] = integral.start
    states[1:, :, :size] = np.concatenate(pushes, axis=1)
    for before, after, transition in zip(states[:-1], states[1:], following, strict=True):
        after += transition @ before
    return states[:, :n]


@lru_cache(maxsize=16)
def _compiled(
    arm: Arm, servo_joints: frozenset[str], effects: tuple[Effect, ...], names: tuple[str, ...]
) -> PreallocatedFunction:
    """``(signals, values) -> derivatives`` of rho for `SAMPLES_PER_CALL` samples, each a column, row-major."""
    one = _derivatives(model_without_values(arm, servo_joints, effects, names))
    name = f"slopes_{len(arm.joints)}"
    function = one.map(name, "serial", SAMPLES_PER_CALL, [1], [])  # the values are the same for all samples
    return PreallocatedFunction(compile_functions(name, {name: function})[name])


def _derivatives(model: ArmModel) -> ca.Function:
    n, size = len(model.arm.joints), len(model.names)
    q, v, a, way, volts, total = (ca.SX.sym(name, n) for name in ("q", "v", "a", "way", "volts", "total"))
    inputs = [ca.SX.sym(name, n) for name in INPUTS]
    v_cmd, on = inputs[INPUTS.index("v_cmd")], inputs[INPUTS.index("on")]
    links, gravity, theta = ca.SX.sym("links", 10 * n), ca.SX.sym("gravity", 3), ca.SX.sym("theta", size)
    _, asked = drive_law(inputs, q, v)
    told = [DriveCommands(asked[i], ca.SX(0), total[i], v_cmd[i], volts[i]) for i in range(n)]
    of_link = (ca.vertsplit(links, 10), gravity)
    load = rigid_torques(model.arm.model, *of_link, q, v, a)
    if has_play(model):
        link = q - ca.vertcat(*plays(model, theta)) * ca.sign(load)
        load = rigid_torques(model.arm.model, *of_link, link, v, a)
    live = ca.if_else(on > 0, 1, 0)
    added, sensor_gain, offset = torques_added_by_effects(model, (q, v, a), way, load, live, theta, told)
    rho = load + added - (asked - offset) / sensor_gain
    outputs = [ca.jacobian(rho, x) for x in (q, v, a, links, gravity, theta)]
    own = [(rho, total), (asked, q), (asked, v)]
    own += [(what, x) for what in (rho, asked) for x in inputs]
    outputs += [ca.vertcat(*(ca.jacobian(what[i], x[i]) for i in range(n))) for what, x in own]
    rows = [ca.densify(ca.vec(part.T)) for part in outputs]
    signals = ca.vertcat(q, v, a, way, volts, total, *inputs)
    return ca.Function("slopes", [signals, ca.vertcat(links, gravity, theta)], rows)


def window_slopes(
    model: ArmModel,
    others: Sequence[ArmModel],
    window: SimulationWindow,
    moved: SimulatedWindow,
    usual_step: float,
    wanted: Sequence[int] | None = None,
) -> np.ndarray:
    """(n, nj, k + m + 2 nj) derivatives of the simulated positions at the stamps of a window; see `motion_slopes`.

    Args:
        model: the arm with its effects.
        others: the same arm with slightly different drives or delays of commands.
        window: the window.
        moved: its simulated motion.
        usual_step: usual step of the integration, s; not shorter than that of the simulation.
        wanted: indices of the k parameters; None means all.
    """
    every = max(1, min(round(usual_step / float(moved.edges[1] - moved.edges[0])), len(moved.edges) - 1))
    edges, q, v = (part[::every] for part in (moved.edges, moved.q, moved.v))
    here, *there = (
        drive_inputs(one, one.theta(), window.run, [one.servo(joint) for joint in one.arm.joints], edges)
        for one in (model, *others)
    )
    slopes = motion_slopes(model, model.theta(), (q, v), here, there, float(edges[1] - edges[0]), wanted)
    return interpolate_rows(slopes, edges, window.time)


def interpolate_rows(values: np.ndarray, edges: np.ndarray, time: np.ndarray) -> np.ndarray:
    """(n, ...) linear interpolation at (n,) times of (m, ...) values at ascending `edges`; constant beyond them."""
    i = np.clip(np.searchsorted(edges, time, "right") - 1, 0, len(edges) - 2)
    share = np.clip((time - edges[i]) / (edges[i + 1] - edges[i]), 0.0, 1.0)
    share = share.reshape(-1, *(1,) * (values.ndim - 1))
    return np.asarray(values[i] * (1.0 - share) + values[i + 1] * share)
