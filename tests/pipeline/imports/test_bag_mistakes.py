"""Bags with mistakes of every kind: what is sound becomes the run, what is not is left out, counted and named."""

from dataclasses import replace

import numpy as np
import pytest

from armdyn.errors import InputError
from armdyn.inspection.inspect import inspect_runs
from pipeline.imports import read_foreign
from pipeline.imports.conversion import run_from_recording
from pipeline.imports.guess import guess_map, map_unambiguous_columns

from .said import (
    ARM,
    ASK,
    NAMES,
    RIGHT,
    SEVEN,
    START,
    STEP,
    TRUE,
    N,
    at,
    check_against_truth,
    overtaken,
    run_of,
    second,
    sound,
    stamped,
    truth,
    written,
)

ZERO = (0.0, 0.0, 0.0)
HELD = (0.3, -0.2, 0.1)
NAN = float("nan")
SHUFFLED = ("j2", "j3", "j1")
OTHER = {"position": ZERO, "velocity": (), "effort": ()}
S = slice


def scattered():
    """Twenty stamps are off by a minute or so."""
    chosen = np.random.default_rng(1).choice(N, 20, replace=False)
    return stamped(at(chosen, lambda s: s + np.random.default_rng(2).normal(0, 50, 20)))


def stalled():
    """A bridge passes nothing on for 0.8 s, and then everything at once."""
    late = START + 1.8
    return [replace(m, received=max(m.received, late)) if 100 <= k < 180 else m for k, m in enumerate(sound())]


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
    "twenty at random": (scattered, 20),
    "the clock set back by 2 s": (lambda: stamped(at(S(150, None), lambda s: s - 2.0)), 0),
    "the clock set back by 0.2 s": (lambda: stamped(at(S(150, None), lambda s: s - 0.2)), 0),
    "the clock set forward by a day": (lambda: stamped(at(S(150, None), lambda s: s + 86400.0)), 0),
    "the clock started anew twice": (lambda: stamped(lambda s: s % 1.0), 0),
    "s since boot, then since 1970": (lambda: stamped(at(S(120), lambda s: s - START + 5.0)), 0),
    "no stamps": (lambda: stamped(lambda s: s + NAN), 0),
    "a stamp that stands": (lambda: stamped(lambda s: 0 * s + 5.0), 0),
    "all stamps 0": (lambda: stamped(lambda s: s - np.inf), 0),
    "a bridge that stalls for 0.8 s": (stalled, 0),
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
    "zeros with efforts of zero": (
        lambda: second(10, 0.0043, names=SHUFFLED, position=ZERO, velocity=ZERO, effort=ZERO), 30),
    "zeros with efforts of zero, in the same order": (
        lambda: second(5, 0.0043, position=ZERO, velocity=ZERO, effort=ZERO), 60),
    "a held posture": (lambda: second(3, position=HELD, velocity=(), effort=()), 100),
    "a held posture in another order": (lambda: second(3, names=SHUFFLED, position=HELD, velocity=(), effort=()), 100),
    "a held posture with speeds": (lambda: second(4, position=HELD, velocity=ZERO, effort=()), 75),
    "a held posture that comes more often": (
        lambda: [x for m in sound() for x in (m, replace(m, received=m.received + 1e-4, names=SHUFFLED, position=HELD,
        velocity=(), effort=()), replace(m, received=m.received + 2e-4, stamp=m.stamp + 0.005, names=SHUFFLED,
        position=HELD, velocity=(), effort=()))], 600),
    "a held posture of another year": (
        lambda: second(2, -3e7, names=SHUFFLED, position=HELD, velocity=(), effort=()), 150),
    "zeros that are not stamped": (
        lambda: [replace(m, stamp=None) if m.position == ZERO else m for m in second(2, names=SHUFFLED, **OTHER)],
        150),
    "zeros of two joints": (lambda: second(2, names=("j3", "j1"), position=(0.0, 0.0), velocity=(), effort=()), 150),
    "zeros of one joint": (lambda: second(2, names=("j3",), position=(0.0,), velocity=(), effort=()), 150),
    "what the arm is told, without efforts": (
        lambda: [x for k, m in enumerate(sound()) for x in (m, replace(m, received=m.received + 1e-4, names=SHUFFLED,
        position=tuple(truth(TRUE[k] + 0.3)[0][[1, 2, 0]]), velocity=(), effort=()))], 300),
    "zeros on a topic of their own": (lambda: second(1, topic="/joint_states_gui", **OTHER), 0),
    "zeros more often on a topic of their own": (
        lambda: [*second(1, topic="/gui", **OTHER), *second(1, 0.005, topic="/gui", **OTHER)], 0),
}  # fmt: skip
UNSOUND = {
    "efforts that are never sent": (lambda: [replace(m, effort=()) for m in sound()], ("tau.j1", "tau.j2", "tau.j3")),
    "efforts of zero": (lambda: [replace(m, effort=ZERO) for m in sound()], ("tau.j1", "tau.j2", "tau.j3")),
    "efforts of NaN": (lambda: [replace(m, effort=(NAN,) * 3) for m in sound()], ("tau.j1", "tau.j2", "tau.j3")),
    "one effort of NaN": (lambda: [replace(m, effort=(*m.effort[:2], NAN)) for m in sound()], ("tau.j3",)),
    "one effort of 0": (lambda: [replace(m, effort=(*m.effort[:2], 0.0)) for m in sound()], ("tau.j3",)),
    "fewer efforts than names": (
        lambda: [replace(m, effort=m.effort[:2]) for m in sound()], ("tau.j1", "tau.j2", "tau.j3")),
    "speeds that are never sent": (lambda: [replace(m, velocity=()) for m in sound()], ("v.j1", "v.j2", "v.j3")),
    "efforts in every second message": (
        lambda: [replace(m, effort=() if k % 2 else m.effort) for k, m in enumerate(sound())], ()),
    "efforts from the middle on": (
        lambda: [replace(m, effort=() if k < 150 else m.effort) for k, m in enumerate(sound())], ()),
    "a NaN now and then": (
        lambda: [replace(m, position=(NAN, *m.position[1:])) if k % 50 == 7 else m for k, m in enumerate(sound())],
        ()),
    "an effort of 1e30 once": (
        lambda: [replace(m, effort=(1e30, *m.effort[1:])) if k == 7 else m for k, m in enumerate(sound())], ()),
    "messages that are not JSON": (
        lambda: [replace(m, raw=b"{") if k % 50 == 7 else m for k, m in enumerate(sound())], ()),
    "messages of another kind on the topic": (
        lambda: [replace(m, raw=b'{"name": ["j1"], "position": "?"}') if k % 50 == 7 else m for k,
        m in enumerate(sound())], ()),
    "messages without names": (lambda: [replace(m, names=()) if k % 50 == 7 else m for k, m in enumerate(sound())], ()),
    "a joint named twice": (
        lambda: [replace(m, names=(*NAMES, "j3"), position=(*m.position, m.position[2]), velocity=(),
        effort=()) for m in sound()], ("v.j1", "tau.j1")),
    "wheels without efforts": (
        lambda: [replace(m, names=(*NAMES, "wheel"), position=(*m.position, 0.1), velocity=(*m.velocity, NAN),
        effort=(*m.effort, NAN)) for m in sound()], ("v.wheel", "tau.wheel")),
    "joints in another order from the middle on": (
        lambda: [m if k < 150 else replace(m, names=SHUFFLED, position=(*m.position[1:], m.position[0]),
        velocity=(*m.velocity[1:], m.velocity[0]), effort=(*m.effort[1:], m.effort[0])) for k,
        m in enumerate(sound())], ()),
    "two drivers with a joint each": (
        lambda: [x for m in sound() for x in (replace(m, names=NAMES[:2], position=m.position[:2],
        velocity=m.velocity[:2], effort=m.effort[:2]), replace(m, received=m.received + 0.001, names=NAMES[2:],
        position=m.position[2:], velocity=m.velocity[2:], effort=m.effort[2:]))], ()),
    "a gripper's own messages": (
        lambda: [x for m in sound() for x in (m, replace(m, names=("finger",), position=(0.02,), velocity=(),
        effort=()))], ()),
    "interfaces in place of joints": (
        lambda: [replace(m, names=tuple(f"{n}/{w}" for n in NAMES for w in ("position", "velocity", "effort")),
        position=tuple(np.column_stack([m.position, m.velocity, m.effort]).ravel()), velocity=(),
        effort=()) for m in sound()], ()),
}  # fmt: skip


@pytest.mark.parametrize("kind", STAMPS)
def test_a_bad_stamp_costs_one_sample_and_a_clock_that_is_set_none(kind, tmp_path):
    make, lost = STAMPS[kind]
    messages = make()
    found = run_of(tmp_path, messages)
    account = found.accounts[0]
    assert account.came - account.kept == lost
    by_stamps = account.stamped and not account.steps and messages[100].stamp
    check_against_truth(found.run, 1e-4 if by_stamps else 2e-3)
    assert bool(found.checks) == (lost > 0 or bool(account.steps) or not account.stamped)
    assert not any(check.kind == "gap" for check in inspect_runs([found.run]).checks)


@pytest.mark.parametrize("kind", PUBLISHERS)
def test_a_second_publisher_is_not_mixed_in_and_is_told(kind, tmp_path):
    make, others = PUBLISHERS[kind]
    found = run_of(tmp_path, make())
    check_against_truth(found.run)
    assert len(found.run.channels["tau.j3"]) >= N - 5
    (account,) = found.accounts
    told = sum(count for why, count in account.left_out.items() if why.startswith("of a second publisher"))
    assert told == pytest.approx(others, abs=5)
    if others:
        assert [check.kind for check in found.checks] == ["second_publisher"]
    assert others or any("is used" in note for note in found.run.warnings)


SILENT = ("efforts that are never sent", "speeds that are never sent", "efforts in every", "efforts from the",
          "a joint named", "joints in another order", "two drivers", "a gripper's own", "interfaces")  # fmt: skip


@pytest.mark.parametrize("kind", UNSOUND)
def test_what_was_not_sent_is_missing_and_blocks_nothing(kind, tmp_path):
    make, lacks = UNSOUND[kind]
    found = run_of(tmp_path, make())
    check_against_truth(found.run)
    assert not set(lacks) & found.run.channels.keys()
    every = {f"{group}.{name}" for group in ("q", "v", "tau") for name in NAMES}
    assert "twice" in kind or every - set(lacks) <= found.run.channels.keys()
    said = " ".join([*found.run.warnings, *(account.sentence for account in found.accounts)])
    words = ("numbers", "nothing can be read", "nothing but zeros", "missing", "for 3 joints")
    assert kind.startswith(SILENT) or any(word in said for word in words)


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
def test_joints_of_a_bag_are_held_against_the_robots(kind, tmp_path, complains):
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
        with complains(InputError):
            map_unambiguous_columns(foreign, robot)
        try:
            guessed = guess_map([foreign], robot)
        except InputError:
            return
        of_arm = [e for e in guessed.entries.values() if e.channel.partition(".")[2] in robot.arm]
        assert all(entry.check for entry in of_arm)
        return
    found = run_from_recording(foreign, map_unambiguous_columns(foreign, robot))
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
