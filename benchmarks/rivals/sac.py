"""One cycle of sequential action control against plain numpy, and its gradient against finite differences.

    python benchmarks/rivals/sac.py [--quick] [--rounds N] [--json FILE]

The rival computes the same discretised cost and the same actions from hand-written equations and derivatives.
"""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parents[1]))
import _timing as bench  # isort: skip

from functools import cache

import numpy as np
from _numpy_sac import NumpyControl
from _pendulum import Pendulum

from armdyn.control.questions import MotionObjective, information_objective, separation_objective
from armdyn.control.sac import SacAction, SacSettings, SacState, SequentialActionControl
from armdyn.effects.catalogue import CATALOGUE
from armdyn.pendulum.model import PendulumModel, pendulum_model

LENGTH, MASS = 0.368, 0.08
OURS, OURS_VM, RIVAL = "armdyn", "armdyn, no C compiler", "plain numpy"
THREE, TWO = "armdyn, three parameters", "armdyn, two rivals"
STATES = 16
SAME = 1e-9
"""Largest relative difference of the two implementations' costs, gradients and actions."""
CHANGE, FINITE_DIFFERENCE = 1e-4, 1e-6
"""Change of central differences [m/s^2], and their largest error over the largest entry of the gradient."""


@cache
def armdyn_control() -> tuple[SequentialActionControl, PendulumModel, list[SacState]]:
    model = pendulum_model(LENGTH, MASS)
    return SequentialActionControl(model), model, situations()


def situations() -> list[SacState]:
    """States of a trial: the gripper within 0.19 m of the middle, the load within 0.4 rad of the vertical."""
    rng = np.random.default_rng(0)
    pendulum = Pendulum(LENGTH, MASS)
    states = []
    for _ in range(STATES):
        x, v = rng.uniform(-0.19, 0.19), rng.uniform(-0.3, 0.3)
        angle, rate = rng.uniform(-0.4, 0.4), rng.uniform(-1.5, 1.5)
        swing = np.array([angle, pendulum.momentum(angle, rate, v)])
        states.append(SacState(0.0, x, v, swing, rng.normal(size=2) * [0.5, 0.02]))
    return states


def armdyn_once() -> float:
    """Seconds of one cycle from each state, as a function that another process can call by its name."""
    control, model, states = armdyn_control()
    return bench.timed(lambda: [control.act(state, model) for state in states])() / len(states)


@cache
def several() -> tuple[SequentialActionControl, list[SacState], PendulumModel]:
    """Controller, states and model for length, mass and drag at once, each with the others unknown."""
    model = pendulum_model(LENGTH, MASS, [CATALOGUE["linear_drag"]]).with_values({"linear_drag.coefficient": 0.005})
    question = information_objective(("length", "mass", "linear_drag.coefficient"))
    return SequentialActionControl(model, question=question), informed(question), model


@cache
def rivals() -> tuple[SequentialActionControl, list[SacState], PendulumModel, PendulumModel]:
    """Controller, states and models that separate drag from friction at the upper end, with unknown length and mass."""
    drag = pendulum_model(LENGTH, MASS, [CATALOGUE["linear_drag"]]).with_values({"linear_drag.coefficient": 0.005})
    name = "pivot_viscous_friction.coefficient"
    pivot = pendulum_model(LENGTH, MASS, [CATALOGUE["pivot_viscous_friction"]]).with_values({name: 7e-4})
    question = separation_objective(("length", "mass", name))
    return SequentialActionControl(drag, question=question, rival=pivot), informed(question), drag, pivot


def informed(question: MotionObjective) -> list[SacState]:
    """The same states after a few seconds, with the information that the motion has given by then."""
    rng, states = np.random.default_rng(3), []
    for state in situations():
        psi = rng.normal(size=(2, len(question.parameters))) * [[0.5], [0.02]]
        root = 10.0 * rng.normal(size=(question.signal_count, question.signal_count))
        gram = root @ root.T + 100.0 * np.eye(question.signal_count)
        at = (state.time, state.x, state.v, state.pendulum)
        if question.rivals:
            states.append(SacState(*at, np.zeros((2, 0)), 1.02 * state.pendulum, psi, gram))
        else:
            states.append(SacState(*at, psi, gram=gram))
    return states


def several_once() -> float:
    """Seconds of one cycle for three parameters."""
    control, states, model = several()
    return bench.timed(lambda: [control.act(state, model) for state in states])() / len(states)


def rivals_once() -> float:
    """Seconds of one cycle for two rival models."""
    control, states, drag, pivot = rivals()
    return bench.timed(lambda: [control.act(state, drag, pivot) for state in states])() / len(states)


def cost_and_gradient(
    control: SequentialActionControl, schedule: np.ndarray, state: SacState, model: PendulumModel
) -> tuple[float, np.ndarray]:
    """Cost of a schedule (steps,) of accelerations, and its gradient (steps,)."""
    cost, gradient = control._gradient(schedule, *control._fixed(state, model, None))
    return float(cost[0, 0]), gradient.ravel().copy()


def difference(ours: np.ndarray | float, other: np.ndarray | float) -> float:
    """Largest difference, relative to the largest entry."""
    return float(np.max(np.abs(np.subtract(ours, other))) / np.max(np.abs(other)))


def disagreement(rival: NumpyControl) -> dict[str, float]:
    """Largest relative differences between the implementations over all states."""
    control, model, states = armdyn_control()
    rng = np.random.default_rng(1)
    worst = {"cost": 0.0, "gradient": 0.0, "action": 0.0}
    for state in states:
        schedule = rng.uniform(-1.0, 1.0, control.settings.steps)
        (cost, slope), (cost2, slope2) = (
            cost_and_gradient(control, schedule, state, model),
            rival.gradient(schedule, state.vector()),
        )
        action: SacAction = control.act(state, model)
        size, start, end, accelerations, _ = rival.act(state.vector())
        ours = np.array([action.acceleration, action.start, action.end, *action.schedule])
        found = {
            "cost": difference(cost, cost2),
            "gradient": difference(slope, slope2),
            "action": difference(ours, np.array([size, start, end, *accelerations])),
        }
        worst = {name: max(value, found[name]) for name, value in worst.items()}
    return worst


def finite_difference_error(states: int) -> float:
    """Largest error of the gradient over some states and random schedules."""
    control, model, situations = armdyn_control()
    rng = np.random.default_rng(2)
    worst = 0.0
    for state in situations[:states]:
        schedule = rng.uniform(-1.0, 1.0, control.settings.steps)
        exact = cost_and_gradient(control, schedule, state, model)[1]
        ends = (
            [
                cost_and_gradient(control, schedule + sign * step, state, model)[0]
                for step in CHANGE * np.eye(len(exact))
            ]
            for sign in (1.0, -1.0)
        )
        numeric = np.subtract(*ends) / (2 * CHANGE)
        worst = max(worst, difference(exact, numeric))
    return worst


def main() -> int:
    options = bench.arguments(__doc__.splitlines()[0], rounds=61, quick_rounds=5).parse_args()
    rounds = bench.rounds_of(options)
    _, _, states = armdyn_control()
    settings = SacSettings()
    rival = NumpyControl(LENGTH, MASS, settings)
    vectors = [state.vector() for state in states]
    differences, gradient_error = disagreement(rival), finite_difference_error(2 if options.quick else STATES)
    with bench.without_compiler() as elsewhere:
        seconds = bench.race(
            {
                OURS: armdyn_once,
                THREE: several_once,
                TWO: rivals_once,
                OURS_VM: elsewhere(armdyn_once),
                RIVAL: lambda: bench.timed(lambda: [rival.act(vector) for vector in vectors])() / len(vectors),
            },
            rounds,
        )
    ratios = {name: bench.ratio(seconds, name, OURS) for name in seconds}
    bench.print_table(
        f"One SAC cycle, {settings.steps} steps of {settings.dt:g} s, {STATES} states, {rounds} rounds",
        ["implementation", "cycle ms", "cycle / armdyn"],
        [[name, bench.milliseconds(seconds[name]), str(ratios[name])] for name in seconds],
    )
    found = ", ".join(f"{name} {value:.0e}" for name, value in differences.items())
    claims = [
        bench.Claim(f"same cost, gradient and action to {SAME:g}", found, max(differences.values()) <= SAME),
        bench.Claim(
            f"gradient within {FINITE_DIFFERENCE:g} of finite differences",
            f"{gradient_error:.0e}",
            gradient_error <= FINITE_DIFFERENCE,
        ),
    ]
    rows = [{"implementation": k, "seconds": seconds[k], "ratio_to_armdyn": ratios[k]} for k in seconds]
    return bench.conclude(
        claims, {"rows": rows, "differences": differences, "gradient_error": gradient_error}, options.json
    )


if __name__ == "__main__":
    raise SystemExit(main())
