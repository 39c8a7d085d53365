"""Does `inspect` find common mistakes in recordings, and no mistake in sound recordings? Prints tables.

    python benchmarks/hidden/mistakes.py --seeds 3 --data DIR

Recordings and mistakes come from `sound_recordings.py` and `mistakes.py` of `tests/worlds`: four arms with a
little of everything wrong and one real effect each (a payload, a spring, gains of a tenth, a tilt of five degrees,
friction, offsets), three pendulums, and what is done to them: units, signs, columns, zeros, clocks, mountings,
descriptions in other units, and faults of signals. Where a mistake changes hardly anything that rigid bodies ask, it is
not asked for.

- `found`: the right kind on a right channel, and nothing of another kind that is called wrong;
- `undone`: of mistakes that a correction can undo, the corrected recording has the sound one's values to rounding, so
  that whatever is done with it next ends as with the sound one;
- `sound`: recordings without a mistake, generated and those of `--data` (see docs/real.md), called wrong or suspect;
- `cost`: processor time of `inspect` over that of `compare`, on recordings that were prepared already, as inside it.
"""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parents[1]))
import _hidden_table as hidden_table  # isort: skip
import _timing as bench  # isort: skip

import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from armdyn.arm.model import ArmModel, arm_model
from armdyn.effects.catalogue import CATALOGUE
from armdyn.errors import InputError
from armdyn.identify.compare import compare
from armdyn.identify.studies import make_study
from armdyn.inspection.check import Check, Inspection, Severity
from armdyn.inspection.description import DescriptionCorrection
from armdyn.inspection.inspect import inspect_runs
from armdyn.model import Model
from armdyn.pendulum.model import pendulum_model
from armdyn.run import Run, read_run

made, recorded = hidden_table.generator("mistakes"), hidden_table.generator("sound_recordings")

DESCRIBED = {
    "arm_dfki_double": "double_pendulum_C1.urdf", "arm_gen3": "gen3.urdf", "emps": "emps.urdf", "ur10e": "ur10e.urdf",
    "arm_panda_unisa": "panda",
}  # fmt: skip
"""URDF or known robot by folder; recordings of a swing angle or a load's force in other folders are of pendulums."""
PENDULUMS = (
    (False, ("swing_angle",)), (True, ("swing_angle", "swing_rate")), (True, ("swing_angle", "load_force")),
)  # fmt: skip
SWINGING = {channel for _, channels in PENDULUMS for channel in channels}
REAL = ("", "pivot_coulomb_friction", "quadratic_drag", "angle_gain", "angle_offset", "gripper_scale", "sensor_bias")
CLOCK = 0.02
"""Largest error of a corrected clock [s]; torques and rates of the recordings have delays of their own."""
SAME = 1e-6
"""Largest difference of a corrected recording from the sound one, over a channel's range."""
TARGET, FALSE, COST = 0.95, 0.01, 0.3


@dataclass(frozen=True)
class Answer:
    """Result for one mistake; `undone` is None where only a new recording helps."""

    name: str
    found: bool
    undone: bool | None
    said: str


def judged(mistake: object, sound: Run, answer: Inspection) -> Answer:
    """Whether an inspection names a mistake and corrects it."""
    hits = [c for c in answer.checks if _right(c, mistake)]
    others = [c for c in answer.wrong if c.kind not in mistake.kinds]
    said = "; ".join(f"{c.severity.key} {c.kind}: {c.sentence}" for c in answer.checks[:3])
    correction = answer.corrected().get(mistake.run.name)
    undone = None
    if any(c.correction is not None for c in hits):
        undone = correction is not None and _same(correction.applied_to(mistake.run), sound)
    return Answer(mistake.name, bool(hits) and not others, undone, said)


def _right(check: Check, mistake: object) -> bool:
    named = not mistake.channels or bool(set(check.channels) & set(mistake.channels))
    return check.kind in mistake.kinds and named


def _same(run: Run, sound: Run) -> bool:
    for name, channel in sound.channels.items():
        mended = run.channels[name]
        size = SAME * (float(np.ptp(channel.value)) + 1e-12)
        if len(mended) != len(channel) or np.abs(mended.value - channel.value).max() > size:
            return False
        if np.abs(mended.time - channel.time).max() > CLOCK:
            return False
    return True


def as_written(model: ArmModel, mass: float, length: float) -> ArmModel:
    """Model of a description in other units."""
    robot = replace(
        model.arm.robot, model=DescriptionCorrection(mass=mass, length=length).corrected_model(model.arm.model)
    )
    return replace(model, arm=replace(model.arm, robot=robot))


def of_arm(robot: str, seed: int) -> Iterator[Answer]:
    """Results for every mistake in one recording of an arm."""
    real = recorded.SOUND[seed % len(recorded.SOUND)]
    sound = recorded.arm(robot, real, seed)
    model = arm_model(robot=robot, joints=made.Plant(robot).joints)
    mistakes = [*made.of_arms(sound, seed), *made.of_signals(sound, np.random.default_rng(seed))]
    for mistake in (*mistakes, *made.mounted(robot, real, seed)):
        described = model if mistake.urdf == (1.0, 1.0) else as_written(model, *mistake.urdf)
        yield judged(mistake, sound.run, inspect_runs([mistake.run], described))


def of_pendulum(kind: int, seed: int) -> Iterator[Answer]:
    """Results for every mistake in one recording of a pendulum."""
    driven, channels = PENDULUMS[kind]
    sound = recorded.pendulum(REAL[seed % len(REAL)], seed, driven=driven, channels=channels)
    for mistake in (*made.of_pendulums(sound, seed), *made.of_signals(sound, np.random.default_rng(seed))):
        yield judged(mistake, sound.run, inspect_runs([mistake.run], pendulum_model(0.35, 0.1)))


def sound_runs(robots: list[str], first: int, seeds: int) -> Iterator[tuple[str, Model, Run]]:
    """Generated recordings without a mistake."""
    for seed in range(100 + first, 100 + first + seeds):
        for robot in robots:
            model = arm_model(robot=robot, joints=made.Plant(robot).joints)
            for real in recorded.SOUND:
                sound = recorded.arm(robot, real, seed)
                yield sound.name, model, sound.run
        for driven, channels in PENDULUMS:
            for real in REAL:
                sound = recorded.pendulum(real, seed, driven=driven, channels=channels)
                yield sound.name, pendulum_model(0.35, 0.1), sound.run


def recorded_runs(data: Path) -> Iterator[tuple[str, Model, Run]]:
    """Real recordings, all assumed to be sound."""
    for folder in sorted(path for path in data.iterdir() if path.is_dir() and path.name != "reference"):
        for file in sorted(folder.glob("*.csv")):
            try:
                run = read_run(file)
            except InputError:  # logs of servos, as their programs wrote them
                continue
            model: Model = pendulum_model(0.35, 0.1)
            if folder.name not in DESCRIBED and not SWINGING & set(run.channels):
                continue  # a linkage or a servo, whose model is not at hand
            if folder.name in DESCRIBED:
                description = DESCRIBED[folder.name]
                urdf = folder / description if description.endswith(".urdf") else None
                model = arm_model(urdf, None if urdf else description, list(run.joints))
            yield f"{folder.name}/{file.name}", model, run


def cost_of(model: Model, run: Run) -> float:
    """Processor time of `inspect` over that of `compare`."""
    catalogue = [e for e in CATALOGUE.values() if e.acts_on in model.stages]
    begun = time.process_time()
    compare(make_study(model, [run], [], catalogue))
    between = time.process_time()
    inspect_runs([run], model, catalogue)
    return (time.process_time() - between) / (between - begun)


def main() -> int:
    parser = bench.argparse.ArgumentParser(
        description=__doc__, formatter_class=bench.argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--robots", default=",".join(recorded.ROBOTS), help="names, with commas")
    parser.add_argument("--data", type=Path, default=bench.DATA, metavar="DIR", help="folder of the real recordings")
    parser.add_argument("--quick", action="store_true", help="one pendulum and one arm's mistakes, once")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write what is printed as JSON too")
    options = parser.parse_args()
    robots = [name for name in options.robots.split(",") if name]
    robots, seeds = (robots[:1], 1) if options.quick else (robots, options.seeds)
    answers: list[Answer] = []
    for seed in range(options.first_seed, options.first_seed + seeds):
        for robot in robots:
            answers += _told(f"{robot} {seed}", of_arm(robot, seed))
        for kind in range(1 if options.quick else len(PENDULUMS)):
            answers += _told(f"pendulum {kind} {seed}", of_pendulum(kind, seed))
    found, asked = Counter(a.name for a in answers if a.found), Counter(a.name for a in answers)
    undone = [a for a in answers if a.undone is not None]
    bench.print_table(
        "Mistakes",
        ("mistake", "asked", "found", "undone"),
        [
            (name, str(n), str(found[name]), f"{sum(a.undone for a in undone if a.name == name)} of "
             f"{sum(a.name == name for a in undone)}")
            for name, n in asked.items()
        ],
    )  # fmt: skip
    wrong, suspect, sound, costs = 0, 0, 0, []
    for name, model, run in sound_runs(robots, options.first_seed, seeds):
        wrong, suspect, sound = _counted(name, inspect_runs([run], model), wrong, suspect, sound)
    real_wrong, real_suspect, real = 0, 0, 0
    if options.data.is_dir() and not options.quick:
        for name, model, run in recorded_runs(options.data):
            costs.append(cost_of(model, run))
            real_wrong, real_suspect, real = _counted(name, inspect_runs([run], model), real_wrong, real_suspect, real)
    print(f"\nsound, generated: {wrong} wrong, {suspect} suspect of {sound}")
    print(f"sound, recorded: {real_wrong} wrong, {real_suspect} suspect of {real}")
    rate, mended = sum(found.values()) / len(answers), float(np.mean([a.undone for a in undone]))
    claims = [
        bench.Claim(
            f"at least {TARGET:.0%} of {len(asked)} kinds of mistake are found",
            f"{rate:.1%} of {len(answers)}",
            rate >= TARGET,
        ),
        bench.Claim(
            f"at least {TARGET:.0%} of those that a correction can undo are undone",
            f"{mended:.1%} of {len(undone)}",
            mended >= TARGET,
        ),
        bench.Claim(
            "at most 1 % of sound recordings are called wrong",
            f"{wrong + real_wrong} of {sound + real}",
            wrong + real_wrong <= FALSE * (sound + real),
        ),
    ]
    if costs:
        middle = float(np.median(costs))
        said = f"{middle:.0%} (quarters {np.quantile(costs, 0.25):.0%} to {np.quantile(costs, 0.75):.0%})"
        claims.append(bench.Claim(f"inspect costs at most {COST:.0%} of compare", said, middle <= COST))
    summary = {"found": dict(found), "asked": dict(asked), "undone": mended, "sound_wrong": wrong + real_wrong,
               "sound": sound + real, "costs": costs}  # fmt: skip
    return bench.conclude(claims, summary, options.json)


def _told(where: str, answers: Iterator[Answer]) -> Iterator[Answer]:
    for answer in answers:
        if not answer.found or answer.undone is False:
            what = "not found" if not answer.found else "not undone"
            print(f"{where}, {answer.name}: {what}: {answer.said[:200] or 'nothing'}", flush=True)
        yield answer


def _counted(name: str, found: Inspection, wrong: int, suspect: int, sound: int) -> tuple[int, int, int]:
    for check in (*found.wrong, *found.with_severity(Severity.SUSPECT)):
        print(f"{name}: {check.severity.key} {check.kind}: {check.sentence[:160]}", flush=True)
    doubtful = bool(found.with_severity(Severity.SUSPECT)) and found.usable
    return wrong + (not found.usable), suspect + doubtful, sound + 1


if __name__ == "__main__":
    raise SystemExit(main())
