"""Problem TA for crocoddyl's FDDP; dynamics and derivatives are CasADi functions, called through their buffers."""

from collections.abc import Callable

import casadi as ca
import crocoddyl
import numpy as np
from _problem_ta import DT, STEPS, Staged

from armdyn.codegen import PreallocatedFunction, compile_functions

MOST_ITERATIONS = 200

Data = crocoddyl.ActionDataAbstract
Evaluation = Callable[[Data, np.ndarray, np.ndarray | None], None]


def fddp(staged: Staged) -> Callable[[], tuple[float, int]]:
    """Function that solves the problem from rest and returns the cost and the number of iterations."""
    n = len(staged.initial)
    s, u = ca.SX.sym("s", n), ca.SX.sym("u")
    following, cost = staged.step(s, u), staged.end(s)
    hessian, slope = ca.hessian(cost, s)
    built = compile_functions(
        "benchmark_fddp",
        {
            "step": ca.Function("step", [s, u], [following]),
            "linearised": ca.Function(
                "linearised", [s, u], [ca.densify(ca.jacobian(following, z)) for z in (s, u)]
            ),
            "end": ca.Function("end", [s], [cost]),
            "expansion": ca.Function("expansion", [s], [ca.densify(slope), ca.densify(hessian)]),
        },
    )  # fmt: skip
    step, linearised, end, expansion = (
        PreallocatedFunction(built[k]) for k in ("step", "linearised", "end", "expansion")
    )

    def calc(data: Data, x: np.ndarray, a: np.ndarray | None) -> None:
        if a is not None:
            data.xnext = step(x, a)[0].ravel()
            data.cost = DT / 2 * a[0] ** 2

    def calc_diff(data: Data, x: np.ndarray, a: np.ndarray | None) -> None:
        if a is not None:
            data.Fx, data.Fu = linearised(x, a)
            data.Lu, data.Luu = DT * a, np.array([[DT]])

    def calc_end(data: Data, x: np.ndarray, _: np.ndarray | None) -> None:
        data.cost = end(x)[0][0, 0]

    def calc_diff_end(data: Data, x: np.ndarray, _: np.ndarray | None) -> None:
        gradient, data.Lxx = expansion(x)
        data.Lx = gradient.ravel()

    running = _action(n, 1, calc, calc_diff)
    initial = np.array(staged.initial)
    solver = crocoddyl.SolverFDDP(
        crocoddyl.ShootingProblem(initial, [running] * STEPS, _action(n, 0, calc_end, calc_diff_end))
    )
    states, controls = [initial] * (STEPS + 1), [np.zeros(1)] * STEPS

    def solve() -> tuple[float, int]:
        solver.solve(states, controls, MOST_ITERATIONS, True)
        return solver.cost, solver.iter

    return solve


def _action(states: int, controls: int, calc: Evaluation, calc_diff: Evaluation) -> crocoddyl.ActionModelAbstract:
    methods = {
        "calc": lambda _self, data, x, u=None: calc(data, x, u),
        "calcDiff": lambda _self, data, x, u=None: calc_diff(data, x, u),
    }
    kind = type("Action", (crocoddyl.ActionModelAbstract,), methods)
    return kind(crocoddyl.StateVector(states), controls)
