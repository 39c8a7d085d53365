"""Check the signals of a recording without a model: gaps, glitches, repeated samples, saturation, noise."""

from collections.abc import Callable, Iterator, Mapping

import numpy as np

from armdyn.inspection.check import Check, CheckKind, Severity, names_in_words, rounded
from armdyn.inspection.commands import command_checks
from armdyn.inspection.correction import CorrectedReading, Correction
from armdyn.inspection.holds import encoder_channels, least_noise, sticking_joint_checks, stuck_sensor_checks
from armdyn.recording.channels import MIN_COMPARED_CHANNEL_SAMPLES, Channel, channel_kind
from armdyn.recording.gaps import MIN_GAP_USUAL_INTERVALS, gaps_of, longest_interval_without_gap
from armdyn.recording.noise import MAX_DIFFERENCE_SPAN_RATIO, noise_std_from_differences, normalised_differences
from armdyn.recording.spikes import ALLOWED_FAULTS, saturated_samples, spikes_of
from armdyn.recording.tracks import samples_of_second_series
from armdyn.run import Run
from armdyn.smoothing.choice import resolution

MIN_FINE_STEP_IN_RESOLUTIONS = 3.0
"""Least usual step of a signal, in steps of its resolution, for which repeated values are not those of a coarse
encoder."""
MIN_REPEATED_ROW_SHARE, MIN_COMMON_REPETITION_SHARE, MIN_REST_ROWS = 0.05, 0.8, 12
"""Share of repeated rows from which they are reported; least share of the repetitions of any channel that are those of
whole rows; number of successive repetitions from which they are a rest."""
MIN_CLIPPED_SHARE = 0.01
"""Share of samples at the end of the range from which a sensor counts as saturated."""
MIN_LOST_COUNT_STEP_STDS = 12.0
"""Least permanent step of an encoder's position that means lost counts, in standard deviations of the noise."""
MIN_LOST_COUNT_STEP = 0.01
"""Least permanent step of an encoder's position that means lost counts, rad or m."""
SAMPLES_BESIDE_STEP, MAX_DIFFERENCES_AS_LARGE_AS_STEP = 10, 8
"""Number of samples to either side of a step that are fitted, and largest number of differences as large as a step."""
MIN_JITTER_RATIO = 0.15
"""Ratio of the standard deviation of sampling intervals to their median from which jitter is reported."""
INTERVAL_MULTIPLE_TOLERANCE, MIN_REGULAR_INTERVAL_SHARE = 0.2, 0.98
"""Tolerance for intervals that are multiples of the usual interval, and least share of them for a regular clock."""
MIN_REPORTED_TO_STATED_NOISE = 5.0
"""Ratio of the noise in the smallest third of a signal's differences to the stated noise from which it is reported."""
MIN_MOTION_RANGE_STDS = 20.0
"""Least range of a position that counts as motion, in standard deviations of the noise; also `MIN_MOTION_RANGE`."""
MIN_MOTION_RANGE = 2e-3
MAX_PLAUSIBLE_VALUE_BY_UNIT: Mapping[str, tuple[float, CheckKind, str]] = {
    "rad": (4.0 * np.pi, "angle_unit", "deg"), "rad/s": (60.0, "angle_unit", "deg/s"), "m": (20.0, "scale", "mm"),
    "m/s": (20.0, "scale", "mm/s"), "N m": (1e4, "torque_unit", "mN m"), "N": (1e4, "torque_unit", "mN"),
}  # fmt: skip
"""Largest plausible value by unit (two turns, ten turns a second, and what no laboratory arm reaches or carries), the
kind of mistake, and the unit that it may be in."""
MAX_NUMERICAL_DUST = 1e-9
"""Size, N m or N, up to which torques and forces are rounding errors of a program, far below what any sensor reads."""
FULL_TURN_IN_RAD_AND_DEG = (2.0 * np.pi, 360.0)
"""A full turn in rad, and in degrees, for angles in degrees that are declared as rad."""
MAX_MOTION_PER_SAMPLE_TURNS, MAX_WRAPPED_SAMPLE_SHARE = 0.2, 0.05
"""Largest motion of a joint between two samples, in turns, and largest share of samples at which its angle wraps."""
SignalCheck = Callable[[Run], Iterator[Check]]


def gap_checks(run: Run) -> Iterator[Check]:
    """Findings on gaps, in which samples of a channel are missing for some time."""
    for begin, end in gaps_of(run):
        yield Check(
            "gap", Severity.NOTE, run.name, tuple(run.channels),
            f"no sample between {begin:.4g} and {end:.4g} s",
            "nothing to do: the run is cut there, and each piece has its own start", begin, end,
        )  # fmt: skip


def _clocks(run: Run) -> Iterator[tuple[str, Channel, np.ndarray, float]]:
    """First channel of every clock, with its name, its intervals (n - 1,) and their median, s."""
    seen: set[bytes] = set()
    for name, channel in run.channels.items():
        steps = np.diff(channel.time)
        if len(steps) >= MIN_COMPARED_CHANNEL_SAMPLES and channel.time.tobytes() not in seen:
            yield name, channel, steps, float(np.median(steps))
            seen.add(channel.time.tobytes())


def dropped_sample_checks(run: Run) -> Iterator[Check]:
    """Findings on single missing samples of a regular clock."""
    for name, channel, steps, usual in _clocks(run):
        counts = np.round(steps / usual)
        if np.mean(np.abs(steps / usual - counts) < INTERVAL_MULTIPLE_TOLERANCE) < MIN_REGULAR_INTERVAL_SHARE:
            continue
        missing = int(np.sum(counts[steps <= longest_interval_without_gap(channel.time)] - 1.0))
        if missing > 0:
            yield Check(
                "samples_dropped", Severity.NOTE, run.name, (name,),
                f"{missing} of {len(channel) + missing} samples of {name} are missing, one or a few at a time",
                "nothing to do: what lies between is interpolated",
            )  # fmt: skip


def jitter_checks(run: Run) -> Iterator[Check]:
    """Findings on time stamps with jitter."""
    for name, _, steps, usual in _clocks(run):
        spread = float(np.std(steps[steps < MIN_GAP_USUAL_INTERVALS * usual])) / usual
        if spread > MIN_JITTER_RATIO:
            yield Check(
                "rate", Severity.NOTE, run.name, (name,),
                f"the interval between samples is {1e3 * usual:.3g} ms give or take {100 * spread:.0f} %",
                "let the sensor's own clock stamp the samples; a program that reads a queue stamps when it reads",
            )  # fmt: skip


def second_publisher_checks(run: Run) -> Iterator[Check]:
    """Findings on positions of two publishers that were recorded as one signal."""
    by_time: dict[bytes, list[str]] = {}
    for name, channel in run.channels.items():
        if name.startswith("q."):
            by_time.setdefault(channel.time.tobytes(), []).append(name)
    for names in by_time.values():
        second = samples_of_second_series(np.column_stack([run.channels[name].value for name in names]))
        if second.any():
            time = run.channels[names[0]].time[second]
            yield Check(
                "second_publisher", Severity.WRONG, run.name, tuple(names),
                f"{len(time)} of {len(second)} samples between the others hold other positions, as of a second "
                "publisher on the topic",
                "import the bag again, which takes one of them, or remove these rows", float(time[0]), float(time[-1]),
            )  # fmt: skip


def glitch_checks(run: Run) -> Iterator[Check]:
    """Findings on glitches: single samples far from their neighbours."""
    found = {name: channel.time[spikes_of(channel)] for name, channel in run.channels.items()}
    found = {name: when for name, when in found.items() if len(when)}
    if found:
        counts = ", ".join(f"{len(when)} of {name}" for name, when in found.items())
        first, last = min(when[0] for when in found.values()), max(when[-1] for when in found.values())
        yield Check(
            "glitch", Severity.NOTE, run.name, tuple(found), f"samples far from their neighbours: {counts}",
            "nothing to do: they are left out", float(first), float(last),
        )  # fmt: skip


def repetition_checks(run: Run) -> Iterator[Check]:
    """Findings on slowly sampled signals whose samples were recorded repeatedly."""
    for name, channel in run.channels.items():
        held = repetitions_per_value(channel)
        if held > 1:
            rate = (len(channel) - 1) / (channel.time[-1] - channel.time[0])
            yield Check(
                "repeated_samples", Severity.SUSPECT, run.name, (name,),
                f"every value of {name} stands {held} times: it was measured at {rate / held:.3g} Hz and written at "
                f"{rate:.3g} Hz",
                f"keep the first of each {held} values of {name}, and empty the other cells",
            )  # fmt: skip


def repeated_row_checks(run: Run) -> Iterator[Check]:
    """Findings on rows that stand again below themselves: all channels of a clock repeat their values at once.

    A joint at rest repeats them for long; coarse signals repeat theirs one by one as well.
    """
    rows: dict[bytes, list[str]] = {}
    for name, channel in run.channels.items():
        rows.setdefault(channel.time.tobytes(), []).append(name)
    for names in rows.values():
        values = np.column_stack([run.channels[name].value for name in names])
        if len(names) < 2 or len(values) < MIN_COMPARED_CHANNEL_SAMPLES:
            continue
        same = np.diff(values, axis=0) == 0.0
        edges = np.flatnonzero(np.diff(np.concatenate([[False], same.all(axis=1), [False]]).astype(int)))
        lengths = np.diff(edges)[::2]
        again = int(lengths[lengths < MIN_REST_ROWS].sum())
        rests = int(lengths[lengths >= MIN_REST_ROWS].sum())
        finest = int(same.sum(axis=0).min()) - rests  # repetitions of the channel that repeats least
        if again > MIN_REPEATED_ROW_SHARE * (len(same) - rests) and again > MIN_COMMON_REPETITION_SHARE * finest:
            yield Check(
                "repeated_samples", Severity.SUSPECT, run.name, tuple(names),
                f"{again} of {len(values)} rows repeat the row above, all {len(names)} channels at once: they were "
                "written again, not measured again",
                "leave the repeated rows out, or record with the sensors' own time stamps",
            )  # fmt: skip


def repetitions_per_value(channel: Channel) -> int:
    """Number of times that each measured value of a channel was recorded; 1 without repetitions."""
    change = np.flatnonzero(np.diff(channel.value) != 0.0)
    if len(change) < MIN_COMPARED_CHANNEL_SAMPLES:
        return 1
    lengths = np.diff(change)
    held = int(np.median(lengths))
    steps = np.abs(np.diff(channel.value)[change])
    regular = float(np.mean(np.abs(lengths % held) == 0)) if held else 0.0
    coarse = float(np.median(steps)) < MIN_FINE_STEP_IN_RESOLUTIONS * resolution(channel.value)
    return held if held > 1 and regular > 0.8 and not coarse else 1


def saturation_checks(run: Run) -> Iterator[Check]:
    """Findings on saturation: many samples have the largest or smallest value."""
    for name, channel in run.channels.items():
        if not channel_kind(name).measured:
            continue
        bad = saturated_samples(channel.value)
        if bad.mean() > MIN_CLIPPED_SHARE:
            top = float(np.abs(channel.value[bad]).max())
            yield Check(
                "saturated", Severity.SUSPECT, run.name, (name,),
                f"{100 * bad.mean():.0f} % of {name} stand at {rounded(top)} {channel.unit}, the end of its range",
                "they are left out; record with a larger range, or move more gently",
                float(channel.time[bad][0]), float(channel.time[bad][-1]),
            )  # fmt: skip


def lost_count_checks(run: Run) -> Iterator[Check]:
    """Findings on lost counts: encoders whose zero position jumps during the recording."""
    for name, channel in encoder_channels(run):
        found = largest_step(channel)
        if found is not None:
            at, size = found
            yield Check(
                "counts_lost", Severity.SUSPECT, run.name, (name,),
                f"{name} steps by {rounded(size)} {channel.unit} at {channel.time[at]:.4g} s and stays there: counts "
                "were lost",
                f"cut the recording at {channel.time[at]:.4g} s, or subtract the step from what follows",
                float(channel.time[at]), float(channel.time[-1]),
            )  # fmt: skip


def encoder_step_times(run: Run) -> list[float]:
    """Times, s, at which the zero position of an encoder jumps."""
    found = ((channel, largest_step(channel)) for _, channel in encoder_channels(run))
    return [float(channel.time[step[0]]) for channel, step in found if step is not None]


def largest_step(channel: Channel) -> tuple[int, float] | None:
    """Index after the largest permanent jump of a signal, and the jump's size; None without a jump.

    The size is the distance of the parabolas through the samples before and after it.
    """
    time, value, n, beside = channel.time, channel.value, len(channel), SAMPLES_BESIDE_STEP
    if n < 6 * beside:
        return None
    third = np.abs(np.nan_to_num(normalised_differences(time, value, 3)))
    usual = noise_std_from_differences(time, value) + resolution(value) / np.sqrt(12.0)
    at = int(np.clip(np.argmax(third) + 1, beside, n - beside - 2))
    longest = np.diff(time[at - beside + 1 : at + beside + 1]).max()
    steps_often = np.sum(third > 0.5 * MIN_LOST_COUNT_STEP_STDS * usual) > MAX_DIFFERENCES_AS_LARGE_AS_STEP
    if steps_often or longest > MAX_DIFFERENCE_SPAN_RATIO * float(np.median(np.diff(time))):
        return None
    places = range(max(beside, at - 2), min(n - beside - 1, at + 3))
    rough, after, size = min((_jump(time, value, k)[1], k + 1, _jump(time, value, k)[0]) for k in places)
    # Where a single sample makes the step, the sample is wrong.
    for k, i in enumerate((after - 1, after)):
        size = min(size, _jump(np.delete(time, i), np.delete(value, i), after - 2 + k)[0], key=abs)
    return (after, size) if abs(size) > max(MIN_LOST_COUNT_STEP_STDS * max(usual, rough), MIN_LOST_COUNT_STEP) else None


def _jump(time: np.ndarray, value: np.ndarray, k: int) -> tuple[float, float]:
    """Distance of the parabolas between samples k and k + 1, and the root mean square of their residuals."""
    beside, middle = SAMPLES_BESIDE_STEP, 0.5 * (time[k + 1] - time[k])
    ends, residuals = [], []
    for part in (slice(k - beside + 1, k + 1), slice(k + 1, k + beside + 1)):
        t, y = time[part] - time[k], value[part]
        curve = np.polyfit(t, y, 2)
        ends.append(float(np.polyval(curve, middle)))
        residuals.append(float(np.std(y - np.polyval(curve, t))))
    return ends[1] - ends[0], max(residuals)


def stated_noise_checks(run: Run) -> Iterator[Check]:
    """Findings on stated noise that is much smaller than the noise of the samples."""
    for name, stated in run.noise.items():
        if name not in run.channels or stated <= 0.0:
            continue
        channel = run.channels[name]
        shown = least_noise(channel)
        if shown > MIN_REPORTED_TO_STATED_NOISE * max(stated, resolution(channel.value) / np.sqrt(12.0)):
            yield Check(
                "noise_misstated", Severity.SUSPECT, run.name, (name,),
                f"the noise of {name} is stated as {stated:.3g} {channel.unit}, and its samples show {shown:.3g}",
                f'write {name} = "{shown:.3g} {channel.unit}" under [noise], or leave the line out',
            )  # fmt: skip


def motion_checks(run: Run) -> Iterator[Check]:
    """Findings on a recording in which nothing moves."""
    moving = [n for n in run.channels if n.startswith("q.") or n in ("swing_angle", "swing_rate", "gripper_x")]
    if moving and not any(changes_beyond_noise(run.channels[name]) for name in moving):
        yield Check(
            "no_motion", Severity.SUSPECT, run.name, tuple(moving),
            f"nothing moves: {', '.join(moving[:4])} stay where they are",
            "record a motion; 'armdyn excite' designs one",
        )  # fmt: skip


def changes_beyond_noise(channel: Channel) -> bool:
    """Whether a position changes by more than its noise, so that it shows a motion."""
    value = channel.value
    last = min(ALLOWED_FAULTS, len(value) - 1)  # as many samples at either end may be glitches
    low, high = np.sort(value)[[last, -1 - last]]
    return bool(
        high - low > max(MIN_MOTION_RANGE_STDS * noise_std_from_differences(channel.time, value), MIN_MOTION_RANGE)
    )


def range_checks(run: Run) -> Iterator[Check]:
    """Findings on values that are impossible in the unit of the channel."""
    for name, channel in run.channels.items():
        most, kind, unit = MAX_PLAUSIBLE_VALUE_BY_UNIT.get(channel.unit, (np.inf, "scale", ""))
        top = float(np.quantile(np.abs(channel.value), 0.99))
        if top > most:
            yield Check(
                kind, Severity.SUSPECT, run.name, (name,),
                f"{name} reaches {rounded(top)} {channel.unit}, more than {rounded(most)}: is it in {unit}?",
                f"write '{name} [{unit}]' in the header if it is",
            )  # fmt: skip


def dust_checks(run: Run) -> Iterator[Check]:
    """Findings on torques and forces that are nothing but rounding errors, or zero."""
    measured = {name: c for name, c in run.channels.items() if channel_kind(name).measured and c.unit in ("N m", "N")}
    sizes = {name: float(np.abs(channel.value).max()) for name, channel in measured.items()}
    dust = {name: size for name, size in sizes.items() if size <= MAX_NUMERICAL_DUST}
    if dust:
        every = len(dust) == len(sizes)
        unit = measured[next(iter(dust))].unit
        which = "all torques and forces are" if every and len(dust) > 1 else f"{names_in_words(list(dust))} is"
        yield Check(
            "scale", Severity.WRONG if every else Severity.SUSPECT, run.name, tuple(dust),
            f"{which} nothing: at most {rounded(max(dust.values()))} {unit}, a rounding error",
            f"leave the column{'s' if len(dust) > 1 else ''} out, or record what a sensor measures",
        )  # fmt: skip


def wrapped_angle_checks(run: Run) -> Iterator[Check]:
    """Findings on angles of endless joints that wrap around after a turn."""
    for name, channel in run.channels.items():
        if channel.unit != "rad" or not (name.startswith("q.") or name == "swing_angle"):
            continue
        step = np.diff(channel.value)
        usual = float(np.quantile(np.abs(step), 1.0 - MAX_WRAPPED_SAMPLE_SHARE)) if len(step) else 0.0
        turns = (
            (turn, _round(step, turn))
            for turn in FULL_TURN_IN_RAD_AND_DEG
            if usual < MAX_MOTION_PER_SAMPLE_TURNS * turn
        )
        turn, wrapped = next(((turn, at) for turn, at in turns if at.any()), (0.0, None))
        if wrapped is None:
            continue
        yield Check(
            "wrapped", Severity.WRONG, run.name, (name,),
            f"{name} counts from the other end again after {rounded(turn)} rad, {wrapped.sum()} times: no joint turns "
            "that fast",
            f"armdyn inspect {run.source or run.name} --fix fixed",
            float(channel.time[1:][wrapped][0]), float(channel.time[-1]),
            correction=Correction({name: CorrectedReading(name, wrap_period=turn)}),
        )  # fmt: skip


def _round(step: np.ndarray, turn: float) -> np.ndarray:
    """(n,) bool: steps of a whole turn, up to the motion, with the same motion before and after."""
    once = np.abs(np.abs(step) - turn) < MAX_MOTION_PER_SAMPLE_TURNS * turn
    small = np.abs(step) < MAX_MOTION_PER_SAMPLE_TURNS * turn
    beside = np.concatenate([[True], small[:-1]]) & np.concatenate([small[1:], [True]])
    return np.asarray(once & beside)


def unconfirmed_mappings(run: Run) -> Iterator[Check]:
    """Find questions about proposed mappings of columns that nobody has answered: each once, with all its channels."""
    questions: dict[str, dict[str, str]] = {}
    for name, of_column in run.asked.items():
        column, _, question = of_column.rpartition("': ")
        questions.setdefault(question, {})[name] = f"{column}'" if column else ""
    for question, columns in questions.items():
        first, made_of = next(iter(columns.items()))
        others = len(columns) - 1
        lines = f"{len(columns)} lines" if others else "line"
        answered = "import with --confirm"
        if run.source is not None:
            answered = f"take its {lines} away below [asked] in {run.source.with_suffix('.toml')}"
        yield Check(
            "unanswered_check", Severity.SUSPECT, run.name, tuple(name for name in columns if name in run.all_channels),
            f"{first}{f' was made of {made_of}' if made_of else ''}{f', and so were {others} more' if others else ''}: "
            f"{question} (nobody has answered this yet)",
            f"if it is right, {answered}; else correct the mapping and import again: "
            "armdyn import FILE --output DIR --map map.toml --force",
        )  # fmt: skip


SIGNAL_CHECKS: tuple[SignalCheck, ...] = (
    second_publisher_checks, motion_checks, command_checks, dust_checks, gap_checks, dropped_sample_checks,
    stuck_sensor_checks, sticking_joint_checks, repetition_checks, repeated_row_checks, saturation_checks,
    lost_count_checks, glitch_checks, jitter_checks, stated_noise_checks, unconfirmed_mappings,
)  # fmt: skip
"""Functions that check the signals of a recording; a new check is a further function."""
