"""Does a trial with random hidden effects, noise, length and a single fault ever break a rule? Runs many of them.

    python benchmarks/robustness.py [--trials 1000] [--first-seed N] [--workers N] [--json FILE]

A trial may land, miss, or stop with a reason. What may never happen: an exception, a command beyond a limit, an arm
that moves at the end, a robot that was not told to stop, a result that JSON cannot hold, a recording that cannot be
read.
"""

import _timing as bench  # isort: skip

import argparse
import json
import math
import multiprocessing
import resource
import sys
import time
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from armdyn.run import read_run
from pipeline.robot.hidden import HIDDEN_EFFECTS
from pipeline.robot.scene import TIME_STEP
from pipeline.robot.settings import PlantSettings
from pipeline.robot.simulated import STEPS_PER_TRUE_MOTION_SAMPLE
from pipeline.trial import TrialSettings, simulate_trial

tests = str(Path(__file__).resolve().parent.parent / "tests")
if tests not in sys.path:
    sys.path.insert(0, tests)

AT_REST = 0.02
"""Largest speed along the line of an arm at rest [m/s]."""
ACCELERATION = 1.05
"""Largest difference of two commands over that of a joint's acceleration limit."""


@dataclass(frozen=True)
class Outcome:
    """Result of one trial: its settings, its ending, and the errors, empty if there are none.

    `megabytes` is the largest memory of the process so far; `to_rest` is the time from the reason of a stop to the
    command that stops the arm, nan without a stop.
    """

    seed: int
    fault: str
    at: float
    hidden: tuple[str, ...]
    success: bool
    stopped: bool
    message: str
    wrong: tuple[str, ...]
    to_rest: float
    megabytes: float
    seconds: float


def settings_of(seed: int, rng: np.random.Generator) -> TrialSettings:
    """Random length, guess, noise and up to three hidden effects between a fifth and twice their typical size."""
    chosen = rng.choice(sorted(HIDDEN_EFFECTS), size=int(rng.integers(0, 4)), replace=False)
    hidden = {}
    for name in chosen.tolist():
        effect = HIDDEN_EFFECTS[name]
        hidden[name] = float(np.clip(effect.typical * rng.uniform(0.2, 2.0), effect.lower, effect.upper))
    plant = PlantSettings()
    readings = replace(
        plant.readings,
        position_noise=plant.readings.position_noise * rng.uniform(0.2, 4.0),
        velocity_noise=plant.readings.velocity_noise * rng.uniform(0.2, 4.0),
    )
    plant = replace(plant, readings=readings, cell=replace(plant.cell, noise=plant.cell.noise * rng.uniform(0.2, 3.0)))
    length = float(rng.uniform(0.3, 0.45))
    guess = float(np.clip(length * rng.uniform(0.7, 1.3), 0.2, 0.6))
    return TrialSettings(length_guess=guess, true_length=length, hidden=hidden, seed=seed, plant=plant)


def fault_of(rng: np.random.Generator) -> tuple[str, float, Any]:
    """Fault at a random instant [s]; one trial of five has none, and half of the faults persist."""
    from faults.faulty import ClockJumps, Raises, Stalls, Through
    from faults.kinds import SENSORS

    at, long = float(rng.uniform(0.1, 14.0)), math.inf if rng.random() < 0.5 else float(rng.uniform(0.005, 0.05))
    others = {
        "none": Through,
        "command": lambda: Raises("command", OSError("link"), at),
        "stall": lambda: Stalls(at, float(rng.uniform(0.01, 1.0))),
        "clock": lambda: ClockJumps(at, float(rng.choice([1000.0, -1.0, 0.1]))),
    }
    sensors = {name: lambda name=name: SENSORS[name][0](at, at + long) for name in SENSORS}
    if rng.random() < 0.2:
        return "none", at, others["none"]()
    table = {**sensors, **others}
    name = str(rng.choice(sorted(table)))
    lasts = "" if name in others else " (lasts)" if math.isinf(long) else " (a moment)"
    return name + lasts, at, table[name]()


def violations(told: list[tuple[Any, ...]], limits: Any) -> list[str]:
    """Names of the limits that commands broke, and a missing stop."""
    commands = [entry for entry in told if len(entry) == 4]
    wrong = []
    if not told or len(told[-1]) != 1:
        wrong.append("not told to stop")
    if not commands:
        return wrong
    t, q, v, a = (np.array([c[i] for c in commands]) for i in range(4))
    if not (np.all(limits.lower <= q) and np.all(q <= limits.upper)):
        wrong.append("position")
    if not np.all(np.abs(v) <= 1.001 * limits.velocity):
        wrong.append("velocity")
    if not np.all(np.abs(a) <= 1.001 * limits.acceleration):
        wrong.append("acceleration")
    steps = np.maximum(np.diff(t), 0.01)[:, None]
    if not np.all(np.abs(np.diff(v, axis=0)) <= ACCELERATION * limits.acceleration * steps):
        wrong.append("step of velocity")
    return wrong


def one(seed: int) -> Outcome:
    """Result of one trial."""
    rng = np.random.default_rng(seed)
    settings = settings_of(seed, rng)
    name, at, robot = fault_of(rng)
    begun, hidden = time.perf_counter(), tuple(settings.hidden)
    success, stopped, message, to_rest, wrong = False, False, "", math.nan, list[str]()
    with TemporaryDirectory() as scratch:
        try:
            trial = simulate_trial(replace(settings, out=Path(scratch)), through=robot.around)
            result = trial.result
            success, stopped, message = result.success, result.stopped, result.message
            wrong += violations(robot.told, trial.experiment.description.limits)
            last = np.diff(trial.robot.history().pivot[-2:], axis=0)
            if not np.linalg.norm(last) < STEPS_PER_TRUE_MOTION_SAMPLE * TIME_STEP * AT_REST:
                wrong.append("moves")
            json.dumps(result.as_json(), allow_nan=False)
            if "\n" in message:
                wrong.append("message of several lines")
            spans = {span.phase.name: span for span in trial.experiment.phases}
            if stopped:
                to_rest = spans["STOP"].end - spans["STOP"].start - 0.3
            read_run(Path(scratch) / "trial.mcap")
        except Exception as error:
            wrong.append(f"{type(error).__name__}: {error}")
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return Outcome(
        seed, name, at, hidden, success, stopped, message, tuple(wrong), to_rest, memory, time.perf_counter() - begun
    )


def main() -> int:
    """Run the benchmark; 1 where a claim is missed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trials", type=int, default=1000)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=1, help="processes")
    parser.add_argument("--minutes", type=float, default=math.inf, help="begin no more after this time")
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args()
    outcomes: list[Outcome] = []
    seeds = range(options.first_seed, options.first_seed + options.trials)
    end = time.monotonic() + 60.0 * options.minutes
    with ProcessPoolExecutor(options.workers, multiprocessing.get_context("spawn")) as pool:
        for start in range(0, len(seeds), options.workers):
            if time.monotonic() > end:
                break
            for outcome in pool.map(one, seeds[start : start + options.workers]):
                outcomes.append(outcome)
                if outcome.wrong:
                    print(f"  {outcome}", file=sys.stderr, flush=True)
                if len(outcomes) % 10 == 0:
                    print(f"  {len(outcomes)} trials", file=sys.stderr, flush=True)
    kinds = Counter(o.fault for o in outcomes)
    rows = []
    for kind in sorted(kinds):
        mine = [o for o in outcomes if o.fault == kind]
        landed, stopped, wrong = (
            str(sum(map(bool, part)))
            for part in ([o.success for o in mine], [o.stopped for o in mine], [o.wrong for o in mine])
        )
        rows.append([kind, str(len(mine)), landed, stopped, wrong])
    bench.print_table(f"{len(outcomes)} trials", ["fault", "trials", "landed", "stopped", "wrong"], rows)
    rest = np.array([o.to_rest for o in outcomes if 0 <= o.to_rest < 10])
    if len(rest):
        print(f"time to rest: median {np.median(rest):.2f} s, at most {rest.max():.2f} s")
    fifth = max(1, len(outcomes) // 5)
    memory = [float(np.mean([o.megabytes for o in part])) for part in (outcomes[fifth : 2 * fifth], outcomes[-fifth:])]
    print(f"memory: {memory[0]:.0f} MB in the second fifth, {memory[1]:.0f} MB in the last")
    bad = sum(bool(o.wrong) for o in outcomes)
    claims = [
        bench.Claim("no trial breaks anything", f"{bad} of {len(outcomes)}", not bad),
        bench.Claim(
            "memory is flat (1.1 times at most)", f"{memory[1] / memory[0]:.3f}",
            memory[1] < 1.1 * memory[0] if len(outcomes) >= 50 else None,
        ),
    ]  # fmt: skip
    return bench.conclude(claims, {"outcomes": [asdict(o) for o in outcomes]}, options.json)


if __name__ == "__main__":
    raise SystemExit(main())
