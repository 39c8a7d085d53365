"""Arms with a force/torque sensor that MuJoCo simulates, watched while something happens to their tool. Prints a table.

    python benchmarks/watch_wrench.py --each 10 --minutes 30

The arms are those of `benchmarks/watch_mujoco.py`, with a tool of 1.2 kg behind a sensor with noise of 0.1 N and
0.005 N m. Model and calibration are made as there. Then it happens, each in a recording of its own:

- `push`: a force of 1 to 5 N at the tool in a random direction, for 1 s.
- `load`: .05 to .5 kg within .06 m of the tool's origin.
- `zeroed`: the sensor reads what it reads then too little.
- `drift`: the sensor drifts by up to 0.1 N/s and 0.005 N m/s in each axis.

Counted are: found, by any event within 200 ms (push) or 30 s; the kind, and what it is said of; size within three
standard deviations; wrong, events that are none of it; and events in work where nothing happens. `ur10+tool` is watched
without its sensor.
"""

from typing import Any

import _hidden_table as hidden_table
import numpy as np
import watch_mujoco as usual
from _watch_table import WatchTable

from armdyn.watch.event import EventKind
from armdyn.watch.watch import Watch

worlds = usual.worlds

PUSH, LOAD, RATES = (1.0, 5.0), (0.05, 0.5), np.repeat([0.1, 0.005], 3)
WANTED = {
    "push": (EventKind.OUTSIDE_TORQUE, "outside_torque"), "load": (EventKind.LOAD_CHANGED, "payload"),
    "zeroed": (EventKind.ROBOT_CHANGED, "wrench_offset"), "drift": (EventKind.ROBOT_CHANGED, "wrench_offset"),
}  # fmt: skip


def happened(name: str, seed: int, rate: float, what: str, number: int, per_hour: float) -> hidden_table.Row:
    """What a watch says where something happens."""
    worker, rng = usual.worker_of(name, seed), np.random.default_rng([seed, 5, number, list(WANTED).index(what)])
    soon = what == "push"
    seconds, begin = (20.0, rng.uniform(8.0, 15.0)) if soon else (usual.MINUTE, rng.uniform(15.0, 25.0))
    motion, given, truth = worker.motion(rng, seconds), dict[str, Any](), None
    if soon:
        way = rng.standard_normal(3)
        truth = float(np.exp(rng.uniform(*np.log(PUSH))))
        given = {"end": begin + usual.CONTACT_LASTS, "push": truth * way / np.linalg.norm(way)}
    elif what == "load":
        truth = float(np.exp(rng.uniform(*np.log(LOAD))))
        given = {"load": truth, "place": tuple(rng.uniform(-usual.PLACE, usual.PLACE, 3))}
    elif what == "zeroed":
        given = {"zeroed": True}
    else:
        given = {"drift": rng.uniform(0.3, 1.0) * rng.choice([-1, 1], 6) * RATES}
    recording = usual.worked(name, seed, rng, motion, seconds, rate, worlds.Happening(begin, **given))
    watch = Watch(usual.model_of(name, seed), usual.sound_of(name, seed, rate), per_hour)
    events = list(watch.events_of(usual.samples(recording)))
    kind, effect = WANTED[what]
    after = [e for e in events if begin <= e.time]
    first = next((e for e in after if e.kind is not EventKind.RECOVERED), None)
    named = next((e for e in after if e.kind is kind and effect in e.what.split(", ")), None)
    fits = named is not None and (what != "load" or abs(named.size - truth) <= 3.0 * named.std)
    if what == "push" and named is not None and named.unit == "N":
        fits = abs(named.size) <= truth + 3.0 * named.std
    allowed = {kind, EventKind.UNIDENTIFIED} | ({EventKind.RECOVERED} if soon else set())
    wrong = [e for e in events if e.time < begin or e.kind not in allowed or (e.kind is kind and e.what != effect)]
    return {
        "what": what, "robot": name, "seed": seed, "number": number, "begin": begin, "truth": truth,
        "found": first is not None and first.time <= begin + (usual.SOON if soon else usual.LATER),
        "after": None if first is None else first.time - begin, "named": named is not None, "right": named is not None,
        "fits": fits, "wrong": [usual.told(e) for e in wrong], "events": [usual.told(e) for e in events],
    }  # fmt: skip


if __name__ == "__main__":
    ROBOTS = ["ur10+ft", "ur10+tool"]
    WatchTable(__doc__, ROBOTS, list(WANTED), 1, 10, ("minutes", 30), happened, usual.quiet, usual.show).main()
