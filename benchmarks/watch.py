"""Does `watch` detect changes of a working arm, name them, and raise no false alarm? Prints a table.

    python benchmarks/watch.py --seeds 3 --hours 1

Robots are those of `tests/worlds/imperfect_arm.py`: links, friction, cogging, flexible joints and drives are
off everywhere, and one joint has much friction. Each is repaired with its training runs as a user would, and watched
with what fifteen minutes of its own sound work say. Then it works: random motions of three kinds, a minute each. What
happens to it:

- `contact`: a force on a random link, in a random direction, whose largest joint torque is 5 N m; for 1 s.
- `load`: 0.1 kg, within 0.1 m of the last joint's origin.
- `friction`: what one joint has, all of it, grows by 10 %.

Counted are: found, by its joint or kind at all, within 50 ms (contact) or 30 s (the others) of the change; told apart,
of those that were found, with the right kind; and events in sound work, with the rate that is below by 95 % (Poisson:
3 over the hours where there is none), and by how much the memory grew after its first ten minutes.
"""

import resource
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import _hidden_table as hidden_table
import numpy as np
import pinocchio as pin
from _watch_table import WatchTable
from scipy.signal import butter, lfilter
from scipy.stats import chi2

from armdyn.arm.model import ArmModel, arm_model
from armdyn.identify.repair import repair
from armdyn.identify.studies import make_study
from armdyn.run import Run
from armdyn.watch.event import EventKind
from armdyn.watch.fault_free import FaultFreeStatistics, joint_samples_of_recording, statistics_of_recordings
from armdyn.watch.watch import Watch

imperfect = hidden_table.generator("imperfect_arm")
hidden_drive = hidden_table.generator("drive")
motions = hidden_table.generator("motions")

CASE = "coulomb"
MINUTE = 60.0
CALIBRATION = 15
"""Minutes of work without a fault that calibrate the watch."""
CONTACT, CONTACT_LASTS, SOON = 5.0, 1.0, 0.05
"""Largest torque [N m] and duration [s] of a contact, and the longest time to its detection [s]."""
LOAD, LATER = 0.1, 30.0
"""Additional load [kg], and the longest time to its detection [s]."""
FRICTION = 1.1


@dataclass(frozen=True, eq=False)
class Robot:
    """Imperfect robot and its repaired model."""

    case: object
    model: ArmModel

    @classmethod
    @lru_cache(maxsize=4)
    def of(cls, name: str, seed: int) -> "Robot":
        """Robot with a model that is repaired as by a user."""
        case = imperfect.generate(name, CASE, seed)
        return cls(
            case,
            repair(make_study(arm_model(robot=name), case.train, case.held_out, hidden_table.JOINT_EFFECTS)).model,
        )

    def work(
        self, rng: np.random.Generator, rate: float, *, seconds: float = MINUTE, what: str = "", begin: float = 0.0
    ) -> tuple[Run, str]:
        """Recording of a minute of work, and the joint that changes at `begin` [s]."""
        world, truth = self.case.exam_world, self.case.exam_truth
        plant = world.plant
        kind = list(motions.KINDS)[rng.integers(len(motions.KINDS))]
        motion = motions.KINDS[kind](rng, plant.rooms(rng)[rng.integers(3)], seconds)
        stamps = np.arange(round(seconds * rate)) / rate
        world = replace(world, motion=motion, stamps=stamps)
        noise = rng.standard_normal((3, len(stamps), len(plant.joints)))
        q, torque = world.measured(truth)
        after, joint, outside = stamps >= begin, "", np.zeros(torque.shape)
        if what == "contact":
            after &= stamps < begin + CONTACT_LASTS
            outside[after], joint = self._outside(rng, world.motion.at(np.array([begin]))[0][0])
        elif what == "load":
            lump = hidden_drive.Lump(LOAD, tuple(rng.uniform(-0.06, 0.06, 3)))
            with_load = world.measured((*truth, hidden_drive.on_link("payload", plant.joints[-1], lump)))[1]
            torque[after], joint = with_load[after], plant.joints[-1]
        elif what == "friction":
            hidden = truth[0]
            joint, j = hidden.joint, plant.joints.index(hidden.joint)
            drive = replace(world.drive, viscous=_more(world.drive.viscous, j), coulomb=_more(world.drive.coulomb, j))
            more = (replace(hidden, coulomb=hidden.coulomb * FRICTION, viscous=hidden.viscous * FRICTION), *truth[1:])
            torque[after] = replace(world, drive=drive).measured(more)[1][after]
        q = q + world.drive.position_noise * noise[0]
        if np.isfinite(world.drive.smoothing):  # the same low-pass as a drive has it, which knows no future
            outside = lfilter(*butter(2, world.drive.smoothing / (0.5 * rate)), outside, axis=0)
        effort = world.drive.read(torque, rate, noise[1:]) + outside
        return _run(plant.joints, stamps, q, effort), joint

    def _outside(self, rng: np.random.Generator, q: np.ndarray) -> tuple[np.ndarray, str]:
        """Torques (nj,) of a force on a random link, the largest of them 5 N m, and the joint of that one."""
        rigid = self.model.arm.model
        data = rigid.createData()
        pin.computeJointJacobians(rigid, data, q)
        link = int(rng.integers(1, rigid.njoints))
        place = data.oMi[link].act(rng.uniform(-0.15, 0.15, 3))
        J = pin.getJointJacobian(rigid, data, link, pin.LOCAL_WORLD_ALIGNED)
        r = place - data.oMi[link].translation
        force = rng.standard_normal(3)
        torque = J[:3].T @ force + J[3:].T @ np.cross(r, force)
        torque *= CONTACT / np.abs(torque).max()
        return torque, self.case.joints[int(np.argmax(np.abs(torque)))]


def _more(values: np.ndarray, joint: int) -> np.ndarray:
    return np.where(np.arange(len(values)) == joint, FRICTION * values, values)


def _run(joints: Sequence[str], stamps: np.ndarray, q: np.ndarray, tau: np.ndarray) -> Run:
    from armdyn.run import Channel

    channels = {f"q.{joint}": Channel(stamps, q[:, i], "rad") for i, joint in enumerate(joints)}
    return Run("work", channels | {f"tau.{joint}": Channel(stamps, tau[:, i], "N m") for i, joint in enumerate(joints)})


@lru_cache(maxsize=4)
def sound_of(name: str, seed: int, rate: float) -> FaultFreeStatistics:
    """Calibration by fifteen minutes of work without a fault."""
    robot, rng = Robot.of(name, seed), np.random.default_rng([seed, 1])
    runs = [robot.work(rng, rate)[0] for _ in range(CALIBRATION)]
    return statistics_of_recordings(
        robot.model, [lambda run=run: joint_samples_of_recording(run, robot.model) for run in runs]
    )


def happened(name: str, seed: int, rate: float, what: str, number: int, per_hour: float) -> hidden_table.Row:
    """Result for one change in a minute of work, or in 15 s for a contact."""
    robot, sound = Robot.of(name, seed), sound_of(name, seed, rate)
    rng = np.random.default_rng([seed, 2, number])
    seconds = 15.0 if what == "contact" else MINUTE
    begin = float(rng.uniform(5.0, 13.0)) if what == "contact" else float(rng.uniform(20.0, 25.0))
    run, joint = robot.work(rng, rate, seconds=seconds, what=what, begin=begin)
    events = list(Watch(robot.model, sound, per_hour).events_of(joint_samples_of_recording(run, robot.model)))
    within = SOON if what == "contact" else LATER
    wanted = {"contact": EventKind.OUTSIDE_TORQUE, "load": EventKind.LOAD_CHANGED, "friction": EventKind.ROBOT_CHANGED}[
        what
    ]
    after = [
        e for e in events if begin <= e.time <= begin + max(within, CONTACT_LASTS) and e.kind is not EventKind.RECOVERED
    ]
    soon = [e for e in after if e.time <= begin + within]
    named = [e.kind for e in after if e.kind is not EventKind.UNIDENTIFIED]
    return {
        "what": what, "robot": name, "seed": seed, "joint": joint, "found": bool(soon),
        "after": after[0].time - begin if after else None, "before": [e.sentence for e in events if e.time < begin],
        "named": bool(named), "apart": bool(after) and set(named) == {wanted},
        "size": after[-1].size if after else None, "sentences": [e.sentence for e in events],
    }  # fmt: skip


def silent(name: str, seed: int, rate: float, hours: float, per_hour: float) -> hidden_table.Row:
    """Result for some hours of work without a fault."""
    robot, sound = Robot.of(name, seed), sound_of(name, seed, rate)
    rng, watch, events = np.random.default_rng([seed, 3]), Watch(robot.model, sound, per_hour), []
    begun, minutes = time.process_time(), round(60 * hours)
    spent, held = 0.0, []
    for minute in range(minutes):
        run = robot.work(rng, rate)[0]
        start = time.process_time()
        events += watch.events_of(_later(joint_samples_of_recording(run, robot.model), minute * (MINUTE + 1.0)))
        spent += time.process_time() - start
        held.append(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0)
    share = spent / (MINUTE * minutes)
    return {"what": "silent", "robot": name, "seed": seed, "hours": hours, "events": [e.sentence for e in events],
            "share": share, "cpu": time.process_time() - begun, "grown": held[-1] - held[min(9, minutes - 1)],
            }  # fmt: skip


def _later(samples: Iterator[tuple], by: float) -> Iterator[tuple]:
    for stamp, q, tau in samples:
        yield stamp + by, q, tau


def show(rows: Sequence[hidden_table.Row]) -> None:
    """Print the table."""
    for what in ("contact", "load", "friction"):
        for robot in [*dict.fromkeys(row["robot"] for row in rows), ""]:
            some = [row for row in rows if row["what"] == what and robot in ("", row["robot"])]
            if some:
                found, named = [r["found"] for r in some], [r for r in some if r["after"] is not None]
                late = [r["after"] for r in named]
                apart = [r["apart"] for r in named]
                after, right = np.median(late) if late else np.nan, 100 * np.mean(apart) if apart else 0.0
                print(
                    f"  {what:9s}{robot or 'all':8s} of {len(some):3d}: found {100 * np.mean(found):5.1f} %, after "
                    f"{after:6.3g} s; told apart {right:5.1f} %"
                )
    quiet = [row for row in rows if row["what"] == "silent"]
    if quiet:
        hours, count = sum(r["hours"] for r in quiet), sum(len(r["events"]) for r in quiet)
        below, grown = chi2(2 * (count + 1)).isf(0.05) / (2.0 * hours), max(r["grown"] for r in quiet)
        share = 100 * np.mean([r["share"] for r in quiet])
        print(f"  sound: {count} events in {hours:.1f} h, fewer than {below:.2g} per hour (95 %)")
        print(f"  {share:.1f} % of a core; memory grew by {grown:.1f} MB")


if __name__ == "__main__":
    WatchTable(
        __doc__, list(imperfect.ROBOTS), ("contact", "load", "friction"), 2, 20, ("hours", 1.0), happened, silent, show
    ).main()
