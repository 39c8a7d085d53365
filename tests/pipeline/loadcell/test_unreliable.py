"""A cell that still sends numbers, but not the force: what a person who looks at the numbers would notice."""

from datetime import UTC, datetime

import numpy as np
import pytest

from armdyn.pendulum.composition import STANDARD_GRAVITY
from pipeline.loadcell.calibration import Calibration
from pipeline.loadcell.cell import count_limits
from pipeline.loadcell.emulator import swinging_load
from pipeline.loadcell.faults import Fault, FaultDetector

RATE, SCALE, NOISE, OFFSET = 80.0, 5.6e-6, 40.0, 84213.0
SWING = swinging_load(mass=0.08, length=0.368, amplitude=0.3, gravity=STANDARD_GRAVITY)
REST = 0.08 * STANDARD_GRAVITY


def calibration(scale=SCALE):
    return Calibration(OFFSET, 1.0, scale, 1e-10, NOISE * abs(scale), datetime(2026, 3, 2, tzinfo=UTC), "test")


def counts_of(force, seconds, seed=0, scale=SCALE, noise=NOISE):
    """Times and counts of a cell that is pulled by force(t)."""
    rng, time = np.random.default_rng(seed), np.arange(0.0, seconds, 1.0 / RATE)
    pull = np.array([force(t) for t in time])
    return time, np.round(OFFSET + pull / scale + noise * rng.standard_normal(time.size))


def judged(time, counts, scale=SCALE):
    """The detector after all of it."""
    detector = FaultDetector(count_limits(calibration(scale)))
    for t, count in zip(time, counts, strict=True):
        detector.sample(float(t), int(count))
    return detector


def weights_by_hand(t):
    """Hung on and taken off every 3 s, with a jerk."""
    return REST * (int(t / 3.0) % 2) * (1.0 + 0.5 * np.exp(-8.0 * (t % 3.0)) * np.cos(40.0 * t))


@pytest.mark.parametrize("scale", [SCALE, -SCALE])
@pytest.mark.parametrize("force", [SWING, lambda _t: 0.0, lambda _t: REST, weights_by_hand])
def test_a_healthy_cell_is_reliable_for_ten_minutes(force, scale):
    detector = judged(*counts_of(force, 600.0, scale=scale), scale)
    assert detector.take_events() == []


@pytest.mark.parametrize("force", [SWING, lambda _t: REST])
@pytest.mark.parametrize("seed", range(5))
def test_spikes_in_one_of_twenty_samples_are_noticed(force, seed):
    time, counts = counts_of(force, 5.0, seed)
    spikes = np.random.default_rng(seed).random(time.size) < 0.05
    assert judged(time, np.where(spikes, OFFSET + 39.0 / SCALE, counts)).active == (Fault.SPIKES,)


def test_one_spike_is_bridged():
    time, counts = counts_of(SWING, 5.0)
    counts[200] += 39.0 / SCALE
    assert judged(time, counts).take_events() == []


def test_spikes_that_have_ended_are_over():
    time, counts = counts_of(SWING, 10.0)
    counts[100:160:8] += 39.0 / SCALE
    detector = judged(time, counts)
    assert detector.active == ()
    assert [(event.fault, event.began) for event in detector.take_events()] == [
        (Fault.SPIKES, True), (Fault.SPIKES, False),
    ]  # fmt: skip


def test_values_that_are_stuck_within_one_count_are_frozen():
    time, _ = counts_of(SWING, 3.0)
    toggling = 200_000 + np.random.default_rng(0).integers(0, 2, time.size)
    assert judged(time, toggling).active == (Fault.FROZEN,)
    assert judged(time, 200_000 + np.arange(time.size) // 2).active == ()  # goes on, slowly


@pytest.mark.parametrize("scale", [SCALE, -SCALE])
def test_a_bridge_without_supply_reads_zero_volts_which_is_no_pull(scale):
    time = np.arange(0.0, 3.0, 1.0 / RATE)
    zero = np.random.default_rng(0).normal(0.0, NOISE, time.size)
    detector = judged(time, zero if scale > 0 else 2 * OFFSET - zero, scale)
    assert Fault.NEGATIVE in detector.active


@pytest.mark.parametrize("speed", [1.0, -1.0, 0.2])
@pytest.mark.parametrize("force", [SWING, lambda _t: REST])
def test_a_drift_is_noticed_while_it_lasts(force, speed):
    time, counts = counts_of(lambda t: force(t) + 5.0 + speed * t, 4.0)
    assert Fault.DRIFTING in judged(time, counts).active
