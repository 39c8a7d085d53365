"""Inverse kinematics along a path: the joint positions that move the tool on it, stored in a table."""

from ik.build import build_line_table, build_path_table, default_table
from ik.errors import StaleTableError, UnreachableError
from ik.path import CirclePath, Path, SplinePath
from ik.pathfile import read_path
from ik.table import JointMotion, LineTable, PathTable, Posture, load

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
    "load",
    "read_path",
]


def __dir__() -> list[str]:
    return sorted(__all__)
