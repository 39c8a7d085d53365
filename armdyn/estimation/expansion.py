"""Quadratic expansions of a cost at a point, and the damped step within bounds to the minimum of each."""

from typing import NamedTuple, Protocol

import numpy as np

from armdyn.estimation.solve import solve_bounded


class Expansion(Protocol):
    """Cost of p unknowns, expanded to second order about a point: its value, gradient and Hessian there."""

    @property
    def cost(self) -> float:
        """The cost at the point."""

    @property
    def gradient(self) -> np.ndarray:
        """(p,) first derivatives of the cost."""

    @property
    def hessian(self) -> np.ndarray:
        """(p, p) Gauss-Newton approximation of the second derivatives, or that of the unknowns of interest alone."""

    def step(self, lower: np.ndarray, upper: np.ndarray, damping: float) -> tuple[np.ndarray, float]:
        """(p,) step to the minimum of the quadratic, and its length in standard deviations, sqrt(step' H step).

        Args:
            lower: (p,) lower bounds of the step.
            upper: (p,) upper bounds of the step.
            damping: share of the curvature along each unknown that is added to it.
        """


class QuadraticExpansion(NamedTuple):
    """Quadratic expansion of the cost J at a point.

    Attributes:
        cost: J at the point.
        gradient: (p,) first derivatives of J.
        hessian: (p, p) Gauss-Newton approximation, positive semidefinite.
    """

    cost: float
    gradient: np.ndarray
    hessian: np.ndarray

    @classmethod
    def diverged(cls, count: int) -> "QuadraticExpansion":
        """The expansion of an infinite cost of `count` unknowns."""
        return cls(np.inf, np.zeros(count), np.eye(count))

    @np.errstate(all="ignore")  # near a divergence the curvature overflows, and the step is not a descent step
    def step(self, lower: np.ndarray, upper: np.ndarray, damping: float) -> tuple[np.ndarray, float]:
        """The step of `Expansion`: unknowns stay on bounds beyond which the cost would fall; the end is not bounded."""
        step = np.zeros(len(self.gradient))
        free = not_held_by_bound(lower, upper, self.gradient)
        free &= np.diag(self.hessian) > 0.0  # a value without effect stays: its step would be 0/0
        if not free.any():
            return step, 0.0
        matrix = self.hessian[np.ix_(free, free)]
        scale = np.sqrt(np.maximum(np.diag(matrix), np.finfo(float).tiny))
        scaled = matrix / np.outer(scale, scale) + damping * np.eye(len(scale))
        reduced = -self.gradient[free] / scale
        try:
            solution = np.linalg.solve(scaled, reduced)
        except np.linalg.LinAlgError:
            solution = np.linalg.lstsq(scaled, reduced, rcond=1e-12)[0]
        step[free] = solution / scale
        return step, float(np.sqrt(max(step @ self.hessian @ step, 0.0)))


class BoundedExpansion(QuadraticExpansion):
    """Expansion with a positive definite Hessian matrix, whose step ends at the minimum within the bounds."""

    def step(self, lower: np.ndarray, upper: np.ndarray, damping: float) -> tuple[np.ndarray, float]:
        """The step of `Expansion`."""
        A = self.hessian + damping * np.diag(np.diag(self.hessian))
        step = solve_bounded(A, -self.gradient, lower, upper).x
        return step, float(np.sqrt(max(step @ self.hessian @ step, 0.0)))


def not_held_by_bound(lower: np.ndarray, upper: np.ndarray, gradient: np.ndarray) -> np.ndarray:
    """(p,) bool: False for a parameter on a bound beyond which the cost would fall further.

    Args:
        lower: (p,) lower bounds of the parameters' changes.
        upper: (p,) upper bounds of their changes.
        gradient: (p,) first derivatives of the cost.
    """
    return ~((lower >= 0.0) & (gradient > 0) | (upper <= 0.0) & (gradient < 0))
