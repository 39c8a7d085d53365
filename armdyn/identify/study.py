"""A study: a model, runs and a catalogue, with every fit that a diagnosis or a repair needs, each computed once."""

from collections import deque
from collections.abc import Collection, Iterator, Sequence
from copy import copy
from dataclasses import replace
from functools import cached_property
from itertools import chain, tee

import numpy as np

from armdyn.effects.effect import Effect
from armdyn.identify.fit import CHI2_NEAR_NOISE, Fit, determined, fit
from armdyn.identify.holdout import HoldoutKind, blocks_of, predictions, predictions_in_turn
from armdyn.identify.prepare import noise_of_runs, prepared, stated_noise
from armdyn.identify.problem import Block, Problem, chi2_of, samples_of, transferred, transferred_mask
from armdyn.identify.residual.tests import ResidualTests, Score, residual_tests, scores
from armdyn.identify.selection.candidate import Candidate, group_by_effect
from armdyn.identify.selection.linear_scorer import LinearScorer, noisy
from armdyn.identify.selection.set_score import SetScore, SetScorer
from armdyn.identify.selection.sums import sums
from armdyn.identify.state_space.motion_start import initial_values
from armdyn.identify.state_space.output_error import OTHER_STARTS, AroundMotion, best_minimum, shows_motion
from armdyn.model import Model
from armdyn.physics.simulated import SimulatedModel
from armdyn.run import Run
from armdyn.threads import one_thread

MAX_QUICK_STEPS = 8
"""Steps of a quick fit; a candidate that needs more is no small correction of the present fit."""
MAX_LISTED_GLITCHES = 5
"""Largest number of glitch times that are listed."""
CACHED_SCORERS = 3
"""Number of cached scorers: a search returns to the last ones."""
MIN_SHARE_PER_VALUE = 0.125
"""Share of the squared error above the noise that each further value of a pendulum must explain: every value that the
public recordings need explains 0.17 of it or more, a lag that the simulated robot's own errors imitate 0.10."""
CHANCE_DEVIATES, SURE_DEVIATES = 0.5, 3.0
"""Standard deviations of a mean square: the smallest error that is compared, and the largest that may be noise
alone."""


class Study:
    """Fits of one model with any of the catalogue's effects.

    One formulation contains every effect at its null value; a fit frees the columns that it needs.

    Args:
        model: the model, with the effects that it has.
        runs: training runs.
        held_out: whole runs that are never fitted but help to choose effects.
        catalogue: effects that may be missing.
        exam: whole runs that are used for nothing else; only `exam_blocks` uses them.
        asked: names of effects for which the last run was designed; their residual need not exceed all other errors.

    Raises:
        InputError: a run cannot be used; see `prepare.prepared`.
    """

    @one_thread
    def __init__(
        self,
        model: Model,
        runs: Sequence[Run],
        held_out: Sequence[Run],
        catalogue: Sequence[Effect],
        exam: Sequence[Run] = (),
        asked: Collection[str] = (),
    ) -> None:
        self.model = model
        self.asked = frozenset(asked)
        self.tried = 0
        """Effects among which the catalogue was chosen, where there were more."""
        self.runs, self.held_out, self.exam = prepared(model, runs, held_out, exam)
        everything = [*self.runs, *self.held_out, *self.exam]
        self.noise = noise_of_runs(model, everything)
        self.stated_noise = stated_noise(model, everything)
        # The catalogue's effects come last: an effect of the model on some joints may be missing on others.
        self.recorded = frozenset(name for run in everything for name in run.everything)
        shown = [effect for effect in catalogue if effect.shows_in(self.recorded)]
        self.effects = {effect.name: effect for effect in (*model.effects, *shown)}
        extended = model.with_candidates(self.effects.values())
        self.problem = Problem(extended, self.runs, self.noise)
        present = (effect for effect in model.effects if effect.quantities)
        self.present = tuple(Candidate.of(effect.name, model.parts(effect.name)) for effect in present)
        given = set(model.names)
        absent = (
            (effect.name, {j: ns for j, ns in extended.parts(effect.name).items() if not set(ns) <= given})
            for effect in extended.effects
        )
        self.candidates = tuple(Candidate.of(name, parts) for name, parts in absent if parts)
        self._held_out: dict[Fit, list[Fit]] = {}
        self._in_turn: dict[Fit, list[Fit]] = {}
        self._exam: dict[Fit, list[Fit]] = {}
        self._starts: dict[frozenset[str], Iterator[np.ndarray]] = {}
        self._started: dict[Fit, Iterator[np.ndarray]] = {}
        self._around_motion: dict[tuple[frozenset[str], int], Fit] = {}
        self._scorers: deque[tuple[Fit, LinearScorer]] = deque(maxlen=CACHED_SCORERS)
        self._present_names = [name for c in self.present for name in c.names]

    @cached_property
    def motion(self) -> AroundMotion | None:
        """All runs linearised around their motion; None for a model without states.

        Where the motion was not measured, the start of each run is searched first.
        """
        model = self.problem.model
        if not isinstance(model, SimulatedModel):
            return None
        everything = Problem(model, [*self.runs, *self.held_out], self.noise)
        present = everything.of(self._present_names)
        options = [everything.start()]
        if not shows_motion(everything):
            alone = Problem(self.model, everything.runs, self.noise)
            found = reversed(initial_values(alone, alone.start()))
            options = [transferred(values, alone, everything) for values in found]
        motion = AroundMotion(everything, len(self.runs), present, options)
        self.problem.place(motion.names_of_places)
        return motion

    @cached_property
    def _first(self) -> Fit:
        if self.motion is not None:
            return self._fit_around(self.present, OTHER_STARTS)
        wanted = self.problem.fitted & self.problem.of(self.model.names)
        free = determined(self.problem, wanted, self.problem.start())
        found = fit(self.problem, free, self.problem.start())
        again = determined(self.problem, wanted, found.values)
        return found if np.array_equal(again, free) else fit(self.problem, again, found.values)

    @one_thread
    def first(self) -> Fit:
        """The fit of the model as given."""
        return self._first

    def fit_with(self, effects: Sequence[Candidate], near: Fit | None, values: np.ndarray | None = None) -> Fit:
        """Fit the model's base with exactly these effects, started from the fit `near`, or from (P,) `values`.

        Where the runs contain the motion, the fit starts there.
        """
        if self.motion is not None:
            return self._fit_around(effects, OTHER_STARTS)
        assert near is not None
        free, start = self._released(effects, near)
        return fit(self.problem, free, start if values is None else values, most_steps=MAX_QUICK_STEPS)

    def left(self, effects: Sequence[Candidate]) -> float:
        """Squared output error of a set, training and held-out runs together; see `squared_error`.

        It has four digits, so that of effects with the same influence, such as two frictions of a fixed pivot, the
        first one of the catalogue is preferred.
        """
        return float(f"{self.squared_error(self.quick_fit(effects)):.4g}")

    def squared_error(self, fit: Fit) -> float:
        """Mean squared error above the noise, over it, of training plus held-out runs; at least that of chance."""
        return float(self.excess(fit).sum())

    def excess(self, fit: Fit) -> np.ndarray:
        """(1,) or (2,) mean squared error above the noise, over it: training, held-out; at least that of chance."""
        excess, by_chance = self._excess(fit)
        return np.maximum(excess, by_chance)

    def leaves_noise(self, fit: Fit) -> bool:
        """Whether the residual of each channel of the training runs is noise, as a mean over channels.

        The fitted model determines the noise: a heavy rotor makes more torque of the positions' noise.
        """
        return self._are_noise([fit])

    def predicts_to_noise(self, fit: Fit) -> bool:
        """Whether the residual is noise (see `leaves_noise`), in the held-out runs as well where there are any."""
        return self.leaves_noise(fit) and not (self.held_out and not self._are_noise(self.held_out_predictions(fit)))

    def _are_noise(self, fits: Sequence[Fit]) -> bool:
        left: dict[str, list[np.ndarray]] = {}
        for one in fits:
            noise = dict(one.problem.noise)
            for i, run in enumerate(one.problem.runs):
                there = one.problem.model.noise(run, one.problem.theta(i, one.values))
                noise |= {(run.name, channel): std for channel, std in there.items()}
            for block in one.blocks:
                left.setdefault(block.channel, []).append(block.misfit / noise[block.run, block.channel])
        squares = [np.concatenate(parts) ** 2 for parts in left.values()]
        shares = [noisy(len(square)) / max(float(np.mean(square)), 1.0) for square in squares]
        return float(np.mean(shares)) >= 1.0

    def chi2_of_stated(self, blocks: Sequence[Block]) -> tuple[float, int]:
        """Squared error of the samples with a stated noise, over that noise, and the number of these samples."""
        stated = [(block, self.stated_noise.get((block.run, block.channel))) for block in blocks]
        known = [(block, std) for block, std in stated if std]
        chi2 = sum(float(block.misfit @ block.misfit) / std**2 for block, std in known)
        return chi2, samples_of([block for block, _ in known])

    def is_at_noise(self, fit: Fit) -> bool:
        """Whether the residual is at most what noise may have by chance, in training and in held-out runs."""
        excess, by_chance = self._excess(fit)
        return bool(np.all(excess <= SURE_DEVIATES / CHANCE_DEVIATES * by_chance))

    def _excess(self, fit: Fit) -> tuple[np.ndarray, float]:
        """Mean squared error above the noise, over the noise, by kind of run, and the part due to chance."""
        kinds = [list(fit.blocks), self.held_out_blocks(fit) if self.held_out else []]
        samples = np.array([samples_of(kind) for kind in kinds if kind])
        means = np.array([chi2_of(kind) for kind in kinds if kind]) / samples
        return means - 1.0, CHANCE_DEVIATES * float(np.sqrt(2.0 / samples.min()))

    def disbelieved(self, fit: Fit) -> list[str]:
        """Sentences on suspected glitches, which had little weight in choosing, for each run and channel."""
        motion, found = self.motion, list[str]()
        if motion is None:
            return found
        free = transferred_mask(fit.free, fit.problem, motion.problem)
        for run, weights in zip(motion.box.runs, motion.believed(free & ~motion.of_starts), strict=True):
            for channel, weight in zip(run.channels, weights, strict=True):
                when = run.run.channels[channel].time[weight > 1.0]
                if len(when):
                    times = ", ".join(f"{t:.4g}" for t in when[:MAX_LISTED_GLITCHES]) + (
                        ", ..." if len(when) > MAX_LISTED_GLITCHES else ""
                    )
                    found.append(
                        f"{run.run.name}: {channel}: {len(when)} of {len(weight)} samples are no noise (a hand, "
                        f"a lost marker) and count little in choosing: at {times} s"
                    )
        return found

    def quick_fit(self, effects: Sequence[Candidate]) -> Fit:
        """Fit these effects around the measured motion, for a table: from one start also where errors are large."""
        return self._fit_around(effects, 0)

    def _fit_around(self, effects: Sequence[Candidate], others: int) -> Fit:
        """The fit of these effects from the measured motion; see `best_minimum` for `others`."""
        motion, names = self.motion, {name for c in effects for name in c.names}
        assert motion is not None
        key = frozenset(names), others
        if key in self._around_motion:
            return self._around_motion[key]
        own = motion.problem.of(self._present_names)
        fitted = motion.problem.of(list(names)) & ~(own & ~motion.problem.fitted)
        free = (motion.base & ~own | fitted) & motion.seen
        if key[0] not in self._starts:
            (self._starts[key[0]],) = tee(motion.starts(free), 1)
        starts, point = self._starts[key[0]], motion.settled_point(free)
        places = chain(copy(starts), motion.elsewhere(free, copy(starts)))
        fitted = transferred_mask(free | motion.of_starts, motion.problem, self.problem)
        found = best_minimum(self.problem, fitted, (self.own(values, motion.problem) for values in places), others)
        if others and found.chi2_per_sample > CHI2_NEAR_NOISE and (likely := motion.likeliest(free)):
            other = best_minimum(self.problem, fitted, [self.own(v, motion.problem) for v in likely], others)
            found = min(found, other, key=lambda one: one.cost)
        if point is not None:
            found = replace(found, settled=self.own(point.values, motion.problem))
        self._started[found] = starts
        self._around_motion[key] = found
        return found

    def model_with(self, effects: Collection[Candidate]) -> Model:
        """The model with exactly these effects."""
        model = self.model
        for candidate in self.present:
            if candidate not in effects:
                model = model.without_effect(candidate.effect)
        for candidate in effects:
            if candidate not in self.present:
                effect = self.effects[candidate.effect]
                model = model.with_effect(effect.on(*candidate.joints) if candidate.joints else effect)
        return model

    def without_unused_effects(self, found: Fit) -> Fit:
        """The same fit, of a model with only the fitted effects besides those of the model as given."""
        fitted = {column.parameter.name for column, fits in zip(self.problem.columns, found.free, strict=True) if fits}
        used = group_by_effect(
            [a for c in self.candidates for a in c.split_by_joint() if not fitted.isdisjoint(a.names)]
        )
        problem = Problem(self.model_with((*self.present, *used)), self.runs, self.noise)
        free = transferred_mask(found.free, self.problem, problem)
        return Fit(problem, free, transferred(found.values, self.problem, problem), found.blocks, found.outcome)

    def scorer(self, at: Fit, given_misfit: float | None = None) -> LinearScorer:
        """Scorer of sets of effects, from sums at a fit; the last few are cached.

        Args:
            at: the fit of the expansion.
            given_misfit: squared error of the model as given, see `LinearScorer`; None where `at` is its fit.
        """
        found = next((scorer for fit, scorer in self._scorers if fit is at), None)
        if found is None:
            found = self._scorer_around(at)
            self._scorers.append((at, found))
        if given_misfit is not None:
            found.given_misfit = given_misfit
        return found

    def _scorer_around(self, at: Fit) -> LinearScorer:
        everything = Problem(self.problem.model, [*self.runs, *self.held_out], self.noise)
        values = transferred(at.values, self.problem, everything)
        free = transferred_mask(at.free, self.problem, everything)
        present = everything.of([n for c in self.present for n in c.names])
        own = [a for c in self.present for a in c.split_by_joint() if np.all(everything.fitted[everything.of(a.names)])]
        present &= ~everything.of([n for c in own for n in c.names])
        atoms = [*own, *(atom for c in self.candidates for atom in c.split_by_joint())]
        absent = [c for c in atoms if not np.any(free & everything.of(c.names))]
        around = sums(everything, {run.name for run in self.runs}, values, absent, free)
        always = everything.fitted & (present | ~everything.is_effect) & (free | everything.per_run)
        found = LinearScorer(around, always, atoms, own)
        found.tried = self.tried
        return found

    def own_values(self, scorer: SetScorer, one: SetScore) -> np.ndarray:
        """(P,) values of the study's unknowns for a scored set."""
        return self.own(scorer.values(one), scorer.problem)

    def own(self, values: np.ndarray, problem: Problem) -> np.ndarray:
        """(P,) values of the study's unknowns, from those of a problem with more or other runs."""
        return transferred(values, problem, self.problem)

    def scores(self, at: Fit, effects: Sequence[Candidate]) -> list[Score]:
        """Predicted contributions of effects that are not in `effects`; an effect may be there on other joints."""
        taken = {name for c in effects for name in c.names}
        left = (c.without(taken) for c in (*self.candidates, *self.present))
        return scores(at, [c for c in left if c.names])

    def tests(self, at: Fit, effects: Sequence[Candidate]) -> ResidualTests:
        """Tests of the residual of a fit with these effects."""
        return residual_tests(at, self.scores(at, effects))

    def held_out_blocks(self, found: Fit) -> list[Block]:
        """Residuals of the held-out runs; without any, of every training run predicted from the others."""
        return blocks_of(self.held_out_predictions(found))

    def held_out_predictions(self, found: Fit) -> list[Fit]:
        """Predictions of the held-out runs; without any, of every training run from the others."""
        if found not in self._held_out:
            started = self._started.get(found)
            starts = None if started is None or self.motion is None else (self.motion.problem, started)
            others = self.held_out
            self._held_out[found] = predictions(found, others, starts) if others else self.predictions_in_turn(found)
        return self._held_out[found]

    def predictions_in_turn(self, found: Fit) -> list[Fit]:
        """Predictions of every training run from the others; an empty list for a single run."""
        if found not in self._in_turn:
            self._in_turn[found] = predictions_in_turn(found)
        return self._in_turn[found]

    def hold_predictions(self, found: Fit, in_turn: Sequence[Fit]) -> None:
        """Store predictions of the training runs from each other that are known already."""
        self._in_turn[found] = list(in_turn)

    @property
    def holdout_kinds(self) -> tuple[HoldoutKind, ...]:
        """Kinds of the runs that judge a model besides the fitted runs, the most independent first."""
        several = HoldoutKind.IN_TURN if len(self.runs) > 1 else HoldoutKind.TRAINING
        others = HoldoutKind.HELD_OUT if self.held_out else several
        return (HoldoutKind.EXAM, others) if self.exam else (others,)

    def exam_blocks(self, found: Fit) -> list[Block]:
        """Residuals of the exam runs, empty where there are none; only for use after all choices are made."""
        return blocks_of(self.exam_predictions(found))

    def exam_predictions(self, found: Fit) -> list[Fit]:
        """Predictions of the exam runs; only for use after all choices are made."""
        if found not in self._exam:
            self._exam[found] = predictions(found, self.exam)
        return self._exam[found]

    def _released(self, effects: Sequence[Candidate], near: Fit) -> tuple[np.ndarray, np.ndarray]:
        """(P,) bool: unknowns that are free with these effects; (P,) values near a fit, other effects at null."""
        problem = self.problem
        wanted = problem.of([name for c in effects for name in c.names])
        fixed = problem.of(self._present_names) & ~problem.fitted
        free = (problem.fitted & ~problem.is_effect) | (wanted & ~fixed)
        values = np.where(problem.is_effect & ~wanted, problem.null, near.values)
        known_slopes = near.values if near.problem is self.problem else values
        return determined(self.problem, free, known_slopes) | (free & self.first().free), values
