"""The time at which a parameter changed, found in fits of many recordings by a test with a stated false-alarm rate.

A series is one parameter of one robot over time. It counts as changed where a step explains more of it than chance
would in any series of the whole batch. A slow drift is not a step: the step is fitted together with a straight line,
and must also remain significant beside a parabola or a line through its neighbours. A single outlier is not a step
either: a value far from the median of its neighbours is replaced by that median. The test of one series is in
`series.py`.
The bound is the quantile of the batch's largest deviate over simulated batches of such noise; it holds for the batch
also where the parameters of a robot are correlated, which only makes alarms rarer (Sidak 1967).
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from scipy.stats import theilslopes

from armdyn.recording.channels import FloatArray
from pipeline.batch.series import ParameterSeries, StepTest, correlation

FALSE_ALARM_RATE = 0.01
"""Probability that a batch in which nothing changes has an alarm."""
SIMULATED_BATCHES = 4000
"""Simulated batches: the bound at 1 % is then the 40th largest value, known within a sixth of that 1 %."""
NEIGHBOURING_RECORDINGS = 12
"""Recordings on either side that are neighbours of a step: over so many a slow curve is nearly straight, while a change
that lasts for a while still looks like a step."""
MAX_SIMULATED_VALUES, MIN_BATCHES = 50_000_000, 1000
"""Largest number of simulated values, some ten seconds of work, and smallest number of batches: for large data fewer
batches are simulated, but so many that the bound at 1 % is the 10th largest value."""

Name: TypeAlias = tuple[str, str]
"""Robot and parameter; the parameter of one joint is written ``"<quantity>[<joint>]"``."""


@dataclass(frozen=True)
class ParameterStep:
    """A sudden change of one parameter.

    Attributes:
        robot: name of the robot.
        parameter: name of the parameter.
        last_before: time of the last recording with the old value, s.
        first_after: time of the first recording with the new value, s.
        before: median of the values before the step, back to the previous step.
        after: median of the values after the step, up to the next step.
        chance: probability of a step at least as clear as this one anywhere in a batch in which nothing changes; at
            least one over the number of simulated batches.
        index: number of the first recording with the new value in the series.
    """

    robot: str
    parameter: str
    last_before: float
    first_after: float
    before: float
    after: float
    chance: float
    index: int


@dataclass(frozen=True)
class Drift:
    """A slow change of one parameter.

    Attributes:
        robot: name of the robot.
        parameter: name of the parameter.
        slope: change per second (median of the pairwise slopes, Theil and Sen).
        chance: probability of a slope at least as clear as this one anywhere in a batch in which nothing changes.
    """

    robot: str
    parameter: str
    slope: float
    chance: float


@dataclass(frozen=True)
class ChangeTest:
    """Result of the test on a batch of series.

    Attributes:
        steps: sudden changes, the clearest first.
        drifts: slow changes of series without a step, the clearest first.
        tested: series that are long enough for the test.
        too_short: series that are too short or constant.
        false_alarms: probability of at least one step, and of at least one drift, in a batch in which nothing changes.
    """

    steps: tuple[ParameterStep, ...]
    drifts: tuple[Drift, ...]
    tested: int
    too_short: int
    false_alarms: float


def find_changes(
    series: Mapping[Name, ParameterSeries],
    false_alarms: float = FALSE_ALARM_RATE,
    *,
    batches: int = SIMULATED_BATCHES,
    seed: int = 0,
) -> ChangeTest:
    """Find the steps and drifts in a batch of parameter series.

    Args:
        series: the series by robot and parameter.
        false_alarms: probability of at least one step, and of at least one drift, in a batch in which nothing changes.
        batches: number of simulated batches from which the bound is taken.
        seed: seed of the simulated noise.

    Returns:
        The steps and drifts that are significant; one series may have several steps.
    """
    rng = np.random.default_rng(seed)
    tests = {name: test for name, one in series.items() if (test := StepTest.of(one)) is not None}
    if not tests:
        return ChangeTest((), (), 0, len(series), false_alarms)
    kinds: dict[str, list[StepTest]] = {}
    for (_, parameter), test in tests.items():
        kinds.setdefault(_kind(parameter), []).append(test)
    phi = {kind: correlation(group, rng) for kind, group in kinds.items()}
    tests = {name: test for name in tests if (test := StepTest.of(series[name], phi[_kind(name[1])])) is not None}
    size = sum(len(test.time) for test in tests.values())
    batches = min(batches, max(MIN_BATCHES, MAX_SIMULATED_VALUES // size))
    largest = np.zeros((2, batches))
    for test in tests.values():
        np.maximum(largest, test.by_chance(batches, rng), out=largest)
    step_bound, drift_bound = np.quantile(largest, 1.0 - false_alarms, axis=1)
    steps: list[ParameterStep] = []
    drifts: list[Drift] = []
    for name, test in tests.items():
        found = list(_steps(name, series[name], (0, len(test.time)), test.phi, largest[0], step_bound))
        steps += found
        trend = float(test.trends(test.scores[None])[0])
        if not found and trend > drift_bound:
            slope = float(theilslopes(test.value, test.time).slope)
            drifts.append(Drift(*name, slope, _chance(trend, largest[1])))
    return ChangeTest(
        tuple(sorted(steps, key=lambda s: (s.chance, s.first_after))),
        tuple(sorted(drifts, key=lambda d: d.chance)),
        len(tests),
        len(series) - len(tests),
        false_alarms,
    )


def _steps(
    name: Name, series: ParameterSeries, part: tuple[int, int], phi: float, by_chance: FloatArray, bound: float
) -> Iterator[ParameterStep]:
    """Steps in one part of a series; both sides of every step found are searched again.

    Args:
        name: robot and parameter.
        series: the whole series.
        part: first recording of the part, and the first one after it.
        phi: correlation of neighbours.
        by_chance: (batches,) largest deviates of simulated batches in which nothing changes.
        bound: deviate beyond which a step is significant.
    """
    first, end = part
    test = StepTest.of(series.part(first, end), phi)
    if test is None:
        return
    deviates, best, _ = test.largest(test.scores[None])
    deviate = float(deviates[0])
    middle = first + int(test.splits[best[0]])
    sharp = test.beside(int(best[0]), parabola=True)
    start, stop = max(first, middle - NEIGHBOURING_RECORDINGS), min(end, middle + NEIGHBOURING_RECORDINGS)
    nearby = StepTest.of(series.part(start, stop), phi)
    if nearby is not None:
        split = int(np.argmin(np.abs(nearby.splits - (middle - start))))
        sharp = max(sharp, nearby.beside(split, parabola=False))
    if min(deviate, sharp) <= bound:
        return
    sides = (first, middle), (middle, end)
    earlier, later = (list(_steps(name, series, side, phi, by_chance, bound)) for side in sides)
    start = max((s.index for s in earlier), default=first)
    stop = min((s.index for s in later), default=end)
    yield from earlier
    yield ParameterStep(
        *name, float(series.time[middle - 1]), float(series.time[middle]),
        float(np.median(series.value[start:middle])), float(np.median(series.value[middle:stop])),
        _chance(deviate, by_chance), middle,
    )  # fmt: skip
    yield from later


def _chance(deviate: float, by_chance: FloatArray) -> float:
    """Share of the simulated batches with at least as large a deviate; at least one over their number."""
    return max(float(np.mean(by_chance >= deviate)), 1.0 / len(by_chance))


def _kind(parameter: str) -> str:
    """The quantity of a parameter, without the name of its joint."""
    return parameter.partition("[")[0]
