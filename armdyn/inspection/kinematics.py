"""Compare positions with joint ranges, and velocities with derivatives of positions: units, signs, columns, clocks."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

import urdf
from armdyn.inspection import signals
from armdyn.inspection.check import MODEL_PLACEHOLDER, Check, CheckKind, Severity, names_in_words, rounded
from armdyn.inspection.correction import CorrectedReading, Correction
from armdyn.object_cache import cached_with_first_argument
from armdyn.recording.channels import Channel
from armdyn.recording.noise import white_noise_std
from armdyn.run import Run

DEGREES_POSITION_TO_RANGE_RATIO = 2.0
"""Ratio of a joint position to the joint's range above which positions are probably in degrees."""
RANGE_SLACK = 0.05
"""Share of a range by which a recorded position may exceed it: a stop gives way, and an encoder's zero is wrong."""
RATE_COMPARISON_TIMES = 400
"""Number of moments at which recorded rates are compared with slopes of positions."""
SLOPE_FIT_HALF_WIDTH_SECONDS = 0.025
"""Half the time, s, over which the slope of a position is fitted and a rate is averaged; at least three samples."""
MIN_RATE_CORRELATION = 0.9
"""Least correlation of a recorded rate with the slope of its position; filtered rates reach 0.95."""
MIN_CHECKED_SPEED_NOISE_STDS = 5.0
"""Least speed of a joint, in standard deviations of the slopes' noise, for which its rate is checked."""
CERTAIN_RATE_CORRELATION = 0.99
"""Correlation of a rate with the slope of its position from which no other position or clock is tried."""
RATE_TO_SLOPE_RATIO_RANGE = (0.75, 1.35)
"""Smallest and largest ratio of a rate to the slope of its position that a filter or backlash may cause."""
RATE_CLOCK_SHIFTS_TRIED_SECONDS = np.round(np.arange(-0.5, 0.501, 0.025), 3)
"""Shifts of a rate's clock that are tried, s."""
MAX_RATE_FILTER_DELAY_SECONDS = 0.06
"""Largest delay of a rate, s, that its own filter may cause."""
COMMON_FACTOR_RATIO = 1.1
"""Ratio of the largest to the smallest factor of several rates up to which it is one factor, that of the clock."""
MIN_EXPLAINED_RATE_RESIDUAL_SHARE = 0.4
"""Least share of the unexplained part of a rate that another position or clock must explain."""
MAX_UNRELATED_CORRELATION = 0.5
"""Correlation up to which a rate is not the derivative of its position."""
RATE_MISTAKE_FACTORS: tuple[tuple[float, CheckKind, str], ...] = (
    (180.0 / np.pi, "angle_unit", "are in degrees per second and called rad/s"),
    (30.0 / np.pi, "angle_unit", "are in turns per minute and called rad/s"),
    (0.5 / np.pi, "angle_unit", "are in turns per second and called rad/s"),
    (np.pi / 180.0, "angle_unit", "are in rad/s and called degrees per second, or the positions are in degrees"),
    (-1.0, "position_sign", "count the other way than the positions"),
)
"""Mistakes of a rate: its ratio to the slope of the position, kind of the mistake, and the mistake in words."""
RATE_OF_POSITION = {"swing_angle": "swing_rate", "gripper_x": "gripper_v"}


RateMistake = tuple[CheckKind, str, CorrectedReading]
"""A mistake of a rate: its kind, the mistake in words, and the corrected reading."""


@dataclass(frozen=True, eq=False)
class RateAndSlope:
    """A recorded rate and the slope of the position whose derivative it should be, at the same moments.

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
        """Least-squares ratio of the rate to the slope of the position."""
        return float(self.slope @ self.value) / max(float(self.slope @ self.slope), 1e-300)

    @property
    def correlation(self) -> float:
        """Absolute correlation of the rate and the slope of the position."""
        return abs(_correlation(self.slope, self.value))


def joint_in_degrees(channels: Mapping[str, Channel], robot: urdf.Robot) -> tuple[str, float, float] | None:
    """The joint whose position exceeds its range most, where positions in rad are certainly in degrees.

    They exceed a range by far, and all are within their ranges as degrees.

    Returns:
        Name of the joint, its largest position and the largest of its range [rad]; None where positions are in rad.
    """
    reached = dict[str, tuple[float, float]]()
    for name, lower, upper in zip(robot.joint_names, robot.limits.lower, robot.limits.upper, strict=True):
        channel = channels.get(f"q.{name}")
        if channel is None or channel.unit != "rad" or not np.isfinite([lower, upper]).all():
            continue
        far, widest = float(np.max(np.abs(channel.value))), max(abs(lower), abs(upper))
        slack, turned = RANGE_SLACK * (upper - lower), np.radians(channel.value)
        if turned.min() < lower - slack or turned.max() > upper + slack:
            return None
        if far > DEGREES_POSITION_TO_RANGE_RATIO * widest:
            reached[name] = far, widest
    if not reached:
        return None
    name, (far, widest) = max(reached.items(), key=lambda item: item[1][0])
    return name, far, widest


def degree_checks(run: Run, robot: urdf.Robot) -> Iterator[Check]:
    """The finding that the positions of a recording, and the commands beside them, are in degrees and called rad."""
    found = joint_in_degrees(run.channels, robot)
    if found is None:
        return
    name, far, widest = found
    quantities = ("q", "v", "a", "q_cmd", "v_cmd")
    turning = {f"{kind}.{joint}" for kind in quantities for joint in robot.joint_names}
    names = [n for n, c in run.channels.items() if n in turning and c.unit.startswith("rad")]
    said = (
        f"q.{name} reaches {rounded(far)} rad, where its limit is {rounded(widest)} rad; in degrees all positions are"
    )
    yield Check(
        "angle_unit", Severity.WRONG, run.name, tuple(names),
        f"{said} within their limits: angles are in degrees and called rad",
        f"write the unit deg in the mapping or the header, or: armdyn inspect {MODEL_PLACEHOLDER} "
        f"{run.source or run.name} --fix fixed",
        correction=Correction({n: CorrectedReading(n, np.pi / 180.0) for n in names}),
    )  # fmt: skip


def rate_checks(run: Run) -> Iterator[Check]:
    """Findings on recorded rates: units, signs, exchanged columns, clocks."""
    found: dict[tuple[CheckKind, str], dict[RateAndSlope, CorrectedReading]] = {}
    pairs, moments = rates_and_slopes(run)
    factors = [pair.factor for pair in pairs if pair.correlation > MIN_RATE_CORRELATION]
    common = len(factors) > 1 and not _is_one(factors[0]) and max(factors) < COMMON_FACTOR_RATIO * min(factors)
    if common and not any(_in_another_unit(pair) for pair in pairs):
        yield _in_another_time(run, pairs, float(np.median(factors)))
        return
    for pair in pairs:
        meaning = _elsewhere(run, pair, pairs, moments) or _in_another_unit(pair)
        if meaning is not None:
            kind, said, reading = meaning
            found.setdefault((kind, said), {})[pair] = reading
            continue
        if pair.correlation < MAX_UNRELATED_CORRELATION:
            said = f"{pair.rate} is not the derivative of {pair.position} (correlation {pair.correlation:.2f})"
            remedy = f"leave {pair.rate} out, or find out what it is"
        elif pair.correlation > MIN_RATE_CORRELATION and not _is_one(pair.factor):
            said = f"{pair.rate} is {rounded(pair.factor)} times the derivative of {pair.position}: "
            said += "a gear ratio, or stamps of the wrong rate"
            remedy = f"divide {pair.rate} by {rounded(pair.factor)}, or check the unit of 'time'"
        else:
            continue
        yield Check("rate", Severity.SUSPECT, run.name, (pair.rate, pair.position), said, remedy)
    for (kind, said), readings in found.items():
        names = [pair.rate for pair in readings]
        yield Check(
            kind, Severity.WRONG, run.name, tuple(names), f"{names_in_words(names)} {said}",
            f"armdyn inspect {run.source or run.name} --fix fixed",
            evidence=min(_nats(pair, reading) for pair, reading in readings.items()),
            correction=Correction({pair.rate: reading for pair, reading in readings.items()}),
        )  # fmt: skip


def _in_another_time(run: Run, pairs: Sequence[RateAndSlope], factor: float) -> Check:
    """The finding that all rates are the derivatives of their positions, times one factor."""
    said = f"all rates are {rounded(factor)} times the derivatives of their positions: the time stamps are "
    apart = f"{rounded(factor)} times too far apart" if factor > 1.0 else f"{rounded(1.0 / factor)} times too close"
    return Check(
        "rate", Severity.SUSPECT, run.name, tuple(name for pair in pairs for name in (pair.rate, pair.position)),
        f"{said}{apart}, or the rates are in a unit of their own",
        f"divide 'time' by {rounded(factor)}, or the rates; check the unit of 'time' and the rate of the samples",
    )  # fmt: skip


def without_inconsistent_rates(run: Run) -> Run:
    """A copy of the run without rates and accelerations that contradict its positions."""
    pairs, _ = rates_and_slopes(run)
    wrong = {p.rate for p in pairs if p.correlation < MIN_RATE_CORRELATION or not _is_one(p.factor)}
    wrong |= {f"a.{name.removeprefix('v.')}" for name in wrong if name.startswith("v.")}
    return replace(run, channels={n: c for n, c in run.channels.items() if n not in wrong}) if wrong else run


@cached_with_first_argument
def rates_and_slopes(run: Run) -> tuple[list[RateAndSlope], np.ndarray]:
    """Recorded rates with the slopes of their positions, for joints that move, and the (n,) moments, s."""
    named = [(f"q.{j}", f"v.{j}") for j in run.joints] + list(RATE_OF_POSITION.items())
    named = [(q, v) for q, v in named if q in run.channels and v in run.channels]
    channels = [run.channels[name] for pair in named for name in pair]
    begin = max((float(c.time[0]) for c in channels), default=0.0)
    end = min((float(c.time[-1]) for c in channels), default=0.0)
    moments = np.linspace(begin, end, RATE_COMPARISON_TIMES)
    found = []
    for q, v in named if begin < end else ():
        slope, noise = local_slopes(run.channels[q], moments)
        if float(np.std(slope)) > MIN_CHECKED_SPEED_NOISE_STDS * noise and signals.changes_beyond_noise(
            run.channels[q]
        ):
            found.append(RateAndSlope(q, v, slope, local_averages(run.channels[v], moments)))
    return found, moments


def local_slopes(channel: Channel, moments: np.ndarray) -> tuple[np.ndarray, float]:
    """(n,) slopes of lines that are fitted to a channel around moments (n,), s, and their standard deviation."""
    near = max(SLOPE_FIT_HALF_WIDTH_SECONDS, 1.6 * float(np.median(np.diff(channel.time))))
    time, value = channel.time - channel.time[0], channel.value - channel.value.mean()
    sums = [np.concatenate([[0.0], np.cumsum(x)]) for x in (np.ones(len(time)), time, value, time**2, time * value)]
    first = np.searchsorted(channel.time, moments - near)
    last = np.searchsorted(channel.time, moments + near)
    one, t, x, tt, tx = (s[last] - s[first] for s in sums)
    spread = np.where(one > 2, one * tt - t**2, np.inf)
    noise = white_noise_std(channel.time, channel.value) * float(np.median(np.sqrt(one / spread)))
    return (one * tx - t * x) / spread, noise


def local_averages(channel: Channel, moments: np.ndarray, near: float = SLOPE_FIT_HALF_WIDTH_SECONDS) -> np.ndarray:
    """(n,) averages of a channel from `near` s before to `near` s after each of (n,) moments, s."""
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
    return RATE_TO_SLOPE_RATIO_RANGE[0] < ratio < RATE_TO_SLOPE_RATIO_RANGE[1]


def _nats(pair: RateAndSlope, reading: CorrectedReading) -> float:
    """Log ratio of a rate's probability under `reading` to that as it is; a tenth of the moments are independent."""
    size = float(np.mean(pair.value**2))
    stands = float(np.mean((pair.value - pair.slope) ** 2))
    alike = pair.correlation if reading.source == pair.rate and not reading.delay else MIN_RATE_CORRELATION
    left = size * max(1.0 - alike**2, 1e-3)
    return 0.05 * len(pair.value) * float(np.log(max(stands / max(left, 1e-300), 1.0)))


def _in_another_unit(pair: RateAndSlope) -> RateMistake | None:
    """The unit or sign that a rate has; None for its own."""
    meant = (
        (kind, said, CorrectedReading(pair.rate, 1.0 / factor))
        for factor, kind, said in RATE_MISTAKE_FACTORS
        if pair.correlation > MIN_RATE_CORRELATION and _is_one(pair.factor / factor)
    )
    return next(meant, None)


def _elsewhere(run: Run, pair: RateAndSlope, pairs: list[RateAndSlope], moments: np.ndarray) -> RateMistake | None:
    """Another position, or another clock, that a rate fits; None where there is none."""
    if pair.correlation >= CERTAIN_RATE_CORRELATION:
        return None
    least = max(
        pair.correlation + MIN_EXPLAINED_RATE_RESIDUAL_SHARE * (1.0 - pair.correlation**2), MIN_RATE_CORRELATION
    )
    others = [p for p in pairs if p is not pair]
    owners = {p.rate: _correlation(pair.slope, p.value) for p in others}
    best = max(owners, key=lambda name: owners[name], default="")
    if best and owners[best] > least and max(abs(_correlation(p.slope, pair.value)) for p in others) > least:
        return "joints_swapped", "are exchanged: each is the rate of another joint", CorrectedReading(best)
    channel = run.channels[pair.rate]
    shifted = {
        s: _correlation(pair.slope, local_averages(Channel(channel.time - s, channel.value, channel.unit), moments))
        for s in RATE_CLOCK_SHIFTS_TRIED_SECONDS.tolist()
    }
    late = max(shifted, key=lambda s: shifted[s])
    if shifted[late] > least and abs(late) >= MAX_RATE_FILTER_DELAY_SECONDS:
        said = f"stamped {abs(late):g} s too {'late' if late > 0.0 else 'early'} against the positions"
        return "clock_shift", said, CorrectedReading(pair.rate, delay=float(late))
    return None
