"""What is said of a sample: nothing without a cause, a torque from outside in time, and no gap as an event."""

import numpy as np
import pytest
from watch_work import FRICTION, RATE, samples, work

from armdyn.arm.rigid import inverse_dynamics
from armdyn.watch import observer as observing
from armdyn.watch.coverage import Skipped
from armdyn.watch.observer import Observer, visible_share_of_step


def steps(arm, recording, bandwidth=40.0):
    observer = Observer(arm, bandwidth)
    found = [observer.process_sample(*sample) for sample in samples(recording)]
    return [step for step in found if not isinstance(step, Skipped) and step.settled]


@pytest.fixture
def quiet(monkeypatch):
    monkeypatch.setattr("watch_work.NOISE", 0.0)


@pytest.mark.usefixtures("quiet")
def test_what_the_model_explains_leaves_nothing_even_where_joints_turn_round(arm):
    contrast = np.array([step.contrast for step in steps(arm, work(arm, 0, 20.0))])
    assert np.sqrt(np.mean(contrast**2)) < 0.06  # white noise of 0.05 N m, what is left of it, and of turns
    assert np.abs(contrast).max() < 0.25 * FRICTION


@pytest.mark.usefixtures("quiet")
def test_a_torque_from_outside_arrives_as_fast_as_the_filter_is(arm):
    found = steps(arm, work(arm, 0, 12.0, begin=8.0, outside=np.array([0, 0, 5.0, 0, 0, 0])))
    time = np.array([step.time for step in found])
    contrast = np.array([step.contrast for step in found])
    after = contrast[np.argmin(np.abs(time - 8.0 - observing.MAX_DETECTION_SECONDS))]
    assert after[2] == pytest.approx(5.0 * visible_share_of_step(40.0), abs=0.3)
    assert np.abs(np.delete(after, 2)).max() < 0.4


def test_filtered_motion_is_that_of_the_delay_before(arm):
    time = np.arange(0, 4, 1 / RATE)
    q = 0.5 * np.sin(2.0 * time)[:, None] * np.ones(6)
    last = steps(arm, (time, q, np.zeros_like(q)))[-1]
    at = last.time - Observer(arm, 40.0).delay
    expected = 0.5 * np.array([np.sin(2 * at), 2 * np.cos(2 * at), -4 * np.sin(2 * at)])
    np.testing.assert_allclose(last.motion[:, 0], expected, atol=0.01)


def test_samples_that_come_rarely_make_the_filter_slower(arm):
    observer = Observer(arm, 75.0)
    for i in range(60):
        observer.process_sample(0.04 * i, np.zeros(6), np.zeros(6))
    assert observer.bandwidth == pytest.approx(observing.MAX_BANDWIDTH_TIMES_INTERVAL / 0.04)


def test_a_sample_that_cannot_be_used_is_skipped_with_its_reason(arm):
    observer, q, gone = Observer(arm), np.zeros(6), np.full(6, np.nan)
    assert not isinstance(observer.process_sample(0.0, q, q), Skipped)
    for sample, reason in (
        ((0.01, gone, q), Skipped.NO_POSITION),
        ((0.01, q, gone), Skipped.NO_TORQUE),
        ((0.01, gone, gone), Skipped.NO_VALUE),
        ((np.nan, q, q), Skipped.NO_TIME),
        ((0.0, q, q), Skipped.NOT_LATER),
        ((-0.01, q, q), Skipped.NOT_LATER),
        ((0.01, q, q + 1e200), Skipped.IMPOSSIBLE),
    ):
        assert observer.process_sample(*sample) is reason


@pytest.mark.parametrize("jump", [1.0, -1.0, 1e9])
def test_after_a_gap_or_a_jump_of_the_clock_the_filters_begin_anew(arm, jump):
    observer = Observer(arm, 40.0)
    for i in range(500):
        step = observer.process_sample(0.004 * i, np.zeros(6), np.zeros(6))
    assert step.settled
    assert not observer.process_sample(0.004 * 500 + jump, np.zeros(6), np.zeros(6)).settled


@pytest.mark.usefixtures("quiet")
def test_the_mean_waits_while_something_acts(arm):
    observer = Observer(arm, 40.0)
    for time, q, tau in samples(work(arm, 0, 10.0, begin=5.0, outside=np.array([0, 0, 5.0, 0, 0, 0]))):
        observer.mean_is_held = time >= 5.0
        step = observer.process_sample(time, q, tau)
    assert step.contrast[2] == pytest.approx(5.0, abs=0.4)


def test_a_joint_that_sticks_leaves_no_error_when_it_moves_on(arm):
    """It stands for two seconds, where its friction holds 0.9 of what it can, and then goes back."""
    joint, time = 1, np.arange(0.0, 8.0, 1.0 / RATE)
    speed = 0.4 * (np.clip(time, 0.0, 1.0) - np.clip(time - 2.0, 0.0, 1.0) - np.clip(time - 5.0, 0.0, 1.0))
    v = np.outer(speed, np.eye(6)[joint])
    a = np.gradient(v, 1.0 / RATE, axis=0)
    q = np.array([0.0, -1.2, 1.2, 0.0, 0.5, 0.0]) + np.cumsum(v, axis=0) / RATE
    held = np.where(np.abs(speed) > 1e-9, np.sign(speed), 0.9)
    tau = inverse_dynamics(arm.arm.model, q, v, a) + FRICTION * np.outer(held, np.eye(6)[joint])
    found = steps(arm, (time, q, tau), 75.0)
    moving = [step for step in found if abs(step.motion[1][joint]) > 0.05]
    assert {np.sign(step.motion[1][joint]) for step in moving} == {1.0, -1.0}
    assert max(abs(step.contrast[joint]) - step.sticking[joint] for step in moving) < 0.1
    stuck = [step for step in found if 3.5 < step.time < 4.9]
    assert min(step.contrast[joint] for step in stuck) > 0.85 * FRICTION
    assert all(abs(step.contrast[joint]) <= step.sticking[joint] for step in stuck)
