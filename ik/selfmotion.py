"""What a redundant arm can do while its tool stands still, and the best way along a path through it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ik.chain import Chain, shortened
from ik.path import Path
from urdf import Limits
from urdf.robot import Array

STEP = 0.02  # rad along the self-motion
LONGEST = 3.2  # rad to either side: about half a turn of the elbow
CORRECTIONS = 4


@dataclass(frozen=True)
class Goal:
    """What a branch is optimised for.

    Attributes:
        core: the stretch on which speed matters most [m].
        core_speed: speed asked of it [m/s].
        margin: distance to keep from every joint limit [rad or m].
        core_weight: time that one part of missing speed on the core is worth [m].
        margin_weight: time that a radian of missing margin is worth [s/rad].
    """

    core: tuple[float, float]
    core_speed: float
    margin: float = 0.53
    core_weight: float = 3000.0
    margin_weight: float = 10.0

    def in_core(self, s: Array) -> NDArray[np.bool_]:
        """Which coordinates belong to the core."""
        slack = 1e-9
        return (s >= self.core[0] - slack) & (s <= self.core[1] + slack)


def project(
    chain: Chain, rotation: Array, position: Array, q: Array, corrections: int = CORRECTIONS
) -> tuple[Array, Array]:
    """Bring postures back to their targets by the shortest joint motion (Gauss-Newton).

    Args:
        chain: the arm.
        rotation: targets, (3, 3, k).
        position: targets, (3, k) [m].
        q: postures, (k, n).
        corrections: number of steps.

    Returns:
        The postures, (k, n), and what is left of their errors, (k,) [m or rad].
    """
    q = q.copy()
    for _ in range(corrections):
        motion = chain.motion(q)
        inverse = np.linalg.pinv(chain.jacobian(motion).transpose(2, 0, 1))
        q += shortened((inverse @ motion.error(rotation, position).T[:, :, None])[:, :, 0], 0.3)
    return q, np.abs(chain.motion(q).error(rotation, position)).max(axis=0)


def null_space(jacobian: Array) -> Array:
    """Orthonormal joint motions that leave the tool where it is: (k, n, n - 6) for Jacobians (6, n, k)."""
    return np.linalg.svd(jacobian.transpose(2, 0, 1))[2][:, 6:, :].transpose(0, 2, 1)


def trace(chain: Chain, path: Path, s: Array, q: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Walk along the self-motion of an arm with one spare joint, from one posture per coordinate.

    Args:
        chain: the arm, with seven joints.
        path: where the tool stands.
        s: coordinates, (k,) [m].
        q: a posture at each, (k, n).

    Returns:
        Postures, (m, k, n), and which of them hold the tool in place, (m, k).
    """
    rotation, position = path.pose(s)
    reference = null_space(chain.jacobian(chain.motion(q)))[:, :, 0]
    # Equal signs along the path, so that equal steps give similar postures.
    for node in range(1, len(s)):
        if reference[node] @ reference[node - 1] < 0:
            reference[node] *= -1
    sides = []
    for sign in (-1.0, 1.0):
        here, direction = q, sign * reference
        walked, good = [here], [np.full(len(s), True)]
        for _ in range(int(LONGEST / STEP)):
            here, error = project(chain, rotation, position, here + STEP * direction, 2)
            turned = null_space(chain.jacobian(chain.motion(here)))[:, :, 0]
            direction = turned * np.where((turned * direction).sum(axis=1) < 0, -1.0, 1.0)[:, None]
            walked.append(here)
            good.append(good[-1] & (error < 1e-6))
        sides.append((np.array(walked), np.array(good)))
    (left, left_good), (right, right_good) = sides
    return np.concatenate((left[:0:-1], right)), np.concatenate((left_good[:0:-1], right_good))


def best_sequence(limits: Limits, goal: Goal, s: Array, postures: Array, valid: NDArray[np.bool_]) -> Array | None:
    """The quickest way along the path through sampled postures, by dynamic programming: no local optimum.

    The cost of a step is the time that the slowest joint needs for it, plus the goal's own terms.

    Args:
        limits: of the joints.
        goal: what to optimise for.
        s: coordinates, (k,) [m].
        postures: candidates, (m, k, n).
        valid: which of them may be used, (m, k).

    Returns:
        One posture per coordinate, (k, n), or None where no sequence exists.
    """
    margin = limits.margin(postures).min(axis=2)
    entry = np.where(valid & (margin > 0), goal.margin_weight * np.maximum(0.0, goal.margin - margin), np.inf)
    step = np.diff(s)
    total, chosen = step.mean() * entry[:, 0], []
    core = goal.in_core((s[1:] + s[:-1]) / 2)
    for node in range(1, len(s)):
        moved = np.abs(postures[None, :, node] - postures[:, None, node - 1]) / limits.velocity
        slowness = moved.max(axis=2) / step[node - 1]
        time = step[node - 1] * slowness
        if core[node - 1]:
            time = time + goal.core_weight * step[node - 1] * np.maximum(0.0, slowness - 1.0 / goal.core_speed)
        reach = total[:, None] + time
        chosen.append(reach.argmin(axis=0))
        total = reach.min(axis=0) + step[node - 1] * entry[:, node]
    if not np.isfinite(total.min()):
        return None
    index = [int(total.argmin())]
    for choice in reversed(chosen):
        index.append(int(choice[index[-1]]))
    return postures[index[::-1], np.arange(len(s))]
