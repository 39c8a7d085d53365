"""Detect collisions of an arm with itself or with the rest of its robot."""

from pathlib import Path
from typing import NamedTuple

import coal
import numpy as np
import pinocchio as pin

from urdf.library_output import library_errors
from urdf.robot import Array, Robot, UrdfError


class Clearance(NamedTuple):
    """The two links of a robot that are closest to each other, and their distance; negative where they overlap."""

    distance: float  # m
    first: str
    second: str


def collision_shapes(robot: Robot) -> tuple[pin.Model, pin.GeometryModel]:
    """Pinocchio model of the arm, and the collision shapes of the whole robot attached to it.

    Raises:
        UrdfError: a mesh cannot be read.
    """
    with library_errors(f"{robot.urdf_path}: a mesh cannot be read", "correct or replace it"):
        full = pin.buildModelFromXML(robot.urdf_xml)
        # Directories are passed by name: in pin 4.1 the third positional argument has another meaning.
        shapes = pin.buildGeomFromUrdfString(
            full,
            robot.urdf_xml,
            pin.GeometryType.COLLISION,
            package_dirs=[str(path) for path in robot.package_dirs],
        )
    for shape in shapes.geometryObjects:
        if hasattr(shape.geometry, "vertices") and not np.isfinite(shape.geometry.vertices()).all():
            raise UrdfError(f"mesh {shape.meshPath} holds a corner that is not a number; correct or replace it")
    locked = [index for index in range(1, full.njoints) if full.names[index] not in robot.joint_names]
    model, shapes = pin.buildReducedModel(full, shapes, locked, pin.neutral(full))
    return model, shapes


class CollisionModel:
    """Checks a robot's links for collisions: the arm's joints move, all other joints stay at their neutral position.

    Pairs of links are not checked if the robot's SRDF or settings exclude them, or if one joint connects them.
    """

    def __init__(self, robot: Robot) -> None:
        self._model, self._shapes = collision_shapes(robot)
        self._shapes.addAllCollisionPairs()
        if robot.srdf_path is not None:
            self._follow(robot.srdf_path)
        self._leave_out(robot.collision_exclusions)
        self._hulls, self._inexact = _with_hulls(self._shapes)
        self._data = self._model.createData()
        self._results, self._hull_results = self._shapes.createData(), self._hulls.createData()

    @property
    def pairs(self) -> tuple[tuple[str, str], ...]:
        """Names of the links of each pair that is checked for collision."""
        return tuple(self._links(index) for index in range(len(self._shapes.collisionPairs)))

    def touching(self, q: Array) -> tuple[str, str] | None:
        """Names of the first two links that collide at joint positions q (n,) [rad or m]; None without a collision."""
        pin.computeCollisions(self._model, self._data, self._hulls, self._hull_results, np.asarray(q), False)
        pin.updateGeometryPlacements(self._model, self._data, self._shapes, self._results)
        results = self._hull_results.collisionResults
        for index in range(len(results)):
            if results[index].isCollision() and (
                index not in self._inexact or pin.computeCollision(self._shapes, self._results, index)
            ):
                return self._links(index)
        return None

    def clearance(self, q: Array) -> Clearance:
        """The closest pair of checked links, and their distance, at joint positions q (n,) [rad or m].

        The distance of two convex hulls is a lower bound of the distance of their meshes; the exact distance of two
        meshes is computed only where this bound is below the smallest distance found before.
        """
        pin.computeDistances(self._model, self._data, self._hulls, self._hull_results, np.asarray(q))
        pin.updateGeometryPlacements(self._model, self._data, self._shapes, self._results)
        results = self._hull_results.distanceResults
        bounds = np.array([results[index].min_distance for index in range(len(results))])
        closest, least = 0, np.inf
        for index in map(int, np.argsort(bounds, kind="stable")):
            if bounds[index] >= least:
                break
            distance = bounds[index]
            if index in self._inexact:
                distance = pin.computeDistance(self._shapes, self._results, index).min_distance
            if distance < least:
                closest, least = index, distance
        return Clearance(float(least), *self._links(closest))

    def _follow(self, srdf: Path) -> None:
        """Exclude the pairs of links that an SRDF file lists as needing no check."""
        with library_errors(f"{srdf}: cannot be read", "correct it, or leave it out of the settings"):
            pin.removeCollisionPairs(self._model, self._shapes, str(srdf))

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
        first, second = (link_of_shape(self._shapes.geometryObjects[end]) for end in (pair.first, pair.second))
        return first, second


def link_of_shape(shape: pin.GeometryObject) -> str:
    """Name of the link that a collision shape belongs to; Pinocchio numbers a link's shapes, "hand_0", "hand_1"."""
    return str(shape.name.rpartition("_")[0])


def convex_hull(geometry: coal.CollisionGeometry) -> tuple[coal.CollisionGeometry, bool]:
    """The convex hull of a geometry, and whether the hull has exactly the geometry's shape.

    Geometries other than meshes, such as boxes and spheres, are convex and are returned unchanged.
    """
    if not isinstance(geometry, coal.BVHModelBase):
        return geometry, True
    # `buildConvexRepresentation` would only reinterpret the triangles; this call also returns whether they are convex.
    is_convex = geometry.buildConvexHull(True, "Qt")
    return geometry.convex, bool(is_convex)


def _with_hulls(shapes: pin.GeometryModel) -> tuple[pin.GeometryModel, frozenset[int]]:
    """Collision shapes with convex hulls in place of meshes, and the indices of the pairs with a non-convex mesh."""
    hulls = pin.GeometryModel(shapes)
    hollow = set()
    for number, shape in enumerate(hulls.geometryObjects):
        shape.geometry, exact = convex_hull(shape.geometry)
        if not exact:
            hollow.add(number)
    pairs = enumerate(hulls.collisionPairs)
    return hulls, frozenset(index for index, pair in pairs if {int(pair.first), int(pair.second)} & hollow)
