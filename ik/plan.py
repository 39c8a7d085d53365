"""From a path to the branch of postures along it."""

import numpy as np
from numpy.typing import NDArray

from ik.branch import Branch
from ik.chain import Chain
from ik.errors import UnreachableError
from ik.path import Path
from ik.refine import refine
from ik.selfmotion import Wish, best_sequence, null_space, project, trace
from urdf import Robot

Array = NDArray[np.float64]

SPACING = 0.01  # m between the nodes of the plan
COARSE = 5  # nodes of the plan per node of the global search
DEGREE = 9  # of the polynomial that picks the branch; more gains no speed and bends more
REACHED = 1e-9  # m and rad


def plan_branch(robot: Robot, chain: Chain, path: Path, wish: Wish) -> tuple[Branch, Array, Array]:
    """The branch on which the path can be travelled fastest.

    The home posture is carried along the path; where the arm has one spare joint, dynamic programming over its
    self-motion finds the global course; a polynomial takes it over and is refined.

    Args:
        robot: the arm.
        chain: the same, for many postures at once.
        path: where the tool should be.
        wish: what is asked of the branch.

    Returns:
        The branch, coordinates s, (k,) [m], and postures on it, (k, n).

    Raises:
        UnreachableError: a target cannot be reached; the message names it.
    """
    nodes = COARSE * max(4, round((path.s_max - path.s_min) / SPACING / COARSE)) + 1
    s = np.linspace(path.s_min, path.s_max, nodes)
    q = carry_along(robot, chain, path, s, robot.home)
    spare = chain.joints - 6
    if spare == 1:
        coarse = np.arange(0, nodes, COARSE)
        postures, valid = trace(chain, path, s[coarse], q[coarse])
        course = best_sequence(robot.limits, wish, s[coarse], postures, valid)
        if course is None:
            raise UnreachableError(
                f"robot '{robot.name}': every course from s = {path.s_min:g} to {path.s_max:g} m passes a joint limit "
                "somewhere; shorten or move the line, or choose another home posture"
            )
        guess = np.array([np.interp(s, s[coarse], course[:, joint]) for joint in range(chain.joints)]).T
        q, _ = project(chain, *path.pose(s), guess)
    branch, q = refine(chain, robot.limits, path, wish, fit_branch(chain, s, q), s, q)
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


def carry_along(robot: Robot, chain: Chain, path: Path, s: Array, home: Array) -> Array:
    """Postures along a path, each the nearest to the one before, starting from home where s is nearest to 0.

    Raises:
        UnreachableError: a target cannot be reached.
    """
    rotation, position = path.pose(s)
    postures = np.empty((len(s), chain.joints))
    start = int(np.abs(s).argmin())
    for nodes, back in ((range(start, len(s)), -1), (range(start - 1, -1, -1), 1)):
        for node in nodes:
            guess = home if node == start else postures[node + back]
            q, error = project(
                chain,
                rotation[:, :, node : node + 1],
                position[:, node : node + 1],
                guess[None],
                30 if node == start else 6,
            )
            if error[0] > REACHED:
                where = ", ".join(f"{value:.3f}" for value in position[:, node])
                raise UnreachableError(
                    f"robot '{robot.name}': the target at s = {s[node]:.3f} m, ({where}) m, is out of reach by "
                    f"{error[0]:.3g} m or rad; move the line closer or shorten it"
                )
            postures[node] = q[0]
    return postures
