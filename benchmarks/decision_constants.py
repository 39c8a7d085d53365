"""Which answers depend on the numbers that decide? Each field of `identify.settings` is halved and doubled.

    python benchmarks/decision_constants.py --processes 2
    python benchmarks/decision_constants.py --only model_errors,tie_nats

Every world of a small table is repaired once with the settings as they are, and once with each field halved, and
doubled. An answer has moved if it names other effects, has another verdict, or an exam error that differs by more than
`NOTICEABLE`. A field that moves no answer decides nothing here; one that moves a single set rests on that set.
"""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parent))
import _hidden_table as hidden_table  # isort: skip

from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import fields, replace
from functools import cache
from typing import NamedTuple

from armdyn.arm.model import arm_model
from armdyn.identify.repair import repair
from armdyn.identify.settings import Settings
from armdyn.identify.studies import make_study
from armdyn.identify.study import Study
from armdyn.pendulum.model import pendulum_model

NOTICEABLE = 0.02
"""Relative change of an exam error that counts."""
FACTORS = (0.5, 2.0)
SETS = {
    "pendulum": [("names", seed) for seed in (1, 3, 4)],
    "clean pendulum": [("clean", seed) for seed in range(4)],
    "dominated arm": [("payload", 1), ("spring", 0)],
    "imperfect arm": [("payload_viscous", 0), ("offset", 1)],
}
"""Worlds by set: a kind and a seed each."""


class Answer(NamedTuple):
    """What a repair says: effects with their joints, the verdict, and the error of the exam's channels together."""

    names: tuple[str, ...]
    verdict: str
    exam: float

    def moved(self, other: "Answer") -> list[str]:
        """What differs in another answer to the same question."""
        words = ["names"] if self.names != other.names else []
        words += ["verdict"] if self.verdict != other.verdict else []
        return words + (["exam"] if abs(other.exam / self.exam - 1.0) > NOTICEABLE else [])


def study_of(kind: str, world: tuple[str, int], settings: Settings) -> Study:
    """The study of one world with some settings."""
    name, seed = world
    if "pendulum" in kind:
        own = _pendulum(name, seed)
        length, mass = own.guess
        model = pendulum_model(length=length, mass=mass)
        effects = hidden_table.PENDULUM_EFFECTS
        return make_study(model, own.runs, own.held_out, effects, own.exam, settings=settings)
    case = _arm(kind.split()[0], name, seed)
    train, held_out, exam = case
    return make_study(arm_model(robot="ur5"), train, held_out, hidden_table.JOINT_EFFECTS, exam, settings=settings)


@cache
def _pendulum(name: str, seed: int) -> object:
    return hidden_table.generator("imperfect_pendulum").world(seed, name)


@cache
def _arm(kind: str, name: str, seed: int) -> tuple[list[object], list[object], list[object]]:
    case = hidden_table.generator(f"{kind}_arm").generate("ur5", name, seed)
    if kind == "dominated":
        return list(case.train), [case.held_out] if seed % 2 else [], [case.exam]
    *train, held_out, exam = (recording.run for recording in case.recordings)
    return train, [held_out], [exam]


def answer(kind: str, world: tuple[str, int], field: str, factor: float) -> Answer:
    """The repair's answer in one world, with one field times a factor; an empty field changes nothing."""
    found = repair(study_of(kind, world, changed(Settings(), field, factor)))
    labels = tuple(sorted(f"{e}:{','.join(s.joints)}" for s in found.path for e in s.added))
    errors = found.path[-1].exam_rmse.values()
    return Answer(labels, found.verdict.key, sum(e**2 for e in errors) ** 0.5)


def changed(settings: Settings, field: str, factor: float) -> Settings:
    """Settings with the field of this name times a factor."""
    for group in fields(settings):
        part = getattr(settings, group.name)
        if field in {one.name for one in fields(part)}:
            value = getattr(part, field)
            new = tuple(factor * x for x in value) if isinstance(value, tuple) else factor * value
            return replace(settings, **{group.name: replace(part, **{field: new})})
    return settings


def deciding() -> Iterator[str]:
    """Names of all fields."""
    settings = Settings()
    yield from (one.name for group in fields(settings) for one in fields(getattr(settings, group.name)))


def main(given: Sequence[str] | None = None) -> None:
    parser = hidden_table.parser(__doc__, ",".join(SETS), 1)
    options = parser.parse_args(given)
    sets = hidden_table.wanted(options.what, tuple(SETS))
    names = options.only.split(",") if options.only else list(deciding())
    worlds = [(kind, world) for kind in sets for world in SETS[kind]]
    cases = [(kind, world, "", 1.0) for kind, world in worlds]
    cases += [(kind, world, name, factor) for name in names for factor in FACTORS for kind, world in worlds]
    answers = hidden_table.answered(answer, cases, options.processes)
    as_is = {(kind, world): next(answers) for kind, world in worlds}
    rows = []
    for name in names:
        moved = defaultdict[str, list[str]](list)
        for factor in FACTORS:
            for kind, world in worlds:
                if what := as_is[kind, world].moved(next(answers)):
                    moved[kind].append(f"x {factor:g} {world[0]} {world[1]}: {', '.join(what)}")
        verdict = "moves nothing" if not moved else "moves one set" if len(moved) == 1 else f"moves {len(moved)} sets"
        print(f"{name:32s} {verdict}", *(f"    {kind}: {text}" for kind in moved for text in moved[kind]), sep="\n")
        sys.stdout.flush()
        rows.append({"what": name, "moved": dict(moved)})
    hidden_table.save(options.json, {"settings": rows})


if __name__ == "__main__":
    main()
