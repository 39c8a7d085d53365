"""Check the feasibility of a motion: whether it is within every limit of the arm, and else which, where and when."""

from pipeline.motion.feasibility.check import CheckSettings, check_joints, check_line
from pipeline.motion.feasibility.clearance import Obstacle, PlannedSwing, box_and_table_obstacles
from pipeline.motion.feasibility.verdict import FeasibilityReport, LimitMargin

__all__ = [
    "CheckSettings",
    "FeasibilityReport",
    "LimitMargin",
    "Obstacle",
    "PlannedSwing",
    "box_and_table_obstacles",
    "check_joints",
    "check_line",
]
