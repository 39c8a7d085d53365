"""Does `repair` find the dominant effect where many small effects are hidden too? Prints a table.

    python benchmarks/hidden/imperfect_arm.py --seeds 10 --robots baxter,ur5,panda --processes 2

Recordings come from `tests/worlds/imperfect_arm.py`: every link's mass, centre and extents off by 3 to 8 %,
friction that drifts, cogging, flexible joints, torques smoothed or late, on all joints, always; and one or two effects
that make at least 80 % of the squared error of the model as described, or none. Training is two runs of 20 s at 100 Hz
with one kind of motion, one run with another kind is held out, and an exam with a third kind is seen by nothing.

What is counted:

- `named`: every effect of the first step is one that was put in, on just the joints where it was.
- `alone`: the named effects alone have at most 1.3 times the held-out error of the whole model.
- `exam`: error in the exam, the root of the summed squared errors of all joints in N m, over that of the true effects
  on their joints fitted to the same training runs. The true effects do not know the small errors, so that a repair may
  be below 1. Close is at most 1.2.
- `quiet`: where nothing dominates, that no name was given with confidence. A name is confident when the first step
  lowers the squared error over all joints by at least half, in training and in the held-out run: it claims to be what
  is missing. In these cases no single effect on one joint explains more than 40 % of both, as a plain least-squares fit
  without noise says, so that such a claim is false. Steps that lower the error a little are not a fault, and neither is
  any that comes later.
"""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parents[1]))
import _hidden_table as hidden_table  # isort: skip

import time
from collections.abc import Mapping, Sequence

import numpy as np

from armdyn.arm.model import ArmModel, arm_model
from armdyn.effects.catalogue import CATALOGUE
from armdyn.identify.explained_share import RepairStep
from armdyn.identify.repair import Repair, add, repair
from armdyn.identify.studies import make_study
from armdyn.run import Run

imperfect = hidden_table.generator("imperfect_arm")

CLOSE = 1.2
"""Largest exam error of a good repair over that of the true effects."""
ALONE = 1.3
"""Largest held-out error of the named effects alone over that of the whole model."""
CONFIDENT = 0.5
"""Least share of the squared error, in training and held out, that a dominant first step removes."""
TARGETS = {"named": 0.95, "alone": 0.95, "close": 0.9, "quiet": 0.95}


def exam_error(model: ArmModel, runs: Sequence[Run]) -> float:
    """Root of the sum of squared errors of all joints, with the model as it is [N m]."""
    squares = []
    for run in runs:
        ready = model.prepare_run(run)
        found = model.predict(ready, model.theta())
        errors = (ready.channels[name].value - found.values[rows] for name, rows in found.slices.items())
        squares.append(sum(float(np.mean(error**2)) for error in errors))
    return float(np.sqrt(np.mean(squares)))


def removed_share(before: RepairStep, after: RepairStep) -> float:
    """Smaller of the shares of the squared error that a step removes in training and held out, over all joints."""
    pairs = ((before.rmse, after.rmse), (before.held_out_rmse, after.held_out_rmse))
    return min(1.0 - _squared(left) / _squared(given) for given, left in pairs)


def _alone(path: Sequence[RepairStep]) -> float:
    """Held-out error of the named effects alone over that of the whole model."""
    named = [step for step in path if not step.values][-1]
    return float(np.sqrt(_squared(named.held_out_rmse) / _squared(path[-1].held_out_rmse)))


def _squared(errors: Mapping[str, float]) -> float:
    return sum(error**2 for error in errors.values())


def named(first: RepairStep, truth: set[tuple[str, str]]) -> bool:
    """Whether a step adds only hidden effects on their own joints."""
    joints = {joint for effect, joint in truth if effect in first.added}
    return set(first.added) <= {effect for effect, _ in truth} and set(first.joints) == joints


def with_true_effects(model: ArmModel, case: object, held_out: Sequence[Run]) -> Repair:
    """Model with the true effects on their joints, fitted to the training runs."""
    effects = [CATALOGUE[hidden.effect].on(hidden.joint) for hidden in case.truth]
    study = make_study(model, case.train, held_out, effects)
    return add(study, effects)


def examine(robot: str, name: str, seed: int) -> hidden_table.Row:
    """Row of the table for one case."""
    case = imperfect.generate(robot, name, seed)
    truth = {(hidden.effect, hidden.joint) for hidden in case.truth}
    model = arm_model(robot=robot)
    begun, cpu = time.perf_counter(), time.process_time()
    mended = repair(make_study(model, case.train, case.held_out, hidden_table.JOINT_EFFECTS))
    row: hidden_table.Row = {
        "what": f"{name} {robot}", "case": name, "robot": robot, "seed": seed,
        "truth": sorted(map(list, truth)),
        "seconds": time.perf_counter() - begun, "cpu": time.process_time() - cpu,
        "verdict": mended.verdict.key, "sentence": mended.sentence,
        "draws": case.draws, "dominance": case.dominance() if truth else case.largest_single,
        "steps": [[list(step.added), list(step.joints)] for step in mended.path[1:]],
        "removed": [removed_share(*pair) for pair in zip(mended.path[:-1], mended.path[1:], strict=True)],
        "added": len(mended.model_without_background.names) - len(model.names),
        "alone": _alone(mended.path) <= ALONE,
        "exam_error": exam_error(mended.model, case.exam), "exam_as_given": exam_error(model, case.exam),
    }  # fmt: skip
    if not truth:
        first = mended.path[1].added if len(mended.path) > 1 else ("background",)
        return row | {"quiet": first == ("background",) or row["removed"][0] < CONFIDENT}
    reference = exam_error(with_true_effects(model, case, case.held_out).model, case.exam)
    row |= {"exam_true": reference, "exam": row["exam_error"] / reference}
    return row | {
        "named": len(mended.path) > 1 and named(mended.path[1], truth),
        "close": row["exam"] <= CLOSE,
    }


def show(title: str, rows: Sequence[hidden_table.Row]) -> None:
    """Print a line for each case and robot, then the shares of all beside their targets."""
    print(f"\n{title}: {len(rows)} cases")
    for what in dict.fromkeys(row["what"] for row in rows):
        print(f"  {what:24s}{_line([row for row in rows if row['what'] == what])}")
    print(f"  {'all':24s}{_line(rows)}")
    for key, target in TARGETS.items():
        values = [row[key] for row in rows if key in row]
        if values:
            print(f"  all: {key} {100 * np.mean(values):.1f} % of {len(values)}, wanted {100 * target:.0f} %")
    print(f"  seconds: worst {max(row['seconds'] for row in rows):.1f}", flush=True)


def _line(rows: Sequence[hidden_table.Row]) -> str:
    parts = [
        f"{key} {100 * np.mean([row[key] for row in rows if key in row]):5.1f} %"
        for key in TARGETS
        if any(key in row for row in rows)
    ]
    for key in ("exam",):
        ratios = [row[key] for row in rows if key in row]
        if ratios:
            parts.append(f"{key} {np.median(ratios):.2f}, 95 % {np.percentile(ratios, 95):.2f}")
    return "  ".join([*parts, f"{np.median([row['seconds'] for row in rows]):.1f} s"])


def main() -> None:
    parser = hidden_table.parser(__doc__, "", 3)
    parser.add_argument("--robots", default=",".join(imperfect.ROBOTS), help="with commas")
    given = parser.parse_args()
    names = given.only.split(",") if given.only else list(imperfect.CASES)
    seeds = hidden_table.seeds_of(given)
    cases = [(robot, name, seed) for seed in seeds for robot in given.robots.split(",") for name in names]
    rows: list[hidden_table.Row] = []
    for row in hidden_table.answered(examine, cases, given.processes):
        rows.append(row)
        if row.get("named") is False or row.get("quiet") is False:
            keys = ("what", "seed", "truth", "steps", "exam")
            print("   miss:", {key: row[key] for key in keys if key in row}, flush=True)
        hidden_table.save(given.json, {"imperfect": rows})
    show("imperfect", rows)


if __name__ == "__main__":
    main()
