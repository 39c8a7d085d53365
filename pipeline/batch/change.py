"""Find when a parameter changed, from fits of many recordings, by a statistical test with a given false-alarm rate.

A series is one parameter of one robot over time. It has a step if two chances are small:

- that mere scatter about a constant shows as much evidence for a step, anywhere in any series of the batch;
- that scatter about the series' own drift, a line or a parabola, shows as much, in any series of the batch that drifts;
  so slow wear is no step, also where it grows or slows down.

Both are computed by permutation: the scatter of the series itself is mixed and tested in the same way. Neighbouring
recordings may be alike; how much they are, all series of the batch tell together. `evidence.py` compares the
descriptions of one series.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import TypeAlias

import numpy as np
from scipy.stats import theilslopes

from armdyn.recording.channels import FloatArray
from pipeline.batch.evidence import SeriesEvidence, correlation_prior
from pipeline.batch.series import ParameterSeries

DEFAULT_FALSE_ALARM_PROBABILITY = 0.01
"""Default probability of a false alarm in a batch in which nothing changes."""
PERMUTATIONS = 1000
"""Number of permutations of each series."""
FIRST_PERMUTATIONS, MIN_CLEAR_CHANCE = 200, 0.1
"""Number of permutations of each series to begin with, and the chance beyond which it is not permuted further."""
TAIL_SHARE = 0.1
"""Share of the permutations with the most evidence, from which the chance of still more evidence is extrapolated."""

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
        chance: probability that scatter gives as much evidence for a step anywhere in the batch.
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
        chance: probability that scatter gives as much evidence for a slope anywhere in the batch.
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


@dataclass(frozen=True)
class _TestedSeries:
    """A series and its chances, of which each is of this series alone.

    Attributes:
        begin: index of the first recording of the best change.
        end: index of the first recording after it; the number of recordings if it never ends.
        drifts: whether a line or a parabola describes the series better than a constant.
        step: probability of as much evidence for a change in mere scatter.
        step_in_drift: probability of as much evidence for a change in scatter about this drift.
        slope: probability of as much evidence for a drift in mere scatter.
    """

    begin: int
    end: int
    drifts: bool
    step: float
    step_in_drift: float
    slope: float


@dataclass(frozen=True)
class _Batch:
    """What the tests of a batch share.

    Attributes:
        prior: probabilities of the correlations of neighbours, (6,).
        permutations: number of permutations of each series.
        rng: source of the permutations.
        tested: number of series.
        drifting: number of series that a drift describes better than a constant, at least one.
        false_alarms: chance below which a change is marked.
    """

    prior: FloatArray
    permutations: int
    rng: np.random.Generator
    tested: int
    drifting: int
    false_alarms: float

    def chance_of_step(self, of: _TestedSeries) -> float:
        """Probability that any series of the batch shows as much evidence for a step by chance."""
        return max(_chance_of_any(of.step, self.tested), _chance_of_any(of.step_in_drift, self.drifting))


def find_changes(
    series: Mapping[SeriesKey, ParameterSeries],
    false_alarms: float = DEFAULT_FALSE_ALARM_PROBABILITY,
    *,
    permutations: int = PERMUTATIONS,
    seed: int = 0,
) -> ParameterChangeTestResult:
    """Find the steps and drifts in a batch of parameter series.

    Args:
        series: the series by robot and parameter.
        false_alarms: probability of at least one false step, and of at least one false drift, in the batch.
        permutations: number of permutations of each series from which chances are computed.
        seed: seed of the permutations.

    Returns:
        The steps and drifts that are significant; one series may have several steps.
    """
    rng = np.random.default_rng(seed)
    evidence = {name: SeriesEvidence(one) for name, one in series.items() if one.testable}
    if not evidence:
        return ParameterChangeTestResult((), (), 0, len(series), false_alarms)
    prior = correlation_prior(np.array([one.correlation_likelihood() for one in evidence.values()]))
    tests = {name: _test(one, prior, permutations, rng, false_alarms) for name, one in evidence.items()}
    drifting = max(1, sum(test.drifts for test in tests.values()))
    batch = _Batch(prior, permutations, rng, len(tests), drifting, false_alarms)
    steps: list[ParameterStep] = []
    drifts: list[ParameterDrift] = []
    for name, test in tests.items():
        found = list(_steps(name, series[name], (0, len(series[name].time)), test, batch))
        steps += found
        chance = _chance_of_any(test.slope, batch.tested)
        if not found and test.drifts and chance <= false_alarms:
            slope = float(theilslopes(series[name].value, series[name].time).slope)
            drifts.append(ParameterDrift(*name, slope, chance))
    return ParameterChangeTestResult(
        tuple(sorted(steps, key=lambda s: (s.chance, s.first_after))),
        tuple(sorted(drifts, key=lambda d: d.chance)),
        len(tests),
        len(series) - len(tests),
        false_alarms,
    )


def _test(
    evidence: SeriesEvidence, prior: FloatArray, permutations: int, rng: np.random.Generator, false_alarms: float
) -> _TestedSeries:
    log_prior = np.log(prior)
    seen = evidence.evidence(evidence.scores[None], log_prior)
    begin, end = evidence.changes[seen.change[0]]
    for count in (min(FIRST_PERMUTATIONS, permutations), permutations):
        made = evidence.permuted(log_prior, count, rng)
        mere, drifting = (evidence.evidence(scores, log_prior) for scores in made)
        test = _TestedSeries(
            int(begin), int(end), bool(seen.drift_over_constant[0] > 0.0),
            _chance(seen.change_over_constant, mere.change_over_constant),
            _chance(seen.change_over_drift, drifting.change_over_drift),
            _chance(seen.drift_over_constant, mere.drift_over_constant),
        )  # fmt: skip
        if min(test.step, test.slope) > max(MIN_CLEAR_CHANCE, 3.0 * false_alarms):
            break
    return test


def _steps(
    name: SeriesKey, series: ParameterSeries, part: tuple[int, int], test: _TestedSeries | None, batch: _Batch
) -> Iterator[ParameterStep]:
    """Find steps in one part of a series; the parts before, between and after them are searched again.

    Args:
        name: robot and parameter.
        series: the whole series.
        part: index of the part's first recording, and of the first one after it.
        test: test of the part; None for a part that has to be tested.
        batch: what the tests of the batch share.
    """
    first, stop = part
    if test is None:
        of = series.section(first, stop)
        if not of.testable:
            return
        test = _test(SeriesEvidence(of), batch.prior, batch.permutations, batch.rng, batch.false_alarms)
    chance = batch.chance_of_step(test)
    if chance > batch.false_alarms:
        return
    places = [first + at for at in (test.begin, test.end) if first + at < stop]
    edges = [first, *places, stop]
    parts = [list(_steps(name, series, (a, b), None, batch)) for a, b in pairwise(edges)]
    for i, at in enumerate(places):
        begin = max((s.index for s in parts[i]), default=edges[i])
        end = min((s.index for s in parts[i + 1]), default=edges[i + 2])
        yield from parts[i]
        yield ParameterStep(
            *name, float(series.time[at - 1]), float(series.time[at]),
            float(np.median(series.value[begin:at])), float(np.median(series.value[at:end])), chance, at,
        )  # fmt: skip
    yield from parts[-1]


def _chance(seen: FloatArray, by_chance: FloatArray) -> float:
    """Probability of at least the evidence (1,) that was seen, from the evidence (m,) of permutations.

    Beyond the `TAIL_SHARE` largest ones, the probability falls exponentially with the evidence, as that of a logarithm
    of a likelihood ratio.
    """
    ordered = np.sort(by_chance)[::-1]
    count = max(1, int(TAIL_SHARE * len(ordered)))
    edge = ordered[count]
    if seen[0] <= edge:
        return float(np.mean(ordered >= seen[0]))
    fall = max(float(np.mean(ordered[:count] - edge)), 1e-300)
    return float(count / len(ordered) * np.exp(-(seen[0] - edge) / fall))


def _chance_of_any(chance: float, count: int) -> float:
    """Probability of at least one of `count` independent events of the same probability (Sidak 1967)."""
    return float(-np.expm1(count * np.log1p(-min(chance, 1.0 - 1e-12))))
