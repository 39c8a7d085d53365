"""The law of false alarms: on Gaussian errors, whose truth is known, and by how much it is told."""

import numpy as np
import pytest
from scipy.stats import chi

from armdyn.watch.tail import ExponentialTail, GaussianDistribution, block_maxima


@pytest.mark.parametrize("count", [10, 40, 400])
def test_the_threshold_is_exceeded_no_more_often_than_was_asked(count):
    """Once in a thousand stretches of 50 values each; over 2000 calibrations."""
    rng = np.random.default_rng(0)
    rates = []
    for _ in range(2000):
        seen = np.abs(rng.standard_normal((count, 50))).max(axis=1)
        threshold = ExponentialTail.of(seen, 3600.0, 2).threshold(1e-3)
        rates.append(1.0 - (1.0 - chi(1).sf(threshold)) ** 50)
    assert np.mean(rates) < 1e-3


def test_short_recordings_ask_for_a_higher_threshold():
    rng = np.random.default_rng(1)
    thresholds = [
        np.median(
            [
                ExponentialTail.of(np.abs(rng.standard_normal((n, 50))).max(axis=1), 2.0, 2).threshold(0.01)
                for _ in range(50)
            ]
        )
        for n in (8, 30, 300)
    ]
    assert thresholds[0] > 1.3 * thresholds[1] > 1.1 * thresholds[2]


def test_fewer_false_alarms_need_a_higher_threshold():
    law = ExponentialTail.of(np.linspace(2.0, 4.0, 30), 2.0, 1)
    assert law.threshold(0.001) > law.threshold(0.01) > law.threshold(1.0)


def test_a_gaussian_band_is_exceeded_as_often_as_a_gaussian():
    assert GaussianDistribution(1000.0).threshold(45.5) == pytest.approx(2.0, abs=0.001)
    assert GaussianDistribution(1000.0, 4).threshold(50.0) == pytest.approx(np.sqrt(9.488), abs=0.001)


def test_the_largest_of_stretches_leave_out_what_is_left_over():
    np.testing.assert_array_equal(block_maxima(np.array([[1.0], [5.0], [2.0], [3.0], [9.0]]), 2), [[5.0], [3.0]])
