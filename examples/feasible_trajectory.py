"""Is a trajectory feasible on the arm? Position, speed, acceleration, jerk, torque, collisions: which limit, when.

Baxter's arm goes from one posture to another in 3 s, then in 0.5 s; the second one asks for too much.
"""

import numpy as np

import urdf
from pipeline.motion.feasibility import CheckSettings, FeasibilityReport, check_joints
from pipeline.motion.trajectory import JointTrajectory


def move(arm: urdf.Robot, start: np.ndarray, end: np.ndarray, seconds: float, rate: float = 100.0) -> JointTrajectory:
    """From rest to rest along a polynomial of degree 7, whose jerk begins and ends at zero."""
    t = np.arange(0.0, seconds + 0.5 / rate, 1.0 / rate)
    shape = np.polynomial.Polynomial([0, 0, 0, 0, 35, -84, 70, -20])
    q, v, a = (np.outer(shape.deriv(k)(t / seconds), end - start) / seconds**k for k in range(3))
    return JointTrajectory(t, start + q, v, a, arm.joint_names)


def main() -> dict[float, FeasibilityReport]:
    """Reports by duration, s."""
    arm = urdf.load("baxter")
    start = arm.home
    end = start + np.array([0.4, 0.3, 0.0, -0.3, 0.2, 0.3, 0.0])
    settings = CheckSettings(load_mass=0.5)  # kg in the hand

    reports = {}
    for seconds in (3.0, 0.5):
        found = check_joints(arm, move(arm, start, end, seconds), settings)
        reports[seconds] = found
        print(f"in {seconds:g} s: {found.sentence}")
        for violation in found.violations[:3]:
            print(f"  {violation}")
        print(f"  closest: {found.tightest.joint}, {found.tightest}")
    return reports


if __name__ == "__main__":
    main()
