"""A joint that friction holds at one place sticks; one that turns round, or waits for its command, does not."""

import numpy as np
import pytest

from armdyn.inspection.inspect import inspect_runs
from armdyn.run import Run

RATE, SPEED, PASSES = 100.0, 0.5, 6  # Hz, rad/s


def passing(seconds):
    """Times and positions of a joint that goes from 0 to 1 rad and back, and stands at .5 rad so long, s."""
    corners = [(0.0, 0.0)]
    for k in range(PASSES):
        begin = corners[-1][0]
        corners += [(begin + 0.5 / SPEED, 0.5), (begin + 0.5 / SPEED + seconds, 0.5)]
        corners.append((begin + 1.0 / SPEED + seconds, float(k % 2 == 0)))
    time = np.arange(0.0, corners[-1][0], 1.0 / RATE)
    return time, np.interp(time, *zip(*corners, strict=True))


def sticks(time, **channels):
    found = inspect_runs([Run.from_arrays(time, channels, joints=["a"], name="run")])
    return any(check.kind == "sticking" for check in found.checks)


@pytest.mark.parametrize(("waits", "wrong"), [(None, True), (False, True), (True, False)],
                         ids=["no command is recorded", "its command goes on", "its command waits"])  # fmt: skip
def test_a_joint_that_stands_in_every_pass_sticks_unless_its_command_stands(waits, wrong):
    time, q = passing(0.6)
    command = q if waits else np.interp(time, *passing(0.0), period=time[-1])
    assert sticks(time, q=q[:, None], **({} if waits is None else {"q_cmd": command[:, None]})) == wrong


def test_a_joint_that_stands_where_it_turns_round_does_not_stick():
    """It comes to one place in the middle of its range four times, stands, and goes back."""
    corners = [(0.0, 0.0)]
    for _ in range(4):
        begin = corners[-1][0]
        corners += [(begin + 0.5 / SPEED, 0.5), (begin + 0.5 / SPEED + 0.6, 0.5), (begin + 1.0 / SPEED + 0.6, 0.0)]
    begin = corners[-1][0]
    corners += [(begin + 1.0 / SPEED, 1.0), (begin + 2.0 / SPEED, 0.0)]
    time = np.arange(0.0, corners[-1][0], 1.0 / RATE)
    assert not sticks(time, q=np.interp(time, *zip(*corners, strict=True))[:, None])
