"""Cost of the gripper's accelerations over the horizon of sequential action control (SAC), with its exact derivative.

For the formulas see `armdyn.control.sac`. The extended state is integrated forwards by the Runge-Kutta method, with the
Gram matrix of the signals where the objective has one, and the adjoint state backwards (reverse differentiation of the
discretised cost).
"""

from functools import lru_cache

import casadi as ca

from armdyn.codegen import PreallocatedFunction, compile_functions
from armdyn.control.questions import MotionObjective
from armdyn.pendulum.dynamics import PLANAR_STATE_SIZE, PendulumDynamics
from armdyn.physics.simulate import runge_kutta_step

SAC_WEIGHTS = ("information_floor", "position_weight", "velocity_weight", "barrier_weight", "barrier")
"""Names of the settings of sequential action control on which its cost depends, in the order of the arguments."""


@lru_cache(maxsize=16)
def horizon_functions(
    dynamics: tuple[PendulumDynamics, ...], name: str, question: MotionObjective, steps: int, dt: float
) -> tuple[PreallocatedFunction, PreallocatedFunction]:
    """Compile the cost over the horizon, and the cost with its gradient, of a schedule of accelerations.

    Both are functions of (schedule, extended state, time, theta, weights, scales, gram).

    Args:
        dynamics: equations of the model, or of both rival models.
        name: identifier of the equations, for the cache of compiled code.
        question: objective of the motion.
        steps: number of steps of the horizon.
        dt: length of a step, s.
    """
    watched = question.differentiated_parameters
    extended_size = 2 + sum(PLANAR_STATE_SIZE * (1 + len(names)) for names in watched)
    sizes = [len(d.names) for d in dynamics]
    z, u, t = ca.SX.sym("z", extended_size), ca.SX.sym("u"), ca.SX.sym("t")
    theta, weights = ca.SX.sym("theta", sum(sizes)), ca.SX.sym("weights", len(SAC_WEIGHTS))
    scales = ca.SX.sym("scales", len(question.parameters) + 1)
    x, v = z[0], z[1]
    w = ca.vertcat(t, x, v, u, ca.SX(3, 1))

    rates, readings, slopes = [v, u], [], []
    at, first = 2, 0
    for d, names, size in zip(dynamics, watched, sizes, strict=True):
        own = theta[first : first + size]
        pendulum = z[at : at + PLANAR_STATE_SIZE]
        psi = ca.reshape(
            z[at + PLANAR_STATE_SIZE : at + PLANAR_STATE_SIZE * (1 + len(names))], PLANAR_STATE_SIZE, len(names)
        )
        columns = [d.names.index(parameter) for parameter in names]

        def derivative(
            expression: ca.SX, *, state: ca.SX = pendulum, by: ca.SX = psi, of: ca.SX = own, places: list[int] = columns
        ) -> ca.SX:
            """Total derivative with respect to the watched parameters."""
            if not places:
                return ca.SX(expression.numel(), 0)
            along = ca.jtimes(expression, state, by) if len(places) == 1 else ca.jacobian(expression, state) @ by
            return along + ca.jacobian(expression, of)[:, places]

        rate = d.derivative(pendulum, w, own)
        rates += [rate, ca.vec(derivative(rate))]
        reading = d.output(pendulum, w, own)[0] if question.logarithmic else d.tension(pendulum, w, own)
        readings.append(reading)
        slopes.append(derivative(reading))
        at, first = at + PLANAR_STATE_SIZE * (1 + len(names)), first + size
    extended = ca.Function("extended", [z, u, t, theta], [ca.vertcat(*rates)])
    following = runge_kutta_step(lambda z, t: extended(z, u, t, theta), z, (t, t + dt / 2, t + dt), dt)

    floor, w_x, w_v, w_b, barrier = ca.vertsplit(weights)
    running = w_x * x**2 + w_v * v**2 + w_b * ca.fmax(0, ca.fabs(x) - barrier) ** 2
    signals = question.signals(readings, slopes, scales)
    if not question.logarithmic:  # judged at each moment: no information is summed over the horizon
        running += floor**2 / (signals**2 + floor**2)
        signals = ca.SX(0, 1)
    size = signals.numel()
    cost, gram, slope = ca.SX.sym("J"), ca.SX.sym("gram", size, size), ca.SX.sym("F", size, size)
    effective = running + ca.dot(slope, signals @ signals.T)
    given = [u, t, theta, weights, scales]
    stage = ca.Function(
        "stage", [z, cost, gram, *given], [following, cost + dt * running, gram + dt * signals @ signals.T]
    )
    costate = ca.SX.sym("co", extended_size)
    back = ca.Function(
        "back",
        [costate, z, *given, slope],
        [
            ca.densify(ca.jtimes(following, z, costate, True) + dt * ca.gradient(effective, z)),
            ca.jtimes(following, u, costate, True) + dt * ca.gradient(effective, u),
        ],
    )
    schedule, start, now = ca.MX.sym("u", steps), ca.MX.sym("z0", extended_size), ca.MX.sym("t0")
    known = [ca.MX.sym("known", symbol.numel()) for symbol in (theta, weights, scales)]
    gathered = ca.MX.sym("gram", size, size)
    times = now + dt * ca.DM(range(steps)).T
    repeated = [ca.repmat(symbol, 1, steps) for symbol in known]
    states, costs, grams = stage.mapaccum("ahead", steps, 3)(start, 0, gathered, schedule.T, times, *repeated)
    value, effect = question.criterion_function()(grams[:, size * (steps - 1) :])
    before, flip = ca.horzcat(start, states[:, :-1]), ca.Slice(steps - 1, -(steps + 1), -1)
    backwards = [before[:, flip], schedule.T[:, flip], times[:, flip], *repeated, ca.repmat(effect, 1, steps)]
    _, gradient = back.mapaccum("behind", steps)(ca.MX.zeros(extended_size), *backwards)
    arguments, total = [schedule, start, now, *known, gathered], costs[-1] + value
    built = compile_functions(
        f"sac_{name}{question.cache_key}",
        {
            "cost": ca.Function("cost", arguments, [total]),
            "gradient": ca.Function("gradient", arguments, [total, gradient[:, flip].T]),
        },
    )
    return PreallocatedFunction(built["cost"]), PreallocatedFunction(built["gradient"])
