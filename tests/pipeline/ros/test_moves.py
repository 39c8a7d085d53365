"""Slow motions before the experiment, the beginning of a stream, and what is published."""

import numpy as np
import pytest

from armdyn.errors import TaskFailedError
from pipeline.motion.feasibility import check_joints, check_line
from pipeline.motion.gate import CONTROL_PERIOD_SECONDS
from pipeline.motion.transitions import MAX_BRIDGED_COMMAND_OFFSET, START_OFFSET_DECAY_SECONDS, DecayingStartOffset
from pipeline.robot.protocol import ForceSample
from pipeline.ros.telemetry import PublishingRecorder, RosTelemetryPublisher
from pipeline.trial.moves import (
    MAX_APPROACH_JOINT_SPEED,
    MAX_REHEARSAL_SPEED,
    approach_motion,
    play_motion,
    postures_along,
    rehearsal_motion,
)


def test_the_approach_goes_from_where_the_arm_is_to_the_start_slowly_and_is_feasible(baxter, table):
    start, goal = np.array(baxter.home), table.posture(0.0).q
    motion = approach_motion(baxter, start, goal)
    assert motion.q[0] == pytest.approx(start)
    assert motion.q[-1] == pytest.approx(goal)
    assert np.max(np.abs(motion.v)) <= MAX_APPROACH_JOINT_SPEED * 1.001
    assert motion.v[[0, -1]] == pytest.approx(0.0)
    assert np.gradient(motion.q, CONTROL_PERIOD_SECONDS, axis=0) == pytest.approx(motion.v, abs=2e-4)
    assert np.gradient(motion.v, CONTROL_PERIOD_SECONDS, axis=0)[1:-1] == pytest.approx(motion.a[1:-1], abs=2e-3)
    assert check_joints(baxter, motion, at=start).feasible


def test_the_rehearsal_covers_the_line_slowly_and_is_feasible(baxter, table):
    motion = rehearsal_motion(table, 0.46)
    assert (motion.s[0], motion.s[-1]) == pytest.approx((0.0, 0.0))
    assert motion.s.min() == pytest.approx(-0.2)
    assert motion.s.max() == pytest.approx(0.46)
    assert np.max(np.abs(motion.v)) <= MAX_REHEARSAL_SPEED * 1.001
    assert check_line(table, baxter, motion).feasible
    assert len(list(postures_along(table, motion))) == len(motion)


class SlowRobot:
    """A robot whose program was kept from running for a while; it notes when it is commanded."""

    def __init__(self):
        self.time, self.commands, self.stopped = 0.0, [], False

    def command(self, q, _v, _a):
        self.commands.append((self.time, float(q[0])))
        if len(self.commands) == 5:
            self.time += 0.2

    def advance(self, duration):
        self.time += duration

    def stop(self):
        self.stopped = True


def test_a_late_cycle_makes_a_motion_longer_never_faster():
    robot, zero = SlowRobot(), np.zeros(1)
    play_motion(robot, [(np.array([0.01 * k]), zero, zero) for k in range(20)], 0.2)
    times = np.array([time for time, _ in robot.commands])
    assert np.all(np.diff(times) >= CONTROL_PERIOD_SECONDS - 1e-9)
    assert not robot.stopped


def test_a_refused_command_stops_the_robot(complains):
    robot, zero = SlowRobot(), np.zeros(1)

    def refused(*_vectors):
        raise TaskFailedError("the gate")

    robot.command = refused
    with complains(TaskFailedError):
        play_motion(robot, [(zero, zero, zero)], 1.0)
    assert robot.stopped


def test_a_blend_goes_from_where_the_arm_is_to_where_it_was_told_to_be_without_jerk():
    here, told, zero = np.array([0.1, 0.2]), np.array([0.11, 0.19]), np.zeros(2)
    blend = DecayingStartOffset(here, told)
    steps = [
        blend.next_command(told, zero, zero)
        for _ in range(round(START_OFFSET_DECAY_SECONDS / CONTROL_PERIOD_SECONDS) + 2)
    ]
    q, v, a = (np.array(x) for x in zip(*steps, strict=True))
    assert q[0] == pytest.approx(here)
    assert q[-1] == pytest.approx(told, abs=0.0)
    assert np.max(np.abs(np.diff(q, axis=0))) / CONTROL_PERIOD_SECONDS < 0.04
    assert np.max(np.abs(np.diff(q, n=3, axis=0))) / CONTROL_PERIOD_SECONDS**3 < 6.0
    assert np.gradient(q, CONTROL_PERIOD_SECONDS, axis=0)[1:-1] == pytest.approx(v[1:-1], abs=5e-4)
    assert np.gradient(v, CONTROL_PERIOD_SECONDS, axis=0)[1:-1] == pytest.approx(a[1:-1], abs=2e-2)
    assert DecayingStartOffset(here + 0.5, here).next_command(here, zero, zero)[0] == pytest.approx(
        here + MAX_BRIDGED_COMMAND_OFFSET
    )  # too far


@pytest.fixture
def telemetry(loopback, bridge, baxter):
    made = RosTelemetryPublisher(bridge, baxter.joint_names)
    loopback.wait_for(lambda: len(loopback.requests) == 4)
    assert [(r["topic"], r["type"]) for r in loopback.requests] == [
        ("/armdyn/estimate", "std_msgs/Float64MultiArray"),
        ("/armdyn/reference", "sensor_msgs/JointState"),
        ("/armdyn/load_force", "geometry_msgs/WrenchStamped"),
        ("/armdyn/phase", "std_msgs/String"),
    ]
    return made


def test_reference_force_and_phase_are_published(loopback, telemetry):
    for k in range(5):  # in one go: only the first is due
        telemetry.publish_reference(np.full(7, 0.1 * k), np.zeros(7))
        telemetry.publish_load_force([ForceSample(0.0, 0.7), ForceSample(0.01, 0.8)])
        telemetry.publish_phase("swing")
    telemetry.publish_phase("finish")
    loopback.wait_for(lambda: len(loopback.published("/armdyn/phase")) == 2)
    (reference,) = loopback.published("/armdyn/reference")
    assert reference["position"] == [0.0] * 7
    assert reference["header"]["stamp"]["secs"] > 1_500_000_000
    (force,) = loopback.published("/armdyn/load_force")
    assert force["wrench"]["force"] == {"x": 0.0, "y": 0.0, "z": 0.8}
    assert [m["data"] for m in loopback.published("/armdyn/phase")] == ["swing", "finish"]


def test_each_estimate_is_published_when_it_is_recorded_until_the_bridge_is_lost(
    loopback, telemetry, bridge, until, tmp_path
):
    channels = {"estimate.length": "m", "estimate.length_std": "m"}
    with PublishingRecorder(tmp_path / "a.mcap", channels, telemetry=telemetry) as recorder:
        recorder.record("estimate.length", 1.0, 0.36)
        recorder.record("estimate.length_std", 1.0, 0.001)
    loopback.wait_for(lambda: loopback.published("/armdyn/estimate"))
    assert loopback.published("/armdyn/estimate")[0]["data"] == [0.36, 0.001]
    loopback.drop()
    until(lambda: bridge.failure)
    telemetry.publish_phase("swing")  # costs what would have been published and nothing else
