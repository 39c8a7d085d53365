"""Joint states from a topic."""

import math

import numpy as np
import pytest
from ros_wire.messages import TOPICS, joint_states

from armdyn.errors import InputError
from pipeline.ros.states import EvenReadingTimes, JointStates, StampClock
from pipeline.ros.topics import CommandKind, commanded_positions, read_topics

BAXTER = [
    "head_nod", "head_pan", "left_e0", "left_e1", "left_s0", "left_s1", "left_w0", "left_w1", "left_w2", "right_e0",
    "right_e1", "right_s0", "right_s1", "right_w0", "right_w1", "right_w2", "torso_t0",
]  # fmt: skip


ARM = [f"right_{j}" for j in ("s0", "s1", "e0", "e1", "w0", "w1", "w2")]


def message(stamp=1.0, names=BAXTER, **changes):
    values = [float(k) for k in range(len(names))]
    given = {"position": values, "velocity": [10 + v for v in values], "effort": [20 + v for v in values]}
    return {**joint_states(names, stamp, **given), **changes}


def taken(*messages_and_times):
    """States of the arm after messages, each followed by the time of its reception."""
    states = JointStates(ARM)
    for each, now in zip(messages_and_times[::2], messages_and_times[1::2], strict=True):
        states.take(each, now)
    return states


def test_joints_are_matched_by_name_and_a_gripper_on_the_same_topic_is_left_out():
    gripper = message(1.01, names=["r_gripper_l_finger_joint"])
    states = taken(message(), 0.0, gripper, 0.01, message(1.02), 0.02)
    expected = [BAXTER.index(name) for name in ARM]
    assert states.latest.q.tolist() == expected
    assert states.latest.v.tolist() == [10 + k for k in expected]
    assert states.latest.tau.tolist() == [20 + k for k in expected]
    assert (len(states._states), states.unreadable) == (2, 0)


@pytest.mark.parametrize(
    "changes",
    [
        {"position": [None] * 17},
        {"position": [math.nan] * 17},
        {"position": [1.0] * 5},
        {"position": None},
        {"velocity": [1.0] * 5},
        {"effort": [math.inf] * 17},
        {"header": {"stamp": {"secs": "now", "nsecs": 0}}},
        {"header": {"stamp": {"secs": math.nan, "nsecs": 0}}},
    ],
)
def test_a_bad_message_is_counted_and_left_out(changes):
    states = taken(message(**changes), 0.0)
    assert states.latest is None
    assert states.unreadable == 1


def test_a_driver_may_leave_out_velocity_and_effort_and_stamps():
    states = taken(message(0.0, velocity=[], effort=[]), 7.0)
    assert np.isnan(states.latest.v).all()  # missing, not 0
    assert np.isnan(states.latest.tau).all()
    assert states.latest.time == 7.0
    states = taken(message(1.0, velocity=[], effort=[]), 7.0, message(1.1, velocity=[], effort=[]), 7.1)
    first, last = (states.at(time) for time in (states._states[0].time, states.latest.time))
    between = states.at(0.5 * (first.time + last.time))
    np.testing.assert_allclose(between.q, 0.5 * (first.q + last.q))
    np.testing.assert_allclose(states.at(last.time + 0.01).q, last.q)


def test_repeated_and_overtaken_messages_are_left_out():
    states = taken(*(x for stamp in (1.0, 1.01, 1.01, 1.0, 1.02) for x in (message(stamp), stamp)))
    assert states.latest.time == pytest.approx(1.02)
    assert len(states._states) == 3


def test_the_stamp_of_ros_2_is_read():
    first, second = ({"header": {"stamp": {"sec": 5, "nanosec": n}}} for n in (0, 500_000_000))
    assert taken(message(**first), 7.0, message(**second), 7.6).latest.time == pytest.approx(7.5, abs=1e-3)


def test_another_clock_is_mapped_by_its_quickest_messages():
    """Stamps 1000 s ahead, delays of 1 to 9 ms: after some messages states are dated to 1 ms."""
    clock, rng = StampClock(), np.random.default_rng(1)
    errors = []
    for k in range(400):
        true = 0.01 * k
        errors.append(clock.local(1000.0 + true, true + 0.001 + 0.008 * rng.random()) - true)
    assert max(errors[50:]) < 0.0015
    assert min(errors[50:]) > 0.0009


def test_clocks_that_drift_are_followed():
    clock = StampClock()
    for k in range(100_000):
        true = 0.01 * k
        local = clock.local(true * (1 - 5e-5), true + 0.001)
    assert abs(local - true) < 0.0015


def test_a_clock_that_jumps_makes_states_old_or_early():
    clock = StampClock()
    for k in range(100):
        clock.local(0.01 * k, 0.01 * k + 0.001)
    assert clock.local(1.0 - 0.5, 1.001) < 0.6
    assert clock.local(1.01 + 0.5, 1.011) == pytest.approx(1.011)  # the offset is smaller: received when it was stamped


def test_one_stamp_from_the_future_moves_no_other():
    """A stamp 0.48 s ahead: its own state is dated when it came, all that follow as those before."""
    clock, errors = StampClock(), []
    for k in range(300):
        true = 0.01 * k
        errors.append(clock.local(true + 0.48 * (k == 150), true + 0.001) - true)
    assert np.abs(errors).max() < 0.0015


def test_a_clock_that_was_set_forward_is_followed_from_the_second_state_on():
    clock = StampClock()
    for k in range(100):
        local = clock.local(0.01 * k + 5.0 * (k >= 50), 0.01 * k + 0.001)
    assert local == pytest.approx(0.01 * 99 + 0.001)


def test_between_two_states_a_cubic_is_exact():
    states = JointStates(["a"])
    q, v = (lambda t: 2 * t**3 - t**2 + 3), (lambda t: 6 * t**2 - 2 * t)
    for t in (0.5, 0.51, 0.52):
        states.take(
            {"name": ["a"], "position": [q(t)], "velocity": [v(t)], "header": {"stamp": {"secs": 0, "nsecs": t * 1e9}}},
            t,
        )
    for t in (0.5, 0.503, 0.51, 0.5177):
        assert states.at(t).q[0] == pytest.approx(q(t), abs=1e-12)
    assert states.at(0.53).q[0] == pytest.approx(q(0.52) + 0.01 * v(0.52))
    assert states.at(0.4).q[0] == pytest.approx(q(0.5))


def cycles(beginnings, period=0.01):
    even = EvenReadingTimes(period)
    return np.array([even.next(t) for t in beginnings])


def test_late_cycles_do_not_bend_the_reading_times():
    rng = np.random.default_rng(0)
    due = 0.01 * np.arange(500)
    late = np.maximum.accumulate(due + 0.012 * rng.random(500) * (rng.random(500) < 0.2))
    late[0] = 0.0
    assert np.allclose(cycles(late), due)


@pytest.mark.parametrize(
    ("beginnings", "times"),
    [
        ([0.0, 0.01, 2.0, 2.01], [0.0, 0.01, 2.0, 2.01]),  # a long pause is caught up at once
        ([0.0, 0.01, 0.0101, 0.02], [0.0, 0.01, 0.01, 0.02]),  # asked twice in one cycle
    ],
)
def test_times_are_whole_periods_apart_unless_the_loop_paused(beginnings, times):
    assert np.allclose(cycles(beginnings), times)


def test_cycles_that_were_left_out_leave_a_gap_of_whole_periods():
    due = 0.01 * np.delete(np.arange(200), [50, 51])
    times = cycles(due)
    steps = np.round(np.diff(times) / 0.01)
    assert set(steps) == {1.0, 3.0}
    assert np.allclose(np.diff(times), 0.01 * steps)
    assert times[-1] == pytest.approx(due[-1])


UR = """
[ros]
joint_states = "/joint_states"
command = "/joint_group_position_controller/command"
type = "std_msgs/Float64MultiArray"
"""


def test_baxters_own_table():
    assert TOPICS.command == "/robot/limb/right/joint_command"
    assert (TOPICS.type, TOPICS.mode) == (CommandKind.JOINT_COMMAND, "raw_position")
    assert (TOPICS.command_timeout, TOPICS.enabling) == (0.1, "/robot")


def test_another_arm_needs_three_lines(tmp_path):
    file = tmp_path / "ur.toml"
    file.write_text(UR)
    topics = read_topics(file)
    assert topics.type is CommandKind.ARRAY
    assert topics.enabling is topics.timeout is topics.feed_forward is None


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[ros]\ncommand = '/a'",
        UR + "speed = 1",
        UR.replace("/joint_states", "joint_states"),
        UR.replace("Float64MultiArray", "String"),
        UR + "mode = 'torque'",
        UR + "command_timeout = 5",
        UR + "command_timeout = nan",
        "[ros",
    ],
)
def test_a_bad_table_is_explained(tmp_path, text, complains):
    file = tmp_path / "arm.toml"
    file.write_text(text)
    with complains(InputError):
        read_topics(file)


def test_a_missing_file_is_named(tmp_path, complains):
    with complains(InputError):
        read_topics(tmp_path / "none.toml")


def test_positions_are_found_in_anybodys_command():
    assert commanded_positions({"command": [1.0]}, CommandKind.JOINT_COMMAND) == (1.0,)
    assert commanded_positions({"data": [1.0]}, CommandKind.ARRAY) == (1.0,)
    assert commanded_positions({"points": [{"positions": [2.0]}, {"positions": [1.0]}]}, CommandKind.TRAJECTORY) == (
        1.0,
    )
    assert commanded_positions({}, CommandKind.TRAJECTORY) == ()
