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
    """Read with the steps of an encoder, and held by dry friction, it stands there for a while."""
    time = np.arange(0.0, 40.0, 1.0 / 30.0)
    slow = 0.3 * np.sin(0.9 * time) + 0.25 * np.sin(0.9 * np.sqrt(5.0) * time)
    held, q = slow[0], np.empty(len(time))
    for k, place in enumerate(slow):
        held = np.clip(held, place - 0.01, place + 0.01)  # what dry friction leaves of a command
        q[k] = held
    step = 2.0 * np.pi / 4096.0
    assert not sticks(time, q=(np.round(q / step) * step)[:, None])
