"""The onset: a step stands in the stages as the filters say, and smooth errors of any size do not hide it."""

import numpy as np
import pytest

from armdyn.watch.observer import Observer
from armdyn.watch.onset import ONSET_STEP_AGE_SECONDS, OnsetTorqueEstimator, smooth_responses, step_response


def stages(arm, tau, interval):
    observer = Observer(arm, 40.0)
    q = np.zeros(6)
    return [observer.process_sample(interval * i, q, torque * np.eye(6)[2]).stages for i, torque in enumerate(tau)]


@pytest.mark.parametrize("interval", [0.001, 0.002])
def test_a_step_stands_in_the_stages_as_the_onset_expects(arm, interval):
    before, after = round(0.5 / interval), round(ONSET_STEP_AGE_SECONDS / interval)
    found = stages(arm, np.repeat([0.0, 5.0], [before, after + 1]), interval)
    # Between samples a torque is straight, so that its step is half an interval early; a stage rises by 27 /s at most.
    early = 5.0 * 27.0 * interval / 2.0
    np.testing.assert_allclose((found[-1] - found[before - 1])[2], 5.0 * step_response(), atol=early)


def test_a_torque_that_began_is_told_without_bias_beside_smooth_errors(arm):
    """Sines of 20 N m below 1 Hz and white noise of 0.05 N m: behind one low-pass they would hide any contact."""
    time = np.arange(0.0, 60.0, 0.002)
    rng = np.random.default_rng(0)
    smooth = sum(20.0 * np.sin(rate * time + phase) for rate, phase in rng.uniform(0.2, 6.0, (4, 2)))
    seen = np.array(stages(arm, smooth + 0.05 * rng.standard_normal(len(time)), 0.002))[500:]
    sources, none = np.eye(4)[0] * np.ones((*seen.shape[:2], 1)), np.zeros(seen.shape[:2])
    onset = OnsetTorqueEstimator.of(40.0, seen[::10], sources[::10], none[::10], np.full(6, np.inf))
    held_out = np.array([onset.estimate(each)[2] for each in seen[5::10]])
    std = np.sqrt(onset.band.variance[2, 0])
    assert std < 0.1
    assert np.sqrt(np.mean(held_out**2)) == pytest.approx(std, rel=0.2)
    assert onset.estimate(seen[100] + 3.0 * step_response())[2] - onset.estimate(seen[100])[2] == pytest.approx(3.0)


def test_what_a_smooth_motion_leaves_in_the_stages_is_as_the_filters_say(arm):
    """Joint 1 turns about the vertical, so that its torque is its acceleration times a constant inertia."""
    now, interval, K = 2.0, 0.0005, 40.0
    time = np.arange(0.0, now, interval)
    ages, expected = 100.0 * (time - time[-1]), smooth_responses(K)
    for power, angle in enumerate((ages**2 / 2.0, ages**3 / 6.0, ages**4 / 12.0)):
        observer, first = Observer(arm.with_only_effects(()), K), np.eye(6)[0]
        torque = ages**power
        for stamp, q, tau in zip(time.tolist(), 1e-4 * angle / 100.0**2, torque, strict=True):
            found = observer.process_sample(stamp, q * first, tau * first)
        measured, predicted = found.stages[0, :8], found.stages[0, 8:]
        np.testing.assert_allclose(measured, expected[:8, power], rtol=0.01)
        inertia = predicted[0] / expected[8, power]
        np.testing.assert_allclose(predicted, inertia * expected[8:, power], rtol=0.01)
