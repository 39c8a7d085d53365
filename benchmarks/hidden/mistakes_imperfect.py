"""Does `inspect` find mistakes in recordings as imperfect as real ones? Prints tables.

    python benchmarks/hidden/mistakes_imperfect.py --pendulums 24 --arms 10 --first-seed 9000

Worlds come from `imperfect_pendulum.py` and `imperfect_arm.py` of `tests/worlds`, mistakes from
`imperfect_mistakes.py`. Every mistake has its sound twin, the recording as it was.

- `found`: the right kind, wrong or to be looked at, and nothing of another kind that is called wrong;
- `sure`: the same, and called wrong;
- `mended`: of those that a correction can undo and that are called wrong, the corrected recording is inspected as the
  sound one is, and where values can be compared they are its own;
- `sound`: twins that are called wrong, or to be looked at.
"""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parents[1]))
import _hidden_table as hidden_table  # isort: skip
import _timing as bench  # isort: skip

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from armdyn.arm.model import arm_model
from armdyn.inspection.check import Inspection, Severity
from armdyn.inspection.inspect import inspect_runs
from armdyn.model import Model
from armdyn.pendulum.model import pendulum_model
from armdyn.run import Run

pendulums, arms = hidden_table.generator("imperfect_pendulum"), hidden_table.generator("imperfect_arm")
made = hidden_table.generator("imperfect_mistakes")
TARGET, CLOCK, SAME = 0.95, 0.03, 1e-6
"""Target share; largest difference of a corrected recording from the sound one in time [s] and over a range."""


@dataclass(frozen=True)
class Answer:
    """Result for one mistake; `mended` is None where no correction exists, or the mistake is not named."""

    name: str
    found: bool
    sure: bool
    mended: bool | None


def worlds(count: int, arm_count: int, first: int) -> Iterator[tuple[str, Model, Run, list]]:
    """Name, model, sound recording and mistakes of each world."""
    for seed in range(first, first + count):
        world, rng = pendulums.world(seed, "names"), np.random.default_rng(seed)
        moved = [run for run in world.runs if "gripper_x" in run.channels]
        run = (moved or list(world.runs))[0]
        yield world.name, pendulum_model(*world.guess), run, list(made.of_pendulum(run, rng))
    cases = list(arms.CASES)
    for seed in range(first, first + arm_count):
        robot, case = arms.ROBOTS[seed % len(arms.ROBOTS)], cases[seed * 7 % len(cases)]
        run, plant = arms.generate(robot, case, seed, duration=12.0).train[0], arms.Plant(robot)
        model = arm_model(robot=robot, joints=plant.joints)
        yield f"{robot} {case} {seed}", model, run, list(made.of_arm(run, plant, np.random.default_rng(seed)))


def judged(mistake: object, sound: Run, model: Model) -> Answer:
    """Whether an inspection names a mistake, and whether its correction restores the sound recording."""
    answer = inspect_runs([mistake.run], model)
    right = [c for c in answer.checks if c.kind in mistake.kinds and c.severity is not Severity.NOTE]
    found = bool(right) and all(c.kind in mistake.kinds for c in answer.wrong)
    sure = found and bool(answer.wrong)
    correction = answer.corrected().get(mistake.run.name)
    mended = None
    if mistake.undone and sure:
        mended = correction is not None and _alike(correction.applied_to(mistake.run), sound, model)
    if not found or mended is False:
        said = "; ".join(f"{c.severity.key} {c.kind}: {c.sentence[:90]}" for c in answer.checks[:3])
        print(f"  {mistake.name}: {'not mended' if found else 'not found'}: {said or 'nothing'}", flush=True)
    return Answer(mistake.name, found, sure, mended)


def _alike(run: Run, sound: Run, model: Model) -> bool:
    """Whether a corrected recording is sound and its channels have the sound values at consistent times."""
    if not inspect_runs([run], model).usable:
        return False
    shifts = []
    for name, channel in sound.channels.items():
        mended = run.channels[name]
        flipped = min(np.abs(sign * mended.value - channel.value).max() for sign in (1.0, -1.0))
        if flipped > SAME * (float(np.ptp(channel.value)) + 1e-12):
            return False
        shifts.append(mended.time[[0, -1]] - channel.time[[0, -1]])
    return bool(np.ptp(shifts, axis=0).max() < CLOCK)


def _doubtful(found: Inspection) -> bool:
    return any(c.kind != "no_motion" for c in found.with_severity(Severity.SUSPECT))


def main() -> int:
    parser = bench.argparse.ArgumentParser(
        description=__doc__, formatter_class=bench.argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--pendulums", type=int, default=24, help="worlds")
    parser.add_argument("--arms", type=int, default=10, help="worlds")
    parser.add_argument("--first-seed", type=int, default=9000)
    parser.add_argument("--json", type=bench.Path, metavar="FILE", help="write what is printed as JSON too")
    options = parser.parse_args()
    answers: list[Answer] = []
    wrong = doubtful = sound = 0
    for name, model, run, mistakes in worlds(options.pendulums, options.arms, options.first_seed):
        twin = inspect_runs([run], model)
        wrong, doubtful, sound = wrong + (not twin.usable), doubtful + _doubtful(twin), sound + 1
        said = "; ".join(c.sentence[:90] for c in (*twin.wrong, *twin.with_severity(Severity.SUSPECT)))
        print(f"{name}: {said or 'sound'}", flush=True)
        answers += [judged(mistake, run, model) for mistake in mistakes]
    asked = Counter(a.name for a in answers)
    rows = []
    for name, count in asked.items():
        own = [a for a in answers if a.name == name]
        mended = [a.mended for a in own if a.mended is not None]
        rows.append((name, str(count), str(sum(a.found for a in own)), str(sum(a.sure for a in own)),
                     f"{sum(mended)} of {len(mended)}"))  # fmt: skip
    bench.print_table("Mistakes", ("mistake", "asked", "found", "called wrong", "mended"), rows)
    found, undone = float(np.mean([a.found for a in answers])), [a.mended for a in answers if a.mended is not None]
    claims = [
        bench.Claim(f"at least {TARGET:.0%} are found", f"{found:.1%} of {len(answers)}", found >= TARGET),
        bench.Claim(f"at least {TARGET:.0%} of those that can be undone are mended",
                    f"{np.mean(undone):.1%} of {len(undone)}", float(np.mean(undone)) >= TARGET),
        bench.Claim("no sound twin is called wrong", f"{wrong} of {sound}, {doubtful} to be looked at", wrong == 0),
    ]  # fmt: skip
    return bench.conclude(claims, {"asked": dict(asked), "found": found, "wrong": wrong}, options.json)


if __name__ == "__main__":
    raise SystemExit(main())
