"""Which robot: its URDF found, validated and mended, and what a URDF cannot say.

Everything is loaded when it is first asked for (PEP 562): a command that reads no robot does not wait for Pinocchio.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from urdf.collision import Clearance, CollisionModel
    from urdf.loader import known_robots, load
    from urdf.robot import Limits, Line, Robot, Spring, UrdfError

_FILES = {
    "Clearance": "collision", "CollisionModel": "collision", "known_robots": "loader", "load": "loader",
    "Limits": "robot", "Line": "robot", "Robot": "robot", "Spring": "robot", "UrdfError": "robot",
}  # fmt: skip
"""Where each name is defined."""
__all__ = ["Clearance", "CollisionModel", "Limits", "Line", "Robot", "Spring", "UrdfError", "known_robots", "load"]


def __getattr__(name: str) -> Any:
    if name not in _FILES:
        raise AttributeError(f"module 'urdf' has no attribute '{name}'")
    found = getattr(import_module(f"urdf.{_FILES[name]}"), name)
    globals()[name] = found
    return found
