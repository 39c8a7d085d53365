"""The day on which a parameter changed, in fits of many recordings: a test with a stated rate of false alarms.

A series is one parameter of one robot over time. It counts as changed where a step explains more of it than chance
would in any series of the whole batch. What is slow is no step: every step is judged beside a straight line, and must
stand beside a parabola or beside a line through its neighbours, too. A single odd recording is none either: a value
far from the median of its neighbours counts as that median. The test of one series is in `series.py`.
The bound is the quantile of the batch's largest deviate over simulated batches of such noise; it holds for the batch
also where the parameters of a robot are correlated, which only makes alarms rarer (Sidak 1967).
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from scipy.stats import theilslopes

from armdyn.identify.series import Series, StepTest, correlation
from armdyn.recording.channels import FloatArray

FALSE_ALARMS = 0.01
"""Probability that a batch in which nothing changes has an alarm."""
BATCHES = 4000
"""Simulated: the bound at 1 % is then the 40th largest, known within a sixth of that 1 %."""
NEARBY = 12
"""Recordings on either side that are neighbours of a step: what bends slowly is straight there, and what comes and goes
is a step there."""
MOST, LEAST_BATCHES = 50_000_000, 1000
"""Numbers that are simulated altogether, some ten seconds; beyond that fewer batches, so many that the bound at
1 % is the 10th largest."""

Name: TypeAlias = tuple[str, str]
"""Robot and parameter; of a joint's parameter ``"<quantity>[<joint>]"``."""


@dataclass(frozen=True)
class Step:
    """A parameter changed.

    Attributes:
        robot: whose.
        parameter: its name.
        last_before: time of the last recording with the old value, s.
        first_after: of the first with the new one, s.
        before: median until then, back to the step before.
        after: median from then on, up to the next step.
        chance: probability of an alarm as clear as this one anywhere in a batch where nothing changes; at least one
            over the number of simulated batches.
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
    """A parameter moves slowly.

    Attributes:
        robot: whose.
        parameter: its name.
        slope: per s (Theil and Sen).
        chance: as of a `Step`.
    """

    robot: str
    parameter: str
    slope: float
    chance: float


@dataclass(frozen=True)
class Found:
    """What the test says.

    Attributes:
        steps: the clearest first.
        drifts: of series without a step, the clearest first.
        tested: series that were long enough.
        too_short: series that were not, or never vary.
        false_alarms: probability of any step, and of any drift, in a batch where nothing changes.
    """

    steps: tuple[Step, ...]
    drifts: tuple[Drift, ...]
    tested: int
    too_short: int
    false_alarms: float


def find_changes(
    series: Mapping[Name, Series], false_alarms: float = FALSE_ALARMS, *, batches: int = BATCHES, seed: int = 0
) -> Found:
    """Steps and drifts of a batch.

    Args:
        series: by robot and parameter.
        false_alarms: probability of any step, and of any drift, in a batch where nothing changes.
        batches: simulated ones that give the bound.
        seed: of these.

    Returns:
        What was found; of one series several steps, if they are there.
    """
    rng = np.random.default_rng(seed)
    tests = {name: test for name, one in series.items() if (test := StepTest.of(one)) is not None}
    if not tests:
        return Found((), (), 0, len(series), false_alarms)
    kinds: dict[str, list[StepTest]] = {}
    for (_, parameter), test in tests.items():
        kinds.setdefault(_kind(parameter), []).append(test)
    phi = {kind: correlation(group, rng) for kind, group in kinds.items()}
    tests = {name: test for name in tests if (test := StepTest.of(series[name], phi[_kind(name[1])])) is not None}
    size = sum(len(test.time) for test in tests.values())
    batches = min(batches, max(LEAST_BATCHES, MOST // size))
    largest = np.zeros((2, batches))
    for test in tests.values():
        np.maximum(largest, test.by_chance(batches, rng), out=largest)
    for_steps, for_drifts = (_Judge.of(by_chance, false_alarms) for by_chance in largest)
    steps: list[Step] = []
    drifts: list[Drift] = []
    for name, test in tests.items():
        found = list(_steps(name, series[name], (0, len(test.time)), test.phi, for_steps))
        steps += found
        trend = float(test.trends(test.scores[None])[0])
        if not found and trend > for_drifts.bound:
            slope = float(theilslopes(test.value, test.time).slope)
            drifts.append(Drift(*name, slope, for_drifts.chance(trend)))
    return Found(
        tuple(sorted(steps, key=lambda s: (s.chance, s.first_after))),
        tuple(sorted(drifts, key=lambda d: d.chance)),
        len(tests),
        len(series) - len(tests),
        false_alarms,
    )


def _steps(name: Name, series: Series, part: tuple[int, int], phi: float, judge: "_Judge") -> Iterator[Step]:
    """Steps of a part of a series, each looked for between those that were found."""
    first, end = part
    test = StepTest.of(series.part(first, end), phi)
    if test is None:
        return
    deviates, best, _ = test.largest(test.scores[None])
    deviate = float(deviates[0])
    middle = first + int(test.splits[best[0]])
    nearby = StepTest.of(series.part(max(first, middle - NEARBY), min(end, middle + NEARBY)), phi)
    sharp = max(
        test.beside(int(best[0]), parabola=True),
        nearby.beside(int(np.argmin(np.abs(nearby.splits - min(middle - first, NEARBY)))), parabola=False)
        if nearby
        else 0.0,
    )
    if min(deviate, sharp) <= judge.bound:
        return
    earlier, later = (list(_steps(name, series, sides, phi, judge)) for sides in ((first, middle), (middle, end)))
    start = max((s.index for s in earlier), default=first)
    stop = min((s.index for s in later), default=end)
    yield from earlier
    yield Step(
        *name, float(series.time[middle - 1]), float(series.time[middle]),
        float(np.median(series.value[start:middle])), float(np.median(series.value[middle:stop])),
        judge.chance(deviate), middle,
    )  # fmt: skip
    yield from later


@dataclass(frozen=True)
class _Judge:
    """What is rare: the batch's largest deviates by chance, and the bound that they give."""

    by_chance: FloatArray
    bound: float

    @classmethod
    def of(cls, by_chance: FloatArray, false_alarms: float) -> "_Judge":
        return cls(by_chance, float(np.quantile(by_chance, 1.0 - false_alarms)))

    def chance(self, deviate: float) -> float:
        """Share of the batches with as large a deviate, at least one of them."""
        return max(float(np.mean(self.by_chance >= deviate)), 1.0 / len(self.by_chance))


def _kind(parameter: str) -> str:
    """The quantity, whatever the joint."""
    return parameter.partition("[")[0]
