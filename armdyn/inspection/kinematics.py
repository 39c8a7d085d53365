"""Compare recorded velocities with derivatives of recorded positions: units, signs, columns and clocks."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from armdyn.inspection import signals
from armdyn.inspection.check import Check, Kind, Severity, amount, listed
from armdyn.inspection.correction import CorrectedReading, Correction
from armdyn.object_cache import cached_with_first_argument
from armdyn.recording.channels import Channel
from armdyn.recording.noise import white_noise_std
from armdyn.run import Run

RATE_MOMENTS = 400
"""Number of moments at which rates are compared."""
SLOPE_SECONDS = 0.025
"""Half the time over which a slope is fitted and a rate averaged, s; at least three samples."""
MIN_RATE_CORRELATION = 0.9
"""Correlation from which a rate belongs to a position; filtered rates reach 0.95."""
MIN_SPEED_DEVIATES = 5.0
"""Least speed of a joint, in standard deviations of the slopes' noise, for which its rate is checked."""
CERTAIN_RATE_CORRELATION = 0.99
"""Correlation from which no other position or clock is tried."""
RATE_RATIO_RANGE = (0.75, 1.35)
"""Ratio of rate to slope that a filter or backlash may cause."""
RATE_CLOCK_SHIFTS = np.round(np.arange(-0.5, 0.501, 0.025), 3)
"""Clock shifts that are tried, s."""
MAX_RATE_DELAY = 0.06
"""Largest delay of a rate, s, that its own filter may cause."""
MIN_EXPLAINED_REST = 0.4
"""Share of the unexplained part of a rate that another position or clock must explain."""
MAX_UNRELATED_CORRELATION = 0.5
"""Correlation below which a rate does not belong to its position."""
RATE_FACTORS: tuple[tuple[float, Kind, str], ...] = (
    (180.0 / np.pi, "angle_unit", "are in degrees per second and called rad/s"),
    (30.0 / np.pi, "angle_unit", "are in turns per minute and called rad/s"),
    (0.5 / np.pi, "angle_unit", "are in turns per second and called rad/s"),
    (np.pi / 180.0, "angle_unit", "are in rad/s and called degrees per second, or the positions are in degrees"),
    (-1.0, "position_sign", "count the other way than the positions"),
)
"""Ratio of rate to slope, the kind of mistake, and the mistake in words."""
RATE_OF_POSITION = {"swing_angle": "swing_rate", "gripper_x": "gripper_v"}


Meaning = tuple[Kind, str, CorrectedReading]
"""A mistake: its kind, the mistake in words, and how the rate is to be read."""


@dataclass(frozen=True, eq=False)
class Pair:
    """A rate and the slope of the position that it should belong to, at common moments.

    Attributes:
        position: name of the position channel.
        rate: name of the rate channel.
        slope: (n,) slopes of the position.
        value: (n,) values of the rate.
    """

    position: str
    rate: str
    slope: np.ndarray
    value: np.ndarray

    @property
    def factor(self) -> float:
        """Ratio of rate to slope."""
        return float(self.slope @ self.value) / max(float(self.slope @ self.slope), 1e-300)

    @property
    def alike(self) -> float:
        """Absolute correlation of the two signals of the pair."""
        return abs(_correlation(self.slope, self.value))


def rate_checks(run: Run) -> Iterator[Check]:
    """Find mistakes in the rates of a recording."""
    found: dict[tuple[Kind, str], dict[Pair, CorrectedReading]] = {}
    pairs, moments = moving_pairs(run)
    for pair in pairs:
        meaning = _elsewhere(run, pair, pairs, moments) or _in_another_unit(pair)
        if meaning is not None:
            kind, said, reading = meaning
            found.setdefault((kind, said), {})[pair] = reading
            continue
        if pair.alike < MAX_UNRELATED_CORRELATION:
            said = f"{pair.rate} is not the derivative of {pair.position} (correlation {pair.alike:.2f})"
            remedy = f"leave {pair.rate} out, or find out what it is"
        elif pair.alike > MIN_RATE_CORRELATION and not _is_one(pair.factor):
            said = f"{pair.rate} is {amount(pair.factor)} times the derivative of {pair.position}: "
            said += "a gear ratio, or stamps of the wrong rate"
            remedy = f"divide {pair.rate} by {amount(pair.factor)}, or check the unit of 'time'"
        else:
            continue
        yield Check("rate", Severity.SUSPECT, run.name, (pair.rate, pair.position), said, remedy)
    for (kind, said), readings in found.items():
        names = [pair.rate for pair in readings]
        yield Check(
            kind, Severity.WRONG, run.name, tuple(names), f"{listed(names)} {said}",
            f"armdyn inspect {run.source or run.name} --fix fixed",
            evidence=min(_nats(pair, reading) for pair, reading in readings.items()),
            correction=Correction({pair.rate: reading for pair, reading in readings.items()}),
        )  # fmt: skip


def consistent(run: Run) -> Run:
    """The run without rates and accelerations that contradict its positions."""
    pairs, _ = moving_pairs(run)
    wrong = {p.rate for p in pairs if p.alike < MIN_RATE_CORRELATION or not _is_one(p.factor)}
    wrong |= {f"a.{name.removeprefix('v.')}" for name in wrong if name.startswith("v.")}
    return replace(run, channels={n: c for n, c in run.channels.items() if n not in wrong}) if wrong else run


@cached_with_first_argument
def moving_pairs(run: Run) -> tuple[list[Pair], np.ndarray]:
    """Every rate with the position to which it should belong, where that moves, and the (n,) moments."""
    named = [(f"q.{j}", f"v.{j}") for j in run.joints] + list(RATE_OF_POSITION.items())
    named = [(q, v) for q, v in named if q in run.channels and v in run.channels]
    channels = [run.channels[name] for pair in named for name in pair]
    begin = max((float(c.time[0]) for c in channels), default=0.0)
    end = min((float(c.time[-1]) for c in channels), default=0.0)
    moments = np.linspace(begin, end, RATE_MOMENTS)
    found = []
    for q, v in named if begin < end else ():
        slope, noise = slopes(run.channels[q], moments)
        if float(np.std(slope)) > MIN_SPEED_DEVIATES * noise and signals.moves(run.channels[q]):
            found.append(Pair(q, v, slope, averages(run.channels[v], moments)))
    return found, moments


def slopes(channel: Channel, moments: np.ndarray) -> tuple[np.ndarray, float]:
    """(n,) slopes of a channel around moments, from fitted lines, and the standard deviation of their noise."""
    near = max(SLOPE_SECONDS, 1.6 * float(np.median(np.diff(channel.time))))
    time, value = channel.time - channel.time[0], channel.value - channel.value.mean()
    sums = [np.concatenate([[0.0], np.cumsum(x)]) for x in (np.ones(len(time)), time, value, time**2, time * value)]
    first = np.searchsorted(channel.time, moments - near)
    last = np.searchsorted(channel.time, moments + near)
    one, t, x, tt, tx = (s[last] - s[first] for s in sums)
    spread = np.where(one > 2, one * tt - t**2, np.inf)
    noise = white_noise_std(channel.time, channel.value) * float(np.median(np.sqrt(one / spread)))
    return (one * tx - t * x) / spread, noise


def averages(channel: Channel, moments: np.ndarray, near: float = SLOPE_SECONDS) -> np.ndarray:
    """(n,) averages of a channel over `near` s to either side of moments."""
    near = max(near, 1.6 * float(np.median(np.diff(channel.time))))
    total = np.concatenate([[0.0], np.cumsum(channel.value)])
    first = np.clip(np.searchsorted(channel.time, moments - near), 0, len(channel.time) - 1)
    last = np.clip(np.searchsorted(channel.time, moments + near), first + 1, len(channel.time))
    return np.asarray((total[last] - total[first]) / (last - first))


def _correlation(a: np.ndarray, b: np.ndarray) -> float:
    size = float(np.sqrt((a @ a) * (b @ b)))
    return float(a @ b) / size if size > 0.0 else 0.0


def _is_one(ratio: float) -> bool:
    """Whether a ratio of rate to slope is one, but for a filter or backlash."""
    return RATE_RATIO_RANGE[0] < ratio < RATE_RATIO_RANGE[1]


def _nats(pair: Pair, reading: CorrectedReading) -> float:
    """Log ratio of a rate's probability under `reading` to that as it is; a tenth of the moments are independent."""
    size = float(np.mean(pair.value**2))
    stands = float(np.mean((pair.value - pair.slope) ** 2))
    alike = pair.alike if reading.source == pair.rate and not reading.late else MIN_RATE_CORRELATION
    left = size * max(1.0 - alike**2, 1e-3)
    return 0.05 * len(pair.value) * float(np.log(max(stands / max(left, 1e-300), 1.0)))


def _in_another_unit(pair: Pair) -> Meaning | None:
    """The unit or sign that a rate has; None for its own."""
    meant = (
        (kind, said, CorrectedReading(pair.rate, 1.0 / factor))
        for factor, kind, said in RATE_FACTORS
        if pair.alike > MIN_RATE_CORRELATION and _is_one(pair.factor / factor)
    )
    return next(meant, None)


def _elsewhere(run: Run, pair: Pair, pairs: list[Pair], moments: np.ndarray) -> Meaning | None:
    """Another position, or another clock, that a rate fits; None where there is none."""
    if pair.alike >= CERTAIN_RATE_CORRELATION:
        return None
    least = max(pair.alike + MIN_EXPLAINED_REST * (1.0 - pair.alike**2), MIN_RATE_CORRELATION)
    others = [p for p in pairs if p is not pair]
    owners = {p.rate: _correlation(pair.slope, p.value) for p in others}
    best = max(owners, key=lambda name: owners[name], default="")
    if best and owners[best] > least and max(abs(_correlation(p.slope, pair.value)) for p in others) > least:
        return "joints_swapped", "are exchanged: each is the rate of another joint", CorrectedReading(best)
    channel = run.channels[pair.rate]
    shifted = {
        s: _correlation(pair.slope, averages(Channel(channel.time - s, channel.value, channel.unit), moments))
        for s in RATE_CLOCK_SHIFTS.tolist()
    }
    late = max(shifted, key=lambda s: shifted[s])
    if shifted[late] > least and abs(late) >= MAX_RATE_DELAY:
        said = f"stamped {abs(late):g} s too {'late' if late > 0.0 else 'early'} against the positions"
        return "clock_shift", said, CorrectedReading(pair.rate, late=float(late))
    return None
