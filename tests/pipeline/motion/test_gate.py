"""What each gate lets through, and why it refuses the rest; `test_gate_properties` tries everything else."""

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from pipeline.motion import (
    JointCommandCheck,
    LineLimits,
    LineReferenceCheck,
    LineSmoother,
    LineState,
    motion_to_finish_over_box,
)
from pipeline.motion.gate import (
    CONTROL_PERIOD_SECONDS,
    MAX_STATE_AGE_SECONDS,
    MAX_STREAM_START_OFFSET,
    NEW_STREAM_PAUSE_SECONDS,
    CommandRefusalReason,
    CommandStreamCheck,
)
from pipeline.motion.transitions import minimum_jerk
from pipeline.robot.protocol import JointState

from .lines import TWO_JOINTS

REST = np.zeros(2)


@pytest.fixture(scope="module")
def line_gate(robot, table):
    return LineReferenceCheck(LineLimits.from_table(table), table, JointCommandCheck(robot.joint_names, robot.limits))


def why(refusal):
    return refusal.reason if refusal else None


def test_what_the_smoother_makes_of_noise_and_the_finish_pass_every_cycle(line_gate):
    rng = np.random.default_rng(3)
    smoother = LineSmoother(line_gate.limits, CONTROL_PERIOD_SECONDS, LineState(0.0))
    noise = [LineState(*map(float, rng.normal(0.0, [0.4, 1.0, 5.0]))) for _ in range(300)]
    smoothed = [smoother.state, *map(smoother.update, noise)]
    finish = motion_to_finish_over_box(LineState(0.13, 0.2), 0.46, line_gate.limits, CONTROL_PERIOD_SECONDS)
    for motion in (smoothed, finish):
        assert {line_gate.check(after, before) for before, after in pairwise(motion)} == {None}


@pytest.mark.parametrize(
    ("reference", "before", "reason"),
    [
        (LineState(math.nan), None, CommandRefusalReason.NOT_A_NUMBER),
        (LineState(0.0, math.inf), None, CommandRefusalReason.NOT_A_NUMBER),
        (LineState(0.5501), None, CommandRefusalReason.OFF_THE_LINE),
        (LineState(-0.31), None, CommandRefusalReason.OFF_THE_LINE),
        (LineState(0.5, 0.6), None, CommandRefusalReason.LINE_SPEED),
        (LineState(0.0, 0.0, -16.0), None, CommandRefusalReason.LINE_ACCELERATION),
        (LineState(0.01), LineState(0.0), CommandRefusalReason.JUMP),
        (LineState(0.0, 0.05), LineState(0.0), CommandRefusalReason.JUMP),
        (LineState(0.0, 0.0, 3.0), LineState(0.0), CommandRefusalReason.JUMP),
    ],
)
def test_a_reference_beyond_a_limit_of_the_line_is_named(line_gate, reference, before, reason):
    assert why(line_gate.check(reference, before)) is reason


@pytest.mark.parametrize("name", ["speed", "acceleration", "jerk"])
def test_a_limit_that_is_no_number_lets_nothing_through(line_gate, name):
    unknown = replace(line_gate.limits, **{name: math.nan * getattr(line_gate.limits, name)})
    assert replace(line_gate, limits=unknown).check(LineState(0.0), LineState(0.0)) is not None


def test_joint_limits_and_where_the_arm_is_are_watched_besides_the_line(robot, table):
    generous = LineLimits(np.array([-0.3, 0.55]), np.full(2, 50.0), np.full(2, 500.0))
    gate = LineReferenceCheck(generous, table, JointCommandCheck(robot.joint_names, robot.limits))
    assert why(gate.check(LineState(0.0, 2.0))) is CommandRefusalReason.VELOCITY
    assert why(gate.check(LineState(0.0, 0.0, 100.0))) is CommandRefusalReason.ACCELERATION
    here = table.posture(0.1).q
    for measured in (here + 0.3 * np.eye(7)[3], np.full(7, math.nan)):
        assert why(gate.check(LineState(0.1), measured=measured)) is CommandRefusalReason.TRACKING
    assert gate.check(LineState(0.1), measured=here) is None


# The gate that remembers its stream, as every command to a real arm passes it.


def at(q, time=0.0):
    return JointState(time, np.array(q, dtype=float), REST, REST)


def smooth(k, reach=0.3, duration=0.8):
    """Minimum-jerk motion of joint a: peak 0.70 rad/s, 2.7 rad/s^2, 35 rad/s^3."""
    parts = minimum_jerk(np.asarray(min(k * CONTROL_PERIOD_SECONDS / duration, 1.0)), duration)
    return tuple(np.array([reach * float(part), 0.0]) for part in parts)


@pytest.fixture
def gate():
    return CommandStreamCheck(("a", "b"), TWO_JOINTS)


@pytest.fixture
def moving(gate):
    """The gate after 40 commands of the smooth motion, the arm following at once."""
    assert follow(gate, 40) == [None] * 40
    return gate


def follow(gate, cycles):
    return [judge(gate, *smooth(k), now=k * CONTROL_PERIOD_SECONDS) for k in range(cycles)]


def judge(gate, q, v=REST, a=REST, state=None, now=0.0):
    """Why the command is refused; the arm is where it is told to be, unless a state says otherwise."""
    vectors = [np.array(x, dtype=float) for x in (q, v, a)]
    return why(gate.check_next(*vectors, at(q, now) if state is None else state, now))


def test_a_smooth_motion_passes_and_begins_anew_after_a_pause_at_rest_where_the_arm_is(gate):
    assert follow(gate, 120) == [None] * 120
    q = smooth(120)[0]
    assert judge(gate, q, now=5.0) is None
    assert judge(gate, q, state=at(q + 0.1, 9.0), now=9.0) is CommandRefusalReason.ELSEWHERE


BEGINNINGS = [
    ((np.zeros(3), np.zeros(3), np.zeros(3)), {"state": at(REST)}, CommandRefusalReason.WRONG_NUMBER),
    ((REST,), {"state": at(REST, 0.0), "now": MAX_STATE_AGE_SECONDS + 0.001}, CommandRefusalReason.STALE),
    ((REST,), {"state": at(REST, math.nan)}, CommandRefusalReason.STALE),
    ((REST,), {"state": at(REST, 0.0), "now": MAX_STATE_AGE_SECONDS - 0.001}, None),
    (([MAX_STREAM_START_OFFSET + 0.001, 0.0],), {"state": at(REST)}, CommandRefusalReason.ELSEWHERE),
    (([MAX_STREAM_START_OFFSET / 2, 0.0],), {"state": at(REST)}, None),
    ((REST, [0.1, 0.0]), {}, CommandRefusalReason.ELSEWHERE),
    (([1.0 + 1e-6, 0.0],), {}, CommandRefusalReason.POSITION),
    (([0.0, math.nan],), {"state": at(REST)}, CommandRefusalReason.NOT_A_NUMBER),
    ((REST, REST, [0.0, math.inf]), {}, CommandRefusalReason.NOT_A_NUMBER),
]


@pytest.mark.parametrize(("command", "options", "reason"), BEGINNINGS)
def test_a_stream_begins_at_rest_where_the_arm_is_known_to_be(gate, command, options, reason):
    assert judge(gate, *command, **options) is reason
    assert why(gate.check_next(REST, REST, REST, None, 0.0)) is CommandRefusalReason.NO_STATE


def test_a_state_that_grows_old_stops_a_motion_at_once(moving):
    frozen = at(smooth(39)[0], 39 * CONTROL_PERIOD_SECONDS)
    refused = [judge(moving, *smooth(k), state=frozen, now=k * CONTROL_PERIOD_SECONDS) for k in range(40, 46)]
    assert refused == [None] * 5 + [CommandRefusalReason.STALE]


def test_a_motion_that_paused_does_not_go_on(moving):
    assert (
        judge(moving, *smooth(40), now=39 * CONTROL_PERIOD_SECONDS + NEW_STREAM_PAUSE_SECONDS + 0.001)
        is CommandRefusalReason.GAP
    )


def test_the_arm_must_be_near_its_command_and_a_refused_one_does_not_count_as_sent(moving):
    q, v, a = smooth(40)
    assert judge(moving, q, v, a, state=at(q + np.array([0.0, 0.21]), 0.4), now=0.4) is CommandRefusalReason.TRACKING
    assert judge(moving, [0.9, 0.0], state=at(smooth(39)[0], 0.4), now=0.4) is CommandRefusalReason.TRACKING
    assert judge(moving, q, v, a, now=0.42) is None  # 20 ms late: judged as if it had come on time


@pytest.mark.parametrize(
    ("step", "v", "a", "reason"),
    [
        (0.0155, 0.0, 0.0, CommandRefusalReason.VELOCITY),  # 1.55 of 1.5 rad/s
        (0.0045, 0.0, 0.0, CommandRefusalReason.ACCELERATION),  # 45 of 20 rad/s^2
        (0.0015, 0.0, 0.0, CommandRefusalReason.JERK),  # 15 rad/s^2 from one cycle to the next: 1500 of 1000 rad/s^3
        (0.0009, 0.0, 0.0, None),  # 900 rad/s^3
        (0.0, 1.6, 0.0, CommandRefusalReason.VELOCITY),  # and what goes along as feed-forward
        (0.0, 0.0, 20.5, CommandRefusalReason.ACCELERATION),
        (0.0, 1.49, 19.9, None),
    ],
)
def test_a_command_is_held_against_the_limits(gate, step, v, a, reason):
    for k in range(5):
        assert judge(gate, REST, now=k * CONTROL_PERIOD_SECONDS) is None
    assert judge(gate, [step, 0.0], [v, 0.0], [a, 0.0], state=at(REST, 0.05), now=5 * CONTROL_PERIOD_SECONDS) is reason


def test_a_motion_that_is_sent_ten_times_as_fast_is_refused_with_the_time_between_its_commands(gate):
    said = [
        gate.check_next(*smooth(k), at(smooth(k)[0], k * CONTROL_PERIOD_SECONDS / 10), k * CONTROL_PERIOD_SECONDS / 10)
        for k in range(40)
    ]
    first = next(refusal for refusal in said if refusal is not None)
    assert "1 ms after the command before" in first.sentence
