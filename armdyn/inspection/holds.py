"""Find stretches in which a channel is constant: a sensor that was stuck, or a joint that sticks at one position.

A lost connection occurs at some time; a joint held by friction stops at some position: in every pass it stops there
from full speed, until the drive has pulled enough. A joint that its drive stops slows down before.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from math import comb

import numpy as np
from scipy.ndimage import maximum_filter1d, minimum_filter1d

from armdyn.inspection.check import Check, Severity, amount
from armdyn.object_cache import cached_with_first_argument
from armdyn.recording.channels import Channel
from armdyn.recording.noise import DIFFERENCE_ORDERS, normalised_differences, quiet_std
from armdyn.run import Run
from armdyn.smoothing.choice import resolution

MIN_STUCK_SHARE = 0.02
"""Share of the samples, but at least `MIN_STUCK_SAMPLES`, with the same value while the rest of the signal changes."""
MIN_STUCK_SAMPLES = 12
MIN_STUCK_HOLDS = 8.0
"""Length of such a stretch, at least, in usual stretches of one value."""
JUMP_STEPS = 6.0
"""Size of the jump at the end of such a stretch, in usual steps of the signal: a signal that was really at rest starts
gently."""
MIN_JUMP_SHARE = 0.03
"""Smallest size of such a jump, as a share of the signal's range."""
QUIET_SHARE, QUIET_NORMAL = 0.3, 0.3853
"""Share of a signal's differences that contain only noise, and this quantile of |x| over the standard deviation, for
normally distributed x."""
MAX_STOP_DISTANCE_SHARE = 0.02
"""Largest distance of stops at one position, as a share of the joint's range."""
MAX_CHANCE_OF_STOPS = 0.01
"""Probability below which stops at one position cannot be lost connections, which occur anywhere."""
STOP_WIDTH_SHARE = 1e-3
"""Width of a position, as a share of that range."""
MIN_ARRIVAL_SPEED_SHARE = 0.75
"""Share of its earlier speed that a joint still has when it comes to a position that holds it; a drive slows down
before."""
MIN_MOVING_SPEED_SHARE = 0.5
"""Share of its usual speed from which on a joint moves on, rather than reverses."""
MIN_STOP_CROSSINGS = 8.0
"""Shortest stop, as a multiple of the time in which a joint usually crosses its own noise."""


@dataclass(frozen=True)
class Stand:
    """A stretch in which a joint stopped on its way.

    Attributes:
        start: time of its first sample, s.
        end: time of its last sample, s.
        place: position of the joint, rad or m.
    """

    start: float
    end: float
    place: float


def stuck(run: Run) -> Iterator[Check]:
    """Find channels that keep one value and then jump, or have no noise for a while."""
    sticks = [name for name, channel in _joints(run) if held_at(channel)]
    for name, channel in run.channels.items():
        found = None if name in sticks else longest_hold(channel)
        if found is None:
            continue
        (begin, end), value = channel.time[list(found)], channel.value[found[0]]
        if channel.unit.endswith("/s") and abs(value) <= resolution(channel.value):
            continue  # a joint at rest has a speed of 0
        yield Check(
            "frozen", Severity.SUSPECT, run.name, (name,),
            f"{name} holds {amount(value)} {channel.unit} from {begin:.4g} to {end:.4g} s, then jumps",
            f"empty the cells of {name} there, or look for a lost connection", float(begin), float(end),
        )  # fmt: skip


def longest_hold(channel: Channel) -> tuple[int, int] | None:
    """First and last sample of the longest stretch in which a sensor was stuck; None where there is none."""
    value = channel.value
    change = np.flatnonzero(np.diff(value) != 0.0)
    if len(change) < 2:
        return None
    edges = np.concatenate([[-1], change, [len(value) - 1]])
    lengths = np.diff(edges)
    steps = np.abs(np.diff(value)[change])
    step = max(JUMP_STEPS * float(np.median(steps)), MIN_JUMP_SHARE * float(np.ptp(value)))
    shortest = max(MIN_STUCK_SAMPLES, MIN_STUCK_SHARE * len(value), MIN_STUCK_HOLDS * float(np.median(lengths)))
    longest = [k for k in np.argsort(-lengths)[:3] if lengths[k] >= shortest]
    shown = 2.0 * resolution(value)
    noisy = bool(longest) and np.mean(lengths == 1) > 0.9 and least_noise(channel) > shown
    for k in longest:
        first, last = int(edges[k]) + 1, int(edges[k + 1])
        beside = [abs(value[last + 1] - value[last])] if last + 1 < len(value) else []
        around = np.abs(np.diff(value[max(first - MIN_STUCK_SAMPLES, 0) : last + 1 + MIN_STUCK_SAMPLES]))
        rests = np.median(around[around > 0.0]) <= shown  # an encoder at rest has no noise either
        if (noisy and not rests) or any(jump > step for jump in beside):
            return first, last
    return None


def sticking(run: Run) -> Iterator[Check]:
    """Find joints that are held at one position whenever they pass it."""
    for name, channel in _joints(run):
        for stands in held_at(channel):
            place, longest = float(np.mean([stand.place for stand in stands])), longest_stop(stands)
            yield Check(
                "sticking", Severity.SUSPECT, run.name, (name,),
                f"{name} stops at {amount(place)} {channel.unit} from full speed {len(stands)} times, for up "
                f"to {longest:.2g} s: it sticks there",
                "look for what holds it there, such as a bearing, a cable or a brake; 'armdyn discover' finds a "
                "friction that depends on the position",
                stands[0].start, stands[-1].end,
            )  # fmt: skip


@cached_with_first_argument
def held_at(channel: Channel) -> list[list[Stand]]:
    """Stops grouped by position, where so many are closer together than stops at random positions would be.

    The ends of the range are left out, because a joint reverses there.
    """
    low, high = float(channel.value.min()), float(channel.value.max())
    whole = high - low
    found = [s for s in stops(channel) if min(s.place - low, high - s.place) > MAX_STOP_DISTANCE_SHARE * whole]
    places: list[list[Stand]] = []
    for stand in sorted(found, key=lambda stand: stand.place):
        if places and stand.place - places[-1][0].place < MAX_STOP_DISTANCE_SHARE * whole:
            places[-1].append(stand)
        else:
            places.append([stand])
    surely = (stands for stands in places if _chance(stands, len(found), whole) < MAX_CHANCE_OF_STOPS)
    return [sorted(stands, key=lambda stand: stand.start) for stands in surely]


def _chance(stands: list[Stand], of: int, whole: float) -> float:
    """Expected number of groups as large and as narrow among so many stops at random positions in a range."""
    apart = max(stands[-1].place - stands[0].place, STOP_WIDTH_SHARE * whole)
    return float(comb(of, len(stands)) * len(stands) * (apart / whole) ** (len(stands) - 1))


def stops(channel: Channel) -> list[Stand]:
    """Stretches in which a joint stops, with its full speed just before or just after."""
    value = channel.value
    step = np.abs(np.diff(value))
    noise = resolution(value) + 3.0 * quiet_std(channel.time, value)
    usual = float(np.median(step[step > noise])) if np.any(step > noise) else float(np.median(step))
    if usual <= 0.0:
        return []
    length = 2 * (max(MIN_STUCK_SAMPLES, int(np.ceil(MIN_STOP_CROSSINGS * 2.0 * noise / usual))) // 2) + 1
    if len(value) < 4 * length:
        return []
    quiet = maximum_filter1d(value, length) - minimum_filter1d(value, length) <= 2.0 * noise
    stands = np.convolve(quiet, np.ones(length), mode="same") > 0.5  # all samples of such a stretch
    edges = np.flatnonzero(np.diff(np.concatenate([[0], stands.astype(int), [0]])))
    near, far = 1 + max(2, int(np.ceil(2.0 * noise / usual))), length

    def abrupt(at: int, way: int) -> bool:
        """Whether the speed near a stretch is that farther away, but for a part of a step."""
        places = at + way * np.array([1, near, near + far])
        if places.min() < 0 or places.max() >= len(value):
            return False
        beside, before = np.diff(value[places]) / (near - 1, far)
        return bool(abs(before) > MIN_MOVING_SPEED_SHARE * usual and beside / before > MIN_ARRIVAL_SPEED_SHARE)

    return [
        Stand(float(channel.time[first]), float(channel.time[end - 1]), float(np.median(value[first:end])))
        for first, end in zip(edges[::2], edges[1::2], strict=True)
        if abrupt(first, -1) or abrupt(end - 1, 1)
    ]


def held(run: Run) -> list[tuple[float, float]]:
    """Time spans, s, around all passes of positions where a joint sticks: they contain no smooth motion.

    Each span is twice as long as the longest stop; in the second half the joint catches up.
    """
    found = []
    for _, channel in _joints(run):
        for stands in held_at(channel):
            crossed = np.diff(channel.value > stands[0].place)
            passes = [*(stand.start for stand in stands), *channel.time[1:][crossed].tolist()]
            found += [(t, t + 2.0 * longest_stop(stands)) for t in passes]
    return found


def longest_stop(stands: Iterable[Stand]) -> float:
    """Duration of the longest of some stops, s."""
    return max(stand.end - stand.start for stand in stands)


def _joints(run: Run) -> Iterator[tuple[str, Channel]]:
    """Position channels except the gripper's, which stops wherever its user wants."""
    return ((name, channel) for name, channel in encoders(run) if name != "gripper_x")


def encoders(run: Run) -> Iterator[tuple[str, Channel]]:
    """Channels of encoders."""
    return ((n, c) for n, c in run.channels.items() if n.startswith("q.") or n in ("swing_angle", "gripper_x"))


def least_noise(channel: Channel) -> float:
    """Standard deviation of white noise where a signal is quietest, from the difference order with the least result."""
    found = []
    for order in DIFFERENCE_ORDERS:
        if len(channel) > 4 * order:
            size = np.abs(normalised_differences(channel.time, channel.value, order))
            size = size[np.isfinite(size)]
            found.append(float(np.quantile(size, QUIET_SHARE) / QUIET_NORMAL) if len(size) else 0.0)
    return min(found, default=0.0)
