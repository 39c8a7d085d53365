"""Compute the distances between arm, load, string and obstacles during a motion."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product

import coal
import numpy as np
import pinocchio as pin

import urdf
from armdyn.errors import InputError
from pipeline.box import LOAD_RADIUS, Box
from pipeline.motion.feasibility.verdict import LimitedQuantity
from pipeline.motion.trajectory import JointTrajectory, freeze_samples
from urdf.collision import collision_shapes, convex_hull, link_of_shape
from urdf.robot import Array

MIN_LINK_CLEARANCE, MIN_LOAD_AND_STRING_CLEARANCE = 0.01, 0.02
"""Smallest allowed distance between links or between a link and an obstacle, and between load or string and arm [m]."""
TABLE_SIZE = (1.6, 0.7, 0.04)
"""Length, depth and thickness of the table top under the box [m]."""
TRAVEL_PER_CHECK_SHARE_OF_DISTANCE = 0.25
"""Share of the present distance between bodies by which the arm may move until the next check, so that no contact is
missed."""
MIN_TRAVEL_BETWEEN_CHECKS = 5e-3
"""Smallest travel of the arm between two checks, also where bodies touch [m]."""
EQUAL_DISTANCE_TOLERANCE = 1e-9
"""Difference below which two distances count as equal, so that the first pair is reported [m]."""
MAX_HAND_OR_LINK_EXTENT = 0.15
"""Upper bound of the hand's extent beyond the tool frame, and of a link's extent beyond its middle line [m]."""


@dataclass(frozen=True)
class Obstacle:
    """A fixed cuboid near the robot.

    Attributes:
        name: name for messages.
        centre: centre in the robot's base frame, (3,) [m].
        size: edge lengths, (3,) [m].
        rotation: orientation in the robot's base frame, (3, 3).
    """

    name: str
    centre: Array
    size: Array
    rotation: Array


def box_and_table_obstacles(line: urdf.Line, box: Box) -> tuple[Obstacle, ...]:
    """Obstacles of the task: the four walls and the floor of the open box under the line, and the table top."""
    top = box.rim_middle(line) - np.array([0.0, 0.0, box.height + box.wall + TABLE_SIZE[2] / 2.0])
    blocks = [
        ("box floor" if plate.name == "floor" else f"box {plate.name} wall", plate.centre, 2.0 * plate.half)
        for plate in box.plates(line)
    ]
    return tuple(Obstacle(*block, line.axes) for block in [*blocks, ("table", top, np.array(TABLE_SIZE))])


@dataclass(frozen=True)
class PlannedSwing:
    """The swing of the load during a motion along the line.

    Attributes:
        time: times on the clock of the motion, (n,) [s].
        angle: angle of the string from the vertical, (n,) [rad]; the load is at ``gripper_x - l sin(angle)``.
        tension: tension of the string, (n,) [N].
        length: length of the string, to the load's centre [m].
        radius: radius of the load [m].
        least_tension: smallest allowed tension of the string [N].

    Raises:
        InputError: the arrays do not have equal lengths, or length or radius is not positive.
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


class ObstacleDistances:
    """Computes distances between the arm's links and other bodies, with convex hulls in place of meshes.

    The true distances are never smaller.

    Args:
        robot: the arm.
        bodies: name and shape of each body, and the joint whose links it may touch, -1 for none.
    """

    def __init__(self, robot: urdf.Robot, bodies: Sequence[tuple[str, coal.CollisionGeometry, int]]) -> None:
        self._model, self._shapes = collision_shapes(robot)
        arm = [(k, shape.parentJoint) for k, shape in enumerate(self._shapes.geometryObjects) if shape.parentJoint]
        for shape in self._shapes.geometryObjects:
            shape.geometry = convex_hull(shape.geometry)[0]
        self._first = self._shapes.ngeoms
        for name, body, _ in bodies:
            self._shapes.addGeometryObject(pin.GeometryObject(name, 0, pin.SE3.Identity(), body))
        for (k, joint), (number, (_, _, spared)) in product(arm, enumerate(bodies, start=self._first)):
            if joint != spared:
                self._shapes.addCollisionPair(pin.CollisionPair(k, number))
        self._data, self._distances = self._model.createData(), self._shapes.createData()

    def set_obstacle_pose(self, number: int, rotation: Array, centre: Array) -> None:
        """Set the pose of a body in the robot's base frame.

        Args:
            number: index of the body.
            rotation: orientation, (3, 3).
            centre: position of its centre, (3,) [m].
        """
        self._shapes.geometryObjects[self._first + number].placement = pin.SE3(rotation, centre)

    def closest(self, q: Array) -> tuple[float, str, str]:
        """Smallest distance at a posture q (n,) [m], at most 0 in a collision, and the names of link and body."""
        pin.computeDistances(self._model, self._data, self._shapes, self._distances, q)
        apart = np.array([result.min_distance for result in self._distances.distanceResults])
        first = int(np.flatnonzero(apart <= apart.min() + EQUAL_DISTANCE_TOLERANCE)[0])
        pair = self._shapes.collisionPairs[first]
        part, body = (self._shapes.geometryObjects[end] for end in (pair.first, pair.second))
        return float(apart[first]), link_of_shape(part), body.name


def collision_limited_quantities(
    robot: urdf.Robot, motion: JointTrajectory, obstacles: Sequence[Obstacle]
) -> list[LimitedQuantity]:
    """Distances between links of the robot, and between links and obstacles, during a motion."""
    itself = urdf.CollisionModel(robot)
    travel = _travel(robot, motion.q)

    def to_itself(k: int) -> tuple[float, str]:
        found = itself.clearance(motion.q[k])
        return found.distance, f"{found.first} - {found.second}"

    series = []
    if itself.pairs:  # a URDF whose meshes are missing has none
        series += _where_it_matters("self_collision", motion.time, travel, to_itself, MIN_LINK_CLEARANCE)
    if obstacles:
        around = ObstacleDistances(robot, [(o.name, coal.Box(*map(float, o.size)), -1) for o in obstacles])
        for number, block in enumerate(obstacles):
            around.set_obstacle_pose(number, block.rotation, block.centre)

        def to_obstacles(k: int) -> tuple[float, str]:
            distance, part, block = around.closest(motion.q[k])
            return distance, f"{part} - {block}"

        series += _where_it_matters("collision", motion.time, travel, to_obstacles, MIN_LINK_CLEARANCE)
    return series


def swing_limited_quantities(
    robot: urdf.Robot, line: urdf.Line, motion: JointTrajectory, swing: PlannedSwing, collision: bool
) -> list[LimitedQuantity]:
    """Tension of the string during a motion, and distances of load and string from the arm's links.

    Args:
        robot: the arm.
        line: line on which the tool moves.
        motion: motion of the joints.
        swing: swing of the load.
        collision: whether to compute the distances; the string may touch the hand.
    """
    tension = LimitedQuantity.from_values("tension", "N", ("string",), swing.time, swing.tension, swing.least_tension)
    if not collision:
        return [tension]
    hand = int(robot.model.frames[robot.tool_frame_id].parentJoint)
    bodies = [("load", coal.Sphere(swing.radius), -1), ("string", coal.Capsule(1e-3, swing.length), hand)]
    around, data = ObstacleDistances(robot, bodies), robot.model.createData()
    along, aside, up = line.direction, -line.axes[:, 1], line.axes[:, 2]
    angle = np.interp(motion.time, swing.time, swing.angle)

    def to_arm(k: int) -> tuple[float, str]:
        top = robot.tool_pose(motion.q[k], data).translation
        hanging = -np.sin(angle[k]) * along - np.cos(angle[k]) * up
        # A capsule lies along its z axis, about its middle.
        turned = np.column_stack([np.cross(aside, hanging), aside, hanging])
        around.set_obstacle_pose(0, np.eye(3), top + swing.length * hanging)
        around.set_obstacle_pose(1, turned, top + swing.length / 2.0 * hanging)
        return around.closest(motion.q[k])[:2]

    travel = _travel(robot, motion.q)
    travel += np.concatenate([[0.0], np.cumsum(np.abs(np.diff(angle)))]) * (swing.length + swing.radius)
    return [tension, *_where_it_matters("swing_clearance", motion.time, travel, to_arm, MIN_LOAD_AND_STRING_CLEARANCE)]


def _where_it_matters(
    limit: str, time: Array, travel: Array, distance: Callable[[int], tuple[float, str]], least: float
) -> list[LimitedQuantity]:
    """Smallest distances during a motion, computed only as often as needed; one series per closest pair.

    `travel` (m,) [m] is an upper bound of how far any point has moved until each sample. `distance` gives the smallest
    distance at a sample [m], and the pair; it must be at least `least` [m].
    """
    found: dict[str, list[tuple[float, float]]] = {}
    k, last = 0, time.size - 1
    while True:
        apart, pair = distance(k)
        found.setdefault(pair, []).append((float(time[k]), apart))
        if k == last:
            break
        room = max(TRAVEL_PER_CHECK_SHARE_OF_DISTANCE * (apart - least), MIN_TRAVEL_BETWEEN_CHECKS)
        k = min(max(int(np.searchsorted(travel, travel[k] + room, side="right")), k + 1), last)
    return [
        LimitedQuantity.from_values(limit, "m", (pair,), [t for t, _ in rows], [d for _, d in rows], least)
        for pair, rows in found.items()
    ]


def _travel(robot: urdf.Robot, q: Array) -> Array:
    """Upper bound of how far any point of the arm has moved until each posture q (m, n): (m,) [m]."""
    lengths = [float(np.linalg.norm(robot.model.jointPlacements[j].translation)) for j in range(2, robot.model.njoints)]
    tool = robot.model.frames[robot.tool_frame_id].placement.translation
    lengths.append(float(np.linalg.norm(tool)) + MAX_HAND_OR_LINK_EXTENT)
    # A part reaches no further from a joint than the stretched chain of all links between them.
    reach = np.cumsum(lengths[::-1])[::-1]
    return np.concatenate([[0.0], np.cumsum(np.abs(np.diff(q, axis=0)) @ reach)])
