"""How often does `diagnose` find a hidden effect in the joints of an arm? Prints a table.

    python benchmarks/hidden/hidden_effects_arm.py --seeds 20 --what single,tenth,clean,coloured,pairs,outside

Recordings come from `tests/worlds/baxter.py`, MuJoCo and numpy: Baxter's right arm, seven joints, two runs of
15 s at 100 Hz with another random motion each, encoder noise 0.4 mrad, torque noise 0.08 N m (wrist 0.04), both runs
with the noise of their torques stated. The whole catalogue is tried. The time of a diagnosis counts everything from
the recordings on; a diagnosis of shorter runs before it counts as start-up.

What counts as right:

- `named`: the first name is the hidden effect's. Effects contain one another, and containing is not enough: Coulomb
  friction is asymmetric friction with equal sizes, a payload is one way of changing the last link's inertia, and a
  constant gain of one joint can stand for heavier links beyond it. The one with fewer unknowns was put in, the other
  says more than is so: it counts as wrong unless the verdict is a tie that holds the truth.
- The exception is asymmetric friction found as Coulomb friction and a torque offset together, on the same joints:
  f+ (1 + s)/2 - f- (1 - s)/2 = s (f+ + f-)/2 + (f+ - f-)/2 is the same torque with the same number of unknowns.
- `honest`: named, or the verdict is a tie and the tied effects hold the truth.
- `joints`: where named, the joints are those that have the effect (at a tenth of the size some may not show).
- A verdict that something unknown is missing counts as neither, whatever stands first.
"""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parents[1]))
import _hidden_table as hidden_table  # isort: skip

import time
from functools import cache

import numpy as np

from armdyn.arm.model import arm_model
from armdyn.identify.compare import fitted_parameters
from armdyn.identify.diagnose import Diagnosis, diagnose
from armdyn.identify.repair import repair
from armdyn.identify.selection.path import SearchStep
from armdyn.identify.studies import make_study
from armdyn.identify.study import Study
from armdyn.run import Run

hidden_arm = hidden_table.generator("baxter")

PAIRS = (
    ("joint_viscous_friction", "joint_coulomb_friction"), ("joint_coulomb_friction", "gravity_spring"),
    ("payload", "joint_coulomb_friction"), ("torque_offset", "joint_viscous_friction"),
    ("link_inertia", "joint_coulomb_friction"), ("gravity_spring", "torque_delay"),
)  # fmt: skip


def recordings(hidden: tuple[str, ...], size: float, seed: int, **settings: float) -> list[Run]:
    return [hidden_arm.generate(hidden, size, seed, recording=k, **settings) for k in range(2)]


def study_of(runs: list[Run]) -> Study:
    """Study of runs with Baxter's arm as described, and the whole catalogue of joints."""
    return make_study(arm_model(robot="baxter"), runs, [], hidden_table.JOINT_EFFECTS)


def true_joints(effect: str) -> set[str]:
    return {name.partition("[")[2].rstrip("]") for name in hidden_arm.true_parameters(effect, 1.0) if "[" in name}


def judged(found: Diagnosis, truth: str) -> tuple[bool, bool, bool]:
    """Whether the first name is right; whether it or a reported tie is; whether name and joints are."""
    if not found.ranked_effects or found.verdict.key not in ("effect_missing", "cannot_tell_apart"):
        return False, False, False
    first = found.ranked_effects[0]
    added = {c.effect: set(c.joints) for c in found.search.last.effects}
    same = set(hidden_table.SAME_TORQUE.get(truth, ()))
    if same and set(added) == same and len({frozenset(joints) for joints in added.values()}) == 1:
        return True, True, set(first.joints) == true_joints(truth)
    named = first.effect == truth
    tie = found.verdict.key == "cannot_tell_apart" and truth in first.tied_with
    return named, named or tie, named and added.get(truth, set(first.joints)) == true_joints(truth)


def pulls(study: Study, last: SearchStep, truth: str, size: float) -> dict[str, float]:
    """Errors of the final model's values over their standard deviations, by true parameter."""
    fitted = fitted_parameters(study, last.fit)
    true = hidden_arm.true_parameters(truth, size)
    return {
        name: (found.value - true[name]) / found.std
        for name, found in fitted.items()
        if name in true and found.std
    }  # fmt: skip


def examine(kind: str, what: str, seed: int) -> hidden_table.Row:
    """Row of the table for one case."""
    _warm()
    hidden = () if what == "none" else tuple(what.split("+"))
    size = 0.1 if kind == "tenth" else 1.0
    row: hidden_table.Row = {"kind": kind, "what": what, "seed": seed}
    runs = recordings(hidden, size, seed, colour=0.8 if kind == "coloured" else 0.0)
    begun, cpu = time.perf_counter(), time.process_time()
    study = study_of(runs)
    if kind == "pairs":
        mended = repair(study)
        names = [effect.name for effect in mended.model_without_background.effects]
        tied = {t for step in mended.path for t in step.tied_with}
        exact = set(names) == set(hidden)
        return row | {
            "seconds": time.perf_counter() - begun, "cpu": time.process_time() - cpu,
            "verdict": mended.verdict.key, "found": names, "exact": exact,
            "honest": exact or set(hidden) <= {*names, *tied},
            "last": mended.path[-1].chi2_per_sample,
            "in_turn": float(np.mean([(c.held_out_rmse or 0.0) ** 2 / c.noise_std**2
                                       for c in mended.after.channels.values()])),
        }  # fmt: skip
    found = diagnose(study)
    row |= {"seconds": time.perf_counter() - begun, "cpu": time.process_time() - cpu}
    row |= {
        "verdict": found.verdict.key,
        "first": found.ranked_effects[0].effect if found.ranked_effects else "",
        "joints_found": list(found.ranked_effects[0].joints) if found.ranked_effects else [],
        "tied_with": list(found.ranked_effects[0].tied_with) if found.ranked_effects else [],
        "steps": [[c.label for c in step.added] for step in found.search.steps[1:]],
        "before": found.search.steps[0].fit.chi2_per_sample,
        "last": found.search.last.fit.chi2_per_sample,
        "sentence": found.sentence,
    }
    if kind in ("single", "tenth"):
        named, honest, joints = judged(found, what)
        row |= {"named": named, "honest": honest, "tie": found.verdict.key == "cannot_tell_apart"}
        row["in_turn"] = hidden_table.chi2_per_sample(study.held_out_blocks(found.search.last.fit))
        if named:
            row["joints"] = joints
            row["pull"] = list(pulls(study, found.search.last, what, size).values())
    elif kind == "outside":
        row["flagged"] = found.verdict.key == "unknown_effect"
    else:
        row["false"] = found.verdict.key != "explained"
    return row


@cache
def _warm() -> None:
    """Compile functions and parse robots once in a process, outside the measured time."""
    diagnose(study_of(recordings(("joint_coulomb_friction",), 1.0, 0, duration=4.0)))


def main() -> None:
    given = hidden_table.parser(__doc__, "single,clean", 3).parse_args()
    names = given.only.split(",") if given.only else list(hidden_arm.REALISTIC)
    what = {
        "single": names, "tenth": names, "clean": ["none"], "coloured": ["none"],
        "pairs": ["+".join(pair) for pair in PAIRS], "outside": list(hidden_arm.OUTSIDE),
    }  # fmt: skip
    kinds = {
        kind: (examine, [(kind, name, seed) for seed in hidden_table.seeds_of(given) for name in what[kind]])
        for kind in hidden_table.wanted(given.what, [*what])
    }
    hidden_table.run(kinds, given.processes, given.json)


if __name__ == "__main__":
    main()
