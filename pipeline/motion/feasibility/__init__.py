"""Feasibility: is a motion within every limit of the arm, and if not, which limit, which joint, when."""

from pipeline.motion.feasibility.check import check_joints, check_line
from pipeline.motion.feasibility.settings import CheckSettings, Obstacle, Swing, box_and_table
from pipeline.motion.feasibility.verdict import FeasibilityReport, Margin, Violation

__all__ = [
    "CheckSettings",
    "FeasibilityReport",
    "Margin",
    "Obstacle",
    "Swing",
    "Violation",
    "box_and_table",
    "check_joints",
    "check_line",
]
