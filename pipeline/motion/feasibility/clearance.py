"""Distances between arm, load, string and obstacles over a motion."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import coal
import numpy as np
import pinocchio as pin

import urdf
from armdyn.errors import InputError
from pipeline.box import LOAD_RADIUS, Box
from pipeline.motion.feasibility.verdict import Bounded
from pipeline.motion.trajectory import JointTrajectory, freeze_samples
from urdf.collision import collision_shapes, hull, link_of_shape
from urdf.robot import Array

CLEARANCE, SWING_CLEARANCE = 0.01, 0.02
"""Distance asked for between the arm and itself or an obstacle, and between load or string and the arm [m]."""
TABLE = (1.6, 0.7, 0.04)
"""Length, depth and thickness of the table top under the box [m]."""
SHARE = 0.25
"""Share of the distance by which the arm may move before the next look, so that no contact is missed."""
STEP = 5e-3
"""Move after which the next look is taken where two parts already touch [m]."""
TIE = 1e-9
"""Distances that differ by less are equal [m]: of two fingers above a table the first is named."""
HAND = 0.15
"""How far the hand reaches beyond the tool frame and the arm beyond the middle of its links, at most [m]."""


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


def box_and_table(line: urdf.Line, box: Box) -> tuple[Obstacle, ...]:
    """An open box on a table, under the line: four walls, the floor and the table top."""
    top = box.rim_middle(line) - np.array([0.0, 0.0, box.height + box.wall + TABLE[2] / 2.0])
    blocks = [
        ("box floor" if plate.name == "floor" else f"box {plate.name} wall", plate.centre, 2.0 * plate.half)
        for plate in box.plates(line)
    ]
    return tuple(Obstacle(*block, line.axes) for block in [*blocks, ("table", top, np.array(TABLE))])


@dataclass(frozen=True)
class Swing:
    """The load's swing that belongs to a motion along the line.

    Attributes:
        time: (n,) on the clock of the motion [s].
        angle: of the string, 0 hanging; the load is at ``gripper_x - l sin(angle)`` (n,) [rad].
        tension: of the string (n,) [N].
        length: of the string, to the load's centre [m].
        radius: of the load [m].
        least_tension: below it the string counts as slack [N].

    Raises:
        InputError: if the arrays do not fit together, or length or radius is not positive.
    """

    time: Array
    angle: Array
    tension: Array
    length: float
    radius: float = LOAD_RADIUS
    least_tension: float = 0.0

    def __post_init__(self) -> None:
        freeze_samples(self, "angle", "tension")
        if not (np.isfinite(self.length) and self.length > 0.0 and np.isfinite(self.radius) and self.radius > 0.0):
            raise InputError(f"swing: length {self.length} m and radius {self.radius} m must be greater than 0")


class Body(NamedTuple):
    """A shape that the arm may touch; `spared` is the joint whose parts it may touch."""

    name: str
    shape: coal.CollisionGeometry
    pose: coal.Transform3s
    spared: int = -1


class ArmShapes:
    """Collision shapes of the arm's links with convex hulls in place of meshes: distances err on the safe side."""

    def __init__(self, robot: urdf.Robot) -> None:
        self._model, shapes = collision_shapes(robot)
        self._data = self._model.createData()
        tool = robot.model.frames[robot.tool_frame_id]
        self.tool_joint = int(tool.parentJoint)
        self._tool_point = tool.placement.act(robot.tool_offset)
        self._parts = [
            (link_of_shape(shape), int(shape.parentJoint), shape.placement.copy(), hull(shape.geometry)[0])
            for shape in shapes.geometryObjects
            if shape.parentJoint > 0
        ]
        self._request, self._result = coal.DistanceRequest(), coal.DistanceResult()

    def place(self, q: Array) -> Array:
        """Move the arm to a posture (n,); where its tool point is then (3,) [m]."""
        pin.forwardKinematics(self._model, self._data, q)
        return np.asarray(self._data.oMi[self.tool_joint].act(self._tool_point))

    def closest(self, bodies: Sequence[Body]) -> tuple[float, str, str]:
        """Smallest distance to a body, 0 or less where they touch [m], of which link, and to which body."""
        best: tuple[float, str, str] = (np.inf, "", "")
        for part, joint, placement, shape in self._parts:
            pose = self._data.oMi[joint] * placement
            where = coal.Transform3s(pose.rotation, pose.translation)
            for body in bodies:
                if joint != body.spared:
                    self._result.clear()
                    apart = coal.distance(shape, where, body.shape, body.pose, self._request, self._result)
                    if apart < best[0] - TIE:
                        best = float(apart), part, body.name
        return best


def collision_series(robot: urdf.Robot, motion: JointTrajectory, obstacles: Sequence[Obstacle]) -> list[Bounded]:
    """Distance of the arm from itself and the rest of the robot, and from what stands around it."""
    itself = urdf.CollisionModel(robot)
    travel = _travel(robot, motion.q)

    def to_itself(k: int) -> tuple[float, str]:
        found = itself.clearance(motion.q[k])
        return found.distance, f"{found.first} - {found.second}"

    series = []
    if itself.pairs:  # a URDF whose meshes are missing has none
        series += _where_it_matters("self_collision", motion.time, travel, to_itself, CLEARANCE)
    if obstacles:
        arm = ArmShapes(robot)
        blocks = [
            Body(o.name, coal.Box(*map(float, o.size)), coal.Transform3s(o.rotation, o.centre)) for o in obstacles
        ]

        def to_obstacles(k: int) -> tuple[float, str]:
            arm.place(motion.q[k])
            distance, part, block = arm.closest(blocks)
            return distance, f"{part} - {block}"

        series += _where_it_matters("collision", motion.time, travel, to_obstacles, CLEARANCE)
    return series


def swing_series(
    robot: urdf.Robot, line: urdf.Line, motion: JointTrajectory, swing: Swing, collision: bool
) -> list[Bounded]:
    """Tension of the string, and distances: of the load to every link, of the string to all but the hand."""
    tension = Bounded.between("tension", "N", ("string",), swing.time, swing.tension, swing.least_tension)
    if not collision:
        return [tension]
    arm, along, aside, up = ArmShapes(robot), line.direction, -line.axes[:, 1], line.axes[:, 2]
    angle = np.interp(motion.time, swing.time, swing.angle)
    load, string = coal.Sphere(swing.radius), coal.Capsule(1e-3, swing.length)

    def to_arm(k: int) -> tuple[float, str]:
        top = arm.place(motion.q[k])
        hanging = -np.sin(angle[k]) * along - np.cos(angle[k]) * up
        # A capsule lies along its z axis, about its middle.
        turned = np.column_stack([np.cross(aside, hanging), aside, hanging])
        middle, end = top + swing.length / 2.0 * hanging, top + swing.length * hanging
        bodies = [
            Body("load", load, coal.Transform3s(np.eye(3), end)),
            Body("string", string, coal.Transform3s(turned, middle), arm.tool_joint),
        ]
        return arm.closest(bodies)[:2]

    travel = _travel(robot, motion.q)
    travel += np.concatenate([[0.0], np.cumsum(np.abs(np.diff(angle)))]) * (swing.length + swing.radius)
    return [tension, *_where_it_matters("swing_clearance", motion.time, travel, to_arm, SWING_CLEARANCE)]


def _where_it_matters(
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
    k, last = 0, time.size - 1
    while True:
        apart, pair = distance(k)
        found.setdefault(pair, []).append((float(time[k]), apart))
        if k == last:
            break
        room = max(SHARE * (apart - least), STEP)
        k = min(max(int(np.searchsorted(travel, travel[k] + room, side="right")), k + 1), last)
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
    return np.concatenate([[0.0], np.cumsum(np.abs(np.diff(q, axis=0)) @ reach)])
