"""Are hidden effects of a pendulum named in recordings as people make them, and do fits reach the true model?

    python benchmarks/hidden/imperfect_pendulum.py --seeds 40 --first-seed 0 --what names,clean,fits --processes 2

Recordings come from `tests/worlds/imperfect_pendulum.py`, which shares no code with armdyn: decays and driven
swings by video, encoder, potentiometer, gyro and load cell, from 0.15 rad to nearly upside down, with true dry friction
and the faults of real sensors. Kinds of cases and columns:

- `names`: one or two effects are hidden, over imperfections. named: the first name is what explains most, or an honest
  tie holds it; set: `repair` finds every effect and at most one value more; exam: its error in a run that took part in
  nothing is at most 1.1 times that of the true structure, fitted by output error of the generator's own physics started
  at the truth.
- `clean`: nothing is hidden under white noise. false: something is named.
- `fits`: one or two frictions are hidden under white noise. truth: `add` of them reaches 1.05 times the noise; wrong:
  `add` of a single friction that is not there reaches 1.05 times what output error started at the truth reaches.

An effect that the data cannot tell from the hidden one counts as right, such as linear drag for the viscous friction of
a fixed pivot. Imperfections that bear an effect's name (a small offset or skew) are neither asked for nor counted as
wrong. Worlds that hide what the catalogue lacks are left out and counted. An exception is a failure of every column.
"""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parents[1]))
import _hidden_table as hidden_table  # isort: skip
import _timing as bench  # isort: skip

import argparse
import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache

import numpy as np

from armdyn.effects.catalogue import CATALOGUE
from armdyn.identify.diagnose import diagnose
from armdyn.identify.repair import add, repair
from armdyn.identify.studies import make_study
from armdyn.identify.study import Study
from armdyn.model import Model
from armdyn.pendulum.model import pendulum_model

imperfect = hidden_table.generator("imperfect_pendulum")
output_error = hidden_table.generator("output_error")

CLOSE = 1.1
"""Largest exam error of a good repair over that of the true structure."""
REACHED = 1.05
"""Largest error of a good fit over the least error that it can reach."""
SPARE = 1
"""Largest number of values that a good repair adds beyond the true ones."""
WRONG_SIZES = np.geomspace(1e-3, 3.0, 15)
"""Start values of an absent friction in an output-error fit, in units of `accelerating`."""
QUICK = {"names": (1, 4), "clean": (1,), "fits": (4,)}
"""Seeds of `--quick` by kind."""
WANTED = {
    ("names", "named"): ("the first name is right, or an honest tie", 0.95),
    ("names", "set"): ("the whole set, with at most one value too many", 0.85),
    ("names", "exam"): (f"the exam's error is at most {CLOSE} of the true structure's", 0.90),
    ("clean", "quiet"): ("no name where nothing is hidden", 0.99),
    ("fits", "truth"): (f"the true effects reach {REACHED} of the noise", 0.98),
    ("fits", "wrong"): (f"a wrong friction reaches {REACHED} of what output error reaches", 0.98),
}  # fmt: skip
"""Claims by kind and column: the text and the least share of the cases."""


def named(world: object) -> hidden_table.Row:
    """First name by `diagnose`, and last model of `repair`, as a row of the table."""
    truth = [world.alike[effect] | {effect} for effect in world.hidden]
    first = set().union(*(world.alike[effect] | {effect} for effect in world.first))
    study = _study(world, exam=True)
    begun = time.process_time()
    found = diagnose(study)
    cpu = time.process_time() - begun
    leading = found.ranked_effects[0] if found.ranked_effects else None
    tie = found.verdict.key == "cannot_tell_apart"
    says = leading is not None and (tie or found.verdict.key == "effect_missing")
    row: hidden_table.Row = {
        "cpu": cpu, "verdict": found.verdict.key, "first": leading.effect if leading and says else "",
        "tied": list(leading.tied_with) if leading and tie else [], "sentence": found.sentence,
        "named": says and bool(first & {leading.effect, *(leading.tied_with if tie else ())}),
    }  # fmt: skip
    mended = repair(study)
    added = [effect for effect in mended.model.effects if effect.name not in world.background]
    beside = {e for step in mended.path for e in step.tied_with}
    right = [any(e.name in names for e in added) or bool(names & beside) for names in truth]
    known = set().union(*truth)
    extra = sum(len(e.parameters()) for e in added if e.name not in known | beside)
    extra += max(0, sum(e.name in known | beside for e in added) - len(truth))
    exam = _root(mended.path[-1].exam_rmse)
    best = output_error.fitted(world.pendulum, tuple(world.hidden), world.records["run"])
    reference = _mean(output_error.predicted(best.pendulum, world.records["exam"]))
    return row | {
        "found": sorted(e.name for e in mended.model.effects), "extra": extra, "set": all(right) and extra <= SPARE,
        "exam_error": exam, "exam_truth": reference, "exam": exam <= CLOSE * reference,
        "values": _values(world, mended.model),
    }  # fmt: skip


def quiet(world: object) -> hidden_table.Row:
    """Row of the table without a hidden effect: whether an effect is named."""
    begun = time.process_time()
    found = diagnose(_study(world))
    said = found.ranked_effects[0].effect if found.ranked_effects else ""
    silent = found.verdict.key == "explained"
    return {"cpu": time.process_time() - begun, "verdict": found.verdict.key, "first": said, "quiet": silent}


def reached(world: object) -> hidden_table.Row:
    """Errors of `add` with the true effects and with an absent friction, as a row of the table."""
    (noise,), records = world.noise.values(), world.records["run"]
    begun = time.process_time()
    error = _added(world, tuple(world.hidden))
    row: hidden_table.Row = {
        "cpu": time.process_time() - begun, "error": error, "noise": noise, "truth": error <= REACHED * noise
    }  # fmt: skip
    if world.wrong:
        best = _mean(_best_with(world.pendulum, world.wrong, records))
        other = _added(world, (world.wrong,))
        row |= {"wrong_effect": world.wrong, "wrong_error": other, "wrong_best": best, "wrong": other <= REACHED * best}
    return row


def _best_with(pendulum: object, effect: str, records: Sequence[object]) -> object:
    """Output-error fit of one effect alone, best of many start sizes, from the true length and start of the swing."""
    unit = output_error.accelerating(pendulum, effect)
    tried = [replace(pendulum, effects={effect: size * unit}) for size in WRONG_SIZES]
    tried.sort(key=lambda start: _mean(output_error.predicted(start, records, steps=0)))
    return min((output_error.fitted(start, (effect,), records, steps=40) for start in tried[:3]), key=_mean)


KINDS: Mapping[str, Callable[[object], hidden_table.Row]] = {"names": named, "clean": quiet, "fits": reached}


def case(what: str, seed: int) -> hidden_table.Row:
    """Row of the table for one world, also where an error occurs."""
    _warm()
    world = imperfect.world(seed, what)
    row: hidden_table.Row = {
        "what": world.kind, "seed": seed, "hidden": list(world.hidden), "visible": dict(world.visible),
        "leads": list(world.first), "alike": {k: sorted(v) for k, v in world.alike.items()},
    }  # fmt: skip
    if not world.hidden.keys() <= CATALOGUE.keys():
        return row | {"skipped": True}
    begun = time.process_time()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return row | KINDS[what](world)
    except Exception as error:  # the product failed, and a user has nothing
        failed = {column: False for kind, column in WANTED if kind == what}
        return row | failed | {"cpu": time.process_time() - begun, "failed": f"{type(error).__name__}: {error}"}


@cache
def _warm() -> None:
    """Derive the equations of the whole catalogue once in a process, outside the measured time."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        diagnose(_study(imperfect.world(1, "clean")))


def _study(world: object, *, exam: bool = False) -> Study:
    length, mass = world.guess
    given = pendulum_model(length=length, mass=mass)
    return make_study(given, world.runs, world.held_out, hidden_table.PENDULUM_EFFECTS, world.exam if exam else ())


def _added(world: object, names: Sequence[str]) -> float:
    """Error in the training runs after `add` with some effects."""
    length, mass = world.guess
    effects = [CATALOGUE[name] for name in names]
    return _root(
        add(make_study(pendulum_model(length=length, mass=mass), world.runs, [], effects), effects).path[-1].rmse
    )


def _root(errors: Mapping[str, float]) -> float:
    """Error of the only channel."""
    (error,) = errors.values()
    return error


def _mean(fit: object) -> float:
    """Root mean square error over all samples of all runs."""
    return float(np.sqrt(np.average(np.square(fit.rmse), weights=fit.samples)))


def _values(world: object, model: Model) -> dict[str, float]:
    """Found over true sizes of the found effects, both per m l^2, or the part of them that an angle determines."""
    length, mass = (model.parameters[name].value for name in ("length", "mass"))
    found = type(world.pendulum)(length, mass, {})
    ratios = {}
    for effect in model.effects:
        if effect.name in world.hidden:
            (parameter, *_) = effect.parameters()
            size = model.parameters[parameter.name].value / output_error.accelerating(found, effect.name)
            true = world.hidden[effect.name] / output_error.accelerating(world.pendulum, effect.name)
            ratios[effect.name] = size / true
    return ratios


def show(what: str, rows: Sequence[hidden_table.Row]) -> None:
    """Print a line for each kind of recording."""
    columns = [column for kind, column in WANTED if kind == what]
    asked = [row for row in rows if not row.get("skipped")]
    lines = []
    for kind in [*dict.fromkeys(row["what"] for row in rows), "all"]:
        mine = [row for row in asked if kind in (row["what"], "all")]
        shares = [f"{sum(row[c] for row in mine if c in row)}/{sum(c in row for row in mine)}" for c in columns]
        seconds = [row["cpu"] for row in mine]
        spent = [f"{np.median(seconds):.1f}", f"{max(seconds):.1f}"] if seconds else ["", ""]
        skipped = sum(bool(row.get("skipped")) and kind in (row["what"], "all") for row in rows)
        lines.append([kind, str(len(mine)), str(skipped), *shares, *spent])
    bench.print_table(what, ["recorded", "worlds", "left out", *columns, "CPU s", "worst"], lines)
    values = [abs(value - 1) for row in asked for value in row.get("values", {}).values()]
    if values:
        print(f"sizes of true effects: {100 * np.median(values):.1f} % off (median of {len(values)})")


def claims(everything: Mapping[str, Sequence[hidden_table.Row]], *, judged: bool) -> list[bench.Claim]:
    """Claims about the selected kinds."""
    found = []
    for (what, column), (sentence, least) in WANTED.items():
        values = [bool(row[column]) for row in everything.get(what, ()) if column in row]
        if values:
            share = float(np.mean(values))
            text = f"{100 * share:.1f} % of {len(values)}, wanted {100 * least:.0f} %"
            found.append(bench.Claim(f"{what}: {sentence}", text, bool(share >= least) if judged else None))
    return found


def main() -> int:
    parser = hidden_table.parser(__doc__, "names,clean,fits", 40)
    parser.add_argument(
        "--quick", action="store_true", help="a few worlds: checks that all is answered, judges no share"
    )
    options: argparse.Namespace = parser.parse_args()
    everything: dict[str, list[hidden_table.Row]] = {}
    for what in hidden_table.wanted(options.what, [*KINDS]):
        rows = everything[what] = []
        seeds = QUICK[what] if options.quick else hidden_table.seeds_of(options)
        for row in hidden_table.answered(case, [(what, seed) for seed in seeds], options.processes):
            rows.append(row)
            if any(row.get(column) is False for kind, column in WANTED if kind == what):
                kept = {k: v for k, v in row.items() if k not in ("alike", "sentence")}
                print(f"   miss, {what}:", kept, flush=True)
        show(what, rows)
    return bench.conclude(claims(everything, judged=not options.quick), everything, options.json)


if __name__ == "__main__":
    raise SystemExit(main())
