"""Find when a parameter changed, from fits of many recordings, by a statistical test with a given false-alarm rate.

A series is one parameter of one robot over time. A step in a series is significant if it explains more than noise would
explain in any series of the whole batch. The step is fitted together with a straight line, so that a slow drift is not
taken for a step; it must also be significant when it is fitted together with a parabola, or with a line through its
neighbours. A value far from the median of its neighbours is an outlier and is replaced by this median before the test.
`series.py` tests one series.

The bound of significance is the quantile of the largest normal deviate in simulated batches of noise. It is valid also
where the parameters of a robot are correlated, which only makes false alarms rarer (Sidak 1967).
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from scipy.stats import theilslopes

from armdyn.recording.channels import FloatArray
from pipeline.batch.series import ChangeTestSeries, ParameterSeries, estimate_lag_one_correlation

DEFAULT_FALSE_ALARM_PROBABILITY = 0.01
"""Default probability of a false alarm in a batch in which nothing changes."""
SIMULATED_BATCHES = 4000
"""Number of simulated batches; the bound for 1 % is then the 40th largest value, with an error of a sixth."""
NEIGHBOURS_PER_SIDE_OF_STEP = 12
"""Number of recordings on each side of a step that are its neighbours.

Over so few recordings a slow drift is nearly straight, while a change that persists still looks like a step.
"""
MAX_SIMULATED_VALUES, MIN_SIMULATED_BATCHES = 50_000_000, 1000
"""Largest number of simulated values (about ten seconds of computation), and smallest number of simulated batches.

With 1000 batches the bound for 1 % is the 10th largest value.
"""

SeriesKey: TypeAlias = tuple[str, str]
"""Name of a robot and name of a parameter; the parameter of one joint is written ``"<quantity>[<joint>]"``."""


@dataclass(frozen=True)
class ParameterStep:
    """A sudden change of one parameter.

    Attributes:
        robot: name of the robot.
        parameter: name of the parameter.
        last_before: time of the last recording with the old value, since 1970 [s].
        first_after: time of the first recording with the new value, since 1970 [s].
        before: median of the values from the previous step to this one, in the parameter's unit.
        after: median of the values from this step to the next one, in the parameter's unit.
        chance: probability that noise alone gives a step at least as clear anywhere in the batch; at least one over the
            number of simulated batches.
        index: index of the first recording with the new value in the series.
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
class ParameterDrift:
    """A slow change of one parameter.

    Attributes:
        robot: name of the robot.
        parameter: name of the parameter.
        slope: change per second, in the parameter's unit per s (median of the pairwise slopes, Theil and Sen).
        chance: probability that noise alone gives a slope at least as clear anywhere in the batch.
    """

    robot: str
    parameter: str
    slope: float
    chance: float


@dataclass(frozen=True)
class ParameterChangeTestResult:
    """Result of testing a batch of series for changes.

    Attributes:
        steps: sudden changes, the clearest first.
        drifts: slow changes of series without a step, the clearest first.
        tested: number of series that were tested.
        untested_series_count: number of series that were not tested, because they are too short or constant.
        false_alarms: probability of at least one false step, and of at least one false drift, in the batch.
    """

    steps: tuple[ParameterStep, ...]
    drifts: tuple[ParameterDrift, ...]
    tested: int
    untested_series_count: int
    false_alarms: float


def find_changes(
    series: Mapping[SeriesKey, ParameterSeries],
    false_alarms: float = DEFAULT_FALSE_ALARM_PROBABILITY,
    *,
    batches: int = SIMULATED_BATCHES,
    seed: int = 0,
) -> ParameterChangeTestResult:
    """Find the steps and drifts in a batch of parameter series.

    Args:
        series: the series by robot and parameter.
        false_alarms: probability of at least one false step, and of at least one false drift, in the batch.
        batches: number of simulated batches from which the bound of significance is computed.
        seed: seed of the simulated noise.

    Returns:
        The steps and drifts that are significant; one series may have several steps.
    """
    rng = np.random.default_rng(seed)
    tests = {name: test for name, one in series.items() if (test := ChangeTestSeries.from_series(one)) is not None}
    if not tests:
        return ParameterChangeTestResult((), (), 0, len(series), false_alarms)
    kinds: dict[str, list[ChangeTestSeries]] = {}
    for (_, parameter), test in tests.items():
        kinds.setdefault(_kind(parameter), []).append(test)
    phi = {kind: estimate_lag_one_correlation(group, rng) for kind, group in kinds.items()}
    tests = {
        name: test
        for name in tests
        if (test := ChangeTestSeries.from_series(series[name], phi[_kind(name[1])])) is not None
    }
    size = sum(len(test.time) for test in tests.values())
    batches = min(batches, max(MIN_SIMULATED_BATCHES, MAX_SIMULATED_VALUES // size))
    largest = np.zeros((2, batches))
    for test in tests.values():
        np.maximum(largest, test.simulated_normal_deviates(batches, rng), out=largest)
    step_bound, drift_bound = np.quantile(largest, 1.0 - false_alarms, axis=1)
    steps: list[ParameterStep] = []
    drifts: list[ParameterDrift] = []
    for name, test in tests.items():
        found = list(_steps(name, series[name], (0, len(test.time)), test.phi, largest[0], step_bound))
        steps += found
        trend = float(test.slope_normal_deviates(test.scores[None])[0])
        if not found and trend > drift_bound:
            slope = float(theilslopes(test.value, test.time).slope)
            drifts.append(ParameterDrift(*name, slope, _chance(trend, largest[1])))
    return ParameterChangeTestResult(
        tuple(sorted(steps, key=lambda s: (s.chance, s.first_after))),
        tuple(sorted(drifts, key=lambda d: d.chance)),
        len(tests),
        len(series) - len(tests),
        false_alarms,
    )


def _steps(
    name: SeriesKey, series: ParameterSeries, part: tuple[int, int], phi: float, by_chance: FloatArray, bound: float
) -> Iterator[ParameterStep]:
    """Find steps in one part of a series; the parts before and after each step are searched again.

    Args:
        name: robot and parameter.
        series: the whole series.
        part: index of the part's first recording, and of the first one after it.
        phi: correlation of neighbouring recordings.
        by_chance: largest normal deviate of each simulated batch of noise, (batches,).
        bound: deviate above which a step is significant.
    """
    first, end = part
    test = ChangeTestSeries.from_series(series.section(first, end), phi)
    if test is None:
        return
    deviates, best, _ = test.best_step(test.scores[None])
    deviate = float(deviates[0])
    middle = first + int(test.splits[best[0]])
    sharp = test.step_normal_deviate(int(best[0]), parabola=True)
    start, stop = max(first, middle - NEIGHBOURS_PER_SIDE_OF_STEP), min(end, middle + NEIGHBOURS_PER_SIDE_OF_STEP)
    nearby = ChangeTestSeries.from_series(series.section(start, stop), phi)
    if nearby is not None:
        split = int(np.argmin(np.abs(nearby.splits - (middle - start))))
        sharp = max(sharp, nearby.step_normal_deviate(split, parabola=False))
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
    """Share of the simulated batches with at least this deviate; at least one over the number of batches."""
    return max(float(np.mean(by_chance >= deviate)), 1.0 / len(by_chance))


def _kind(parameter: str) -> str:
    """The quantity of a parameter, without the name of its joint."""
    return parameter.partition("[")[0]
