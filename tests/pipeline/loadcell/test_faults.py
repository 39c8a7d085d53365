import math

import numpy as np
import pytest

from pipeline.loadcell.faults import Fault, FaultDetector, FaultEvent, FaultLimits, implausible_repeats
from pipeline.robot.devices import SimulatedCell
from pipeline.robot.hidden import HIDDEN_EFFECTS
from pipeline.robot.protocol import ForceSample
from pipeline.robot.settings import CellSettings


def stream(forces, start=0.0, period=0.01):
    return [ForceSample(start + k * period, force) for k, force in enumerate(forces)]


def test_a_noisy_cell_in_its_range_has_no_fault():
    noise = np.random.default_rng(0).normal(0.78, 0.005, 100_000)
    forces = 5e-4 * np.round(noise / 5e-4)
    detector = FaultDetector(FaultLimits.of(0.005, 5e-4, -9.8, 9.8))
    assert detector.update(999.99, stream(forces)) is None
    assert detector.take_events() == []


def test_identical_values_are_a_frozen_cell_until_they_change():
    detector = FaultDetector(FaultLimits(repeats=5))
    assert detector.update(0.03, stream([1.0] * 4)) is None
    assert detector.update(0.04, stream([1.0], 0.04)) is Fault.FROZEN
    assert detector.update(0.05, stream([1.0], 0.05)) is Fault.FROZEN
    assert detector.update(0.06, stream([1.01], 0.06)) is None
    assert detector.take_events() == [
        FaultEvent(0.04, Fault.FROZEN, began=True),
        FaultEvent(0.06, Fault.FROZEN, began=False),
    ]
    assert detector.take_events() == []


@pytest.mark.parametrize("force", [9.8, -9.8, 12.0, math.inf, math.nan])
def test_a_force_at_the_end_of_the_range_is_saturated(force):
    detector = FaultDetector(FaultLimits.of(0.005, 5e-4, -9.8, 9.8))
    assert detector.update(0.0, stream([force])) is Fault.SATURATED
    assert detector.update(0.01, stream([9.7], 0.01)) is None


def test_silence_begins_after_its_time_and_ends_with_a_sample():
    detector = FaultDetector(FaultLimits(silent_after=0.2))
    assert detector.update(1.0, stream([0.5], 1.0)) is None
    assert detector.update(1.199, []) is None
    assert detector.update(1.201, []) is Fault.SILENT
    assert detector.active == (Fault.SILENT,)
    assert detector.update(1.3, stream([0.6], 1.3)) is None


def test_a_cell_that_never_speaks_is_silent_once_its_start_up_is_over():
    detector = FaultDetector(FaultLimits(silent_after=0.2, start_up=2.0))
    assert detector.check(10.0) is None
    assert detector.check(12.1) is None
    assert detector.check(12.3) is Fault.SILENT


def test_the_start_up_is_granted_once():
    detector = FaultDetector(FaultLimits(silent_after=0.2, start_up=2.0))
    detector.update(0.0, stream([0.5]))
    assert detector.check(0.5) is Fault.SILENT


def test_a_gap_between_samples_that_come_together_is_told():
    detector = FaultDetector(FaultLimits(silent_after=0.2))
    detector.update(1.0, [ForceSample(0.0, 0.5), ForceSample(0.9, 0.6), ForceSample(1.0, 0.7)])
    events = [(event.fault, event.began) for event in detector.take_events()]
    assert events == [(Fault.SILENT, True), (Fault.SILENT, False)]


def test_the_gravest_fault_comes_first():
    detector = FaultDetector(FaultLimits(-1.0, 1.0, repeats=3))
    detector.update(0.02, stream([1.0] * 3))
    assert detector.active == (Fault.SATURATED, Fault.FROZEN)
    assert detector.check(5.0) is Fault.SILENT


def test_every_fault_says_what_to_do_in_one_line():
    for fault in Fault:
        assert ": " in fault.value
        assert "\n" not in fault.value
    assert [fault for fault in Fault if fault.lasts] == list(Fault)[:7]


@pytest.mark.parametrize("ratio", [0.3, 0.5, 1.0])
def test_working_cells_repeat_themselves_as_rarely_as_stated(ratio):
    """Noise of `ratio` steps of the converter around the middle of a step, where repeats are likeliest."""
    rng = np.random.default_rng(1)
    allowed = 1e-4
    repeats = implausible_repeats(ratio, 1.0, allowed)
    values = np.round(rng.normal(0.0, ratio, 3_000_000))
    same = np.concatenate([[False], values[1:] == values[:-1]])
    run = np.convolve(same, np.ones(repeats - 1), "valid") > repeats - 1.5
    assert 0 < run.mean() < 1.2 * allowed


def test_a_cell_without_noise_may_stand_still():
    detector = FaultDetector(FaultLimits.of(0.0, 0.0, -9.8, 9.8))
    assert detector.update(99.99, stream([0.78] * 10_000)) is None


@pytest.mark.parametrize(
    ("spoil", "expected", "within"),
    [
        (lambda _sample, _last: [], Fault.SILENT, 0.25),
        (lambda sample, last: [ForceSample(sample.time, last)], Fault.FROZEN, 0.15),
        (lambda sample, _last: [ForceSample(sample.time, 9.80665)], Fault.SATURATED, 0.05),
    ],
)
def test_the_same_detector_finds_the_faults_of_the_simulated_cell(spoil, expected, within):
    settings, rng = CellSettings(), np.random.default_rng(2)
    cell = SimulatedCell(settings, dict.fromkeys(HIDDEN_EFFECTS, 0.0), 0.01, 0.013, rng)
    detector = FaultDetector(
        FaultLimits.of(settings.noise, settings.resolution, -settings.full_scale, settings.full_scale)
    )
    found, last = None, 0.0
    for step in range(3000):
        cell.feel(step, 0.785 + 0.05 * math.sin(0.01 * step), 0.0)
        samples = cell.received(step * 0.001)
        if step >= 2000:
            samples = [each for sample in samples for each in spoil(sample, last)]
        elif samples:
            last = samples[-1].force
        fault = detector.update(step * 0.001, samples)
        if fault is not None:
            found = (fault, step * 0.001)
            break
    assert found is not None
    assert found[0] is expected
    assert 2.0 <= found[1] < 2.0 + 0.013 + within
