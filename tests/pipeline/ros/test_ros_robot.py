"""The arm behind rosbridge, against a loopback bridge and an arm that obeys at once. Time is the test's own."""

import threading
import time

import numpy as np
import pytest
from ros_wire.messages import TOPICS, joint_states

import pipeline.robot.drivers.ros as ros_module
import pipeline.ros.master as master_module
import pipeline.ros.states as states_module
from armdyn.errors import InputError, TaskFailedError
from pipeline.motion.gate import CONTROL_PERIOD_SECONDS
from pipeline.robot.drivers.ros import RosRobot
from pipeline.robot.link import Percentiles
from pipeline.ros.topics import CommandKind, RosTopics

POSTURE = np.array([0.1, -0.5, 0.7, 1.9, -1.2, 0.6, 0.8])


class ObedientArm:
    """Publishes Baxter's states when the test's clock goes on, and is where it was last told to be."""

    def __init__(self, loopback, names, topics=TOPICS):
        self.loopback, self.names, self.topics = loopback, names, topics
        self.time, self.q, self.silent = 0.0, POSTURE.copy(), False
        self.state = {"enabled": True, "ready": True, "stopped": False, "error": False}
        self.state |= {"estop_button": 0, "estop_source": 0}
        self._lock = threading.Lock()

    def step(self, duration):
        with self._lock:
            end = self.time + max(duration, 0.0)
            while self.time < end - 1e-9:
                self.time = min(self.time + CONTROL_PERIOD_SECONDS, end)
                self.say()

    def say(self):
        sent = self.loopback.published(self.topics.command)
        if sent and "command" in sent[-1]:
            self.q = np.array(sent[-1]["command"])
        if not self.silent:
            zero = [0.0] * len(self.names)
            message = joint_states(self.names, 500.0 + self.time, self.q.tolist(), velocity=zero, effort=zero)
            self.loopback.publish(self.topics.joint_states, message)
            self.loopback.publish("/robot/state", self.state)


class SteppedRobot(RosRobot):
    """Waiting lets the test's time pass, and what is published meanwhile arrive."""

    def __init__(self, arm, description, topics=TOPICS):
        self.arm = arm
        super().__init__(arm.loopback.uri, description, topics, clock=lambda: arm.time)

    def advance(self, duration):
        """The newest state is then as old as the arm's clock says."""
        self.arm.step(duration)
        end = time.monotonic() + 10.0
        while not self.arm.silent and self.bridge.failure is None and time.monotonic() < end:
            newest = self._states.latest
            if newest is not None and newest.time > self.arm.time - 1e-6:
                return
            time.sleep(0.0005)


@pytest.fixture
def arm(loopback, baxter, monkeypatch):
    monkeypatch.setattr(ros_module, "round_trip_times", lambda _bridge: Percentiles(50, 0.001, 0.002, 0.003, 0.004))
    monkeypatch.setattr(states_module, "FIRST_STATE_TIMEOUT_SECONDS", 10.0)
    obedient = ObedientArm(loopback, baxter.joint_names)

    def first_states():  # until somebody has subscribed
        while not loopback.stopped.wait(0.01) and not any(r["op"] == "advertise" for r in loopback.requests):
            obedient.say()
        for _ in range(20):
            obedient.say()
            time.sleep(0.01)

    thread = threading.Thread(target=first_states)
    thread.start()
    yield obedient
    loopback.stopped.set()
    thread.join()


@pytest.fixture
def robot(arm, baxter):
    with SteppedRobot(arm, baxter) as stepped:
        stepped.advance(CONTROL_PERIOD_SECONDS)
        yield stepped


def stream(robot, cycles, speed=0.0, start=0.0):
    """Command joint s0 along a minimum-jerk ramp to a speed, cycle by cycle."""
    q, v = POSTURE.copy(), np.zeros(7)
    for k in range(cycles):
        u = min(max((k * CONTROL_PERIOD_SECONDS - start) / 0.4, 0.0), 1.0)
        before, v = v.copy(), np.zeros(7)
        v[0] = speed * u**3 * (10 - 15 * u + 6 * u * u)
        q = q + 0.5 * CONTROL_PERIOD_SECONDS * (before + v)
        robot.command(q, v, (v - before) / CONTROL_PERIOD_SECONDS)
        robot.advance(CONTROL_PERIOD_SECONDS)
    return q, v


def sent(robot):
    """Positions of joint s0 in all commands that arrived at the bridge."""
    robot.arm.loopback.wait_for(lambda: len(robot.arm.loopback.published(TOPICS.command)) == robot.statistics.commands)
    return np.array([m["command"][0] for m in robot.arm.loopback.published(TOPICS.command)])


def test_a_command_says_mode_names_and_positions(robot):
    stream(robot, 1)
    robot.arm.loopback.wait_for(lambda: robot.arm.loopback.published(TOPICS.command))
    message = robot.arm.loopback.published(TOPICS.command)[0]
    assert message == {"mode": 4, "names": list(robot.joint_names), "command": POSTURE.tolist()}
    point = robot.arm.loopback.published(TOPICS.feed_forward)[0]
    assert point["positions"] == POSTURE.tolist()
    assert point["velocities"] == point["accelerations"] == [0.0] * 7


def test_states_are_dated_on_our_clock_and_readings_are_even_and_a_little_behind(robot):
    robot.advance(0.1)
    assert robot.newest_state().time == pytest.approx(robot.time, abs=1e-6)
    assert robot.newest_state().q == pytest.approx(POSTURE)
    times = []
    for _ in range(20):
        robot.advance(CONTROL_PERIOD_SECONDS)
        times.append(robot.joint_state().time)
    assert np.diff(times) == pytest.approx(CONTROL_PERIOD_SECONDS)
    assert 0.0 < robot.time - times[-1] < 0.02 + 1e-9


def test_stop_brakes_within_the_limits_and_holds(robot, baxter, until):
    stream(robot, 60, speed=0.5)
    robot.stop()
    until(lambda: not robot._braking.is_set())
    path = sent(robot)
    assert path[-1] == path[-10]
    limits = baxter.limits
    for order, bound in ((1, limits.velocity), (2, limits.acceleration), (3, limits.jerk)):
        assert np.all(np.abs(np.diff(path, n=order)) / CONTROL_PERIOD_SECONDS**order <= 1.001 * bound[0])
    # 0.5 rad/s is gone after 0.06 s with half of 20 rad/s^2 and of 1000 rad/s^3.
    standing = np.flatnonzero(np.abs(np.diff(path)) < 1e-9)
    assert standing[standing > 50][0] - 60 <= 10


def test_a_refused_command_is_not_sent_and_ends_the_run(robot, until, complains):
    stream(robot, 60, speed=0.5)
    before = robot.statistics.commands
    with complains(TaskFailedError):
        robot.command(POSTURE + 0.1, np.zeros(7), np.zeros(7))
    until(lambda: not robot._braking.is_set())
    with complains(TaskFailedError):
        robot.command(robot.arm.q, np.zeros(7), np.zeros(7))
    path = sent(robot)
    assert np.all(np.abs(np.diff(path)) <= 1.5 * CONTROL_PERIOD_SECONDS)
    assert len(path) > before  # the way to rest
    assert "faster than its limit" in robot.fault


def test_states_that_stop_coming_end_the_run_and_nothing_resumes(robot, until, complains):
    q, v = stream(robot, 60, speed=0.3)
    robot.arm.silent = True

    def go_on():
        for k in range(1, 11):
            robot.arm.step(CONTROL_PERIOD_SECONDS)
            robot.command(q + k * CONTROL_PERIOD_SECONDS * v, v, np.zeros(7))

    with complains(TaskFailedError):
        go_on()
    count = robot.statistics.commands
    robot.arm.silent = False
    robot.advance(0.1)
    until(lambda: not robot._braking.is_set())
    with complains(TaskFailedError):
        robot.command(robot.newest_state().q, np.zeros(7), np.zeros(7))
    assert len(sent(robot)) == count


def test_a_command_waits_for_a_state_that_is_late_and_goes_after_it(robot, monkeypatch):
    monkeypatch.setattr(ros_module, "RECENT_STATE_TIMEOUT_SECONDS", 10.0)  # of the computer that runs this test
    q, v = stream(robot, 60, speed=0.3)
    robot.arm.silent = True
    for k in range(1, 5):
        robot.arm.step(CONTROL_PERIOD_SECONDS)
        robot.command(q + k * CONTROL_PERIOD_SECONDS * v, v, np.zeros(7))
    robot.arm.step(2 * CONTROL_PERIOD_SECONDS)  # the newest state is 60 ms old now
    count = robot.statistics.commands
    waiting = threading.Thread(target=lambda: robot.command(q + 5 * CONTROL_PERIOD_SECONDS * v, v, np.zeros(7)))
    waiting.start()
    waiting.join(0.1)
    assert waiting.is_alive()
    assert robot.statistics.commands == count  # none leaves without a young state
    robot.arm.silent = False
    robot.arm.say()
    waiting.join(10.0)
    assert robot.statistics.commands == count + 1
    assert robot.fault is None


def press(robot):
    robot.arm.state |= {"enabled": False, "stopped": True, "estop_button": 1, "estop_source": 1}
    robot.advance(CONTROL_PERIOD_SECONDS)


def intrude(robot):
    other = {"mode": 1, "names": list(robot.joint_names), "command": (POSTURE + 0.05).tolist()}
    robot.arm.loopback.publish(TOPICS.command, other)


def lose_master(robot):
    robot.arm.loopback.answers[master_module.MASTER_SERVICE] = lambda _arguments: "Unable to communicate with master!"


@pytest.mark.parametrize(
    ("fault", "braked"),
    [
        (press, False),
        (intrude, False),
        (lambda robot: robot.arm.loopback.drop(), False),
        (lose_master, True),  # the arm still follows
    ],
)
def test_what_fails_outside_ends_the_run(robot, until, fault, braked, complains):
    stream(robot, 5)
    fault(robot)
    until(lambda: robot.fault)
    with complains(TaskFailedError):
        stream(robot, 1)
    until(lambda: not robot._braking.is_set())
    assert (len(robot.arm.loopback.published(TOPICS.command)) > 6) == braked  # the other program sends one


def test_a_bridge_without_that_service_is_no_dead_master(robot, until):
    asked = []
    robot.arm.loopback.answers[master_module.MASTER_SERVICE] = lambda _arguments: asked.append(0) or "does not exist"
    until(lambda: len(asked) > 2)
    assert robot.fault is None


def sag(robot, by):
    """The arm is not quite where it was told to be [rad]."""
    robot.arm.q = POSTURE - by
    robot.advance(CONTROL_PERIOD_SECONDS)


def test_a_stream_begins_where_the_arm_is_and_goes_over_to_the_command_without_a_step(robot, until):
    """The first command is where it is, and after half a second what was asked for."""
    sag(robot, 0.01)
    stream(robot, 60)
    path = sent(robot)
    until(lambda: len(robot.statistics.echoes) == 60)  # each is timed, and nobody else's
    assert robot.fault is None
    assert path[0] == pytest.approx(POSTURE[0] - 0.01, abs=1e-9)
    assert path[-1] == POSTURE[0]
    assert np.max(np.abs(np.diff(path))) / CONTROL_PERIOD_SECONDS < 0.04
    assert np.max(np.abs(np.diff(path, n=3))) / CONTROL_PERIOD_SECONDS**3 < 6.0


def test_a_stream_that_would_begin_elsewhere_is_refused(robot, complains):
    sag(robot, 0.03)
    with complains(TaskFailedError):
        stream(robot, 1)
    assert robot.statistics.commands == 0


def test_a_pressed_button_is_told(robot, until, complains):
    press(robot)
    until(lambda: robot.fault)
    with complains(InputError):
        robot.prepare()


def test_another_commander_at_the_start_is_refused(arm, baxter, complains):
    def intrude():
        arm.loopback.wait_subscribed(TOPICS.command)
        arm.loopback.publish(TOPICS.command, {"mode": 1, "names": [], "command": [1.0]})

    thread = threading.Thread(target=intrude)
    thread.start()
    with complains(InputError):
        SteppedRobot(arm, baxter)
    thread.join()


def test_without_joint_states_the_topic_is_named(loopback, baxter, monkeypatch, complains):
    monkeypatch.setattr(states_module, "FIRST_STATE_TIMEOUT_SECONDS", 0.05)
    with complains(InputError):
        RosRobot(loopback.uri, baxter, TOPICS)


def test_enabling_resets_first_and_waits_and_closing_restores_the_robots_own_settings(arm, baxter):
    def obey():
        arm.loopback.wait_for(lambda: arm.loopback.published("/robot/set_super_reset"))
        arm.state |= {"stopped": False, "estop_source": 0, "estop_button": 0}
        arm.say()
        arm.loopback.wait_for(lambda: arm.loopback.published("/robot/set_super_enable"))
        arm.state |= {"enabled": True}
        arm.say()

    with SteppedRobot(arm, baxter) as robot:
        robot.advance(CONTROL_PERIOD_SECONDS)
        arm.state |= {"enabled": False, "stopped": True, "estop_source": 2, "estop_button": 2}
        arm.say()
        thread = threading.Thread(target=obey)
        thread.start()
        while robot.fault is None:
            time.sleep(0.001)
        robot.prepare()
        thread.join()
        assert robot.fault is None
    asked = [r["topic"] for r in arm.loopback.requests if r["op"] == "publish" and "set_super" in r["topic"]]
    assert asked[0] == "/robot/set_super_reset"
    assert arm.loopback.published("/robot/set_super_enable")[0] == {"data": True}
    arm.loopback.wait_for(lambda: len(arm.loopback.published(TOPICS.speed_ratio)) == 2)
    assert [m["data"] for m in arm.loopback.published(TOPICS.timeout)] == [0.1, 0.2]
    assert [m["data"] for m in arm.loopback.published(TOPICS.speed_ratio)] == [1.0, 0.3]


@pytest.mark.parametrize("kind", [CommandKind.TRAJECTORY, CommandKind.ARRAY])
def test_other_controllers_need_a_settings_file_only(arm, baxter, kind, until):
    topics = RosTopics("/robot/joint_states", "/controller/command", kind)
    with SteppedRobot(arm, baxter, topics) as robot:
        robot.advance(CONTROL_PERIOD_SECONDS)
        robot.prepare()
        robot.command(POSTURE, np.zeros(7), np.zeros(7))
        arm.loopback.wait_for(lambda: arm.loopback.published("/controller/command"))
        until(lambda: robot.statistics.echoes)
        assert robot.fault is None
    message = arm.loopback.published("/controller/command")[0]
    if kind is CommandKind.ARRAY:
        assert message == {"data": POSTURE.tolist()}
    else:
        assert message["joint_names"] == list(baxter.joint_names)
        assert message["points"][0]["positions"] == POSTURE.tolist()
        assert message["points"][0]["time_from_start"] == {"secs": 0, "nsecs": 20_000_000}
