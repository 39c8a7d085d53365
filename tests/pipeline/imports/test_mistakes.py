"""Recordings with mistakes of every kind: what is sound becomes the run, what is not is left out, counted and named.

An arm whose joints are known functions of the true time is written down wrongly. Its first joint is a ramp, so that
each row says itself when it was taken.
"""

import json
import zipfile
from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from mcap.writer import Writer

from armdyn.errors import InputError
from armdyn.inspection.inspect import inspected
from pipeline.imports import read_foreign
from pipeline.imports.conversion import imported
from pipeline.imports.guess import guess_map, known_columns
from pipeline.imports.joints import Joints, Range

START, N, STEP = 1_700_000_000.0, 300, 0.01
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
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start(profile="", library="a test")
        channels = {}
        for m in messages:
            if m.topic not in channels:
                channels[m.topic] = writer.register_channel(m.topic, "json", 0)
            content = {"name": list(m.names), **{f: list(getattr(m, f)) for f in ("position", "velocity", "effort")}}
            if m.stamp is not None:
                nanoseconds = round(1e9 * m.stamp)
                content["header"] = {"stamp": {"sec": nanoseconds // 10**9, "nanosec": nanoseconds % 10**9}}
            data = json.dumps(content).encode() if m.raw is None else m.raw
            writer.add_message(channels[m.topic], round(1e9 * m.received), data, round(1e9 * m.received))
        writer.finish()
    return path


ZERO = (0.0, 0.0, 0.0)
HELD = (0.3, -0.2, 0.1)
NAN = float("nan")
SHUFFLED = ("j2", "j3", "j1")
OTHER = {"position": ZERO, "velocity": (), "effort": ()}
S = slice
STAMPS = {
    "one ahead by 100 s": (lambda: stamped(at([150], 250.0)), 1),
    "one ahead by 0.48 s": (lambda: stamped(at([150], lambda s: s + 0.48)), 1),
    "one ahead by a day": (lambda: stamped(at([10], 86400.0)), 1),
    "one back by 1 s": (lambda: stamped(at([150], lambda s: s - 1.0)), 1),
    "one of another year": (lambda: stamped(at([150], lambda s: s - 3e7)), 1),
    "the first one from the day before": (lambda: stamped(at([0], -86400.0)), 1),
    "the last one ahead": (lambda: stamped(at([-1], 1e5)), 1),
    "the first is 0": (lambda: stamped(at([0], -np.inf)), 1),
    "the first five are 0": (lambda: stamped(at(S(5), -np.inf)), 5),
    "some are 0 in between": (lambda: stamped(at(S(3, None, 37), -np.inf)), 9),
    "some are missing": (lambda: stamped(at(S(3, None, 37), NAN)), 9),
    "three of the one before": (lambda: stamped(at([50, 100, 150], lambda s: s - STEP)), 3),
    "a packet that came twice": (lambda: [x for m in sound() for x in (m, m)][: 2 * N], N),
    "pairs that overtook each other": (overtaken, 6),
    "twenty at random": (lambda: stamped(at(np.random.default_rng(1).choice(N, 20, False), lambda s: s + np.random.default_rng(2).normal(0, 50, 20))), 20),  # noqa: E501
    "the clock set back by 2 s": (lambda: stamped(at(S(150, None), lambda s: s - 2.0)), 25),
    "the clock set back by 0.2 s": (lambda: stamped(at(S(150, None), lambda s: s - 0.2)), 25),
    "the clock set forward by a day": (lambda: stamped(at(S(150, None), lambda s: s + 86400.0)), 25),
    "the clock started anew twice": (lambda: stamped(lambda s: s % 1.0), 50),
    "s since boot, then since 1970": (lambda: stamped(at(S(120), lambda s: s - START + 5.0)), 25),
    "no stamps": (lambda: stamped(lambda s: s + NAN), 0),
    "a stamp that stands": (lambda: stamped(lambda s: 0 * s + 5.0), 0),
    "all stamps 0": (lambda: stamped(lambda s: s - np.inf), 0),
    "a bridge that stalls for 0.8 s": (lambda: [replace(m, received=max(m.received, START + 1.8) if 100 <= k < 180 else m.received) for k, m in enumerate(sound())], 0),  # noqa: E501
}  # fmt: skip
PUBLISHERS = {
    "zeros in another order": (lambda: second(2, names=SHUFFLED, **OTHER), 150),
    "zeros in the same order": (lambda: second(2, **OTHER), 150),
    "zeros, one in ten": (lambda: second(10, **OTHER), 30),
    "as many zeros": (lambda: second(1, **OTHER), 300),
    "zeros on a clock of their own": (lambda: second(10, 0.0043, names=SHUFFLED, **OTHER), 30),
    "zeros on a clock of their own, in the same order": (lambda: second(10, 0.0043, **OTHER), 30),
    "zeros before": (lambda: second(2, first=True, names=SHUFFLED, **OTHER), 150),
    "zeros before, in the same order": (lambda: second(3, first=True, **OTHER), 100),
    "zeros with efforts of zero": (lambda: second(10, 0.0043, names=SHUFFLED, position=ZERO, velocity=ZERO, effort=ZERO), 30),  # noqa: E501
    "zeros with efforts of zero, in the same order": (lambda: second(5, 0.0043, position=ZERO, velocity=ZERO, effort=ZERO), 60),  # noqa: E501
    "a held posture": (lambda: second(3, position=HELD, velocity=(), effort=()), 100),
    "a held posture in another order": (lambda: second(3, names=SHUFFLED, position=HELD, velocity=(), effort=()), 100),
    "a held posture with speeds": (lambda: second(4, position=HELD, velocity=ZERO, effort=()), 75),
    "a held posture that comes more often": (lambda: [x for m in sound() for x in (m, replace(m, received=m.received + 1e-4, names=SHUFFLED, position=HELD, velocity=(), effort=()), replace(m, received=m.received + 2e-4, stamp=m.stamp + 0.005, names=SHUFFLED, position=HELD, velocity=(), effort=()))], 600),  # noqa: E501
    "a held posture of another year": (lambda: second(2, -3e7, names=SHUFFLED, position=HELD, velocity=(), effort=()), 150),  # noqa: E501
    "zeros that are not stamped": (lambda: [replace(m, stamp=None) if m.position == ZERO else m for m in second(2, names=SHUFFLED, **OTHER)], 150),  # noqa: E501
    "zeros of two joints": (lambda: second(2, names=("j3", "j1"), position=(0.0, 0.0), velocity=(), effort=()), 150),
    "zeros of one joint": (lambda: second(2, names=("j3",), position=(0.0,), velocity=(), effort=()), 150),
    "what the arm is told, without efforts": (lambda: [x for k, m in enumerate(sound()) for x in (m, replace(m, received=m.received + 1e-4, names=SHUFFLED, position=tuple(truth(TRUE[k] + 0.3)[0][[1, 2, 0]]), velocity=(), effort=()))], 300),  # noqa: E501
    "zeros on a topic of their own": (lambda: second(1, topic="/joint_states_gui", **OTHER), 0),
    "zeros more often on a topic of their own": (lambda: [*second(1, topic="/gui", **OTHER), *second(1, 0.005, topic="/gui", **OTHER)], 0),  # noqa: E501
}  # fmt: skip
UNSOUND = {
    "efforts that are never sent": (lambda: [replace(m, effort=()) for m in sound()], ("tau.j1", "tau.j2", "tau.j3")),
    "efforts of zero": (lambda: [replace(m, effort=ZERO) for m in sound()], ("tau.j1", "tau.j2", "tau.j3")),
    "efforts of NaN": (lambda: [replace(m, effort=(NAN,) * 3) for m in sound()], ("tau.j1", "tau.j2", "tau.j3")),
    "one effort of NaN": (lambda: [replace(m, effort=(*m.effort[:2], NAN)) for m in sound()], ("tau.j3",)),
    "one effort of 0": (lambda: [replace(m, effort=(*m.effort[:2], 0.0)) for m in sound()], ("tau.j3",)),
    "fewer efforts than names": (lambda: [replace(m, effort=m.effort[:2]) for m in sound()], ("tau.j1", "tau.j2", "tau.j3")),  # noqa: E501
    "speeds that are never sent": (lambda: [replace(m, velocity=()) for m in sound()], ("v.j1", "v.j2", "v.j3")),
    "efforts in every second message": (lambda: [replace(m, effort=() if k % 2 else m.effort) for k, m in enumerate(sound())], ()),  # noqa: E501
    "efforts from the middle on": (lambda: [replace(m, effort=() if k < 150 else m.effort) for k, m in enumerate(sound())], ()),  # noqa: E501
    "a NaN now and then": (lambda: [replace(m, position=(NAN, *m.position[1:])) if k % 50 == 7 else m for k, m in enumerate(sound())], ()),  # noqa: E501
    "an effort of 1e30 once": (lambda: [replace(m, effort=(1e30, *m.effort[1:])) if k == 7 else m for k, m in enumerate(sound())], ()),  # noqa: E501
    "messages that are no JSON": (lambda: [replace(m, raw=b"{") if k % 50 == 7 else m for k, m in enumerate(sound())], ()),  # noqa: E501
    "messages of another kind on the topic": (lambda: [replace(m, raw=b'{"name": ["j1"], "position": "?"}') if k % 50 == 7 else m for k, m in enumerate(sound())], ()),  # noqa: E501
    "messages without names": (lambda: [replace(m, names=()) if k % 50 == 7 else m for k, m in enumerate(sound())], ()),
    "a joint named twice": (lambda: [replace(m, names=(*NAMES, "j3"), position=(*m.position, m.position[2]), velocity=(), effort=()) for m in sound()], ("v.j1", "tau.j1")),  # noqa: E501
    "wheels without efforts": (lambda: [replace(m, names=(*NAMES, "wheel"), position=(*m.position, 0.1), velocity=(*m.velocity, NAN), effort=(*m.effort, NAN)) for m in sound()], ("v.wheel", "tau.wheel")),  # noqa: E501
    "joints in another order from the middle on": (lambda: [m if k < 150 else replace(m, names=SHUFFLED, position=(*m.position[1:], m.position[0]), velocity=(*m.velocity[1:], m.velocity[0]), effort=(*m.effort[1:], m.effort[0])) for k, m in enumerate(sound())], ()),  # noqa: E501
    "two drivers with a joint each": (lambda: [x for m in sound() for x in (replace(m, names=NAMES[:2], position=m.position[:2], velocity=m.velocity[:2], effort=m.effort[:2]), replace(m, received=m.received + 0.001, names=NAMES[2:], position=m.position[2:], velocity=m.velocity[2:], effort=m.effort[2:]))], ()),  # noqa: E501
    "a gripper's own messages": (lambda: [x for m in sound() for x in (m, replace(m, names=("finger",), position=(0.02,), velocity=(), effort=()))], ()),  # noqa: E501
    "interfaces in place of joints": (lambda: [replace(m, names=tuple(f"{n}/{w}" for n in NAMES for w in ("position", "velocity", "effort")), position=tuple(np.column_stack([m.position, m.velocity, m.effort]).ravel()), velocity=(), effort=()) for m in sound()], ()),  # noqa: E501
}  # fmt: skip


def run_of(tmp_path, messages):
    (foreign,) = read_foreign(written(tmp_path / "a.mcap", messages))
    return imported(foreign, known_columns(foreign))


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


def check_accounted(found, messages):
    """Messages that came are those that were written, and each is used or left out for a reason."""
    topics = {account.source: account for account in found.accounts}
    for source, account in topics.items():
        assert account.came == sum(m.topic == source for m in messages)
        assert account.came == account.kept + sum(account.left_out.values())
        assert str(account.came) in account.sentence


@pytest.mark.parametrize("kind", STAMPS)
def test_a_bad_stamp_costs_one_sample_and_a_gap_that_was_made_is_found(kind, tmp_path):
    make, lost = STAMPS[kind]
    messages = make()
    found = run_of(tmp_path, messages)
    account = found.accounts[0]
    assert account.came - account.kept == lost
    check_accounted(found, messages)
    by_stamps = account.stamped and not account.steps and messages[100].stamp
    check_against_truth(found.run, 1e-4 if by_stamps else 2e-3)
    assert bool(found.checks) == (lost > 0 or not account.stamped)
    assert bool(account.steps) == any(check.kind == "gap" for check in inspected([found.run]).checks)


@pytest.mark.parametrize("kind", PUBLISHERS)
def test_a_second_publisher_is_not_mixed_in_and_is_told(kind, tmp_path):
    make, others = PUBLISHERS[kind]
    messages = make()
    found = run_of(tmp_path, messages)
    check_accounted(found, messages)
    check_against_truth(found.run)
    assert len(found.run.channels["tau.j3"]) >= N - 5
    (account,) = found.accounts
    told = sum(count for why, count in account.left_out.items() if why.startswith("of a second publisher"))
    assert told == pytest.approx(others, abs=5)
    if others:
        assert [check.kind for check in found.checks] == ["second_publisher"]
    else:
        assert any("is used" in note for note in found.run.warnings)


@pytest.mark.parametrize("kind", UNSOUND)
def test_what_was_not_sent_is_missing_and_blocks_nothing(kind, tmp_path):
    make, lacks = UNSOUND[kind]
    messages = make()
    found = run_of(tmp_path, messages)
    check_accounted(found, messages)
    check_against_truth(found.run)
    assert not set(lacks) & found.run.channels.keys()
    every = {f"{kind}.{name}" for kind in ("q", "v", "tau") for name in NAMES}
    if "twice" not in kind:
        assert every - set(lacks) <= found.run.channels.keys()
    said = " ".join([*found.run.warnings, *(account.sentence for account in found.accounts)])
    silent = ("efforts that are never sent", "speeds that are never sent", "efforts in every", "efforts from the",
              "a joint named", "joints in another order", "two drivers", "a gripper's own", "interfaces")  # fmt: skip
    assert kind.startswith(silent) or any(
        word in said for word in ("numbers", "nothing can be read", "nothing but zeros", "missing", "for 3 joints")
    )


ARM = Joints(NAMES, ("lift",), ("finger",), {n: Range(False, 3.0, 50.0) for n in NAMES})
ALONE = replace(ARM, others=(), grippers=())
SEVEN = Joints(tuple(f"panda_joint{i}" for i in range(1, 8)),
               ranges={f"panda_joint{i}": Range(False, 3.0, 50.0) for i in range(1, 8)})  # fmt: skip
RIGHT, ASK = "right", "asks"
JOINTS = {
    "as the robot's": (NAMES, ARM, RIGHT),
    "in another order": (SHUFFLED, ARM, RIGHT),
    "with a prefix": (tuple(f"left_{n}" for n in NAMES), ARM, RIGHT),
    "with a namespace": (tuple(f"arm/{n}" for n in NAMES), ARM, RIGHT),
    "with a namespace that begins with a slash": (tuple(f"/robot1/{n}" for n in NAMES), ARM, ASK),
    "with a long prefix": (tuple(f"robot_a::{n}" for n in NAMES), ARM, RIGHT),
    "with a prefix in another order": (tuple(f"left_{n}" for n in SHUFFLED), ARM, RIGHT),
    "in capitals": (tuple(n.upper() for n in NAMES), ARM, RIGHT),
    "with a suffix": (tuple(f"{n}_joint" for n in NAMES), ARM, RIGHT),
    "with wheels": ((*NAMES, "wheel"), ARM, RIGHT),
    "with a gripper and a lift": ((*NAMES, "finger", "lift"), ARM, RIGHT),
    "of two arms": ((*(f"left_{n}" for n in NAMES), *(f"right_{n}" for n in NAMES)), ARM, ASK),
    "with one missing": (NAMES[:2], ARM, RIGHT),
    "with one missing and a prefix": (tuple(f"left_{n}" for n in NAMES[:2]), ARM, RIGHT),
    "of another robot with as many": (("waist", "shoulder", "elbow"), ARM, ASK),
    "of another robot with more": (tuple(f"iiwa_joint_{i}" for i in range(1, 8)), ARM, ASK),
    "of another robot with fewer": (("pan", "tilt"), ARM, ASK),
    "numbers from 0": (("j0", "j1", "j2"), ARM, ASK),
    "of wheels alone": (("wheel_left", "wheel_right"), ARM, ASK),
    "of a Panda": (SEVEN.arm, SEVEN, RIGHT),
    "of a Panda with another prefix": (tuple(f"fr3_joint{i}" for i in range(1, 8)), SEVEN, RIGHT),
    "of a Panda with an id": (tuple(f"left_panda_joint{i}" for i in range(1, 8)), SEVEN, RIGHT),
}


@pytest.mark.parametrize("kind", JOINTS)
def test_joints_of_a_bag_are_held_against_the_robots(kind, tmp_path):
    """A name that is the robot's joint for sure becomes it; where it is not sure, nothing is imported before a person
    read the proposal, which says CHECK."""
    names, robot, outcome = JOINTS[kind]
    count = len(names)
    messages = [
        replace(m, names=names, position=tuple(0.1 * (i + 1) + 0.5 * np.sin(2 * t + i) for i in range(count)),
                velocity=(), effort=tuple(float(i + 1) for i in range(count)))
        for m, t in zip(sound(), TRUE, strict=True)
    ]  # fmt: skip
    (foreign,) = read_foreign(written(tmp_path / "a.mcap", messages))
    if outcome == ASK:
        with pytest.raises(InputError, match="not called as the robot's"):
            known_columns(foreign, robot)
        try:
            guessed = guess_map([foreign], robot)
        except InputError:
            return
        of_arm = [e for e in guessed.entries.values() if e.channel.partition(".")[2] in robot.arm]
        assert all(entry.check for entry in of_arm)
        return
    found = imported(foreign, known_columns(foreign, robot))
    digits = {"".join(filter(str.isdigit, n))[-1:]: i for i, n in enumerate(names) if n not in robot.grippers}
    for joint in robot.arm:
        place = digits.get("".join(filter(str.isdigit, joint))[-1:])
        if place is None:
            assert f"tau.{joint}" not in found.run.channels
            assert f"joint '{joint}' of the robot was never sent" in found.run.warnings
        else:
            assert found.run.channels[f"tau.{joint}"].value[0] == place + 1
    renamed = any(name not in robot.names for name in names if name != "wheel")
    assert any("of the robot" in note for note in found.run.warnings) == (renamed or "missing" in kind)


def rows(*columns, separator=",", digits="%.6f"):
    return "\n".join(separator.join(digits % x for x in row) for row in zip(*columns, strict=True))


Q, V, TAU = truth(TRUE)
ALL = (TRUE, *Q.T, *TAU.T)
HEAD = "t,q1,q2,q3,tau1,tau2,tau3"
BLANKS = HEAD.replace(",", " ")
UNITS_BELOW = "s,deg,deg,deg,Nm,Nm,Nm"
IN_DEGREES = (TRUE, *np.rad2deg(Q).T, *TAU.T)
TABLES = {
    "as usual": (f"{HEAD}\n{rows(*ALL)}\n", "", RIGHT),
    "without a last newline": (f"{HEAD}\n{rows(*ALL)}", "", RIGHT),
    "cut in a number": (f"{HEAD}\n{rows(*ALL)}"[:-4], "", RIGHT),
    "cut in a row": (f"{HEAD}\n{rows(*ALL)}"[:-24], "", RIGHT),
    "comments above": (f"# by a logger\n# on Monday\n{HEAD}\n{rows(*ALL)}\n", "", RIGHT),
    "comments in between": (f"{HEAD}\n{rows(*(c[:100] for c in ALL))}\n# paused\n{rows(*(c[100:] for c in ALL))}\n", "", RIGHT),  # noqa: E501
    "numpy's header": (f"# {BLANKS}\n{rows(*ALL, separator=' ', digits='%.18e')}\n", "", RIGHT),
    "numpy's header with commas over blanks": (f"# {HEAD}\n{rows(*ALL, separator=' ')}\n", "", RIGHT),
    "Octave's header": (f"% made by Octave 8\n% {BLANKS}\n{rows(*ALL, separator=' ')}\n", "", RIGHT),
    "lines above": (f"Robot: A\nDate: Monday\n\n{HEAD}\n{rows(*ALL)}\n", "", RIGHT),
    "a line above with as many commas": (f"Robot,A,,,,,\n{HEAD}\n{rows(*ALL)}\n", "", RIGHT),
    "units below": (f"{HEAD}\n{UNITS_BELOW}\n{rows(*IN_DEGREES)}\n", "", RIGHT),
    "units in brackets below": (f"{HEAD}\n[s],[deg],[deg],[deg],[Nm],[Nm],[Nm]\n{rows(*IN_DEGREES)}\n", "", RIGHT),
    "tabs": (HEAD.replace(",", "\t") + f"\n{rows(*ALL, separator=chr(9))}\n", "", RIGHT),
    "decimal commas": (HEAD.replace(",", ";") + f"\n{rows(*ALL, separator=';')}\n".replace(".", ","), "", RIGHT),
    "decimal commas under a comment": ("# x\n" + HEAD.replace(",", ";") + f"\n{rows(*ALL, separator=';')}\n".replace(".", ","), "", RIGHT),  # noqa: E501
    "no stamps": (f"{HEAD[2:]}\n{rows(*ALL[1:])}\n", "100 Hz", RIGHT),
    "no stamps and no rate": (f"{HEAD[2:]}\n{rows(-ALL[1], *ALL[2:4], -ALL[4], *ALL[5:])}\n", "", "rate"),
    "no header": (f"{rows(*ALL)}\n", "", ASK),
    "no header, as MATLAB saves": ("\n".join("   " + line.replace(" ", "   ") for line in rows(*ALL, separator=" ", digits="%.7e").split("\n")) + "\n", "", ASK),  # noqa: E501
    "no header under a comment": (f"# by a logger\n{rows(*ALL)}\n", "", ASK),
    "neither header nor stamps": (f"{rows(*ALL[1:])}\n", "100 Hz", ASK),
    "no header and too many columns": (f"{rows(*ALL, TRUE)}\n", "", "has no header"),
    "energies": (f"t,q1,q2,q3,energy1 [J],energy2 [J],energy3 [J]\n{rows(*ALL)}\n", "", "none"),
    "energies by their unit": (f"t,q1,q2,q3,tau1 (J),tau2 (J),tau3 (J)\n{rows(*ALL)}\n", "", "none"),
    "energies by their name": (f"t,q1,q2,q3,E_kin,E_pot,kinetic_energy\n{rows(*ALL)}\n", "", "none"),
    "a stamp that goes back once": (f"{HEAD}\n{rows(at([50], -1.0)(TRUE.copy()), *ALL[1:])}\n", "", RIGHT),
    "a stamp ahead once": (f"{HEAD}\n{rows(at([50], 9e5)(TRUE.copy()), *ALL[1:])}\n", "", RIGHT),
    "a row twice": (f"{HEAD}\n{rows(*(np.insert(c, 50, c[50]) for c in ALL))}\n", "", RIGHT),
}  # fmt: skip


@pytest.mark.parametrize("kind", TABLES)
def test_tables_of_every_kind_become_the_run_or_ask(kind, tmp_path):
    """`none`: what is no torque becomes none; other words: what the one line says."""
    text, rate, outcome = TABLES[kind]
    (tmp_path / "a.csv").write_text(text)
    (foreign,) = read_foreign(tmp_path / "a.csv")
    if outcome not in (RIGHT, ASK, "none"):
        with pytest.raises(InputError, match=outcome):
            guess_map([foreign], ALONE, rate)
        return
    mapping = guess_map([foreign], ALONE, rate)
    assert all((bool(entry.check)) == (outcome == ASK) for entry in mapping.entries.values())
    found = imported(foreign, mapping)
    (account,) = found.accounts
    assert account.came == account.kept + sum(account.left_out.values())
    assert N - 1 <= account.kept <= N
    assert {name.partition(".")[0] for name in found.run.channels} == {"q"} if outcome == "none" else {"q", "tau"}
    check_against_truth(found.run, 1e-3)


def matlab(path, **content):
    from scipy.io import savemat

    savemat(path, content)


MATLAB = {
    "vectors and matrices": ({"t": TRUE, "q": Q, "tau": TAU, "name": "x", "gain": 3.0}, ""),
    "columns": ({"t": TRUE[:, None], "q": Q, "tau": TAU}, ""),
    "matrices that lie": ({"t": TRUE, "q": Q.T, "tau": TAU.T}, ""),
    "a structure": ({"out": {"time": TRUE, "q": Q, "tau": TAU}}, ""),
    "structures in structures": ({"log": {"t": TRUE, "arm": {"q": Q, "tau": TAU}}}, ""),
    "other lengths": ({"t": TRUE, "q": Q, "tau": TAU, "spectrum": np.ones(77)}, ""),
    "no stamps": ({"q": Q, "tau": TAU, "fs": 100.0}, "100 Hz"),
}


@pytest.mark.parametrize("kind", MATLAB)
def test_matlabs_arrays_are_columns(kind, tmp_path):
    content, rate = MATLAB[kind]
    matlab(tmp_path / "a.mat", **content)
    (foreign,) = read_foreign(tmp_path / "a.mat")
    found = imported(foreign, guess_map([foreign], ALONE, rate))
    assert set(found.run.channels) == {f"{kind}.{name}" for kind in ("q", "tau") for name in NAMES}
    check_against_truth(found.run)


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM" + bytes(400), "-v7"),
        (b"not MATLAB's" * 50, "no MATLAB file that can be read"),
        (b"", "no MATLAB file that can be read"),
    ],
)
def test_what_is_no_matlab_file_is_one_line(content, says, tmp_path):
    (tmp_path / "a.mat").write_bytes(content)
    with pytest.raises(InputError, match=says):
        read_foreign(tmp_path / "a.mat")


def test_a_pendulum_by_video_or_phone(tmp_path):
    """Tracker and phyphox: the angle is the angle, a rate is a rate, x and y in a picture are no gripper."""
    swing = 0.4 * np.sin(4 * TRUE)
    rate = 1.6 * np.cos(4 * TRUE)
    tracker = "mass A\nt\tx\ty\tθ\n" + rows(TRUE, np.sin(swing), -np.cos(swing), swing, separator="\t")
    phone = '"Time (s)","Gyroscope x (rad/s)","Gyroscope y (rad/s)"\n' + rows(TRUE, 0.01 * rate, rate, digits="%.9E")
    for text, channels in ((tracker, {"swing_angle"}), (phone, {"swing_rate"})):
        (tmp_path / "a.txt").write_text(text, encoding="utf-8")
        mapping = guess_map(read_foreign(tmp_path / "a.txt"))
        assert {entry.channel for entry in mapping.entries.values()} == channels
        assert all(entry.check for entry in mapping.entries.values())
    (tmp_path / "a.txt").write_text("t,x,y\n" + rows(TRUE, np.sin(swing), -np.cos(swing)))
    with pytest.raises(InputError, match="x and y of a load are no channels"):
        guess_map(read_foreign(tmp_path / "a.txt"))


SHEET = """<worksheet xmlns="http://schemas.openxmlformats.org/spreadsheetml/2006/main"><sheetData>{}</sheetData></worksheet>"""
STRINGS = """<sst xmlns="http://schemas.openxmlformats.org/spreadsheetml/2006/main">{}</sst>"""


def test_the_first_sheet_of_a_workbook_is_a_table(tmp_path):
    names = HEAD.split(",")
    head = "".join(f'<c r="{chr(65 + i)}1" t="s"><v>{i}</v></c>' for i in range(len(names)))
    lines = [
        "".join(f'<c r="{chr(65 + i)}{k}"><v>{x:.9f}</v></c>' for i, x in enumerate(row))
        for k, row in enumerate(zip(*ALL, strict=True), start=2)
    ]
    with zipfile.ZipFile(tmp_path / "a.xlsx", "w") as archive:
        body = "".join(f"<row>{line}</row>" for line in (head, *lines))
        archive.writestr("xl/worksheets/sheet1.xml", SHEET.format(body))
        archive.writestr("xl/sharedStrings.xml", STRINGS.format("".join(f"<si><t>{n}</t></si>" for n in names)))
    (foreign,) = read_foreign(tmp_path / "a.xlsx")
    check_against_truth(imported(foreign, guess_map([foreign], ALONE)).run)
    (tmp_path / "a.xlsx").write_bytes(b"?")
    with pytest.raises(InputError, match="save it as CSV"):
        read_foreign(tmp_path / "a.xlsx")
