"""What stands around the arm, and how far the arm and the hanging load keep from it."""

from __future__ import annotations

from dataclasses import dataclass

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

import urdf

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Obstacle:
    """A block that stands still.

    Attributes:
        name: for messages.
        centre: (3,) in the robot's base frame [m].
        size: edge lengths (3,) [m].
        rotation: of the block in the base frame (3, 3).
    """

    name: str
    centre: Array
    size: Array
    rotation: Array


def box_and_table(
    line: urdf.Line,
    near_wall: float,
    width: float,
    depth: float,
    rim: float,
    height: float,
    wall: float,
) -> tuple[Obstacle, ...]:
    """An open box on a table, under the line.

    Args:
        line: of the tool point.
        near_wall: line coordinate of the middle of its near wall [m].
        width: between the middles of near and far wall [m].
        depth: between the middles of the other two walls [m].
        rim: how far its rim is below the line [m].
        height: from the inner floor to the rim [m].
        wall: thickness [m].

    Returns:
        Four walls, the floor and the table top.
    """
    along = np.asarray(line.direction, dtype=float)
    up = np.array([0.0, 0.0, 1.0])
    rotation = np.column_stack([along, np.cross(up, along), up])
    rim_middle = np.asarray(line.origin) + (near_wall + width / 2.0) * along - rim * up

    def block(name: str, offset: tuple[float, float, float], size: tuple[float, float, float]) -> Obstacle:
        return Obstacle(name, rim_middle + rotation @ np.array(offset), np.array(size), rotation)

    deep, floor = height / 2.0, height + wall / 2.0
    sides = [
        block(f"box {name} wall", (x, y, -deep), size)
        for name, x, y, size in (
            ("near", -width / 2.0, 0.0, (wall, depth + wall, height)),
            ("far", width / 2.0, 0.0, (wall, depth + wall, height)),
            ("front", 0.0, -depth / 2.0, (width, wall, height)),
            ("back", 0.0, depth / 2.0, (width, wall, height)),
        )
    ]
    bottom = block("box floor", (0.0, 0.0, -floor), (width + wall, depth + wall, wall))
    thickness = 0.04
    table = block("table", (0.0, 0.0, -height - wall - thickness / 2.0), (1.6, 0.7, thickness))
    return (*sides, bottom, table)


class Surroundings:
    """Distances between the arm, what stands around it, and the string with its load.

    Meshes are replaced by their convex hulls, which contain them: the distances err on the safe side.

    Args:
        robot: the arm.
        obstacles: blocks that stand still.
    """

    def __init__(self, robot: urdf.Robot, obstacles: tuple[Obstacle, ...] = ()) -> None:
        full = pin.buildModelFromXML(robot.urdf_xml)
        shapes = pin.buildGeomFromUrdfString(
            full, robot.urdf_xml, pin.GeometryType.COLLISION, package_dirs=[str(path) for path in robot.package_dirs]
        )
        locked = [index for index in range(1, full.njoints) if full.names[index] not in robot.joint_names]
        self._model, reduced = pin.buildReducedModel(full, shapes, locked, pin.neutral(full))
        self._data = self._model.createData()
        tool = robot.model.frames[robot.tool_frame_id]
        self._tool_joint = int(tool.parentJoint)
        self._tool_point = tool.placement.act(np.asarray(robot.tool_offset))
        self._parts = [
            (shape.name.rpartition("_")[0], int(shape.parentJoint), shape.placement.copy(), _hull(shape.geometry))
            for shape in reduced.geometryObjects
            if shape.parentJoint > 0
        ]
        self._obstacles = [
            (o.name, coal.Box(*map(float, o.size)), coal.Transform3s(o.rotation, np.asarray(o.centre, dtype=float)))
            for o in obstacles
        ]
        self._request, self._result = coal.DistanceRequest(), coal.DistanceResult()

    def clearance(self, q: Array) -> tuple[float, str]:
        """Smallest distance between the arm and an obstacle at a posture.

        Args:
            q: (n,) [rad].

        Returns:
            Distance, 0 or less where they touch [m], and which two.
        """
        self._place(q)
        best, names = np.inf, ""
        for part, joint, placement, shape in self._parts:
            pose = _transform(self._data.oMi[joint] * placement)
            for name, box, place in self._obstacles:
                distance = self._distance(shape, pose, box, place)
                if distance < best:
                    best, names = distance, f"{part} - {name}"
        return best, names

    def swing_clearance(self, q: Array, along: Array, angle: float, length: float, radius: float) -> tuple[float, str]:
        """Smallest distance between the hanging load with its string and the arm.

        The load is held against every link. The string is held against all but the hand, on which it hangs.

        Args:
            q: posture (n,) [rad].
            along: unit vector of the line (3,).
            angle: of the swing, 0 hanging; the load is at ``-l sin(angle)`` along the line [rad].
            length: of the string, to the load's centre [m].
            radius: of the load [m].

        Returns:
            Distance [m], and to which link.
        """
        self._place(q)
        top = self._data.oMi[self._tool_joint].act(self._tool_point)
        hanging = -np.sin(angle) * along - np.cos(angle) * np.array([0.0, 0.0, 1.0])
        load, load_pose = coal.Sphere(radius), coal.Transform3s(np.eye(3), top + length * hanging)
        string = coal.Capsule(1e-3, length)
        # A capsule lies along its z axis, about its middle.
        aside = np.cross(along, [0.0, 0.0, 1.0])
        turned = np.column_stack([np.cross(aside, hanging), aside, hanging])
        string_pose = coal.Transform3s(turned, top + length / 2.0 * hanging)
        best, names = np.inf, ""
        for part, joint, placement, shape in self._parts:
            pose = _transform(self._data.oMi[joint] * placement)
            distance = self._distance(shape, pose, load, load_pose)
            if joint != self._tool_joint:
                distance = min(distance, self._distance(shape, pose, string, string_pose))
            if distance < best:
                best, names = distance, part
        return best, names

    def _place(self, q: Array) -> None:
        pin.forwardKinematics(self._model, self._data, np.asarray(q, dtype=float))

    def _distance(
        self, a: coal.CollisionGeometry, at_a: coal.Transform3s, b: coal.CollisionGeometry, at_b: coal.Transform3s
    ) -> float:
        self._result.clear()
        return float(coal.distance(a, at_a, b, at_b, self._request, self._result))


def _hull(shape: coal.CollisionGeometry) -> coal.CollisionGeometry:
    if not isinstance(shape, coal.BVHModelBase):
        return shape
    # `buildConvexRepresentation` would only reinterpret the triangles; this one computes a hull.
    shape.buildConvexHull(True, "Qt")
    return shape.convex


def _transform(pose: pin.SE3) -> coal.Transform3s:
    return coal.Transform3s(pose.rotation, pose.translation)
