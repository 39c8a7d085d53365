"""Joint states from a topic."""

import math

import numpy as np
import pytest
from ros_wire.messages import joint_states

from armdyn.errors import InputError
from pipeline.ros.states import EvenReadingTimes, JointStateBuffer, StampClock
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
    states = JointStateBuffer(ARM)
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


BAD = [
    *({"position": wrong} for wrong in ([None] * 17, [math.nan] * 17, [1.0] * 5, None)),
    {"velocity": [1.0] * 5}, {"effort": [math.inf] * 17},
    *({"header": {"stamp": {"secs": secs, "nsecs": 0}}} for secs in ("now", math.nan)),
]  # fmt: skip


@pytest.mark.parametrize("changes", BAD)
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


def test_repeated_and_overtaken_messages_are_left_out_and_the_stamp_of_ros_2_is_read():
    states = taken(*(x for stamp in (1.0, 1.01, 1.01, 1.0, 1.02) for x in (message(stamp), stamp)))
    assert states.latest.time == pytest.approx(1.02)
    assert len(states._states) == 3
    first, second = ({"header": {"stamp": {"sec": 5, "nanosec": n}}} for n in (0, 500_000_000))
    assert taken(message(**first), 7.0, message(**second), 7.6).latest.time == pytest.approx(7.5, abs=1e-3)


def dated(stamps, delays):
    """How late the states of an arm are dated whose true times are 10 ms apart."""
    clock, true = StampClock(), 0.01 * np.arange(len(stamps))
    return np.array([clock.local(*each) for each in zip(stamps, true + delays, strict=True)]) - true


T = 0.01 * np.arange(400)
LONG = 0.01 * np.arange(100_000)
CLOCKS = {
    "of its own, by its quickest messages": (
        1000.0 + T,
        0.001 + 0.008 * np.random.default_rng(1).random(400),
        50,
        0.0015,
    ),
    "that drifts": (LONG * (1 - 5e-5), 0.001, 50, 0.0016),
    "that jumps ahead for one stamp": (T + 0.48 * (np.arange(400) == 150), 0.001, 0, 0.0015),
    "that was set forward": (T + 5.0 * (T >= 0.5), 0.001, 52, 0.0015),
}


@pytest.mark.parametrize(("stamps", "delays", "settled", "within"), CLOCKS.values(), ids=CLOCKS)
def test_states_are_dated_on_our_clock_whatever_the_robots_does(stamps, delays, settled, within):
    late = dated(stamps, delays + 0.0 * stamps)[settled:]
    assert late.max() < within
    assert late.min() > 0.0009


def test_a_stamp_that_goes_back_once_makes_one_state_old():
    assert dated(T[:100] - 0.5 * (np.arange(100) == 99), 0.001 + 0.0 * T[:100])[-1] < -0.4


@pytest.mark.parametrize("back", [0.004, 0.013, 0.026, 0.04, 0.055, 0.2, 1.0, 30.0, 999.0])
@pytest.mark.parametrize("spread", [0.0, 0.001])
def test_a_clock_that_is_set_back_by_any_amount_costs_one_state(back, spread):
    states, true = JointStateBuffer(["a"]), 0.01 * np.arange(400)
    delays = 0.001 + spread * np.random.default_rng(3).random(400)
    kept, late = 0, []
    for i, received in enumerate(true + delays):
        before = states.latest
        stamp = 2000.0 + true[i] - back * (i >= 200)
        states.take(message(stamp, ["a"], position=[float(i)]), received)
        kept += states.latest is not before
        late.append(states.latest.time - true[i] if states.latest is not before else 0.0)
    assert kept >= 399
    assert (
        np.abs(late[202:]).max() < max(0.001 + spread, back if back < 2 * 0.01 else 0.0) + 1e-4
    )  # less than two periods: dated early


def test_messages_that_are_repeated_together_or_overtaken_do_not_set_the_clock_back():
    order = [*range(50), 47, 48, 49, *range(50, 60), 61, 60, 62, 64, 63, *range(65, 100)]
    states = JointStateBuffer(["a"])
    for place, i in enumerate(order):
        states.take(message(1.0 + 0.01 * i, ["a"], position=[float(i)]), 0.01 * place + 0.001 * (place % 3))
        assert states.latest.q[0] == max(order[: place + 1])


def test_between_two_states_a_cubic_is_exact():
    states = JointStateBuffer(["a"])
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


DUE = 0.01 * np.arange(500)
LATE = np.maximum.accumulate(DUE + 0.012 * np.random.default_rng(0).random(500) * (np.arange(500) % 5 == 1))


def read_at(beginnings):
    even = EvenReadingTimes(0.01)
    return np.array([even.next(t) for t in beginnings])


@pytest.mark.parametrize(
    ("beginnings", "times"),
    [
        (LATE, DUE),  # late cycles do not bend them
        ([0.0, 0.01, 2.0, 2.01], [0.0, 0.01, 2.0, 2.01]),  # a long pause is caught up at once
        ([0.0, 0.01, 0.0101, 0.02], [0.0, 0.01, 0.01, 0.02]),  # asked twice in one cycle
    ],
)
def test_reading_times_are_whole_periods_apart_unless_the_loop_paused(beginnings, times):
    assert np.allclose(read_at(beginnings), times)


def test_cycles_that_were_left_out_leave_a_gap_of_whole_periods():
    due = np.delete(DUE[:200], [50, 51])
    times = read_at(due)
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


def test_another_arm_needs_three_lines(tmp_path, complains):
    file = tmp_path / "ur.toml"
    with complains(InputError):
        read_topics(file)
    file.write_text(UR)
    topics = read_topics(file)
    assert topics.type is CommandKind.ARRAY
    assert topics.enabling is topics.timeout is topics.feed_forward is None


TABLES = [
    "", "[ros]\ncommand = '/a'", UR + "speed = 1", UR.replace("/joint_states", "joint_states"),
    UR.replace("Float64MultiArray", "String"), UR + "mode = 'torque'", UR + "command_timeout = 5",
    UR + "command_timeout = nan", "[ros",
]  # fmt: skip


@pytest.mark.parametrize("text", TABLES)
def test_a_bad_table_is_explained(tmp_path, text, complains):
    file = tmp_path / "arm.toml"
    file.write_text(text)
    with complains(InputError):
        read_topics(file)


def test_positions_are_found_in_anybodys_command():
    assert commanded_positions({"command": [1.0]}, CommandKind.JOINT_COMMAND) == (1.0,)
    assert commanded_positions({"data": [1.0]}, CommandKind.ARRAY) == (1.0,)
    assert commanded_positions({"points": [{"positions": [2.0]}, {"positions": [1.0]}]}, CommandKind.TRAJECTORY) == (
        1.0,
    )
    assert commanded_positions({}, CommandKind.TRAJECTORY) == ()
