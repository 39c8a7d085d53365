"""The cost of a schedule of accelerations over SAC's horizon, and its exact derivative; see `sac` for the formulas.

The extended state runs ahead by the Runge-Kutta method, with the Gram matrix of the signals where the question has one,
and its costate back (reverse differentiation of the discretised cost).
"""

from functools import lru_cache

import casadi as ca

from armdyn.codegen import Buffered, compiled
from armdyn.control.questions import Question
from armdyn.pendulum.dynamics import STATE_SIZE, Dynamics

WEIGHTS = ("information_floor", "position_weight", "velocity_weight", "barrier_weight", "barrier")
"""Settings of SAC that the cost takes, in this order."""


@lru_cache(maxsize=16)
def horizon_functions(
    dynamics: tuple[Dynamics, ...], name: str, question: Question, steps: int, dt: float
) -> tuple[Buffered, Buffered]:
    """Cost, and cost with gradient, of (schedule, extended state, time, theta, weights), and of (scales, gram)."""
    watched = question.watched
    extended_size = 2 + sum(STATE_SIZE * (1 + len(names)) for names in watched)
    sizes = [len(d.names) for d in dynamics]
    z, u, t = ca.SX.sym("z", extended_size), ca.SX.sym("u"), ca.SX.sym("t")
    theta, weights = ca.SX.sym("theta", sum(sizes)), ca.SX.sym("weights", len(WEIGHTS))
    scales = ca.SX.sym("scales", len(question.parameters) + 1)
    x, v = z[0], z[1]
    w = ca.vertcat(t, x, v, u, ca.SX(3, 1))

    rates, readings, slopes = [v, u], [], []
    at, first = 2, 0
    for d, names, size in zip(dynamics, watched, sizes, strict=True):
        own = theta[first : first + size]
        pendulum = z[at : at + STATE_SIZE]
        psi = ca.reshape(z[at + STATE_SIZE : at + STATE_SIZE * (1 + len(names))], STATE_SIZE, len(names))
        columns = [d.names.index(parameter) for parameter in names]

        def derivative(
            expression: ca.SX, *, state: ca.SX = pendulum, by: ca.SX = psi, of: ca.SX = own, places: list[int] = columns
        ) -> ca.SX:
            """Total derivative with respect to the parameters that are watched."""
            if not places:
                return ca.SX(expression.numel(), 0)
            if len(places) == 1:
                return ca.jtimes(expression, state, by) + ca.jacobian(expression, of)[:, places[0]]
            return ca.jacobian(expression, state) @ by + ca.jacobian(expression, of)[:, places]

        rate = d.derivative(pendulum, w, own)
        rates += [rate, ca.vec(derivative(rate))]
        reading = d.output(pendulum, w, own)[0] if question.logarithmic else d.tension(pendulum, w, own)
        readings.append(reading)
        slopes.append(derivative(reading))
        at, first = at + STATE_SIZE * (1 + len(names)), first + size
    extended = ca.Function("extended", [z, u, t, theta], [ca.vertcat(*rates)])
    k1 = extended(z, u, t, theta)
    k2 = extended(z + dt / 2 * k1, u, t + dt / 2, theta)
    k3 = extended(z + dt / 2 * k2, u, t + dt / 2, theta)
    k4 = extended(z + dt * k3, u, t + dt, theta)
    following = z + dt / 6 * (k1 + 2 * k2 + 2 * k3 + k4)

    floor, w_x, w_v, w_b, barrier = ca.vertsplit(weights)
    running = w_x * x**2 + w_v * v**2 + w_b * ca.fmax(0, ca.fabs(x) - barrier) ** 2
    signals = question.signals(readings, slopes, scales)
    if not question.logarithmic:
        running = floor**2 / (signals**2 + floor**2) + running
    J, F = ca.SX.sym("J"), ca.SX.sym("F", signals.numel(), signals.numel())
    gained = dt * signals @ signals.T
    effective = running + ca.dot(F, signals @ signals.T) if question.logarithmic else running
    given = [u, t, theta, weights, scales]
    gram = ca.SX.sym("gram", signals.numel(), signals.numel())
    co = ca.SX.sym("co", extended_size)
    if question.logarithmic:
        stage = ca.Function("stage", [z, J, gram, *given], [following, J + dt * running, gram + gained])
    else:
        stage = ca.Function("stage", [z, J, u, t, theta, weights], [following, J + dt * running])
    behind_given = [u, t, theta, weights, scales, F] if question.logarithmic else [u, t, theta, weights]
    back = ca.Function(
        "back",
        [co, z, *behind_given],
        [
            ca.densify(ca.jtimes(following, z, co, True) + dt * ca.gradient(effective, z)),
            ca.jtimes(following, u, co, True) + dt * ca.gradient(effective, u),
        ],
    )
    behind = back.mapaccum("behind", steps)
    U, z0, t0 = ca.MX.sym("u", steps), ca.MX.sym("z0", extended_size), ca.MX.sym("t0")
    P, W = ca.MX.sym("theta", sum(sizes)), ca.MX.sym("weights", len(WEIGHTS))
    T = t0 + dt * ca.DM(range(steps)).T
    flip = ca.Slice(steps - 1, -(steps + 1), -1)
    repeated = [ca.repmat(P, 1, steps), ca.repmat(W, 1, steps)]
    arguments = [U, z0, t0, P, W]
    if question.logarithmic:
        S, G0 = ca.MX.sym("scales", scales.numel()), ca.MX.sym("gram", *gram.shape)
        arguments += [S, G0]
        repeated.append(ca.repmat(S, 1, steps))
        Z, costs, grams = stage.mapaccum("ahead", steps, 3)(z0, 0, G0, U.T, T, *repeated)
        size = signals.numel()
        value, slope = question.criterion_function()(grams[:, -size:])
        cost = costs[-1] + value
        repeated.append(ca.repmat(slope, 1, steps))
    else:
        Z, costs = stage.mapaccum("ahead", steps, 2)(z0, 0, U.T, T, *repeated)
        cost = costs[-1]
    before = ca.horzcat(z0, Z[:, :-1])
    last = [ca.MX.zeros(extended_size), before[:, flip], U.T[:, flip], T[:, flip], *repeated]
    _, gradient = behind(*last)
    built = compiled(
        f"sac_{name}{question.tag}",
        {
            "cost": ca.Function("cost", arguments, [cost]),
            "gradient": ca.Function("gradient", arguments, [cost, gradient[:, flip].T]),
        },
    )
    return Buffered(built["cost"]), Buffered(built["gradient"])
