"""A force/torque sensor beside the joints' torques: touches that joints do not show, loads, a sensor that is zeroed."""

import numpy as np
import pytest
from watch_work import samples
from worlds import tools

from armdyn.effects.catalogue import CATALOGUE
from armdyn.errors import InputError
from armdyn.run import Run
from armdyn.watch.channels import WatchedChannels
from armdyn.watch.coverage import Skipped
from armdyn.watch.event import EventKind
from armdyn.watch.fault_free import joint_samples_of_recording, statistics_of_recordings
from armdyn.watch.observer import Observer
from armdyn.watch.watch import Watch

TOOL = tools.Tool(1.2, np.array([0.02, -0.01, 0.08]), np.diag([3e-3, 3e-3, 2e-3]))
PUSH = np.array([1.5, -1.0, 1.0])
JOINTS = 6


@pytest.fixture(scope="module")
def model():
    found = tools.sensed_model()
    for name in ("joint_coulomb_friction", "payload", "payload_inertia"):
        found = found.with_effect(CATALOGUE[name])
    values = {name: tools.FRICTION for name in found.names if "coulomb" in name}
    joint, moments = found.joints[-1], np.trace(TOOL.inertia) / 2.0 - np.diag(TOOL.inertia)
    own = {"mass": TOOL.mass} | dict(zip("xyz", TOOL.centre.tolist(), strict=True))
    values |= {f"payload.{name}[{joint}]": x for name, x in own.items()}
    values |= {f"payload_inertia.{2 * axis}[{joint}]": float(x) for axis, x in zip("xyz", moments, strict=True)}
    return found.with_values(values)


def watch_of(model, channels, columns=slice(None)):
    runs = [tools.worked(TOOL, seed) for seed in range(100, 106)]
    given = [lambda run=run: samples((*run[:2], run[2][:, columns])) for run in runs]
    return Watch(model, statistics_of_recordings(model, given, (), channels), 0.01)


@pytest.fixture(scope="module")
def watch(model):
    return watch_of(model, WatchedChannels.of(model))


@pytest.fixture(scope="module")
def by_joints(model):
    return watch_of(model, WatchedChannels.of(model, sensed=()), slice(JOINTS))


def events(watch, recording):
    watch.begin_source()
    time, q, read = recording
    return list(watch.events_of(samples((time, q, read[:, : len(watch.channels.names)]))))


@pytest.mark.parametrize("seed", range(3))
def test_a_push_of_two_newtons_is_told_with_a_sensor_and_not_by_the_joints_alone(watch, by_joints, seed):
    recording = tools.worked(TOOL, seed, 14.0, begin=10.0, end=11.0, push=PUSH)
    found = events(watch, recording)
    assert 10.0 <= found[0].time <= 10.1
    assert {(event.joint, event.channel[1:]) for event in found} <= {(None, f"{axis}.ft") for axis in "xyz"}
    (told,) = [event for event in found if event.kind is EventKind.OUTSIDE_TORQUE]
    size = float(np.linalg.norm(PUSH))
    assert told.unit == "N"
    assert size / np.sqrt(3.0) - 3.0 * told.std <= abs(told.size) <= size + 3.0 * told.std
    assert found[-1].kind is EventKind.RECOVERED
    assert EventKind.OUTSIDE_TORQUE not in {event.kind for event in events(by_joints, recording)}


@pytest.mark.parametrize("seed", range(7, 11))
def test_a_push_of_twelve_seconds_is_one_event_with_its_end(watch, seed):
    found = events(watch, tools.worked(TOOL, seed, 32.0, begin=10.0, end=22.0, push=12.0 * PUSH))
    assert [event.kind for event in found] == [
        EventKind.UNIDENTIFIED,
        EventKind.OUTSIDE_TORQUE,
        EventKind.RECOVERED,
    ]
    assert 22.0 < found[2].time < 22.5
    assert found[2].since == found[1].since


def test_a_force_has_the_sign_of_what_acts_on_the_tool(watch):
    recording = tools.worked(TOOL, 4, 14.0, begin=10.0, end=11.0, push=4.0 * PUSH)
    (told,) = [e for e in events(watch, recording) if e.kind is EventKind.OUTSIDE_TORQUE]
    assert told.channel is not None
    axes = tools.measured(TOOL, *(part[None] for part in (recording[1][1275], np.zeros(6), np.zeros(6))))[2][0]
    expected = (axes.T @ (4.0 * PUSH))["xyz".index(told.channel[1])]
    assert told.size == pytest.approx(expected, abs=3.0 * told.std + 0.1 * abs(expected))


@pytest.mark.parametrize("seed", range(2))
def test_a_load_of_eighty_grams_is_weighed(watch, seed):
    found = [
        e
        for e in events(watch, tools.worked(TOOL, seed, begin=20.0, load=0.08))
        if e.kind is not EventKind.UNIDENTIFIED
    ]
    assert [(event.kind, event.what) for event in found] == [(EventKind.LOAD_CHANGED, "payload")]
    assert found[0].time < 50.0
    assert found[0].size == pytest.approx(0.08, abs=3.0 * found[0].std + 3.0 * tools.WRENCH_ERROR * 0.08)


@pytest.mark.parametrize("seed", range(3))
def test_a_sensor_that_is_zeroed_is_no_contact_but_a_change_of_its_offsets(watch, seed):
    recording = tools.worked(TOOL, seed, begin=20.0, zeroed=True)
    before = tools.worked(TOOL, seed)[2][2500, JOINTS:]
    found = events(watch, recording)
    assert {event.kind for event in found} <= {EventKind.UNIDENTIFIED, EventKind.ROBOT_CHANGED}
    (told,) = [event for event in found if event.kind is EventKind.ROBOT_CHANGED]
    assert told.what == "wrench_offset"
    assert told.time < 45.0
    axis = watch.channels.names.index(told.channel) - JOINTS
    assert told.size == pytest.approx(-before[axis], abs=4.0 * told.std + 0.03 * abs(before[axis]) + 0.3)


@pytest.mark.parametrize("seed", range(3))
def test_a_sensor_that_is_zeroed_while_its_tool_shakes_is_no_contact(watch, seed):
    """The moment's reading, which it lacks from then on, is 6 % more than what the tool weighs."""
    time, q, read = tools.worked(TOOL, seed, begin=20.0, zeroed=True)
    before = tools.worked(TOOL, seed)[2][2500, JOINTS:]
    read[2500:, JOINTS:] -= 0.06 * before
    found = events(watch, (time, q, read))
    assert {event.kind for event in found} <= {EventKind.UNIDENTIFIED, EventKind.ROBOT_CHANGED}
    assert [event.what for event in found if event.kind is EventKind.ROBOT_CHANGED] == ["wrench_offset"]


def test_sound_work_has_no_event(watch):
    assert [event for seed in (50, 51, 52) for event in events(watch, tools.worked(TOOL, seed))] == []


def run_of(recording, channels):
    time, q, read = recording
    names = [f"tau.{joint}" for joint in tools.robot().joint_names] + [f"{axis}.ft" for axis in tools.AXES]
    values = {"q": q} | {name: read[:, names.index(name)] for name in channels}
    return Run.from_arrays(time, values, joints=tools.robot().joint_names, name="run")


def test_a_wrench_alone_is_watched_and_a_sensor_that_a_recording_lacks_is_not(model):
    torques = [f"tau.{joint}" for joint in model.joints]
    axes = [f"{axis}.ft" for axis in tools.AXES]
    work = tools.worked(TOOL, 100, 20.0)
    alone, joints, both = (run_of(work, names) for names in (axes, torques, [*torques, *axes]))
    assert WatchedChannels.of(model, [alone]).asked.tolist() == [False] * 6 + [True] * 6
    assert WatchedChannels.of(model, [both, joints]).names == tuple(torques)
    assert WatchedChannels.of(model, [both]).names == (*torques, *axes)
    with pytest.raises(InputError, match=r"holds no fx\.ft"):
        next(joint_samples_of_recording(joints, model, WatchedChannels.of(model, [both])))
    channels = WatchedChannels.of(model, [alone])
    sound = [run_of(tools.worked(TOOL, seed), axes) for seed in range(100, 103)]
    given = [lambda run=run: joint_samples_of_recording(run, model, channels) for run in sound]
    watch = Watch(model, statistics_of_recordings(model, given, (), channels), 0.01)
    pushed = run_of(tools.worked(TOOL, 1, 14.0, begin=10.0, end=11.0, push=2.0 * PUSH), axes)
    found = list(watch.events_of(joint_samples_of_recording(pushed, model, channels)))
    assert 10.0 <= found[0].time <= 10.1
    assert EventKind.OUTSIDE_TORQUE in {event.kind for event in found}


def test_a_sample_without_a_wrench_is_skipped(model):
    observer, read = Observer(model), np.zeros(12)
    read[6:] = np.nan
    assert observer.process_sample(0.0, np.zeros(6), read) is Skipped.NO_WRENCH
