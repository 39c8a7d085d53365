"""How often does `discover` find a law that no catalogue has? Prints a row for each hidden law; run it in pieces.

    python benchmarks/hidden/discover.py --seeds 5 --kinds magnet,cogging --out rows.jsonl

Recordings come from `tests/worlds/laws.py`, with physics of its own. After `discover` its file is written, read
as a user's, added with what else was found, and a run that took part in nothing is predicted: its error over the noise.
"""

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2] / "tests"))

from worlds.laws import CLEAN, LAWS, URDF, World, world

from armdyn.arm.model import arm_model
from armdyn.discovery.discover import discover
from armdyn.discovery.result import Discovery
from armdyn.effects.effect import Effect
from armdyn.effects.user import available_effects, load_effects
from armdyn.identify.repair import add
from armdyn.identify.residual.block import ResidualBlock
from armdyn.identify.studies import make_study
from armdyn.model import Model
from armdyn.pendulum.model import pendulum_model


def judged(kind: str, seed: int, folder: Path) -> dict:
    """Result for one hidden law: the found laws, and the error over the noise on the exam run."""
    given = world(kind, seed)
    model = _model(given, folder)
    start = time.process_time()
    found = discover(make_study(model, given.runs, [given.held_out], available_effects(model)))
    seconds = time.process_time() - start
    kinds = [one.kind for one in found.laws] + [one.known_as for one in found.laws if one.known_as]
    before, after = _errors(model, given, ()), _errors(model, given, effects_found(model, found, folder))
    return {
        "kind": kind, "seed": seed, "kinds": kinds, "before": before, "after": after,
        "right": kind in LAWS and bool(set(kinds) & set(LAWS[kind].names)), "new": len(found.laws_outside_catalogue),
        "found": [one.sentence for one in found.laws], "seconds": round(seconds),
    }  # fmt: skip


def _model(given: World, folder: Path) -> Model:
    if given.base == "pendulum":
        return pendulum_model(given.length, given.mass)
    path = folder / "two.urdf"
    path.write_text(URDF)
    return arm_model(urdf=path)


def effects_found(model: Model, found: Discovery, folder: Path) -> list[Effect]:
    """Found laws as effects to add, after their file was written to a folder and read as a user's file."""
    own: dict[str, Effect] = {}
    if found.laws_outside_catalogue:
        found.write(folder / "effect.py")
        own = {e.name: e for e in load_effects(folder / "effect.py", stages=None)}
    known = {e.name: e for e in available_effects(model)} | own
    return [known[o.effect].on(*o.joints) if o.joints else known[o.effect] for o in found.laws]


def _errors(model: Model, given: World, effects: list[Effect] | tuple[()]) -> float:
    """Largest error over the noise on the exam run, after `add` with some effects."""
    study = make_study(model, given.runs, [given.held_out], tuple(effects), [given.exam])
    return round(largest_error(study.exam_blocks(add(study, effects).steps[-1].fit)), 3)


def largest_error(blocks: Sequence[ResidualBlock]) -> float:
    """Largest root mean square error of a channel over its noise."""
    return max(float(np.sqrt(np.mean(block.residual**2))) for block in blocks)


def main() -> None:
    """Print a row for each law."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--kinds", default=",".join([*LAWS, *CLEAN]))
    parser.add_argument("--out", type=Path)
    chosen = parser.parse_args()
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for seed in range(chosen.first_seed, chosen.first_seed + chosen.seeds):
            for kind in chosen.kinds.split(","):
                row = judged(kind, seed, Path(folder))
                rows.append(row)
                print(json.dumps(row), flush=True)
                if chosen.out is not None:
                    with chosen.out.open("a") as stream:
                        stream.write(json.dumps(row) + "\n")
    laws = [row for row in rows if row["kind"] in LAWS]
    clean = [row for row in rows if row["kind"] in CLEAN]
    if laws:
        within = sum(row["after"] < 1.2 for row in laws)
        print(f"{within} of {len(laws)} within 1.2 of the noise; kind right in {sum(r['right'] for r in laws)}")
    if clean:
        print(f"something new in {sum(row['new'] > 0 for row in clean)} of {len(clean)} clean ones")


if __name__ == "__main__":
    main()
