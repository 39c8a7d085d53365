"""From a path to the branch of postures along it that keeps within the joint limits and touches nothing."""

from collections.abc import Callable

import numpy as np

from ik.branch import Branch, refine
from ik.chain import Chain
from ik.errors import UnreachableError
from ik.path import Path
from ik.selfmotion import Goal, best_sequence, null_space, project, trace
from ik.solver import Solver
from urdf import CollisionModel, Robot
from urdf.robot import Array

SPACING = 0.01  # m between the nodes of the plan
COARSE = 5  # nodes of the plan per node of the global search
DEGREE = 9  # of the polynomial that picks the branch; more gains no speed and bends more
REACHED = 1e-9  # m and rad


def plan_branch(
    robot: Robot, chain: Chain, path: Path, goal: Goal, allowed: Callable[[Array], bool] | None = None
) -> tuple[Branch, Array, Array]:
    """The branch on which the path can be travelled fastest.

    The home posture is carried along the path; where the arm has one spare joint, dynamic programming over its
    self-motion finds the global course; a polynomial takes it over and is refined.

    Args:
        robot: the arm.
        chain: the same, for many postures at once.
        path: where the tool should be.
        goal: what to optimise the branch for.
        allowed: says whether a posture (n,) may be used; None allows all.

    Returns:
        The branch, coordinates s, (k,) [m], and postures on it, (k, n).

    Raises:
        UnreachableError: no smooth course leads along the whole path.
    """
    nodes = COARSE * max(4, round((path.s_max - path.s_min) / SPACING / COARSE)) + 1
    s = np.linspace(path.s_min, path.s_max, nodes)
    q = carry_along(robot, chain, path, s)
    if chain.joints == 7:
        coarse = np.arange(0, nodes, COARSE)
        postures, valid = trace(chain, path, s[coarse], q[coarse])
        if allowed is not None:
            for step, node in np.argwhere(valid):
                valid[step, node] = allowed(postures[step, node])
        course = best_sequence(robot.limits, goal, s[coarse], postures, valid)
        if course is None:
            raise UnreachableError(f"no course from s = {path.s_min:g} to {path.s_max:g} m is free all the way")
        guess = np.array([np.interp(s, s[coarse], course[:, joint]) for joint in range(chain.joints)]).T
        q, _ = project(chain, *path.pose(s), guess)
    branch, q = refine(chain, robot.limits, path, goal, fit_branch(chain, s, q), s, q)
    return branch, s, q


def fit_branch(chain: Chain, s: Array, q: Array) -> Branch:
    """The branch that runs closest to given postures.

    Args:
        chain: the arm.
        s: coordinates, (k,) [m].
        q: postures, (k, n).
    """
    null = null_space(chain.jacobian(chain.motion(q)))
    # The directions that all null spaces share most: the leading eigenvectors of their mean projector.
    mean = np.einsum("kir,kjr->ij", null, null) / len(s)
    weights = np.linalg.eigh(mean)[1][:, ::-1][:, : chain.joints - 6].T
    empty = Branch(weights, np.zeros((len(weights), DEGREE + 1)), float(s[0]), float(s[-1]))
    coefficients = np.linalg.lstsq(empty.basis(s), q @ weights.T, rcond=None)[0].T
    return Branch(weights, coefficients, float(s[0]), float(s[-1]))


def carry_along(robot: Robot, chain: Chain, path: Path, s: Array) -> Array:
    """Postures along a path, each the nearest to the one before, starting near home where s is nearest to 0.

    Joint limits are left to what follows: the self-motion can still lead back within them.

    Args:
        robot: the arm and its home posture.
        chain: the same, for many postures at once.
        path: where the tool should be.
        s: coordinates, (k,) [m].

    Raises:
        UnreachableError: a target cannot be reached from its neighbour.
    """
    rotation, position = path.pose(s)
    postures = np.empty((len(s), chain.joints))
    start = int(np.abs(s).argmin())
    postures[start] = _start(robot, chain, rotation[:, :, [start]], position[:, [start]], float(s[start]))
    for nodes, back in ((range(start + 1, len(s)), -1), (range(start - 1, -1, -1), 1)):
        for node in nodes:
            guess = postures[[node + back]]
            q, error = project(chain, rotation[:, :, [node]], position[:, [node]], guess, 8)
            if error[0] > REACHED:
                raise UnreachableError(f"the arm cannot follow to s = {s[node]:.3f} m")
            postures[node] = q[0]
    return postures


def _start(robot: Robot, chain: Chain, rotation: Array, position: Array, s: float) -> Array:
    """The posture at one target that is nearest to home, (n,)."""
    q, error = project(chain, rotation, position, robot.home[None], 30)
    if error[0] < REACHED and robot.limits.margin(q[0]).min() > 0:
        return np.asarray(q[0])
    found = Solver(robot).postures(rotation[:, :, 0], position[:, 0])
    if not len(found):
        raise UnreachableError(f"the arm cannot reach s = {s:.3f} m")
    return np.asarray(found[np.abs(found - robot.home).max(axis=1).argmin()])


def plan_free(
    robot: Robot, chain: Chain, path: Path, goal: Goal, collisions: CollisionModel
) -> tuple[Branch, Array, Array]:
    """Plan a branch, and plan it again around collisions where the best one touches something.

    Args:
        robot: the arm and its home posture.
        chain: the same, for many postures at once.
        path: where the tool should be.
        goal: what to optimise the branch for.
        collisions: what the arm must not touch.

    Returns:
        The branch, coordinates s, (k,) [m], and postures on it, (k, n).

    Raises:
        UnreachableError: there is none; the message is the reason, as the end of a sentence.
    """

    def free(q: Array) -> bool:
        return collisions.touching(q) is None

    # Collision checks of every sampled posture are slow: they are made only where the best branch touches something.
    for allowed in (None, free):
        branch, s, q = plan_branch(robot, chain, path, goal, allowed)
        why = objection(robot, collisions, s, q)
        if not why:
            return branch, s, q
        if chain.joints != 7:  # without a spare joint there is only one branch
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
