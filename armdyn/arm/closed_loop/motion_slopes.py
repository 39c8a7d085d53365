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

from collections.abc import Iterator, Sequence
from functools import lru_cache

import casadi as ca
import numpy as np

from armdyn.arm.arm import Arm
from armdyn.arm.closed_loop.play import has_play, plays
from armdyn.arm.closed_loop.rollout import INTEGRAL_EFFECT, SimulatedWindow, SimulationWindow, drive_inputs
from armdyn.arm.closed_loop.simulator import DriveInputs, drive_law_function, model_without_values
from armdyn.arm.control_laws import DRIVE_SIGNALS, ControlLaw, DriveSignals
from armdyn.arm.model import ArmModel
from armdyn.arm.physics import DriveCommands
from armdyn.arm.symbolic import rigid_torques, torques_added_by_effects
from armdyn.codegen import PreallocatedFunction, compile_functions
from armdyn.effects.effect import Effect

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
) -> Iterator[tuple[int, np.ndarray]]:
    """First step of each stretch of m <= `SAMPLES_PER_CALL` steps, and (m + 1, nj, k + o + 2 nj) slopes at its edges.

    They are the derivatives of simulated positions by the k wanted parameters, the changes of the motion under o other
    inputs of the drives, to first order in their difference, and the derivatives by the start positions and start
    velocities. Where a simulation has run away, they no longer change. Whole recordings would not fit into a
    processor's cache, so the next stretch overwrites them.

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
    count, width = len(q) - 1, size + len(others)
    middle = [(part[1:] + part[:-1]) / 2.0 for part in (q, v)]
    away = ~(np.abs(np.hstack([q[1:], v[1:]])).max(axis=1) < MAX_STATE)
    if away.any():
        q, v = (np.where(np.abs(part) < MAX_STATE, part, 0.0) for part in (q, v))
        middle = [(part[1:] + part[:-1]) / 2.0 for part in (q, v)]
    slides = ((v[1:] != 0.0) & ~away[:, None]).astype(float)
    summed = drives.integrands(*middle)
    total = drives.total + (np.cumsum(summed, axis=0) - summed) * step
    *inputs, volts = drives.rows
    signals = np.hstack([*middle, np.diff(v, axis=0) / step, np.sign(v[1:]), volts, total, *inputs])
    changes = np.array([other.rows[:-1] for other in others]).reshape(-1, *np.shape(inputs)) - inputs
    links, of_changes = model.arm.described.copy(), np.zeros((10 * n, len(theta)))
    for i, (change, derivatives) in model.changed_links(theta).items():
        links[i] += change
        of_changes[10 * i : 10 * (i + 1)] = derivatives
    by_links, by_gravity = _nonzero(of_changes[:, columns]), _nonzero(_gravity_slopes(model, theta)[:, columns])
    function = _compiled(model.arm, model.servo_joints, model.effects, model.names, drives.laws)
    values = np.concatenate([links.ravel(), model.gravity_at(theta), theta])
    integrates = any(theta[i] != 0.0 for i, p in enumerate(model.parameters.values()) if p.effect == INTEGRAL_EFFECT)
    states = np.zeros((SAMPLES_PER_CALL + 1, (3 if integrates else 2) * n, width + 2 * n))
    states[0, : 2 * n, width:] = np.eye(2 * n)
    if integrates:  # the change of the integral is a third state
        for i, other in enumerate(others):
            states[0, 2 * n :, size + i] = other.total - drives.total
    forces, summed_more = np.zeros((2, SAMPLES_PER_CALL, n, width))
    for begin in range(0, count, SAMPLES_PER_CALL):
        part = slice(begin, min(begin + SAMPLES_PER_CALL, count))
        m = part.stop - begin
        found = _evaluated(function, signals[part], values)
        by_q, by_v, by_a, of_links, of_gravity, of_theta, by_total, summed_by_q, summed_by_v = (
            one.reshape(m, n, -1) for one in found[:9]
        )
        forces[:m, :, :size] = of_theta[:, :, columns]
        for of, (given, own) in ((of_links, by_links), (of_gravity, by_gravity)):
            forces[:m, :, own] += of @ given
        by_input, summed_by_input = np.split(np.array(found[9:]), 2)
        forces[:m, :, size:] = np.einsum("imj,oimj->mjo", by_input, changes[:, :, part])
        if integrates:
            summed_more[:m, :, size:] = np.einsum("imj,oimj->mjo", summed_by_input, changes[:, :, part])
        integral = (by_total, summed_by_q, summed_by_v, summed_more[:m]) if integrates else None
        following, pushes = _transitions((by_q, by_v, by_a), forces[:m], slides[part], step, integral)
        states[1 : m + 1, :, :width] = pushes
        states[1 : m + 1, :, width:] = 0.0
        for before, after, transition in zip(states[:m], states[1 : m + 1], following, strict=True):
            after += transition @ before
        yield begin, states[: m + 1, :n]
        states[0] = states[m]


def _nonzero(derivatives: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Columns that are not zero, and their indices: few parameters change links or the base."""
    own = np.flatnonzero(derivatives.any(axis=0))
    return derivatives[:, own], own


def _gravity_slopes(model: ArmModel, theta: np.ndarray) -> np.ndarray:
    """(3, p) difference quotients of the acceleration of free fall, which only effects on the base change."""
    found, at = np.zeros((3, len(theta))), model.gravity_at(theta)
    for i, p in enumerate(model.parameters.values()):
        if p.effect and not p.joint:
            changed = theta.copy()
            changed[i] += GRAVITY_DIFFERENCE * p.typical
            found[:, i] = (model.gravity_at(changed) - at) / (GRAVITY_DIFFERENCE * p.typical)
    return found


def _evaluated(function: PreallocatedFunction, signals: np.ndarray, values: np.ndarray) -> list[np.ndarray]:
    """Outputs of a function of `SAMPLES_PER_CALL` samples for (m, s) signals, each (m, k), row-major."""
    inputs = np.vstack([signals, np.repeat(signals[-1:], SAMPLES_PER_CALL - len(signals), axis=0)]).T
    return [output.T[: len(signals)] for output in function(inputs, values)]


def _diagonal(values: np.ndarray) -> np.ndarray:
    """(m, n, n) diagonal matrices of (m, n) or (m, n, 1) values."""
    return values.reshape(*values.shape[:2], 1) * np.eye(values.shape[1])


def _transitions(
    by_motion: tuple[np.ndarray, np.ndarray, np.ndarray],
    forces: np.ndarray,
    slides: np.ndarray,
    step: float,
    integral: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray] | None,
) -> tuple[np.ndarray, np.ndarray]:
    """(m, s, s) transitions and (m, s, k) pushes of the states' changes in m steps, by the equation of the module.

    Args:
        by_motion: (m, n, n) R_q, R_v and R_a.
        forces: (m, n, k) R_theta.
        slides: (m, n) 0 where a joint sticks, else 1.
        step: length of a step, s.
        integral: for integral action, (m, n, 1) R_total, derivatives of the laws' integrands by positions and by
            velocities, and (m, n, k) those by parameters.
    """
    (by_q, by_v, by_a), n = by_motion, forces.shape[1]
    half = step / 2.0 * by_v + step**2 / 4.0 * by_q
    moves = slides[:, :, None] * slides[:, None, :]
    implicit = (by_a + half) * moves + _diagonal(1.0 - slides)
    regular = np.abs(np.linalg.det(implicit)) > 0.0  # impossible values may cancel an inertia
    implicit[~regular] = np.eye(n)
    inverse = np.linalg.inv(implicit) * moves * regular[:, None, None]
    unit, inertia, stiffness = np.eye(n), inverse @ (by_a - half), -step * (inverse @ by_q)
    push, middle = -step * (inverse @ forces), step / 2.0
    rows = [[unit + middle * stiffness, middle * (unit + inertia)], [stiffness, inertia]]  # of dq and dv
    pushes = [middle * push, push]
    if integral is not None:
        by_total, summed_by_q, summed_by_v, summed_more = integral
        through = -step * (inverse @ _diagonal(by_total))
        rows = [[*rows[0], middle * through], [*rows[1], through]]
        rows.append([step * _diagonal(summed_by_q), step * _diagonal(summed_by_v), np.broadcast_to(unit, by_a.shape)])
        pushes.append(step * summed_more)
    return np.block(rows), np.concatenate(pushes, axis=1)


@lru_cache(maxsize=16)
def _compiled(
    arm: Arm,
    servo_joints: frozenset[str],
    effects: tuple[Effect, ...],
    names: tuple[str, ...],
    laws: tuple[ControlLaw, ...],
) -> PreallocatedFunction:
    """``(signals, values) -> derivatives`` of rho for `SAMPLES_PER_CALL` samples, each a column, row-major."""
    one = _derivatives(model_without_values(arm, servo_joints, effects, names), laws)
    name = f"slopes_{len(arm.joints)}"
    function = one.map(name, "serial", SAMPLES_PER_CALL, [1], [])  # the values are the same for all samples
    return PreallocatedFunction(compile_functions(name, {name: function})[name])


def _derivatives(model: ArmModel, laws: Sequence[ControlLaw]) -> ca.Function:
    n, size = len(model.arm.joints), len(model.names)
    q, v, a, way, volts, total = (ca.SX.sym(name, n) for name in ("q", "v", "a", "way", "volts", "total"))
    inputs = [ca.SX.sym(name, n) for name in DRIVE_SIGNALS]
    drive = DriveSignals(*inputs)
    links, gravity, theta = ca.SX.sym("links", 10 * n), ca.SX.sym("gravity", 3), ca.SX.sym("theta", size)
    *_, asked, summed = drive_law_function(laws)(*inputs, q, v)
    told = [DriveCommands(asked[i], ca.SX(0), total[i], drive.velocity[i], volts[i]) for i in range(n)]
    of_link = (ca.vertsplit(links, 10), gravity)
    load = rigid_torques(model.arm.model, *of_link, q, v, a)
    if has_play(model):
        link = q - ca.vertcat(*plays(model, theta)) * ca.sign(load)
        load = rigid_torques(model.arm.model, *of_link, link, v, a)
    live = ca.if_else(drive.share > 0, 1, 0)
    added, sensor_gain, offset = torques_added_by_effects(model, (q, v, a), way, load, live, theta, told)
    rho = load + added - (asked - offset) / sensor_gain
    outputs = [ca.jacobian(rho, x) for x in (q, v, a, links, gravity, theta)]
    own = [(rho, total), (summed, q), (summed, v)]
    own += [(what, x) for what in (rho, summed) for x in inputs]
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
    found, step, last = None, float(edges[1] - edges[0]), len(edges) - 1
    place = np.clip(np.searchsorted(edges, window.time, "right") - 1, 0, last - 1)
    for begin, states in motion_slopes(model, model.theta(), (q, v), here, there, step, wanted):
        inside = (place >= begin) & (place < begin + len(states) - 1)
        if found is None:
            found = np.empty((len(window.time), *states.shape[1:]))
        found[inside] = interpolate_rows(states, edges[begin : begin + len(states)], window.time[inside])
    assert found is not None
    return found


def interpolate_rows(values: np.ndarray, edges: np.ndarray, time: np.ndarray) -> np.ndarray:
    """(n, ...) linear interpolation at (n,) times of (m, ...) values at ascending `edges`; constant beyond them."""
    i = np.clip(np.searchsorted(edges, time, "right") - 1, 0, len(edges) - 2)
    share = np.clip((time - edges[i]) / (edges[i + 1] - edges[i]), 0.0, 1.0)
    share = share.reshape(-1, *(1,) * (values.ndim - 1))
    return np.asarray(values[i] * (1.0 - share) + values[i + 1] * share)
