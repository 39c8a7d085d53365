"""Search for a straight line on which an arm can move its tool fast, far from joint limits and without collisions."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from armdyn.errors import InputError
from ik.branch import inside_core_indicator
from ik.chain import KinematicChain
from ik.errors import UnreachableError
from ik.path import MAX_PATH_LENGTH
from ik.plan import BranchPlanner
from ik.solver import IkSolver
from ik.torque import JointTorque
from urdf import CollisionModel, Line, Robot
from urdf.robot import Array

COARSE_GRID_SPACING_METRES = 0.1
"""Distance between the targets of the coarse grid of the search for the best line [m]."""
COARSE_GRID_STARTS_PER_TARGET = 3
"""Number of starting postures per target of the coarse grid."""
BEST_LINES_PLANNED = 8
"""Number of lines of the coarse grid that are planned: those that look best."""
START_POSTURES_PER_LINE = 3
"""Number of different postures from which each of the planned lines is planned."""
BEST_LINE_SHIFTS_METRES = (0.05, 0.025, 0.0125)
"""Distances by which the best line is moved, one after the other [m]."""
JOINT_LIMIT_MARGIN_OF_FULL_SCORE = 0.5
"""Distance from the joint limits above which a line's score no longer rises [rad]."""
WHOLE_LINE_SPEED_WEIGHT = 0.3
"""Weight of the lowest speed on the whole line in a line's score; the lowest speed on the core has weight 1."""
TRIED_CORE_SPEEDS = (
    3.0,
    0.8,
    0.3,
)
"""Speeds required on the core in the search [m/s]; the next one is tried if a limit is violated."""
REQUIRED_SHARE_OF_FOUND_SPEED = (
    0.97  # share of the speed found that the final line requires; the rest serves the joint margin
)
"""Required speed of the final line, as a share of the speed that the search found; the rest serves the distance from
joint limits."""
CHECKED_TARGETS_PER_LINE = 9
"""Number of targets on a line of the coarse grid that must be reachable."""


class LineCandidate(NamedTuple):
    """A line that the arm can follow, with its speed, margins and score.

    Attributes:
        line: the line.
        home: posture at s = 0 that selects the branch, (n,) [rad or m].
        core_speed: smallest value on the core of the largest possible tool speed [m/s].
        whole_speed: smallest value on the whole line of the largest possible tool speed [m/s].
        joint_margin: smallest distance of a joint from its position limit [rad or m].
        clearance: smallest distance of two links in the collision check [m]; nan until it is computed.
        torque: largest share of a torque limit that creeping either way takes, without and with springs.
        score: score that the search maximises.
    """

    line: Line
    home: Array
    core_speed: float
    whole_speed: float
    joint_margin: float
    clearance: float
    torque: tuple[float, float]
    score: float


@dataclass(frozen=True)
class LineRequirements:
    """Requirements on the line that `search_line` searches for.

    Attributes:
        direction: unit vector of growing s in the base frame, (3,).
        rotation: orientation of the tool, (3, 3); None for the orientation parallel to the base's axes that is nearest
            to the tool's at home.
        s_min: first line coordinate [m].
        s_max: last line coordinate [m].
        core: first and last coordinate of the part on which speed matters most [m].
    """

    direction: tuple[float, float, float] = (0.0, 1.0, 0.0)
    rotation: Array | None = None
    s_min: float = -0.25
    s_max: float = 0.25
    core: tuple[float, float] = (-0.15, 0.15)

    def __post_init__(self) -> None:
        if not 0.0 < self.s_max - self.s_min <= MAX_PATH_LENGTH:
            raise InputError(
                f"a line from {self.s_min:g} to {self.s_max:g} m: give one of {MAX_PATH_LENGTH:g} m at most"
            )


def search_line(
    robot: Robot, demand: LineRequirements | None = None, progress: Callable[[str], None] | None = None
) -> LineCandidate:
    """Search for the line on which an arm can move its tool fast with much distance from its joint limits.

    The score is (smallest speed on the core + 0.3 smallest speed on the line) * min(1, margin / 0.5 rad). Lines with a
    collision are rejected, and lines on which a joint's torque does not suffice to creep.

    Only lines on one side of the base are searched: to the right of a person at the base who looks along the direction.
    A coarse grid of reachable targets gives the first candidates. The best ones are planned, from the home posture and
    others; then the best line is moved in smaller and smaller steps.

    Args:
        robot: the arm.
        demand: requirements on the line; by default those of `LineRequirements()`.
        progress: function that is called with a sentence about each step.

    Raises:
        UnreachableError: the arm can follow no line of this length and direction.
    """
    demand, say = demand or LineRequirements(), progress or (lambda _: None)
    search = _Search(robot, demand)
    say("looking where the tool can be held")
    origins = search.shortlist()
    best: LineCandidate | None = None
    for number, origin in enumerate(origins):
        for start in search.starts(origin):
            found = search.try_out(origin, start)
            if found is not None and (best is None or found.score > best.score):
                best = found
        say(f"row {number + 1} of {len(origins)}: {_sentence(best)}")
    if best is None:
        raise UnreachableError(
            f"robot '{robot.name}': no line of {demand.s_max - demand.s_min:g} m along {demand.direction} was found; "
            "ask for a shorter one or another orientation of the tool"
        )
    for step in BEST_LINE_SHIFTS_METRES:
        improved = True
        while improved:
            improved = False
            for move in (side * step * axis for axis in search.frame[::-1] for side in (1.0, -1.0)):
                found = search.try_out(best.line.origin + move, best.home)
                if found is not None and found.score > best.score + 1e-3:
                    best, improved = found, True
            say(f"steps of {1e3 * step:g} mm: {_sentence(best)}")
    return search.settle(best)


def axis_aligned_rotation(rotation: Array) -> Array:
    """The orientation (3, 3) with axes parallel to the base's axes that is nearest to a given orientation (3, 3)."""
    upright = np.round(Rotation.create_group("O").as_matrix()) + 0.0
    return np.asarray(upright[np.einsum("kij,ij->k", upright, rotation).argmax()])


class _Search:
    def __init__(self, robot: Robot, demand: LineRequirements) -> None:
        self.robot, self.demand = robot, demand
        self.chain, self.solver, self.collisions = (
            KinematicChain.from_robot(robot),
            IkSolver(robot),
            CollisionModel(robot),
        )
        self.torque = JointTorque(robot, springs=True)
        self.direction = np.array(demand.direction) / np.linalg.norm(demand.direction)
        up = np.array([0.0, 0.0, 1.0]) if abs(self.direction[2]) < 0.9 else np.array([1.0, 0.0, 0.0])
        across = np.cross(self.direction, up) / np.linalg.norm(np.cross(self.direction, up))
        self.frame = np.stack((across, self.direction, np.cross(across, self.direction)))
        given = demand.rotation
        self.rotation = axis_aligned_rotation(robot.tool_pose(robot.home).rotation) if given is None else given

    def line(self, origin: Array, core_speed: float) -> Line:
        demand = self.demand
        return Line(origin, self.direction, self.rotation, demand.s_min, demand.s_max, demand.core, core_speed)

    def shortlist(self) -> list[Array]:
        """Origins of the lines of the coarse grid whose targets are all reachable, the fastest first."""
        frame = self.frame
        postures = np.random.default_rng(0).uniform(
            self.robot.limits.lower, self.robot.limits.upper, (4000, self.chain.joints)
        )
        corners = frame @ self.chain.forward_kinematics(postures).position
        corners[0] = np.maximum(corners[0], COARSE_GRID_SPACING_METRES)
        axes = [
            np.arange(low, high, COARSE_GRID_SPACING_METRES)
            for low, high in zip(corners.min(axis=1), corners.max(axis=1), strict=True)
        ]
        grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
        speed = self._first_look(grid.reshape(-1, 3) @ frame).reshape(grid.shape[:3])
        scores, origins = [], []
        looks = np.linspace(self.demand.s_min, self.demand.s_max, CHECKED_TARGETS_PER_LINE)
        for (i, j, k), centre in np.ndenumerate(np.broadcast_to(axes[1][:, None], (len(axes[0]), *grid.shape[1:3]))):
            along = np.interp(centre + looks, axes[1], speed[i, :, k], left=0.0, right=0.0)
            if along.min() > 0 and speed[i, j, k] > 0:
                scores.append(along.mean())
                origins.append(grid[i, j, k] @ frame)
        chosen: list[Array] = []
        for index in np.argsort(scores)[::-1]:
            # The chosen origins must not all be neighbours.
            if all(np.linalg.norm(origins[index] - other) > 1.2 * COARSE_GRID_SPACING_METRES for other in chosen):
                chosen.append(origins[index])
            if len(chosen) == BEST_LINES_PLANNED:
                break
        return chosen

    def starts(self, origin: Array) -> list[Array]:
        """Postures at s = 0 from which a line is planned, as different from each other as possible."""
        found = self.solver.alternative_postures(self.rotation, origin)
        found = found[self.robot.limits.margin(found).min(axis=1) > 0]
        chosen = [self.robot.home]
        while len(found) and len(chosen) < START_POSTURES_PER_LINE:
            distance = np.min([np.abs(found - other).max(axis=1) for other in chosen], axis=0)
            chosen.append(found[int(distance.argmax())])
        return chosen

    def try_out(self, origin: Array, home: Array) -> LineCandidate | None:
        """The line with the highest requested speed on its core that can be followed; None where there is none."""
        tries = (self.judge(origin, home, core_speed) for core_speed in TRIED_CORE_SPEEDS)
        return next((found for found in tries if found is not None), None)

    def judge(self, origin: Array, home: Array, core_speed: float) -> LineCandidate | None:
        """Speed, margin and score of a line for a requested speed on its core; None where it cannot be followed.

        Args:
            origin: (3,) start of the line, m.
            home: (nj,) posture near which the arm follows it, rad.
            core_speed: speed on the line's middle part, m/s.
        """
        line = self.line(origin, core_speed)
        planner = BranchPlanner(replace(self.robot, home=home), line, self.collisions)
        try:
            branch, q = planner.plan()
        except UnreachableError:
            return None
        s, limits = planner.s, self.robot.limits
        rate, bending, _ = branch.derivatives(self.chain, line, s, q)
        without, helped = self.torque.path_torque_terms(q, rate, bending).holding_torque_shares(limits.effort)
        torque = float(without.max()), float(helped.max())
        if max(torque) > 1.0:
            return None
        speed = 1.0 / np.abs(rate / limits.velocity).max(axis=1)
        core, whole = float(speed[inside_core_indicator(line, s) > 0].min()), float(speed.min())
        margin = float(limits.margin(q).min())
        score = (core + WHOLE_LINE_SPEED_WEIGHT * whole) * min(1.0, margin / JOINT_LIMIT_MARGIN_OF_FULL_SCORE)
        return LineCandidate(line, q[int(np.abs(s).argmin())], core, whole, margin, float("nan"), torque, score)

    def settle(self, best: LineCandidate) -> LineCandidate:
        """Plan the best line again for a slightly lower speed, and compute its clearance."""
        origin, home = np.round(best.line.origin, 4), np.round(best.home, 3)
        core_speed = float(np.floor(1e3 * REQUIRED_SHARE_OF_FOUND_SPEED * best.core_speed) / 1e3)
        found = self.judge(origin, home, core_speed) or best._replace(line=self.line(best.line.origin, core_speed))
        _, q = BranchPlanner(replace(self.robot, home=home), found.line, self.collisions).plan()
        clearance = min(self.collisions.clearance(posture).distance for posture in q)
        return found._replace(home=home, clearance=clearance)

    def _first_look(self, position: Array) -> Array:
        """Possible tool speed at each target in one posture, (k,) [m/s]; 0 where no posture was found."""
        rotation = np.broadcast_to(self.rotation, (len(position), 3, 3))
        answers = self.solver.solve(rotation, position, starts=COARSE_GRID_STARTS_PER_TARGET, tolerance=1e-6)
        jacobian = self.chain.jacobian(self.chain.forward_kinematics(answers.q)).transpose(2, 0, 1)
        twist = np.concatenate((self.direction, np.zeros(3)))
        rate = np.linalg.pinv(jacobian, rcond=1e-6) @ twist
        speed = 1.0 / np.maximum(np.abs(rate / self.robot.limits.velocity).max(axis=1), 1e-6)
        return np.where(answers.reached, speed, 0.0)


def _sentence(found: LineCandidate | None) -> str:
    if found is None:
        return "none yet"
    where = ", ".join(f"{value:.3f}" for value in found.line.origin)
    return f"{found.core_speed:.2f} m/s with {found.joint_margin:.2f} rad at ({where}) m"
