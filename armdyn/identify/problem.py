"""The least-squares problem of a model, runs and their noise, in which any parameter can be fitted or fixed.

A diagnosis needs many fits that differ only in which parameters are fitted. So the residuals and their derivatives with
respect to every parameter are evaluated together, and a fit selects its columns.
"""

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import replace
from itertools import compress

import numpy as np

from armdyn.errors import InputError
from armdyn.estimation.descent import DescentResult, DescentSettings, descend
from armdyn.estimation.expansion import QuadraticExpansion
from armdyn.identify.residual.block import ResidualBlock, chi2_sum
from armdyn.identify.settings import DEFAULT_SETTINGS, Settings
from armdyn.identify.unknowns import unknowns_of
from armdyn.model import Model
from armdyn.recording.noise import NoiseByChannel
from armdyn.run import Run

ROUNDING_SHARE_OF_COST = 1e-9
"""Rounding error of a cost that is computed without derivatives, as a share of it, and more."""
CACHED_POINTS = 3
"""Number of points whose residuals and derivatives are cached."""
WEAK_PRIOR_STD_TYPICAL_SIZES = 0.1
"""Standard deviation, in typical sizes, of the prior that `Problem.with_weak_priors` gives a parameter shared by all
runs: a stretch of motion determines a length ten times better, and a stretch at rest must not change it."""
EFFECT_PRIOR_STD_TYPICAL_SIZES = 10.0
"""Standard deviation, in typical sizes, of the wide prior of an effect's parameter about its null value: a parameter
that few samples determine stays small, and a mass of typical size 1 kg can still become 95 kg."""
GUESS_PRIOR_STD_TYPICAL_SIZES = 3.0
"""Standard deviation of a first guess, in typical sizes. The guess acts as a weak prior: it keeps values that the runs
do not identify in the range where the equations are valid, and hardly changes the others."""


class Problem:
    """The least-squares problem of fitting a model to runs.

    Args:
        model: the model; a fit starts from its values. A parameter of scope ``"per_run"`` is one unknown for each run.
        runs: recordings with different names.
        noise: standard deviation by run and channel, in the channel's unit.
        settings: numbers that decide the answers of fits.

    Values that a run states (`Run.known`) are priors: one for all runs where they agree, else one for each run.

    Attributes:
        jumps: likeliest value by unknown, for effects whose only value has no influence at null; see
            `armdyn.identify.state_space.threshold_search`.
    """

    def __init__(
        self, model: Model, runs: Sequence[Run], noise: NoiseByChannel, settings: Settings = DEFAULT_SETTINGS
    ) -> None:
        if not runs:
            raise InputError("nothing to fit: give at least one run")
        self.model, self.runs, self.noise, self.settings = model, tuple(runs), noise, settings
        self.columns = columns = unknowns_of(model, runs)
        parameters = [c.parameter for c in columns]
        self.lower = np.array([p.lower for p in parameters])
        self.upper = np.array([p.upper for p in parameters])
        self.typical = np.array([p.typical for p in parameters])
        self.null = np.array([p.null for p in parameters])
        recorded = {name for run in runs for name in run.all_channels}
        self.fitted = np.array([p.fitted and p.is_identifiable_from(recorded) for p in parameters], dtype=bool)
        self.is_effect = np.array([bool(p.effect) for p in parameters], dtype=bool)
        self.prior_mean = np.array([p.prior.mean if p.prior else 0.0 for p in parameters])
        self.prior_weight = np.array([1.0 / p.prior.std if p.prior else 0.0 for p in parameters])
        guessed = self.mask_of_unknowns(model.guessed_parameters) & (self.prior_weight == 0.0)
        self.guess_mean = self.start_values()
        self.guess_weight = np.where(guessed, 1.0 / (GUESS_PRIOR_STD_TYPICAL_SIZES * self.typical), 0.0)
        self.jumps: dict[int, float] = {}
        self._whole: dict[tuple[bytes, frozenset[str], bool], list[ResidualBlock]] = {}
        self._partial: dict[tuple[bytes, frozenset[str], bool], list[ResidualBlock]] = {}
        self._of_run = [self._placed(i) for i in range(len(self.runs))]
        self._effects = tuple(effect.name for effect in model.effects)
        self._of_effects = np.array(
            [[c.parameter.effect == name for c in columns] for name in self._effects], dtype=bool
        ).reshape(len(self._effects), len(columns))
        self._lean: dict[frozenset[str], tuple[Model, np.ndarray]] = {}

    def set_thresholds(self, places: Mapping[str, float]) -> None:
        """Set start values, by name, of parameters such as thresholds that have no influence while an effect is null.

        The start value becomes the parameter's null value too.
        """
        moved = [
            replace(c, parameter=replace(p, value=places[p.name], null=places[p.name])) if p.name in places else c
            for c in self.columns
            for p in [c.parameter]
        ]
        self.columns = tuple(moved)
        self.null = np.array([c.parameter.null for c in moved])

    def unknowns_of_run(self, run: int) -> np.ndarray:
        """(p,) indices of the unknowns that are the model's parameters in the run with index `run`."""
        return self._of_run[run]

    def _placed(self, run: int) -> np.ndarray:
        """(p,) positions for one run; see `unknowns_of_run`."""
        here = {c.index: j for j, c in enumerate(self.columns) if c.run in (None, run)}
        return np.array([here[k] for k in range(len(self.model.names))], dtype=int)

    def start_values(self) -> np.ndarray:
        """(P,) start values of the unknowns: the model's values, and first guesses for unknowns of one run."""
        return np.array([c.parameter.value for c in self.columns])

    @property
    def samples(self) -> int:
        """Number of measured samples that the model predicts, over all runs."""
        return sum(len(run.channels[name].value) for run in self.runs for name in self.model.predicted_channels(run))

    def with_weak_priors(self, values: np.ndarray) -> "Problem":
        """A copy of the problem with weak priors about (P,) values for all unknowns without a prior.

        It is used for short stretches of runs, which do not identify every unknown.
        """
        held = copy(self)
        unknown = self.prior_weight == 0.0
        width = np.where(self.per_run, 1.0, WEAK_PRIOR_STD_TYPICAL_SIZES) * self.typical
        held.prior_mean = np.where(unknown, values, self.prior_mean)
        held.prior_weight = np.where(unknown, 1.0 / width, self.prior_weight)
        return held

    def with_wide_priors(self, left: float) -> "Problem":
        """A copy of the problem with a wide prior on every effect's parameter that has none, about its null value.

        It is used for few runs, which do not identify every effect.

        Args:
            left: root mean square residual of a fit, in standard deviations of the noise. The priors are stronger by
                this factor, because each sample gives less information.
        """
        held = copy(self)
        unknown = self.is_effect & (self.prior_weight == 0.0)
        held.prior_mean = np.where(unknown, self.null, self.prior_mean)
        held.prior_weight = np.where(
            unknown, max(1.0, left) / (EFFECT_PRIOR_STD_TYPICAL_SIZES * self.typical), self.prior_weight
        )
        return held

    def with_weights(self, noise: NoiseByChannel, std: np.ndarray) -> "Problem":
        """A copy of the problem in which samples have other weights, and unknowns without a prior get one.

        Args:
            noise: standard deviation of one sample by run and channel; others keep theirs.
            std: (P,) standard deviations of the priors about the null values, infinite where there is none.
        """
        other, unknown = copy(self), self.prior_weight == 0.0
        other.noise, other._whole, other._partial = {**self.noise, **noise}, {}, {}
        other.prior_mean = np.where(unknown, self.null, self.prior_mean)
        other.prior_weight = np.where(unknown, 1.0 / std, self.prior_weight)
        return other

    def of_runs(self, runs: Sequence[Run]) -> "Problem":
        """The same problem, with its priors, for some of the runs."""
        other = Problem(self.model, runs, self.noise, self.settings)
        other.prior_mean = transfer_values(self.prior_mean, self, other)
        other.prior_weight = transfer_values(self.prior_weight, self, other, missing=0.0)
        return other

    def unknown_name_and_run(self, unknown: int) -> tuple[str, str | None]:
        """Key of an unknown that is the same in other problems: its parameter's name, and its run's name or None."""
        column = self.columns[unknown]
        return column.parameter.name, None if column.run is None else self.runs[column.run].name

    def mask_of_unknowns(self, names: Sequence[str]) -> np.ndarray:
        """(P,) bool: True for the unknowns that belong to the parameters `names`."""
        wanted = {self.model.names.index(name) for name in names}
        return np.array([c.index in wanted for c in self.columns], dtype=bool)

    @property
    def per_run(self) -> np.ndarray:
        """(P,) bool: True for the unknowns that belong to one run, such as its start state."""
        return np.array([c.run is not None for c in self.columns], dtype=bool)

    def theta(self, run: int, values: np.ndarray) -> np.ndarray:
        """(p,) parameter vector of the model in the run with index `run`, from (P,) values of the unknowns."""
        return values[self._of_run[run]]

    def blocks(self, values: np.ndarray, wanted: np.ndarray | None = None) -> list[ResidualBlock]:
        """Evaluate the residuals of all channels of all runs, and their derivatives; the last few points are cached.

        Args:
            values: (P,) values of the unknowns.
            wanted: (P,) bool, unknowns whose derivatives are needed; None means all. Derivatives of the others may be
                0.
        """
        held = frozenset(self._effects) if wanted is None else self.needed_effects(values, wanted)
        derivatives = wanted is None or bool(wanted.any()) or not self.model.values_are_cheap
        key, everything = (values.tobytes(), held, derivatives), (values.tobytes(), frozenset(self._effects), True)
        if everything in self._whole:  # it serves every fit that starts here, so others must not replace it
            return self._whole[everything]
        memory = self._whole if key == everything else self._partial
        if key not in memory:
            while len(memory) >= CACHED_POINTS:
                del memory[next(iter(memory))]
            memory[key] = self._blocks(values, held, derivatives=derivatives)
        return memory[key]

    def needed_effects(self, values: np.ndarray, wanted: np.ndarray) -> frozenset[str]:
        """Names of the effects that matter for predictions and wanted derivatives.

        Args:
            values: (P,) values of the unknowns; an effect matters where one of its values is not null.
            wanted: (P,) bool, unknowns whose derivatives are needed; their effects matter too.
        """
        concerned = self._of_effects & (wanted | (values != self.null))
        return frozenset(compress(self._effects, concerned.any(axis=1) | ~self._of_effects.any(axis=1)))

    def reduced_model(self, needed: frozenset[str]) -> tuple[Model, np.ndarray]:
        """A faster model with at least the `needed` effects, and (q,) indices of its parameters in the whole model."""
        if needed not in self._lean:
            model = self.model.reduced_model(needed, self.runs)
            place = {name: i for i, name in enumerate(self.model.names)}
            self._lean[needed] = model, np.array([place[name] for name in model.names], dtype=int)
        return self._lean[needed]

    def _blocks(self, values: np.ndarray, held: frozenset[str], *, derivatives: bool) -> list[ResidualBlock]:
        (model, places), found = self.reduced_model(held), []
        for i, run in enumerate(self.runs):
            theta = self.theta(i, values)[places]
            prediction = model.predict(run, theta) if derivatives else None
            predicted = model.predict_values(run, theta) if prediction is None else prediction.values_by_channel
            for channel, value in predicted.items():
                noise, measured = self.noise[run.name, channel], run.channels[channel]
                # Column by column: columns of parameters that the model lacks are never touched and take no memory.
                sensitivities = np.zeros((len(value), len(self.columns)), order="F")
                moving = np.zeros(len(self.columns), dtype=bool)
                if prediction is not None:
                    own = prediction.moving.get(channel, np.arange(len(places)))
                    columns = self._of_run[i][places[own]]
                    moving[columns] = True
                    sensitivities[:, columns] = prediction.sensitivities[prediction.slices[channel]][:, own] / noise
                residual = (measured.value - value) / noise
                found.append(ResidualBlock(run.name, channel, measured, residual, sensitivities, noise, moving))
        return found

    def cost(self, values: np.ndarray, free: np.ndarray) -> float:
        """The cost at a point, as that of `expansion`, but without derivatives."""
        blocks = self._blocks(values, self.needed_effects(values, free), derivatives=False)
        return self._penalty(values)[0] + chi2_sum(blocks) / 2

    @np.errstate(all="ignore")  # a diverging simulation has infinite cost, and a step to it is shortened
    def expansion(self, values: np.ndarray, free: np.ndarray, *, guesses: bool = True) -> QuadraticExpansion:
        """Expand the cost to second order (Gauss-Newton) at a point.

        Args:
            values: (P,) values of the unknowns.
            free: (P,) bool, unknowns with respect to which the cost is expanded.
            guesses: whether first guesses act as weak priors; see `GUESS_PRIOR_STD_TYPICAL_SIZES`.
        """
        cost, gradient = self._penalty(values, guesses=guesses)
        gradient = gradient[free]
        hessian = np.diag(self.prior_weight[free] ** 2 + (self.guess_weight[free] ** 2 if guesses else 0.0))
        blocks = self.blocks(values, free)
        for block in blocks:
            sensitivities, own = block.sensitivities[:, free & block.moving], np.flatnonzero(block.moving[free])
            gradient[own] -= sensitivities.T @ block.residual
            hessian[np.ix_(own, own)] += sensitivities.T @ sensitivities
        return QuadraticExpansion(cost + chi2_sum(blocks) / 2, gradient, hessian)

    def _penalty(self, values: np.ndarray, *, guesses: bool = True) -> tuple[float, np.ndarray]:
        """Cost of priors and first guesses, and its (P,) gradient."""
        prior = self.prior_weight * (self.prior_mean - values)
        guess = self.guess_weight * (self.guess_mean - values) if guesses else np.zeros(len(values))
        return float(prior @ prior + guess @ guess) / 2, -(self.prior_weight * prior + self.guess_weight * guess)

    def fit(
        self, free: np.ndarray, start: np.ndarray, *, most_steps: int = 30, tolerance: float = 0.02
    ) -> DescentResult:
        """Minimise the cost; see `descend`.

        Args:
            free: (P,) bool, unknowns that change.
            start: (P,) start values; the other unknowns keep them.
            most_steps: largest number of steps.
            tolerance: length of a step, in standard deviations, below which the minimisation has converged.

        Returns:
            The result, with (P,) values of all unknowns.
        """
        part = CostOfFreeUnknowns(self, free, start)
        how = DescentSettings(most_steps, tolerance, gross_chi2=self.settings.noise.gross_chi2)
        found = descend(part, start[free], how, samples=self.samples)
        return found._replace(values=part.all_values(found.values))


def transfer_values(
    values: np.ndarray, source: Problem, target: Problem, *, missing: float | None = None
) -> np.ndarray:
    """Transfer values of the unknowns of one problem to those of another one, by parameter and run.

    Args:
        values: (P,) values for the unknowns of `source`.
        source: problem from which values are taken.
        target: problem for which values are returned.
        missing: value of an unknown that `source` lacks; None means its start value.

    Returns:
        (P',) values for the unknowns of `target`. A parameter that all runs share in one problem may have one unknown
        for each run in the other.
    """
    result = target.start_values() if missing is None else np.full(len(target.columns), missing)
    place = {source.unknown_name_and_run(i): i for i in range(len(source.columns))}
    for i in range(len(target.columns)):
        name, run = target.unknown_name_and_run(i)
        others = [r.name for r in target.runs] if run is None else [None] * any(r.name == run for r in source.runs)
        key = next((key for key in ((name, run), *((name, other) for other in others)) if key in place), None)
        if key is not None:
            result[i] = values[place[key]]
    return result


def transfer_mask(mask: np.ndarray, source: Problem, target: Problem) -> np.ndarray:
    """Transfer a (P,) bool mask of the unknowns of `source` to those of `target`, (P',); False for missing ones."""
    return transfer_values(mask.astype(float), source, target, missing=0.0) > 0.0


class CostOfFreeUnknowns:
    """The cost of a problem as a function of some of its unknowns, while the others are fixed.

    Args:
        problem: the problem.
        free: (P,) bool, the p unknowns that vary.
        start: (P,) values, at which the others are fixed.
    """

    def __init__(self, problem: Problem, free: np.ndarray, start: np.ndarray) -> None:
        self._problem, self._free, self._start = problem, free, start
        self._last: tuple[bytes, QuadraticExpansion] | None = None
        self.lower, self.upper, self.typical = problem.lower[free], problem.upper[free], problem.typical[free]

    def all_values(self, values: np.ndarray) -> np.ndarray:
        """(P,) values of all unknowns, from (p,) values of those that vary."""
        everything = self._start.copy()
        everything[self._free] = values
        return everything

    def value(self, values: np.ndarray, limit: float) -> float:
        """The cost at (p,) values of the unknowns that vary; it is infinite where a simulation diverges.

        Args:
            values: (p,) values.
            limit: where derivatives take long, a cost above it is infinite as well.
        """
        if self._problem.model.values_are_cheap:
            cost = self._problem.cost(self.all_values(values), self._free)
            if not cost <= limit + ROUNDING_SHARE_OF_COST * abs(limit):
                return np.inf
        return self.expand(values).cost

    def expand(self, values: np.ndarray) -> QuadraticExpansion:
        """Expand the cost at (p,) values of the unknowns that vary; it is infinite where a simulation diverges."""
        key = values.tobytes()
        if self._last is None or self._last[0] != key:
            at = self._problem.expansion(self.all_values(values), self._free)
            finite = np.isfinite(at.cost) and np.all(np.isfinite(at.hessian)) and np.all(np.isfinite(at.gradient))
            self._last = key, at if finite else QuadraticExpansion.diverged(len(values))
        return self._last[1]
