"""Inverse kinematics of many targets at once, by damped least squares from the nearest of many random postures."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from armdyn.errors import InputError
from ik.chain import POSE_EQUATIONS, KinematicChain, scale_down_steps
from urdf import Limits, Robot
from urdf.robot import Array

REACHED_POSE_TOLERANCE = 1e-9
"""Largest error of a pose at which its target counts as reached [m and rad]."""
MAX_DESCENT_ITERATIONS = 20
"""Default number of iterations of the damped least squares."""
MAX_JOINT_STEP_PER_ITERATION = 0.6
"""Largest change of a joint in one iteration of the damped least squares [rad or m]."""
STEPS_BEFORE_GIVING_UP = 4
"""Number of iterations after which a target whose error is still above `hopeless` is given up."""
RANDOM_START_POSTURES = 10_000
"""Number of random postures to start from; more cost more to search than they save in iterations."""
START_POSTURE_SEED = (
    1_618_033  # seed of the random postures; unusual, so that no test draws its targets from the same seed
)
"""Seed of the random postures; unusual, so that no test draws its targets from the same seed."""
MAX_STARTS_PER_TARGET = 32
"""Number of nearest random postures that are tried in turn for a target."""
STARTS_FOR_DIFFERENT_POSTURES = 64
"""Number of nearest random postures from which different postures for one target are searched."""
METRES_EQUAL_TO_ONE_RADIAN = 0.5
"""Distance that counts as much as an angle of 1 rad when poses are compared [m]."""


def damped_least_squares(
    chain: KinematicChain,
    limits: Limits | None,
    rotation: Array,
    position: Array,
    q: Array,
    *,
    tolerance: float = REACHED_POSE_TOLERANCE,
    iterations: int = MAX_DESCENT_ITERATIONS,
    hopeless: float = np.inf,
) -> tuple[Array, Array]:
    r"""Solve inverse kinematics by damped least squares (Levenberg-Marquardt), from one guess per target pose.

    Each iteration takes the smallest joint motion that removes the pose error e,

        \delta q = J^T (J J^T + \lambda I)^{-1} e,    \lambda = min(0.01, 0.01 |e|^2),

    where the Jacobian's columns of joints that would leave their limits are zero. Damping proportional to the error
    keeps the quadratic convergence (Sugihara 2011, IEEE Transactions on Robotics 27(5)).

    Args:
        chain: kinematics of the arm.
        limits: limits of the joints; None for joints without limits.
        rotation: target orientations of the tool, (3, 3, k), or a common one, (3, 3, 1).
        position: target positions of the tool point, (3, k) [m].
        q: guesses, (k, n) [rad or m].
        tolerance: largest error per component at which a target counts as reached [m and rad].
        iterations: number of evaluations of the error, one more than the number of steps.
        hopeless: error above which a target is given up after `STEPS_BEFORE_GIVING_UP` steps [m and rad].

    Returns:
        Postures, (k, n), and their remaining errors, (6, k) [m and rad].
    """
    q = q.copy() if limits is None else np.clip(q, limits.lower, limits.upper)
    final, errors = q.copy(), np.full((POSE_EQUATIONS, len(q)), np.inf)
    active = np.arange(len(q))
    for step in range(iterations):
        motion = chain.forward_kinematics(q)
        error = motion.pose_error(rotation, position)
        final[active], errors[:, active] = q, error
        size = np.abs(error).max(axis=0)
        going = size >= tolerance
        if step >= STEPS_BEFORE_GIVING_UP:
            going &= size < hopeless
        if not going.any() or step == iterations - 1:
            break
        jacobian = chain.jacobian(motion)
        if not going.all():
            active, q, error, jacobian = active[going], q[going], error[:, going], jacobian[:, :, going]
            position = position[:, going]
            rotation = rotation if rotation.shape[2] == 1 else rotation[:, :, going]
        rows = jacobian.transpose(2, 0, 1)
        if limits is not None:
            pull = (error.T[:, None, :] @ rows)[:, 0]
            held = ((q <= limits.lower) & (pull < 0)) | ((q >= limits.upper) & (pull > 0))
            rows = np.where(held[:, None, :], 0.0, rows)
        columns = rows.transpose(0, 2, 1)
        normal = rows @ columns
        normal[:, np.arange(POSE_EQUATIONS), np.arange(POSE_EQUATIONS)] += (
            1e-2 * np.minimum(1.0, (error**2).sum(axis=0)) + 1e-12
        )[:, None]
        q = q + scale_down_steps(
            (columns @ np.linalg.solve(normal, error.T[:, :, None]))[:, :, 0], MAX_JOINT_STEP_PER_ITERATION
        )
        if limits is not None:
            q = np.clip(q, limits.lower, limits.upper)
    return final, errors


@dataclass(frozen=True)
class IkSolutions:
    """Solutions of inverse kinematics for k targets.

    Attributes:
        q: postures within the joint limits, (k, n) [rad or m]; where a target was not reached, the closest one found.
        reached: whether each target was reached, (k,).
        distance: remaining distance of the tool point from its target, (k,) [m].
        angle: remaining angle between the tool and its target orientation, (k,) [rad].
    """

    q: Array
    reached: NDArray[np.bool_]
    distance: Array
    angle: Array


class IkSolver:
    """Solves inverse kinematics from the nearest of many random postures, and where this fails from the next ones.

    Args:
        robot: the arm.
        limited: whether the joints must stay within their limits.
    """

    def __init__(self, robot: Robot, limited: bool = True) -> None:
        self.chain = KinematicChain.from_robot(robot)
        self._limits = robot.limits if limited else None
        rng = np.random.default_rng(START_POSTURE_SEED)
        self._library = rng.uniform(robot.limits.lower, robot.limits.upper, (RANDOM_START_POSTURES, self.chain.joints))
        motion = self.chain.forward_kinematics(self._library)
        self._tree = cKDTree(_features(motion.rotation, motion.position))

    def solve(
        self,
        rotation: Array,
        position: Array,
        tolerance: float = REACHED_POSE_TOLERANCE,
        starts: int = MAX_STARTS_PER_TARGET,
    ) -> IkSolutions:
        """Find one posture for each target pose of the tool.

        Args:
            rotation: target orientations of the tool, (k, 3, 3).
            position: target positions of the tool point in the base frame, (k, 3) [m].
            tolerance: largest error per component at which a target counts as reached [m and rad].
            starts: number of starting postures that are tried before a target is given up.

        Raises:
            InputError: an array has the wrong shape, or a target is not finite.
        """
        if rotation.shape != (len(position), 3, 3) or position.shape != (len(position), 3):
            raise InputError(
                f"targets: rotations {rotation.shape} and positions {position.shape} should be (k, 3, 3), (k, 3)"
            )
        if not (np.isfinite(rotation).all() and np.isfinite(position).all()):
            raise InputError("targets: a rotation or position is not finite; remove it")
        turned, placed = np.ascontiguousarray(rotation.transpose(1, 2, 0)), np.ascontiguousarray(position.T)
        features = _features(turned, placed)
        nearest = np.empty((len(position), starts), dtype=np.intp)
        nearest[:, :1] = self._tree.query(features, k=[1])[1]
        best = np.empty((len(position), self.chain.joints))
        errors = np.full((POSE_EQUATIONS, len(position)), np.inf)
        unsolved = np.arange(len(position))
        for start in range(starts):
            if start == 1:  # few targets get this far; looking for more starting postures costs as much as a descent
                nearest[unsolved, 1:] = self._tree.query(features[unsolved], k=np.arange(2, starts + 1))[1]
            guess = self._library[nearest[unsolved, start]]
            q, error = damped_least_squares(
                self.chain, self._limits, turned[:, :, unsolved], placed[:, unsolved], guess, tolerance=tolerance
            )
            better = (error**2).sum(axis=0) < (errors[:, unsolved] ** 2).sum(axis=0)
            best[unsolved[better]], errors[:, unsolved[better]] = q[better], error[:, better]
            unsolved = unsolved[np.abs(errors[:, unsolved]).max(axis=0) >= tolerance]
            if not len(unsolved):
                break
        return IkSolutions(
            q=best,
            reached=np.abs(errors).max(axis=0) < tolerance,
            distance=np.linalg.norm(errors[:3], axis=0),
            angle=np.linalg.norm(errors[3:], axis=0),
        )

    def alternative_postures(self, rotation: Array, position: Array) -> Array:
        """Find different postures for one target pose of the tool.

        Args:
            rotation: target orientation of the tool, (3, 3).
            position: target position of the tool point in the base frame, (3,) [m].

        Returns:
            Postures that reach the target, (m, n) [rad or m], with m from 0 to `STARTS_FOR_DIFFERENT_POSTURES`.
        """
        turned, placed = np.asarray(rotation)[:, :, None], np.asarray(position)[:, None]
        nearest = self._tree.query(_features(turned, placed)[0], k=STARTS_FOR_DIFFERENT_POSTURES)[1]
        guess = self._library[nearest]
        q, error = damped_least_squares(
            self.chain, self._limits, turned, np.repeat(placed, STARTS_FOR_DIFFERENT_POSTURES, axis=1), guess
        )
        return q[np.abs(error).max(axis=0) < REACHED_POSE_TOLERANCE]


def _features(rotation: Array, position: Array) -> Array:
    """Points (k, 9) whose Euclidean distance measures the difference of two poses."""
    return np.concatenate((position / METRES_EQUAL_TO_ONE_RADIAN, rotation[:, 0], rotation[:, 2])).T
