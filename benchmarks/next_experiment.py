"""Does one designed motion tell rivals apart, does a random one, and is the predicted probability right?

    python benchmarks/next_experiment.py [--seeds N] [--first-seed N] [--processes N] [--what EFFECTS] [--quick]

Recordings come from `tests/hidden_effects/pendulum.py`, which shares no code with armdyn: 100 Hz, force noise 5 mN, load
weighed to 1 %, string measured to 3 mm; `sensor_bias` and `sensor_delay` are unknowns of every model. The first run is a
random multisine of 4 s. Where `diagnose`, with the whole catalogue, calls a tie, `next` designs a second one of 8 s for
all that tie; beside it stands a random motion of the same peak acceleration. Both are recorded, and each is diagnosed
together with the first run. Right is: one effect, without a tie, and the hidden one.
"""

import multiprocessing
import time
import zlib
from argparse import Namespace
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from itertools import pairwise

# First, because it keeps numpy to one thread.
import _hidden_table as hidden_table
import _timing as bench
import numpy as np
from scipy.interpolate import make_interp_spline

from armdyn.effects.catalogue import CATALOGUE
from armdyn.experiments.design import within_swing
from armdyn.experiments.hypothesis import Held
from armdyn.experiments.motion import Harmonics, Limits, Motion
from armdyn.experiments.plan import Proposal, designed_motion
from armdyn.experiments.rivals import Rivals, of_diagnosis
from armdyn.experiments.separation import outlook
from armdyn.identify.diagnose import Diagnosis, diagnose
from armdyn.identify.study import Study
from armdyn.pendulum.model import PendulumModel, pendulum_model
from armdyn.run import Run
from armdyn.units import Known

hidden_pendulum = hidden_table.generator("pendulum")

SIZES = {
    "pivot_viscous_friction": 1e-3, "linear_drag": 5e-3, "quadratic_drag": 1e-2, "pivot_coulomb_friction": 1e-3,
    "sensor_lag": 0.02, "gripper_lag": 0.03, "string_elasticity": 2e-3, "gripper_compliance": 5e-3, "wind": 0.01,
    "path_tilt": 0.02, "load_inertia": 4e-4, "string_mass": 5e-3, "gripper_scale": 0.03, "sensor_gain": 0.03,
    "string_creep": 2e-4,
}  # fmt: skip
"""As large as is usual, or less."""
INSEPARABLE = ({"wind", "path_tilt"}, {"load_inertia", "string_mass"})
"""Exact ties of a load cell, whatever the motion: a rotation of the frame, and inertia about the pivot."""
DURATION, FIRST = 8.0, 4.0
"""s; of the second run, and of the first, which is short so that there are ties."""
NUISANCE = {"sensor_bias.force": (0.0, 0.02), "sensor_delay.time": (0.0, 0.01)}
BINS = (0.0, 0.2, 0.5, 0.8, 0.95, 1.0001)
SURE = 0.95


def model() -> PendulumModel:
    found = pendulum_model(0.36, 0.08, [CATALOGUE["sensor_bias"], CATALOGUE["sensor_delay"]])
    for name, (mean, std) in NUISANCE.items():
        found = found.with_prior(name, mean, std)
    return found


def recorded(name: str, setup: object, motion: Motion | None, rng: np.random.Generator, known: dict[str, Known]) -> Run:
    """One run; along the generator's own random motion where none is given."""
    if motion is None:
        run = hidden_pendulum.record(name, setup, rng)
    else:
        spline = make_interp_spline(motion.time, motion.along[0], k=5)
        parts = [spline, spline.derivative(1), spline.derivative(2)]

        def moved(t: np.ndarray | float) -> np.ndarray:
            inside = np.clip(t, 0.0, motion.time[-1])
            return np.array([part(inside) for part in parts])

        given, hidden_pendulum.gripper_motion = hidden_pendulum.gripper_motion, lambda _rng, _duration: moved
        try:
            run = hidden_pendulum.record(name, setup, rng)
        finally:
            hidden_pendulum.gripper_motion = given
    return replace(run, known=known)


def diagnosed(runs: list[Run]) -> tuple[Study, Diagnosis]:
    pendulum = [e for e in CATALOGUE.values() if e.acts_on != "joint" and e.name not in ("sensor_bias", "sensor_delay")]
    study = Study(model(), runs, [], pendulum)
    return study, diagnose(study)


def right(found: Diagnosis, hidden: str) -> bool:
    added = [c.effect for c in found.search.last.effects if c not in found.search.steps[0].effects]
    return found.verdict.key == "effect_missing" and added == [hidden]


def random_motion(rivals: Rivals, designed: Proposal, rng: np.random.Generator) -> Motion:
    """With the peak acceleration of the designed one, within the same limits."""
    assert designed.experiment.motion is not None
    limits = Limits(acceleration=float(designed.experiment.motion.peaks[2]))
    harmonics = Harmonics(DURATION, limits)
    helds = [Held(h, designed.experiment) for h in rivals.hypotheses]
    return harmonics.motion(within_swing(helds, harmonics, harmonics.random(rng)))


def case(hidden: str, seed: int) -> dict[str, object]:
    """One hidden effect, one seed."""
    rng = np.random.default_rng([seed, zlib.crc32(hidden.encode())])
    mass, length = 0.08 * (1 + 0.1 * rng.normal()), 0.368 * (1 + 0.05 * rng.normal())
    known = {
        "mass": Known(mass * (1 + 0.01 * rng.normal()), 0.01 * mass, "kg"),
        "length": Known(length + 3e-3 * rng.normal(), 3e-3, "m"),
    }
    setup = hidden_pendulum.Setup(
        length=length, mass=mass, hidden={hidden: SIZES[hidden]}, duration=FIRST, force_noise=5e-3
    )
    setup = replace(setup, start=(0.0, 0.0))
    first = recorded("first.csv", setup, None, rng, known)
    setup = replace(setup, duration=DURATION)
    study, found = diagnosed([first])
    row: dict[str, object] = {
        "hidden": hidden,
        "seed": seed,
        "verdict": found.verdict.key,
        "first": right(found, hidden),
    }
    rivals = of_diagnosis(study, found)
    if rivals is None:
        return row
    names = [h.name for h in rivals.hypotheses]
    row["rivals"] = names
    started = time.process_time()
    proposal = designed_motion(rivals, DURATION, seed=seed)
    row["cpu"] = time.process_time() - started
    separable = not any({hidden, other} in INSEPARABLE for other in names)
    row["separable"] = separable
    row["said_inseparable"] = bool(np.any((proposal.outlook.rises + proposal.outlook.rises.T < 1.0).sum(axis=1) > 1))
    motion = random_motion(rivals, proposal, rng)
    for kind, foreseen in (
        ("designed", proposal.outlook),
        ("random", outlook(rivals.hypotheses, proposal.experiment.along(motion))),
    ):
        made = proposal.experiment.motion if kind == "designed" else motion
        predicted = float(foreseen.right[names.index(hidden)]) if hidden in names else 0.0
        row[f"{kind}_predicted"], row[f"{kind}_overall"] = predicted, foreseen.probability
        row[f"{kind}_separation"] = foreseen.separation
        if separable:
            _, after = diagnosed([first, recorded(f"{kind}.csv", setup, made, rng, known)])
            row[f"{kind}_right"] = right(after, hidden)
            row[f"{kind}_verdict"] = after.verdict.key
            row[f"{kind}_named"] = [c.effect for c in after.search.last.effects]
    return row


def calibration(rows: list[dict[str, object]]) -> list[tuple[float, float, int, float, float]]:
    """By bin of the predicted probability: how often the verdict was right."""
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


def worked(job: tuple[str, int]) -> dict[str, object]:
    return case(*job)


def arguments() -> Namespace:
    parser = bench.arguments(__doc__.splitlines()[0], rounds=1, quick_rounds=1)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first-seed", type=int, default=2000)
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--what", default=",".join(SIZES), help="hidden effects, separated by commas")
    return parser.parse_args()


def main() -> int:
    options = arguments()
    names = ["pivot_viscous_friction"] if options.quick else options.what.split(",")
    seeds = range(options.first_seed, options.first_seed + (1 if options.quick else options.seeds))
    jobs = [(name, seed) for seed in seeds for name in names]
    rows: list[dict[str, object]] = []
    if options.processes > 1:
        with ProcessPoolExecutor(options.processes, mp_context=multiprocessing.get_context("spawn")) as pool:
            rows = list(pool.map(worked, jobs))
    else:
        for job in jobs:
            rows.append(case(*job))
            if not options.quick:
                print(rows[-1], flush=True)
    table = []
    for name in names:
        mine = [r for r in rows if r["hidden"] == name]
        tied = [r for r in mine if "rivals" in r]
        tried = [r for r in tied if "designed_right" in r]
        table.append(
            [
                name, str(len(mine)), str(sum(bool(r["first"]) for r in mine)), str(len(tied)),
                *(f"{sum(bool(r[f'{k}_right']) for r in tried)}/{len(tried)}" for k in ("designed", "random")),
                *(
                    f"{np.median([float(r[f'{k}_separation']) for r in tried]):.1f}" if tried else "-"
                    for k in ("designed", "random")
                ),
            ]
        )  # fmt: skip
    bench.print_table(
        "Verdict unique and right after one more motion of 8 s",
        ["hidden", "cases", "named at first", "tied", "designed", "random", "sep. designed", "sep. random"], table,
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
    tried = [r for r in rows if "designed_right" in r]
    sure = [r for r in tried if float(r["designed_predicted"]) >= SURE]
    wins = np.mean([bool(r["designed_right"]) for r in sure]) if sure else 0.0
    random = np.mean([bool(r["random_right"]) for r in tried]) if tried else 0.0
    exact = [r for r in rows if "rivals" in r and not r["separable"]]
    said = np.mean([bool(r["said_inseparable"]) for r in exact]) if exact else 0.0
    off = max((abs(mean - share) for _, _, n, mean, share in found if n >= 10), default=0.0)
    judged = not options.quick
    claims = [
        bench.Claim(
            f"right after a designed motion where {SURE:.0%} is predicted, at least 95 %",
            f"{wins:.1%} of {len(sure)}", bool(wins >= 0.95) if judged and sure else None,
        ),
        bench.Claim(
            "right after a random motion of the same peak acceleration, below 50 %",
            f"{random:.1%} of {len(tried)}", bool(random < 0.5) if judged and tried else None,
        ),
        bench.Claim(
            "predicted probability within 0.1 in every bin with 10 cases or more", f"{off:.2f} off",
            bool(off <= 0.1) if judged and tried else None,
        ),
        bench.Claim(
            "inseparable pairs said to be so", f"{said:.0%} of {len(exact)}",
            bool(said == 1.0) if judged and exact else None,
        ),
    ]  # fmt: skip
    if tried:
        print(f"\ndesign: {np.median([float(r['cpu']) for r in rows if 'cpu' in r]):.1f} s of processor time (median)")
    return bench.conclude(claims, {"rows": rows, "calibration": found}, options.json)


if __name__ == "__main__":
    raise SystemExit(main())
