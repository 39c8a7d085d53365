"""Distances between arm, load, string and obstacles over a motion."""

from __future__ import annotations

from collections.abc import Callable

import coal
import numpy as np
import pinocchio as pin

import urdf
from pipeline.motion.feasibility.series import SampledMotion
from pipeline.motion.feasibility.settings import CheckSettings, Obstacle, Swing
from pipeline.motion.feasibility.verdict import Bounded
from urdf.collision import collision_shapes
from urdf.robot import Array


class Surroundings:
    """Distances between the arm, what stands around it, and the string with its load.

    Meshes are replaced by their convex hulls, which contain them: the distances err on the safe side.
    """

    def __init__(self, robot: urdf.Robot, obstacles: tuple[Obstacle, ...] = ()) -> None:
        self._model, shapes = collision_shapes(robot)
        self._data = self._model.createData()
        tool = robot.model.frames[robot.tool_frame_id]
        self._tool_joint = int(tool.parentJoint)
        self._tool_point = tool.placement.act(np.asarray(robot.tool_offset))
        self._parts = [
            (shape.name.rpartition("_")[0], int(shape.parentJoint), shape.placement.copy(), _hull(shape.geometry))
            for shape in shapes.geometryObjects
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

        Distances of the load are to every link; those of the string to all but the hand, on which it hangs.

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


SHARE = 0.25
"""Share of the distance by which the arm may move before the next look, so that no contact is missed."""

STEP = 5e-3
"""Move after which the next look is taken where two parts already touch [m]."""

HAND = 0.15
"""How far the hand reaches beyond the tool frame and the arm beyond the middle of its links, at most [m]."""


def collision_series(robot: urdf.Robot, motion: SampledMotion, settings: CheckSettings) -> list[Bounded]:
    """Distance of the arm from itself and the rest of the robot, and from what stands around it."""
    itself, around = urdf.CollisionModel(robot), Surroundings(robot, settings.obstacles)

    def to_itself(k: int) -> tuple[float, str]:
        found = itself.clearance(motion.fine_q[k])
        return found.distance, f"{found.first} - {found.second}"

    travel = _travel(robot, motion.fine_q)
    series = []
    if itself.pairs:  # a URDF whose meshes are missing has none
        series += _looked_at("self_collision", motion.fine_time, travel, to_itself, settings.clearance)
    if settings.obstacles:
        series += _looked_at(
            "collision", motion.fine_time, travel, lambda k: around.clearance(motion.fine_q[k]), settings.clearance
        )
    return series


def swing_series(
    robot: urdf.Robot, line: urdf.Line, motion: SampledMotion, swing: Swing, settings: CheckSettings
) -> list[Bounded]:
    """Tension of the string, and distance of string and load from the arm."""
    tension = Bounded.between("tension", "N", ("string",), swing.time, swing.tension, swing.least_tension)
    if not settings.collision:
        return [tension]
    around, along = Surroundings(robot), np.asarray(line.direction)
    angle = np.interp(motion.fine_time, swing.time, swing.angle)

    def to_arm(k: int) -> tuple[float, str]:
        return around.swing_clearance(motion.fine_q[k], along, float(angle[k]), swing.length, swing.radius)

    travel = _travel(robot, motion.fine_q)
    travel += np.concatenate([[0.0], np.cumsum(np.abs(np.diff(angle)))]) * (swing.length + swing.radius)
    return [tension, *_looked_at("swing_clearance", motion.fine_time, travel, to_arm, settings.swing_clearance)]


def _looked_at(
    limit: str, time: Array, travel: Array, distance: Callable[[int], tuple[float, str]], least: float
) -> list[Bounded]:
    """Distances at the instants that matter, a series per pair that was the closest at one of them.

    Args:
        limit: what is limited.
        time: of all samples (m,) [s].
        travel: upper bound of the distance that any point of the arm has moved until each sample (m,) [m].
        distance: at a sample: how far apart which two are [m].
        least: distance that is asked for [m].
    """
    found: dict[str, list[tuple[float, float]]] = {}
    k = 0
    while k < time.size:
        apart, pair = distance(k)
        found.setdefault(pair, []).append((float(time[k]), apart))
        room = max(SHARE * (apart - least), STEP)
        following = int(np.searchsorted(travel, travel[k] + room, side="right"))
        last = time.size - 1
        k = max(following, k + 1) if k == last else min(max(following, k + 1), last)
    return [
        Bounded.between(limit, "m", (pair,), [t for t, _ in rows], [d for _, d in rows], least)
        for pair, rows in found.items()
    ]


def _travel(robot: urdf.Robot, q: Array) -> Array:
    """Upper bound of the distance that any point of the arm has moved until each posture (m,) [m]."""
    lengths = [float(np.linalg.norm(robot.model.jointPlacements[j].translation)) for j in range(2, robot.model.njoints)]
    tool = robot.model.frames[robot.tool_frame_id].placement.translation
    lengths.append(float(np.linalg.norm(tool)) + HAND)
    # A part reaches no further from a joint than the stretched chain of all links between them.
    reach = np.cumsum(lengths[::-1])[::-1]
    steps = np.abs(np.diff(q, axis=0)) @ reach
    return np.concatenate([[0.0], np.cumsum(steps)])
