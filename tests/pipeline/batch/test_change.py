"""A change is found on its day; what is slow, odd or merely noisy is none; alarms are as rare as stated."""

import numpy as np
import pytest
from scipy.stats import norm
from scipy.stats import t as student

from pipeline.batch.change import find_changes
from pipeline.batch.series import ChangeTestSeries, ParameterSeries

DAY = 86400.0
DAYS = DAY * np.arange(40)


def noise(seed, count=40):
    return np.random.default_rng(seed).standard_normal(count)


def found(value, time=DAYS, std=None):
    return find_changes({("robot", "mass"): ParameterSeries(time, value, std)}, batches=1000)


@pytest.mark.parametrize("day", [4, 13, 20, 36])
def test_a_step_is_found_on_its_day(day):
    (step,) = found(5.0 + 0.1 * noise(1) + 1.0 * (day * DAY <= DAYS)).steps
    assert (step.last_before, step.first_after) == ((day - 1) * DAY, day * DAY)
    assert (step.before, step.after) == (pytest.approx(5.0, abs=0.1), pytest.approx(6.0, abs=0.1))
    assert step.chance <= 0.01


def test_a_step_counts_as_much_whatever_its_direction_and_unit():
    value = 0.1 * noise(2) + (DAYS >= 15 * DAY)
    (up,), (down,) = found(value).steps, found(-1e6 * value).steps
    assert (up.index, up.chance) == (down.index, down.chance)


def test_wear_is_a_drift_and_no_step():
    result = found(0.1 * noise(4) + DAYS / DAYS[-1])
    assert result.steps == ()
    (drift,) = result.drifts
    assert drift.slope == pytest.approx(1.0 / DAYS[-1], rel=0.2)


ODD = np.where(np.isin(np.arange(40), [5, 6, 30]), 50.0, 0.1 * noise(7))
POOR = np.where(DAYS < 20 * DAY, 0.05, 2.0)
STEPS = {
    "a tool that comes and goes": (0.1 * noise(3) + ((DAYS >= 12 * DAY) & (DAYS < 26 * DAY)), None, [12, 26]),
    "wear that slows down": (0.05 * noise(5) + np.exp(-DAYS / (10 * DAY)), None, []),
    "a step beside wear": (0.1 * noise(6) + 2.0 * DAYS / DAYS[-1] + (DAYS >= 18 * DAY), None, [18]),
    "odd recordings": (ODD, None, []),
    "a step among odd recordings": (ODD + (DAYS >= 20 * DAY), None, [20]),
    "poor recordings": (POOR * noise(8), POOR, []),
}


@pytest.mark.parametrize(("value", "std", "steps"), STEPS.values(), ids=STEPS)
def test_steps_are_told_from_what_is_slow_or_odd(value, std, steps):
    assert sorted(step.index for step in found(value, DAYS, std).steps) == steps


def test_recordings_of_one_day_are_not_torn_apart():
    time = DAY * (np.arange(40) // 4)
    (step,) = found(0.1 * noise(9) + (np.arange(40) >= 20), time).steps
    assert (step.last_before, step.first_after) == (4 * DAY, 5 * DAY)


UNTESTED = {
    "too short": (noise(1, 9), DAYS[:9]), "all the same": (np.full(40, 3.0), DAYS), "all zero": (np.zeros(40), DAYS),
    "at a single time": (noise(1), np.zeros(40)),
}  # fmt: skip


@pytest.mark.parametrize(("value", "time"), UNTESTED.values(), ids=UNTESTED)
def test_what_cannot_be_tested_is_counted_and_left(value, time):
    result = found(value, time)
    assert (result.tested, result.untested_series_count, result.steps) == (0, 1, ())


def batch(seed, phi):
    """Eight robots with three parameters that follow the weather together."""
    rng, series = np.random.default_rng(seed), {}
    for robot in range(8):
        weather = rng.standard_normal((4, 30))
        for k in range(1, 30):
            weather[:, k] = phi * weather[:, k - 1] + np.sqrt(1.0 - phi**2) * weather[:, k]
        for parameter in range(3):
            value = 0.6 * weather[3] + 0.8 * weather[parameter]
            series[f"robot {robot}", f"p{parameter}"] = ParameterSeries(DAYS[:30], value)
    return series


@pytest.mark.parametrize("phi", [0.0, pytest.param(0.4, marks=pytest.mark.slow)])
def test_alarms_are_as_rare_as_stated(phi):
    """With a stated rate of 20 % over 20 batches, 4 are expected; 11 and more would come once in 1,700."""
    alarms = sum(bool(find_changes(batch(seed, phi), 0.2, batches=100).steps) for seed in range(20))
    assert alarms < 11


@pytest.mark.parametrize("phi", [0.0, 0.5])
def test_the_best_step_is_that_of_a_regression(phi):
    """Every step beside a line, weighted and with what neighbours share taken out, by plain least squares."""
    rng, count = np.random.default_rng(0), 20
    time, std = np.cumsum(rng.uniform(0.5, 2.0, count)), rng.uniform(0.5, 2.0, count)
    test = ChangeTestSeries.from_series(
        ParameterSeries(time, rng.standard_normal(count) + 2.0 * (np.arange(count) > 9), std), phi
    )
    own = np.eye(count) - phi * np.eye(count, k=-1)
    own[0, 0] = np.sqrt(1.0 - phi**2)
    sizes = []
    for split in test.splits:
        columns = own @ (test.weight[:, None] * np.column_stack([np.ones(count), time, np.arange(count) >= split]))
        found = np.linalg.lstsq(columns, test.scores, rcond=None)[0]
        left = test.scores - columns @ found
        variance = left @ left / (count - 3) * np.linalg.inv(columns.T @ columns)[2, 2]
        sizes.append(abs(found[2]) / np.sqrt(variance))
    (deviate,), (best,), _ = test.best_step(test.scores[None])
    assert best == np.argmax(sizes)
    exact = -norm.ppf(student.sf(max(sizes), count - 3))
    assert deviate == pytest.approx(exact, rel=5e-3)
