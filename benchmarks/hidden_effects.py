"""How often does `diagnose` find a hidden effect? Prints a table; run it on one core, in pieces if need be.

    python benchmarks/hidden_effects.py --seeds 20 --what single,tenth,clean,coloured,pairs,outside,encoder

Recordings come from `tests/hidden_effects/pendulum.py`, which shares no code with armdyn: two runs of 15 s at 100 Hz,
force noise 3 mN, random motion, start, mass (60 to 120 g, weighed to 0.5 %) and length (0.30 to 0.45 m, measured to
1 mm).
"""

import argparse
import importlib.util
import json
import os
import sys
import time
from collections.abc import Iterator
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from armdyn.effects.catalogue import CATALOGUE
from armdyn.identify.diagnose import Diagnosis, diagnose
from armdyn.identify.repair import repair
from armdyn.identify.study import Study
from armdyn.pendulum.model import pendulum_model
from armdyn.run import Run
from armdyn.units import Known

_PATH = Path(__file__).parents[1] / "tests/hidden_effects/pendulum.py"
_SPEC = importlib.util.spec_from_file_location("hidden_pendulum", _PATH)
assert _SPEC is not None
assert _SPEC.loader is not None
hidden_pendulum = importlib.util.module_from_spec(_SPEC)
sys.modules["hidden_pendulum"] = hidden_pendulum
_SPEC.loader.exec_module(hidden_pendulum)

PENDULUM = tuple(effect for effect in CATALOGUE.values() if effect.acts_on != "joint")
OUTSIDE = {"one_sided_rub": 4e-3, "hum": 0.01, "magnet": 0.1}
PAIRS = (
    ("quadratic_drag", "sensor_delay"), ("pivot_coulomb_friction", "quadratic_drag"), ("gripper_lag", "sensor_bias"),
    ("linear_drag", "load_inertia"), ("cross_axis_sensitivity", "sensor_drift"), ("sensor_nonlinearity", "gripper_bob"),
)  # fmt: skip
EQUIVALENT = {"wind": {"path_tilt"}, "path_tilt": {"wind"}}


def recordings(seed: int, hidden: dict[str, float], **settings: float) -> tuple[list[Run], float, float]:
    rng = np.random.default_rng(seed)
    mass, length = rng.uniform(0.06, 0.12), rng.uniform(0.30, 0.45)
    weighed = Known(mass * (1 + 0.005 * rng.normal()), 0.005 * mass, "kg")
    measured = Known(length + 1e-3 * rng.normal(), 1e-3, "m")
    runs = []
    for k in range(2):
        setup = hidden_pendulum.Setup(
            length=length, mass=mass, hidden=hidden, start=(0.02 * rng.normal(), 0.04 * rng.normal()), **settings
        )
        runs.append(hidden_pendulum.weighed(hidden_pendulum.record(f"r{k}.csv", setup, rng), weighed, measured))
    return runs, length, mass


def study_of(runs: list[Run]) -> Study:
    return Study(pendulum_model(0.35, 0.1), runs, [], PENDULUM)


def judged(found: Diagnosis, truth: str) -> tuple[bool, bool]:
    """Right first name; right first name or an honest tie that contains it."""
    if not found.suspects or found.verdict.key not in ("effect_missing", "cannot_tell_apart"):
        return False, False
    first = found.suspects[0]
    named = first.effect == truth
    tie = found.verdict.key == "cannot_tell_apart" and truth in first.tied_with
    return named, named or tie


def singles(seeds: int, scale: float, names: list[str]) -> Iterator[dict]:
    for name in names:
        for seed in range(seeds):
            size = hidden_pendulum.REALISTIC[name] * scale
            runs, _, _ = recordings(1000 + seed, {name: size})
            begun = time.perf_counter()
            found = diagnose(study_of(runs))
            named, honest = judged(found, name)
            row = {
                "what": name, "seed": seed, "verdict": found.verdict.key, "named": named, "honest": honest,
                "tie": found.verdict.key == "cannot_tell_apart", "seconds": time.perf_counter() - begun,
                "first": found.suspects[0].effect if found.suspects else "",
                "last": found.search.last.fit.chi2_per_sample,
            }  # fmt: skip
            if scale == 1.0 and found.suspects and named:
                parameter = next(iter(found.suspects[0].parameters.values()))
                true = size**2 if name == "out_of_plane_swing" else size
                if parameter.std:
                    row["pull"] = (parameter.value - true) / parameter.std
            yield row


def clean(seeds: int, **settings: float) -> Iterator[dict]:
    for seed in range(seeds):
        runs, _, _ = recordings(2000 + seed, {}, **settings)
        found = diagnose(study_of(runs))
        first = found.suspects[0].effect if found.suspects else ""
        yield {
            "what": "none",
            "seed": seed,
            "verdict": found.verdict.key,
            "false": found.verdict.key != "explained",
            "first": first,
        }


def pairs(seeds: int) -> Iterator[dict]:
    for one, two in PAIRS:
        for seed in range(seeds):
            sizes = {name: hidden_pendulum.REALISTIC[name] for name in (one, two)}
            runs, _, _ = recordings(3000 + seed, sizes)
            found = repair(study_of(runs))
            names = {effect.name for effect in found.model.effects}
            tied = {t for rung in found.ladder for t in rung.tied_with}
            held_out = [c.chi2_per_sample for c in found.after.channels.values()]
            yield {
                "what": f"{one}+{two}",
                "seed": seed,
                "exact": names == {one, two},
                "honest": names == {one, two} or {one, two} <= names | tied,
                "found": sorted(names),
                "chi2": held_out[0],
            }


def outside(seeds: int) -> Iterator[dict]:
    for name, size in OUTSIDE.items():
        for seed in range(seeds):
            runs, _, _ = recordings(4000 + seed, {name: size})
            found = diagnose(study_of(runs))
            yield {
                "what": name,
                "seed": seed,
                "flagged": found.verdict.key == "unknown_effect",
                "verdict": found.verdict.key,
                "sentence": found.sentence,
                "chi2": found.comparison.fit.chi2_per_sample,
            }


def share(rows: list[dict], key: str) -> str:
    values = [bool(row[key]) for row in rows if key in row]
    return f"{100 * np.mean(values):5.1f} %" if values else "  –"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--what", default="single,clean")
    parser.add_argument("--only", default="", help="effects, with commas")
    parser.add_argument("--json", type=Path, default=None)
    given = parser.parse_args()
    names = given.only.split(",") if given.only else list(hidden_pendulum.REALISTIC)
    everything: dict[str, list[dict]] = {}
    for what in given.what.split(","):
        maker = {
            "single": lambda: singles(given.seeds, 1.0, names), "tenth": lambda: singles(given.seeds, 0.1, names),
            "clean": lambda: clean(given.seeds), "coloured": lambda: clean(given.seeds, correlation=0.8),
            "encoder": lambda: clean(given.seeds, encoder_noise=2e-4), "pairs": lambda: pairs(given.seeds),
            "outside": lambda: outside(given.seeds),
        }[what]  # fmt: skip
        rows = everything[what] = []
        for row in maker():
            rows.append(row)
            if row.get("false") or row.get("honest") is False or row.get("flagged") is False:
                print("   miss:", {k: v for k, v in row.items() if k not in ("seconds",)}, flush=True)
        print(f"\n{what}: {len(rows)} cases")
        for name in dict.fromkeys(row["what"] for row in rows):
            mine = [row for row in rows if row["what"] == name]
            keys = [k for k in ("named", "honest", "tie", "false", "exact", "flagged") if k in mine[0]]
            print(f"  {name:44s}" + "  ".join(f"{key} {share(mine, key)}" for key in keys), flush=True)
        for key in ("named", "honest", "false", "exact", "flagged"):
            if any(key in row for row in rows):
                print(f"  all: {key} {share(rows, key)}")
        untied = [row for row in rows if row.get("tie") is False]
        if untied:
            print(f"  where no tie was reported: named {share(untied, 'named')}")
        pulls = [abs(row["pull"]) for row in rows if "pull" in row]
        if pulls:
            print(f"  true value within 3 std: {100 * np.mean(np.array(pulls) < 3):.1f} % of {len(pulls)}")
        seconds = [row["seconds"] for row in rows if "seconds" in row]
        if seconds:
            print(f"  seconds per diagnosis: median {np.median(seconds):.2f}, worst {np.max(seconds):.2f}", flush=True)
    if given.json is not None:
        given.json.write_text(json.dumps(everything, indent=1, default=float))


if __name__ == "__main__":
    main()
