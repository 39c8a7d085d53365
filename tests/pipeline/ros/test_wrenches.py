"""A force/torque sensor on its own ROS topic: its samples at the times of joint states, and what is said without it."""

import itertools
import subprocess
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from command import called
from ros_wire.messages import joint_states
from ros_wire.wire import KIT, Wire, missing
from worlds import tools

import urdf
from armdyn.errors import InputError, TaskFailedError
from armdyn.run import read_run
from armdyn.watch.channels import WatchedChannels
from armdyn.watch.observer import MAX_SAMPLE_GAP_SECONDS
from pipeline.ros import wrenches
from pipeline.ros.bridge import RosBridge
from pipeline.ros.record import record_run
from pipeline.ros.topics import RosTopics, time_message
from pipeline.ros.wrenches import WRENCH_TYPE, WrenchBuffer, missing_wrench_error
from pipeline.watch import ros_source
from pipeline.watch.ros_source import RosSampleSource

STATES, WRENCH, RATE = "/joint_states", "/ft_sensor/wrench", 0.8
TOPICS = RosTopics(STATES, "/command")
OTHER_CLOCK = 1000.0
"""The sensor's stamps are this much ahead of the arm's [s]."""


def wrench(stamp, value):
    force, torque = (dict(zip("xyz", values, strict=True)) for values in ((value, 2.0, 3.0), (4.0, 5.0, -value)))
    return {"header": {"stamp": time_message(stamp)}, "wrench": {"force": force, "torque": torque}}


@pytest.fixture(scope="module")
def model():
    return tools.sensed_model()


@pytest.fixture
def robot(loopback, model):
    """Sends joint states at 100 Hz, and until `silent` a wrench at 250 Hz: fx and every joint are RATE times time."""
    silent, names = threading.Event(), model.arm.joints

    def speak():
        begun = time.monotonic()
        for k in itertools.count():
            if loopback.stopped.wait(0.004):
                return
            now = time.monotonic() - begun
            if not silent.is_set():
                loopback.publish(WRENCH, wrench(OTHER_CLOCK + now, RATE * now))
            if k % 3 == 0:
                at = [RATE * now] * len(names)
                loopback.publish(STATES, joint_states(names, 1.0 + now, at, velocity=[RATE] * len(names), effort=at))

    thread = threading.Thread(target=speak, daemon=True)
    thread.start()
    yield silent
    loopback.stopped.set()
    thread.join()


def source(uri, model, topic=WRENCH):
    """The samples, without the waits between them."""
    (sensor,) = model.sensors
    return filter(None, RosSampleSource(uri, STATES, WatchedChannels.of(model), {sensor: topic}).samples())


def test_a_wrench_between_two_samples_is_interpolated_and_unknown_beyond_them_and_in_a_gap():
    sensor = WrenchBuffer()
    for stamp in (1.0, 1.01, 1.02, 1.02 + 2.0 * MAX_SAMPLE_GAP_SECONDS):
        sensor.take(wrench(stamp, RATE * stamp), stamp)
    np.testing.assert_allclose(sensor.at(1.013), [RATE * 1.013, 2.0, 3.0, 4.0, 5.0, -RATE * 1.013])
    for beyond in (0.99, 1.02 + MAX_SAMPLE_GAP_SECONDS, 2.0):
        assert np.isnan(sensor.at(beyond)).all()
    assert sensor.at(1.0)[0] == pytest.approx(RATE)


@pytest.mark.usefixtures("robot")
def test_a_joint_state_has_the_wrench_of_its_time_though_the_clocks_differ(loopback, model):
    samples = list(itertools.islice(source(loopback.uri, model), 100))
    read = np.array([row for _, _, row in samples[20:]])
    joints = len(model.arm.joints)
    assert read.shape[1] == joints + 6
    assert np.abs(read[:, joints] - read[:, 0]).max() < RATE * 0.015  # less than a cycle of the joint states
    np.testing.assert_allclose(read[:, joints + 1 : joints + 5], [[2.0, 3.0, 4.0, 5.0]] * len(read))


def test_a_sensor_that_falls_silent_is_missing_and_the_joints_go_on(loopback, model, robot):
    states = source(loopback.uri, model)
    assert any(np.isfinite(next(states)[2]).all() for _ in range(50))
    robot.set()
    joints, rows = len(model.arm.joints), [next(states)[2] for _ in range(80)]
    assert np.isfinite(np.array(rows)[:, :joints]).all()
    assert np.isnan(np.array(rows)[-10:, joints:]).all()


@pytest.mark.usefixtures("robot")
@pytest.mark.parametrize("kind", ["", "sensor_msgs/JointState", WRENCH_TYPE, None])
def test_a_topic_without_wrenches_is_refused_in_one_line(loopback, model, monkeypatch, complains, kind):
    """None: rosapi does not run."""
    monkeypatch.setattr(ros_source, "FIRST_STATE_TIMEOUT_SECONDS", 0.3)
    loopback.answers["/rosapi/topic_type"] = lambda _given: None if kind is None else {"type": kind}
    known = {"topics": [WRENCH, "/b"]} if kind == "" else {"topics": []}
    loopback.answers["/rosapi/topics_for_type"] = lambda _given: None if kind is None else known
    with complains(InputError):
        list(source(loopback.uri, model, "/other"))


def test_a_recording_holds_the_wrench_beside_the_joints(loopback, baxter, speaking, tmp_path, monkeypatch, complains):
    begun, topics = time.monotonic(), RosTopics("/robot/joint_states", "/command")

    def messages(_k):
        now = time.monotonic() - begun
        loopback.publish(WRENCH, wrench(OTHER_CLOCK + now, RATE * now))
        yield joint_states(baxter.joint_names, 1.0 + now, [RATE * now] * 7, effort=[1.0] * 7)

    speaking(messages)
    file = tmp_path / "run.csv"
    _, said = record_run(loopback.uri, baxter, topics, file, 0.6, wrenches={"ft": WRENCH})
    assert any(note.startswith(f"{WRENCH}: ") and note.endswith("all are used") for note in said)
    run = read_run(file)
    force, joint = run.channels["fx.ft"], run.channels["q.right_s0"]
    assert np.interp(joint.time[2:-2], force.time, force.value) == pytest.approx(joint.value[2:-2], abs=RATE * 0.01)
    assert run.channels["tz.ft"].value == pytest.approx(-force.value)
    monkeypatch.setattr("pipeline.ros.record.FIRST_STATE_TIMEOUT_SECONDS", 0.3)
    with complains(InputError):
        record_run(loopback.uri, baxter, topics, tmp_path / "b.csv", 0.5, wrenches={"ft": "/none"})


def test_a_recording_ends_where_its_sensor_falls_silent_and_what_came_is_kept(loopback, robot, tmp_path, monkeypatch):
    monkeypatch.setattr("pipeline.ros.record.MAX_STATE_GAP_SECONDS", 0.5)
    threading.Timer(0.6, robot.set).start()
    with pytest.raises(TaskFailedError, match=rf"{WRENCH}: nothing came for 0.5 s; the .* of 30 s that came are in"):
        record_run(loopback.uri, urdf.load("ur5"), TOPICS, tmp_path / "run.csv", 30.0, wrenches={"ft": WRENCH})
    assert len(read_run(tmp_path / "run.csv").channels["fx.ft"]) > 10


@pytest.mark.parametrize("text", ["ft", "ft=wrench", "f t=/a"])
def test_sensor_and_topic_are_written_with_an_equals_sign(text, complains):
    with complains(InputError):
        wrenches.chosen_wrench_topics([text])
    with complains(InputError):
        wrenches.chosen_wrench_topics(["ft=/a", "other=/a"])


def test_a_watch_says_which_topic_to_add(loopback, model, tmp_path, refused, monkeypatch):
    monkeypatch.setattr(ros_source, "FIRST_STATE_TIMEOUT_SECONDS", 0.3)
    file, sound, channels = tmp_path / "ur5.toml", tmp_path / "sound.csv", WatchedChannels.of(model)
    assert called("new", "arm", file, "--robot", "ur5", "--wrench", "ft=tool0")[0] == 0
    heads = [f"{name} [{unit}]" for name, unit in zip(channels.names, channels.units, strict=True)]
    heads = ["time [s]", *(f"q.{joint} [rad]" for joint in channels.joints), *heads]
    np.savetxt(
        sound, np.column_stack(tools.worked(tools.drawn(0), 0)), delimiter=",", header=",".join(heads), comments=""
    )
    words = ("watch", file, "--calibrate", sound)
    said = refused(*words, "--ros", loopback.uri, "--wrench", "tcp=/a")
    assert "has no such force/torque sensor; it has ft" in said
    assert "it needs --ros" in refused(*words, "-", "--wrench", "ft=/a")
    loopback.answers["/rosapi/topics_for_type"] = lambda _given: {"topics": [WRENCH]}
    status, said, wrong = called(*words, "--ros", loopback.uri)
    assert status == 2
    assert f"ft is not watched: add --wrench ft=TOPIC; wrenches are sent on {WRENCH}." in said
    assert "no state of" in wrong


NODE = """
import rospy
from geometry_msgs.msg import WrenchStamped
from sensor_msgs.msg import JointState
rospy.init_node("arm")
states = rospy.Publisher("/joint_states", JointState, queue_size=1)
sensor = rospy.Publisher("/ft_sensor/wrench", WrenchStamped, queue_size=1)
begun, rate, k = rospy.get_time(), rospy.Rate(300), 0
while not rospy.is_shutdown():
    now, wrench, state = rospy.Time.now(), WrenchStamped(), JointState()
    value = 0.8 * (now.to_sec() - begun)
    wrench.header.stamp = state.header.stamp = now
    wrench.wrench.force.x, wrench.wrench.torque.z = value, -value
    sensor.publish(wrench)
    if k % 3 == 0:
        state.name, state.position, state.effort = {names}, [value] * {count}, [value] * {count}
        states.publish(state)
    k += 1
    rate.sleep()
"""


@pytest.mark.slow
@pytest.mark.skipif(missing() is not None, reason=str(missing()))
def test_a_real_master_passes_wrenches_on_and_knows_their_topic(model, tmp_path):
    names, script = list(model.arm.joints), tmp_path / "node.py"
    script.write_text(NODE.format(names=names, count=len(names)))
    with Wire() as wire:
        master = wire.master.rpartition(":")[2].rstrip("/")
        node = subprocess.Popen([str(Path(KIT) / "node.sh"), master, str(script)])
        try:
            read = np.array([row for _, _, row in itertools.islice(source(wire.uri, model), 300)])[100:]
            record_run(wire.uri, urdf.load("ur5"), TOPICS, tmp_path / "run.csv", 1.0, wrenches={"ft": WRENCH})
            with RosBridge(wire.uri) as bridge:
                said = [str(missing_wrench_error(bridge, [topic])) for topic in ("/nothing", STATES)]
        finally:
            node.kill()
            node.wait()
    assert np.isfinite(read).all()
    assert np.median(np.abs(read[:, len(names)] - read[:, 0])) < RATE * 0.01
    run = read_run(tmp_path / "run.csv")
    force, joint = run.channels["fx.ft"], run.channels[f"q.{names[0]}"]
    apart = np.interp(joint.time[2:-2], force.time, force.value) - joint.value[2:-2]
    assert np.median(np.abs(apart)) < RATE * 0.01
    assert said == [
        f"/nothing: there is no such topic; wrenches are sent on {WRENCH}",
        f"{STATES}: its messages are sensor_msgs/JointState, not {WRENCH_TYPE}; wrenches are sent on {WRENCH}",
    ]
