"""Are hidden effects of users' bases named, and are other recordings predicted as well as by the truth?

    python benchmarks/hidden/hidden_effects_own.py [--cases N] [--thresholds N] [--clean N] [--first SEED] [--off SHARE]

Bases are thermal, hydraulic, pneumatic, electrical, chemical, mechanical and geared, of order 1 to 6, written as the
documentation asks for it, with several effects of their own each, one of which is hidden
(tests/worlds/own_bases). Start values are off at random. Two recordings are fitted, one takes part in
choosing, one in nothing. Thresholds have a place: right are those whose values are all within three standard
deviations. Seeds below 100 were used to build it.
"""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parents[1]))
import _timing as bench  # isort: skip

import argparse
import tempfile
import time
from collections.abc import Iterator, Sequence

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tests"))
from worlds.own_bases import Case, Family, case
from worlds.own_bases.fast import FAST
from worlds.own_bases.laboratory import LABORATORY
from worlds.own_bases.slow import SLOW
from worlds.own_bases.unruly import UNRULY

from armdyn.checked_study import CheckedStudy
from armdyn.errors import ArmdynError
from armdyn.identify.repair import Repair
from armdyn.identify.sentence import Verdict

FAMILIES = (*SLOW, *FAST, *LABORATORY)
THRESHOLDS = (
    ("tanks", "overflow"), ("tanks", "pump_dead_zone"), ("vessel", "relief_valve"), ("filter", "diode"),
    ("geared", "gear_backlash"), ("masses", "end_stop"), ("train", "coupling_backlash"),
    ("cylinder", "valve_dead_zone"),
)  # fmt: skip
AS_GOOD, WITHIN = 1.2, 3.0
"""Largest error of a good prediction over the noise, and largest error of a right value in standard deviations."""


def drawn(number: int, first: int, of: Sequence[tuple[Family, str | None]]) -> Iterator[Case]:
    """Cases of a given number, each family in turn."""
    for k in range(number):
        family, hidden = of[k % len(of)]
        yield case(family, first + k // len(of), hidden)


def repaired(one: Case, off: float) -> tuple[str, float, Repair | None]:
    """Outcome of a case, error over the noise on the recording that took part in no fit, and the repair."""
    with tempfile.TemporaryDirectory() as folder:
        try:
            runs = one.runs()
            given = CheckedStudy.of(one.model(Path(folder), off), runs[:2], runs[2:3], runs[3:])
            found = given.repair()
            exam = [block for fit in given.study.exam_predictions(found.after.fit) for block in fit.blocks]
        except ArmdynError as error:
            return f"refused: {error}", np.inf, None
        except Exception as error:
            return f"crash: {error!r}", np.inf, None
    error = float(np.sqrt(np.mean([np.mean((b.misfit / one.family.noise[b.channel]) ** 2) for b in exam])))
    if found.verdict is Verdict.LOST:
        return "lost", error, found
    names = [effect.name for effect in found.model.effects]
    wanted = [one.hidden] if one.hidden else []
    tied = {name.partition(":")[0] for step in found.path for name in step.tied_with}
    end = "named" if names == wanted else "tied" if one.hidden and one.hidden in {*names, *tied} else "wrong"
    return end, error, found


def within(one: Case, found: Repair) -> tuple[int, int]:
    """Number of values within `WITHIN` standard deviations of the truth, and number of values compared."""
    told = {n: p for n, p in found.model.parameters.items() if n in one.true and p.std}
    near = [abs(p.value - one[n]) <= WITHIN * p.std for n, p in told.items()]
    return sum(near), len(near)


def counted(cases: Sequence[Case], off: float, title: str) -> list[list[str]]:
    """A row per family, and one for all; wrong results are printed."""
    rows: dict[str, list[float]] = {}
    for one in cases:
        begun = time.process_time()
        end, error, found = repaired(one, off)
        near, told = within(one, found) if found is not None and end == "named" else (0, 0)
        spent = time.process_time() - begun
        sure = float(bool(found) and end == "named" and near == told)
        row = [1.0, end == "named", end == "tied", end == "lost", error <= AS_GOOD, near, told, sure, spent]
        for key in (one.family.name, "all"):
            rows[key] = [a + b for a, b in zip(rows.get(key, [0.0] * len(row)), row, strict=True)]
        if end != "named" or error > AS_GOOD or near < told:
            names = [effect.name for effect in found.model.effects] if found else []
            off_by = {
                n: f"{(found.model.value(n) - v) / found.model.parameters[n].std:+.1f}"
                for n, v in one.true.items()
                if found and n in found.model.parameters and found.model.parameters[n].std
            }
            print(f"  {title}: {one.family.name} {one.seed} {one.hidden or 'nothing'}: {end} {names}, "
                  f"error {error:.2f}, values off by {off_by} std", flush=True)  # fmt: skip
    return [[key, *(f"{x:.0f}" for x in row[:-1]), f"{row[-1] / row[0]:.1f}"] for key, row in rows.items()]


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cases", type=int, default=60)
    parser.add_argument("--thresholds", type=int, default=40)
    parser.add_argument("--clean", type=int, default=104)
    parser.add_argument("--unruly", type=int, default=0)
    parser.add_argument("--first", type=int, default=100, help="seed of the first ones")
    parser.add_argument("--off", type=float, default=0.3, help="share, or factor from 1 on, by which starts are off")
    given = parser.parse_args()
    by_name = {family.name: family for family in FAMILIES}
    kinds = {
        "hidden effects": (given.cases, [(family, None) for family in FAMILIES]),
        "hidden thresholds": (given.thresholds, [(by_name[name], effect) for name, effect in THRESHOLDS]),
        "unruly": (given.unruly, [(family, None) for family in UNRULY]),
        "nothing hidden": (given.clean, [(family, "") for family in FAMILIES]),
    }
    headings = ["base", "cases", "named", "tied", "lost", "as the truth", "values within", "of", "all within", "cpu s"]
    for title, (number, of) in kinds.items():
        if number:
            rows = counted(list(drawn(number, given.first, of)), given.off, title)
            bench.print_table(title, headings, rows, texts=1)


if __name__ == "__main__":
    main()
