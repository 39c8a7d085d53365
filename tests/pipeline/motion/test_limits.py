"""What the limits of a line allow, at any place, speed and acceleration of theirs, the arm has torque for."""

import numpy as np
import pytest

from ik.torque import JointTorque
from pipeline.motion import LineLimits
from pipeline.motion.gate import LIMIT_TOLERANCE_SHARE


@pytest.mark.parametrize("load", [0.0, 0.08, 0.5])
def test_the_motors_suffice_for_whatever_the_limits_allow(robot, table, load):
    torque = JointTorque(robot, load)

    def largest(limits):
        """Share of a torque limit."""
        shares, s = [], np.linspace(limits.s_min, limits.s_max, 1001)
        for speed in np.linspace(-1.0, 1.0, 41):
            for way in (-1.0, 1.0):
                motion = table.joint_motion(s, speed * limits.speed_at(s), way * limits.acceleration_at(s))
                shares.append(np.max(np.abs(torque(*motion)) / robot.limits.effort))
        return max(shares)

    limits = LineLimits.from_table(table, torque)
    assert largest(limits) < 1.0 + LIMIT_TOLERANCE_SHARE
    assert largest(LineLimits.from_table(table)) > 1.05
    assert (
        limits.min_acceleration_limit == LineLimits.from_table(table).min_acceleration_limit
    )  # where joints are the limit, they stay it
