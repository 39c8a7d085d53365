r"""Linearise a model at one fit and sum over its samples, so that the fit of any set of effects follows from the sums.

With X the derivatives of a channel's prediction with respect to every unknown and r its residual, the squared error
after a change d of the unknowns is r'r - 2 d' X'r + d' X'X d, exactly where the model is linear in them, as an arm is
in most of its effects. The sums X'X, X'r and r'r of every run and channel therefore contain all that is needed to
choose effects: fitting a set to some runs and predicting the others is one small linear solve (Hocking, Biometrics 32,
1976, on subsets by their normal equations).
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from armdyn.estimation.equations import NormalEquations
from armdyn.estimation.solve import solve_bounded, solve_positive
from armdyn.identify.problem import EFFECT_PRIOR_STD_TYPICAL_SIZES, Problem
from armdyn.identify.residual.block import ResidualBlock
from armdyn.identify.selection.candidate import Candidate
from armdyn.identify.thresholds import likeliest_thresholds

INDIRECT_UNKNOWN_FIT_STEPS = 3
"""Number of steps of the fits that optimise unknowns which act only through another one."""


@dataclass(frozen=True, eq=False)
class Sums:
    """A linearised model of P unknowns as sums over the samples of U units, each one channel in one run.

    Attributes:
        problem: the problem of these unknowns.
        values: (P,) values at the point of linearisation.
        runs: names of the runs.
        channels: names of the channels.
        run: (U,) index of each unit's run.
        channel: (U,) index of each unit's channel.
        training: (U,) bool, False for runs that are only predicted.
        equations: sums over the samples of each unit.
        noise: (U,) standard deviation of one sample.
        driver: (P,) index of the unknown through which an unknown acts, or its own index. For example, the position of
            a payload acts only if its mass (the driver) is not zero, so its derivative is taken at a typical mass.
        size: (P,) change of the driver at which that derivative was taken; 0 for unknowns that act by themselves.
        blocks: samples of the units.
        width: (P,) prior standard deviation of each unknown in a fit with these sums.
        centre: (P,) prior mean of each unknown's change from `values`.
    """

    problem: Problem
    values: np.ndarray
    runs: tuple[str, ...]
    channels: tuple[str, ...]
    run: np.ndarray
    channel: np.ndarray
    training: np.ndarray
    equations: NormalEquations
    noise: np.ndarray
    driver: np.ndarray
    size: np.ndarray
    blocks: tuple[ResidualBlock, ...]
    width: np.ndarray
    centre: np.ndarray

    def changed(self, columns: np.ndarray, change: np.ndarray) -> np.ndarray:
        """(P,) values of all unknowns, within their bounds, after a change of some of them.

        Some unknowns act as a product with another one, their driver. If the driver is now smaller than where the
        derivative was taken, the change is larger by the ratio of the two.

        Args:
            columns: (c,) indices of the changed unknowns.
            change: (c,) their change.
        """
        by = np.zeros(len(self.values))
        by[columns] = change
        latent = np.flatnonzero(self.size != 0.0)
        acting = by[self.driver[latent]]
        with np.errstate(divide="ignore", invalid="ignore"):
            by[latent] *= np.where(acting != 0.0, self.size[latent] / acting, 0.0)
        width = self.width[latent]
        by[latent] = np.clip(np.nan_to_num(by[latent]), -width, width)
        values = np.clip(self.values + by, self.problem.lower, self.problem.upper)
        values[latent[acting == 0.0]] = self.problem.null[latent[acting == 0.0]]
        # The value at which derivatives of an absent effect were taken is not a result.
        absent = self.size != 0.0
        absent[columns] = False
        values[absent] = self.problem.null[absent]
        return values

    def residual(self, unit: int, columns: np.ndarray, change: np.ndarray) -> np.ndarray:
        """(n,) residual of one unit after a change of some unknowns, in the channel's unit.

        Args:
            unit: index of the unit.
            columns: (c,) indices of the changed unknowns.
            change: (c,) their change.
        """
        block = self.blocks[unit]
        return np.asarray(block.misfit - block.noise * (block.sensitivities[:, columns] @ change))


def sums(
    problem: Problem,
    training: Collection[str],
    values: np.ndarray,
    absent: Sequence[Candidate],
    free: np.ndarray,
    indirect_steps: int = INDIRECT_UNKNOWN_FIT_STEPS,
) -> Sums:
    """Linearise a model at a point and compute its sums over the samples of every channel in every run.

    Args:
        problem: model and all runs, including those that are only predicted.
        training: names of the runs that fits may use.
        values: (P,) values of all unknowns at the point.
        absent: effects at their null values, some of whose unknowns may act only through another one of the effect.
        free: (P,) bool, unknowns that were fitted; they are adapted when an absent effect is optimised.
        indirect_steps: number of steps of the fits of unknowns that act only through another one; with 0 they stay.
    """
    placed, start = np.zeros(len(values), dtype=bool), values
    if indirect_steps:
        values, placed = with_thresholds(problem, training, values, absent, free)
    here = problem.blocks(values)
    driver = _drivers(problem, here, absent)
    fitted = [block for block in here if block.run in training]
    values, acting = _settled(problem, fitted, values, driver, free, placed, indirect_steps)
    blocks = here
    if np.any(acting != values):
        latent = driver != np.arange(len(values))
        drivers = np.isin(np.arange(len(values)), driver[latent])
        moves = ((values, drivers),) if np.any(values != start) else ()
        for at, moved in (*moves, (acting, latent)):
            there = problem.blocks(at, drivers | latent)
            blocks = [_with_columns(h, t, moved) for h, t in zip(blocks, there, strict=True)]
    runs = tuple(run.name for run in problem.runs)
    channels = tuple(dict.fromkeys(block.channel for block in blocks))
    products = [_products([block], np.arange(len(values))) for block in blocks]
    noise = np.array([block.noise for block in blocks])
    return Sums(
        problem=problem,
        values=values,
        runs=runs,
        channels=channels,
        run=np.array([runs.index(block.run) for block in blocks]),
        channel=np.array([channels.index(block.channel) for block in blocks]),
        training=np.array([block.run in training for block in blocks]),
        equations=NormalEquations(
            np.array([gram for gram, _ in products]) * noise[:, None, None] ** 2,
            np.array([slope for _, slope in products]) * noise[:, None] ** 2,
            np.array([float(block.misfit @ block.misfit) for block in blocks]),
            np.array([len(block.residual) for block in blocks], dtype=float),
            np.zeros(len(blocks)),
        ),
        noise=noise,
        driver=driver,
        size=np.where(driver != np.arange(len(values)), (acting - values)[driver], 0.0),
        blocks=tuple(blocks),
        width=_width(problem),
        centre=np.where(problem.prior_weight > 0, problem.prior_mean, problem.null) - values,
    )


def _moving(blocks: Sequence[ResidualBlock], unknowns: int) -> np.ndarray:
    """(P,) bool: unknowns that change some prediction."""
    moves = np.zeros(unknowns, dtype=bool)
    for block in blocks:
        moves[block.moving] |= np.any(block.sensitivities[:, block.moving] != 0.0, axis=0)
    return moves


def _products(
    blocks: Sequence[ResidualBlock], columns: np.ndarray, residuals: Sequence[np.ndarray] | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """(c, c) X'X and (c,) X'r of the derivatives X by some unknowns (c,), over the noise, summed over some blocks.

    Args:
        blocks: the blocks.
        columns: (c,) indices of the unknowns.
        residuals: (n,) residual r of each block, over the noise; None means its own.
    """
    gram, slope = np.zeros((len(columns), len(columns))), np.zeros(len(columns))
    for block, residual in zip(
        blocks, [block.residual for block in blocks] if residuals is None else residuals, strict=True
    ):
        own = np.flatnonzero(block.moving[columns])  # a joint's torque depends on a part of the unknowns
        X = block.sensitivities[:, columns[own]]
        gram[np.ix_(own, own)] += X.T @ X
        slope[own] += X.T @ residual
    return gram, slope


def _move_far(problem: Problem, values: np.ndarray, unknowns: np.ndarray) -> np.ndarray:
    """(P,) bool: those of the `unknowns` that change some prediction when they change by a typical size.

    A tilt of the base may have no derivative, and is not a threshold.
    """
    none = np.zeros(len(values), dtype=bool)
    at = values + np.where(values + problem.typical <= problem.upper, 1.0, -1.0) * problem.typical

    def changed(which: np.ndarray) -> bool:
        there = problem.blocks(np.where(np.isin(np.arange(len(values)), which), at, values), none)
        pairs = zip(problem.blocks(values, none), there, strict=True)
        return any(not np.array_equal(one.residual, other.residual) for one, other in pairs)

    found = none.copy()
    if len(unknowns) and changed(unknowns):
        found[[k for k in unknowns if changed(np.array([k]))]] = True
    return found


def with_thresholds(
    problem: Problem, training: Collection[str], values: np.ndarray, absent: Sequence[Candidate], free: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """(P,) values with the likeliest threshold of every absent effect that has one, and (P,) bool, these thresholds.

    See `thresholds`; for the arguments see `sums`.
    """
    values, moves = values.copy(), _moving(problem.blocks(values), len(values))
    placed = np.zeros(len(values), dtype=bool)
    columns = [np.flatnonzero(problem.mask_of_unknowns(c.names)) for c in absent]
    moves |= _move_far(problem, values, np.flatnonzero(~moves & (problem.prior_weight == 0.0)))
    unseen = [own[~moves[own] & (problem.prior_weight[own] == 0.0)] for own in columns]
    for turn in range(max(map(len, unseen), default=0)):
        asked = [(i, own[own != i]) for own, hidden in zip(columns, unseen, strict=True) for i in hidden[turn:][:1]]
        asked = [(i, own) for i, own in asked if len(own)]
        place, sizes = np.array([i for i, _ in asked], dtype=int), [own for _, own in asked]
        evidence = partial(_gains, problem, training, values, free, place, sizes)
        found = likeliest_thresholds(
            evidence, *(part[place] for part in (values, problem.typical, problem.lower, problem.upper))
        )
        placed[place] = ~np.isnan(found)
        values[place] = np.where(placed[place], found, values[place])
    return values, placed


def _gains(
    problem: Problem,
    training: Collection[str],
    values: np.ndarray,
    free: np.ndarray,
    place: np.ndarray,
    sizes: Sequence[np.ndarray],
    at: np.ndarray,
) -> np.ndarray:
    """(n,) half the fall of chi2 in fits of the sizes of n effects and all `free` unknowns, with thresholds (n,) `at`.

    Args:
        problem: model and all runs.
        training: names of the fitted runs.
        values: (P,) values of all unknowns.
        free: (P,) bool, unknowns that adapt.
        place: (n,) indices of the thresholds.
        sizes: for each effect, (k,) indices of its other unknowns, which stay within their bounds.
        at: (n,) thresholds.
    """
    values, wanted, width = values.copy(), free.copy(), _width(problem)
    values[place] = at
    wanted[np.concatenate([place, *sizes])] = True
    blocks = [block for block in problem.blocks(values, wanted) if block.run in training]
    lower, upper, found = problem.lower - values, problem.upper - values, np.zeros(len(place))
    every = np.flatnonzero(wanted)
    gram, slope = _products(blocks, every)
    for i, own in enumerate(sizes):
        c = np.append(own, np.flatnonzero(free))
        at_c = np.searchsorted(every, c)
        A, b = np.diag(width[c] ** -2.0) + gram[np.ix_(at_c, at_c)], slope[at_c]
        change = solve_bounded(A, b, lower[c], upper[c]).x
        found[i] = b @ change - change @ A @ change / 2
    return found


def _width(problem: Problem) -> np.ndarray:
    """(P,) prior standard deviation of the unknowns; see `Sums.width`."""
    with np.errstate(divide="ignore"):
        return np.minimum(EFFECT_PRIOR_STD_TYPICAL_SIZES * problem.typical, 1.0 / problem.prior_weight)


def _with_columns(block: ResidualBlock, other: ResidualBlock, of_other: np.ndarray) -> ResidualBlock:
    """A block with the derivatives of another block for some unknowns, (P,) bool."""
    X = block.sensitivities.copy()
    X[:, of_other] = other.sensitivities[:, of_other]
    return replace(block, sensitivities=X, moving=np.where(of_other, other.moving, block.moving))


def _drivers(problem: Problem, here: Sequence[ResidualBlock], absent: Sequence[Candidate]) -> np.ndarray:
    """(P,) `Sums.driver`: for unknowns of an absent effect that change nothing, its first unknown that does."""
    moves = _moving(here, len(problem.columns))
    driver = np.arange(len(moves))
    for candidate in absent:
        columns = np.flatnonzero(problem.mask_of_unknowns(candidate.names))
        if moves[columns].any():
            driver[columns[~moves[columns]]] = columns[moves[columns]][0]
    return driver


def _settled(
    problem: Problem,
    here: Sequence[ResidualBlock],
    values: np.ndarray,
    driver: np.ndarray,
    free: np.ndarray,
    placed: np.ndarray,
    steps: int,
) -> tuple[np.ndarray, np.ndarray]:
    """Point of the expansion for unknowns that act through another, and (P,) values for their derivatives.

    Each such effect is fitted together with the fitted unknowns, so that its other unknowns are near their optimum: a
    payload's place, or the speed at which friction fades, also where another friction imitates it. While its driver is
    at null, they change nothing.

    Args:
        problem: model and all runs.
        here: units of the training runs at `values`.
        values: (P,) values of all unknowns.
        driver: (P,) see `Sums.driver`.
        free: (P,) bool, unknowns that adapt.
        placed: (P,) bool, thresholds that were looked for; they stay, since a step may leave the range of the runs.
        steps: number of steps of the fits.
    """
    width, there_already = _width(problem), np.flatnonzero(free)
    latent = np.flatnonzero(driver != np.arange(len(values)))
    groups = {int(d): latent[(driver[latent] == d) & ~placed[latent]] for d in np.unique(driver[latent])}
    point, acting = values.copy(), values.copy()
    sign = np.where(problem.upper > values, 1.0, -1.0)
    for d in groups:
        acting[d] = np.clip(values[d] + sign[d] * problem.typical[d], problem.lower[d], problem.upper[d])
    groups = {d: others for d, others in groups.items() if len(others)}
    wanted = free.copy()
    wanted[[*latent, *groups]] = True
    every = np.flatnonzero(wanted)
    for _ in range(steps if groups else 0):
        there = {(block.run, block.channel): block for block in problem.blocks(acting, wanted)}
        gram, slope = _products([there[h.run, h.channel] for h in here], every, [h.residual for h in here])
        for d, others in groups.items():
            own = np.append(d, others)
            columns = np.append(own, np.setdiff1d(there_already, own))
            at = np.searchsorted(every, columns)
            G, right = np.diag(width[columns] ** -2.0) + gram[np.ix_(at, at)], slope[at]
            right[1 : len(own)] += (problem.null - point)[others] / width[others] ** 2
            change = solve_positive(G, right)[: len(own)]
            if change[0] * sign[d] <= 0.0:
                continue
            # Derivatives were taken at the driver's last size, and are proportional to it.
            step = change[1:] * (acting[d] - values[d]) / change[0]
            moved = point[others] + np.clip(step, -width[others], width[others])
            point[others] = np.clip(moved, problem.lower[others], problem.upper[others])
            acting[d] = np.clip(values[d] + change[0], problem.lower[d], problem.upper[d])
        acting[latent] = point[latent]
    return point, acting
