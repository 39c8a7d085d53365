"""How an arm moved in a run: positions smoothed with the noise that they have, and differentiated."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.special import erf

from armdyn.channels import Channel
from armdyn.errors import InputError
from armdyn.run import Run
from armdyn.smoothing import FEWEST, ORDERS, Choice, Curve, Rates, best_smoothing, derivative_noise, smoothed

SHARPEST = 1e-3
"""Of a joint's speed: the least noise that its velocity is taken to have."""
CERTAIN = 0.99
"""Expected sign of a velocity from which its sign is known."""
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
        stands: whether it stands still for most of the recording.
    """

    curve: Curve
    choice: Choice
    interval: float
    speed_noise: float
    stands: bool

    def direction(self, velocity: np.ndarray) -> np.ndarray:
        """(n,) expected sign of (n,) velocities; one that is not known is none where the joint stands most of the time.

        What a joint at rest is held by is no friction that a motion shows.
        """
        expected = expected_sign(velocity, self.speed_noise)
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
        ways = [j.direction(v[:, i]) for i, j in enumerate(self.joints)]
        return Motion(time, q, v, a, np.column_stack(ways))

    def direction(self, joint: int, time: np.ndarray) -> np.ndarray:
        """(n,) expected sign of one joint's velocity at (n,) times."""
        path = self.joints[joint]
        return path.direction(path.curve(np.clip(time, self.start, self.end), 1)[:, 0])


def expected_sign(velocity: np.ndarray, noise: float) -> np.ndarray:
    """Of (n,) velocities that are known with normal noise."""
    return np.asarray(erf(velocity / (np.sqrt(2.0) * noise)))


@lru_cache(maxsize=64)
def measured_motion(run: Run, joints: tuple[str, ...]) -> MeasuredMotion:
    """Smooth the recorded motion of `joints`.

    Measured velocities and accelerations are used where they agree with the positions.

    Raises:
        InputError: a joint's position was not recorded, or hardly.
    """
    curves = []
    start, end = -np.inf, np.inf
    for name in joints:
        if f"q.{name}" not in run.channels:
            raise InputError(
                f"{run.source or run.name}: holds no 'q.{name}', the position of a joint of the arm: record it, or "
                "choose the arm's joints without it"
            )
        q = run.channels[f"q.{name}"]
        if len(q) < FEWEST:
            raise InputError(
                f"{run.source or run.name}: 'q.{name}' has {len(q)} samples, at least {FEWEST} are needed: "
                "record longer"
            )
        start, end = max(start, float(q.time[0])), min(end, float(q.time[-1]))
        curves.append(_joint_curve(q, run.channels.get(f"v.{name}"), run.channels.get(f"a.{name}")))
    if not start < end:
        raise InputError(
            f"{run.source or run.name}: the joints' positions were recorded at different times: record again"
        )
    return MeasuredMotion(tuple(curves), start, end)


@lru_cache(maxsize=512)
def _joint_curve(q: Channel, v: Channel | None, a: Channel | None) -> JointCurve:
    """By channels, which a run keeps when others of its channels are cleaned."""
    interval = float((q.time[-1] - q.time[0]) / (len(q) - 1))
    choice = best_smoothing(q.time, q.value, ORDERS)
    rates = [Rates(c.time, c.value, k) for k, c in ((1, v), (2, a)) if c is not None and len(c) >= FEWEST]
    curve = smoothed(q.time, q.value, choice, rates)
    speed = float(np.sqrt(np.mean(curve(q.time, 1) ** 2)))
    creep = 0.1 * CREEP if q.unit == "m" else CREEP
    noise = max(derivative_noise(choice, interval, 1), SHARPEST * speed, creep)
    moving = np.abs(expected_sign(curve(q.time, 1)[:, 0], noise)) >= CERTAIN
    return JointCurve(curve, choice, interval, noise, bool(np.mean(moving) < 0.5))
