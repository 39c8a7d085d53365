r"""Simulate an arm with its effects: under given torques, or in closed loop with its servos.

The model gives the torques T(q, v, a) that a motion needs, with effects, and the reading R = gain T + offset of the
drives. Over a step h, with q' = q + h v/2 and v' = v + h a/2 at its middle, the equation of motion is

    (A + h/2 D + h^2/4 K) v_next + h F sign(v_next) = (A + h^2/4 K) v + h (u - T(q', v', 0) + D (v' - v/2)),
    q_next = q' + h v_next/2

with A = dT/da, D the derivative of T and of the drive's torque u by the joint's own velocity, K that of u by its
position, which are taken at the means of both velocities and positions, and F(q', v', load) the dry friction,
dT/dsign(v), of each direction. The scheme is of second
order where nothing sticks. At v_next = 0 friction takes any value up to F, so v_next is the minimum of a convex
function with kinks (Moreau, Unilateral Contact and Dry Friction in Finite Freedom Dynamics, 1988). It is found by
Newton's method for such functions (Hintermüller, Ito & Kunisch, SIAM J. Optim. 13, 2003), then by coordinate descent. A
joint at rest stays exactly at rest.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

from armdyn.arm.arm import Arm
from armdyn.arm.closed_loop.play import has_play, plays
from armdyn.arm.control_laws import DRIVE_SIGNALS, ControlLaw, DriveSignals, LawValue, over_joints
from armdyn.arm.drives import Servo
from armdyn.arm.model import ArmModel
from armdyn.arm.physics import DriveCommands, Expression
from armdyn.arm.symbolic import rigid_torques, torques_added_by_effects
from armdyn.codegen import PreallocatedFunction, compile_functions
from armdyn.effects.effect import Effect

ARM_STEPS_PER_CALL = 50
"""Number of integration steps of an arm's simulation in one call of a compiled function."""
SLIDING_NEWTON_STEPS = 3
"""Iterations that find which joints stick, and in which direction the others slide; the last one is hardly needed."""
COORDINATE_SWEEPS = 2
"""Sweeps of coordinate descent; the rest of a wrong iteration is then an error of the friction in one step."""


@dataclass(frozen=True, eq=False)
class DriveInputs:
    """Inputs of an arm's drives over n steps.

    Attributes:
        signals: what the drives are told, (n, nj) each.
        laws: law of each joint's drive; without a gain it gives what is fed forward.
        voltage: (n, nj) relative excess of supply voltages over those of the gains.
        total: (nj,) sums over time of the laws' integrands before the first step, N m s or N s, for integral action.
    """

    signals: DriveSignals
    laws: tuple[ControlLaw, ...]
    voltage: np.ndarray
    total: np.ndarray | float = 0.0

    def integrands(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """(n, nj) integrands of the laws in n steps, with (n, nj) positions and velocities in their middle."""
        return np.column_stack(over_joints(lambda law: law.integrand, self.laws, self.signals, q, v))

    @property
    def rows(self) -> list[np.ndarray]:
        """(n, nj) signals of compiled functions, which take no infinite limit; then the voltage."""
        told = self.signals
        return [*replace(told, limit=np.minimum(told.limit, UNLIMITED_TORQUE)).all, self.voltage]

    @classmethod
    def off(cls, count: int, laws: Sequence[ControlLaw]) -> "DriveInputs":
        """Inputs over `count` steps of drives that are off, in new arrays that may be changed."""
        signals = {name: np.zeros((count, len(laws))) for name in DRIVE_SIGNALS}
        signals["limit"] += np.inf
        return cls(DriveSignals(**signals), tuple(laws), np.zeros((count, len(laws))))


def simulate_arm(
    model: ArmModel, theta: np.ndarray, start: tuple[np.ndarray, np.ndarray], drives: DriveInputs, step: float
) -> tuple[np.ndarray, np.ndarray]:
    """Simulate the motion of an arm from a start state.

    Args:
        model: the arm with its effects.
        theta: (p,) parameters.
        start: (nj,) positions and (nj,) velocities.
        drives: the drives over n steps.
        step: length of a step, s; vibrations that are faster do not grow, and are not resolved.

    Returns:
        (n + 1, nj) positions and velocities, the start first.

    Raises:
        InputError: an effect depends on time or has states of its own.
    """
    count, joints = drives.voltage.shape
    function = _compiled(model.arm, model.servo_joints, model.effects, model.names, drives.laws)
    links = model.arm.described.copy()
    for i, (change, _) in model.changed_links(theta).items():
        links[i] += change
    gravity = model.gravity_at(theta)
    values = np.concatenate([links.ravel(), gravity, theta, [step]])
    rows = np.hstack(drives.rows)
    state = np.concatenate([*start, np.zeros(joints), np.zeros(joints) + drives.total])
    found = np.empty((count + 1, len(state)))
    inputs = np.zeros((rows.shape[1], ARM_STEPS_PER_CALL), order="F")  # as the function has it
    inputs[:] = rows[:1].T
    # The first step is made twice, because the acceleration before it is unknown.
    state[2 * joints : 3 * joints] = function(state, inputs, values)[0][2 * joints : 3 * joints, 0]
    found[0] = state
    for begin in range(0, count, ARM_STEPS_PER_CALL):
        part = rows[begin : begin + ARM_STEPS_PER_CALL]
        inputs[:, : len(part)] = part.T
        inputs[:, len(part) :] = part[-1:].T
        states = function(state, inputs, values)[0]
        found[begin + 1 : begin + 1 + len(part)] = states.T[: len(part)]
        state = found[begin + len(part)]
    return found[:, :joints], found[:, joints : 2 * joints]


UNLIMITED_TORQUE = 1e30
"""Limit that no torque reaches, N m or N."""


@lru_cache(maxsize=16)
def _compiled(
    arm: Arm,
    servo_joints: frozenset[str],
    effects: tuple[Effect, ...],
    names: tuple[str, ...],
    laws: tuple[ControlLaw, ...],
) -> PreallocatedFunction:
    """``(state, inputs, p) -> states`` of `ARM_STEPS_PER_CALL` steps."""
    step = _step(model_without_values(arm, servo_joints, effects, names), laws)
    name = f"arm_{len(arm.joints)}_steps"
    block = step.mapaccum(name, ARM_STEPS_PER_CALL)
    s, w = ca.MX.sym("s", step.size1_in(0)), ca.MX.sym("w", step.size1_in(1), ARM_STEPS_PER_CALL)
    p = ca.MX.sym("p", step.size1_in(2))
    whole = ca.Function(name, [s, w, p], [block(s, w, ca.repmat(p, 1, ARM_STEPS_PER_CALL))])
    return PreallocatedFunction(compile_functions(name, {name: whole})[name])


def drive_law_function(laws: Sequence[ControlLaw]) -> ca.Function:
    """``(*signals, q, v)`` to (n,) torques without limit, their slopes, torques and integrands; see `ControlLaw`.

    The slopes are those by position and velocity, with the other sign.
    """
    q, v, *told = (ca.SX.sym(name, len(laws)) for name in ("q", "v", *DRIVE_SIGNALS))
    values: list[LawValue] = [lambda law: law.unlimited_torque, lambda law: law.torque, lambda law: law.integrand]
    wanted, torque, integrand = (ca.vertcat(*over_joints(one, laws, DriveSignals(*told), q, v)) for one in values)
    slopes = [-ca.vertcat(*(ca.jacobian(wanted[i], x[i]) for i in range(len(laws)))) for x in (q, v)]
    found = ca.cse([wanted, *map(ca.densify, slopes), torque, integrand])
    return ca.Function("drive_law", [*told, q, v], found)


def model_without_values(
    arm: Arm, servo_joints: frozenset[str], effects: tuple[Effect, ...], names: tuple[str, ...]
) -> ArmModel:
    """A model with drives on some joints, for functions whose inputs are its values and those of the drives."""
    nameless: Any = dict.fromkeys(names)
    return ArmModel(effects, nameless, arm, {"": Servo(tuple(servo_joints))})


def _step(model: ArmModel, laws: Sequence[ControlLaw]) -> ca.Function:
    """``(state, inputs, p) -> state`` of one step.

    The state is q, v, the mean acceleration of the last step, and the sum of the laws' integrands, for integral action.
    """
    n, size = len(model.arm.joints), len(model.names)
    state, inputs = ca.SX.sym("x", 4 * n), ca.SX.sym("w", (len(DRIVE_SIGNALS) + 1) * n)
    p = ca.SX.sym("p", 10 * n + 4 + size)
    q, v, last, total = (state[i * n : (i + 1) * n] for i in range(4))
    *signals, volts = ca.vertsplit(inputs, n)
    drive = DriveSignals(*signals)
    links, ends = ca.vertsplit(p[: 10 * n], 10), np.cumsum([0, 3, size, 1]).tolist()
    gravity, theta, h = ca.vertsplit(p[10 * n :], ends)
    qm, vm = q + h / 2 * v, v + h / 2 * last
    qs, vs, a, way, load, live = (ca.SX.sym(name, n) for name in ("qs", "vs", "a", "way", "load", "live"))
    rigid = rigid_torques(model.arm.model, links, gravity, qs, vs, a)
    mass = ca.jacobian(rigid, a)
    told = [ca.SX.sym(name, n) for name in ("asked", "total", "told_v", "volts")]
    drives = [DriveCommands(told[0][i], ca.SX(0), *(part[i] for part in told[1:])) for i in range(n)]
    added, sensor_gain, offset = torques_added_by_effects(model, (qs, vs, a), way, load, live, theta, drives)
    by_a, zero = ca.jacobian(added, a), ca.SX.zeros(n)
    still = ca.substitute(added, a, zero)
    free = ca.substitute(still, way, zero)
    forwards, backwards = (ca.substitute(still, way, sign * ca.SX.ones(n)) for sign in (1, -1))
    own = ca.vertcat(*(ca.jacobian(free[i], vs[i]) + ca.jacobian(offset[i], vs[i]) / sensor_gain[i] for i in range(n)))
    bias = ca.substitute(rigid, a, zero)
    parts = ca.Function(
        "parts",
        [qs, vs, load, live, *told, p],
        [by_a, free, forwards - free, free - backwards, own, sensor_gain, offset],
    )
    rigid_parts, needed = ca.Function("rigid", [qs, vs, p], [mass, bias]), ca.Function("needed", [qs, vs, p], [bias])
    M, b = rigid_parts(qm, vm, p)
    asks = b + M @ last
    if has_play(model):  # the links are where their loads push them
        b = needed(qm - ca.vertcat(*plays(model, theta)) * ca.sign(asks), vm, p)
    wanted, stiffness, damping, asked, integrand = drive_law_function(laws)(*signals, qm, vm)
    within = drive.share * (ca.fabs(wanted) < drive.limit)
    live = ca.if_else(drive.share > 0, 1, 0)
    more, free, up, down, own, sensor_gain, offset = parts(qm, vm, asks, live, asked, total, drive.velocity, volts, p)
    u = (asked - offset) / sensor_gain
    D, K = own + within * damping / sensor_gain, within * stiffness / sensor_gain
    A = M + more + ca.diag(h**2 / 4 * K)
    H = A + ca.diag(h / 2 * D)
    r = A @ v + h * (u - b - free + D * (vm - v / 2))
    v_next = _sliding(H, r, h * up, h * down, v)
    stops = v_next == 0
    a_next = ca.if_else(stops, 0, (v_next - v) / h)
    following = ca.vertcat(qm + h / 2 * v_next, v_next, a_next, total + h * integrand)
    return ca.Function("step", [state, inputs, p], [ca.densify(following)])


def _sliding(H: Expression, r: Expression, up: Expression, down: Expression, v: Expression) -> Expression:
    """(n,) v for which r - H v is the friction: `up` where v > 0, -`down` where v < 0, between them where v = 0.

    H is (n, n), positive definite; `up` and `down` are (n,), not negative; the search begins at `v`.
    """
    n = r.numel()
    diagonal = ca.diag(H)
    for _ in range(SLIDING_NEWTON_STEPS):
        push = r - H @ v + diagonal * v
        moves = ca.logic_or(push > up, push < -down)
        friction = ca.if_else(push > up, up, -down)
        keep = ca.if_else(moves, 1, 0)
        masked = H * (keep @ keep.T)
        for i in range(n):
            masked[i, i] = ca.if_else(moves[i], H[i, i], 1)
        v = ca.ldl_solve(keep * (r - friction), *ca.ldl(masked, False))  # without pivots: H is positive definite
    for _ in range(COORDINATE_SWEEPS):
        for i in range(n):
            push = r[i] - H[i, :] @ v + H[i, i] * v[i]
            v[i] = (ca.fmax(push - up[i], 0) + ca.fmin(push + down[i], 0)) / H[i, i]
    return v
