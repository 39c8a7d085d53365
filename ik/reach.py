"""Why an arm cannot hold its tool at a target."""

from dataclasses import dataclass
from enum import Enum

import numpy as np

from ik.path import Path
from ik.solver import Solver
from urdf import CollisionModel, Robot
from urdf.robot import Array

POSTURES = 64  # tried per target before it is said to be in collision
ALL_STARTS = 200  # starting postures that a search without joint limits may use


class Reason(Enum):
    """Why a target is missed; the value is the end of a sentence."""

    REACH = "it is beyond the arm's reach"
    LIMIT = "a joint would pass its limit"
    COLLISION = "the arm would touch something"


@dataclass(frozen=True)
class Miss:
    """A target that cannot be held.

    Attributes:
        name: of the target, such as ``"s = 0.550 m"``.
        position: of the tool point, (3,) [m].
        reason: why.
        distance: how far off the tool point stays within the joint limits [m]; 0 for a collision.
        angle: how far the tool stays turned away [rad]; 0 for a collision.
        detail: which joint or which links, as the end of a sentence.
    """

    name: str
    position: Array
    reason: Reason
    distance: float
    angle: float
    detail: str

    @property
    def sentence(self) -> str:
        """Which target, how far off and why."""
        where = ", ".join(f"{value:.3f}" for value in self.position)
        off = f" by {1e3 * self.distance:.1f} mm and {1e3 * self.angle:.0f} mrad" if self.distance or self.angle else ""
        return f"the target {self.name} at ({where}) m is missed{off}: {self.detail}"


def survey(robot: Robot, path: Path, s: Array, collisions: CollisionModel | None = None) -> tuple[Miss, ...]:
    """Look at targets along a path one by one, each with its own best posture.

    Args:
        robot: the arm.
        path: where the tool should be.
        s: path coordinates, (k,) [m].
        collisions: what the arm must not touch; None leaves collisions out.

    Returns:
        The targets that cannot be held, in the order of s.
    """
    rotation, position = path.pose(s)
    names = [f"s = {value:.3f} m" for value in s]
    return explain(robot, rotation.transpose(2, 0, 1), position.T, names, collisions)


def explain(
    robot: Robot, rotation: Array, position: Array, names: list[str], collisions: CollisionModel | None = None
) -> tuple[Miss, ...]:
    """Which targets cannot be held, how far off the arm stays, and why.

    Args:
        robot: the arm.
        rotation: orientations of the tool, (k, 3, 3).
        position: positions of the tool point, (k, 3) [m].
        names: what to call each target.
        collisions: what the arm must not touch; None leaves collisions out.
    """
    solver = Solver(robot)
    answers = solver.solve(rotation, position)
    missed = np.flatnonzero(~answers.reached)
    free = Solver(robot, limited=False).solve(rotation[missed], position[missed], starts=ALL_STARTS)
    misses: dict[int, Miss] = {}
    for index, reached, q in zip(missed.tolist(), free.reached, free.q, strict=True):
        reason = Reason.LIMIT if reached else Reason.REACH
        detail = _beyond(robot, q) if reached else reason.value
        off = float(answers.distance[index]), float(answers.angle[index])
        misses[index] = Miss(names[index], position[index], reason, *off, detail)
    if collisions is not None:
        for index in np.flatnonzero(answers.reached).tolist():
            touching = collisions.touching(answers.q[index])
            if touching is not None and not _free_posture(solver, rotation[index], position[index], collisions):
                detail = f"{touching[0]} would touch {touching[1]} in every posture that was tried"
                misses[index] = Miss(names[index], position[index], Reason.COLLISION, 0.0, 0.0, detail)
    return tuple(misses[index] for index in sorted(misses))


def _beyond(robot: Robot, q: Array) -> str:
    """Which joint of a posture is furthest beyond its limits, whole turns apart, and by how much."""
    middle = (robot.limits.lower + robot.limits.upper) / 2
    turned = middle + np.remainder(q - middle + np.pi, 2 * np.pi) - np.pi
    margin = robot.limits.margin(turned)
    joint = int(margin.argmin())
    return f"joint '{robot.joint_names[joint]}' would pass its limit by {-margin[joint]:.3f} rad"


def _free_posture(solver: Solver, rotation: Array, position: Array, collisions: CollisionModel) -> bool:
    """Whether some posture at a target touches nothing."""
    return any(collisions.touching(q) is None for q in solver.postures(rotation, position, POSTURES))
