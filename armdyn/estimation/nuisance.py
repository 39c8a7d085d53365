r"""Nuisance unknowns that act in one part of the samples each, such as states of windows, eliminated from a fit.

With the derivatives J by the unknowns of interest and S_w by the nuisance unknowns of part w, and the weights k of the
samples, the Hessian of both is an arrowhead matrix, of which the Schur complement remains:

    H = J'kJ - sum_w B_w A_w^-1 B_w',     A_w = S_w'k S_w + h_w,     B_w = J_w'k S_w

(Triggs et al., Bundle Adjustment, Lecture Notes in Computer Science 1883, 2000, §6.1).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from armdyn.estimation.expansion import BoundedExpansion
from armdyn.estimation.solve import inverse_positive


@dataclass(frozen=True, eq=False)
class EliminatedNuisance:
    """What remains of u unknowns after s nuisance unknowns in each of w parts have been eliminated.

    Attributes:
        hessian: (u, u) Hessian H.
        slopes: (u, ...) derivatives of the samples, with the nuisance unknowns at their best values.
        inverse: (w, s, s) inverses of A_w.
        between: (w, u, s) B_w.
    """

    hessian: np.ndarray
    slopes: np.ndarray
    inverse: np.ndarray
    between: np.ndarray

    @property
    def follow(self) -> np.ndarray:
        """(w, u, s) changes of the best nuisance unknowns, with the sign turned, per change of those of interest."""
        return self.between @ self.inverse


def eliminate_nuisance(
    slopes: np.ndarray, of_nuisance: np.ndarray, weight: np.ndarray, parts: Sequence[slice], held: np.ndarray
) -> EliminatedNuisance:
    """The normal equations of the unknowns of interest, without the nuisance unknowns (Schur complement).

    Args:
        slopes: (u, N, c) derivatives of N samples of c channels by the unknowns of interest.
        of_nuisance: (s, N, c) their derivatives by the nuisance unknowns of their part.
        weight: (N, c) weights of the samples' squares.
        parts: the samples of each of w parts.
        held: (w, s) weights of the squares of the nuisance unknowns, by their priors.
    """
    H, own, inverses, betweens = np.zeros((len(slopes), len(slopes))), np.empty_like(slopes), [], []
    for h, rows in zip(held, parts, strict=True):
        J, S, k = slopes[:, rows], of_nuisance[:, rows], weight[rows]
        inverse = inverse_positive(np.einsum("snj,tnj->st", S * k, S) + np.diag(h))
        B = np.einsum("unj,snj->us", J * k, S)
        own[:, rows] = J - np.einsum("us,snj->unj", B @ inverse, S)
        H += np.einsum("unj,vnj->uv", own[:, rows], J * k)
        inverses.append(inverse)
        betweens.append(B)
    return EliminatedNuisance(H, own, np.array(inverses), np.array(betweens))


@dataclass(frozen=True, eq=False)
class ArrowheadExpansion:
    """Expansion of a cost of u unknowns of interest, then s nuisance unknowns of each of w parts.

    Attributes:
        cost: the cost.
        gradient: (u + w s) its first derivatives.
        hessian: (u, u) its second derivatives by those of interest, with the nuisance unknowns at their best values.
        eliminated: what the nuisance unknowns depend on.
    """

    cost: float
    gradient: np.ndarray
    hessian: np.ndarray
    eliminated: EliminatedNuisance

    def step(self, lower: np.ndarray, upper: np.ndarray, damping: float) -> tuple[np.ndarray, float]:
        """The step of `Expansion`, best within the bounds of those of interest; only these are damped."""
        u, (w, _, s) = len(self.hessian), self.eliminated.inverse.shape
        own, nuisance = -self.gradient[:u], -self.gradient[u:].reshape(w, s)
        own = own - np.einsum("wus,ws->u", self.eliminated.follow, nuisance)
        step, size = BoundedExpansion(self.cost, -own, self.hessian).step(lower[:u], upper[:u], damping)
        left = nuisance - np.einsum("wus,u->ws", self.eliminated.between, step)
        moved = np.einsum("wst,wt->ws", self.eliminated.inverse, left)
        return np.concatenate([step, moved.ravel()]), size
