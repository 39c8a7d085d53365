"""The swing optimiser on problem TA against IPOPT, fatrop and crocoddyl's FDDP.

    python benchmarks/rivals/task_optimizer.py [--quick] [--rounds N] [--json FILE]

Construction is not counted in the solve time and is printed beside it. crocoddyl takes part where it is installed.
"""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parents[1]))
import _timing as bench  # isort: skip

import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import chdir, contextmanager
from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from time import perf_counter
from typing import Any

import _problem_ta as problem
import casadi as ca
import numpy as np

from armdyn.codegen import find_compiler
from armdyn.control.task import SwingPlan, TaskCost, TaskPlanner
from armdyn.pendulum.model import pendulum_model

OURS, OURS_VM = "armdyn", "armdyn, no C compiler"
COST_TOLERANCE = 1e-6
LARGEST_SHARE_OF_FATROP = 0.7


@dataclass(frozen=True)
class Answer:
    """Result of a solver: cost, iterations, and the least cost that is known."""

    cost: float
    iterations: int
    best: float


@dataclass(frozen=True)
class Solver:
    """Prepared solver: duration of the preparation [s], and the function that solves."""

    construction: float
    solve: Callable[[], Answer]


@dataclass(frozen=True)
class Outcome:
    """Results and times of the comparison by solver."""

    answers: dict[str, Answer]
    construction: dict[str, float]
    seconds: dict[str, np.ndarray]


@cache
def armdyn_solver() -> Solver:
    started = perf_counter()
    model = pendulum_model(problem.LENGTH, problem.MASS)
    planner = TaskPlanner(model, problem.STEPS, problem.DT)
    construction = perf_counter() - started
    weights = (problem.POSITION_WEIGHT, problem.POSITION_WEIGHT), (problem.VELOCITY_WEIGHT, problem.VELOCITY_WEIGHT)
    cost = TaskCost(problem.TARGET, position_weights=weights[0], velocity_weights=weights[1], control_weight=1.0)

    def solve() -> Answer:
        plan: SwingPlan = planner.plan(model, cost)
        return Answer(plan.solution.cost, len(plan.solution.iterations), problem.BEST_VARIATIONAL)

    return Solver(construction, solve)


def armdyn_once() -> float:
    """Seconds of one solution by armdyn, as a function that another process can call by its name."""
    return bench.timed(armdyn_solver().solve)()


def nlp_solver(state: Callable[[], problem.Program], plugin: str, options: Mapping[str, Any]) -> Solver:
    """Solver of a program by IPOPT or fatrop."""
    started = perf_counter()
    program = state()
    settings = {"print_time": False, **options}
    if plugin == "fatrop":
        settings |= {"structure_detection": "auto", "equality": [True] * program.nlp["g"].numel()}
        settings["fatrop"] = {"print_level": 0}
    else:
        settings["ipopt"] = {"print_level": 0, "sb": "yes"}
    solver = ca.nlpsol("solver", plugin, program.nlp, settings)
    construction = perf_counter() - started
    guess = ca.DM(program.guess)

    def solve() -> Answer:
        solution = solver(x0=guess, lbg=0, ubg=0)
        return Answer(float(solution["f"]), solver.stats()["iter_count"], program.best)

    return Solver(construction, solve)


@contextmanager
def machine_code() -> Iterator[dict[str, Any]]:
    """Options with which CasADi translates a solver's functions to C and compiles them for this machine.

    CasADi writes the files where the program stands, and removes them when the solver goes; so it stands elsewhere.
    """
    flags = ["-O3", "-march=native", "-ffast-math"]
    with tempfile.TemporaryDirectory() as scratch, chdir(scratch):
        yield {
            "jit": True,
            "jit_cleanup": False,
            "compiler": "shell",
            "jit_options": {"flags": flags, "cleanup": False},
        }


def rivals(code: Mapping[str, Any] | None) -> dict[str, Solver]:
    """Prepared rivals by name; those in C only where `code` gives the options."""
    midpoint, zero_order = problem.variational(), problem.runge_kutta()
    ready = {
        "IPOPT, as stated": nlp_solver(problem.as_stated, "ipopt", {}),
        "IPOPT, variational": nlp_solver(lambda: problem.flat(midpoint), "ipopt", {}),
        "IPOPT, RK4": nlp_solver(lambda: problem.flat(zero_order), "ipopt", {}),
        "fatrop, variational": nlp_solver(lambda: problem.flat(midpoint), "fatrop", {}),
        "fatrop, RK4": nlp_solver(lambda: problem.flat(zero_order), "fatrop", {}),
    }
    if code is not None:
        ready |= {
            "IPOPT, variational, C": nlp_solver(lambda: problem.mapped(midpoint), "ipopt", code),
            "fatrop, variational, C": nlp_solver(lambda: problem.mapped(midpoint), "fatrop", code),
            "fatrop, RK4, C": nlp_solver(lambda: problem.mapped(zero_order), "fatrop", code),
        }
    if find_spec("crocoddyl") is None:
        print("crocoddyl is not installed: FDDP is left out (pip install 'armdyn[bench]')")
        return ready
    from _fddp import fddp

    for name, staged in (("FDDP, variational", midpoint), ("FDDP, RK4", zero_order)):
        started = perf_counter()
        solve = fddp(staged)
        ready[name] = Solver(perf_counter() - started, lambda solve=solve, best=staged.best: Answer(*solve(), best))
    return ready


def run(rounds: int, in_c: bool) -> Outcome:
    solvers = {OURS: armdyn_solver()}
    if in_c:
        with machine_code() as code:
            solvers |= rivals(code)
    else:
        solvers |= rivals(None)
    answers = {name: solver.solve() for name, solver in solvers.items()}
    with bench.without_compiler() as elsewhere:
        contenders = {name: bench.timed(solver.solve) for name, solver in solvers.items()}
        seconds = bench.race({**contenders, OURS_VM: elsewhere(armdyn_once)}, rounds)
    construction = {name: solver.construction for name, solver in solvers.items()}
    return Outcome({**answers, OURS_VM: answers[OURS]}, construction, seconds)


def main() -> int:
    options = bench.arguments(__doc__.splitlines()[0], rounds=41, quick_rounds=3).parse_args()
    rounds = bench.rounds_of(options)
    outcome = run(rounds, in_c=not options.quick and find_compiler() is not None)
    ratios = {name: bench.ratio(outcome.seconds, name, OURS) for name in outcome.seconds}
    order = sorted(ratios, key=lambda name: ratios[name].median)
    headings = ["solver", "iterations", "cost - best", "construction s", "solve ms", "solve / armdyn"]
    rows, records = [], []
    for name in order:
        answer, construction = outcome.answers[name], outcome.construction.get(name)
        rows.append(
            [
                name,
                str(answer.iterations),
                f"{answer.cost - answer.best:+.1e}",
                "" if construction is None else f"{construction:.2f}",
                bench.milliseconds(outcome.seconds[name]),
                str(ratios[name]),
            ]
        )
        records.append(
            {
                "solver": name,
                "iterations": answer.iterations,
                "cost": answer.cost,
                "best_cost": answer.best,
                "construction_seconds": construction,
                "seconds": outcome.seconds[name],
                "ratio_to_armdyn": ratios[name],
            }
        )
    bench.print_table(f"Problem TA, {rounds} rounds", headings, rows)
    stated = claims(outcome.answers, outcome.seconds, options.quick)
    return bench.conclude(stated, {"problem": "TA", "rows": records}, options.json)


def claims(answers: Mapping[str, Answer], seconds: Mapping[str, np.ndarray], quick: bool) -> list[bench.Claim]:
    off = abs(answers[OURS].cost - answers[OURS].best)
    fastest = min((name for name in seconds if name.startswith("fatrop")), key=lambda name: np.median(seconds[name]))
    stated = [bench.Claim(f"cost within {COST_TOLERANCE:g} of the optimum", f"{off:.1e}", off <= COST_TOLERANCE)]
    for name in dict.fromkeys(["fatrop, RK4", fastest]):
        share = bench.ratio(seconds, OURS, name)
        stated.append(
            bench.Claim(
                f"solve time at most {LARGEST_SHARE_OF_FATROP:g} of {name}",
                str(share),
                None if quick else share.median <= LARGEST_SHARE_OF_FATROP,
            )
        )
    return stated


if __name__ == "__main__":
    raise SystemExit(main())
