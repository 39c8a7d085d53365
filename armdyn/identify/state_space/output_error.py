"""Fit simulated runs to recordings (output error), from start values that lead to the right minimum.

A slightly wrong pendulum that is simulated over a long recording is soon in another phase, and a fit ends in one of
many wrong minima. Here the model is first linearised around the measured motion, with kicks (process noise) for what
the model lacks. Then the kicks shrink to nothing, and the measured motion changes gradually into the simulated one.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import islice

import numpy as np

from armdyn.identify.failed_fit import residual_variance_ratio
from armdyn.identify.fit import Fit, continue_fit, fit
from armdyn.identify.problem import Problem
from armdyn.identify.state_space.grey_box import NEARBY_EVALUATIONS, GreyBox, LinearisationPoint
from armdyn.identify.state_space.starts import likeliest_start_values, nearly_equal
from armdyn.identify.state_space.threshold_search import find_thresholds
from armdyn.physics.simulated import as_simulated_model

MIN_TRIED_VALUE_DIFFERENCE_SHARE = 0.1
"""Relative difference above which a value that a recording shows directly is tried in addition to the model's value."""
FIT_STEPS_BEFORE_SELECTION = 5
"""Number of steps after which only the better ones of several fits are continued."""
OTHER_START_VALUES_TRIED = 3
"""Number of further start values that are tried where a fit has large errors."""
TRIED_EFFECT_SIZE_FACTORS = (0.2, 0.4, 0.7, 1.5, 3.0)
"""Factors on the sizes of effects that are tried as start values where a fit has large errors."""
TRIED_START_STATE_FACTORS = (0.4, 0.7)
"""Factors on the start states that are tried where a fit without effects has large errors: without friction a decaying
swing is best imitated by a smaller one. For two free swings of a link the error falls from 0.94 to 0.50 rad."""
MAX_FIT_STEPS, MAX_RANKING_FIT_STEPS = 30, 10
"""Largest number of steps of a fit, and of a fit that only ranks a set of effects among others."""
WRONG_MINIMUM_SHARE = 1e-3
"""Share of a signal's variance below which no fit in a wrong minimum leaves it: there the motion is in another phase,
or a start state compensates a wrong decay. An error may still be far above the noise of a good sensor."""
MAX_SAMPLES_PREDICTED_FOR_STARTS = 5_000_000
"""Number of samples that may be predicted (in five seconds) to try other start values where a fit has large errors. All
start values are tried for recordings of up to 37,000 samples (five minutes of a swing), fewer for longer ones, none
above 111,000."""


def every_run_has_motion(problem: Problem) -> bool:
    """Whether every run of a problem has a measured motion, and not only a measured force that depends on it."""
    model = as_simulated_model(problem.model)
    values = problem.start_values()
    return all(
        model.measured_motion(run, np.array([run.channels[model.predicted_channels(run)[0]].time[0]]), theta, 1.0)
        is not None
        for i, run in enumerate(problem.runs)
        for theta in [problem.theta(i, values)]
    )


class EffectSetOptimiser:
    """Optimises sets of effects with process noise around the measured motion of runs, and gives start values for fits.

    Args:
        problem: problem of the model with every effect that may be fitted; training runs come first.
        training: number of runs that are fitted; the others are only predicted.
        present: (P,) bool, unknowns of effects that the model already has.
        options: several (P,) start values, of which the likeliest is used.

    Attributes:
        box: the runs, which can be linearised and optimised.
        motion_measured: whether the motion itself was measured, and not only a force.
        start_unknowns: (P,) bool, unknowns of the runs' start states.
        base: (P,) bool, unknowns that are fitted with every set of effects: those of the base model that the runs
            identify without added effects.
        point: point at which these unknowns are optimised without added effects.
        influential: (P,) bool, unknowns that have an influence on these runs, or a prior.
        thresholds: start values, by index of the unknown, of thresholds: unknowns without influence while their effect
            is absent.
    """

    def __init__(self, problem: Problem, training: int, present: np.ndarray, options: Sequence[np.ndarray]) -> None:
        model = as_simulated_model(problem.model)
        values = options[0]
        self.problem, self.motion_measured, self._given = problem, every_run_has_motion(problem), values
        self.start_unknowns = problem.mask_of_unknowns(model.start_names)
        self.box = GreyBox(problem, values, training, problem.is_effect & ~present)
        wanted = problem.fitted & ~self.start_unknowns & (~problem.is_effect | present)
        self.base, self.point = self._begun(wanted, options)
        known = (problem.prior_weight > 0.0) | self.start_unknowns | self.base
        self.influential = self.box.influential(self.point) | known
        self._declared = problem.null
        self.thresholds, problem.jumps = find_thresholds(self.box, self.point, self.base, self.influential)
        problem.set_thresholds(self.threshold_values)
        self._given = values.copy()
        for k, place in self.thresholds.items():
            self.point.values[k] = self._given[k] = place
        self.influential |= self.box.influential(self.point)
        self.influential[list(self.thresholds)] = True
        self._settled = {self.base.tobytes(): (self.base, self.point)}

    @property
    def threshold_values(self) -> dict[str, float]:
        """Start values, by parameter name, of thresholds: parameters without influence while their effect is absent."""
        return {self.problem.columns[k].parameter.name: place for k, place in self.thresholds.items()}

    def move_thresholds(self, free: np.ndarray) -> list[str]:
        """Search the thresholds of absent effects anew, beside a set of effects, and start from them.

        Beside the model as given, a stop in a pivot that rubs is looked for where the friction is missing.

        Args:
            free: (P,) bool, unknowns that are fitted with the set.

        Returns:
            Names of the parameters of thresholds that moved by a typical size or more.
        """
        problem, point = self.problem, self.optimise(free)
        absent = np.zeros(len(free), dtype=bool)
        absent[[k for k in self.thresholds if not free[k]]] = True
        problem.set_thresholds({problem.columns[k].name: self._declared[k] for k in np.flatnonzero(absent)})
        found, _ = find_thresholds(self.box, self._without(point, free), free, ~absent)
        moved = {k: at for k, at in found.items() if abs(at - self.thresholds[k]) >= problem.typical[k]}
        self.thresholds |= moved
        problem.set_thresholds(self.threshold_values)
        for k, at in moved.items():
            self._settled = {key: one for key, one in self._settled.items() if not one[0][k]}
            for _, kept in self._settled.values():
                kept.values[k] = at
            self._given[k] = at
        return [problem.columns[k].name for k in moved]

    def _begun(self, wanted: np.ndarray, options: Sequence[np.ndarray]) -> tuple[np.ndarray, LinearisationPoint]:
        """Unknowns of the base that the runs identify, and the point optimised from (P,) options or shown values.

        A value of the model file may be far off, and the period of a large swing suggests a length that is too large.
        """
        problem, values = self.problem, options[0]
        model = as_simulated_model(problem.model)
        shown: dict[str, list[float]] = {}
        for i, run in enumerate(problem.runs[: self.box.training]):
            for name, value in model.direct_estimates(run, problem.theta(i, values)).items():
                shown.setdefault(name, []).append(value)
        other = values.copy()
        for j in np.flatnonzero(wanted & (problem.prior_weight == 0.0)):
            name = problem.columns[j].parameter.name
            if name in shown:
                other[j] = np.clip(np.median(shown[name]), problem.lower[j], problem.upper[j])
        if np.any(np.abs(other - values) > MIN_TRIED_VALUE_DIFFERENCE_SHARE * np.abs(values)):
            options = [*options, other]
        if self.motion_measured:
            options = likeliest_start_values(problem, self.box.training, wanted, values) or options
        found = list[tuple[np.ndarray, LinearisationPoint]]()
        for option in options:
            if any(nearly_equal(option, point.values, wanted) for _, point in found):
                continue
            found.append(self._settled_from(option, wanted))
            if (
                not self.motion_measured
                and self.box.max_process_noise_std(found[-1][1]) < self.problem.settings.noise.kick_ratio
            ):
                break  # no sign that the motion may be a wrong one
            # An option may cut pieces of the runs, which all options share.
            found = [(base, self._settled_anew(base, point)) for base, point in found]
        return max(found, key=lambda one: one[1].evidence)

    def _settled_from(self, option: np.ndarray, wanted: np.ndarray) -> tuple[np.ndarray, LinearisationPoint]:
        """The unknowns of (P,) `wanted` that the runs identify, and the point optimised with them from (P,) values."""
        begin = self.box.initial_point(option)
        base = self.box.identifiable(begin, wanted)
        if (guessed := wanted & (self.problem.guess_weight > 0.0)).any():
            # An unknown that a start state compensates gets a weak prior: an added effect may make it identifiable.
            change = np.diag(self.problem.expansion(option, guessed, guesses=False).hessian)
            base[np.flatnonzero(guessed)[change > 0.0]] = True
        return base, self.box.optimise(base, begin)

    def _settled_anew(self, free: np.ndarray, point: LinearisationPoint) -> LinearisationPoint:
        """A point, optimised again where pieces were cut since: only evidence with as many kicks is comparable."""
        return self.box.optimise(free, point, NEARBY_EVALUATIONS) if self.box.has_divided_pieces(point) else point

    def optimise(self, free: np.ndarray, like: np.ndarray | None = None) -> LinearisationPoint:
        """Optimise values, noise and motions for a set of effects, starting from the most similar set so far.

        Args:
            free: (P,) bool, unknowns that are fitted; other effects have their null values.
            like: (P,) bool, unknowns of an optimised set from which a second optimisation starts; the better result is
                returned.
        """
        key = free.tobytes()
        if key not in self._settled:
            point = self.box.optimise(free, self._near(free), NEARBY_EVALUATIONS)
            self._settled[key] = free, self._followed_anew(free, point)
        if like is not None:
            there = self._settled[like.tobytes()][1]
            other = self.box.optimise(free, self._without(there, free), NEARBY_EVALUATIONS)
            if other.evidence > self._settled[key][1].evidence:
                self._settled[key] = free, other
        return self._settled[key][1]

    def optimised_point(self, free: np.ndarray) -> LinearisationPoint | None:
        """The point that was optimised for the (P,) bool unknowns `free`; None if it was not computed."""
        found = self._settled.get(free.tobytes())
        return None if found is None else found[1]

    def _followed_anew(self, free: np.ndarray, point: LinearisationPoint) -> LinearisationPoint:
        """An optimised point, or a better one whose motion is derived from the force anew, with its values.

        The motion derived from the force with other values, such as without the bias that is most of the force, may be
        wrong altogether; the difference then appears as large kicks.
        """
        if self.motion_measured or self.box.max_process_noise_std(point) < self.problem.settings.noise.kick_ratio:
            return point
        other = self.box.optimise(free, self.box.initial_point(self.box.values_with_start_states(point)))
        return max(self._settled_anew(free, point), other, key=lambda one: one.evidence)

    def sample_weights(self, free: np.ndarray) -> tuple[tuple[np.ndarray, ...], ...]:
        """Relative variances of the samples: 1 for ordinary ones, above 1 for glitches, which count less.

        They are those of the optimised set of effects that shares most unknowns with the set `free`.

        Args:
            free: (P,) bool, unknowns of the set for which weights are needed.

        Returns:
            By run and channel, (N,) variance of each sample relative to that of ordinary ones.
        """
        return self._near(free).sample_weights

    def _near(self, free: np.ndarray) -> LinearisationPoint:
        """The point of the most similar optimised set, with effects that are not `free` at null."""
        near = min(self._settled.values(), key=lambda one: (np.sum(one[0] != free), -one[1].evidence))[1]
        return self._without(near, free)

    def _without(self, near: LinearisationPoint, free: np.ndarray) -> LinearisationPoint:
        """A point, with the effects that are not `free` set to null."""
        return replace(
            near, values=np.where(self.box.removable & ~free, self.problem.null, near.values), evidence=-np.inf
        )

    def start_values(self, free: np.ndarray) -> Iterator[np.ndarray]:
        """(P,) start values for a fit of whole simulated runs with (P,) bool unknowns `free`, the likeliest first."""
        return self.box.start_values(free, self._near(free))

    def rescaled_start_values(self, free: np.ndarray, starts: Iterable[np.ndarray]) -> Iterator[np.ndarray]:
        """(P,) further start values: with other sizes of the effects, or, for a set without effects, of the motion.

        The size of a wrong effect that fits whole runs best differs from its size in the linearised runs, and from run
        to run.

        Args:
            free: (P,) bool, unknowns that are fitted.
            starts: (P,) start values, the likeliest first.
        """
        sized = free & self.box.removable
        if sized.any():
            found = list(islice(starts, 2))
            yield from (
                np.where(sized, size * one, one) for one in (found[-1], found[0]) for size in TRIED_EFFECT_SIZE_FACTORS
            )
            yield from self._of_single_runs(free, found[0])
        else:
            first = next(iter(starts))
            yield from (np.where(self.start_unknowns, size * first, first) for size in TRIED_START_STATE_FACTORS)

    def likeliest_start_values(self, free: np.ndarray) -> list[np.ndarray]:
        """(P,) start values for a model whose values are only guesses; see `likeliest_start_values`.

        They are searched for each set of effects, as an added effect may move the optimum far.
        """
        return likeliest_start_values(self.problem, self.box.training, free, self._given)

    def _of_single_runs(self, free: np.ndarray, values: np.ndarray) -> list[np.ndarray]:
        """(P,) values with every run's start fitted to that run alone, and all others fitted to one of the runs.

        A friction of a wrong kind has another size in a large swing than in a small one; between them are minima in
        which a start state compensates the wrong size.
        """
        problem, count = self.problem, self.box.training
        if count == 1:
            return []
        found, starts = list[np.ndarray](), values.copy()
        for i, run in enumerate(problem.runs[:count]):
            single = Problem(problem.model, [run], problem.noise, problem.settings)
            places = problem.unknowns_of_run(i)[[column.index for column in single.columns]]
            alone = fit_run(single, values[places], (free | self.start_unknowns)[places])
            told = values.copy()
            told[places] = alone.values
            found.append(told)
            own = problem.per_run[places]
            starts[places[own]] = alone.values[own]
        return [np.where(problem.per_run, starts, told) for told in found]


def best_fit(
    problem: Problem, free: np.ndarray, starts: Iterable[np.ndarray], others: int = OTHER_START_VALUES_TRIED
) -> Fit:
    """Fit whole simulated runs from several start values and return the best fit.

    Further start values are computed and tried only where the fit is far above the noise.

    Args:
        problem: model, runs and noise.
        free: (P,) bool, unknowns that are fitted.
        starts: (P,) start values, the likeliest first.
        others: largest number of start values that are tried after the first two; 0 for a quick fit that only ranks a
            set of effects.
    """
    noise = problem.settings.noise
    values, steps = iter(starts), MAX_FIT_STEPS if others else MAX_RANKING_FIT_STEPS
    found = [_bounded_fit(problem, free, next(values), steps)]
    if found[0].chi2_per_sample > (noise.minimum_chi2 if others else noise.gross_chi2):
        found += [_bounded_fit(problem, free, tied, steps) for tied in islice(values, 1)]
    best = min(found, key=lambda one: one.cost)
    if residual_variance_ratio(best.blocks) < WRONG_MINIMUM_SHARE:
        others = 0
    others = min(
        others, MAX_SAMPLES_PREDICTED_FOR_STARTS // (problem.samples * (3 * FIT_STEPS_BEFORE_SELECTION + MAX_FIT_STEPS))
    )
    if best.chi2_per_sample > noise.gross_chi2 and others:
        # With large errors the shrinking kicks may have left the best minimum; earlier values may be nearer.
        nearer = sorted(values, key=lambda one: _cost(problem, one))[: 3 * others]
        sketched = sorted(
            (_bounded_fit(problem, free, v, FIT_STEPS_BEFORE_SELECTION) for v in nearer), key=lambda one: one.cost
        )
        found += [_bounded_fit(problem, free, one.values, MAX_FIT_STEPS) for one in sketched[:others]]
    best = min(found, key=lambda one: one.cost)
    return continue_fit(best) if steps == MAX_FIT_STEPS else best


def _bounded_fit(problem: Problem, free: np.ndarray, values: np.ndarray, steps: int) -> Fit:
    return fit(problem, free, np.clip(values, problem.lower, problem.upper), most_steps=steps)


def _cost(problem: Problem, values: np.ndarray) -> float:
    values = np.clip(values, problem.lower, problem.upper)
    return problem.expansion(values, np.zeros(len(values), dtype=bool)).cost


def fit_run(single: Problem, values: np.ndarray, free: np.ndarray) -> Fit:
    """Fit the simulation of a single run, whose start values follow from the measured motion.

    Args:
        single: problem of one run.
        values: (P,) values of the unknowns.
        free: (P,) bool, unknowns that are fitted; the others are fixed.
    """
    box = GreyBox(single, values, 1, np.zeros(len(values), dtype=bool))
    own = free & ~single.mask_of_unknowns(as_simulated_model(single.model).start_names)
    point = box.optimise(own, box.initial_point(values))
    return best_fit(single, free, box.start_values(own, point))
