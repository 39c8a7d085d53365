"""Are thresholds with an unknown place found in pendulums and arms, and none where there is none?

    python benchmarks/hidden/hidden_thresholds.py [--seeds N] [--clean N] [--first SEED]

A user's file of four effects with a place each (tests/worlds/thresholds.py) joins the whole catalogue. Two
recordings are fitted, one takes part in choosing. Right: the effect is named and nothing else, on its joint, and all of
its values are within three standard deviations. Every third clean recording is short, 5 s. Seeds below 100 were used to
build it. Bases of one's own: see hidden_effects_own.py.
"""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parents[1]))
import _hidden_table as hidden_table  # isort: skip
import _timing as bench  # isort: skip

import argparse
import time
from collections.abc import Sequence

from armdyn.arm.model import arm_model
from armdyn.effects.catalogue import CATALOGUE
from armdyn.identify.repair import Repair, repair
from armdyn.identify.studies import make_study
from armdyn.pendulum.model import pendulum_model

thresholds = hidden_table.generator("thresholds")

WITHIN = 3.0
"""Largest error of a right value in standard deviations."""
SHORT, LONG = 5.0, 15.0
"""Lengths of short and long recordings [s]."""


def repaired(one: "thresholds.Case") -> Repair:
    """Repair of a case."""
    model = pendulum_model(0.35, 0.1) if one.robot == "pendulum" else arm_model(robot="baxter")
    catalogue = [effect for effect in CATALOGUE.values() if effect.acts_on in model.stages]
    return repair(make_study(model, one.runs[:2], one.runs[2:], [*catalogue, *thresholds.effects(one.robot)]))


def counted(cases: Sequence["thresholds.Case"]) -> list[str]:
    """Row of the table; wrong results are printed."""
    ends, begun = list[str](), time.process_time()
    for one in cases:
        found = repaired(one)
        labels = [effect.label for effect in found.model_without_background.effects]
        tied = {name for step in found.path for name in step.tied_with}
        end = "named" if labels == one.labels else "tied" if one.hidden in {*tied, *labels} else "wrong"
        told = {
            n: (p.value - one.true[n]) / p.std
            for n, p in found.model_without_background.parameters.items()
            if n in one.true and p.std
        }
        sure = len(told) == len(one.true) and all(abs(off) <= WITHIN for off in told.values())
        ends.append("right" if end == "named" and sure else end)
        if ends[-1] != "right":
            off = {name: f"{x:+.1f}" for name, x in told.items()}
            print(f"  {one.robot} {one.seed} {one.hidden or 'nothing'}: {end} {labels}, off by {off} std", flush=True)
    counts = [len(ends), *(ends.count(end) for end in ("right", "named", "tied", "wrong"))]
    return [*map(str, counts), f"{(time.process_time() - begun) / max(len(ends), 1):.1f}"]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=3, help="of every threshold")
    parser.add_argument("--clean", type=int, default=30, help="of each robot")
    parser.add_argument("--first", type=int, default=100, help="seed of the first ones")
    parser.add_argument("--robots", default="pendulum,arm", help="with commas")
    given, rows = parser.parse_args(), []
    seeds = range(given.first, given.first + given.seeds)
    for robot, make, names in (
        ("pendulum", thresholds.of_pendulum, thresholds.OF_PENDULUM),
        ("arm", thresholds.of_arm, thresholds.OF_ARM),
    ):
        if robot not in given.robots.split(","):
            continue
        for name in names if given.seeds else ():
            rows.append([robot, name, *counted([make(name, seed) for seed in seeds])])
        if given.clean:
            clean = [make("", given.first + k, LONG if k % 3 else SHORT) for k in range(given.clean)]
            rows.append([robot, "nothing", *counted(clean)])
    headings = ["robot", "hidden", "cases", "right", "named, values off", "tied", "wrong", "cpu s"]
    bench.print_table("thresholds with an unknown place", headings, rows, texts=2)


if __name__ == "__main__":
    main()
