"""Which robot: its URDF found, validated and mended, and what a URDF cannot say."""

from urdf.collision import Clearance, CollisionModel
from urdf.load import known_robots, load
from urdf.robot import Limits, Line, Robot, Spring, UrdfError

__all__ = ["Clearance", "CollisionModel", "Limits", "Line", "Robot", "Spring", "UrdfError", "known_robots", "load"]
