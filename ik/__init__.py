"""From a line in space to a saved table of postures: inverse kinematics on SE(3) and Jacobians."""

from ik.build import build_line_table, default_table
from ik.errors import StaleTableError, UnreachableError
from ik.table import JointMotion, LineTable, Posture

__all__ = [
    "JointMotion",
    "LineTable",
    "Posture",
    "StaleTableError",
    "UnreachableError",
    "build_line_table",
    "default_table",
]
