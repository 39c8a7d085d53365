"""Recordings of an arm that says wrong things, and what must hold of the runs that they become.

An arm whose joints are known functions of the true time is written down wrongly. Its first joint is a ramp, so that
each row says itself when it was taken.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from pipeline.imports import read_foreign
from pipeline.imports.conversion import run_from_recording
from pipeline.imports.guess import map_unambiguous_columns
from pipeline.imports.joints import JointRange, RobotJoints

from .bags import START, write_mcap

N, STEP = 300, 0.01
TRUE = STEP * np.arange(N)
NAMES = ("j1", "j2", "j3")
RAMP = 0.2
"""rad/s."""


def truth(t):
    """Positions, velocities and efforts (n, 3)."""
    t = np.asarray(t)[..., None]
    q = np.concatenate([RAMP * t, np.sin(2 * t), 0.5 * np.cos(3 * t)], axis=-1)
    v = np.concatenate([RAMP + 0 * t, 2 * np.cos(2 * t), -1.5 * np.sin(3 * t)], axis=-1)
    return q, v, 5 + 3 * q + v


@dataclass(frozen=True)
class Said:
    """A message as it is written down."""

    received: float
    stamp: float | None
    names: tuple = NAMES
    position: tuple = ()
    velocity: tuple = ()
    effort: tuple = ()
    topic: str = "/joint_states"
    raw: bytes | None = field(default=None)


def sound():
    q, v, tau = truth(TRUE)
    delay = 0.002 + 0.001 * np.random.default_rng(0).random(N)
    return [
        Said(START + t + d, START + t, NAMES, tuple(a), tuple(b), tuple(c))
        for t, d, a, b, c in zip(TRUE, delay, q, v, tau, strict=True)
    ]


def stamped(change):
    """All messages, the stamps of which are changed: `change` takes and gives (n,) s since the start; -inf is 0."""
    stamps = change(TRUE.copy())
    return [
        replace(m, stamp=None if np.isnan(s) else 0.0 if s == -np.inf else START + s)
        for m, s in zip(sound(), stamps, strict=True)
    ]


def overtaken():
    """Messages of which two come in the wrong order, again and again."""
    found = sound()
    for k in range(1, N, 50):
        early, late = found[k], found[k + 1]
        found[k] = replace(late, received=early.received)
        found[k + 1] = replace(early, received=late.received)
    return found


def at(places, value):
    def change(s):
        s[places] = value(s[places]) if callable(value) else value
        return s

    return change


def second(every, shift=0.0, *, first=False, **fields):
    """A second publisher, whose message comes after (or before) one in so many."""
    found = []
    for k, m in enumerate(sound()):
        other = replace(m, received=m.received + (-1e-4 if first else 1e-4), stamp=m.stamp + shift, **fields)
        found += [other, m] if first and k % every == 0 else [m, other] if k % every == 0 else [m]
    return found


def written(path, messages):
    found = []
    for m in messages:
        content = {"name": list(m.names), **{f: list(getattr(m, f)) for f in ("position", "velocity", "effort")}}
        if m.stamp is not None:
            nanoseconds = round(1e9 * m.stamp)
            content["header"] = {"stamp": {"sec": nanoseconds // 10**9, "nanosec": nanoseconds % 10**9}}
        found.append((m.topic, m.received, content if m.raw is None else m.raw))
    return write_mcap(path, found)


ARM = RobotJoints(NAMES, ("lift",), ("finger",), {n: JointRange(False, 3.0, 50.0) for n in NAMES})
ALONE = replace(ARM, others=(), grippers=())
SEVEN = RobotJoints(tuple(f"panda_joint{i}" for i in range(1, 8)),
               ranges={f"panda_joint{i}": JointRange(False, 3.0, 50.0) for i in range(1, 8)})  # fmt: skip
RIGHT, ASK = "right", "asks"


def run_of(tmp_path, messages):
    """What is read of messages; those that came are those that were written, each used or left out for a reason."""
    (foreign,) = read_foreign(written(tmp_path / "a.mcap", messages))
    found = run_from_recording(foreign, map_unambiguous_columns(foreign))
    for account in found.accounts:
        assert account.came == sum(m.topic == account.source for m in messages)
        assert account.came == account.kept + sum(account.left_out.values())
        assert str(account.came) in account.sentence
    return found


def check_against_truth(run, dated=1e-4):
    """Every sample is what the arm did at its time; times are the true ones but for a constant."""
    first = run.channels["q.j1"]
    shift = np.median(first.value / RAMP - first.time)
    assert np.abs(first.value / RAMP - first.time - shift).max() < dated
    for kind, of in zip(("q", "v", "tau"), range(3), strict=True):
        for j, name in enumerate(NAMES):
            if (channel := run.channels.get(f"{kind}.{name}")) is not None:
                expected = truth(channel.time + shift)[of][:, j]
                np.testing.assert_allclose(channel.value, expected, atol=20 * dated)
