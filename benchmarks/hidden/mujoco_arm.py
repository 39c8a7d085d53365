"""Does `repair` name what was hidden in arms that MuJoCo simulated? Prints a line for each arm, and totals.

    python benchmarks/hidden/mujoco_arm.py --arms 24 --first-seed 0 --kind ordinary
    python benchmarks/hidden/mujoco_arm.py --only 7 --kind ordinary

Arms come from `tests/worlds/mujoco_arm.py`: friction on most joints, rotors, loads and offsets, and descriptions of
which every second one is 5 to 10 % off (kind ordinary), or coloured torque noise (ar1), quantised positions (quantised)
or a force that no catalogue has (unknown). The repair is that of a command, with its inspection; all is counted from
the model that it writes. Two runs are fitted, one is held out, an exam with faster motion is seen by nothing.

What is counted:

- `right`: hidden values that are named, on their joint, with a value within 3 std or 10 %; a load's place within 10 %
  of its distance. Only visible effects count, see `NOISES` of the generator: torque above 3 times the noise, or above
  the noise and 3 % of the joint's error as described. An asymmetric or load friction in place of a Coulomb friction is
  wrong, but for an asymmetric one where a Coulomb friction and an offset were hidden: the two have the same torque.
  `named` are those with the right name, whatever the value.
- `empty`: named effects of which every parameter is within 2 std of null.
- `nameless`: effects of the background that are among the visible hidden ones, or whose torque is more than 10 % of
  their joint's error as described (root mean square in training).
- `false`: named effects, nothing like which was hidden there, that explain more than 1 % of the squared error of the
  model as described, summed over all joints. Frictions are alike, and where the description is off link inertias are
  not false. A link inertia on the last joint is like a load.
- `named only`: error of the named effects alone in the held-out run over that of the whole model.
- `held out`, `exam`: error of the written model over that of the true one, with the exact links and hidden values.
- `explained`: the verdict; wanted always for ar1 and quantised, never for unknown.
- `--given`: the hidden effects, and link inertias where the description is off, are added by name instead of searched
  for: what a repair can reach. No verdict but `explained` is one then, as nothing was searched.
- `refused`: arms that the inspection or the fit refuses. They count in nothing else.
"""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parents[1]))
import _hidden_table as hidden_table  # isort: skip

import argparse
import time
import warnings
from collections.abc import Mapping, Sequence
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from armdyn.arm.model import ArmModel, arm_model
from armdyn.checked_study import CheckedStudy
from armdyn.effects.catalogue import CATALOGUE
from armdyn.effects.effect import Effect
from armdyn.errors import ArmdynError
from armdyn.identify.repair import Repair
from armdyn.run import Run

mujoco_arm = hidden_table.generator("mujoco_arm")

STDS, CLOSE = 3.0, 0.1
"""A value is right within so many standard deviations, or this share of itself."""
EMPTY = 2.0
"""Standard deviations from null within which a value says nothing."""
LARGE_NAMELESS, LARGE_FALSE = 0.1, 0.01
"""Share of its joint's error, and of the squared error of all joints."""
FRICTIONS = ("joint_coulomb_friction", "joint_asymmetric_friction", "joint_load_friction", "joint_stribeck_friction")
ASYMMETRIC = "joint_asymmetric_friction"

Pair = tuple[str, str]


def squares(model: ArmModel, runs: Sequence[Run], other: ArmModel | None = None) -> np.ndarray:
    """(nj,) mean squares of the errors of a model, or of what it predicts other than another one, N^2 m^2."""
    found = np.zeros(len(model.joints))
    for run in runs:
        ready = model.prepare_run(run)
        predicted = model.predict(ready, model.theta())
        compared = None if other is None else other.predict(ready, other.theta())
        for name, rows in predicted.slices.items():
            reference = ready.channels[name].value if compared is None else compared.values[compared.slices[name]]
            error = predicted.values[rows] - reference
            found[model.joints.index(name.removeprefix("tau."))] += float(np.mean(error**2)) / len(runs)
    return found


def error(model: ArmModel, run: Run) -> float:
    """Root of the sum of the mean squared errors of all joints, N m."""
    return float(np.sqrt(squares(model, [run]).sum()))


def true_model(model: ArmModel, hidden: Sequence[Any]) -> ArmModel:
    """An exact model with the hidden effects at their values."""
    values: dict[str, float] = {}
    for one in hidden:
        model = model.with_effect(CATALOGUE[one.effect].on(one.joint))
        values |= {f"{one.effect}.{short}[{one.joint}]": value for short, value in one.values.items()}
    return model.with_values(values)


def pairs(model: ArmModel) -> list[Pair]:
    """Effects of a model, each with one of its joints."""
    return [(e.name, joint) for e in model.effects for joint in model.joints_having_effect(e.name)]


def torque_of(model: ArmModel, pair: Pair, runs: Sequence[Run]) -> np.ndarray:
    """(nj,) mean square of the torque of one effect on one joint of a model, N^2 m^2."""
    return squares(model, runs, model.without_effect(":".join(filter(None, pair))))


def same_torque(model: ArmModel, joint: str) -> dict[str, tuple[float, float]]:
    """Coulomb friction and offset of a joint that a model describes by an asymmetric friction, each with its std."""
    up, down = (model.parameters[f"{ASYMMETRIC}.{way}[{joint}]"] for way in ("positive", "negative"))
    std = 0.5 * float(np.hypot(up.std or 0.0, down.std or 0.0))
    half, offset = 0.5 * (up.value + down.value), 0.5 * (up.value - down.value)
    return {f"joint_coulomb_friction.torque[{joint}]": (half, std), f"torque_offset.torque[{joint}]": (offset, std)}


def told_values(model: ArmModel, hidden: Sequence[Any]) -> dict[str, tuple[float, float]]:
    """Values with their std that a model without background tells, by name."""
    told = {name: (p.value, p.std or 0.0) for name, p in model.parameters.items() if p.effect}
    there = {(one.effect, one.joint) for one in hidden}
    for joint in model.joints_having_effect(ASYMMETRIC):
        both = all((effect, joint) in there for effect in hidden_table.SAME_TORQUE[ASYMMETRIC])
        told |= same_torque(model, joint) if both else {}
    return told


def right_values(told: Mapping[str, tuple[float, float]], one: Any) -> dict[str, bool] | None:
    """Whether the values of a hidden effect, by short name, are right; None where it is not named."""
    distance = float(np.linalg.norm([one.values[axis] for axis in "xyz"])) if one.effect == "payload" else 0.0
    found = {}
    for short, value in one.values.items():
        name = f"{one.effect}.{short}[{one.joint}]"
        if name not in told:
            return None
        size = distance if short in ("x", "y", "z") else abs(value)
        found[short] = abs(told[name][0] - value) <= max(STDS * told[name][1], CLOSE * size)
    return found


def is_empty(model: ArmModel, pair: Pair) -> bool:
    """Whether every fitted parameter of an effect on a joint is within its uncertainty of null."""
    own = [model.parameters[name] for name in model.parameter_names_by_joint(pair[0])[pair[1]]]
    known = [p for p in own if p.std is not None]
    return bool(known) and all(abs(p.value - p.null) <= EMPTY * (p.std or 0.0) for p in known)


def is_like_hidden(pair: Pair, arm: Any) -> bool:
    """Whether something like an effect on a joint was hidden there."""
    effect, joint = pair
    here = {one.effect for one in arm.hidden if one.joint == joint}
    if effect in here or (effect in FRICTIONS and here.intersection(FRICTIONS)):
        return True
    return effect == "link_inertia" and (arm.off or "payload" in here)


def judged(arm: Any, given: ArmModel, exact: ArmModel, mended: Repair) -> hidden_table.Row:
    """What is counted."""
    model, train, held_out, exam = mended.model, list(arm.runs[:2]), arm.runs[2], arm.runs[3]
    assert isinstance(model, ArmModel)
    bare = model.without_background()
    visible = [one for one in arm.hidden if one.visible]
    named = pairs(bare)
    unnamed = [pair for pair in pairs(model) if pair not in named]
    told = told_values(bare, arm.hidden)
    values = {(one.effect, one.joint): right_values(told, one) for one in visible}
    size = {pair: torque_of(model, pair, train) for pair in [*named, *unnamed]}
    misfit = arm.misfit**2
    truth = true_model(exact, arm.hidden)
    alone = mended.model_without_background
    assert isinstance(alone, ArmModel)
    whole = error(model, held_out)
    wrong = [pair for pair in named if not is_like_hidden(pair, arm)]
    return {
        "values": {":".join(pair): found for pair, found in values.items()},
        "hidden": sum(len(one.values) for one in visible),
        "named": sum(len(found) for found in values.values() if found is not None),
        "right": sum(sum(found.values()) for found in values.values() if found is not None),
        "empty": [pair for pair in named if is_empty(model, pair)],
        "nameless": [p for p in unnamed if p in values or np.any(size[p] > LARGE_NAMELESS**2 * misfit)],
        "false": [pair for pair in wrong if size[pair].sum() > LARGE_FALSE * misfit.sum()],
        "other names": [pair for pair in named if pair not in {(one.effect, one.joint) for one in arm.hidden}],
        "named only": error(alone, held_out) / whole,
        "named as written": error(bare, held_out) / whole,
        "held out": whole / error(truth, held_out), "exam": error(model, exam) / error(truth, exam),
        "as given": error(given, held_out) / error(truth, held_out),
        "background": len(model.background.names) if model.background is not None else 0,
    }  # fmt: skip


def hidden_effects(arm: Any) -> list[Effect]:
    """What was hidden, each effect on all of its joints, and link inertias where the description is off."""
    joints: dict[str, list[str]] = {}
    for one in arm.hidden:
        joints.setdefault(one.effect, []).append(one.joint)
    links = [CATALOGUE["link_inertia"]] if arm.off else []
    return [*(CATALOGUE[effect].on(*where) for effect, where in joints.items()), *links]


def examine(
    seed: int, kind: str, sticking: bool = False, kept: Path | None = None, known: bool = False, tell: bool = False
) -> hidden_table.Row:
    """Row of the table for one arm, which is kept in a folder for the next time; `known`: see `--given`."""
    warnings.simplefilter("ignore")
    file = None if kept is None else kept / f"{kind}{'_sticking' * sticking}_{seed}.pickle"
    arm = hidden_table.kept(file, lambda: mujoco_arm.generate(seed, kind, sticking=sticking))
    row: hidden_table.Row = {
        "seed": seed, "kind": kind, "robot": arm.robot, "off": arm.off, "stiff": arm.stiff, "rate": arm.rate,
        "resolution": arm.resolution, "unknown": arm.unknown,
    }  # fmt: skip
    with TemporaryDirectory() as folder:
        given, exact = (
            _model(Path(folder) / f"{name}.urdf", text, arm.joints)
            for name, text in (("given", arm.description), ("exact", arm.exact))
        )
        begun, cpu = time.perf_counter(), time.process_time()
        try:
            study = CheckedStudy.of(given, arm.runs[:2], arm.runs[2:3])
            mended = study.add(hidden_effects(arm)) if known else study.repair()
        except ArmdynError as refusal:
            return row | {"refused": str(refusal), "cpu": time.process_time() - cpu}
        row |= {"cpu": time.process_time() - cpu, "seconds": time.perf_counter() - begun}
        row |= {"verdict": mended.verdict.key, "sentence": mended.sentence}
        row |= {"steps": [[list(step.added), list(step.joints)] for step in mended.path[1:]]}
        row |= judged(arm, given, exact, mended)
        if tell:
            show_one(arm, mended, row)
    return row


def _model(path: Path, text: str, joints: tuple[str, ...]) -> ArmModel:
    path.write_text(text)
    return arm_model(urdf=path, joints=joints)


def show_one(arm: Any, mended: Repair, row: Mapping[str, Any]) -> None:
    """Print the sentence, the steps, and what was hidden beside what the model says."""
    print(mended.sentence)
    for step in mended.path:
        print(f"  + {', '.join(step.added) or 'as given':60s} {', '.join(step.joints):60s}")
    model = mended.model
    bare = model.without_background()
    for one in arm.hidden:
        for short, value in one.values.items():
            name = f"{one.effect}.{short}[{one.joint}]"
            place = "named" if name in bare.names else "background" if name in model.names else "absent"
            found = _number(model, name) if name in model.names else ""
            right = (row["values"].get(f"{one.effect}:{one.joint}") or {}).get(short)
            judged_so = "" if right is None else "right" if right else "WRONG"
            seen = "" if one.visible else "not visible, "
            print(f"  {name:56s}{value:10.4g}  {found:21s}  {place:10s}  {judged_so:5s}  {seen}rms {one.size:.3g} N m")
    truth = {(one.effect, one.joint) for one in arm.hidden}
    for name, p in bare.parameters.items():
        if (p.effect, p.joint) not in truth:
            print(f"  {name:56s}{'':10s}  {_number(bare, name):21s}  beside the truth")
    for key in ("empty", "nameless", "false"):
        print(f"  {key}: {row[key]}")


def _number(model: ArmModel, name: str) -> str:
    parameter = model.parameters[name]
    return f"{parameter.value:10.4g} ± {np.nan if parameter.std is None else parameter.std:8.2g}"


def line(row: Mapping[str, Any]) -> str:
    """One arm."""
    kinds = f"{'off' if row['off'] else 'exact':6s}{'stiff' if row['stiff'] else 'soft':6s}"
    what = f"{row['seed']:4d} {row['robot']:7s}{kinds}{row['rate']:4.0f} Hz {1e3 * row['resolution']:5.2f} mrad  "
    if "refused" in row:
        return f"{what} refused: {row['refused']}"
    return what + (
        f"right {row['right']:3d} named {row['named']:3d} of {row['hidden']:3d}  empty {len(row['empty']):2d}  "
        f"nameless {len(row['nameless']):2d}  false {len(row['false']):2d}  named only {row['named only']:5.2f}  "
        f"held out {row['held out']:5.2f}  exam {row['exam']:5.2f}  cpu {row['cpu']:5.1f} s  {row['verdict']}"
        + (f"  ({row['unknown'][0]}: {100 * row['unknown'][1]:.0f} % unknown)" if row["unknown"] else "")
    )


def show(kind: str, rows: Sequence[hidden_table.Row]) -> None:
    """Print a line for each arm, then totals beside their targets."""
    print(f"\n{kind}: {len(rows)} arms")
    for row in rows:
        print(line(row))
    told = [row for row in rows if "refused" not in row]
    print(f"  refused {len(rows) - len(told)} of {len(rows)}")
    if not told:
        return
    hidden = sum(row["hidden"] for row in told)
    for key, target in (("right", "95 %"), ("named", "")):
        share = sum(row[key] for row in told) / hidden
        print(f"  {key} {100 * share:.1f} % of {hidden} hidden values{f', wanted {target}' if target else ''}")
    for key in ("empty", "nameless"):
        print(f"  {key} {sum(len(row[key]) for row in told)}, wanted 0")
    print(f"  arms with a false name {sum(bool(row['false']) for row in told)} of {len(told)}, wanted 1 in 20")
    for key in ("named only", "named as written", "held out", "exam", "cpu"):
        values = [row[key] for row in told]
        print(f"  {key}: median {np.median(values):.2f}, worst {max(values):.2f}")
    explained = sum(row["verdict"] == "explained" for row in told)
    wanted = {"ar1": ", wanted 95 %", "quantised": ", wanted 95 %", "unknown": ", wanted 0"}.get(kind, "")
    print(f"  explained {explained} of {len(told)}{wanted}", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--arms", type=int, default=24)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--kind", choices=mujoco_arm.KINDS, default="ordinary")
    parser.add_argument("--sticking", action="store_true", help="as much Coulomb friction as ordinary arms, any kind")
    parser.add_argument("--only", type=int, default=None, help="one seed, told at length")
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--given", action="store_true", help="add the hidden effects by name instead of searching")
    parser.add_argument("--kept", type=Path, default=None, help="folder of simulated arms, to be read the next time")
    parser.add_argument("--out", type=Path, default=None, help="JSON of every row")
    given = parser.parse_args()
    seeds = range(given.first_seed, given.first_seed + given.arms) if given.only is None else [given.only]
    if given.kept is not None:
        given.kept.mkdir(parents=True, exist_ok=True)
    cases = [(seed, given.kind, given.sticking, given.kept, given.given, given.only is not None) for seed in seeds]
    rows: list[hidden_table.Row] = []
    for row in hidden_table.answered(examine, cases, given.processes):
        rows.append(row)
        print(line(row), flush=True)
        hidden_table.save(given.out, {given.kind: rows})
    if given.only is None:
        show(given.kind, rows)


if __name__ == "__main__":
    main()
