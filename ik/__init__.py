"""From a path in space to a saved table of postures: inverse kinematics on SE(3) and Jacobians."""

from ik.build import build_line_table, build_path_table, default_table
from ik.errors import StaleTableError, UnreachableError
from ik.path import CirclePath, Path, SplinePath
from ik.pathfile import read_path
from ik.table import JointMotion, LineTable, PathTable, Posture

__all__ = [
    "CirclePath",
    "JointMotion",
    "LineTable",
    "Path",
    "PathTable",
    "Posture",
    "SplinePath",
    "StaleTableError",
    "UnreachableError",
    "build_line_table",
    "build_path_table",
    "default_table",
    "read_path",
]


def __dir__() -> list[str]:
    return sorted(__all__)
