"""The gate that remembers its stream, as every command to a real arm passes it."""

import math

import numpy as np
import pytest

import urdf
from pipeline.motion.gate import FRESH, GAP, NEAR, PERIOD, StreamGate, Withheld
from pipeline.robot.protocol import JointState

NAMES = ("a", "b")
LIMITS = urdf.Limits(
    lower=np.array([-1.0, -2.0]),
    upper=np.array([1.0, 2.0]),
    velocity=np.array([1.5, 4.0]),
    acceleration=np.array([20.0, 40.0]),
    jerk=np.array([1000.0, 2000.0]),
    effort=np.array([50.0, 15.0]),
)
REST = np.zeros(2)


def at(q, time=0.0):
    return JointState(time, np.array(q, dtype=float), REST, REST)


def smooth(k, reach=0.3, duration=0.8):
    """Minimum-jerk motion of joint a: peak 0.70 rad/s, 2.7 rad/s^2, 35 rad/s^3."""
    u = min(k * PERIOD / duration, 1.0)
    q = reach * u**3 * (10 - 15 * u + 6 * u * u)
    v = reach * 30 * u**2 * (1 - u) ** 2 / duration
    a = reach * 60 * u * (1 - u) * (1 - 2 * u) / duration**2
    return np.array([q, 0.0]), np.array([v, 0.0]), np.array([a, 0.0])


def follow(gate, cycles, start=0):
    """The commands of the smooth motion, the arm following at once; the refusals."""
    refusals = []
    for k in range(start, start + cycles):
        q, v, a = smooth(k)
        refusals.append(gate.judge(q, v, a, at(q, k * PERIOD), k * PERIOD))
    return refusals


def judge(gate, q, v=REST, a=REST, state=None, now=0.0):
    refusal = gate.judge(
        np.array(q, dtype=float), np.array(v), np.array(a), at(q, now) if state is None else state, now
    )
    return refusal.why if refusal else None


def test_a_smooth_motion_passes():
    assert follow(StreamGate(NAMES, LIMITS), 120) == [None] * 120


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("place", range(3))
def test_what_is_not_finite_never_leaves(bad, place):
    gate = StreamGate(NAMES, LIMITS)
    vectors = [np.zeros(2) for _ in range(3)]
    vectors[place][1] = bad
    assert gate.judge(*vectors, at(REST), 0.0).why is Withheld.NOT_A_NUMBER


def test_the_number_of_joints_must_be_right():
    gate = StreamGate(NAMES, LIMITS)
    assert gate.judge(np.zeros(3), np.zeros(3), np.zeros(3), at(REST), 0.0).why is Withheld.WRONG_NUMBER


def test_nothing_is_sent_without_a_state_or_with_an_old_one():
    gate = StreamGate(NAMES, LIMITS)
    assert gate.judge(REST, REST, REST, None, 0.0).why is Withheld.NO_STATE
    assert judge(gate, REST, state=at(REST, 0.0), now=FRESH + 0.001) is Withheld.STALE
    assert judge(gate, REST, state=at(REST, math.nan), now=0.0) is Withheld.STALE
    assert judge(gate, REST, state=at(REST, 0.0), now=FRESH - 0.001) is None


def test_a_state_that_grows_old_stops_a_motion_at_once():
    gate = StreamGate(NAMES, LIMITS)
    follow(gate, 40)
    frozen = at(smooth(39)[0], 39 * PERIOD)
    refused = [gate.judge(*smooth(k), frozen, k * PERIOD) for k in range(40, 46)]
    assert [r.why if r else None for r in refused] == [None] * 5 + [Withheld.STALE]


def test_a_stream_begins_where_the_arm_is_and_at_rest():
    assert judge(StreamGate(NAMES, LIMITS), [NEAR + 0.001, 0.0], state=at(REST)) is Withheld.ELSEWHERE
    assert judge(StreamGate(NAMES, LIMITS), REST, v=[0.1, 0.0]) is Withheld.ELSEWHERE
    assert judge(StreamGate(NAMES, LIMITS), [NEAR / 2, 0.0], state=at(REST)) is None


def test_a_motion_that_paused_does_not_go_on():
    gate = StreamGate(NAMES, LIMITS)
    follow(gate, 40)
    later = 39 * PERIOD + GAP + 0.001
    q, v, a = smooth(40)
    assert gate.judge(q, v, a, at(q, later), later).why is Withheld.GAP


def test_a_stream_that_paused_at_rest_begins_anew_where_the_arm_is():
    gate = StreamGate(NAMES, LIMITS)
    follow(gate, 100)
    q = smooth(100)[0]
    assert judge(gate, q, now=5.0) is None
    assert judge(gate, q, state=at(q + 0.1, 9.0), now=9.0) is Withheld.ELSEWHERE


def test_the_arm_must_be_near_its_command():
    gate = StreamGate(NAMES, LIMITS, tracking=0.2)
    follow(gate, 40)
    q, v, a = smooth(40)
    assert gate.judge(q, v, a, at(q + np.array([0.0, 0.21]), 0.4), 0.4).why is Withheld.TRACKING


@pytest.mark.parametrize(
    ("step", "why"),
    [
        (0.0155, Withheld.VELOCITY),  # 1.55 of 1.5 rad/s
        (0.0045, Withheld.ACCELERATION),  # 45 of 20 rad/s^2
        (0.0015, Withheld.JERK),  # 15 rad/s^2 from one cycle to the next: 1500 of 1000 rad/s^3
        (0.0009, None),  # 900 rad/s^3
    ],
)
def test_a_step_is_held_against_the_limits(step, why):
    gate = StreamGate(NAMES, LIMITS)
    for k in range(5):
        assert judge(gate, REST, now=k * PERIOD) is None
    assert judge(gate, [step, 0.0], now=5 * PERIOD) is why


@pytest.mark.parametrize(
    ("place", "value", "why"),
    [(1, 1.6, Withheld.VELOCITY), (2, 20.5, Withheld.ACCELERATION), (1, 1.49, None), (2, 19.9, None)],
)
def test_feed_forward_is_held_against_the_limits(place, value, why):
    gate = StreamGate(NAMES, LIMITS)
    judge(gate, REST)
    vectors = [REST, REST.copy(), REST.copy()]
    vectors[place][0] = value
    refusal = gate.judge(*vectors, at(REST, PERIOD), PERIOD)
    assert (refusal.why if refusal else None) is why


def test_no_joint_leaves_its_range():
    gate = StreamGate(NAMES, LIMITS)
    q = np.array([1.0 + 1e-6, 0.0])
    assert gate.judge(q, REST, REST, at(q), 0.0).why is Withheld.POSITION


def test_a_refusal_names_joint_and_values():
    gate = StreamGate(NAMES, LIMITS)
    judge(gate, REST)
    assert "a: 2 of 1.5 rad/s" in gate.judge(np.array([0.02, 0.0]), REST, REST, at(REST, 0.01), 0.01).sentence


def test_a_refused_command_does_not_count_as_sent():
    gate = StreamGate(NAMES, LIMITS)
    follow(gate, 40)
    assert judge(gate, [0.9, 0.0], state=at(smooth(39)[0], 0.4), now=0.4) is Withheld.TRACKING
    q, v, a = smooth(40)
    assert gate.judge(q, v, a, at(q, 0.4), 0.4) is None
