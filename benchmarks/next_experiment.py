"""Does one designed motion separate rival models, does a random one, and is the predicted probability right?

    python benchmarks/next_experiment.py [--seeds N] [--first-seed N] [--processes N] [--what PAIRS] [--quick]
    python benchmarks/next_experiment.py --separations

Recordings come from `tests/worlds/pendulum.py`, which shares no code with armdyn: 8 s at 100 Hz, force noise
5 mN, load weighed to 1 %, string measured to 3 mm; `sensor_bias` and `sensor_delay` are unknowns of every model. In
each case one of two rivals is hidden. The first run is a random multisine; `next --rivals` designs the second one from
it, and beside it stands a random motion of the same peak acceleration. Both are recorded, and each is diagnosed
together with the first run, with the two rivals as the catalogue. Right is: one effect, no tie, and the hidden one.
"""

import json
import multiprocessing
import time
import zlib
from argparse import Namespace
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import _hidden_table as hidden_table
import _timing as bench
import numpy as np
from scipy.interpolate import make_interp_spline

from armdyn.effects.catalogue import CATALOGUE
from armdyn.experiments.gripper import GRIPPER_NODE_INTERVAL_SECONDS, GripperProblem, design_motion, motion_series
from armdyn.experiments.hypothesis import Hypothesis, PlannedExperiment
from armdyn.experiments.limits import GripperLimits
from armdyn.experiments.plan import ProposedExperiment, designed_motion, inseparable_pairs
from armdyn.experiments.rivals import Rivals, rivals_by_name
from armdyn.experiments.search import random_motion as any_motion
from armdyn.experiments.separation import expected_outcome
from armdyn.identify.diagnose import Diagnosis, diagnose
from armdyn.identify.studies import make_study
from armdyn.identify.study import Study
from armdyn.pendulum.model import PendulumModel, pendulum_model
from armdyn.pendulum.path import GripperPath
from armdyn.recording.units import KnownQuantity
from armdyn.run import Run

hidden_pendulum = hidden_table.generator("pendulum")

SIZES = {
    "pivot_viscous_friction": 7e-4, "linear_drag": 5e-3, "quadratic_drag": 5e-3, "pivot_coulomb_friction": 7e-4,
    "sensor_lag": 0.02, "gripper_lag": 0.02, "string_elasticity": 2e-3, "gripper_compliance": 5e-3, "wind": 0.01,
    "path_tilt": 0.01, "load_inertia": 4e-4, "string_mass": 5e-3, "gripper_scale": 0.03, "sensor_drift": 1e-3,
    "string_creep": 2e-4, "cross_axis_sensitivity": 0.02, "sensor_nonlinearity": 0.05, "sensor_gain": 0.03,
}  # fmt: skip
"""Usual sizes of the hidden effects [SI units]."""
PAIRS = (
    ("pivot_viscous_friction", "linear_drag"), ("linear_drag", "pivot_viscous_friction"),
    ("linear_drag", "quadratic_drag"), ("sensor_lag", "gripper_lag"),
    ("pivot_coulomb_friction", "pivot_viscous_friction"), ("string_elasticity", "gripper_compliance"),
    ("wind", "path_tilt"),
    ("gripper_lag", "sensor_lag"), ("quadratic_drag", "linear_drag"), ("quadratic_drag", "pivot_coulomb_friction"),
    ("pivot_viscous_friction", "pivot_coulomb_friction"), ("gripper_compliance", "string_elasticity"),
    ("gripper_scale", "load_inertia"), ("load_inertia", "gripper_scale"), ("string_creep", "sensor_drift"),
    ("path_tilt", "wind"), ("load_inertia", "string_mass"), ("string_mass", "load_inertia"),
)  # fmt: skip
"""Hidden effects with their rivals: first the pairs with a known result of a random search, then other ties."""
INSEPARABLE = ({"wind", "path_tilt"},)
"""Exact ties of a load cell, whatever the motion: a rotation of the frame. Inertia and a heavy string are one, too,
unless the load was weighed, as it was here."""
DURATION = 8.0
NUISANCE = {"sensor_bias.force": (0.0, 0.02), "sensor_delay.time": (0.0, 0.01)}
BINS = (0.0, 0.2, 0.5, 0.8, 0.95, 1.0001)
SURE = 0.95


def model() -> PendulumModel:
    found = pendulum_model(0.36, 0.08, [CATALOGUE["sensor_bias"], CATALOGUE["sensor_delay"]])
    for name, (mean, std) in NUISANCE.items():
        found = found.with_prior(name, mean, std)
    return found


def recorded(
    name: str, setup: object, motion: GripperPath | None, rng: np.random.Generator, known: dict[str, KnownQuantity]
) -> Run:
    """One run, along the generator's random motion if no motion is given."""
    if motion is None:
        run = hidden_pendulum.record(name, setup, rng)
    else:
        spline = make_interp_spline(motion.time, motion.x, k=5)
        parts = [spline, spline.derivative(1), spline.derivative(2)]

        def moved(t: np.ndarray | float) -> np.ndarray:
            inside = np.clip(t, 0.0, motion.time[-1])
            return np.array([part(inside) for part in parts])

        run = hidden_pendulum.record(name, setup, rng, moved)
    return replace(run, known=known)


def study_of(runs: list[Run], pair: tuple[str, str]) -> Study:
    return make_study(model(), runs, [], [CATALOGUE[name] for name in pair])


def right(found: Diagnosis, hidden: str) -> bool:
    added = [c.effect for c in found.search.last.effects if c not in found.search.steps[0].effects]
    return found.verdict.key == "effect_missing" and added == [hidden]


def random_motion(rivals: Rivals, proposal: ProposedExperiment, rng: np.random.Generator) -> GripperPath:
    """Random motion with the peak acceleration of the designed one, within the same limits."""
    assert proposal.experiment.motion is not None
    limits = GripperLimits(acceleration=float(proposal.experiment.motion.peaks[2]))
    problem = GripperProblem(
        rivals.hypotheses, proposal.experiment, motion_series(DURATION), limits, GRIPPER_NODE_INTERVAL_SECONDS
    )
    return problem.motion(any_motion(problem, rng))


def case(pair: tuple[str, str], seed: int) -> dict[str, object]:
    """Result for a pair of which the first effect is hidden."""
    hidden = pair[0]
    rng = np.random.default_rng([seed, zlib.crc32("/".join(pair).encode())])
    mass, length = 0.08 * (1 + 0.1 * rng.normal()), 0.368 * (1 + 0.05 * rng.normal())
    known = {
        "mass": KnownQuantity(mass * (1 + 0.01 * rng.normal()), 0.01 * mass, "kg"),
        "length": KnownQuantity(length + 3e-3 * rng.normal(), 3e-3, "m"),
    }
    setup = hidden_pendulum.Setup(
        length=length, mass=mass, hidden={hidden: SIZES[hidden]}, duration=DURATION, force_noise=5e-3, start=(0.0, 0.0)
    )
    first = recorded("first.csv", setup, None, rng, known)
    study = study_of([first], pair)
    begun = diagnose(study)
    rivals = rivals_by_name(study, pair)
    names = [h.name for h in rivals.hypotheses]
    started = time.process_time()
    proposal = designed_motion(rivals, DURATION, seed=seed)
    separable = set(pair) not in INSEPARABLE
    row: dict[str, object] = {
        "pair": "/".join(pair), "seed": seed, "verdict": begun.verdict.key, "first": right(begun, hidden),
        "cpu": time.process_time() - started, "separable": separable,
        "said": len(inseparable_pairs(rivals.hypotheses, proposal.expected, proposal.experiment)) == 1,
    }  # fmt: skip
    motion = random_motion(rivals, proposal, rng)
    for kind, foreseen in (
        ("designed", proposal.expected),
        ("random", expected_outcome(rivals.hypotheses, proposal.experiment.along_motion(motion))),
    ):
        made = proposal.experiment.motion if kind == "designed" else motion
        row[f"{kind}_predicted"] = float(foreseen.correct_decision_probability[names.index(hidden)])
        row[f"{kind}_separation"] = float(np.sqrt(foreseen.chi2_increase[names.index(hidden), 1 - names.index(hidden)]))
        if separable:
            after = diagnose(study_of([first, recorded(f"{kind}.csv", setup, made, rng, known)], pair))
            row[f"{kind}_right"], row[f"{kind}_verdict"] = right(after, hidden), after.verdict.key
    return row


def calibration(rows: list[dict[str, object]]) -> list[tuple[float, float, int, float, float]]:
    """Shares of right verdicts by bin of the predicted probability."""
    points = [
        (float(r[f"{k}_predicted"]), bool(r[f"{k}_right"]))
        for r in rows for k in ("designed", "random") if f"{k}_right" in r
    ]  # fmt: skip
    found = []
    for low, high in pairwise(BINS):
        inside = [(p, w) for p, w in points if low <= p < high]
        if inside:
            mean, share = np.mean([p for p, _ in inside]), np.mean([w for _, w in inside])
            found.append((low, high, len(inside), float(mean), float(share)))
    return found


def hypothesis(effect: str) -> Hypothesis:
    """Hypothesis of an effect of its size in `SIZES`, with a mass known to 1 % and priors of bias and delay."""
    found = pendulum_model(0.368, 0.08, [CATALOGUE[n] for n in (effect, "sensor_bias", "sensor_delay")])
    own = next(name for name, p in found.parameters.items() if p.effect == effect)
    found = found.with_values({own: SIZES[effect], "sensor_delay.time": 0.01})
    stds = {"mass": 8e-4, **{name: std for name, (_, std) in NUISANCE.items()}}
    free = ("length", "mass", own, *NUISANCE)
    return Hypothesis(effect, found, free, np.diag([stds.get(name, np.inf) ** -2.0 for name in free]))


def separations(pairs: list[tuple[str, str]]) -> list[dict[str, object]]:
    """Smaller rise of chi2 of the two directions: median of eight random motions, and the designed motion."""
    rows = []
    for pair in pairs:
        both = [hypothesis(name) for name in pair]
        cell = PlannedExperiment("motion", "", noise={"load_force": 5e-3})
        started = time.process_time()
        found, _ = design_motion(both, cell, DURATION)
        seconds = time.process_time() - started
        problem = GripperProblem(both, cell, motion_series(DURATION), GripperLimits(), GRIPPER_NODE_INTERVAL_SECONDS)
        rng = np.random.default_rng(1)
        at_random = []
        for _ in range(8):
            motion = problem.motion(any_motion(problem, rng))
            at_random.append(expected_outcome(both, cell.along_motion(motion)).separation ** 2)
        row = {
            "pair": "/".join(pair),
            "random": float(np.median(at_random)),
            "designed": expected_outcome(both, cell.along_motion(found)).separation ** 2,
            "cpu": seconds,
        }
        rows.append(row)
    bench.print_table(
        "Smallest rise of chi2 when the rival is refitted, without noise, nothing known from earlier runs",
        ["rivals", "random, median of 8", "designed", "design, CPU s"],
        [[r["pair"], f"{r['random']:.2g}", f"{r['designed']:.3g}", f"{r['cpu']:.1f}"] for r in rows],
    )
    return rows


def worked(job: tuple[tuple[str, str], int]) -> dict[str, object]:
    return case(*job)


def arguments() -> Namespace:
    parser = bench.arguments(__doc__.splitlines()[0], rounds=1, quick_rounds=1)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first-seed", type=int, default=2000)
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--what", help="pairs such as wind/path_tilt, separated by commas; all if not given")
    parser.add_argument("--separations", action="store_true", help="only the table of separations, without recordings")
    parser.add_argument("--progress", type=Path, metavar="FILE", help="append every case to this file as it ends")
    return parser.parse_args()


def main() -> int:
    options = arguments()
    wanted = PAIRS if options.what is None else [tuple(p.split("/")) for p in options.what.split(",")]
    pairs = PAIRS[:1] if options.quick else wanted
    if options.separations:
        distinct = {frozenset(pair): pair for pair in reversed(pairs)}
        return bench.conclude([], {"separations": separations(list(distinct.values())[::-1])}, options.json)
    seeds = range(options.first_seed, options.first_seed + (1 if options.quick else options.seeds))
    jobs = [(pair, seed) for seed in seeds for pair in pairs]
    rows: list[dict[str, object]] = []
    if options.processes > 1:
        with ProcessPoolExecutor(options.processes, mp_context=multiprocessing.get_context("spawn")) as pool:
            rows = list(pool.map(worked, jobs))
    else:
        for job in jobs:
            rows.append(worked(job))
            if options.progress is not None:
                with options.progress.open("a") as stream:
                    stream.write(json.dumps(rows[-1]) + "\n")
    return report(rows, options)


def report(rows: list[dict[str, object]], options: Namespace) -> int:
    """Print the results; 1 where a claim is missed."""
    table = []
    for name in dict.fromkeys(str(r["pair"]) for r in rows):
        mine = [r for r in rows if r["pair"] == name]
        tried = [r for r in mine if r["separable"]]
        table.append(
            [
                name, str(len(mine)), f"{sum(bool(r['first']) for r in mine)}/{len(mine)}",
                *(f"{sum(bool(r[f'{k}_right']) for r in tried)}/{len(tried)}" for k in ("designed", "random")),
                *(f"{np.median([float(r[f'{k}_separation']) for r in mine]):.1f}" for k in ("designed", "random")),
            ]
        )  # fmt: skip
    bench.print_table(
        "Verdict unique and right after the first run, and after one more motion of 8 s",
        ["hidden/rival", "cases", "first run", "designed", "random", "sep. designed", "sep. random"], table,
    )  # fmt: skip
    found = calibration(rows)
    bench.print_table(
        "Calibration of the predicted probability, designed and random motions",
        ["predicted", "cases", "mean", "right"],
        [
            [f"{low:.2f} to {min(high, 1.0):.2f}", str(n), f"{mean:.2f}", f"{share:.2f}"]
            for low, high, n, mean, share in found
        ],
    )
    tried = [r for r in rows if r["separable"]]
    sure = [r for r in tried if float(r["designed_predicted"]) >= SURE]
    wins = np.mean([bool(r["designed_right"]) for r in sure]) if sure else 0.0
    open_still = [r for r in tried if not r["first"]]
    random = np.mean([bool(r["random_right"]) for r in open_still]) if open_still else 0.0
    exact = [r for r in rows if not r["separable"]]
    said = np.mean([bool(r["said"]) for r in exact]) if exact else 0.0
    wrongly = sum(bool(r["said"]) for r in tried)
    off = max((abs(mean - share) for _, _, n, mean, share in found if n >= 10), default=0.0)
    judged = not options.quick
    claims = [
        bench.Claim(
            f"right after a designed motion where {SURE:.0%} is predicted, at least 95 %",
            f"{wins:.1%} of {len(sure)}", bool(wins >= 0.95) if judged and sure else None,
        ),
        bench.Claim(
            "right after a random motion of the same peak acceleration where the first run did not do, below 50 %",
            f"{random:.1%} of {len(open_still)}", bool(random < 0.5) if judged and open_still else None,
        ),
        bench.Claim(
            "predicted probability within 0.1 in every bin with 10 cases or more", f"{off:.2f} off",
            bool(off <= 0.1) if judged and tried else None,
        ),
        bench.Claim(
            "inseparable pairs said to be so, and no others", f"{said:.0%} of {len(exact)}, and {wrongly} others",
            bool(said == 1.0 and not wrongly) if judged and exact else None,
        ),
    ]  # fmt: skip
    if tried:
        print(f"\ndesign: {np.median([float(r['cpu']) for r in rows]):.1f} s of processor time (median)")
    return bench.conclude(claims, {"rows": rows, "calibration": found}, options.json)


if __name__ == "__main__":
    raise SystemExit(main())
