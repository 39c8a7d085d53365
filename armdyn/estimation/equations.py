"""Normal equations of a linear model: sums over samples that give the fit, and the errors, of any set of unknowns."""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from itertools import pairwise
from typing import Self

import numpy as np


@dataclass(frozen=True, eq=False)
class NormalEquations:
    """Normal equations of a linear model with P unknowns, for each of U units.

    A unit is a part of the data, such as one channel in one recording, or the same data under another hypothesis on
    their noise.

    Attributes:
        gram: (U, P, P) products X'X of the derivatives X of the predictions with respect to the unknowns.
        slope: (U, P) products X'r with the residual r, measured minus predicted.
        square: (U,) squared residuals r'r.
        count: (U,) number of samples.
        log_std: (U,) sums of the logarithms of the samples' standard deviations, by which X and r were divided.
    """

    gram: np.ndarray
    slope: np.ndarray
    square: np.ndarray
    count: np.ndarray
    log_std: np.ndarray

    @classmethod
    def of_samples(cls, X: np.ndarray, r: np.ndarray, std: float = 1.0) -> Self:
        """One unit from its samples.

        Args:
            X: (n, P) derivatives of the predictions.
            r: (n,) residuals, measured minus predicted.
            std: standard deviation of a sample, by which both are divided.
        """
        X, r, count = X / std, r / std, float(len(r))
        sums = (X.T @ X, X.T @ r, r @ r, count, count * np.log(std))
        return cls(*(np.array(one, dtype=float)[None] for one in sums))

    @classmethod
    def of_units(cls, X: np.ndarray, r: np.ndarray, std: np.ndarray) -> Self:
        """U units from n samples each, with a standard deviation for every sample.

        Args:
            X: (U, n, P) derivatives of the predictions.
            r: (U, n) residuals, measured minus predicted.
            std: (U, n) standard deviations, by which both are divided; a sample with an infinite one does not count.
        """
        X, r, known = X / std[..., None], r / std, np.isfinite(std)
        gram, slope = X.swapaxes(1, 2) @ X, (X.swapaxes(1, 2) @ r[..., None])[..., 0]
        log_std = np.log(std, where=known, out=np.zeros(std.shape)).sum(axis=1)
        return cls(gram, slope, (r**2).sum(axis=1), known.sum(axis=1).astype(float), log_std)

    @classmethod
    def of_groups(cls, X: np.ndarray, r: np.ndarray, std: float, group: np.ndarray, count: int) -> Self:
        """One unit for each group of samples.

        Args:
            X: (n, P) derivatives of the predictions.
            r: (n,) residuals, measured minus predicted.
            std: standard deviation of a sample, by which both are divided.
            group: (n,) index of each sample's group, in ascending order.
            count: number of groups; those without a sample are empty units.
        """
        bounds = np.searchsorted(group, np.arange(count + 1)).tolist()
        return cls.stacked([cls.of_samples(X[a:b], r[a:b], std) for a, b in pairwise(bounds)])

    @classmethod
    def stacked(cls, parts: Sequence[Self]) -> Self:
        """The units of several equations with the same unknowns."""
        return cls(*(np.concatenate([getattr(part, one.name) for part in parts]) for one in fields(cls)))

    def only(self, units: np.ndarray) -> Self:
        """The equations of some units, given by indices or as (U,) bool."""
        return type(self)(*(getattr(self, one.name)[units] for one in fields(self)))

    def grouped(self, group: np.ndarray, count: int) -> Self:
        """The sums over units of the same group.

        Args:
            group: (U,) index of each unit's group.
            count: number of groups; those without a unit have no samples.
        """

        def summed(part: np.ndarray) -> np.ndarray:
            total = np.zeros((count, *part.shape[1:]))
            np.add.at(total, group, part)
            return total

        return type(self)(*(summed(getattr(self, one.name)) for one in fields(self)))

    def windows(self, size: int, step: int) -> Self:
        """The sums over every `size` successive of k groups of `step` units: (k - size + 1) groups of `step` units."""

        def summed(part: np.ndarray) -> np.ndarray:
            groups = part.reshape(-1, step, *part.shape[1:])
            total = np.concatenate([np.zeros((1, *groups.shape[1:])), np.cumsum(groups, axis=0)])
            return (total[size:] - total[:-size]).reshape(-1, *part.shape[1:])

        return type(self)(*(summed(getattr(self, one.name)) for one in fields(self)))

    def among(self, columns: np.ndarray, count: int) -> Self:
        """The same equations among `count` unknowns, without effect of those at other places than (P,) `columns`."""
        gram, slope = np.zeros((len(self.square), count, count)), np.zeros((len(self.square), count))
        gram[:, columns[:, None], columns], slope[:, columns] = self.gram, self.slope
        return replace(self, gram=gram, slope=slope)

    def after_change(self, columns: np.ndarray, change: np.ndarray, kept: np.ndarray) -> Self:
        """The equations of some unknowns after a change of others, or of the same ones.

        Args:
            columns: (c,) indices of the changed unknowns.
            change: (c,) change.
            kept: (k,) indices of the unknowns of the returned equations.
        """
        X, d = self.gram[:, columns], change
        slope = self.slope[:, kept] - X[:, :, kept].transpose(0, 2, 1) @ d
        square = self.square - 2.0 * self.slope[:, columns] @ d + (X[:, :, columns] @ d) @ d
        return replace(self, gram=self.gram[:, kept[:, None], kept], slope=slope, square=square)

    def squared_error(self, change: np.ndarray, units: np.ndarray) -> np.ndarray:
        """(u,) sums of squared residuals of the units with indices (u,) after a change (P,) of the unknowns."""
        total = self.square[units] - 2.0 * self.slope[units] @ change
        for i, (own, gram) in enumerate(self._moving[unit] for unit in units):
            total[i] += change[own] @ gram @ change[own]
        return np.maximum(total, 0.0)

    def squared_errors(self, changes: np.ndarray) -> np.ndarray:
        """(U, k) sums of squared residuals after each of k changes (P, k) of the unknowns."""
        total = self.square[:, None] - 2.0 * self.slope @ changes
        for square, (own, gram) in zip(total, self._moving, strict=True):
            change = changes[own]
            square += np.einsum("pk,pk->k", change, gram @ change)
        return np.maximum(total, 0.0)

    @cached_property
    def _moving(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """For each unit the (p,) unknowns that change its predictions, and their (p, p) products X'X."""
        moving = [np.flatnonzero(np.diag(gram)) for gram in self.gram]
        return [(own, gram[np.ix_(own, own)]) for own, gram in zip(moving, self.gram, strict=True)]

    def weighted(self, weight: np.ndarray, units: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(P, P) and (P,) sums of X'X and X'r over some units.

        Args:
            weight: (u,) weights of the units.
            units: (u,) indices of the units.
        """
        return np.tensordot(weight, self.gram[units], 1), weight @ self.slope[units]

    def log_likelihood(self, level: np.ndarray) -> np.ndarray:
        """(U,) log likelihoods of the units, with (U,) factors on all standard deviations of their noise."""
        return np.asarray(-0.5 * self.square / level**2 - self.log_std - self.count * np.log(level))
