"""Spikes and saturated readings are found, and nothing else is."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from armdyn.faults import at_the_end, spikes, without_saturation, without_spikes
from armdyn.identify.noise import white_noise_std
from armdyn.run import Channel, Run

TIME = np.arange(1500) / 100
SIGNAL = 0.8 + 0.1 * np.cos(10 * TIME)


def noisy(seed):
    return SIGNAL + 3e-3 * np.random.default_rng(seed).normal(size=len(TIME))


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 1000), st.integers(0, 1499), st.sampled_from([-0.3, 0.3, 0.8]))
def test_a_spike_is_found_wherever_it_is(seed, at, height):
    value = noisy(seed)
    value[at] += height
    expected = np.zeros(len(value), dtype=bool)
    expected[at] = True
    assert np.array_equal(spikes(TIME, value), expected)


def test_of_white_noise_nothing_is_a_spike():
    assert not any(spikes(TIME, noisy(seed)).any() for seed in range(40))


def test_two_spikes_side_by_side_are_found():
    value = noisy(0)
    value[[700, 701]] += 0.9
    assert np.flatnonzero(spikes(TIME, value)).tolist() == [700, 701]


def test_a_load_that_hits_something_is_no_spike():
    value = noisy(0)
    value[700:712] += 0.3 * np.exp(-np.arange(12) / 4) * np.cos(2.0 * np.arange(12))
    assert not spikes(TIME, value).any()


def test_readings_at_the_end_of_the_range_are_found():
    value = np.minimum(noisy(0), 0.85)
    assert np.array_equal(at_the_end(value), value == 0.85)


@pytest.mark.parametrize("quantum", [0.02, 0.01, 1e-3])
def test_a_coarsely_rounded_swing_is_not_at_the_end_of_its_range(quantum):
    assert not at_the_end(quantum * np.round(noisy(0) / quantum)).any()


def test_left_out_samples_are_counted_in_the_warnings():
    value = np.minimum(noisy(0), 0.85)
    value[660] -= 0.3
    run = Run("a.csv", {"load_force": Channel(TIME, value, "N")})
    clean = without_spikes(without_saturation(run, ["load_force"]), ["load_force"])
    assert len(clean.warnings) == 2
    assert "1 sample far from its neighbours left out, at 6.6 s" in clean.warnings[1]
    assert TIME[660] not in clean.channels["load_force"].time


@pytest.mark.parametrize(("rate", "jitter"), [(100.0, 0.0), (100.0, 0.4), (20.0, 0.0)])
def test_the_noise_is_measured_at_uneven_stamps_and_low_rates(rate, jitter):
    rng = np.random.default_rng(1)
    time = np.arange(0.0, 30.0, 1 / rate)
    time = time + jitter / rate * rng.uniform(-0.5, 0.5, len(time))
    value = np.cos(2 * np.pi * 1.2 * time) + 0.01 * rng.normal(size=len(time))
    assert white_noise_std(time, value) == pytest.approx(0.01, rel=0.2)
