"""One or two effects make nearly all of the error, friction and rotors and small links the rest: is all of it modelled?

    python benchmarks/hidden/dominated_arm.py --seeds 20 --first-seed 0 --processes 2

Recordings come from `tests/worlds/dominated_arm.py`, with nothing that the catalogue lacks: Coulomb friction,
viscous friction and a rotor on every joint, links whose mass, centre and extents are off by 3 to 8 %, and the noise of
encoders and torque sensors. One or two effects (a gain of two joints, a spring, a payload, a tilted base) make 95 to
99 % of the squared error of the model as described. Training is one or two runs with one kind of motion; another kind
is held out in every other case, a third is the exam.

What is counted:

- `led`: the first steps of the repair, as many as there are dominant effects, are those.
- `frictions`: every later name is one that was put in.
- `model`: error in the exam of the repaired model over that of the true structure, all effects that were put in on all
  joints, fitted to the same training runs, is at most 1.1.
"""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parents[1]))
import _hidden_table as hidden_table  # isort: skip

import time
from collections.abc import Sequence

import numpy as np
from imperfect_arm import exam_error

from armdyn.arm.model import arm_model
from armdyn.effects.catalogue import CATALOGUE
from armdyn.effects.effect import Effect
from armdyn.identify.explained_share import RepairStep
from armdyn.identify.repair import add, repair
from armdyn.identify.studies import make_study

dominated = hidden_table.generator("dominated_arm")
ROBOTS = hidden_table.generator("imperfect_arm").ROBOTS

FRICTIONS = ("joint_coulomb_friction", "joint_viscous_friction", "rotor_inertia")
CLOSE = 1.1
TARGETS = {"led": 0.95, "frictions": 0.95, "model": 0.95}


def examine(robot: str, kind: str, seed: int) -> hidden_table.Row:
    """Row of the table for one case."""
    case = dominated.generate(robot, kind, seed)
    big, train, held_out, exam = case.dominant, case.train, [case.held_out] if seed % 2 else [], [case.exam]
    model = arm_model(robot=robot)
    begun = time.perf_counter()
    mended = repair(make_study(model, train, held_out, hidden_table.JOINT_EFFECTS))
    seconds = time.perf_counter() - begun
    wanted: list[Effect] = [CATALOGUE["base_tilt"]] if kind == "tilt" else []
    names = {"base_tilt"} if kind == "tilt" else {hidden.effect for hidden in big}
    joints = {name: [h.joint for h in big if h.effect == name] for name in names if name != "base_tilt"}
    wanted += [CATALOGUE[name].on(*on) for name, on in joints.items()]
    every = [*wanted, *(CATALOGUE[name] for name in (*FRICTIONS, "link_inertia") if name not in names)]
    truth = add(make_study(model, train, held_out, every), every)
    steps = mended.path[1:]
    named = [step for step in steps if step.added != ("background",)]
    told = {e for step in named for e in step.added}
    row: hidden_table.Row = {
        "what": f"{kind} {robot}", "kind": kind, "robot": robot, "seed": seed, "share": case.share, "seconds": seconds,
        "held_out": bool(held_out), "runs": len(train),
        "steps": [[list(step.added), list(step.joints)] for step in steps],
        "led": _lead(named, {(name, joint) for name in names for joint in joints.get(name, [""])}),
        "frictions": told <= names | {*FRICTIONS, "link_inertia"},
        "exam_error": exam_error(mended.model, exam), "exam_named": exam_error(mended.model_without_background, exam),
        "exam_true": exam_error(truth.model, exam),
    }  # fmt: skip
    row["exam"] = row["exam_error"] / row["exam_true"]
    return row | {"model": row["exam"] <= CLOSE, "told": sorted(told)}


def _lead(steps: Sequence[RepairStep], wanted: set[tuple[str, str]]) -> bool:
    """Whether the first steps add these effects and no others."""
    left = set(wanted)
    for step in steps:
        here = {(effect, joint) for effect in step.added for joint in step.joints or ("",)}
        if not left or not here <= left:
            break
        left -= here
    return not left


def main() -> None:
    parser = hidden_table.parser(__doc__, "", 5)
    given = parser.parse_args()
    kinds = given.only.split(",") if given.only else list(dominated.KINDS)
    cases = [(robot, kind, seed) for seed in hidden_table.seeds_of(given) for robot in ROBOTS for kind in kinds]
    rows: list[hidden_table.Row] = []
    for row in hidden_table.answered(examine, cases, given.processes):
        rows.append(row)
        keys = ("what", "seed", "share", "runs", "held_out", "steps", "exam", "exam_named", "exam_true", "seconds")
        print({key: round(row[key], 3) if isinstance(row[key], float) else row[key] for key in keys}, flush=True)
    shares = {key: (float(np.mean([row[key] for row in rows])), len(rows)) for key in TARGETS}
    hidden_table.show_shares(shares, TARGETS)
    exams = [row["exam"] for row in rows]
    print(f"exam over that of the truth: median {np.median(exams):.3f}, 95 % {np.percentile(exams, 95):.3f}")
    hidden_table.save(given.json, {"dominated": rows})


if __name__ == "__main__":
    main()
