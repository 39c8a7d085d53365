"""Motions of an arm of which position, velocity and acceleration are known exactly at any time."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np

Derivatives = tuple[np.ndarray, np.ndarray, np.ndarray]


class Motion(Protocol):
    """What moves the joints."""

    def at(self, time: np.ndarray) -> Derivatives:
        """(n, nj) positions [rad], velocities [rad/s] and accelerations [rad/s^2] at (n,) times [s]."""
        ...


@dataclass(frozen=True)
class Room:
    """Where and how fast the joints may move; all (nj,)."""

    centre: np.ndarray  # rad
    swing: np.ndarray  # largest distance from the centre, rad
    speed: np.ndarray  # largest, rad/s
    acceleration: np.ndarray  # largest, rad/s^2, roughly


@dataclass(frozen=True)
class Fourier:
    """A Fourier series: q = centre + sum over h of sine_h sin(h w t) + cosine_h cos(h w t), w = 2 pi / period."""

    centre: np.ndarray  # (nj,) rad
    sine: np.ndarray  # (nj, h) rad
    cosine: np.ndarray  # (nj, h) rad
    period: float  # s

    def at(self, time: np.ndarray) -> Derivatives:
        """See `Motion.at`."""
        w = 2.0 * np.pi * np.arange(1, self.sine.shape[1] + 1) / self.period
        s, c = np.sin(np.outer(time, w)), np.cos(np.outer(time, w))
        q = self.centre + s @ self.sine.T + c @ self.cosine.T
        v = (c * w) @ self.sine.T - (s * w) @ self.cosine.T
        a = -(s * w**2) @ self.sine.T - (c * w**2) @ self.cosine.T
        return q, v, a


def random_fourier(
    rng: np.random.Generator, centre: np.ndarray, swing: np.ndarray, speed: np.ndarray, period: float, harmonics: int
) -> Fourier:
    """A Fourier series as large as `swing` [rad] and `speed` [rad/s] allow."""
    shape = (len(centre), harmonics)
    weight = 1.0 / np.arange(1, harmonics + 1) ** 0.5
    raw = Fourier(centre, rng.standard_normal(shape) * weight, rng.standard_normal(shape) * weight, period)
    q, v, _ = raw.at(np.linspace(0.0, period, 400))
    scale = np.minimum(swing / np.abs(q - centre).max(axis=0), speed / np.abs(v).max(axis=0))[:, None]
    return Fourier(centre, raw.sine * scale, raw.cosine * scale, period)


@dataclass(frozen=True)
class Moves:
    """From posture to posture with a rest at each; q = q_k + (q_k+1 - q_k) b(s), b' = 140 s^3 (1 - s)^3."""

    postures: np.ndarray  # (k + 1, nj) rad
    begin: np.ndarray  # (k,) when each move begins, s
    length: np.ndarray  # (k,) how long it takes, s

    def at(self, time: np.ndarray) -> Derivatives:
        """See `Motion.at`."""
        k = np.clip(np.searchsorted(self.begin, time, side="right") - 1, 0, len(self.begin) - 1)
        length = self.length[k][:, None]
        s = np.clip((time - self.begin[k])[:, None] / length, 0.0, 1.0)
        far = self.postures[k + 1] - self.postures[k]
        q = self.postures[k] + far * s**4 * (35.0 - 84.0 * s + 70.0 * s**2 - 20.0 * s**3)
        v = far / length * 140.0 * s**3 * (1.0 - s) ** 3
        a = far / length**2 * 420.0 * s**2 * (1.0 - s) ** 2 * (1.0 - 2.0 * s)
        return q, v, a


PEAK_SPEED, PEAK_ACCELERATION = 2.1875, 7.52  # of a move over unit distance in unit time


def random_moves(rng: np.random.Generator, room: Room, duration: float) -> Moves:
    """Moves to random postures, as fast as the slowest joint can or up to half as long again; rests up to 0.5 s."""
    postures, begin, length = [room.centre + room.swing * rng.uniform(-1.0, 1.0, len(room.centre))], [], []
    now = 0.0
    while now < duration:
        postures.append(room.centre + room.swing * rng.uniform(-1.0, 1.0, len(room.centre)))
        far = np.abs(postures[-1] - postures[-2])
        shortest = max(
            (PEAK_SPEED * far / room.speed).max(), np.sqrt(PEAK_ACCELERATION * far / room.acceleration).max(), 0.4
        )
        begin.append(now)
        length.append(shortest * rng.uniform(1.0, 1.5))
        now += length[-1] + rng.uniform(0.1, 0.5)
    return Moves(np.array(postures), np.array(begin), np.array(length))


@dataclass(frozen=True)
class Sweeps:
    """Every joint to and fro at a constant speed of its own; in turns the acceleration follows sin^2; all (nj,)."""

    centre: np.ndarray  # rad
    speed: np.ndarray  # between turns, rad/s
    half: np.ndarray  # from turn to turn, s
    turn: np.ndarray  # how long a turn takes, s
    phase: np.ndarray  # time that is gone at t = 0, s

    def at(self, time: np.ndarray) -> Derivatives:
        """See `Motion.at`."""
        gone = (time[:, None] + self.phase) / self.half
        way = np.where(np.floor(gone) % 2 == 0, 1.0, -1.0)
        x = (gone - np.floor(gone) - 0.5) * self.half  # s from the middle of the sweep
        straight = 0.5 * (self.half - self.turn)
        side, y = np.sign(x), np.maximum(np.abs(x) - straight, 0.0)  # s since the turn began, or until it ends
        angle = 2.0 * np.pi * y / self.turn
        round_the_turn = y - y**2 / self.turn + self.turn / (2.0 * np.pi**2) * (1.0 - np.cos(angle))
        q = self.centre + way * self.speed * (np.clip(x, -straight, straight) + side * round_the_turn)
        v = way * self.speed * (1.0 - 2.0 * y / self.turn + np.sin(angle) / np.pi)
        a = -way * side * self.speed * 2.0 / self.turn * (1.0 - np.cos(angle))
        return q, v, a


TURNING = 0.25 + 1.0 / np.pi**2  # way from where a turn begins to its farthest point, over speed and length of the turn


def random_sweeps(rng: np.random.Generator, room: Room) -> Sweeps:
    """Sweeps at 0.25 to 0.9 of the largest speed over 0.6 to 1 of the room."""
    count = len(room.centre)
    speed, reach = room.speed * rng.uniform(0.25, 0.9, count), room.swing * rng.uniform(0.6, 1.0, count)
    turn = np.maximum(rng.uniform(0.3, 0.6, count), 4.0 * speed / room.acceleration)
    # A joint that cannot turn within its room at this speed is slowed down.
    speed = np.minimum(speed, reach / (1.2 * TURNING * turn))
    half = 2.0 * (reach / speed - (TURNING - 0.5) * turn)
    return Sweeps(room.centre, speed, half, turn, half * rng.uniform(0.0, 2.0, count))


KINDS: Mapping[str, Callable[[np.random.Generator, Room, float], Motion]] = {
    "multisine": lambda rng, room, _: random_fourier(rng, room.centre, room.swing, room.speed, 6.0, 6),
    "moves": random_moves,
    "sweeps": lambda rng, room, _: random_sweeps(rng, room),
}
"""A random motion of each kind, from randomness, room and duration [s]."""
