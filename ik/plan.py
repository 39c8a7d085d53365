"""Plan a smooth branch of postures along a path, within the joint limits and without collisions."""

import numpy as np

from ik.branch import (
    CORE_SPEED_SHORTFALL_WEIGHT,
    MARGIN_COST_SECONDS_PER_RADIAN,
    WANTED_JOINT_LIMIT_MARGIN,
    IkBranchEquations,
    inside_core_indicator,
    optimise_ik_branch,
)
from ik.chain import POSE_EQUATIONS, KinematicChain
from ik.errors import UnreachableError
from ik.path import Path
from ik.solver import REACHED_POSE_TOLERANCE, IkSolver, damped_least_squares
from urdf import CollisionModel, Robot
from urdf.robot import Array

PLAN_NODE_SPACING_METRES = 0.01
"""Distance between the nodes of a planned joint path along the tool's path [m]."""
PLAN_NODES_PER_COARSE_NODE = 5
"""Number of nodes of the plan per node of the global search."""
BRANCH_POLYNOMIAL_DEGREE = (
    9  # degree of the polynomial that selects the branch; a higher one gains no speed and bends more
)
"""Degree of the polynomial that selects the branch; a higher one gains no speed and bends more."""
SELF_MOTION_STEP = 0.02
"""Step along the self-motion, the motion of the joints that leaves the tool at rest [rad]."""
MAX_SELF_MOTION = 3.2
"""Longest examined self-motion to either side [rad]: about half a turn of the elbow."""


class BranchPlanner:
    """Plans the branch of postures on which an arm can travel a path fastest.

    First, inverse kinematics follows the path from the home posture. For an arm with seven joints, dynamic programming
    over the self-motion (joint motion that leaves the tool at rest) then finds the globally fastest sequence of
    postures. Finally a polynomial is fitted to the sequence and optimised.

    Attributes:
        robot: the arm.
        path: the tool's path.
        collisions: collision check of the arm; None to allow collisions.
        chain: kinematics of the arm.
        s: path coordinates at which postures are planned, (k,) [m].
    """

    def __init__(self, robot: Robot, path: Path, collisions: CollisionModel | None = None) -> None:
        self.robot, self.path, self.collisions = robot, path, collisions
        self.chain = KinematicChain.from_robot(robot)
        nodes = (
            PLAN_NODES_PER_COARSE_NODE
            * max(4, round((path.s_max - path.s_min) / PLAN_NODE_SPACING_METRES / PLAN_NODES_PER_COARSE_NODE))
            + 1
        )
        self.s = np.linspace(path.s_min, path.s_max, nodes)

    def plan(self) -> tuple[IkBranchEquations, Array]:
        """Plan the branch.

        Returns:
            The branch, and its postures at the path coordinates `s`, (k, n) [rad or m].

        Raises:
            UnreachableError: no branch was found; the message is the reason, as the end of a sentence.
        """
        carried, coarse = self._carry_along(), slice(None, None, PLAN_NODES_PER_COARSE_NODE)
        spare = self.chain.joints == POSE_EQUATIONS + 1  # without a spare joint there is only one branch
        if spare:
            postures, valid = self._self_motion(self.s[coarse], carried[coarse])
        branch, q = self._refined(self._course(postures, valid) if spare else carried)
        why = self._objection(q)
        # Collision checks of all these postures are slow: made only where the best branch touches something.
        if why and spare and self.collisions is not None:
            for step, node in np.argwhere(valid):
                valid[step, node] = self.collisions.touching(postures[step, node]) is None
            branch, q = self._refined(self._course(postures, valid))
            why = self._objection(q)
        if why:
            raise UnreachableError(why)
        return branch, q

    def _carry_along(self) -> Array:
        """Postures (k, n) along the path by continuation: each starts from the one before, the first from home.

        Joint limits are ignored, because the self-motion can still lead back within them.
        """
        rotation, position = self.path.pose(self.s)
        count = len(self.s)
        postures = np.empty((count, self.chain.joints))
        start = int(np.abs(self.s).argmin())

        def reach(node: int, guess: Array, iterations: int) -> tuple[Array, bool]:
            target = rotation[:, :, [node]], position[:, [node]]
            q, error = damped_least_squares(self.chain, None, *target, guess[None], iterations=iterations)
            return q[0], bool(np.abs(error).max() < REACHED_POSE_TOLERANCE)

        postures[start], reached = reach(start, self.robot.home, 31)
        if not reached or self.robot.limits.margin(postures[start]).min() <= 0:
            found = IkSolver(self.robot).alternative_postures(rotation[:, :, start], position[:, start])
            if not len(found):
                raise UnreachableError(f"the arm cannot reach s = {self.s[start]:.3f} m")
            postures[start] = found[np.abs(found - self.robot.home).max(axis=1).argmin()]
        for nodes, back in ((range(start + 1, count), -1), (range(start - 1, -1, -1), 1)):
            for node in nodes:
                postures[node], reached = reach(node, postures[node + back], 9)
                if not reached:
                    raise UnreachableError(f"the arm cannot follow to s = {self.s[node]:.3f} m")
        return postures

    def _self_motion(self, s: Array, q: Array) -> tuple[Array, Array]:
        """Sample the self-motion of a seven-joint arm at path coordinates s (k,), from one posture q (k, n) each.

        Returns:
            Postures, (m, k, n), and whether each keeps the tool at its target, (m, k).
        """
        target = self.path.pose(s)
        reference = self._spare_motions(q)[:, :, 0]
        # Equal signs along the path, so that equal steps give similar postures.
        for node in range(1, len(s)):
            if reference[node] @ reference[node - 1] < 0:
                reference[node] *= -1
        sides = []
        for sign in (-1.0, 1.0):
            here, direction = q, sign * reference
            walked, good = [here], [np.full(len(s), True)]
            for _ in range(int(MAX_SELF_MOTION / SELF_MOTION_STEP)):
                here, error = damped_least_squares(
                    self.chain, None, *target, here + SELF_MOTION_STEP * direction, iterations=3
                )
                turned = self._spare_motions(here)[:, :, 0]
                direction = turned * np.where((turned * direction).sum(axis=1) < 0, -1.0, 1.0)[:, None]
                walked.append(here)
                good.append(good[-1] & (np.abs(error).max(axis=0) < 1e-6))
            sides.append((np.array(walked), np.array(good)))
        (left, left_good), (right, right_good) = sides
        return np.concatenate((left[:0:-1], right)), np.concatenate((left_good[:0:-1], right_good))

    def _course(self, postures: Array, valid: Array) -> Array:
        """The fastest sequence of postures, (k, n), by dynamic programming over candidates (m, c, n).

        The candidates belong to c coarse nodes; only those that are `valid` (m, c) are used. The cost of a step is the
        time of its slowest joint, plus penalties for missing speed on the core and missing distance from joint limits.
        """
        limits, s = self.robot.limits, self.s[::PLAN_NODES_PER_COARSE_NODE]
        margin = limits.margin(postures).min(axis=2)
        entry = np.where(
            valid & (margin > 0),
            MARGIN_COST_SECONDS_PER_RADIAN * np.maximum(0.0, WANTED_JOINT_LIMIT_MARGIN - margin),
            np.inf,
        )
        step = np.diff(s)
        total, chosen = step.mean() * entry[:, 0], []
        core = CORE_SPEED_SHORTFALL_WEIGHT * inside_core_indicator(self.path, (s[1:] + s[:-1]) / 2)
        for node in range(1, len(s)):
            moved = np.abs(postures[None, :, node] - postures[:, None, node - 1]) / limits.velocity
            slowness = moved.max(axis=2) / step[node - 1]
            missing = np.maximum(0.0, slowness - 1.0 / self.path.core_speed)
            reach = total[:, None] + step[node - 1] * (slowness + core[node - 1] * missing)
            chosen.append(reach.argmin(axis=0))
            total = reach.min(axis=0) + step[node - 1] * entry[:, node]
        if not np.isfinite(total.min()):
            raise UnreachableError(f"no course from s = {s[0]:g} to {s[-1]:g} m is free all the way")
        index = [int(total.argmin())]
        for choice in reversed(chosen):
            index.append(int(choice[index[-1]]))
        course = postures[index[::-1], np.arange(len(s))]
        guess = np.array([np.interp(self.s, s, course[:, joint]) for joint in range(self.chain.joints)]).T
        return damped_least_squares(self.chain, None, *self.path.pose(self.s), guess, iterations=5)[0]

    def _refined(self, q: Array) -> tuple[IkBranchEquations, Array]:
        """The branch that is fitted to postures q (k, n) and then optimised, and its postures, (k, n)."""
        null = self._spare_motions(q)
        # The directions that all null spaces share most: the leading eigenvectors of their mean projector.
        mean = np.einsum("kir,kjr->ij", null, null) / len(q)
        weights = np.linalg.eigh(mean)[1][:, ::-1][:, : self.chain.joints - POSE_EQUATIONS].T
        empty = IkBranchEquations(
            weights, np.zeros((len(weights), BRANCH_POLYNOMIAL_DEGREE + 1)), self.path.s_min, self.path.s_max
        )
        coefficients = np.linalg.lstsq(empty.chebyshev_basis(self.s), q @ weights.T, rcond=None)[0].T
        branch = IkBranchEquations(weights, coefficients, self.path.s_min, self.path.s_max)
        return optimise_ik_branch(self.chain, self.robot.limits, self.path, branch, self.s, q)

    def _spare_motions(self, q: Array) -> Array:
        """Orthonormal basis of the Jacobian's null space at postures q (k, n): (k, n, n - 6)."""
        jacobian = self.chain.jacobian(self.chain.forward_kinematics(q)).transpose(2, 0, 1)
        return np.linalg.svd(jacobian)[2][:, POSE_EQUATIONS:, :].transpose(0, 2, 1)

    def _objection(self, q: Array) -> str:
        """The first joint limit or collision that postures q (k, n) along the path violate; empty without one."""
        margin = self.robot.limits.margin(q)
        if margin.min() < 0:
            node, joint = divmod(int(margin.argmin()), margin.shape[1])
            beyond = f"{-margin[node, joint]:.3f} rad or m beyond its limit"
            return f"at s = {self.s[node]:.3f} m joint '{self.robot.joint_names[joint]}' would be {beyond}"
        for at, posture in zip(self.s, q, strict=True):
            if self.collisions is not None and (touching := self.collisions.touching(posture)):
                return f"at s = {at:.3f} m {touching[0]} would touch {touching[1]}"
        return ""
