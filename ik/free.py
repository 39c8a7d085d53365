"""The best branch along a path that keeps within the joint limits and touches nothing."""

import numpy as np
from numpy.typing import NDArray

from ik.branch import Branch
from ik.chain import Chain
from ik.errors import UnreachableError
from ik.path import Path
from ik.plan import plan_branch
from ik.selfmotion import Wish
from urdf import CollisionModel, Robot

Array = NDArray[np.float64]


def plan_free(
    robot: Robot, chain: Chain, path: Path, wish: Wish, collisions: CollisionModel
) -> tuple[Branch, Array, Array]:
    """Plan a branch, and plan it again around collisions where the best one touches something.

    Args:
        robot: the arm and its home posture.
        chain: the same, for many postures at once.
        path: where the tool should be.
        wish: what is asked of the branch.
        collisions: what the arm must not touch.

    Returns:
        The branch, coordinates s, (k,) [m], and postures on it, (k, n).

    Raises:
        UnreachableError: there is none; the message is the reason, as the end of a sentence.
    """

    def free(q: Array) -> bool:
        return collisions.touching(q) is None

    # Checking every sampled posture for collisions costs more than the rest: only where the best branch touches.
    for allowed in (None, free):
        branch, s, q = plan_branch(robot, chain, path, wish, allowed)
        why = objection(robot, collisions, s, q)
        if not why:
            return branch, s, q
        if chain.joints != 7:  # without a spare joint there is nothing to plan around with
            break
    raise UnreachableError(why)


def objection(robot: Robot, collisions: CollisionModel, s: Array, q: Array) -> str:
    """What is wrong with postures (k, n) along a path, or nothing."""
    margin = robot.limits.margin(q)
    if margin.min() < 0:
        node, joint = divmod(int(margin.argmin()), margin.shape[1])
        beyond = f"{-margin[node, joint]:.3f} rad or m beyond its limit"
        return f"at s = {s[node]:.3f} m joint '{robot.joint_names[joint]}' would be {beyond}"
    for at, posture in zip(s, q, strict=True):
        touching = collisions.touching(posture)
        if touching is not None:
            return f"at s = {at:.3f} m {touching[0]} would touch {touching[1]}"
    return ""
