"""Tools behind a force/torque sensor that MuJoCo simulates: does a repair name what is wrong? Prints a table.

    python benchmarks/wrench_mujoco.py --seeds 30 --processes 2

The tools are those of `tests/worlds/tools.py`: a body of 0.4 to 3 kg that the model does not have, on a UR5 with noisy
readings, and faults of its sensor. Two recordings of 20 s are fitted, and one is held out.

- `wrench`: positions and a wrench, as of a UR; one or two faults of the sensor.
- `torques`: the same with joint torques beside the wrench.
- `clean`: positions and a wrench, and a tool that the description has: nothing is wrong.
- `servo`: positions, their commands and a wrench of four robots that MuJoCo moves by position actuators, with hidden
  friction and one or two faults of the sensor; `servo_clean`: friction alone is hidden (`tests/worlds/servo_tools.py`).

Counted are: named, every hidden effect; alone, nothing else is named; mass within 1 % and centre within 2 mm, where
they are determined (where three standard deviations are less than that); refused, recordings that count as wrong.
"""

import argparse
import json
import tempfile
import time
import warnings
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import _hidden_table as hidden_table
import numpy as np

from armdyn.checked_study import CheckedStudy
from armdyn.inspection.check import WrongRecordingError

worlds = hidden_table.generator("tools")
servos = hidden_table.generator("servo_tools")

RUNS, HELD_OUT = 2, 5
MASS, CENTRE, SURE = 0.01, 2e-3, 3.0  # share; m; standard deviations
TOOL = {"payload", "payload_inertia"}


def repaired(kind: str, seed: int, joints: int | None = None) -> dict[str, Any]:
    """One row: what was hidden in a tool of a seed, and what was found; a servo arm has all or its first `joints`."""
    warnings.simplefilter("ignore")
    clean, friction = kind.endswith("clean"), set[str]()
    with tempfile.TemporaryDirectory() as folder:
        if kind.startswith("servo"):
            arm = servos.generate(seed, clean=clean, count=joints)
            tool, runs, model = arm.tool, arm.runs, arm.model(Path(folder))
            friction = {"joint_viscous_friction"} | ({"joint_coulomb_friction"} if arm.dry.any() else set())
        else:
            tool = replace(worlds.drawn(seed), faults={}) if clean else worlds.drawn(seed)
            runs = [worlds.recorded(tool, 10 * seed + k, torques=kind == "torques") for k in (*range(RUNS), HELD_OUT)]
            file = Path(folder) / "arm.urdf"
            file.write_text(worlds.description(tool), encoding="utf-8")
            model = worlds.sensed_model(file if clean else None)
        row: dict[str, Any] = {"kind": kind, "seed": seed, "hidden": sorted(tool.faults)}
        begun = time.process_time()
        try:
            found = CheckedStudy.of(model, runs[:RUNS], runs[RUNS:]).repair()
        except WrongRecordingError as error:
            return row | {"refused": str(error)}
    names = {effect.name for effect in found.model.named_effects}
    own = set() if clean else TOOL
    hidden = set(tool.faults) | friction
    row |= {
        "found": sorted(names - own), "verdict": found.verdict.name, "cpu": time.process_time() - begun,
        "named": hidden | ({"payload"} & own) <= names, "alone": names <= hidden | own,
        "chi2": found.steps[-1].fit.chi2_per_sample,
    }  # fmt: skip
    joint = found.model.joints[-1]
    values = [found.model.parameters.get(f"payload.{name}[{joint}]") for name in ("mass", "x", "y", "z")]
    if own and all(p is not None and p.std is not None for p in values):
        mass, *centre = values
        if SURE * mass.std < MASS * tool.mass:
            row["mass"] = bool(abs(mass.value - tool.mass) < MASS * tool.mass)
        sure = [p.std * SURE < CENTRE for p in centre]
        if all(sure):
            row["centre"] = bool(np.all(np.abs([p.value for p in centre] - tool.centre) < CENTRE))
        row["error"] = [value.value - true for value, true in zip(values, [tool.mass, *tool.centre], strict=True)]
        row["off"] = [(p.value - true) / p.std for p, true in zip(values, [tool.mass, *tool.centre], strict=True)]
    return row


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=30, help="of each kind; two thirds of it for clean ones")
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--what", default="wrench,torques,clean")
    parser.add_argument("--joints", type=int, default=None, help="of servo arms, from the base; all of them by default")
    parser.add_argument("--json", type=Path, default=None, help="every row")
    args = parser.parse_args()
    counts = {kind: args.seeds if not kind.endswith("clean") else 2 * args.seeds // 3 for kind in args.what.split(",")}
    cases = [(kind, args.first_seed + k, args.joints) for kind, count in counts.items() for k in range(count)]
    with ProcessPoolExecutor(args.processes) as pool:
        rows = []
        for row in pool.map(repaired, *zip(*cases, strict=True)):
            rows.append(row)
            print(json.dumps(row, default=float), flush=True)
            if args.json is not None:
                args.json.write_text(json.dumps(rows, default=float), encoding="utf-8")
    print("\n| kind | tools | named | alone | mass | centre | refused | CPU s |\n|---|---|---|---|---|---|---|---|")
    for kind in args.what.split(","):
        own = [row for row in rows if row["kind"] == kind]
        each = {name: [row[name] for row in own if name in row] for name in ("named", "alone", "mass", "centre", "cpu")}
        shares = [f"{sum(each[name])} of {len(each[name])}" for name in ("named", "alone", "mass", "centre")]
        refused = sum("refused" in row for row in own)
        print(f"| {kind} | {len(own)} | {' | '.join(shares)} | {refused} | {np.median(each['cpu'] or [0.0]):.0f} |")


if __name__ == "__main__":
    main()
