"""Recorded velocities against the derivatives of recorded positions: units, signs, columns and clocks of rates."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from armdyn.identify.noise import white_noise_std
from armdyn.inspection import signals
from armdyn.inspection.check import Check, Kind, Severity, amount, listed
from armdyn.inspection.correction import Correction, Reading
from armdyn.kept import cached_with_first_argument
from armdyn.recording.channels import Channel
from armdyn.run import Run

MOMENTS = 400
"""At which rates are compared."""
NEAR = 0.025
"""s to either side of a moment over which a slope is taken, and a rate averaged; at least three samples."""
ALIKE = 0.9
"""Correlation from which a rate is that of a position; measured rates that are filtered reach 0.95."""
CLEAR = 5.0
"""Times the noise of slopes that a joint's speed has at least before its rate is asked about."""
CERTAIN = 0.99
"""Correlation from which nobody asks whether another position, or another clock, would do better."""
OFF = (0.75, 1.35)
"""Rate over slope that a filter or a gear's play makes."""
SHIFTS = np.round(np.arange(-0.5, 0.501, 0.025), 3)
"""s by which clocks are tried."""
LATE = 0.06
"""s; what a rate is late by less is its filter."""
CLEARLY = 0.4
"""Share of what a rate does not follow that another position, or another clock, must explain."""
NOTHING_ALIKE = 0.5
"""Correlation below which a rate is not that of its position."""
FACTORS: tuple[tuple[float, Kind, str], ...] = (
    (180.0 / np.pi, "angle_unit", "are in degrees per second and called rad/s"),
    (30.0 / np.pi, "angle_unit", "are in turns per minute and called rad/s"),
    (0.5 / np.pi, "angle_unit", "are in turns per second and called rad/s"),
    (np.pi / 180.0, "angle_unit", "are in rad/s and called degrees per second, or the positions are in degrees"),
    (-1.0, "position_sign", "count the other way than the positions"),
)
"""Rate over slope, the kind of mistake, and what it means."""
PAIRS = {"swing_angle": "swing_rate", "gripper_x": "gripper_v"}


@dataclass(frozen=True, eq=False)
class Pair:
    """A rate and what it should be the rate of, at common moments.

    Attributes:
        position: name of the channel.
        rate: name of the channel.
        slope: (n,) of the position.
        value: (n,) of the rate.
        moves: whether the position changes by more than its noise.
    """

    position: str
    rate: str
    slope: np.ndarray
    value: np.ndarray
    moves: bool

    @property
    def factor(self) -> float:
        """Rate over slope."""
        return float(self.slope @ self.value) / max(float(self.slope @ self.slope), 1e-300)

    @property
    def alike(self) -> float:
        """Correlation, without its sign."""
        return abs(_alike(self.slope, self.value))


def rate_checks(run: Run) -> Iterator[Check]:
    """What is wrong with the rates of a recording."""
    pairs, moments = paired(run)
    told: dict[tuple[Kind, str], list[tuple[Pair, Reading]]] = {}
    for pair in pairs:
        if not pair.moves:
            continue
        if pair.alike < CERTAIN:
            other = _elsewhere(run, pair, pairs, moments)
            if other is not None:
                kind, said, reading = other
                told.setdefault((kind, said), []).append((pair, reading))
                continue
        meant = next((meaning for meaning in FACTORS if OFF[0] < pair.factor / meaning[0] < OFF[1]), None)
        if pair.alike < NOTHING_ALIKE:
            yield Check(
                "rate", Severity.SUSPECT, run.name, (pair.rate, pair.position),
                f"{pair.rate} is not the derivative of {pair.position} (correlation {pair.alike:.2f})",
                f"leave {pair.rate} out, or find out what it is",
            )  # fmt: skip
        elif meant is not None and pair.alike > ALIKE:
            factor, kind, said = meant
            told.setdefault((kind, said), []).append((pair, Reading(pair.rate, 1.0 / factor)))
        elif pair.alike > ALIKE and not OFF[0] < pair.factor < OFF[1]:
            yield Check(
                "rate", Severity.SUSPECT, run.name, (pair.rate, pair.position),
                f"{pair.rate} is {amount(pair.factor)} times the derivative of {pair.position}: "
                "a gear ratio, or stamps of the wrong rate",
                f"divide {pair.rate} by {amount(pair.factor)}, or check the unit of 'time'",
            )  # fmt: skip
    for (kind, said), found in told.items():
        names = [pair.rate for pair, _ in found]
        yield Check(
            kind, Severity.WRONG, run.name, tuple(names), f"{listed(names)} {said}",
            f"armdyn inspect {run.source or run.name} --fix fixed",
            evidence=min(_nats(pair, reading) for pair, reading in found),
            correction=Correction({pair.rate: reading for pair, reading in found}),
        )  # fmt: skip


def consistent(run: Run) -> Run:
    """The run without rates, and accelerations, that are not those of its positions."""
    pairs, _ = paired(run)
    wrong = {p.rate for p in pairs if p.moves and not (p.alike >= ALIKE and OFF[0] < p.factor < OFF[1])}
    wrong |= {f"a.{name.removeprefix('v.')}" for name in wrong if name.startswith("v.")}
    return replace(run, channels={n: c for n, c in run.channels.items() if n not in wrong}) if wrong else run


@cached_with_first_argument
def paired(run: Run) -> tuple[list[Pair], np.ndarray]:
    """Every rate with the position that it should be the rate of, and the (n,) moments."""
    named = [(f"q.{j}", f"v.{j}") for j in run.joints] + list(PAIRS.items())
    named = [(q, v) for q, v in named if q in run.channels and v in run.channels]
    if not named:
        return [], np.zeros(0)
    channels = [run.channels[name] for pair in named for name in pair]
    begin, end = max(c.time[0] for c in channels), min(c.time[-1] for c in channels)
    if not begin < end:
        return [], np.zeros(0)
    moments = np.linspace(begin, end, MOMENTS)
    found = []
    for q, v in named:
        slope, noise = slopes(run.channels[q], moments)
        moves = float(np.std(slope)) > CLEAR * noise and signals.moves(run.channels[q])
        found.append(Pair(q, v, slope, averages(run.channels[v], moments), moves))
    return found, moments


def slopes(channel: Channel, moments: np.ndarray) -> tuple[np.ndarray, float]:
    """(n,) slopes of a channel around moments, by straight lines; and the standard deviation of their noise."""
    near = max(NEAR, 1.6 * float(np.median(np.diff(channel.time))))
    time, value = channel.time - channel.time[0], channel.value - channel.value.mean()
    sums = [np.concatenate([[0.0], np.cumsum(x)]) for x in (np.ones(len(time)), time, value, time**2, time * value)]
    first = np.searchsorted(channel.time, moments - near)
    last = np.searchsorted(channel.time, moments + near)
    one, t, x, tt, tx = (s[last] - s[first] for s in sums)
    spread = np.where(one > 2, one * tt - t**2, np.inf)
    noise = white_noise_std(channel.time, channel.value) * float(np.median(np.sqrt(one / spread)))
    return (one * tx - t * x) / spread, noise


def averages(channel: Channel, moments: np.ndarray, near: float = NEAR) -> np.ndarray:
    """(n,) averages of a channel so many s to either side of moments."""
    near = max(near, 1.6 * float(np.median(np.diff(channel.time))))
    total = np.concatenate([[0.0], np.cumsum(channel.value)])
    first = np.clip(np.searchsorted(channel.time, moments - near), 0, len(channel.time) - 1)
    last = np.clip(np.searchsorted(channel.time, moments + near), first + 1, len(channel.time))
    return np.asarray((total[last] - total[first]) / (last - first))


def _alike(a: np.ndarray, b: np.ndarray) -> float:
    size = float(np.sqrt((a @ a) * (b @ b)))
    return float(a @ b) / size if size > 0.0 else 0.0


def _nats(pair: Pair, reading: Reading) -> float:
    """Logarithm of how much more probable a rate is so than as it stands; a tenth of the moments are independent."""
    size = float(np.mean(pair.value**2))
    stands = float(np.mean((pair.value - pair.slope) ** 2))
    alike = pair.alike if reading.source == pair.rate and not reading.late else ALIKE
    left = size * max(1.0 - alike**2, 1e-3)
    return 0.05 * len(pair.value) * float(np.log(max(stands / max(left, 1e-300), 1.0)))


def _elsewhere(run: Run, pair: Pair, pairs: list[Pair], moments: np.ndarray) -> tuple[Kind, str, Reading] | None:
    """A rate that is that of another position, or of its own at another time; None where it is neither."""
    least = max(pair.alike + CLEARLY * (1.0 - pair.alike**2), ALIKE)
    owners = {p.rate: _alike(pair.slope, p.value) for p in pairs if p is not pair and p.moves}
    best = max(owners, key=lambda name: owners[name], default="")
    others = max((abs(_alike(p.slope, pair.value)) for p in pairs if p is not pair and p.moves), default=0.0)
    if best and owners[best] > least and others > least:
        return "joints_swapped", "are exchanged: each is the rate of another joint", Reading(best)
    channel = run.channels[pair.rate]
    shifted = {
        s: _alike(pair.slope, averages(Channel(channel.time - s, channel.value, channel.unit), moments))
        for s in SHIFTS.tolist()
    }
    late = max(shifted, key=lambda s: shifted[s])
    if shifted[late] > least and abs(late) >= LATE:
        word = "late" if late > 0.0 else "early"
        said = f"stamped {abs(late):g} s too {word} against the positions"
        return "clock_shift", said, Reading(pair.rate, late=float(late))
    return None
