"""Stretches in which a channel stands: a sensor that was stuck for a while, and a joint that sticks at one place.

A connection is lost at some time, and a joint that is held by friction stands at some place: in every pass it stops
from full speed, until the drive has pulled enough. Where a drive stops by itself it slows down before.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from math import comb

import numpy as np
from scipy.ndimage import maximum_filter1d, minimum_filter1d

from armdyn.inspection.check import Check, Severity, amount
from armdyn.kept import cached_with_first_argument
from armdyn.recording.channels import Channel
from armdyn.recording.differences import normalised_differences, quiet_std
from armdyn.run import Run
from armdyn.smoothing.choice import resolution

STUCK = 0.02
"""Of the samples, at least `FEWEST_STUCK`, with one and the same value while the rest of the signal changes."""
FEWEST_STUCK = 12
JUMP = 6.0
"""Times the usual step that a signal makes when it comes loose: one that really stood still starts gently."""
JUMP_SHARE = 0.03
"""Of the signal's range, that such a jump is at least."""
NOISE_ORDERS = (3, 4, 5, 6, 7, 8)
QUIET_THIRD = 0.3853
"""Quantile 0.3 of |x| over the standard deviation, for normal x."""
ONE_PLACE = 0.02
"""Of the range that a joint moves through: how far apart stops at one place are at most."""
BY_CHANCE = 0.01
"""Probability below which stops at one place are no lost connections, which are anywhere."""
WIDE = 1e-3
"""Of that range: how wide a place is."""
AT_SPEED = 0.75
"""Of the speed that a joint had before, with which it still comes to a place that holds it; a drive slows down."""
MOVING = 0.5
"""Of its usual speed, with which a joint moves on, rather than turns round."""
CROSSING = 8.0
"""Times as long as a joint usually takes to cross its own noise, it stands at least."""


@dataclass(frozen=True)
class Stand:
    """A stretch in which a joint stood on its way.

    Attributes:
        first: its first sample.
        last: its last one.
        place: where, rad or m.
    """

    first: int
    last: int
    place: float


def stuck(run: Run) -> Iterator[Check]:
    """A channel keeps one value and then jumps, or shows no noise for a while."""
    sticks = [name for name, channel in _joints(run) if held_at(channel)]
    for name, channel in run.channels.items():
        found = None if name in sticks else longest_hold(channel)
        if (
            found is not None
            and channel.unit.endswith("/s")
            and abs(channel.value[found[0]]) <= resolution(channel.value)
        ):
            continue  # what stands has a speed of 0
        if found is not None:
            begin, end = channel.time[found[0]], channel.time[found[1]]
            yield Check(
                "frozen", Severity.SUSPECT, run.name, (name,),
                f"{name} holds {amount(channel.value[found[0]])} {channel.unit} from {begin:.4g} to {end:.4g} s, then "
                "jumps",
                f"empty the cells of {name} there, or look for a lost connection", float(begin), float(end),
            )  # fmt: skip


def longest_hold(channel: Channel) -> tuple[int, int] | None:
    """First and last sample of the longest stretch in which a sensor was stuck; None where it never was."""
    value = channel.value
    change = np.flatnonzero(np.diff(value) != 0.0)
    if len(change) < 2:
        return None
    edges = np.concatenate([[-1], change, [len(value) - 1]])
    lengths = np.diff(edges)
    usual = float(np.median(lengths))
    steps = np.abs(np.diff(value)[change])
    step = max(JUMP * float(np.median(steps)), JUMP_SHARE * float(np.ptp(value)))
    longest = [k for k in np.argsort(-lengths)[:3] if lengths[k] >= max(FEWEST_STUCK, STUCK * len(value), 8.0 * usual)]
    shown = 2.0 * resolution(value)
    noisy = bool(longest) and np.mean(lengths == 1) > 0.9 and least_noise(channel) > shown
    for k in longest:
        first, last = int(edges[k]) + 1, int(edges[k + 1])
        beside = [abs(value[last + 1] - value[last])] if last + 1 < len(value) else []
        around = np.abs(np.diff(value[max(first - FEWEST_STUCK, 0) : last + 1 + FEWEST_STUCK]))
        rests = np.median(around[around > 0.0]) <= shown  # an encoder of what rests shows no noise either
        if (noisy and not rests) or any(jump > step for jump in beside):
            return first, last
    return None


def sticking(run: Run) -> Iterator[Check]:
    """A joint is held at one place whenever it passes there."""
    for name, channel in _joints(run):
        for stands in held_at(channel):
            begin, end = channel.time[stands[0].first], channel.time[stands[-1].last]
            place = float(np.mean([stand.place for stand in stands]))
            longest = max(float(channel.time[s.last] - channel.time[s.first]) for s in stands)
            yield Check(
                "sticking", Severity.SUSPECT, run.name, (name,),
                f"{name} stops at {amount(place)} {channel.unit} from full speed {len(stands)} times, for up "
                f"to {longest:.2g} s: it sticks there",
                "look for what holds it there, such as a bearing, a cable or a brake; 'armdyn discover' finds a "
                "friction that depends on the position",
                float(begin), float(end),
            )  # fmt: skip


@cached_with_first_argument
def held_at(channel: Channel) -> list[list[Stand]]:
    """Stops by their place, where so many are so near to each other as those at random places are not.

    At the ends of its range a joint turns round.
    """
    low, high = float(channel.value.min()), float(channel.value.max())
    whole = high - low
    found = [s for s in stops(channel) if min(s.place - low, high - s.place) > ONE_PLACE * whole]
    places: list[list[Stand]] = []
    for stand in sorted(found, key=lambda stand: stand.place):
        if places and stand.place - places[-1][0].place < ONE_PLACE * whole:
            places[-1].append(stand)
        else:
            places.append([stand])
    surely = (stands for stands in places if _chance(stands, len(found), whole) < BY_CHANCE)
    return [sorted(stands, key=lambda stand: stand.first) for stands in surely]


def _chance(stands: list[Stand], of: int, whole: float) -> float:
    """Number of groups as large and as near that so many stops at random places in a range have on average."""
    apart = max(stands[-1].place - stands[0].place, WIDE * whole)
    return float(comb(of, len(stands)) * len(stands) * (apart / whole) ** (len(stands) - 1))


def stops(channel: Channel) -> list[Stand]:
    """Stretches in which a joint stands, to which it came at speed, or from which it goes at once at speed."""
    value = channel.value
    step = np.abs(np.diff(value))
    noise = resolution(value) + 3.0 * quiet_std(channel.time, value)
    usual = float(np.median(step[step > noise])) if np.any(step > noise) else float(np.median(step))
    if usual <= 0.0:
        return []
    length = 2 * (max(FEWEST_STUCK, int(np.ceil(CROSSING * 2.0 * noise / usual))) // 2) + 1
    if len(value) < 4 * length:
        return []
    quiet = maximum_filter1d(value, length) - minimum_filter1d(value, length) <= 2.0 * noise
    stands = np.convolve(quiet, np.ones(length), mode="same") > 0.5  # every sample of such a stretch
    edges = np.flatnonzero(np.diff(np.concatenate([[0], stands.astype(int), [0]])))
    near, far = 1 + max(2, int(np.ceil(2.0 * noise / usual))), length

    def abrupt(at: int, way: int) -> bool:
        """Whether it has the same speed near a stretch, but for a part of a step, as farther from it."""
        places = at + way * np.array([1, near, near + far])
        if places.min() < 0 or places.max() >= len(value):
            return False
        beside, before = np.diff(value[places]) / (near - 1, far)
        return bool(abs(before) > MOVING * usual and beside / before > AT_SPEED)

    return [
        Stand(int(first), int(end) - 1, float(np.median(value[first:end])))
        for first, end in zip(edges[::2], edges[1::2], strict=True)
        if abrupt(first, -1) or abrupt(end - 1, 1)
    ]


def held(run: Run) -> list[tuple[float, float]]:
    """Spans, s, of all passes of places where a joint sticks: no smooth motion goes through them.

    Each is twice as long as the joint stands there at most, of which it catches up in the second half.
    """
    found = []
    for _, channel in _joints(run):
        for stands in held_at(channel):
            time, beyond = channel.time, channel.value > stands[0].place
            longest = max(float(time[s.last] - time[s.first]) for s in stands)
            passes = [time[s.first] for s in stands] + list(time[1:][np.diff(beyond)])
            found += [(float(t), float(t) + 2.0 * longest) for t in passes]
    return found


def _joints(run: Run) -> Iterator[tuple[str, Channel]]:
    """Positions but the gripper's, which stops as whoever moves it pleases."""
    return ((name, channel) for name, channel in encoders(run) if name != "gripper_x")


def encoders(run: Run) -> Iterator[tuple[str, Channel]]:
    """Channels that count."""
    return ((n, c) for n, c in run.channels.items() if n.startswith("q.") or n in ("swing_angle", "gripper_x"))


def least_noise(channel: Channel) -> float:
    """Standard deviation of white noise that is seen where a signal is quietest, by the order that shows least."""
    found = []
    for order in NOISE_ORDERS:
        if len(channel) > 4 * order:
            size = np.abs(normalised_differences(channel.time, channel.value, order))
            size = size[np.isfinite(size)]
            found.append(float(np.quantile(size, 0.3)) / QUIET_THIRD if len(size) else 0.0)
    return min(found, default=0.0)
