"""Arms that MuJoCo simulates, watched while something happens to them, or nothing does. Prints a table.

    python benchmarks/watch_mujoco.py --each 10 --minutes 60

The arms are those of `tests/worlds/mujoco_work.py`: their descriptions are 5 to 10 % off; they have friction, and
stick. Each is repaired from two recordings of 40 s as a user would, and calibrated by ten minutes of work. Then it
happens, each in a recording of its own:

- `contact`: a force on a random link in a random direction, whose largest joint torque is 5 to 10 N m; for 1 s.
- `load`: .1 to .5 kg within .1 m of the last joint's origin.
- `drift`: dry friction of one joint, of at least 1 N m, grows by 10 to 30 % within 5 s.

Counted are: found, by any event within 200 ms (contact) or 30 s; kind, joint (for a contact one with at least half the
largest torque) and size within three standard deviations; wrong, events that are none of it or smaller than three
deviations; and events in work where nothing happens.
"""

import tempfile
import time
from collections.abc import Iterator, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import _hidden_table as hidden_table
import numpy as np
from _watch_table import WatchTable

from armdyn.arm.model import SENSOR_GAIN_EFFECT, ArmModel, arm_model
from armdyn.effects.catalogue import CATALOGUE
from armdyn.identify.repair import repair
from armdyn.identify.studies import make_study
from armdyn.recording.channels import WRENCH_CHANNELS
from armdyn.run import Run
from armdyn.watch.event import EventKind, WatchEvent
from armdyn.watch.fault_free import FaultFreeStatistics, JointSample, statistics_of_recordings
from armdyn.watch.watch import Watch

worlds = hidden_table.generator("mujoco_work")

TRAINING, TRAINING_RATE, CALIBRATION, MINUTE = 40.0, 250.0, 10, 60.0
CONTACT, CONTACT_LASTS, SOON = (5.0, 10.0), 1.0, 0.2
LOAD, PLACE, DRIFT, LATER = (0.1, 0.5), 0.06, (0.1, 0.3), 30.0
WANTED = {
    "contact": EventKind.OUTSIDE_TORQUE, "load": EventKind.LOAD_CHANGED, "drift": EventKind.ROBOT_CHANGED,
}  # fmt: skip
ALLOWED = {EventKind.UNIDENTIFIED}
DRY_FRICTION, SENSED = "joint_coulomb_friction", "+ft"
Recording = tuple[np.ndarray, np.ndarray, np.ndarray]


@lru_cache(maxsize=1)
def worker_of(name: str, seed: int) -> Any:
    """The arm; with a tool, and a sensor that carries it, if its name ends so."""
    robot, _, tool = name.partition("+")
    return (worlds.SensedWorker if tool else worlds.Worker)(robot, seed)


def worked(name: str, seed: int, rng: np.random.Generator, *given: Any) -> Recording:
    """Work of an arm, with what is read of it."""
    stamps, q, read = worker_of(name, seed).work(rng, *given)
    return stamps, q, read if name.endswith(SENSED) else read[:, : q.shape[1]]


@lru_cache(maxsize=1)
def model_of(name: str, seed: int) -> ArmModel:
    """The model that a user repairs."""
    worker, rng = worker_of(name, seed), np.random.default_rng([seed, 1])
    runs = []
    for k in range(3):
        stamps, q, read = worked(name, seed, rng, worker.motion(rng, TRAINING), TRAINING, TRAINING_RATE)
        values = {"q": q, "tau": read[:, : q.shape[1]]}
        values |= {f"{axis}.ft": column for axis, column in zip(WRENCH_CHANNELS, read[:, q.shape[1] :].T, strict=False)}
        runs.append(Run.from_arrays(stamps, values, joints=worker.joints, name=f"run {k}"))
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "arm.urdf"
        file.write_text(worker.description)
        described = arm_model(str(file), joints=worker.joints)
    effects = hidden_table.JOINT_EFFECTS
    if name.endswith(SENSED):
        described = described.with_sensors({"ft": {"link": worlds.TOOL_LINK}})
        # Its gains are calibrated: where all links are off, no torque tells them from the tool's mass.
        effects += tuple(e for e in CATALOGUE.values() if e.acts_on == "wrench" and e.name != SENSOR_GAIN_EFFECT)
    return repair(make_study(described, runs[:2], runs[2:], effects)).model


@lru_cache(maxsize=1)
def sound_of(name: str, seed: int, rate: float) -> FaultFreeStatistics:
    """Calibration by ten minutes of work without a fault."""
    worker, rng = worker_of(name, seed), np.random.default_rng([seed, 2])
    runs = [worked(name, seed, rng, worker.motion(rng, MINUTE), MINUTE, rate) for _ in range(CALIBRATION)]
    return statistics_of_recordings(model_of(name, seed), [lambda run=run: samples(run) for run in runs])


def samples(recording: Recording, later: float = 0.0) -> Iterator[JointSample]:
    """The samples of a recording, later by some seconds."""
    stamps, q, tau = recording
    yield from zip((stamps + later).tolist(), q, tau, strict=True)


def happened(name: str, seed: int, rate: float, what: str, number: int, per_hour: float) -> hidden_table.Row:
    """What a watch says where something happens."""
    worker, rng = worker_of(name, seed), np.random.default_rng([seed, 3, number, list(WANTED).index(what)])
    seconds, begin = (20.0, rng.uniform(8.0, 15.0)) if what == "contact" else (MINUTE, rng.uniform(15.0, 25.0))
    motion = worker.motion(rng, seconds)
    if what == "contact":
        torque = worker.jacobian_torques(rng, motion.at(np.array([begin]))[0][0], rng.uniform(*CONTACT))
        happening = worlds.Happening(begin, begin + CONTACT_LASTS, touch=torque)
        joint = int(np.argmax(np.abs(torque)))
        truth = {
            j: float(t) for j, t in zip(worker.joints, torque, strict=True) if abs(t) >= 0.5 * np.abs(torque).max()
        }
    elif what == "load":
        joint, size = len(worker.joints) - 1, float(np.exp(rng.uniform(*np.log(LOAD))))
        truth = {worker.joints[joint]: size}
        happening = worlds.Happening(begin, load=size, place=tuple(rng.uniform(-PLACE, PLACE, 3)))
    else:
        joint, share = int(rng.choice(np.flatnonzero(worker.dry >= 1.0))), float(rng.uniform(*DRIFT))
        happening = worlds.Happening(begin, worn=share * np.eye(len(worker.joints))[joint])
        truth = {worker.joints[joint]: share * float(worker.dry[joint])}
    recording = worker.work(rng, motion, seconds, rate, happening)
    events = list(Watch(model_of(name, seed), sound_of(name, seed, rate), per_hour).events_of(samples(recording)))
    within = SOON if what == "contact" else LATER
    after = [e for e in events if begin <= e.time]
    first = next((e for e in after if e.kind is not EventKind.RECOVERED), None)
    named = next((e for e in after if e.kind is WANTED[what]), None)
    right = named is not None and named.joint in truth
    right = right and (what != "drift" or DRY_FRICTION in named.what.split(", "))
    fits = right and named.what.split(", ")[0] in (DRY_FRICTION, named.what)
    fits = fits and abs(named.size - truth[named.joint]) <= 3.0 * named.std
    ended = {EventKind.RECOVERED} if what == "contact" else set()
    wrong = [e for e in events if e.time < begin or e.kind not in {WANTED[what], *ALLOWED, *ended}]
    wrong += [e for e in events if e.size is not None and abs(e.size) < 3.0 * e.std and e not in wrong]
    return {
        "what": what, "robot": name, "seed": seed, "number": number, "begin": begin, "joint": worker.joints[joint],
        "truth": truth, "found": first is not None and first.time <= begin + within,
        "after": None if first is None else first.time - begin, "named": named is not None, "right": right,
        "fits": fits, "wrong": [told(e) for e in wrong], "events": [told(e) for e in events],
    }  # fmt: skip


def told(event: WatchEvent) -> str:
    return f"{event.time:.2f} {event.kind.value}: {event.sentence}"


def quiet(name: str, seed: int, rate: float, minutes: int, per_hour: float) -> hidden_table.Row:
    """What a watch says in work where nothing happens."""
    worker, rng = worker_of(name, seed), np.random.default_rng([seed, 4])
    watch, events, spent = Watch(model_of(name, seed), sound_of(name, seed, rate), per_hour), [], 0.0
    for minute in range(minutes):
        recording = worked(name, seed, rng, worker.motion(rng, MINUTE), MINUTE, rate)
        start = time.process_time()
        events += watch.events_of(samples(recording, minute * (MINUTE + 1.0)))
        spent += time.process_time() - start
    return {"what": "quiet", "robot": name, "seed": seed, "minutes": minutes, "events": [told(e) for e in events],
            "share": spent / (MINUTE * max(minutes, 1))}  # fmt: skip


def show(rows: Sequence[hidden_table.Row]) -> None:
    """Print the table."""
    for what in dict.fromkeys(row["what"] for row in rows if row["what"] != "quiet"):
        for robot in [*dict.fromkeys(row["robot"] for row in rows), ""]:
            some = [row for row in rows if row["what"] == what and robot in ("", row["robot"])]
            if some:
                share = {key: 100.0 * np.mean([r[key] for r in some]) for key in ("found", "named", "right", "fits")}
                late = [r["after"] for r in some if r["after"] is not None]
                print(
                    f"  {what:8s}{robot or 'all':9s} of {len(some):3d}: found {share['found']:5.1f} %, after "
                    f"{np.median(late) if late else np.nan:6.3g} s; kind {share['named']:5.1f} %, joint too "
                    f"{share['right']:5.1f} %, size too {share['fits']:5.1f} %; wrong events "
                    f"{sum(len(r['wrong']) for r in some)}"
                )
    for row in rows:
        if row["what"] == "quiet":
            print(
                f"  quiet   {row['robot']:9s} {row['minutes']} min: {len(row['events'])} events, "
                f"{100 * row['share']:.1f} % of a core"
            )


if __name__ == "__main__":
    WatchTable(__doc__, list(worlds.DRY), list(WANTED), 1, 10, ("minutes", 60), happened, quiet, show).main()
