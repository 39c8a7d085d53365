import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from armdyn.errors import InputError, TaskFailedError
from pipeline.motion import LineState, motion_to_finish_over_box
from pipeline.motion.finish import point_to_point_motion

from .lines import DT, baxter_limits, is_one_motion, worst_excess

LIMITS = baxter_limits()


def test_finish_ends_at_rest_over_the_box_and_uses_its_share_of_the_limits_and_no_more():
    move = motion_to_finish_over_box(LineState(0.13, 0.26, 0.5), 0.46, LIMITS, DT)
    assert (move[0], move.end) == ((0.13, 0.26, 0.5), (0.46, 0.0, 0.0))
    share = np.abs(move.v) / np.interp(move.s, LIMITS.s, LIMITS.speed)
    assert 0.68 < share.max() <= 0.70
    assert 7.5 < np.abs(move.a).max() <= 8.0
    assert worst_excess(LIMITS, move) < 1e-9


def test_finish_rides_the_limit_instead_of_the_slowest_place():
    move = motion_to_finish_over_box(LineState(-0.2), 0.46, LIMITS, DT)
    # At a constant speed it cannot pass s = 0.43, 8 m/s^2 before the end, faster than that place allows.
    constant = 0.70 * np.interp(0.43, LIMITS.s, LIMITS.speed)
    assert move.time[-1] < 0.95 * 0.66 / constant


def test_finish_from_faster_than_its_share_comes_down_within_the_whole_limit():
    move = motion_to_finish_over_box(LineState(0.1, 0.95, 0.0), 0.46, LIMITS, DT)
    assert move.end == (0.46, 0.0, 0.0)
    assert worst_excess(LIMITS, move) < 1e-9


def test_a_finish_out_of_reach_and_a_start_that_cannot_be_stopped_are_refused(complains):
    with complains(InputError):
        motion_to_finish_over_box(LineState(0.1), 0.7, LIMITS, DT)
    with complains(TaskFailedError):
        motion_to_finish_over_box(LineState(0.54, 0.4, 5.0), 0.46, LIMITS, DT)


@settings(max_examples=60)
@given(start=st.floats(-0.25, 0.5), end=st.floats(-0.3, 0.55), v=st.floats(-0.35, 0.35), a=st.floats(-3.0, 3.0))
def test_every_move_is_one_motion_within_the_limits(start, end, v, a):
    try:
        move = point_to_point_motion(LineState(start, v, a), end, LIMITS, DT)
    except TaskFailedError:
        assert min(0.55 - start, start + 0.3) < 0.1
        return
    assert move.end == (end, 0.0, 0.0)
    assert worst_excess(LIMITS, move) < 1e-9
    assert is_one_motion(list(move), LIMITS.jerk)
