"""Find the target poses that an arm cannot reach, and the reason: distance, a joint limit or a collision."""

from dataclasses import dataclass

import numpy as np

from ik.path import Path
from ik.solver import IkSolver
from urdf import CollisionModel, Robot
from urdf.robot import Array

STARTS_WITHOUT_JOINT_LIMITS = 200
"""Number of starting postures per target in the search without joint limits."""


@dataclass(frozen=True)
class UnreachableTarget:
    """A target pose of the tool that the arm cannot reach.

    Attributes:
        s: path coordinate of the target [m].
        position: target of the tool point, (3,) [m].
        distance: smallest distance of the tool point from the target within the joint limits [m]; 0 for a collision.
        angle: angle between the tool and its target at this distance [rad]; 0 for a collision.
        reason: the reason, as the end of a sentence: the arm's reach, a joint's limit, or two links that would collide.
    """

    s: float
    position: Array
    distance: float
    angle: float
    reason: str

    @property
    def sentence(self) -> str:
        """The target, its distance from the reachable poses, and the reason, as a sentence."""
        where = ", ".join(f"{value:.3f}" for value in self.position)
        off = f" by {1e3 * self.distance:.1f} mm and {1e3 * self.angle:.0f} mrad" if self.distance or self.angle else ""
        return f"the target s = {self.s:.3f} m at ({where}) m is missed{off}: {self.reason}"


def find_unreachable_targets(
    robot: Robot, path: Path, s: Array, collisions: CollisionModel
) -> tuple[UnreachableTarget, ...]:
    """Find the poses on a path that an arm cannot reach, of those at path coordinates s (k,) [m], in this order."""
    turned, placed = path.pose(s)
    rotation, position = turned.transpose(2, 0, 1), placed.T
    solver = IkSolver(robot)
    answers = solver.solve(rotation, position)
    missed = np.flatnonzero(~answers.reached)
    free = IkSolver(robot, limited=False).solve(rotation[missed], position[missed], starts=STARTS_WITHOUT_JOINT_LIMITS)
    without_limits = dict(zip(missed.tolist(), zip(free.reached, free.q, strict=True), strict=True))
    misses = []
    for index, at in enumerate(s):
        off = float(answers.distance[index]), float(answers.angle[index])
        if index in without_limits:
            reached, q = without_limits[index]
            why = _joint_beyond_limit(robot, q) if reached else "it is beyond the arm's reach"
            misses.append(UnreachableTarget(float(at), position[index], *off, why))
        elif touching := collisions.touching(answers.q[index]):
            others = solver.alternative_postures(rotation[index], position[index])
            if not any(collisions.touching(q) is None for q in others):
                why = f"{touching[0]} would touch {touching[1]} in every posture that was tried"
                misses.append(UnreachableTarget(float(at), position[index], 0.0, 0.0, why))
    return tuple(misses)


def _joint_beyond_limit(robot: Robot, q: Array) -> str:
    """Name the joint that is furthest beyond its limits, angles reduced by whole turns, as the end of a sentence."""
    middle = (robot.limits.lower + robot.limits.upper) / 2
    margin = robot.limits.margin(middle + np.remainder(q - middle + np.pi, 2 * np.pi) - np.pi)
    joint = int(margin.argmin())
    return f"joint '{robot.joint_names[joint]}' would pass its limit by {-margin[joint]:.3f} rad"
