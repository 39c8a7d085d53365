r"""Unknowns that differ from unit to unit at random, beside the unknowns of interest (linear mixed model).

In unit k the residuals are r = X (d + s_k) + e. The unknowns d are sought; s_k is normal of mean m and covariance P,
other in every unit; and e has n times the variance by which the sums were weighted. With S = X'X and b = X'r of the
unknowns that scatter, the residuals without them have the weight V^-1 = (1 - X P M X') / n with M = (S P + n)^-1:

    X' V^-1 X = M S,        X' V^-1 (r - X m) = M (b - S m).

m, P and n are found from how b scatters over the units, so that n holds for correlated samples too, by expectation
maximisation (Laird & Ware, Biometrics 38, 1982).
"""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from armdyn.estimation.equations import NormalEquations
from armdyn.estimation.solve import solve_positive

EM_STEPS, MIN_NOISE = 10, 1e-6
"""Number of steps of the expectation maximisation; and least n, as well as what is added to the diagonal of sums of
mean 1, for unknowns that no sample depends on."""
MIN_MEAN_INFORMATION = 1e-18
"""Least mean information about an unknown, by whose root it is scaled."""


@dataclass(frozen=True, eq=False)
class RandomEffects:
    """How p unknowns scatter, for each of g groups of units.

    Attributes:
        mean: (g, p) m.
        scatter: (g, p, p) P.
        noise: (g,) n.
    """

    mean: np.ndarray
    scatter: np.ndarray
    noise: np.ndarray

    @classmethod
    def of_noise(cls, noise: np.ndarray, unknowns: int) -> Self:
        """No scatter, and (g,) noise."""
        return cls(np.zeros((len(noise), unknowns)), np.zeros((len(noise), unknowns, unknowns)), noise)

    @classmethod
    def fitted(cls, equations: NormalEquations, kinds: np.ndarray, independent: float, shared: float) -> Self:
        """Fit to units k = 0, 1, ..., of which unit k belongs to group k modulo g.

        Args:
            equations: the units.
            kinds: (g,) the same number for groups whose unknowns scatter alike.
            independent: number of independent units of each group.
            shared: weight of the mean scatter of all groups of a kind beside a group's own, in independent units.
        """
        p, groups = equations.slope.shape[1], len(kinds)
        S, b = equations.gram.reshape(-1, groups, p, p), equations.slope.reshape(-1, groups, p)
        level = np.maximum(np.einsum("...ii->...i", S).mean(axis=0), MIN_MEAN_INFORMATION)
        unit, known = 1.0 / np.sqrt(level), np.maximum((level > MIN_MEAN_INFORMATION).sum(axis=-1), 1)
        S, b = S * unit[:, :, None] * unit[:, None, :] + MIN_NOISE * np.eye(p), b * unit
        mean = solve_positive(S.sum(axis=0), b.sum(axis=0))
        error = b - _times(S, mean)
        P, n = np.tile(np.eye(p), (groups, 1, 1)), np.ones(groups)
        for _ in range(EM_STEPS):
            M = np.linalg.inv(S @ P + n[:, None, None] * np.eye(p))
            u = _times(M, error)
            own, covariance = _times(P, u), P - P @ M @ S @ P
            left = n[:, None] * u
            squares = (left * solve_positive(S, left)).sum(axis=-1)
            n = np.maximum((squares + np.einsum("...ij,...ji->...", S, covariance)).mean(axis=0) / known, MIN_NOISE)
            each = (own[..., None] * own[..., None, :] + covariance).mean(axis=0)
            P = pooled(each, kinds, independent, shared)
        return cls(mean * unit, P * unit[:, :, None] * unit[:, None, :], n)

    def integrated_out(self, equations: NormalEquations, columns: np.ndarray) -> NormalEquations:
        """The equations of d for units that the scatter of the unknowns `columns` (p,) does not disturb.

        Args:
            equations: units of all unknowns; unit k belongs to group k modulo the number of groups.
            columns: indices of the unknowns that scatter.
        """
        p, repeats = len(columns), len(equations.square) // len(self.noise)
        P, m, n = (np.tile(part, (repeats, *[1] * (part.ndim - 1))) for part in (self.scatter, self.mean, self.noise))
        between = equations.gram[:, :, columns]
        S, b = between[:, columns], equations.slope[:, columns]
        spread = S @ P + n[:, None, None] * np.eye(p)
        M = np.linalg.inv(spread)
        error, G = b - _times(S, m), between @ P @ M
        n = n[:, None]
        gram = (equations.gram - G @ between.swapaxes(1, 2)) / n[:, :, None]
        slope = (equations.slope - _times(between, m) - _times(G, error)) / n
        # (1 - S P M) / n = M, without the rounding of the difference.
        gram[:, columns] = M @ between.swapaxes(1, 2)
        gram[:, :, columns] = gram[:, columns].swapaxes(1, 2)
        slope[:, columns] = _times(M, error)
        square = equations.square - (m * (b + error)).sum(axis=1) - (error * _times(P @ M, error)).sum(axis=1)
        ratio = np.linalg.slogdet(spread / n[:, :, None])[1]
        log_std = equations.log_std + 0.5 * (ratio + equations.count * np.log(n[:, 0]))
        return replace(equations, gram=gram, slope=slope, square=square / n[:, 0], log_std=log_std)


def pooled(own: np.ndarray, kinds: np.ndarray, independent: float, shared: float) -> np.ndarray:
    """Statistics (g, ...) of groups, drawn to the mean of all groups of the same kind (g,).

    Args:
        own: each group's own statistics.
        kinds: the same number for groups that are alike.
        independent: weight of the own ones.
        shared: weight of the mean.
    """
    means = np.empty_like(own)
    for kind in np.unique(kinds):
        means[kinds == kind] = own[kinds == kind].mean(axis=0)
    return np.asarray((independent * own + shared * means) / (independent + shared))


def _times(matrix: np.ndarray, vector: np.ndarray) -> np.ndarray:
    return np.asarray((matrix @ vector[..., None])[..., 0])
