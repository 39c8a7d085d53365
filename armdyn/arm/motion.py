"""How an arm moved in a run: positions smoothed with the noise that they have, and differentiated."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import erf

from armdyn.errors import InputError
from armdyn.kept import cached_with_first_argument
from armdyn.recording.channels import Channel
from armdyn.run import Run
from armdyn.smoothing import (
    MIN_SMOOTHED_SAMPLES,
    SPLINE_ORDERS,
    Choice,
    Curve,
    Rates,
    best_smoothing,
    derivative_noise,
    smoothed,
)

SHARPEST = 1e-3
"""Of a joint's speed: the least noise that its velocity is taken to have."""
CERTAIN = 0.99
"""Expected sign of a velocity from which its sign is known."""
STANDING = 0.5
"""Share of the time during which a joint must surely move for its rests to be left out."""
CREEP = 1e-3
"""rad/s, and a tenth of it in m/s: a slower joint creeps within what its gears and the bristles of its friction bend,
and the direction of its friction is not that of its velocity (Armstrong-Hélouvry, Dupont & Canudas de Wit, Automatica
30(7), 1994). So a joint at rest has no friction whose sign is noise. Real arms would have it larger (other motions of a
UR10e are predicted to 4.12, 3.79 and 3.51 N m with 0, 0.001 and 0.003); up to 0.001 a sharp sign is told exactly."""


@dataclass(frozen=True, eq=False)
class Motion:
    """Positions, velocities and accelerations at some times.

    Attributes:
        time: (n,) s.
        q: (n, nj) rad or m.
        v: (n, nj) per s.
        a: (n, nj) per s^2.
        direction: (n, nj) expected sign of v, given how well it is known.
    """

    time: np.ndarray
    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    direction: np.ndarray


@dataclass(frozen=True, eq=False)
class JointCurve:
    """One joint's path.

    Attributes:
        curve: position over time, rad or m.
        choice: how the measured position was smoothed.
        interval: between its samples, s.
        speed_noise: by how much its smoothed velocity is off, as far as friction is concerned, rad/s or m/s.
        moving: share of the recording during which it surely moves.
        stands: whether it hardly does anything but rest, so that rests are all that it shows.
        turns: (k,) s, where its smoothed velocity changes sign.
        moves: (k + 1,) bool, whether between two turns it is seen to move: smoothed positions swing after a quick stop.
    """

    curve: Curve
    choice: Choice
    interval: float
    speed_noise: float
    moving: float
    stands: bool
    turns: np.ndarray
    moves: np.ndarray

    def direction(self, time: np.ndarray, velocity: np.ndarray) -> np.ndarray:
        """(n,) expected sign of (n,) velocities at (n,) times; if unknown, none where the joint mostly stands.

        What a joint at rest is held by is no friction that a motion shows.
        """
        expected = expected_sign(velocity, self.speed_noise) * self.moves[np.searchsorted(self.turns, time)]
        return np.where(np.abs(expected) < CERTAIN, 0.0, expected) if self.stands else expected


@dataclass(frozen=True, eq=False)
class MeasuredMotion:
    """The paths of all joints, good from `start` to `end` s."""

    joints: tuple[JointCurve, ...]
    start: float
    end: float

    def at(self, time: np.ndarray) -> Motion:
        """The motion at (n,) times; outside the recording the arm is where it was at its end."""
        inside = np.clip(time, self.start, self.end)
        q, v, a = (np.column_stack([j.curve(inside, k)[:, 0] for j in self.joints]) for k in range(3))
        ways = [j.direction(inside, v[:, i]) for i, j in enumerate(self.joints)]
        return Motion(time, q, v, a, np.column_stack(ways))

    def standing(self, stands: Sequence[bool]) -> "MeasuredMotion":
        """The same motion where `stands` says which joints hardly do anything but rest."""
        joints = tuple(replace(j, stands=still) for j, still in zip(self.joints, stands, strict=True))
        return replace(self, joints=joints)

    def direction(self, joint: int, time: np.ndarray) -> np.ndarray:
        """(n,) expected sign of one joint's velocity at (n,) times."""
        path, inside = self.joints[joint], np.clip(time, self.start, self.end)
        return path.direction(inside, path.curve(inside, 1)[:, 0])


def expected_sign(velocity: np.ndarray, noise: float) -> np.ndarray:
    """Of (n,) velocities that are known with normal noise."""
    return np.asarray(erf(velocity / (np.sqrt(2.0) * noise)))


def standing_joints(motions: Sequence[MeasuredMotion]) -> tuple[bool, ...]:
    """Which joints rest for more than half of the time of all recordings together.

    A joint that moves through most of them and creeps through one has frictions that its rests do not show.
    """
    lasts = np.array([motion.end - motion.start for motion in motions])
    moving = np.array([[j.moving for j in motion.joints] for motion in motions])
    return tuple((lasts @ moving < STANDING * lasts.sum()).tolist())


@cached_with_first_argument
def measured_motion(run: Run, joints: tuple[str, ...]) -> MeasuredMotion:
    """Smooth the recorded motion of `joints`.

    Measured velocities and accelerations are used where they agree with the positions.

    Raises:
        InputError: a joint's position was not recorded, or hardly.
    """
    curves = []
    start, end = -np.inf, np.inf
    for name in joints:
        q = _position(run, name)
        if len(q) < MIN_SMOOTHED_SAMPLES:
            raise InputError(
                f"{run.source or run.name}: 'q.{name}' has {len(q)} samples, at least {MIN_SMOOTHED_SAMPLES} are "
                "needed: record longer"
            )
        start, end = max(start, float(q.time[0])), min(end, float(q.time[-1]))
        curves.append(_joint_curve(q, run.channels.get(f"v.{name}"), run.channels.get(f"a.{name}")))
    if not start < end:
        raise InputError(
            f"{run.source or run.name}: the joints' positions were recorded at different times: record again"
        )
    return MeasuredMotion(tuple(curves), start, end)


@cached_with_first_argument
def _joint_curve(q: Channel, v: Channel | None, a: Channel | None) -> JointCurve:
    """By channels, which a run keeps when others of its channels are cleaned."""
    interval = float((q.time[-1] - q.time[0]) / (len(q) - 1))
    choice = best_smoothing(q.time, q.value, SPLINE_ORDERS)
    rates = [Rates(c.time, c.value, k) for k, c in ((1, v), (2, a)) if c is not None and len(c) >= MIN_SMOOTHED_SAMPLES]
    curve = smoothed(q.time, q.value, choice, rates)
    position, velocity = curve(q.time)[:, 0], curve(q.time, 1)[:, 0]
    speed = float(np.sqrt(np.mean(velocity**2)))
    creep = 0.1 * CREEP if q.unit == "m" else CREEP
    noise = max(derivative_noise(choice, interval, 1), SHARPEST * speed, creep)
    moving = float(np.mean(np.abs(expected_sign(velocity, noise)) >= CERTAIN))
    turns = np.flatnonzero(np.diff(velocity > 0.0)) + 1
    moves = _moves(q.value, position, np.concatenate([[0], turns]), choice.noise)
    return JointCurve(curve, choice, interval, noise, moving, moving < STANDING, q.time[turns], moves)


def _moves(recorded: np.ndarray, smoothed: np.ndarray, begins: np.ndarray, noise: float) -> np.ndarray:
    """(k,) bool, whether a joint is seen to move in each of k stretches of a recording.

    It goes further than the noise of one sample, and the recorded positions go the same way: the slope of their
    regression on the smoothed ones has a sign that is certain.

    Args:
        recorded: (n,) positions.
        smoothed: (n,) positions.
        begins: (k,) index of the first sample of each stretch.
        noise: standard deviation of recorded positions.
    """
    counts = np.diff(np.append(begins, len(smoothed)))
    means = (np.add.reduceat(values, begins) / counts for values in (recorded, smoothed))
    own, way = (values - np.repeat(m, counts) for values, m in zip((recorded, smoothed), means, strict=True))
    along, square = np.add.reduceat(own * way, begins), np.add.reduceat(way**2, begins)
    seen = expected_sign(along / np.maximum(noise * np.sqrt(square), np.finfo(float).tiny), 1.0) >= CERTAIN
    way_there = np.abs(smoothed[np.append(begins[1:], len(smoothed)) - 1] - smoothed[begins])
    return seen & (way_there > noise)


def motion_channels(run: Run, joints: Sequence[str], slides: Sequence[bool]) -> dict[str, Channel]:
    """Position ``q``, velocity ``v`` and acceleration ``a`` of every joint, at the stamps of the first one's position.

    Args:
        run: a recording.
        joints: names from base to tool.
        slides: whether each slides.

    Raises:
        InputError: a position is missing, or its samples are too few.
    """
    motion = measured_motion(run.recording, tuple(joints))
    first = run.recording.channels[f"q.{joints[0]}"]
    time = first.time[(first.time >= motion.start) & (first.time <= motion.end)]
    at = motion.at(time)
    found = {}
    for i, joint in enumerate(joints):
        unit = "m" if slides[i] else "rad"
        for kind, values, per in (("q", at.q, ""), ("v", at.v, "/s"), ("a", at.a, "/s^2")):
            found[f"{kind}.{joint}"] = Channel(time, values[:, i], f"{unit}{per}")
    return found


def torque_channels(
    run: Run, joints: Sequence[str], slides: Sequence[bool], carried: Collection[str] = ()
) -> tuple[str, ...]:
    """The measured torques of an arm's joints, of a recording that also holds how every joint moved.

    Args:
        run: a recording.
        joints: names from base to tool.
        slides: whether each slides.
        carried: joints whose torque is not asked for.

    Raises:
        InputError: it holds no torque, or lacks a position, or one is in the unit of another kind of joint.
    """
    asked = [joint for joint in joints if joint not in carried]
    channels = tuple(f"tau.{joint}" for joint in asked if f"tau.{joint}" in run.channels)
    where = run.source or run.name
    if not channels:
        raise InputError(
            f"{where}: holds no torque of {', '.join(asked)}, so there is nothing to compare: record 'tau.<joint>'"
        )
    for joint, sliding in zip(joints, slides, strict=True):
        unit = _position(run, joint).unit
        if (unit == "m") != sliding:
            moves = "slides" if sliding else "turns"
            raise InputError(f"{where}: 'q.{joint}' is in {unit}, but the joint {moves}: mend the column's unit")
    return channels


def _position(run: Run, joint: str) -> Channel:
    if f"q.{joint}" not in run.channels:
        raise InputError(
            f"{run.source or run.name}: holds no 'q.{joint}', the position of a joint of the arm: record it, or choose "
            "the arm's joints without it"
        )
    return run.channels[f"q.{joint}"]
