"""Three kinds of event, told apart; silence on sound work, gaps and clocks that jump."""

import numpy as np
import pytest
from watch_work import RATE, samples, work

from armdyn.errors import InputError
from armdyn.watch.coverage import Skipped
from armdyn.watch.event import EventKind
from armdyn.watch.fault_free import statistics_of_model_error, statistics_of_recordings
from armdyn.watch.watch import Watch

CONTACT = np.array([2.0, 5.0, 1.0, 0.3, -0.8, 0.0])


def events(arm, sound, *recordings, per_hour=0.01):
    watch = Watch(arm, sound, per_hour)
    return [event for recording in recordings for event in watch.events_of(samples(recording))]


@pytest.mark.parametrize("seed", range(3))
def test_a_contact_is_one_from_outside_and_found_within_50_ms_and_so_is_its_end(arm, sound, seed):
    found = events(arm, sound, work(arm, seed, 16.0, begin=10.0, until=11.0, outside=CONTACT))
    first, *_, last = found
    assert 10.0 <= first.time <= 10.05
    assert 9.8 <= first.since <= 10.05
    assert last.kind is EventKind.RECOVERED
    assert 11.0 <= last.time <= 12.0
    kinds = [event.kind for event in found]
    assert set(kinds) <= {EventKind.UNIDENTIFIED, EventKind.OUTSIDE_TORQUE, EventKind.RECOVERED}
    (told,) = [event for event in found if event.kind is EventKind.OUTSIDE_TORQUE]
    assert kinds[-2] is EventKind.OUTSIDE_TORQUE
    assert told.time <= 10.2
    # The drives hold against what acts on the arm: `outside` is what they read more.
    expected = -CONTACT[arm.joints.index(told.joint)]
    assert told.size == pytest.approx(expected, abs=3.0 * told.std)
    assert all(abs(event.size) >= 3.0 * event.std for event in found)


@pytest.mark.parametrize("seed", range(2))
def test_a_load_is_weighed(arm, sound, seed):
    found = [
        e for e in events(arm, sound, work(arm, seed, load=0.3, begin=20.0)) if e.kind is not EventKind.UNIDENTIFIED
    ]
    assert [event.kind for event in found] == [EventKind.LOAD_CHANGED]
    (event,) = found
    assert event.time < 50.0
    assert event.since == pytest.approx(20.0, abs=8.0)
    assert event.size == pytest.approx(0.3, abs=max(4 * event.std, 0.03))
    assert (event.unit, event.what) == ("kg", "payload")


@pytest.mark.parametrize("seed", range(2))
def test_more_friction_is_a_changed_robot(arm, sound, seed):
    found = events(arm, sound, work(arm, seed, friction=1.4, begin=20.0))
    (event,) = [event for event in found if event.kind is EventKind.ROBOT_CHANGED]
    assert event.joint == "shoulder_lift_joint"
    assert "joint_coulomb_friction" in event.what
    assert event.time < 50.0


def test_a_load_that_is_put_down_again_is_over(arm, sound):
    found = events(arm, sound, work(arm, 7, 150.0, load=0.5, begin=20.0, until=80.0))
    told = [
        event.kind
        for event in found
        if event.kind in (EventKind.LOAD_CHANGED, EventKind.ROBOT_CHANGED, EventKind.RECOVERED)
    ]
    assert told[0] is EventKind.LOAD_CHANGED
    assert told[-1] is EventKind.RECOVERED
    assert EventKind.ROBOT_CHANGED not in told


def test_friction_that_grows_slowly_is_told_by_what_it_grew_to(arm, sound):
    """By .8 N m in 8 s, which no window sees from its beginning."""
    time, q, tau = work(arm, 3, 70.0)
    way = np.sign(np.gradient(q[:, 1], time))
    tau = tau.copy()
    tau[:, 1] += 0.8 * np.clip((time - 20.0) / 8.0, 0.0, 1.0) * way
    found = events(arm, sound, (time, q, tau))
    (event,) = [event for event in found if event.kind is EventKind.ROBOT_CHANGED]
    assert event.what.split(", ")[0] == "joint_coulomb_friction"
    assert event.size == pytest.approx(0.8, abs=3.0 * event.std)
    assert 19.0 <= event.since <= 29.0  # blocks last 1 s


def test_what_was_found_in_one_recording_does_not_hold_in_the_next(arm, sound):
    watch = Watch(arm, sound, 0.01)
    assert list(watch.events_of(samples(work(arm, 1, load=0.3, begin=20.0))))
    watch.begin_source()
    assert list(watch.events_of(samples(work(arm, 21)))) == []


def test_sound_work_is_silent(arm, sound):
    assert events(arm, sound, *(work(arm, seed) for seed in range(20, 25))) == []


def test_gaps_missing_values_and_clocks_that_jump_are_no_events(arm, sound):
    time, q, tau = work(arm, 30)
    q, tau = q.copy(), tau.copy()
    q[3000:3100] = np.nan
    tau[5000:5400, 2] = np.nan
    tau[7000, 0] = np.nan
    time = time.copy()
    time[9000:] += 100.0
    time[11000:] -= 3000.0
    keep = np.ones(len(time), dtype=bool)
    keep[13000:13200] = False
    watch = Watch(arm, sound, 0.01)
    found = list(watch.events_of(samples((time[keep], q[keep], tau[keep]))))
    # The clock is set forward by 100 s: that nothing came meanwhile is all there is to say.
    assert [event.kind for event in found] == [EventKind.SILENT, EventKind.RECOVERED]
    assert (found[0].since, found[0].time) == pytest.approx((36.0, 136.0), abs=0.01)
    assert watch.coverage.skipped[Skipped.NO_POSITION] == 100
    assert watch.coverage.skipped[Skipped.NO_TORQUE] == 401
    settling = watch.coverage.skipped[Skipped.SETTLING]
    assert watch.coverage.skipped.total() == 501 + settling
    assert watch.coverage.watched == pytest.approx((len(time) - 200 - 501 - settling) / RATE, abs=0.1)


def test_a_source_that_falls_silent_is_told_once_and_again_when_it_is_back(arm, sound):
    time, q, tau = work(arm, 33, 40.0)
    tau = tau.copy()
    tau[(time > 10.0) & (time < 20.0)] = np.nan
    watch = Watch(arm, sound, 0.01)
    before = list(watch.events_of(samples((time, q, tau))))
    assert [event.kind for event in before] == [EventKind.SILENT, EventKind.RECOVERED]
    assert before[0].what == "no torque"
    assert before[0].time == pytest.approx(13.0, abs=0.1)
    idle = [event for seconds in (1.5, 2.5, 3.5, 4.5) for event in watch.wait(seconds)]
    assert [(event.kind, event.time) for event in idle] == [(EventKind.SILENT, pytest.approx(43.5, abs=0.1))]
    assert "size" not in idle[0].answer


def test_another_recording_begins_where_the_arm_was_not(arm, sound):
    assert events(arm, sound, work(arm, 31, 15.0), work(arm, 32, 15.0)) == []


def test_what_is_kept_does_not_grow(arm, sound):
    watch = Watch(arm, sound, 0.01)
    sizes = []
    for minute in range(2):
        list(watch.events_of(samples(work(arm, 40 + minute), 61.0 * minute)))
        sizes.append((len(watch._blocks.equations), len(watch._blocks.start_times), watch.observer._state.size))
    assert sizes[0] == sizes[1]


def test_a_model_that_says_its_error_needs_no_calibration(arm):
    history = [{"rmse": {f"tau.{joint}": 0.2 for joint in arm.joints}}]
    band = statistics_of_model_error(arm, history)
    assert "--calibrate" in band.sentence
    assert events(arm, band, work(arm, 50)) == []
    assert EventKind.OUTSIDE_TORQUE in {
        e.kind for e in events(arm, band, work(arm, 0, 16.0, begin=10.0, outside=CONTACT))
    }


def test_a_model_that_says_nothing_of_its_error_needs_recordings(arm, complains):
    with complains(InputError):
        statistics_of_model_error(arm, [])


def test_sound_recordings_that_are_too_short_are_refused(arm, complains):
    with complains(InputError):
        statistics_of_recordings(arm, [lambda: samples(work(arm, 0, 5.0))])


def test_a_told_load_leaves_nothing_of_itself_to_be_told(arm, sound):
    """2 kg: its torque 40 ms late would be as large as a friction that the watch tells."""
    found = events(arm, sound, work(arm, 8, 120.0, load=2.0, begin=20.0))
    assert {event.kind for event in found} <= {EventKind.UNIDENTIFIED, EventKind.LOAD_CHANGED}
    assert sum(event.kind is EventKind.LOAD_CHANGED for event in found) == 1
