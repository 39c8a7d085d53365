"""Spikes and saturated readings are found, and nothing else is."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from armdyn.recording.noise import white_noise_std
from armdyn.recording.spikes import saturated_samples, spikes, without_saturation, without_spikes
from armdyn.run import Channel, Run

TIME = np.arange(1500) / 100
SIGNAL = 0.8 + 0.1 * np.cos(10 * TIME)


def noisy(seed):
    return SIGNAL + 3e-3 * np.random.default_rng(seed).normal(size=len(TIME))


@pytest.mark.parametrize("at", [0, 1499])
def test_a_spike_at_an_end_is_found_where_the_one_difference_that_sees_it_is_large(at):
    # The first and the last sample take part in one fourth difference, with the smallest weight.
    for seed in range(20):
        value = noisy(seed)
        value[at] += 0.6
        assert np.flatnonzero(spikes(TIME, value)).tolist() == [at]


@settings(max_examples=30)
@given(st.integers(0, 1000), st.integers(1, 1498), st.sampled_from([-0.3, 0.3, 0.8]))
def test_a_spike_is_found_wherever_it_is(seed, at, height):
    value = noisy(seed)
    value[at] += height
    expected = np.zeros(len(value), dtype=bool)
    expected[at] = True
    assert np.array_equal(spikes(TIME, value), expected)


def test_of_a_million_samples_of_white_noise_none_is_a_spike():
    assert not any(spikes(TIME, np.random.default_rng(seed).normal(size=len(TIME))).any() for seed in range(667))


@pytest.mark.parametrize("seed", range(20))
def test_one_sample_in_a_hundred_at_random_is_found_and_nothing_else(seed):
    rng = np.random.default_rng(seed)
    value, bad = noisy(seed), rng.random(len(TIME)) < 0.01
    value[bad] += rng.choice([-1.0, 1.0], bad.sum()) * 10 ** rng.uniform(-1, 1.7, bad.sum())
    found = spikes(TIME, value)
    assert not (found & ~bad).any()
    assert (bad & ~found).sum() <= 1


@pytest.mark.parametrize("width", [1e-6, 0.01, 0.05])
def test_a_friction_that_changes_sign_is_no_spike(width):
    turns = samples = 0
    for seed in range(20):
        rng = np.random.default_rng(seed)
        rate = np.sin(rng.uniform(1, 6) * TIME + rng.uniform(0, 6))
        value = np.tanh(rate / width) + rng.uniform(0, 5) * SIGNAL + 0.05 * rng.normal(size=len(TIME))
        turns += np.count_nonzero(np.diff(np.sign(rate)))
        samples += np.count_nonzero(spikes(TIME, value))
    assert samples <= 0.05 * turns


JUMPING = np.cumsum(np.cumsum(np.repeat(np.random.default_rng(0).choice([-0.8, 0.0, 0.8], 15), 100))) * 1e-4
HIT = noisy(0) + np.where(np.abs(np.arange(1500) - 705.5) < 6, 1.0, 0.0) * (
    0.3 * np.exp(-(np.arange(1500) - 700) / 4) * np.cos(2.0 * (np.arange(1500) - 700))
)
NO_SPIKES = {"a jump of acceleration": JUMPING, "the same in steps": 4e-4 * np.round(JUMPING / 4e-4), "a hit": HIT}


@pytest.mark.parametrize("value", NO_SPIKES.values(), ids=NO_SPIKES)
def test_what_moves_a_sensor_is_no_spike(value):
    assert not spikes(TIME, value).any()


def test_a_sensor_that_is_often_wrong_keeps_all_its_samples_and_a_warning_says_so():
    value = noisy(0)
    value[20::20] += 0.5
    clean = without_spikes(Run("a.csv", {"load_force": Channel(TIME, value, "N")}), ["load_force"])
    assert len(clean.channels["load_force"]) == len(TIME)
    assert "too many to be faults" in clean.warnings[0]
    assert not clean.outliers


def test_two_spikes_side_by_side_are_found():
    value = noisy(0)
    value[[700, 701]] += 0.9
    assert np.flatnonzero(spikes(TIME, value)).tolist() == [700, 701]


def test_readings_at_the_end_of_the_range_are_found():
    value = np.minimum(noisy(0), 0.85)
    assert np.array_equal(saturated_samples(value), value == 0.85)


@pytest.mark.parametrize("quantum", [0.02, 0.01, 1e-3])
def test_a_coarsely_rounded_swing_is_not_at_the_end_of_its_range(quantum):
    assert not saturated_samples(quantum * np.round(noisy(0) / quantum)).any()


def test_left_out_samples_are_counted_in_the_warnings():
    value = np.minimum(noisy(0), 0.85)
    value[660] -= 0.3
    run = Run("a.csv", {"load_force": Channel(TIME, value, "N")})
    clean = without_spikes(without_saturation(run, ["load_force"]), ["load_force"])
    assert len(clean.warnings) == 2
    assert "1 of 909 samples far from its neighbours left out, at 6.6 s" in clean.warnings[1]
    assert TIME[660] not in clean.channels["load_force"].time


@pytest.mark.parametrize(("rate", "jitter"), [(100.0, 0.0), (100.0, 0.4), (20.0, 0.0)])
def test_the_noise_is_measured_at_uneven_stamps_and_low_rates(rate, jitter):
    rng = np.random.default_rng(1)
    time = np.arange(0.0, 30.0, 1 / rate)
    time = time + jitter / rate * rng.uniform(-0.5, 0.5, len(time))
    value = np.cos(2 * np.pi * 1.2 * time) + 0.01 * rng.normal(size=len(time))
    assert white_noise_std(time, value) == pytest.approx(0.01, rel=0.2)
