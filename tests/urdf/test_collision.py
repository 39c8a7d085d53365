"""Distances bounded by convex hulls are those of the meshes."""

import coal
import numpy as np
import pinocchio as pin
import pytest

import urdf
from urdf.collision import collision_shapes


@pytest.mark.parametrize("name", ["ur5", "baxter"])
def test_the_clearance_is_that_of_the_meshes_themselves(name):
    robot = urdf.load(name)
    model = urdf.CollisionModel(robot)
    arm, shapes = collision_shapes(robot)
    numbers = {shape.name: k for k, shape in enumerate(shapes.geometryObjects)}
    for pair in model._shapes.collisionPairs:
        ends = (numbers[model._shapes.geometryObjects[end].name] for end in (pair.first, pair.second))
        shapes.addCollisionPair(pin.CollisionPair(*ends))
    data, distances = arm.createData(), shapes.createData()
    rng, touching = np.random.default_rng(0), 0
    for _ in range(25):
        q = rng.uniform(np.maximum(robot.limits.lower, -3.0), np.minimum(robot.limits.upper, 3.0))
        pin.computeDistances(arm, data, shapes, distances, q)
        nearest = min(result.min_distance for result in distances.distanceResults)
        assert model.clearance(q).distance == pytest.approx(nearest, abs=1e-6)
        assert (model.touching(q) is not None) == (nearest <= 0.0)
        touching += nearest <= 0.0
    assert 0 < touching < 25
    if name == "ur5":  # none of its meshes is convex: every one is bounded by its hull
        assert not any(isinstance(shape.geometry, coal.BVHModelBase) for shape in model._hulls.geometryObjects)
        assert len(model._inexact) == len(model.pairs)
