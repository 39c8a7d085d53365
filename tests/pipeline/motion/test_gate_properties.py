"""Whatever is asked of the gates, no stream of commands that leaves them breaks a limit."""

import math

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from pipeline.motion import JointCommandCheck, LineLimits, LineReferenceCheck, LineState
from pipeline.motion.gate import (
    CONTROL_PERIOD_SECONDS,
    MAX_JOINT_SPEED_AT_REST,
    MAX_STATE_AGE_SECONDS,
    MAX_STREAM_START_OFFSET,
    NEW_STREAM_PAUSE_SECONDS,
    CommandStreamCheck,
)
from pipeline.robot.protocol import JointState

from .lines import TWO_JOINTS as LIMITS

TRACKING = 0.2
MORE = 1.001
"""The share for rounding that both gates allow."""
NUMBERS = st.one_of(st.floats(-3.0, 3.0), st.sampled_from([math.nan, math.inf, -math.inf, 1e300, 0.0]))

asked = st.fixed_dictionaries(
    {
        "jerk": st.one_of(st.sampled_from([0.0, 0.9, -0.9, 1.01]), st.floats(-2.5, 2.5)),  # of the limit
        "other": st.one_of(st.none(), st.none(), st.none(), NUMBERS),  # in place of that, for one joint
        "v": st.one_of(st.none(), st.none(), NUMBERS),
        "a": st.one_of(st.none(), st.none(), NUMBERS),
        "wait": st.sampled_from([CONTROL_PERIOD_SECONDS] * 12 + [0.0, 1e-4, 1e-3, 0.007, 0.03, 0.049, 0.051, 0.5]),
        "age": st.sampled_from([0.0] * 9 + [0.04, 0.06, math.nan]),
        "times": st.sampled_from([1, 1, 2, 4, 8]),
        "behind": st.sampled_from([0.0] * 8 + [0.01, 0.19, 0.21, math.nan]),
    }
)


@settings(max_examples=150, suppress_health_check=[HealthCheck.too_slow])
@given(st.lists(asked, min_size=1, max_size=30))
def test_no_stream_of_commands_that_leaves_breaks_a_limit(stream):
    gate = CommandStreamCheck(("a", "b"), LIMITS)
    sent, spacings, at, now = [np.zeros(2)] * 3, [CONTROL_PERIOD_SECONDS] * 3, 0.0, 0.0
    assert gate.check_next(*sent, JointState(now, *sent), now) is None
    for wanted in (one for one in stream for _ in range(one["times"])):
        now += wanted["wait"]
        q = following(sent, spacings, min(max(now - at, 1e-6), CONTROL_PERIOD_SECONDS), wanted["jerk"])
        if wanted["other"] is not None:
            q = np.array([wanted["other"], q[1]])
        v, a = np.zeros(2), np.zeros(2)
        v[0], a[1] = (0.0 if wanted[name] is None else wanted[name] for name in ("v", "a"))
        a *= 20.0
        state = JointState(now - wanted["age"], sent[-1] + [wanted["behind"], 0.0], np.zeros(2), np.zeros(2))
        standing = np.all(np.abs(sent[-1] - sent[-2]) <= MAX_JOINT_SPEED_AT_REST * CONTROL_PERIOD_SECONDS)
        if gate.check_next(q, v, a, state, now) is not None:
            continue
        assert np.isfinite([q, v, a]).all()
        assert wanted["age"] <= MAX_STATE_AGE_SECONDS
        assert np.all(np.abs(q - state.q) <= TRACKING)
        assert np.all((q >= LIMITS.lower) & (q <= LIMITS.upper))
        assert np.all(np.abs(v) <= MORE * LIMITS.velocity)
        assert np.all(np.abs(a) <= MORE * LIMITS.acceleration)
        if now - at > NEW_STREAM_PAUSE_SECONDS:
            assert standing  # a motion that paused does not go on
            assert np.all(np.abs(q - state.q) <= MAX_STREAM_START_OFFSET)
            assert np.all(np.abs(v) <= MAX_JOINT_SPEED_AT_REST)
            sent, spacings = [q] * 3, [CONTROL_PERIOD_SECONDS] * 3
        sent, spacings = [*sent[-3:], q], [*spacings[-2:], min(max(now - at, 1e-6), CONTROL_PERIOD_SECONDS)]
        assert_within_limits(sent, spacings)
        if now > at:
            assert np.all(np.abs(sent[-1] - sent[-2]) <= MORE * LIMITS.velocity * (now - at) + 1e-9)
        at = now


def following(sent, spacings, spacing, jerk):
    """The position that goes on from those before with a share of the limit of jerk, `spacing` s after the last."""
    v, before = ((sent[-k] - sent[-k - 1]) / spacings[-k] for k in (1, 2))
    a = (v - before) / (0.5 * (spacings[-1] + spacings[-2]))
    a = a + jerk * LIMITS.jerk * np.mean([*spacings[-2:], spacing])
    return sent[-1] + spacing * (v + 0.5 * (spacings[-1] + spacing) * a)


def assert_within_limits(sent, spacings):
    """The last of four positions or more, by divided differences over the time between them, s."""
    h = np.array(spacings)
    v = np.diff(sent[-4:], axis=0) / h[:, None]
    a = np.diff(v, axis=0) / (0.5 * (h[1:] + h[:-1]))[:, None]
    j = (a[1] - a[0]) / np.mean(h)
    for value, bound in ((v[-1], LIMITS.velocity), (a[-1], LIMITS.acceleration), (j, LIMITS.jerk)):
        assert np.all(np.abs(value) <= MORE * bound + 1e-6)


references = st.lists(
    st.tuples(
        st.one_of(st.sampled_from([0.0, 0.9, -0.9, 1.01]), st.floats(-2.0, 2.0)),  # of the limit of jerk
        st.sampled_from([1, 1, 2, 4, 8]),  # times
        st.one_of(st.none(), st.none(), st.none(), NUMBERS),  # acceleration, whatever position and speed say
        st.one_of(st.none(), st.none(), st.none(), st.tuples(NUMBERS, NUMBERS, NUMBERS)),
    ),
    min_size=1,
    max_size=30,
)


@pytest.fixture(scope="module", params=["limits of the table", "of a line on which only the joints limit"])
def line_gate(request, robot, table):
    generous = LineLimits(np.array([-0.3, 0.55]), np.full(2, 50.0), np.full(2, 500.0), 5e4)
    limits = LineLimits.from_table(table) if "table" in request.param else generous
    return LineReferenceCheck(limits, table, JointCommandCheck(robot.joint_names, robot.limits))


@settings(max_examples=50, suppress_health_check=[HealthCheck.too_slow])
@given(stream=references, start=st.floats(-0.3, 0.55))
def test_no_stream_of_references_that_passes_breaks_a_limit_of_line_or_joints(line_gate, robot, table, stream, start):
    limits, last = line_gate.limits, LineState(start)
    for jerk, pull, other in ((one[0], one[2], one[3]) for one in stream for _ in range(one[1])):
        j, h = jerk * limits.jerk, CONTROL_PERIOD_SECONDS
        s = last.s + h * last.v + h**2 / 2.0 * last.a + h**3 / 6.0 * j
        reference = LineState(s, last.v + h * last.a + h**2 / 2.0 * j, last.a + h * j)
        reference = reference if pull is None else reference._replace(a=last.a + 10.0 * pull)
        reference = reference if other is None else LineState(*other)
        measured = table.posture(float(np.clip(last.s, -0.3, 0.55))).q
        if line_gate.check(reference, last, measured) is not None:
            continue
        assert reference.is_finite
        assert limits.s_min - 1e-9 <= reference.s <= limits.s_max + 1e-9
        assert abs(reference.v) <= MORE * limits.speed_at(reference.s)
        assert abs(reference.a) <= MORE * limits.acceleration_at(reference.s)
        assert abs(reference.a - last.a) <= MORE * limits.jerk * CONTROL_PERIOD_SECONDS + 1e-9
        at = float(np.clip(reference.s, limits.s_min, limits.s_max))
        q, v, a = table.joint_motion(at, reference.v, reference.a)
        assert np.all((q >= robot.limits.lower) & (q <= robot.limits.upper))
        assert np.all(np.abs(v) <= MORE * robot.limits.velocity)
        assert np.all(np.abs(a) <= MORE * robot.limits.acceleration)
        assert np.all(np.abs(measured - q) <= TRACKING)
        last = reference
