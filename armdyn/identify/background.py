r"""What is small in an arm: values of every effect on every joint, each held near nothing by one width.

A model that is to predict holds more than what has a name. Beside the named effects every effect of the catalogue on
every joint has a value x, in typical sizes, with a prior x ~ N(0, s^2). One width s for all is chosen by predicting
whole runs: every training run from the others, fifths of a lone one, and the held-out runs from all training runs
(ridge regression, its penalty by cross-validation; Hoerl & Kennard, Technometrics 12, 1970). What the evidence is sure
of is as free as what has a name:

    evidence = - sum_c n_c / 2 misfit(E_c / v_c) - log det(1 + T G T) / 2 - price,

E_c the mean squared error of channel c in the training and in the held-out runs, v_c what the wide model leaves there,
G the sums X'X with the weights n_c / (N_c v_c), T the typical sizes. n_c counts independent samples. The sensor's
noise has N_c / tau_c of them; the model's own error repeats itself, and has `OF_MODEL_ERROR` however long a recording
is. With m = 1 - noise variance / v_c, the variance of a mean square gives

    1 / n_c = (1 - m)^2 tau_c / N_c + m^2 / OF_MODEL_ERROR.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import lgamma, log

import numpy as np

from armdyn.identify.appraisal import SURE
from armdyn.identify.candidate import Candidate
from armdyn.identify.fit import Fit, fit
from armdyn.identify.noise import correlation_time
from armdyn.identify.problem import Problem, transferred
from armdyn.identify.sample_evidence import NOISY, misfit_of
from armdyn.identify.study import Study
from armdyn.identify.summed import HELD
from armdyn.identify.sums import Sums
from armdyn.linear.normal_equations import NormalEquations
from armdyn.linear.solve import log_det, solve_bounded, solve_positive
from armdyn.run import Run

WIDTHS = (0.0, 0.003, 0.01, 0.03, 0.1, 0.3, 1.0, 3.0)
"""Widths that are tried, in typical sizes."""
OF_MODEL_ERROR = 20.0
"""Independent samples of a model's own error in one channel. With 8 the springs of a Gen3 are not found; with 20 the
exam's error is below that of the best single width in 10 of 15 imperfect arms, and at most 1.13 of it in the others."""
PIECES = 5
"""Parts of a lone training run that are predicted in turn."""
LEVELS = 3
"""Rounds in which the wide model and the errors that it leaves, which weigh it, settle."""
PROMISING = 12
"""Effects on one joint, those that promise most, whose evidence is worked out in each round."""
STEPS = 4
"""Gauss-Newton steps of the whole model from the linear solution, at most."""

Atoms = frozenset[Candidate]
"""Effects, each on one joint."""


@dataclass(frozen=True)
class SmallValues:
    """Small values beside the named effects.

    Attributes:
        width: s, in typical sizes; 0 where only what is sure is held.
        values: by parameter, in its unit.
        fit: of named effects and small values together.
        covariance: (P, P) of all unknowns of the study.
        in_turn: every training run with the values that the others give; none where runs are held out, or of one run.
    """

    width: float
    values: dict[str, float]
    fit: Fit
    covariance: np.ndarray
    in_turn: tuple[Fit, ...]


def find_background(
    study: Study, named: Sequence[Candidate], last: Fit, sums: Sums, say: Callable[[str], None]
) -> SmallValues | None:
    """The background beside named effects; None where it does not predict other runs better.

    Args:
        study: runs and catalogue.
        named: the effects that have a name.
        last: their fit.
        sums: around that fit.
        say: told how far the search is.
    """
    linear = _Linear(sums, named, study.candidates)
    say("choosing what is small")
    sure = linear.sure()
    width = max(WIDTHS, key=lambda s: linear.predicted(linear.widths(sure, s)))
    widths = linear.widths(sure, width)
    if linear.predicted(widths) < linear.predicted(linear.widths(frozenset(), 0.0)) + SURE:
        return None
    say(f"fitting {np.count_nonzero(widths)} values")
    found, covariance = _fitted(study, linear, widths)
    # Sums foretell little of what is far from linear.
    if study.squared_error(found) >= study.squared_error(last):
        return None
    problem, names = study.problem, [name for atom in linear.atoms for name in atom.names]
    own = np.flatnonzero(problem.of(names) & (found.values != problem.null))
    values = {problem.columns[i].name: float(found.values[i]) for i in own}
    in_turn = () if study.held_out else tuple(_in_turn(study, linear, widths))
    return SmallValues(width, values, found, covariance, in_turn)


def sure_effects(
    study: Study, named: Sequence[Candidate], sums: Sums, say: Callable[[str], None]
) -> tuple[Candidate, ...]:
    """Effects on one joint each that the evidence is sure of beside named ones; see the module."""
    say("choosing all that is sure")
    return tuple(_Linear(sums, named, study.candidates).sure())


def _fitted(study: Study, linear: "_Linear", widths: np.ndarray) -> tuple[Fit, np.ndarray]:
    """Named and small values, of (c,) `widths`, at the minimum of the whole model, and their (P, P) covariance."""
    found, given = _with_priors(study, linear, widths, study.runs, linear.training), study.problem
    free = found.free
    at = Fit(given, free, found.values, tuple(given.blocks(found.values, free)), found.outcome)
    covariance, own = np.zeros((len(free), len(free))), np.flatnonzero(free)
    information = found.problem.expansion(found.values, free).hessian
    scale = np.sqrt(np.diag(information))
    covariance[np.ix_(own, own)] = np.linalg.inv(information / np.outer(scale, scale)) / np.outer(scale, scale)
    return at, covariance


def _in_turn(study: Study, linear: "_Linear", widths: np.ndarray) -> Iterator[Fit]:
    """See `SmallValues.in_turn`."""
    for run, others in linear.without_each():
        rest = _with_priors(study, linear, widths, [r for i, r in enumerate(study.runs) if i != run], others)
        alone = Problem(study.problem.model, [study.runs[run]], study.noise)
        free = np.zeros(len(alone.columns), dtype=bool)
        values = transferred(rest.values, rest.problem, alone)
        yield Fit(alone, free, values, tuple(alone.blocks(values, free)), rest.outcome)


def _with_priors(study: Study, linear: "_Linear", widths: np.ndarray, runs: Sequence[Run], units: np.ndarray) -> Fit:
    """The whole model fitted to runs, whose units in the sums are (u,), with (c,) widths as priors of its values.

    Steps begin at the minimum of the expansion, where links may be no bodies yet.
    """
    sums, moving = linear.sums, widths > 0.0
    columns = linear.columns[moving]
    start = linear.values(linear.solution(widths, units)[moving], moving)
    width = np.zeros(len(start))
    width[columns] = widths[moving] * linear.typical[moving]
    problem = Problem(study.problem.model, runs, {**study.problem.noise, **linear.levels})
    width = transferred(width, sums.problem, problem, missing=0.0)
    free = width > 0.0
    unknown = free & (problem.prior_weight == 0.0)
    problem.prior_weight[unknown], problem.prior_mean[unknown] = 1.0 / width[unknown], problem.null[unknown]
    return fit(problem, free, transferred(start, sums.problem, problem), most_steps=STEPS)


class _Linear:
    """Every effect on every joint, linear around a fit, in typical sizes.

    Args:
        sums: around the fit.
        named: effects that are free in any case.
        catalogue: effects that may be small.

    Attributes:
        columns: (c,) unknowns: of the base and of named effects first, then of every other effect on every joint.
        typical: (c,) their typical sizes.
        atoms: the other effects, each on one joint, with (k,) where their unknowns are among the columns.
        training: units that fits may use.
    """

    def __init__(self, sums: Sums, named: Sequence[Candidate], catalogue: Sequence[Candidate]) -> None:
        p = self.problem = sums.problem
        self.sums = sums
        told = p.of([name for c in named for name in c.names])
        moved = np.einsum("uii->i", sums.gram[sums.training]) > 0.0
        # What acts through another unknown stays where it was settled.
        moved &= sums.driver == np.arange(len(moved))
        self.columns = np.flatnonzero(moved & p.fitted & ~p.is_effect | moved & told)
        self._always = len(self.columns)
        self.atoms: dict[Candidate, np.ndarray] = {}
        apart = [atom for c in catalogue for atom in c.apart()]
        places = {atom: np.flatnonzero(moved & ~told & p.of(atom.names)) for atom in apart}
        for atom, own in places.items():
            if len(own) and not self._is_held_by_simpler(atom, places):
                self.atoms[atom] = len(self.columns) + np.arange(len(own))
                self.columns = np.append(self.columns, own)
        C = self.columns
        self.typical = p.typical[C]
        self._lower, self._upper = ((bound - sums.values)[C] / self.typical for bound in (p.lower, p.upper))
        self._centre, self._wide = sums.centre[C] / self.typical, sums.width[C] / self.typical
        self.equations, self._unit, self._fold = self._cut()
        self._channel, self._is_training = sums.channel[self._unit], sums.training[self._unit]
        self.training = np.flatnonzero(self._is_training)
        self._evidence: dict[Atoms, float] = {}
        self._normals: dict[bytes, tuple[np.ndarray, np.ndarray]] = {}
        self._variance, self._samples = self._measured()
        self._normals.clear()

    def _is_held_by_simpler(self, atom: Candidate, places: Mapping[Candidate, np.ndarray]) -> bool:
        """Whether effects of the same joint with fewer values do together all that one does.

        Asymmetric friction is Coulomb friction and an offset.
        """
        own = places[atom]
        simpler = [c for other, c in places.items() if other.joints == atom.joints and 0 < len(c) < len(own)]
        if not simpler or not atom.joints:
            return False
        others = np.concatenate(simpler)
        G = self.sums.gram[self.sums.training].sum(axis=0)
        scale = 1.0 / np.sqrt(np.diag(G))[np.concatenate([own, others])]
        G = G[np.ix_(np.concatenate([own, others]), np.concatenate([own, others]))] * np.outer(scale, scale)
        k = len(own)
        within = np.linalg.lstsq(G[k:, k:], G[k:, :k], rcond=1e-10)[0]
        return bool(np.all(1.0 - np.sum(G[:k, k:] * within.T, axis=1) < HELD))

    def _cut(self) -> tuple[NormalEquations, np.ndarray, np.ndarray]:
        """Sums in typical sizes, (U,) the unit of `sums` that each is of, (U,) which are predicted together."""
        s, C, t = self.sums, self.columns, self.typical
        if len(np.unique(s.run[s.training])) > 1:
            gram = s.gram[:, C[:, None], C] * (t[:, None] * t)
            return NormalEquations(gram, s.slope[:, C] * t, s.square, s.count), np.arange(len(s.count)), s.run
        parts, unit, fold = [], [], []
        for i, block in enumerate(s.blocks):
            X, r = block.sensitivities[:, C] * (block.noise * t), block.misfit
            for k, rows in enumerate(np.array_split(np.arange(len(r)), PIECES if s.training[i] else 1)):
                parts.append((X[rows].T @ X[rows], X[rows].T @ r[rows], float(r[rows] @ r[rows]), float(len(rows))))
                unit.append(i)
                fold.append(k if s.training[i] else PIECES)
        return NormalEquations(*(np.array(part) for part in zip(*parts, strict=True))), np.array(unit), np.array(fold)

    def _measured(self) -> tuple[np.ndarray, np.ndarray]:
        """(2, c) what the wide model leaves of every channel in training and held-out runs, (2, c) its samples."""
        s, channels = self.sums, len(self.sums.channels)
        noise = np.array([np.average(s.noise[s.channel == c] ** 2) for c in range(channels)])
        self._variance, self._samples = np.tile(noise, (2, 1)), np.ones((2, channels))
        change = np.zeros(len(self.columns))
        self._variance[:] = np.maximum(self.errors(change) / 30.0, noise)
        for _ in range(LEVELS):
            self._samples[:] = [self._counted(k) for k in (0, 1)]
            self._normals.clear()
            change = self.solution(self.widths(frozenset(), 1.0), self.training)
            self._variance = np.maximum(self.errors(change), noise)
        time = np.array([self._correlation_time(c, change) for c in range(channels)])
        m = np.clip(1.0 - NOISY * noise / self._variance, 0.0, 1.0)
        count = np.array([self._counted(k) for k in (0, 1)])
        with np.errstate(divide="ignore"):
            samples = 1.0 / ((1.0 - m) ** 2 * np.maximum(time / count, 0.0) + m**2 / OF_MODEL_ERROR)
        return self._variance, np.where(count > 0.0, samples, 0.0)

    def _counted(self, stage: int) -> np.ndarray:
        """(c,) samples of every channel in the training runs, 0, or the held-out runs, 1."""
        mine = self._is_training == (stage == 0)
        count = self.equations.count[mine]
        return np.bincount(self._channel[mine], weights=count, minlength=len(self.sums.channels))

    def _correlation_time(self, channel: int, change: np.ndarray) -> float:
        s = self.sums
        units = np.flatnonzero((s.channel == channel) & s.training)
        left = [s.residual(int(unit), self.columns, change * self.typical) for unit in units]
        return float(np.average([correlation_time([one]) for one in left], weights=s.count[units]))

    @property
    def levels(self) -> dict[tuple[str, str], float]:
        """By run and channel of training runs, standard deviation with which a sample counts as the fits here count."""
        return {
            (block.run, block.channel): float(self._weight()[self.sums.channel[i]] ** -0.5)
            for i, block in enumerate(self.sums.blocks)
            if self.sums.training[i]
        }

    def _weight(self) -> np.ndarray:
        """(c,) of a squared error in training runs."""
        return np.asarray(self._samples[0] / (self._counted(0) * self._variance[0]))

    def widths(self, sure: Atoms, width: float) -> np.ndarray:
        """(c,) widths of all unknowns: of the base, of named effects and of what is `sure` as in any fit."""
        found = np.full(len(self.columns), width)
        found[: self._always] = self._wide[: self._always]
        for atom in sure:
            found[self.atoms[atom]] = self._wide[self.atoms[atom]]
        return np.minimum(found, self._wide)

    def solution(self, widths: np.ndarray, units: np.ndarray) -> np.ndarray:
        """(c,) change that fits units best, of unknowns of (c,) widths; what has none stays."""
        c = np.flatnonzero(widths > 0.0)
        G, slope = self._normal(units)
        w, change = widths[c], np.zeros(len(widths))
        A = w[:, None] * G[np.ix_(c, c)] * w
        A.flat[:: len(c) + 1] += 1.0
        right = w * slope[c] + self._centre[c] / w
        change[c] = w * solve_bounded(A, right, self._lower[c] / w, self._upper[c] / w).x
        return change

    def _normal(self, units: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(c, c) and (c,) weighted sums of X'X and X'r over units (u,)."""
        key = units.tobytes()
        if key not in self._normals:
            self._normals[key] = self.equations.weighted(self._weight()[self._channel[units]], units)
        return self._normals[key]

    def errors(self, change: np.ndarray) -> np.ndarray:
        """(2, c) mean squared error of every channel in training and held-out runs; 0 where there are none."""
        every = self.equations.squared_error(change, np.arange(len(self.equations.count)))
        found = np.zeros((2, len(self.sums.channels)))
        for k in (0, 1):
            mine, count = self._is_training == (k == 0), self._counted(k)
            total = np.bincount(self._channel[mine], weights=every[mine], minlength=len(count))
            found[k] = np.where(count > 0.0, total / np.maximum(count, 1.0), 0.0)
        return found

    def predicted(self, widths: np.ndarray) -> float:
        """Log likelihood of every training run as predicted from the others, and of the held-out runs from all."""
        held_out = self.errors(self.solution(widths, self.training))[1]
        errors = np.array([self._errors_in_turn(widths), held_out])
        return -0.5 * float(np.sum(self._samples * misfit_of(errors / self._variance)))

    def values(self, change: np.ndarray, moving: np.ndarray) -> np.ndarray:
        """(P,) of all unknowns after a change (m,) of the `moving` ones, (c,) bool, in typical sizes."""
        exact = np.zeros(len(self.sums.values), dtype=bool)
        return self.sums.changed(self.columns[moving], change * self.typical[moving], exact)

    def without_each(self) -> Iterator[tuple[int, np.ndarray]]:
        """Every training run, and the units of the others; none of a single run."""
        run = self.sums.run[self._unit[self.training]]
        if len(np.unique(run)) > 1:
            yield from ((int(r), self.training[run != r]) for r in np.unique(run))

    def _errors_in_turn(self, widths: np.ndarray) -> np.ndarray:
        """(c,) mean squared error of the training runs, or parts of a lone one, each predicted from the others."""
        units, total = self.training, np.zeros(len(self.sums.channels))
        for k in np.unique(self._fold[units]):
            mine = units[self._fold[units] == k]
            change = self.solution(widths, units[self._fold[units] != k])
            error = self.equations.squared_error(change, mine)
            total += np.bincount(self._channel[mine], weights=error, minlength=len(total))
        return np.asarray(total / np.maximum(self._counted(0), 1.0))

    def sure(self) -> Atoms:
        """Effects beside the named ones that evidence is sure of: the best one or all joints of one, in turn."""
        now: Atoms = frozenset()
        kinds = {name: frozenset(a for a in self.atoms if a.effect == name) for name in (a.effect for a in self.atoms)}
        while True:
            promising = sorted(self.atoms, key=self._gains(now).__getitem__, reverse=True)[:PROMISING]
            options = [now | {a} for a in promising] + [now | kind for kind in kinds.values()]
            best = max(options, key=self.evidence, default=now)
            while best:
                fewer = [*(best - {a} for a in best), *(best - kind for kind in kinds.values() if best & kind)]
                simpler = max(fewer, key=self.evidence)
                if self.evidence(simpler) < self.evidence(best):
                    break
                best = simpler
            if self.evidence(best) <= self.evidence(now):
                return now
            now = best

    def _gains(self, now: Atoms) -> dict[Candidate, float]:
        """By effect, twice the nats that it promises beside others (Rao's score test); 0 for those that are there."""
        widths = self.widths(now, 0.0)
        c = np.flatnonzero(widths > 0.0)
        G, slope = self._normal(self.training)
        left = slope - G @ self.solution(widths, self.training)
        inner = G[np.ix_(c, c)] + np.diag(widths[c] ** -2.0)
        found = dict.fromkeys(self.atoms, 0.0)
        for atom, own in self.atoms.items():
            if atom not in now:
                across = G[np.ix_(c, own)]
                A = G[np.ix_(own, own)] + np.eye(len(own)) - across.T @ np.linalg.solve(inner, across)
                found[atom] = float(left[own] @ solve_positive(A, left[own]))
        return found

    def evidence(self, sure: Atoms) -> float:
        """Nats for effects beside the named ones; see the module."""
        if sure not in self._evidence:
            self._evidence[sure] = self._worked_out(sure)
        return self._evidence[sure]

    def _worked_out(self, sure: Atoms) -> float:
        change = self.solution(self.widths(sure, 0.0), self.training)
        value = -0.5 * float(np.sum(self._samples * misfit_of(self.errors(change) / self._variance)))
        own = np.concatenate([np.zeros(0, dtype=int), *(self.atoms[a] for a in sure)])
        if len(own):
            G, _ = self._normal(self.training)
            value -= 0.5 * float(log_det(G[np.ix_(own, own)] + np.eye(len(own))))
            value -= float(np.sum(np.log1p(change[own] ** 2)))
        return value - sum(self._price(name, sure) for name in {a.effect for a in sure})

    def _price(self, name: str, sure: Atoms) -> float:
        """What an effect must gain: it could have been another one, and on any other of its joints."""
        reach, on = (sum(a.effect == name for a in atoms) for atoms in (self.atoms, sure))
        ways = lgamma(reach + 1) - lgamma(on + 1) - lgamma(reach - on + 1)
        return log(len({a.effect for a in self.atoms})) + log(reach) + ways + SURE
