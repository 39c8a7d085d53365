"""The motion of an arm in a run: smoothed positions, with their velocities and accelerations."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import erf

from armdyn.arm.drives import law_of_commands
from armdyn.errors import InputError
from armdyn.object_cache import cached_with_first_argument
from armdyn.recording.channels import Channel
from armdyn.run import Run
from armdyn.smoothing.choice import (
    SPLINE_ORDERS,
    MeasuredDerivative,
    SmoothingChoice,
    best_smoothing,
    derivative_noise,
    smooth_curve,
)
from armdyn.smoothing.spline import MIN_SMOOTHED_SAMPLES, SplineCurve

MIN_VELOCITY_NOISE = 1e-3
"""Least noise of a joint's velocity, as a share of its speed."""
MIN_CERTAIN_VELOCITY_SIGN = 0.99
"""Expected sign of a velocity from which its sign is known."""
MIN_MOVING_TIME_SHARE = 0.05
"""Share of the time during which a joint must certainly move for its rests to be left out: with less there is hardly a
motion to compare, and its weight at rest is all that the recordings show."""
CREEP_SPEED = 1e-3
"""Speed of creep, rad/s, and a tenth of it in m/s: a slower joint moves within the elastic deformation of its gears and
of the bristles of its friction, which has no certain direction (Armstrong-Hélouvry, Dupont & Canudas de Wit, Automatica
30(7), 1994). So a joint at rest has no friction with a random sign. A larger value would suit real arms (other motions
of a UR10e are predicted to 4.12, 3.79 and 3.51 N m with 0, 0.001 and 0.003); up to 0.001 a sharp sign remains exact."""


@dataclass(frozen=True, eq=False)
class Motion:
    """Positions, velocities and accelerations of an arm's joints at n times.

    Attributes:
        time: (n,) times, s.
        q: (n, nj) positions, rad or m.
        v: (n, nj) velocities, per s.
        a: (n, nj) accelerations, per s^2.
        direction: (n, nj) expected signs of the velocities, given their noise.
    """

    time: np.ndarray
    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    direction: np.ndarray

    def own_columns(self, joint: int, fading: Sequence[float]) -> list[np.ndarray]:
        """(n,) regression columns of a joint's own torques: offset, springs, viscous friction, rotor, dry frictions.

        A friction that fades with the speed is a mixture of those that fade over the speeds `fading`, rad/s or m/s.
        """
        q, v, a, way = (part[:, joint] for part in (self.q, self.v, self.a, self.direction))
        frictions = [way * np.exp(-((v / speed) ** 2)) for speed in fading]
        return [np.ones(len(q)), q, np.sin(q), np.cos(q), v, a, way, *frictions]


@dataclass(frozen=True, eq=False)
class SmoothedJointMotion:
    """Smoothed path of one joint.

    Attributes:
        curve: position over time, rad or m.
        choice: smoothing of the measured position.
        interval: interval between its samples, s.
        smoothed_velocity_noise_std: standard deviation of the smoothed velocity, as it matters for friction, rad/s or
            m/s.
        moving_share: share of the recording during which the joint certainly moves.
        mostly_rests: whether the joint mostly rests, so that its rests are compared as well.
        reversal_times: (k,) times at which the smoothed velocity changes its sign, s.
        moves_between_reversals: (k + 1,) bool, whether the joint certainly moves between two such times: after a stop
            smoothed positions oscillate.
    """

    curve: SplineCurve
    choice: SmoothingChoice
    interval: float
    smoothed_velocity_noise_std: float
    moving_share: float
    mostly_rests: bool
    reversal_times: np.ndarray
    moves_between_reversals: np.ndarray

    def direction(self, time: np.ndarray, velocity: np.ndarray) -> np.ndarray:
        """(n,) expected sign of (n,) velocities at (n,) times; 0 at uncertain ones of a joint that mostly rests.

        Friction at rest is not that of a motion.
        """
        expected = (
            expected_sign(velocity, self.smoothed_velocity_noise_std)
            * self.moves_between_reversals[np.searchsorted(self.reversal_times, time)]
        )
        return np.where(np.abs(expected) < MIN_CERTAIN_VELOCITY_SIGN, 0.0, expected) if self.mostly_rests else expected


@dataclass(frozen=True, eq=False)
class MeasuredMotion:
    """Smoothed paths of all joints of an arm, valid from `start` to `end`, s."""

    joints: tuple[SmoothedJointMotion, ...]
    start: float
    end: float

    def at(self, time: np.ndarray) -> Motion:
        """The motion at (n,) times, s; before and after the recording the arm rests."""
        inside = np.clip(time, self.start, self.end)
        q, v, a = (np.column_stack([j.curve(inside, k)[:, 0] for j in self.joints]) for k in range(3))
        ways = [j.direction(inside, v[:, i]) for i, j in enumerate(self.joints)]
        return Motion(time, q, v, a, np.column_stack(ways))

    def standing(self, stands: Sequence[bool]) -> "MeasuredMotion":
        """A copy of the motion in which `stands` says whether each joint mostly rests."""
        joints = tuple(replace(j, mostly_rests=still) for j, still in zip(self.joints, stands, strict=True))
        return replace(self, joints=joints)

    def direction(self, joint: int, time: np.ndarray) -> np.ndarray:
        """(n,) expected sign of the velocity of the joint with index `joint` at (n,) times, s."""
        path, inside = self.joints[joint], np.clip(time, self.start, self.end)
        return path.direction(inside, path.curve(inside, 1)[:, 0])


def expected_sign(velocity: np.ndarray, noise: float) -> np.ndarray:
    """(n,) expected signs of velocities with normal noise of this standard deviation."""
    return np.asarray(erf(velocity / (np.sqrt(2.0) * noise)))


def mostly_resting_joint_mask(motions: Sequence[MeasuredMotion]) -> tuple[bool, ...]:
    """Whether each joint hardly moves in all recordings together, by `MIN_MOVING_TIME_SHARE`."""
    lasts = np.array([motion.end - motion.start for motion in motions])
    moving = np.array([[j.moving_share for j in motion.joints] for motion in motions])
    return tuple((lasts @ moving < MIN_MOVING_TIME_SHARE * lasts.sum()).tolist())


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
def _joint_curve(q: Channel, v: Channel | None, a: Channel | None) -> SmoothedJointMotion:
    """Path of a joint, cached with its position channel, which other versions of a run share."""
    interval = float((q.time[-1] - q.time[0]) / (len(q) - 1))
    choice = best_smoothing(q.time, q.value, SPLINE_ORDERS)
    rates = [
        MeasuredDerivative(c.time, c.value, k)
        for k, c in ((1, v), (2, a))
        if c is not None and len(c) >= MIN_SMOOTHED_SAMPLES
    ]
    curve = smooth_curve(q.time, q.value, choice, rates)
    position, velocity = curve(q.time)[:, 0], curve(q.time, 1)[:, 0]
    speed = float(np.sqrt(np.mean(velocity**2)))
    creep = 0.1 * CREEP_SPEED if q.unit == "m" else CREEP_SPEED
    noise = max(derivative_noise(choice, interval, 1), MIN_VELOCITY_NOISE * speed, creep)
    moving = float(np.mean(np.abs(expected_sign(velocity, noise)) >= MIN_CERTAIN_VELOCITY_SIGN))
    turns = np.flatnonzero(np.diff(velocity > 0.0)) + 1
    moves = _moves(q.value, position, np.concatenate([[0], turns]), choice.noise)
    return SmoothedJointMotion(
        curve, choice, interval, noise, moving, moving < MIN_MOVING_TIME_SHARE, q.time[turns], moves
    )


def _moves(recorded: np.ndarray, smoothed: np.ndarray, begins: np.ndarray, noise: float) -> np.ndarray:
    """(k,) bool, whether a joint certainly moves in each of k parts of a recording, from (k,) first samples on.

    It moves farther than the noise of one sample, and the slope of the regression of (n,) recorded on (n,) smoothed
    positions has a certain sign.
    """
    counts = np.diff(np.append(begins, len(smoothed)))
    means = (np.add.reduceat(values, begins) / counts for values in (recorded, smoothed))
    own, way = (values - np.repeat(m, counts) for values, m in zip((recorded, smoothed), means, strict=True))
    along, square = np.add.reduceat(own * way, begins), np.add.reduceat(way**2, begins)
    seen = (
        expected_sign(along / np.maximum(noise * np.sqrt(square), np.finfo(float).tiny), 1.0)
        >= MIN_CERTAIN_VELOCITY_SIGN
    )
    way_there = np.abs(smoothed[np.append(begins[1:], len(smoothed)) - 1] - smoothed[begins])
    return seen & (way_there > noise)


def motion_channels(run: Run, sliding: Mapping[str, bool]) -> dict[str, Channel]:
    """Position ``q``, velocity ``v`` and acceleration ``a`` of every joint, at the stamps of the first one's position.

    `sliding` is whether each joint slides, by its name.

    Raises:
        InputError: a position is missing, or its samples are too few.
    """
    motion = measured_motion(run.recording, tuple(sliding))
    first = run.recording.channels[f"q.{next(iter(sliding))}"]
    time = first.time[(first.time >= motion.start) & (first.time <= motion.end)]
    at = motion.at(time)
    return {
        f"{kind}.{joint}": Channel(time, values[:, i], f"{'m' if slides else 'rad'}{per}")
        for i, (joint, slides) in enumerate(sliding.items())
        for kind, values, per in (("q", at.q, ""), ("v", at.v, "/s"), ("a", at.a, "/s^2"))
    }


def without_idle_torques(run: Run, joints: tuple[str, ...]) -> Run:
    """The run without constant torques of joints that rest in it: a drive at rest may report one value all the time.

    A torque that is constant while its joint moves stays, for a sensor that was not connected; so does the last one.
    """
    torques = [name for joint in joints if (name := f"tau.{joint}") in run.channels]
    constant = {name for name in torques if np.ptp(run.channels[name].value) == 0.0}
    if not constant or len(constant) == len(torques):
        return run
    motion = dict(zip(joints, measured_motion(run, joints).joints, strict=True))
    idle = {n for n in constant if motion[n.removeprefix("tau.")].moving_share < MIN_MOVING_TIME_SHARE}
    return replace(run, channels={name: c for name, c in run.channels.items() if name not in idle}) if idle else run


def torque_channels(
    run: Run, sliding: Mapping[str, bool], carried: Collection[str], beside: Sequence[str] = ()
) -> tuple[str, ...]:
    """Channels with the torques of an arm's joints, without those of `carried` joints, then those `beside` them.

    Raises:
        InputError: the run has no such channel, or lacks a position, or one is in the unit of another kind of joint.
    """
    asked = [joint for joint in sliding if joint not in carried]
    channels = (*(f"tau.{joint}" for joint in asked if f"tau.{joint}" in run.channels), *beside)
    where = run.source or run.name
    if not channels:
        others = [name.removeprefix("tau.") for name in run.channels if name.startswith("tau.")]
        law = law_of_commands(run)
        advice = "record 'tau.<joint>'"
        advice += f" or, as it holds commands, make the model with --drive servo:{law}=all" if law else ""
        if others:
            advice = (
                f"it holds those of {', '.join(others)}: import its log again, with --urdf or --robot, so that joints "
                "are called as the robot's"
            )
        raise InputError(f"{where}: holds no torque of {', '.join(asked)}, so there is nothing to compare: {advice}")
    for joint, slides in sliding.items():
        unit = _position(run, joint).unit
        if (unit == "m") != slides:
            moves = "slides" if slides else "turns"
            raise InputError(f"{where}: 'q.{joint}' is in {unit}, but the joint {moves}: correct the column's unit")
    return channels


def _position(run: Run, joint: str) -> Channel:
    if f"q.{joint}" not in run.channels:
        raise InputError(
            f"{run.source or run.name}: holds no 'q.{joint}', the position of a joint of the arm: record it, or choose "
            "the arm's joints without it"
        )
    return run.channels[f"q.{joint}"]
