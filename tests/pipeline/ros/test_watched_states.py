"""A watch of a robot behind rosbridge: its states are samples, a bridge that went away comes back, nothing is sent."""

import threading
import time

import numpy as np
import pytest
from ros_wire.messages import joint_states
from watch_work import model, work

from armdyn.errors import InputError
from armdyn.watch.channels import WatchedChannels
from pipeline.watch import ros_source
from pipeline.watch.ros_source import RosSampleSource

TOPIC = "/robot/joint_states"


def speak(loopback, arm, count, effort=True):
    stamps, q, tau = work(arm, 0, 4.0)
    loopback.wait_subscribed(TOPIC)
    for stamp, position, torque in zip(stamps[:count] + 1.0, q, tau, strict=False):
        efforts = {"effort": [*torque, 0.0]} if effort else {}
        loopback.publish(TOPIC, joint_states([*arm.joints, "gripper"], stamp, [*position, 0.0], **efforts))
        time.sleep(0.002)


@pytest.fixture
def arm():
    return model()


def test_states_are_samples_of_the_arms_joints_and_nothing_is_published(loopback, arm):
    thread = threading.Thread(target=speak, args=(loopback, arm, 300), daemon=True)
    thread.start()
    states = RosSampleSource(loopback.uri, TOPIC, WatchedChannels.of(arm))
    found = [sample for sample, _ in zip(states.samples(), range(200), strict=False)]
    thread.join()
    _, q, tau = work(arm, 0, 4.0)
    time_of, first, efforts = (np.array(part) for part in zip(*found, strict=True))
    assert time_of[0] == 0.0
    assert np.all(np.diff(time_of) > 0)
    begin = int(np.argmin(np.abs(q - first[0]).sum(axis=1)))
    np.testing.assert_allclose(first[:100], q[begin : begin + 100])
    np.testing.assert_allclose(efforts[:100], tau[begin : begin + 100])
    assert {request["op"] for request in loopback.requests} == {"subscribe"}


def test_a_bridge_that_went_away_is_called_again(loopback, arm, monkeypatch):
    monkeypatch.setattr(ros_source, "RECONNECT_PERIOD_SECONDS", 0.05)
    states = RosSampleSource(loopback.uri, TOPIC, WatchedChannels.of(arm)).samples()
    threading.Thread(target=speak, args=(loopback, arm, 50), daemon=True).start()
    before = [next(states) for _ in range(20)]
    loopback.drop()
    threading.Thread(target=speak, args=(loopback, arm, 400), daemon=True).start()
    after = [next(states) for _ in range(100)]
    assert after[-1][0] > before[-1][0]


def test_states_without_torques_are_refused(loopback, arm, monkeypatch, complains):
    monkeypatch.setattr(ros_source, "FIRST_STATE_TIMEOUT_SECONDS", 0.2)
    threading.Thread(target=speak, args=(loopback, arm, 400, False), daemon=True).start()
    with complains(InputError):
        list(RosSampleSource(loopback.uri, TOPIC, WatchedChannels.of(arm)).samples())
