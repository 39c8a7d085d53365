"""Are all hidden effects of an arm found and no others, with right values, at every rate and length?

    python benchmarks/hidden/generated_arm.py --first-seed 0 --robots 40
    python benchmarks/hidden/generated_arm.py --first-seed 0 --same-story
    python benchmarks/hidden/generated_arm.py --first-seed 0 --robots 10 --exports

Recordings come from `tests/worlds/generated_arm.py`, MuJoCo and numpy: four robots of example-robot-data, three
to seven effects at once, each on one to three joints, 100 to 1000 Hz, 12 to 120 s in one to six runs, with the noise
of encoders and torque sensors, which no recording states; some torques are low-passed. The whole catalogue is tried.
Nothing is hidden that the recordings do not show: see `showing` there. What is counted:

- named: of all hidden effects, those that the repaired model has on their joints. An effect in a tie that holds it
  counts, as does another with the same torque and the same number of values (asymmetric friction is Coulomb friction
  and an offset together).
- nothing false: robots whose repaired model has no other effect.
- values: of the effects that are named, those within three standard deviations of the truth.
- second: robots whose repaired model a second repair leaves as it is.

`--same-story` records one motion of one robot at every rate, in every length, in one run and in six, and prints what
is named. `--exports` hides what MuJoCo can hold, and sensors' errors; the repaired model goes to MuJoCo, and there
follows new motions: its error against the true torque, over that of the model itself.
"""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parents[1]))
import _hidden_table as hidden_table  # isort: skip

import argparse
import time
from collections.abc import Iterable, Sequence

import mujoco
import numpy as np

from armdyn.arm.model import ArmModel, arm_model
from armdyn.arm.slots import slots_of
from armdyn.arm.symbolic import inverse_dynamics_function
from armdyn.effects.catalogue import CATALOGUE
from armdyn.identify.repair import Repair, repair
from armdyn.identify.selection.candidate import Candidate
from armdyn.identify.studies import make_study
from armdyn.identify.study import Study
from armdyn.run import Run
from pipeline.exports.mujoco_file import mujoco_text
from pipeline.exports.parts import INEXPRESSIBLE_REASONS, MUJOCO_SLOTS, held_effects

generated = hidden_table.generator("generated_arm")

TARGETS = {"named": 0.95, "nothing false": 0.90, "values": 0.95, "second": 0.98}
DEVIATIONS = 3.0
CLOSE = 1.2
"""Largest error of the exported model over the error of the model itself."""
OF_DRIVES = {
    name
    for name, one in CATALOGUE.items()
    if one.acts_on in ("joint", "drive") and {*slots_of(one).names, slots_of(one).depends_on} & {*INEXPRESSIBLE_REASONS}
}
"""Effects on what a drive is told or reads, which are not part of an exported arm's torques."""
EXPORTED = tuple(
    effect
    for effect in generated.EFFECTS
    if effect in held_effects(CATALOGUE.values(), MUJOCO_SLOTS) | OF_DRIVES
    and effect != "joint_asymmetric_friction"  # MuJoCo holds its mean
)
LENGTHS, COUNTS = (12.0, 30.0, 60.0, 120.0), (1, 6)
"""Lengths of the recordings [s], and numbers of runs."""
Atom = tuple[str, str]


def model_of(robot: object) -> ArmModel:
    return arm_model(robot.name) if Path(robot.name).exists() else arm_model(robot=robot.name)


def study_of(model: ArmModel, runs: Sequence[Run], held_out: bool) -> Study:
    count = len(runs) - held_out
    return make_study(model, runs[:count], runs[count:], hidden_table.JOINT_EFFECTS)


def atoms(effects: Iterable[Candidate]) -> set[Atom]:
    return {(effect.effect, joint) for effect in effects for joint in effect.joints or ("",)}


def judged(mended: Repair, truth: set[Atom]) -> tuple[set[Atom], set[Atom]]:
    """Hidden effects that are not named, and named effects that are not hidden."""
    found = atoms(mended.steps[-1].effects)
    missed, false = truth - found, found - truth
    for one, parts in hidden_table.SAME_TORQUE.items():
        for joint in {joint for _, joint in truth | found}:
            whole, split = {(one, joint)}, {(part, joint) for part in parts}
            for said, hidden in ((whole, split), (split, whole)):
                if hidden <= missed and said <= false:
                    missed, false = missed - hidden, false - said
    for step in mended.steps:
        for one in atoms(step.added) & false:
            for other in [(tie, one[1]) for tie, joint in atoms(step.tied_effects) if joint == one[1]]:
                if other in missed:
                    missed, false = missed - {other}, false - {one}
    return missed, false


def examine(seed: int) -> hidden_table.Row:
    """Row of the table for one robot."""
    robot = generated.generate(seed)
    runs, truth = robot.runs(), {(hidden.effect, hidden.joint) for hidden in robot.truth}
    model = model_of(robot)
    begun = time.perf_counter()
    mended = repair(study_of(model, runs, robot.held_out))
    seconds = time.perf_counter() - begun
    missed, false = judged(mended, truth)
    parameters = mended.model_without_background.parameters
    pulls = {
        name: (parameters[name].value - value) / parameters[name].std
        for name, value in robot.values.items()
        if name in parameters and parameters[name].std
    }
    again = repair(study_of(mended.model_without_background, runs, robot.held_out))
    return {
        "seed": seed, "robot": Path(robot.name).stem, "rate": round(robot.rate), "runs": len(runs),
        "length": robot.length,
        "held out": robot.held_out, "low-passed": float(robot.worlds[0].drive.smoothing), "seconds": seconds,
        "truth": robot.values, "missed": sorted(missed), "false": sorted(false), "pulls": pulls,
        "hidden": len(truth), "path": [(s.added, s.joints, s.tied_with, s.chi2_per_sample) for s in mended.path],
        "second": [(step.added, step.joints) for step in again.path[1:]],
        "same after": atoms(again.steps[-1].effects) == atoms(mended.steps[-1].effects),
        "verdict": mended.verdict.key, "sentence": mended.sentence,
    }  # fmt: skip


def line(row: hidden_table.Row) -> str:
    """Result of one robot in a line, with further lines for errors."""
    off = {name: round(pull, 1) for name, pull in row["pulls"].items() if abs(pull) > DEVIATIONS}
    text = (
        f"{row['seed']:5d} {row['robot']:12s} {row['rate']:4d} Hz {row['length']:5.1f} s in {row['runs']}"
        f"{' (1 held out)' if row['held out'] else ''}"
        f"{_low_passed(row['low-passed'])}: "
        f"{row['hidden'] - len(row['missed'])} of {row['hidden']} named, {len(row['false'])} false, "
        f"{len(row['pulls']) - len(off)} of {len(row['pulls'])} values, {row['seconds']:.0f} s, {row['verdict']}"
    )
    wrong = {"missed": row["missed"], "false": row["false"], "values": off, "second repair": row["second"]}
    return "\n".join([text, *(f"      {what}: {_spoken(which)}" for what, which in wrong.items() if which)])


def _low_passed(cut_off: float) -> str:
    return f", low-passed {cut_off:.0f} Hz" if np.isfinite(cut_off) else ""


def _spoken(which: object) -> str:
    if isinstance(which, dict):
        return ", ".join(f"{name} {pull:+g} std" for name, pull in which.items())
    return ", ".join(" ".join(map(str, one)) for one in which)


def found_shares(rows: Sequence[hidden_table.Row]) -> dict[str, tuple[float, int]]:
    """Shares of named effects, of robots without a wrong name and of right values, each with its number of cases."""
    pulls = np.abs(np.concatenate([[*row["pulls"].values()] for row in rows]))
    hidden = sum(row["hidden"] for row in rows)
    return {
        "named": (1.0 - sum(len(row["missed"]) for row in rows) / hidden, hidden),
        "nothing false": (float(np.mean([not row["false"] for row in rows])), len(rows)),
        "values": (float(np.mean(pulls < DEVIATIONS)), len(pulls)),
    }


def show(rows: Sequence[hidden_table.Row]) -> None:
    """Print the shares of all robots beside their targets, and the time."""
    print()
    second = float(np.mean([row["same after"] for row in rows])), len(rows)
    hidden_table.show_shares({**found_shares(rows), "second": second}, TARGETS)
    print(f"robots with everything named: {sum(not row['missed'] for row in rows)} of {len(rows)}")
    taken = [row["seconds"] for row in rows]
    print(f"seconds: median {np.median(taken):.1f}, worst {max(taken):.1f}")


def same_story(seed: int) -> None:
    """Print the results of one robot at every rate and length, in one run and in several."""
    robot = generated.generate(seed, story=True)
    truth, model = {(hidden.effect, hidden.joint) for hidden in robot.truth}, model_of(robot)
    print(f"{Path(robot.name).stem}: {_spoken(sorted(truth))}")
    stories = []
    for seconds in LENGTHS:
        for rate in generated.RATES:
            for count in COUNTS:
                begun = time.perf_counter()
                mended = repair(study_of(model, robot.cut(rate, seconds, count).runs(), False))
                missed, false = judged(mended, truth)
                stories.append((frozenset(missed), frozenset(false)))
                wrong = [f"{w}: {_spoken(sorted(x))}" for w, x in (("missed", missed), ("false", false)) if x]
                print(
                    f"{seconds:4.0f} s at {rate:4.0f} Hz in {count}: {'; '.join(wrong) or 'all of it'}, "
                    f"{mended.verdict.key}, {time.perf_counter() - begun:.0f} s", flush=True,
                )  # fmt: skip
    print(f"{len(set(stories))} different stories of {len(stories)}")


def exported_error(seed: int) -> tuple[float, float]:
    """Rms error of the exported and of the repaired model against the true torque on new motions [N m]."""
    robot = generated.generate(seed, effects=EXPORTED)
    mended = repair(study_of(model_of(robot), robot.runs(), robot.held_out)).model
    arm = mended.with_only_effects([effect.name for effect in mended.effects if effect.name not in OF_DRIVES])
    dynamics, compiled = inverse_dynamics_function(arm), mujoco.MjModel.from_xml_string(mujoco_text(mended)[0])
    data, squares = mujoco.MjData(compiled), []
    for world in robot.fresh():
        true = world.measured([hidden for hidden in robot.truth if hidden.effect not in OF_DRIVES])[1]
        for q, v, a, torque in zip(*world.motion.at(world.stamps), true, strict=True):
            data.qpos[:], data.qvel[:], data.qacc[:] = q, v, a
            mujoco.mj_inverse(compiled, data)
            own = np.asarray(dynamics(q, v, a))[:, 0]
            squares.append((np.sum((data.qfrc_inverse - torque) ** 2), np.sum((own - torque) ** 2)))
    there, own = np.sqrt(np.mean(squares, axis=0)).tolist()
    return there, own


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--robots", type=int, default=40)
    parser.add_argument("--same-story", action="store_true", help="one robot, every rate and length")
    parser.add_argument("--exports", action="store_true", help="repaired models in MuJoCo on new motions")
    parser.add_argument("--json", type=Path, default=None, help="every row")
    given = parser.parse_args()
    seeds = range(given.first_seed, given.first_seed + given.robots)
    if given.same_story:
        same_story(given.first_seed)
        return
    if given.exports:
        ratios = []
        for seed in seeds:
            there, own = exported_error(seed)
            ratios.append(there / own)
            print(f"{seed:5d}: {there:.4f} N m in MuJoCo, {own:.4f} N m the model: {ratios[-1]:.2f}", flush=True)
        print(f"within {CLOSE}: {sum(ratio <= CLOSE for ratio in ratios)} of {len(ratios)}")
        return
    rows: list[hidden_table.Row] = []
    for seed in seeds:
        rows.append(examine(seed))
        print(line(rows[-1]), flush=True)
        hidden_table.save(given.json, {"generated": rows})
    show(rows)


if __name__ == "__main__":
    main()
