"""Whether an arm touches itself or the rest of its robot."""

from pathlib import Path
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from urdf.quiet import Said, quiet, reason
from urdf.robot import Array, Robot, UrdfError


class Clearance(NamedTuple):
    """The closest pair of links and how far apart they are; negative where they overlap."""

    distance: float  # m
    first: str
    second: str


def collision_shapes(robot: Robot) -> tuple[pin.Model, pin.GeometryModel]:
    """Model of the arm, and the collision shapes of the whole robot on it.

    Raises:
        UrdfError: a mesh cannot be read.
    """
    said = Said()
    try:
        with quiet() as said:
            full = pin.buildModelFromXML(robot.urdf_xml)
            # Directories go in by name: pin 4.1 takes the third positional argument for something else.
            shapes = pin.buildGeomFromUrdfString(
                full,
                robot.urdf_xml,
                pin.GeometryType.COLLISION,
                package_dirs=[str(path) for path in robot.package_dirs],
            )
    except (ValueError, RuntimeError) as error:
        raise UrdfError(
            f"{robot.urdf_path}: a mesh cannot be read ({reason(said, error)}); mend or replace it"
        ) from error
    locked = [index for index in range(1, full.njoints) if full.names[index] not in robot.joint_names]
    model, shapes = pin.buildReducedModel(full, shapes, locked, pin.neutral(full))
    return model, shapes


class CollisionModel:
    """The collision shapes of a robot and the pairs of them that are worth checking.

    Pairs that its SRDF or its settings exclude are left out, and so are links joined by one joint.

    Args:
        robot: the arm; the rest of its robot stands still at its neutral posture.
    """

    def __init__(self, robot: Robot) -> None:
        self._model, self._shapes = collision_shapes(robot)
        self._shapes.addAllCollisionPairs()
        if robot.srdf_path is not None:
            self._follow(robot.srdf_path)
        self._leave_out(robot.collision_exclusions)
        self._data = self._model.createData()
        self._results = self._shapes.createData()

    @property
    def pairs(self) -> tuple[tuple[str, str], ...]:
        """Links that are checked against each other."""
        return tuple(self._links(index) for index in range(len(self._shapes.collisionPairs)))

    def touching(self, q: Array) -> tuple[str, str] | None:
        """The first pair of links that touch at a posture (n,), or None."""
        if not pin.computeCollisions(self._model, self._data, self._shapes, self._results, np.asarray(q), True):
            return None
        results = self._results.collisionResults
        return self._links(next(index for index in range(len(results)) if results[index].isCollision()))

    def clearance(self, q: Array) -> Clearance:
        """How close the arm comes to anything at a posture (n,)."""
        pin.computeDistances(self._model, self._data, self._shapes, self._results, np.asarray(q))
        results = self._results.distanceResults
        distances = [results[index].min_distance for index in range(len(results))]
        closest = int(np.argmin(distances))
        return Clearance(float(distances[closest]), *self._links(closest))

    def _follow(self, srdf: Path) -> None:
        """Leave out what an SRDF says.

        Raises:
            UrdfError: it cannot be read.
        """
        said = Said()
        try:
            with quiet() as said:
                pin.removeCollisionPairs(self._model, self._shapes, str(srdf))
        except (ValueError, RuntimeError) as error:
            raise UrdfError(
                f"{srdf}: cannot be read ({reason(said, error)}); mend it, or leave it out of the settings"
            ) from error

    def _leave_out(self, exclusions: tuple[tuple[str, str], ...]) -> None:
        excluded = {frozenset(pair) for pair in exclusions}
        kept = []
        for index in range(len(self._shapes.collisionPairs)):
            pair = self._shapes.collisionPairs[index]
            joints = [int(self._shapes.geometryObjects[end].parentJoint) for end in (pair.first, pair.second)]
            neighbours = self._model.parents[max(joints)] == min(joints)
            if not neighbours and frozenset(self._links(index)) not in excluded:
                kept.append((int(pair.first), int(pair.second)))
        self._shapes.removeAllCollisionPairs()
        for first, second in kept:
            self._shapes.addCollisionPair(pin.CollisionPair(first, second))

    def _links(self, index: int) -> tuple[str, str]:
        pair = self._shapes.collisionPairs[index]
        # Pinocchio numbers the shapes of a link: "hand_0", "hand_1".
        first, second = (self._shapes.geometryObjects[end].name.rpartition("_")[0] for end in (pair.first, pair.second))
        return first, second
