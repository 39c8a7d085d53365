import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.motion.gate import CONTROL_PERIOD_SECONDS, LIMIT_TOLERANCE_SHARE
from pipeline.motion.transitions import BRAKING_SHARE_OF_JOINT_LIMITS, BrakingMotion

from .lines import TWO_JOINTS as LIMITS

share = st.floats(-1.0, 1.0)


@settings(max_examples=200)
@given(st.tuples(share, share), st.tuples(share, share))
def test_every_joint_comes_to_rest_with_bounded_acceleration_and_jerk(speeds, pulls):
    start = np.zeros(2), np.array(speeds) * LIMITS.velocity, np.array(pulls) * LIMITS.acceleration
    brake = BrakingMotion(start, LIMITS)
    for given_, found in zip(start, brake.state_at(0.0), strict=True):
        assert np.allclose(found, given_, atol=1e-9)
    time = np.arange(0.0, brake.duration + 0.05, CONTROL_PERIOD_SECONDS)
    q, v, a = (np.array(part) for part in zip(*(brake.state_at(t) for t in time), strict=True))
    assert brake.duration < 1.0
    assert np.all(v[-1] == 0.0)
    assert np.all(a[-1] == 0.0)
    assert np.array_equal(q[-1], brake.state_at(1e3)[0])
    assert np.all(np.abs(a) <= np.maximum(BRAKING_SHARE_OF_JOINT_LIMITS * LIMITS.acceleration, np.abs(start[2])) + 1e-9)
    assert np.all(
        np.abs(np.diff(a, axis=0)) / CONTROL_PERIOD_SECONDS
        <= (BRAKING_SHARE_OF_JOINT_LIMITS + LIMIT_TOLERANCE_SHARE) * LIMITS.jerk
    )
    within = np.abs(v[:-1]).max(axis=0, initial=0.0) * CONTROL_PERIOD_SECONDS + 1e-6
    assert np.all(np.abs(np.diff(q, axis=0)) <= within + 0.5 * LIMITS.acceleration * CONTROL_PERIOD_SECONDS**2)


def test_an_arm_that_stands_stays_where_it_is():
    brake = BrakingMotion((np.array([0.3, -0.2]), np.zeros(2), np.zeros(2)), LIMITS)
    assert brake.duration == 0.0
    for time in (0.0, 0.01, 5.0):
        assert np.array_equal(brake.state_at(time), [[0.3, -0.2], [0.0, 0.0], [0.0, 0.0]])
