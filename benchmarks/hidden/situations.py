"""Does the first fit find the start of the swing in recordings of users, and is the right effect named?

    python benchmarks/hidden/situations.py --seeds 20 --first-seed 1000 --processes 2

Situations come from `tests/worlds/situations.py`, which shares no code with armdyn: pull and release with the
load cell alone, a release from 2 rad, a gripper that moves late, a start in mid-swing, gaps, spikes, and so on; each
with nothing hidden and with each of `EFFECTS`. Columns:

- start: the first fit of the true structure is as good as the fit that starts from the truth;
- reproduced: `compare` of the repaired model gives the error that `repair` left, to 1 % (with `--what repaired`);
- named, honest, false: the right name first; that, or a tie that holds it; a name where nothing or another effect is.
"""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parents[1]))
import _hidden_table as hidden_table  # isort: skip

import time
import zlib
from functools import cache

import numpy as np

from armdyn.effects.catalogue import CATALOGUE
from armdyn.identify.diagnose import diagnose
from armdyn.identify.repair import repair
from armdyn.identify.studies import make_study
from armdyn.identify.study import Study
from armdyn.pendulum.model import PendulumModel, pendulum_model

situations = hidden_table.generator("situations")

EFFECTS = ("pivot_viscous_friction", "quadratic_drag", "sensor_bias")
UNSEEN = {("release_unweighed", "sensor_bias")}
"""Undetermined effects by situation: a bias acts as mass where the load is not weighed."""
AS_GOOD = 1.02
"""Largest ratio of two chi2 of the same minimum."""
SAME_ERROR = 0.01


def recordings(name: str, effect: str, seed: int, keep: Path | None) -> tuple[object, dict[str, float]]:
    """Runs with the truth, and their hidden values; ``"none"`` hides nothing."""
    situation = situations.SITUATIONS[name]
    hidden = {} if effect == "none" else situations.realistic(effect, situation)
    file = None if keep is None else keep / f"{name}-{effect}-{seed}.pickle"
    rng = np.random.default_rng([seed, zlib.crc32(f"{name}{effect}".encode())])
    return hidden_table.kept(file, lambda: situations.recorded(situation, hidden, rng)), hidden


def study_of(model: PendulumModel, recorded: object) -> Study:
    return make_study(model, recorded.runs, [], hidden_table.PENDULUM_EFFECTS)


def given(name: str) -> PendulumModel:
    """Model that the user starts with: a length 5 % wrong, and a guessed mass."""
    situation = situations.SITUATIONS[name]
    return pendulum_model(0.95 * float(np.mean(situation.length)), 1.1 * float(np.mean(situation.mass)))


def start_found(name: str, recorded: object, hidden: dict[str, float]) -> hidden_table.Row:
    """Chi2 per sample of the true structure after its first fit, and after a fit that starts from the truth."""
    model = given(name)
    for effect in hidden:
        model = model.with_effect(CATALOGUE[effect])
    study = study_of(model, recorded)
    first = study.first()
    problem, truth = study.problem, study.problem.start_values()
    place = {run.name: k for k, run in enumerate(recorded.runs)}
    for j, column in enumerate(problem.columns):
        name = study.runs[column.run or 0].name
        k = place[name.partition("#")[0]]
        angle, rate = recorded.starts[k]
        path = recorded.runs[k].channels.get("gripper_x")
        speed = 0.0 if path is None else float(np.gradient(path.value[:3], path.time[:3])[0])
        true = {
            "length": recorded.length, "mass": recorded.masses[k], "initial_angle": angle,
            "initial_rate": rate - speed / recorded.length * np.cos(angle), **hidden,
        }  # fmt: skip
        later = column.run is not None and name not in place and not name.endswith("#1")
        truth[j] = first.values[j] if later else true.get(column.parameter.name.partition(".")[0], truth[j])
    wanted = problem.fitted & ~problem.mask_of_unknowns([n for c in study.candidates for n in c.names])
    best = problem.fit(wanted, truth)
    blocks = problem.blocks(best.values)
    reachable, reached = hidden_table.chi2_per_sample(blocks), first.chi2_per_sample
    return {"start": bool(reached <= max(1.2, AS_GOOD * reachable)), "reached": reached, "reachable": reachable}


def diagnosed(name: str, effect: str, seed: int, keep: Path | None) -> hidden_table.Row:
    """Row of the table for one situation with one hidden effect or none."""
    _warm()
    recorded, hidden = recordings(name, effect, seed, keep)
    wall, cpu = time.perf_counter(), time.process_time()
    study = study_of(given(name), recorded)
    found = diagnose(study)
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    first = found.ranked_effects[0] if found.ranked_effects else None
    row = {
        "what": name, "hidden": effect, "seed": seed, **start_found(name, recorded, hidden),
        "verdict": found.verdict.key, "first": first.effect if first else "", "tied": first.tied_with if first else (),
        "found": [e.label for e in found.search.last.effects], "base": found.search.steps[0].fit.chi2_per_sample,
        "chi2": found.search.last.fit.chi2_per_sample, "seconds": wall, "cpu": cpu,
    }  # fmt: skip
    named_any = found.verdict.key in ("effect_missing", "cannot_tell_apart")
    if effect == "none":
        return row | {"false": found.verdict.key != "explained"}
    judged = hidden_table.judged(found, effect)
    return row | judged | {"false": named_any and not judged["honest"]}


def repaired(name: str, effect: str, seed: int, keep: Path | None) -> hidden_table.Row:
    """Whether the model that `repair` writes has, on the same runs, the error that `repair` reports."""
    _warm()
    recorded, _ = recordings(name, effect, seed, keep)
    found = repair(study_of(given(name), recorded))
    again = study_of(found.model, recorded).first()
    left, now = found.after.fit.rmse(), again.rmse()
    same = all(abs(now[channel] - left[channel]) <= SAME_ERROR * left[channel] for channel in left)
    return {"what": name, "hidden": effect, "seed": seed, "reproduced": same, "left": left, "now": now}


@cache
def _warm() -> None:
    diagnose(study_of(given("plain"), recordings("plain", "pivot_viscous_friction", 0, None)[0]))


def main() -> None:
    options = hidden_table.parser(__doc__, "diagnosed", 3)
    options.add_argument("--recordings", type=Path, default=None, help="folder to keep recordings in")
    options.add_argument("--hidden", default="none," + ",".join(EFFECTS), help="effects, with commas")
    given_options = options.parse_args()
    names = given_options.only.split(",") if given_options.only else list(situations.SITUATIONS)
    seeds = hidden_table.seeds_of(given_options)
    keep: Path | None = given_options.recordings
    if keep is not None:
        keep.mkdir(parents=True, exist_ok=True)
    effects = given_options.hidden.split(",")
    cases = [
        (name, "angle_offset" if effect == "sensor_bias" and name == "near_upright" else effect, seed, keep)
        for name in names for effect in effects for seed in seeds if (name, effect) not in UNSEEN
    ]  # fmt: skip
    kinds = {"diagnosed": (diagnosed, cases), "repaired": (repaired, cases)}
    wanted = {what: kinds[what] for what in hidden_table.wanted(given_options.what, [*kinds])}
    hidden_table.run(wanted, given_options.processes, given_options.json)


if __name__ == "__main__":
    main()
