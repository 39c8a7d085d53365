"""The estimator against scipy and plain numpy: the same answer, how much faster, how close to the Cramer-Rao bound.

    python benchmarks/rivals/estimator.py [--quick] [--rounds N] [--draws N] [--data CSV] [--json FILE]

The data are 10 s at 100 Hz below a gripper that moves with .04 (1 - cos 2 pi .6 t) + .012 (1 - cos 2 pi 1.15 t) m:
a recording of that motion where one is found, else simulated by scipy from equations of the benchmark's own.
"""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parents[1]))
import _timing as bench  # isort: skip

from dataclasses import dataclass
from functools import partial

import numpy as np
from _closed_loop import learn
from _estimation_cases import LENGTH, MASS, MOTION, NOISE, OUR_NAMES, TIME, recording, scenarios, simple_model
from _gradient_descent import gradient_descent
from _pendulum import Pendulum
from _rival_fits import NAMES, Fit, with_arrays, with_floats, with_scipy

from armdyn.estimation.descent import descend
from armdyn.identify.estimator import Estimate, Estimator
from armdyn.recording.gaps import run_until

METHODS = {"levenberg_marquardt": descend, "gradient_descent": gradient_descent}
OURS, OURS_VM = "armdyn", "armdyn, no C compiler"
RIVALS: dict[str, Fit] = {
    "scipy least_squares + solve_ivp": with_scipy,
    "plain Runge-Kutta, Python floats": with_floats,
    "plain Runge-Kutta, numpy arrays": with_arrays,
}
SAME = 0.02
"""Largest difference of two estimates in standard deviations; each method stops within 0.01."""
LEAST_EFFICIENCY = 0.95
GUESSES = np.linspace(0.15, 0.9, 12)
"""Guesses of the length in the study of convergence [m]."""
WITHIN = 5.0
"""Largest error of a converged estimate, in its standard deviations."""
DEFAULT_DATA = Path(__file__).resolve().parents[3] / "shared" / "data" / "reference" / "est_data.csv"


def armdyn_once(name: str, data: Path | None) -> float:
    """Seconds of one estimate by armdyn, as a function that another process can call by its name."""
    return bench.timed(scenarios(data)[name].ours)()


def compare(data: Path | None, rounds: int, near_only: bool) -> tuple[list[dict[str, object]], float]:
    """Rows of the comparison, and the largest difference of an estimate from armdyn's in standard deviations."""
    rows: list[dict[str, object]] = []
    worst = 0.0
    with bench.without_compiler() as elsewhere:
        for name, scenario in scenarios(data).items():
            if near_only and scenario.windows:
                continue
            estimate = scenario.ours()
            columns = [estimate.names.index(OUR_NAMES[NAMES.index(free)]) for free in scenario.data.free]
            values, stds = estimate.values[columns], np.sqrt(np.diag(estimate.covariance))[columns]
            off = {k: float(np.max(np.abs(scenario.theirs(fit) - values) / stds)) for k, fit in RIVALS.items()}
            worst = max(worst, *off.values())
            seconds = bench.race(
                {
                    OURS: bench.timed(scenario.ours),
                    OURS_VM: elsewhere(partial(armdyn_once, name, data)),
                    **{k: bench.timed(partial(scenario.theirs, fit)) for k, fit in RIVALS.items()},
                },
                rounds,
            )
            rows += [
                {
                    "estimated": name,
                    "by": k,
                    "off": off.get(k),
                    "seconds": seconds[k],
                    "ratio_to_armdyn": bench.ratio(seconds, k, OURS),
                }
                for k in seconds
            ]
    return rows, worst


@dataclass(frozen=True)
class Efficiency:
    """Ratio of the Cramer-Rao bound to the mean squared error of the estimates.

    Attributes:
        plain: ratio from the squared errors alone.
        plain_std: standard deviation of `plain`.
        paired: ratio with the squared errors of the best linear unbiased estimate on the same noise as reference;
            their expectation is the bound, and most of the chance cancels.
        paired_std: standard deviation of `paired`.
        bound: least standard deviation of the length [m].
        mean_error: mean error of the length [m].
    """

    plain: float
    plain_std: float
    paired: float
    paired_std: float
    bound: float
    mean_error: float


def efficiency(draws: int) -> Efficiency:
    """Efficiency of the length on the exact model: one estimate per draw of the noise, from a guess 2 mm beside."""
    truth = Pendulum(LENGTH, MASS)
    force, slope = truth.simulate(MOTION, TIME)[1], truth.length_sensitivity(MOTION, TIME)
    bound = NOISE**2 / float(slope @ slope)
    error, linear = np.zeros(draws), np.zeros(draws)
    for seed in range(draws):
        noise = NOISE * np.random.default_rng(seed).normal(size=len(TIME))
        estimator = Estimator(simple_model(LENGTH + 0.002), {"load_force": NOISE})
        error[seed] = estimator.update(recording(force + noise)).value("length") - LENGTH
        linear[seed] = slope @ noise / (slope @ slope)
    plain = bound / float(np.mean(error**2))
    excess = error**2 - linear**2
    paired = bound / (bound + float(np.mean(excess)))
    spread = float(np.std(excess, ddof=1) / np.sqrt(draws)) / bound
    return Efficiency(
        plain,
        plain * float(np.sqrt(2 / draws)),
        paired,
        paired**2 * spread,
        float(np.sqrt(bound)),
        float(np.mean(error)),
    )


def convergence(guesses: np.ndarray, seeds: int) -> list[dict[str, object]]:
    """Shares of converged estimates by guess: 6 s of SAC at 5 mN, and the other tables' weaker motion at 10 mN."""
    strong, weak = Pendulum(LENGTH, 0.08), Pendulum(LENGTH, MASS).simulate(MOTION, TIME)[1]
    rows: list[dict[str, object]] = []
    for guess in guesses.tolist():
        row: dict[str, object] = {"guess": guess}
        for method in METHODS:
            found: dict[str, list[bool]] = {"sac": [], "fixed": []}
            evaluations = []
            for seed in range(seeds):
                trial = learn(
                    strong, simple_model(guess, 0.08), 6.0, 0.005, np.random.default_rng(seed), METHODS[method]
                )
                found["sac"].append(arrived(trial.estimates[-1]))
                evaluations.append(trial.evaluations / len(trial.estimates))
                run = recording(weak + NOISE * np.random.default_rng(seed).normal(size=len(TIME)))
                estimator = Estimator(simple_model(guess), {"load_force": NOISE}, METHODS[method])
                for end in np.arange(1.0, 6.01, 0.5):
                    estimate = estimator.update(run_until(run, end))
                found["fixed"].append(arrived(estimate))
            row[method] = {k: float(np.mean(v)) for k, v in found.items()} | {
                "evaluations": float(np.mean(evaluations))
            }
        rows.append(row)
    return rows


def arrived(estimate: Estimate) -> bool:
    return abs(estimate.value("length") - LENGTH) <= WITHIN * estimate.std("length")


def main() -> int:
    parser = bench.arguments(__doc__.splitlines()[0], rounds=21, quick_rounds=1)
    parser.add_argument("--draws", type=int, help="of the noise for the efficiency (100; 20 with --quick)")
    parser.add_argument("--data", type=Path, default=DEFAULT_DATA, help="recording of the motion, force in column 7")
    options = parser.parse_args()
    data = options.data if options.data.exists() else None
    print(f"length alone: {'simulated' if data is None else data.name}; everything: simulated")
    rounds, draws = bench.rounds_of(options), options.draws or (20 if options.quick else 100)
    rows, worst = compare(data, rounds, options.quick)
    bench.print_table(
        f"Estimates from 10 s at 100 Hz, {rounds} rounds",
        ["estimated", "by", "ms", "time / armdyn", "differs by [std]"],
        [
            [
                row["estimated"] if i % (len(RIVALS) + 2) == 0 else "",
                row["by"],
                bench.milliseconds(row["seconds"]),
                str(row["ratio_to_armdyn"]),
                "" if row["off"] is None else f"{row['off']:.4f}",
            ]
            for i, row in enumerate(rows)
        ],
        texts=2,
    )
    found = efficiency(draws)
    print(
        f"\nEfficiency of the length on the exact model, {draws} draws: {found.paired:.4f} +/- {found.paired_std:.4f} "
        f"(paired with the linear estimate), {found.plain:.2f} +/- {found.plain_std:.2f} (squared errors alone); "
        f"bound {1e3 * found.bound:.3f} mm, mean error {1e3 * found.mean_error:+.3f} mm"
    )
    seeds = 1 if options.quick else 4
    table = convergence(GUESSES[:1] if options.quick else GUESSES, seeds)
    bench.print_table(
        f"Converged to the truth, warm-started at 2 Hz from 1 s to 6 s, {seeds} seeds",
        ["guess m", *(f"{m}: {what}" for m in ("LM", "descent") for what in ("SAC", "fixed motion", "evaluations"))],
        [
            [
                f"{row['guess']:.3f}",
                *(
                    text
                    for method in METHODS
                    for text in (
                        f"{row[method]['sac']:.0%}",
                        f"{row[method]['fixed']:.0%}",
                        f"{row[method]['evaluations']:.1f}",
                    )
                ),
            ]
            for row in table
        ],
    )
    share = float(np.mean([row[method]["sac"] for row in table for method in METHODS]))
    claims = [
        bench.Claim(f"the same answers to {SAME:g} standard deviations", f"{worst:.4f}", worst <= SAME),
        bench.Claim(
            f"efficiency at least {LEAST_EFFICIENCY:g}", f"{found.paired:.4f}", found.paired >= LEAST_EFFICIENCY
        ),
        bench.Claim("converges from 0.15 to 0.9 m on SAC's motion, both methods", f"{share:.0%}", share == 1.0),
    ]
    results = {
        "data": None if data is None else data.name,
        "rows": rows,
        "efficiency": vars(found) | {"draws": draws},
        "convergence": table,
    }
    return bench.conclude(claims, results, options.json)


if __name__ == "__main__":
    raise SystemExit(main())
