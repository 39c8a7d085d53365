"""Are all hidden effects found in an arm that records commands and positions of its drives, but no torque?

    python benchmarks/hidden/servo_arm.py --first-seed 0 --robots 40
    python benchmarks/hidden/servo_arm.py --first-seed 0 --robots 20 --exports

Recordings come from `tests/worlds/servo_arm.py`: five joints of four robots of example-robot-data, drives that
are told positions (half), velocities or torques, with a delay that nobody knows, a gain that nobody knows for those
that carry most, encoders of 4096 to 65536 steps, supplies that sag and drives that saturate; one to five effects on all
joints. Two runs of 20 s are fitted, one of another kind of motion is held out. The whole catalogue is tried. Nothing is
hidden that the motion does not show. What is counted:

- named: of all hidden effects, those that the repaired model has on their joints; ties and equal torques as in
  `generated_arm.py`.
- nothing false: arms whose repaired model has no other effect.
- values: of the effects that are named, and of gains and delays, those within three standard deviations of the truth.
- roll-out: arms whose motion in the held-out run, all joints together, is at most 1.2 times as far off as that of the
  truth itself: whole runs in closed loop, windows of 0.5 s where they are told no position.

`--exports` hides what MuJoCo can hold; the repaired model, without what it has not, goes to MuJoCo, and there moves as
it was told in the held-out run, at the file's own step: how far it is off, over how far the model itself is.
"""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parents[1]))
import _hidden_table as hidden_table  # isort: skip

import argparse
import time

import numpy as np
from generated_arm import DEVIATIONS, found_shares, judged

from armdyn.arm.closed_loop.rollout import simulated_position_errors, simulated_positions
from armdyn.arm.model import ArmModel
from armdyn.checked_study import CheckedStudy
from armdyn.effects.catalogue import CATALOGUE
from armdyn.errors import InputError
from armdyn.inspection.check import WrongRecordingError
from armdyn.run import Run
from pipeline.exports.mujoco_file import mujoco_text
from pipeline.exports.parts import MUJOCO_SLOTS, held_effects

generated = hidden_table.generator("servo_arm")
IN_MUJOCO = held_effects(CATALOGUE.values(), MUJOCO_SLOTS)
TARGETS = {"named": 0.95, "nothing false": 0.90, "values": 0.93, "roll-out": 1.0}
CLOSE, ALIKE = 1.2, 1.05
"""Largest error over that of the truth; largest error of an export over the model's own."""
in_mujoco = hidden_table.generator("servo_in_mujoco")


def off(model: ArmModel, run: Run) -> dict[str, float]:
    """Rms error of all joints together by kind of roll-out [rad]."""
    found = simulated_position_errors(model, [(run, "held_out")])
    kinds = {one.kind for one in found} - {"window_5"}  # a torque pulls nothing back
    return {
        kind: float(
            np.sqrt(np.mean([one.rms**2 if one.rms is not None else np.inf for one in found if one.kind == kind]))
        )
        for kind in kinds
    }


def examine(seed: int) -> hidden_table.Row:
    """Row of the table for one arm."""
    arm = generated.generate(seed)
    truth = {(e.name, j) for e in arm.truth.effects for j in e.joints or arm.truth.joints_effect_can_act_on(e)}
    begun = time.process_time()
    *training, held_out = arm.runs
    row = {"seed": seed, "robot": Path(arm.robot).stem, "law": arm.law, "hidden": len(truth)}
    try:
        found = CheckedStudy.of(arm.known, training, [held_out]).repair()
    except (InputError, WrongRecordingError) as error:
        return row | {
            "refused": str(error),
            "missed": sorted(truth),
            "false": [],
            "pulls": {},
            "roll-out": np.inf,
            "cpu": 0.0,
        }
    missed, false = judged(found, truth)
    named = found.model.without_background()
    pulls = {
        name: (named.parameters[name].value - p.value) / named.parameters[name].std
        for name, p in arm.truth.parameters.items()
        if name in named.names and named.parameters[name].std
    }
    for kind, servo in found.model.drives.items():
        true = arm.truth.drives[kind]
        if servo.gain.std is not None:
            pulls[f"gain of {kind}"] = (servo.gain.value - true.gain.value) / servo.gain.std
    own, best = off(found.model, held_out), off(arm.truth, held_out)
    return row | {
        "missed": sorted(missed), "false": sorted(false), "pulls": pulls,
        "own": own, "best": best, "roll-out": max(own[kind] / best[kind] for kind in best),
        "path": [(s.added, s.joints, s.tied_with) for s in found.path], "verdict": found.verdict.key,
        "cpu": time.process_time() - begun,
    }  # fmt: skip


def exported_errors(seed: int) -> list[float]:
    """Rms errors of the positions in the held-out run [rad]: MuJoCo's, and the model's own."""
    arm = generated.generate(seed, tuple(effect for effect in generated.EFFECTS if effect in IN_MUJOCO))
    *training, held_out = arm.runs
    mended = CheckedStudy.of(arm.known, training, [held_out], trusted=True).repair().model
    mended = mended.with_only_effects([effect.name for effect in mended.effects if effect.name in IN_MUJOCO])
    text = mujoco_text(mended)[0]
    there = in_mujoco.errors_in_mujoco(text, mended, held_out)
    own = [simulated_positions(mended, mended.theta(), w) - w.q for w in in_mujoco.stretches(mended, held_out)]
    return [float(np.sqrt(np.mean(errors**2))) for errors in (there, np.vstack(own))]


def line(row: hidden_table.Row) -> str:
    """Result of one arm in a line, with further lines for errors."""
    wrong = {name: round(pull, 1) for name, pull in row["pulls"].items() if abs(pull) > DEVIATIONS}
    text = (
        f"{row['seed']:5d} {row['robot'][:8]:8s} {row['law']:8s} {row['hidden'] - len(row['missed']):2d} of "
        f"{row['hidden']:2d} named, {len(row['false'])} false, {len(row['pulls']) - len(wrong)} of {len(row['pulls'])} "
        f"values, roll-out {row['roll-out']:.2f}, {row['cpu']:.0f} s"
    )
    more = {"missed": row["missed"], "false": row["false"], "values": wrong, "refused": row.get("refused")}
    return "\n".join([text, *(f"      {what}: {which}" for what, which in more.items() if which)])


def show(rows: list[hidden_table.Row]) -> None:
    """Print the shares of all arms beside their targets, and the time."""
    roll_out = float(np.mean([row["roll-out"] <= CLOSE for row in rows])), len(rows)
    hidden_table.show_shares({**found_shares(rows), "roll-out": roll_out}, TARGETS)
    print(f"seconds of processor time: median {np.median([row['cpu'] for row in rows]):.1f}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--robots", type=int, default=40)
    parser.add_argument("--exports", action="store_true", help="repaired models in MuJoCo, on new motions")
    parser.add_argument("--json", type=Path, default=None, help="every row")
    given = parser.parse_args()
    if given.exports:
        ratios = []
        for seed in range(given.first_seed, given.first_seed + given.robots):
            there, own = exported_errors(seed)
            ratios.append(there / own)
            print(
                f"{seed:5d}: {1e3 * there:.3f} mrad in MuJoCo, {1e3 * own:.3f} the model: {ratios[-1]:.3f}", flush=True
            )
        print(f"within {ALIKE}: {sum(ratio <= ALIKE for ratio in ratios)} of {len(ratios)}")
        return
    rows: list[hidden_table.Row] = []
    for seed in range(given.first_seed, given.first_seed + given.robots):
        rows.append(examine(seed))
        print(line(rows[-1]), flush=True)
        hidden_table.save(given.json, {"servo": rows})
    show(rows)


if __name__ == "__main__":
    main()
