"""Find parts of a recording in which a channel is constant: a stuck sensor, or a joint that sticks at one position.

A lost connection occurs at some time; a joint held by friction stops at some position: in every pass it stops there
from full speed, until the drive has pulled enough, and goes on. A joint that its drive stops slows down before, and
every joint stands where it turns round, or where its command stands.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from math import comb

import numpy as np
from scipy.ndimage import maximum_filter1d, minimum_filter1d

from armdyn.inspection.check import Check, Severity, rounded
from armdyn.object_cache import cached_with_first_argument
from armdyn.recording.channels import Channel, channel_kind
from armdyn.recording.noise import DIFFERENCE_ORDERS, noise_std_from_differences, normalised_differences
from armdyn.run import Run
from armdyn.smoothing.choice import resolution

MIN_STUCK_REPEATED_SAMPLE_SHARE = 0.02
"""Least share of successive samples with the same value from which a sensor may be stuck; also `MIN_STUCK_SAMPLES`."""
MIN_STUCK_SAMPLES = 12
MIN_STUCK_LENGTH_IN_MEDIAN_HOLDS = 8.0
"""Least length of a stretch with one value of a stuck sensor, in median lengths of such stretches."""
MIN_STUCK_END_JUMP_USUAL_STEPS = 6.0
"""Least jump at the end of a stuck sensor's stretch, in usual steps of the signal: a motion from rest starts gently."""
MIN_STUCK_END_JUMP_RANGE_SHARE = 0.03
"""Least jump at the end of a stuck sensor's stretch, as a share of the signal's range."""
NOISE_ONLY_DIFFERENCE_SHARE, NOISE_ONLY_ABS_NORMAL_QUANTILE = 0.3, 0.3853
"""Share of a signal's differences, the smallest ones, that contain only noise; and the quantile of |x| at this share,
in standard deviations of a normally distributed x."""
MAX_SAME_STOP_DISTANCE_RANGE_SHARE = 0.02
"""Largest distance of stops that count as stops at one position, as a share of the joint's range."""
MAX_SAME_STOP_PROBABILITY = 0.01
"""Probability below which stops at one position cannot be lost connections, which occur anywhere."""
MIN_STOP_SPACING_RANGE_SHARE = 1e-3
"""Least distance of stops in the estimate of their probability, as a share of the joint's range."""
MIN_SPEED_SHARE_BEFORE_STICKING = 0.75
"""Least speed of a joint just before it sticks, as a share of its earlier speed: a joint that its drive stops slows
down before."""
MIN_SPEED_SHARE_BESIDE_STICKING = 0.5
"""Least speed of a joint before or after it sticks, as a share of its usual speed; a reversing joint is slower."""
MIN_STOP_IN_NOISE_CROSSING_TIMES = 8.0
"""Shortest stop, as a multiple of the time in which a joint usually crosses its own noise."""


@dataclass(frozen=True)
class Stop:
    """A stop of a joint during a motion.

    Attributes:
        start: time of the first sample at rest, s.
        end: time of the last sample at rest, s.
        position: position of the joint, rad or m.
        passed: whether the joint goes on in the direction from which it came.
    """

    start: float
    end: float
    position: float
    passed: bool


def stuck_sensor_checks(run: Run) -> Iterator[Check]:
    """Findings on stuck sensors: channels that keep one value and then jump, or have no noise for some time."""
    sticks = [name for name, _ in _joints(run) if repeated_stops(run, name)]
    for name, channel in run.channels.items():
        command = channel_kind(name).held
        found = None if name in sticks or command else longest_constant_stretch(channel)
        if found is None:
            continue
        (begin, end), value = channel.time[list(found)], channel.value[found[0]]
        if channel.unit.endswith("/s") and abs(value) <= resolution(channel.value):
            continue  # a joint at rest has a speed of 0
        yield Check(
            "frozen", Severity.SUSPECT, run.name, (name,),
            f"{name} holds {rounded(value)} {channel.unit} from {begin:.4g} to {end:.4g} s, then jumps",
            f"empty the cells of {name} there, or look for a lost connection", float(begin), float(end),
        )  # fmt: skip


def longest_constant_stretch(channel: Channel) -> tuple[int, int] | None:
    """First and last sample of the longest stretch in which a sensor was stuck; None if it was not stuck."""
    value = channel.value
    change = np.flatnonzero(np.diff(value) != 0.0)
    if len(change) < 2:
        return None
    edges = np.concatenate([[-1], change, [len(value) - 1]])
    lengths = np.diff(edges)
    steps = np.abs(np.diff(value)[change])
    step = max(
        MIN_STUCK_END_JUMP_USUAL_STEPS * float(np.median(steps)), MIN_STUCK_END_JUMP_RANGE_SHARE * float(np.ptp(value))
    )
    shortest = max(
        MIN_STUCK_SAMPLES,
        MIN_STUCK_REPEATED_SAMPLE_SHARE * len(value),
        MIN_STUCK_LENGTH_IN_MEDIAN_HOLDS * float(np.median(lengths)),
    )
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


def sticking_joint_checks(run: Run) -> Iterator[Check]:
    """Findings on joints that stick at one position whenever they pass it."""
    for name, channel in _joints(run):
        for stands in repeated_stops(run, name):
            place, longest = float(np.mean([stand.position for stand in stands])), longest_stop(stands)
            yield Check(
                "sticking", Severity.SUSPECT, run.name, (name,),
                f"{name} stops at {rounded(place)} {channel.unit} from full speed {len(stands)} times, for up "
                f"to {longest:.2g} s: it sticks there",
                "look for what holds it there, such as a bearing, a cable or a brake; 'armdyn discover' finds a "
                "friction that depends on the position",
                stands[0].start, stands[-1].end,
            )  # fmt: skip


@cached_with_first_argument
def repeated_stops(run: Run, name: str) -> list[list[Stop]]:
    """Stops of a joint that repeat at one position, grouped by position.

    A group has more stops, closer together, than stops at random positions would have. Left out are the ends of the
    range, and stops that something else explains: the joint turns round, or its command stands too.

    Args:
        run: the recording.
        name: channel of the joint's position.
    """
    channel, command = run.channels[name], run.all_channels.get(f"q_cmd.{name.removeprefix('q.')}")
    low, high = float(channel.value.min()), float(channel.value.max())
    whole = high - low
    found = [
        s
        for s in abrupt_stops(channel)
        if s.passed
        and (command is None or _moves(command, s))
        and min(s.position - low, high - s.position) > MAX_SAME_STOP_DISTANCE_RANGE_SHARE * whole
    ]
    places: list[list[Stop]] = []
    for stand in sorted(found, key=lambda stand: stand.position):
        if places and stand.position - places[-1][0].position < MAX_SAME_STOP_DISTANCE_RANGE_SHARE * whole:
            places[-1].append(stand)
        else:
            places.append([stand])
    surely = (stands for stands in places if _chance(stands, len(found), whole) < MAX_SAME_STOP_PROBABILITY)
    return [sorted(stands, key=lambda stand: stand.start) for stands in surely]


def _moves(command: Channel, stop: Stop) -> bool:
    """Whether a command, which holds until its next sample, changes in the middle half of a stop.

    Its ends are left out, because a drive follows its command late.
    """
    span = stop.start + (stop.end - stop.start) * np.array([0.25, 0.75])
    first, last = np.searchsorted(command.time, span, side="right") - 1
    return bool(np.ptp(command.value[max(first, 0) : last + 1]) > resolution(command.value))


def _chance(stands: list[Stop], of: int, whole: float) -> float:
    """Expected number of groups as large and as narrow among so many stops at random positions in a range."""
    apart = max(stands[-1].position - stands[0].position, MIN_STOP_SPACING_RANGE_SHARE * whole)
    return float(comb(of, len(stands)) * len(stands) * (apart / whole) ** (len(stands) - 1))


def abrupt_stops(channel: Channel) -> list[Stop]:
    """Stops of a joint that moves at full speed just before or just after."""
    value = channel.value
    step = np.abs(np.diff(value))
    noise = resolution(value) + 3.0 * noise_std_from_differences(channel.time, value)
    usual = float(np.median(step[step > noise])) if np.any(step > noise) else float(np.median(step))
    if usual <= 0.0:
        return []
    length = 2 * (max(MIN_STUCK_SAMPLES, int(np.ceil(MIN_STOP_IN_NOISE_CROSSING_TIMES * 2.0 * noise / usual))) // 2) + 1
    if len(value) < 4 * length:
        return []
    quiet = maximum_filter1d(value, length) - minimum_filter1d(value, length) <= 2.0 * noise
    stands = np.convolve(quiet, np.ones(length), mode="same") > 0.5  # all samples of such a stretch
    edges = np.flatnonzero(np.diff(np.concatenate([[0], stands.astype(int), [0]])))
    near, far = 1 + max(2, int(np.ceil(2.0 * noise / usual))), length

    def steps(at: int, way: int) -> tuple[float, float]:
        """Steps per sample near a stretch and farther away, seen from it; 0 at the recording's end."""
        places = at + way * np.array([1, near, near + far])
        if places.min() < 0 or places.max() >= len(value):
            return 0.0, 0.0
        beside, before = np.diff(value[places]) / (near - 1, far)
        return float(beside), float(before)

    def abrupt(at: int, way: int) -> bool:
        """Whether the speed near a stretch is that farther away, but for a part of a step."""
        beside, before = steps(at, way)
        return bool(
            abs(before) > MIN_SPEED_SHARE_BESIDE_STICKING * usual and beside / before > MIN_SPEED_SHARE_BEFORE_STICKING
        )

    return [
        Stop(
            float(channel.time[first]),
            float(channel.time[end - 1]),
            float(np.median(value[first:end])),
            passed=steps(first, -1)[1] * steps(end - 1, 1)[1] < 0.0,
        )
        for first, end in zip(edges[::2], edges[1::2], strict=True)
        if abrupt(first, -1) or abrupt(end - 1, 1)
    ]


def sticking_spans(run: Run) -> list[tuple[float, float]]:
    """Time spans, s, in which joints pass positions at which they stick, so that their motion is not smooth.

    Each span is twice as long as the longest stop; in the second half the joint catches up.
    """
    found = []
    for name, channel in _joints(run):
        for stands in repeated_stops(run, name):
            crossed = np.diff(channel.value > stands[0].position)
            passes = [*(stand.start for stand in stands), *channel.time[1:][crossed].tolist()]
            found += [(t, t + 2.0 * longest_stop(stands)) for t in passes]
    return found


def longest_stop(stands: Iterable[Stop]) -> float:
    """Duration of the longest of some stops, s."""
    return max(stand.end - stand.start for stand in stands)


def _joints(run: Run) -> Iterator[tuple[str, Channel]]:
    """Position channels except the gripper's, which stops wherever its user wants."""
    return ((name, channel) for name, channel in encoder_channels(run) if name != "gripper_x")


def encoder_channels(run: Run) -> Iterator[tuple[str, Channel]]:
    """Channels of positions: joints, swing angle and gripper."""
    return ((n, c) for n, c in run.channels.items() if n.startswith("q.") or n in ("swing_angle", "gripper_x"))


def least_noise(channel: Channel) -> float:
    """Standard deviation of a signal's white noise where the signal changes least."""
    found = []
    for order in DIFFERENCE_ORDERS:
        if len(channel) > 4 * order:
            size = np.abs(normalised_differences(channel.time, channel.value, order))
            size = size[np.isfinite(size)]
            found.append(
                float(np.quantile(size, NOISE_ONLY_DIFFERENCE_SHARE) / NOISE_ONLY_ABS_NORMAL_QUANTILE)
                if len(size)
                else 0.0
            )
    return min(found, default=0.0)
