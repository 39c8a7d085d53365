"""Load robots: find, validate and mend a URDF, and add the properties that a URDF cannot contain.

Modules are imported at first use (PEP 562), so that a command that reads no robot does not wait for Pinocchio.
"""

from typing import TYPE_CHECKING

from urdf.lazy import lazy_getattr

if TYPE_CHECKING:
    from urdf.collision import Clearance, CollisionModel
    from urdf.loader import known_robots, load
    from urdf.robot import DescriptionWarning, Limits, Line, Robot, Spring, UrdfError

__all__ = [
    "Clearance", "CollisionModel", "DescriptionWarning", "Limits", "Line", "Robot", "Spring", "UrdfError",
    "known_robots", "load",
]  # fmt: skip
__getattr__ = lazy_getattr(
    __name__,
    {
        **dict.fromkeys(("Clearance", "CollisionModel"), "urdf.collision"),
        **dict.fromkeys(("known_robots", "load"), "urdf.loader"),
        **dict.fromkeys(("DescriptionWarning", "Limits", "Line", "Robot", "Spring", "UrdfError"), "urdf.robot"),
    },
)


def __dir__() -> list[str]:
    return sorted(__all__)
