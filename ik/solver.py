"""Inverse kinematics of many unrelated targets at once, and why an arm cannot hold its tool at one."""

from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from armdyn.errors import InputError
from ik.chain import Chain, least_motion
from ik.path import Path
from urdf import CollisionModel, Robot
from urdf.robot import Array

LIBRARY = 10_000  # random postures to start from; more cost more to search than they save in iterations
SEED = 1_618_033  # of the library; unusual, so that no test or user draws its targets from the same seed
STARTS = 32  # nearest of them tried in turn
ITERATIONS = 20
TOLERANCE = 1e-9  # m and rad
LONGEST_STEP = 0.6  # rad or m
REACH_SCALE = 0.5  # m that count as much as a radian when postures are compared


@dataclass(frozen=True)
class Answers:
    """What was found for k targets.

    Attributes:
        q: postures within the joint limits, (k, n) [rad or m]; the closest ones seen where the target was missed.
        reached: which targets were reached, (k,).
        distance: how far off the tool point is, (k,) [m].
        angle: how far its orientation is off, (k,) [rad].
    """

    q: Array
    reached: NDArray[np.bool_]
    distance: Array
    angle: Array


class Solver:
    r"""Damped least squares (Levenberg-Marquardt) from the nearest of many random postures, within joint limits.

    Each iteration takes the step

        \delta q = J^T (J J^T + \lambda I)^{-1} e,    \lambda = min(0.01, 0.01 |e|^2),

    where columns of joints that stand at a limit and would leave it are zero. Error-proportional damping keeps
    the quadratic convergence (Sugihara 2011, IEEE Transactions on Robotics 27(5)).

    Args:
        robot: the arm.
        seed: of the random postures.
        limited: whether joints must stay within their limits.
    """

    def __init__(self, robot: Robot, seed: int = SEED, limited: bool = True) -> None:
        self.chain = Chain.of(robot)
        self._lower, self._upper = robot.limits.lower, robot.limits.upper
        self._limited = limited
        rng = np.random.default_rng(seed)
        self._library = rng.uniform(self._lower, self._upper, (LIBRARY, self.chain.joints))
        motion = self.chain.motion(self._library)
        self._tree = cKDTree(_features(motion.rotation, motion.position))

    def solve(self, rotation: Array, position: Array, tolerance: float = TOLERANCE, starts: int = STARTS) -> Answers:
        """Postures that hold the tool at the targets.

        Args:
            rotation: orientations of the tool, (k, 3, 3).
            position: positions of the tool point in the base frame, (k, 3) [m].
            tolerance: error per component that counts as reached [m and rad].
            starts: how many starting postures are tried before a target is given up.

        Raises:
            InputError: shapes do not fit, or a target is not finite.
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
        errors = np.full((6, len(position)), np.inf)
        open_targets = np.arange(len(position))
        for start in range(starts):
            if start == 1:  # few targets get this far; looking for more starting postures costs as much as a descent
                nearest[open_targets, 1:] = self._tree.query(features[open_targets], k=np.arange(2, starts + 1))[1]
            guess = self._library[nearest[open_targets, start]]
            q, error = self._descend(turned[:, :, open_targets], placed[:, open_targets], guess, tolerance)
            better = _size(error) < _size(errors[:, open_targets])
            chosen = open_targets[better]
            best[chosen], errors[:, chosen] = q[better], error[:, better]
            open_targets = open_targets[np.abs(errors[:, open_targets]).max(axis=0) >= tolerance]
            if not len(open_targets):
                break
        return Answers(
            q=best,
            reached=np.abs(errors).max(axis=0) < tolerance,
            distance=np.linalg.norm(errors[:3], axis=0),
            angle=np.linalg.norm(errors[3:], axis=0),
        )

    def postures(self, rotation: Array, position: Array, starts: int = 64) -> Array:
        """Different postures that hold the tool at one target.

        Args:
            rotation: orientation of the tool, (3, 3).
            position: position of the tool point, (3,) [m].
            starts: how many starting postures are tried.

        Returns:
            Those that reached it, (m, n) with m from 0 to starts, from the nearest start on.
        """
        turned = np.repeat(np.asarray(rotation)[:, :, None], starts, axis=2)
        placed = np.repeat(np.asarray(position)[:, None], starts, axis=1)
        nearest = self._tree.query(_features(turned[:, :, :1], placed[:, :1])[0], k=starts)[1]
        q, error = self._descend(turned, placed, self._library[nearest], TOLERANCE)
        return q[np.abs(error).max(axis=0) < TOLERANCE]

    def descend(self, rotation: Array, position: Array, q: Array) -> tuple[Array, Array]:
        """Postures from one guess per target.

        Args:
            rotation: orientations of the tool, (k, 3, 3).
            position: positions of the tool point, (k, 3) [m].
            q: guesses, (k, n).

        Returns:
            Postures, (k, n), and the largest component of what each misses its target by, (k,) [m or rad].
        """
        start = np.clip(q, self._lower, self._upper) if self._limited else q
        turned, placed = np.ascontiguousarray(rotation.transpose(1, 2, 0)), np.ascontiguousarray(position.T)
        found, error = self._descend(turned, placed, start, TOLERANCE)
        return found, np.abs(error).max(axis=0)

    def _descend(self, rotation: Array, position: Array, q: Array, tolerance: float) -> tuple[Array, Array]:
        """Iterate until every target is met or the patience is over; met targets leave the batch."""
        final, errors = q.copy(), np.full((6, len(q)), np.inf)
        active = np.arange(len(q))
        for _ in range(ITERATIONS):
            motion = self.chain.motion(q)
            error = motion.error(rotation, position)
            final[active], errors[:, active] = q, error
            going = np.abs(error).max(axis=0) >= tolerance
            if not going.any():
                break
            jacobian = self.chain.jacobian(motion)
            if not going.all():
                active, q, error, jacobian = active[going], q[going], error[:, going], jacobian[:, :, going]
                rotation, position = rotation[:, :, going], position[:, going]
            q = self._step(q, error, jacobian.transpose(2, 0, 1))
        return final, errors

    def _step(self, q: Array, error: Array, jacobian: Array) -> Array:
        if self._limited:
            pull = (error.T[:, None, :] @ jacobian)[:, 0]
            held = ((q <= self._lower) & (pull < 0)) | ((q >= self._upper) & (pull > 0))
            jacobian = np.where(held[:, None, :], 0.0, jacobian)
        damping = 1e-2 * np.minimum(1.0, (error**2).sum(axis=0)) + 1e-12
        step = least_motion(jacobian, error.T, damping, LONGEST_STEP)
        return np.clip(q + step, self._lower, self._upper) if self._limited else q + step


def _features(rotation: Array, position: Array) -> Array:
    """Points (k, 9) whose distances tell how different two poses are."""
    return np.concatenate((position / REACH_SCALE, rotation[:, 0], rotation[:, 2])).T


def _size(error: Array) -> Array:
    return (error**2).sum(axis=0)


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
