"""Why an arm cannot hold its tool at a target: out of reach, a joint limit or a collision, and by how much."""

from dataclasses import dataclass

import numpy as np

from ik.path import Path
from ik.solver import Solver
from urdf import CollisionModel, Robot
from urdf.robot import Array

UNLIMITED_STARTS_PER_TARGET = 200  # starting postures that a search without joint limits may use


@dataclass(frozen=True)
class Miss:
    """A target that cannot be held.

    Attributes:
        s: its path coordinate [m].
        position: of the tool point, (3,) [m].
        distance, angle: how far off the tool stays within the joint limits [m, rad]; 0 for a collision.
        why: the reason, as the end of a sentence: beyond reach, or the joint or the links that forbid it.
    """

    s: float
    position: Array
    distance: float
    angle: float
    why: str

    @property
    def sentence(self) -> str:
        """The target, the distance by which it is missed, and the reason, as a sentence."""
        where = ", ".join(f"{value:.3f}" for value in self.position)
        off = f" by {1e3 * self.distance:.1f} mm and {1e3 * self.angle:.0f} mrad" if self.distance or self.angle else ""
        return f"the target s = {self.s:.3f} m at ({where}) m is missed{off}: {self.why}"


def find_misses(robot: Robot, path: Path, s: Array, collisions: CollisionModel) -> tuple[Miss, ...]:
    """The targets at path coordinates (k,) [m] that the arm cannot hold, in this order, each with the reason."""
    turned, placed = path.pose(s)
    rotation, position = turned.transpose(2, 0, 1), placed.T
    solver = Solver(robot)
    answers = solver.solve(rotation, position)
    missed = np.flatnonzero(~answers.reached)
    free = Solver(robot, limited=False).solve(rotation[missed], position[missed], starts=UNLIMITED_STARTS_PER_TARGET)
    without_limits = dict(zip(missed.tolist(), zip(free.reached, free.q, strict=True), strict=True))
    misses = []
    for index, at in enumerate(s):
        off = float(answers.distance[index]), float(answers.angle[index])
        if index in without_limits:
            reached, q = without_limits[index]
            why = _joint_beyond_limit(robot, q) if reached else "it is beyond the arm's reach"
            misses.append(Miss(float(at), position[index], *off, why))
        elif touching := collisions.touching(answers.q[index]):
            others = solver.postures(rotation[index], position[index])
            if not any(collisions.touching(q) is None for q in others):
                why = f"{touching[0]} would touch {touching[1]} in every posture that was tried"
                misses.append(Miss(float(at), position[index], 0.0, 0.0, why))
    return tuple(misses)


def _joint_beyond_limit(robot: Robot, q: Array) -> str:
    """Which joint of a posture is furthest beyond its limits, whole turns apart, and by how much."""
    middle = (robot.limits.lower + robot.limits.upper) / 2
    margin = robot.limits.margin(middle + np.remainder(q - middle + np.pi, 2 * np.pi) - np.pi)
    joint = int(margin.argmin())
    return f"joint '{robot.joint_names[joint]}' would pass its limit by {-margin[joint]:.3f} rad"
