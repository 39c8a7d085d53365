"""Which streams of forces or counts cannot be relied on, whatever sends them."""

import math

import numpy as np
import pytest

from armdyn.pendulum.physics import STANDARD_GRAVITY
from pipeline.loadcell.cell import count_fault_limits
from pipeline.loadcell.emulator import swinging_load
from pipeline.loadcell.faults import (
    LoadCellFault,
    LoadCellFaultDetector,
    LoadCellFaultEvent,
    LoadCellFaultLimits,
    implausible_repeats,
)
from pipeline.robot.protocol import ForceSample

from .cells import calibration

NOISY = LoadCellFaultLimits.from_noise(0.005, 5e-4, -9.8, 9.8)


def stream(forces, start=0.0, period=0.01):
    return [ForceSample(start + k * period, force) for k, force in enumerate(forces)]


@pytest.mark.parametrize(("noise", "step"), [(0.005, 5e-4), (0.0, 0.0)])
def test_a_cell_in_its_range_has_no_fault_noisy_or_without_any_noise(noise, step):
    forces = np.random.default_rng(0).normal(0.78, noise, 20_000)
    detector = LoadCellFaultDetector(LoadCellFaultLimits.from_noise(noise, step, -9.8, 9.8))
    assert detector.update(199.99, stream(step * np.round(forces / step) if step else forces)) is None
    assert detector.take_events() == []


def test_identical_values_are_a_frozen_cell_until_they_change():
    detector = LoadCellFaultDetector(LoadCellFaultLimits(repeats=5))
    assert detector.update(0.03, stream([1.0] * 4)) is None
    assert detector.update(0.05, stream([1.0] * 2, 0.04)) is LoadCellFault.FROZEN
    assert detector.update(0.06, stream([1.01], 0.06)) is None
    assert detector.take_events() == [
        LoadCellFaultEvent(0.04, LoadCellFault.FROZEN),
        LoadCellFaultEvent(0.06, LoadCellFault.FROZEN, began=False),
    ]
    assert detector.take_events() == []


@pytest.mark.parametrize("force", [9.8, -9.8, 12.0, math.inf, math.nan])
def test_a_force_at_the_end_of_the_range_is_saturated(force):
    detector = LoadCellFaultDetector(NOISY)
    assert detector.update(0.0, stream([force])) is LoadCellFault.SATURATED
    assert detector.update(0.01, stream([9.7], 0.01)) is None


def test_silence_begins_after_its_time_and_ends_with_a_sample():
    detector = LoadCellFaultDetector(LoadCellFaultLimits(silent_after=0.2))
    assert detector.update(1.0, stream([0.5], 1.0)) is None
    assert [detector.check(now) for now in (1.199, 1.201)] == [None, LoadCellFault.SILENT]
    assert detector.active == (LoadCellFault.SILENT,)
    assert detector.update(1.3, stream([0.6], 1.3)) is None
    # A gap between samples that come together is told as well.
    detector.update(2.5, stream([0.6], 2.0) + stream([0.7], 2.5))
    assert [event.began for event in detector.take_events()] == [True, False] * 3


def test_a_cell_that_never_speaks_is_silent_once_its_start_up_is_over_which_is_granted_once():
    limits = LoadCellFaultLimits(silent_after=0.2, start_up_seconds=2.0)
    detector = LoadCellFaultDetector(limits)
    assert [detector.check(now) for now in (10.0, 12.1, 12.3)] == [None, None, LoadCellFault.SILENT]
    detector = LoadCellFaultDetector(limits)
    detector.update(0.0, stream([0.5]))
    assert detector.check(0.5) is LoadCellFault.SILENT


def test_the_gravest_fault_comes_first():
    detector = LoadCellFaultDetector(LoadCellFaultLimits(-1.0, 1.0, repeats=3))
    detector.update(0.02, stream([1.0] * 3))
    assert detector.active == (LoadCellFault.SATURATED, LoadCellFault.FROZEN)
    assert detector.check(5.0) is LoadCellFault.SILENT


@pytest.mark.parametrize("ratio", [0.3, 1.0])
def test_working_cells_repeat_themselves_as_rarely_as_stated(ratio):
    """Noise of `ratio` steps of the converter around the middle of a step, where repeats are likeliest."""
    allowed = 1e-4
    repeats = implausible_repeats(ratio, 1.0, allowed)
    values = np.round(np.random.default_rng(1).normal(0.0, ratio, 1_000_000))
    same = np.concatenate([[False], values[1:] == values[:-1]])
    run = np.convolve(same, np.ones(repeats - 1), "valid") > repeats - 1.5
    assert 0 < run.mean() < 1.2 * allowed


# A cell that still sends numbers, but not the force: what a person who looks at the numbers would notice.
RATE, SCALE, NOISE, OFFSET = 80.0, 5.6e-6, 40.0, 84213.0
SWING = swinging_load(mass=0.08, length=0.368, amplitude=0.3, gravity=STANDARD_GRAVITY)
REST = 0.08 * STANDARD_GRAVITY
SPIKE = 39.0 / SCALE


def test_a_swinging_load_pulls_most_at_the_lowest_point_and_its_weights_share_where_it_turns_round():
    quarter = np.pi / 2 * np.sqrt(0.368 / STANDARD_GRAVITY)
    speed_squared = STANDARD_GRAVITY * 0.368 * 0.3**2  # of small swings, m^2/s^2
    assert SWING(0.0) == SWING(2 * quarter) == pytest.approx(REST * np.cos(0.3))
    assert SWING(quarter) == SWING(3 * quarter) == pytest.approx(REST + 0.08 * speed_squared / 0.368)


def counts_of(force, seconds, seed=0, scale=SCALE):
    """Times and counts of a cell that is pulled by force(t)."""
    rng, time = np.random.default_rng(seed), np.arange(0.0, seconds, 1.0 / RATE)
    pull = np.array([force(t) for t in time])
    return time, np.round(OFFSET + pull / scale + NOISE * rng.standard_normal(time.size))


def judged(time, counts, scale=SCALE):
    """The detector after all of it."""
    detector = LoadCellFaultDetector(count_fault_limits(calibration(OFFSET, scale, NOISE * abs(scale))))
    for t, count in zip(time, counts, strict=True):
        detector.add_sample(float(t), int(count))
    return detector


def weights_by_hand(t):
    """Hung on and taken off every 3 s, with a jerk."""
    return REST * (int(t / 3.0) % 2) * (1.0 + 0.5 * np.exp(-8.0 * (t % 3.0)) * np.cos(40.0 * t))


@pytest.mark.parametrize("scale", [SCALE, -SCALE])
@pytest.mark.parametrize("force", [SWING, lambda _t: 0.0, lambda _t: REST, weights_by_hand])
def test_a_healthy_cell_is_reliable_for_two_minutes(force, scale):
    assert judged(*counts_of(force, 120.0, scale=scale), scale).take_events() == []


@pytest.mark.parametrize(("force", "seed"), [(SWING, 0), (lambda _t: REST, 1)])
def test_spikes_in_one_of_twenty_samples_are_noticed(force, seed):
    time, counts = counts_of(force, 5.0, seed)
    spikes = np.random.default_rng(seed).random(time.size) < 0.05
    assert judged(time, np.where(spikes, OFFSET + SPIKE, counts)).active == (LoadCellFault.SPIKES,)


@pytest.mark.parametrize(("where", "told"), [(slice(200, 201), []), (slice(100, 160, 8), [True, False])])
def test_one_spike_is_bridged_and_many_are_over_when_they_have_ended(where, told):
    time, counts = counts_of(SWING, 10.0)
    counts[where] += SPIKE
    detector = judged(time, counts)
    assert detector.active == ()
    assert [(event.fault, event.began) for event in detector.take_events()] == [(LoadCellFault.SPIKES, b) for b in told]


def test_values_that_are_stuck_within_one_count_are_frozen():
    time, _ = counts_of(SWING, 3.0)
    toggling = 200_000 + np.random.default_rng(0).integers(0, 2, time.size)
    assert judged(time, toggling).active == (LoadCellFault.FROZEN,)
    assert judged(time, 200_000 + np.arange(time.size) // 2).active == ()  # goes on, slowly


STEP = 1e-3 * 2**24 + 10.0 * NOISE
"""Counts: a thousandth of the converter's range, and ten standard deviations."""


@pytest.mark.parametrize("scale", [SCALE, -SCALE])
@pytest.mark.parametrize("share", [0.98, 1.02])
def test_a_force_that_is_no_pull_a_drift_and_a_spike_are_told_from_where_they_begin(scale, share):
    """0.1 N of push for ten samples, 0.1 N/s over five blocks of half a second, three steps of a spike."""
    time = np.arange(0.0, 2.7, 1.0 / RATE)
    pushed, drifted = (OFFSET + force / scale for force in (np.full(11, -0.1 * share), 1.0 + 0.1 * share * time))
    spiky = np.full(50, OFFSET + 1.0 / scale) + np.arange(50)
    spiky[10:34:8] += share * STEP
    beyond = share > 1.0
    for stamps, counts, fault in (
        (time[:9], pushed[:9], None), (time[:10], pushed[:10], LoadCellFault.NEGATIVE),
        (time, drifted, LoadCellFault.DRIFTING), (time[time < 2.4], drifted[time < 2.4], None),
        (time[:50], spiky, LoadCellFault.SPIKES), (time[:26], spiky[:26], None),
    ):  # fmt: skip
        wiggled = counts + 3.0 * (np.arange(len(counts)) % 2)  # a cell that stands still is frozen
        assert judged(stamps, np.round(wiggled), scale).active == ((fault,) if fault and beyond else ())
