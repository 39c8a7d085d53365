"""Motions of the tool along the robot's line: planning, smoothing and checking against the limits.

The motions are functions of the line coordinate ``s`` [m] of the tool (positive to the robot's left), so that no motion
can leave the line. An IK table of the package `ik` converts them to joint positions.
"""

from pipeline.motion.finish import motion_to_finish_over_box
from pipeline.motion.gate import JointCommandCheck, LineReferenceCheck
from pipeline.motion.limits import LineLimits
from pipeline.motion.smoother import LineSmoother
from pipeline.motion.trajectory import LineState, LineTrajectory

__all__ = [
    "JointCommandCheck",
    "LineLimits",
    "LineReferenceCheck",
    "LineSmoother",
    "LineState",
    "LineTrajectory",
    "motion_to_finish_over_box",
]
