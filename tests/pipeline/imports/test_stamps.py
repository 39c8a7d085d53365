"""A robot's clock that is set while a recording runs: with times of arrival it costs one sample at most."""

import numpy as np
import pytest

from pipeline.imports.stamps import samples_with_valid_stamps, without_rounding

PERIOD, COUNT = 0.01, 600


def stamped(rng, back, burst):
    """Times, stamps of a clock that is set back in the middle, and arrivals; messages come alone or in fives."""
    taken = PERIOD * np.arange(COUNT)
    stamps = 1000.0 + taken - back * (np.arange(COUNT) >= COUNT // 2)
    late = 4 * PERIOD * (np.arange(COUNT) % 5 == 0) if burst else rng.exponential(0.0005, COUNT)
    return taken, stamps, np.maximum.accumulate(taken + 0.001 + late)


@pytest.mark.parametrize("burst", [False, True])
@pytest.mark.parametrize("back", [0.003, 0.015, 0.05, 0.1, 0.3, 2.0, 100.0, -0.05, -2.0, -100.0])
def test_a_clock_that_is_set_costs_one_sample_at_most(back, burst):
    taken, stamps, arrivals = stamped(np.random.default_rng(0), back, burst)
    found = samples_with_valid_stamps(stamps, arrivals)
    assert len(found.rows) >= COUNT - 1
    assert (np.diff(found.time) > 0.0).all()
    if back > 2 * PERIOD or back < -1.0:  # what is less is no more than a message that was late
        assert len(found.steps) == 1
        since = found.time - found.time[0]
        np.testing.assert_allclose(since, taken[found.rows] - taken[found.rows[0]], atol=0.002)


@pytest.mark.parametrize("overtaken", [1, 3, 10, 20])
def test_messages_that_were_overtaken_are_no_clock_that_was_set(overtaken):
    _, stamps, arrivals = stamped(np.random.default_rng(1), 0.0, burst=False)
    arrivals[COUNT // 2 : COUNT // 2 + overtaken] += 2.5 * overtaken * PERIOD
    order = np.argsort(arrivals)
    found = samples_with_valid_stamps(stamps[order], arrivals[order])
    assert found.steps == ()
    assert len(found.rows) >= COUNT - overtaken


@pytest.mark.parametrize(("rate", "decimals"), [(30.0, 3), (59.94, 3), (29.97, 2), (240.0, 3)])
def test_rounded_stamps_of_a_camera_are_those_of_its_rate(rate, decimals):
    true = 5.0 + np.arange(2000) / rate
    found, step = without_rounding(np.round(true, decimals))
    assert step == pytest.approx(10.0**-decimals)
    assert np.abs(found - true).max() < 0.05 * step


def test_stamps_that_are_not_rounded_or_not_of_one_rate_stay_as_they_are():
    rng, even = np.random.default_rng(2), 0.01 * np.arange(2000)
    lost = np.delete(np.round(even, 2), 1000)
    for stamps in (even, lost, even + rng.normal(0.0, 1e-3, 2000), np.round(even + rng.normal(0.0, 1e-3, 2000), 3)):
        found, step = without_rounding(stamps)
        assert step == 0.0
        np.testing.assert_array_equal(found, stamps)
