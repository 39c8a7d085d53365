r"""Problem TA: swing a load on a string up to a point, as nonlinear programs without armdyn's code.

A load of m = 0.1 kg on l = 0.368 m hangs at rest; over N = 500 steps of dt = 0.01 s the gripper's acceleration a_k
minimises

    J = 1/2 1e4 (x_N + .45)^2 + 1/2 1e4 (z_N + .248)^2 + 1/2 1e3 |v_N|^2 + sum dt/2 a_k^2

either on the midpoint variational model, v_N = (q_N - q_{N-1})/dt,

    m (q_{k+1} - 2 q_k + q_{k-1})/dt + dt m g e_z + 2 lambda_k (q_k - g_k) = 0,    |q_{k+1} - g_{k+1}| = l,

or on Runge-Kutta steps of (x, v, phi, phi') with the acceleration held over each.
"""

from dataclasses import dataclass

import casadi as ca

LENGTH, MASS, GRAVITY, DT, STEPS = 0.368, 0.1, 9.81, 0.01, 500
TARGET = (-0.45, -0.248)
POSITION_WEIGHT, VELOCITY_WEIGHT = 1e4, 1e3
BEST_VARIATIONAL, BEST_RUNGE_KUTTA = 0.515326192, 0.515467631
"""Least costs of the two discretisations; on the second one IPOPT, fatrop and FDDP agree to 1e-9."""


@dataclass(frozen=True)
class Staged:
    """Optimal control problem in stages.

    Attributes:
        step: dynamics of a stage, ``(s, u) -> s_next``.
        end: cost of the last state, ``s -> ()``.
        initial: state at rest.
        best: the least cost.
    """

    step: ca.Function
    end: ca.Function
    initial: tuple[float, ...]
    best: float


@dataclass(frozen=True)
class Program:
    """A nonlinear program with equality constraints.

    Attributes:
        nlp: the program in the form that `casadi.nlpsol` accepts.
        guess: start values of the unknowns: everything at rest.
        best: the least cost.
    """

    nlp: dict[str, ca.MX | ca.SX]
    guess: list[float]
    best: float


def end_cost(position: ca.SX, velocity: ca.SX) -> ca.SX:
    """Cost of the load's last position and velocity, (2,) each."""
    return POSITION_WEIGHT / 2 * ca.sumsqr(position - ca.DM(TARGET)) + VELOCITY_WEIGHT / 2 * ca.sumsqr(velocity)


def runge_kutta() -> Staged:
    """Problem TA discretised by Runge-Kutta steps, with states x, v, phi, phi'."""
    s, u = ca.SX.sym("s", 4), ca.SX.sym("u")

    def rate(s: ca.SX) -> ca.SX:
        return ca.vertcat(s[1], u, s[3], (u * ca.cos(s[2]) - GRAVITY * ca.sin(s[2])) / LENGTH)

    k1 = rate(s)
    k2 = rate(s + DT / 2 * k1)
    k3 = rate(s + DT / 2 * k2)
    k4 = rate(s + DT * k3)
    x, v, phi, phi_dot = ca.vertsplit(s)
    position = ca.vertcat(x - LENGTH * ca.sin(phi), -LENGTH * ca.cos(phi))
    velocity = ca.vertcat(v - LENGTH * ca.cos(phi) * phi_dot, LENGTH * ca.sin(phi) * phi_dot)
    return Staged(
        step=ca.Function("step", [s, u], [s + DT / 6 * (k1 + 2 * k2 + 2 * k3 + k4)]),
        end=ca.Function("end", [s], [end_cost(position, velocity)]),
        initial=(0.0, 0.0, 0.0, 0.0),
        best=BEST_RUNGE_KUTTA,
    )


def variational() -> Staged:
    """State x, (x - x_before)/dt, phi, (phi - phi_before)/dt.

    The multiplier is the root of a quadratic equation, so a step needs no iteration: with the free flight r seen from
    the next gripper position and the string's direction d, |r - mu d| = l.
    """
    s, u = ca.SX.sym("s", 4), ca.SX.sym("u")
    x, v, phi, rate = ca.vertsplit(s)
    direction = ca.vertcat(-ca.sin(phi), -ca.cos(phi))
    before = phi - DT * rate
    q = ca.vertcat(x, 0) + LENGTH * direction
    q_before = ca.vertcat(x - DT * v - LENGTH * ca.sin(before), -LENGTH * ca.cos(before))
    v_next = v + DT * u
    x_next = x + DT * v_next
    r = 2 * q - q_before - ca.vertcat(x_next, DT**2 * GRAVITY)
    along = ca.dot(r, direction)
    string = r - (along - ca.sqrt(along**2 - ca.sumsqr(r) + LENGTH**2)) * direction
    phi_next = ca.atan2(-string[0], -string[1])
    return Staged(
        step=ca.Function("step", [s, u], [ca.vertcat(x_next, v_next, phi_next, (phi_next - phi) / DT)]),
        end=ca.Function("end", [s], [end_cost(q, (q - q_before) / DT)]),
        initial=(0.0, 0.0, 0.0, 0.0),
        best=BEST_VARIATIONAL,
    )


def flat(staged: Staged) -> Program:
    """Program with all stages written out in scalar operations, the fastest form for CasADi's virtual machine."""
    n = len(staged.initial)
    states = [ca.SX.sym(f"s{k}", n) for k in range(STEPS + 1)]
    controls = [ca.SX.sym(f"u{k}") for k in range(STEPS)]
    gaps = [states[k + 1] - staged.step(states[k], controls[k]) for k in range(STEPS)]
    unknowns = [part for k in range(STEPS) for part in (states[k], controls[k])]
    return Program(
        {
            "x": ca.vertcat(*unknowns, states[-1]),
            "f": DT / 2 * ca.sumsqr(ca.vertcat(*controls)) + staged.end(states[-1]),
            "g": ca.vertcat(gaps[0], states[0] - ca.DM(staged.initial), *gaps[1:]),
        },
        [*[*staged.initial, 0.0] * STEPS, *staged.initial],
        staged.best,
    )


def mapped(staged: Staged) -> Program:
    """The same program with loops over the stages, a form whose C code compiles in seconds."""
    n = len(staged.initial)
    w = ca.MX.sym("w", STEPS * (n + 1) + n)
    stages, last = ca.reshape(w[: STEPS * (n + 1)], n + 1, STEPS), w[STEPS * (n + 1) :]
    states, controls = stages[:n, :], stages[n, :]
    gaps = ca.horzcat(states[:, 1:], last) - staged.step.map(STEPS)(states, controls)
    return Program(
        {
            "x": w,
            "f": DT / 2 * ca.sumsqr(controls) + staged.end(last),
            "g": ca.vertcat(gaps[:, 0], states[:, 0] - ca.DM(staged.initial), ca.vec(gaps[:, 1:])),
        },
        [*[*staged.initial, 0.0] * STEPS, *staged.initial],
        staged.best,
    )


def as_stated() -> Program:
    """Variational problem in Cartesian positions, with unknown multipliers that start from their values at rest."""
    gripper, load = [ca.SX(0), ca.SX(0)], [ca.SX([0, -LENGTH])] * 2
    unknowns, residuals, guess, effort = [], [], [], 0
    weight = ca.vertcat(0, DT * MASS * GRAVITY)
    for k in range(STEPS):
        multiplier, x, q = ca.SX.sym(f"lambda{k}"), ca.SX.sym(f"x{k + 1}"), ca.SX.sym(f"q{k + 1}", 2)
        pull = 2 * multiplier * (load[-1] - ca.vertcat(gripper[-1], 0))
        residuals += [
            MASS * (q - 2 * load[-1] + load[-2]) / DT + weight + pull,
            ca.sumsqr(q - ca.vertcat(x, 0)) - LENGTH**2,
        ]
        effort += DT / 2 * ((x - 2 * gripper[-1] + gripper[-2]) / DT**2) ** 2
        unknowns += [multiplier, x, q]
        guess += [MASS * GRAVITY * DT / (2 * LENGTH), 0.0, 0.0, -LENGTH]
        gripper.append(x)
        load.append(q)
    cost = effort + end_cost(load[-1], (load[-1] - load[-2]) / DT)
    return Program({"x": ca.vertcat(*unknowns), "f": cost, "g": ca.vertcat(*residuals)}, guess, BEST_VARIATIONAL)
