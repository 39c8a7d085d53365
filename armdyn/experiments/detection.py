"""Detection limits: how large an effect must be for recordings to show it, and the effects that they may hide.

With the information I on an effect's value that remains where all other unknowns are fitted (the Schur complement of
the Fisher information), an effect of size s raises chi2 of the model without it by l = I s^2; measured, the rise is
close to N(l, 4 l). It shows where the rise exceeds what the search requires of one effect among the catalogue, c; with
95 % it does so from l = (z + sqrt(z^2 + c))^2 on, z = 1.645. (Currie, Analytical Chemistry 40, 1968.)
"""

from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np

from armdyn.estimation.solve import marginal_information
from armdyn.experiments.rivals import MAX_RIVALS, NO_EFFECT_NAME, Rivals, effective_noise, fit_rivals
from armdyn.identify.fit import Fit
from armdyn.identify.problem import Problem
from armdyn.identify.selection.candidate import Candidate
from armdyn.identify.settings import SearchSettings
from armdyn.identify.study import Study
from armdyn.parameter import Parameter

DETECTION_Z = 1.645
"""Standard deviations of the rise of chi2 between its mean and what 95 % of all recordings exceed."""
NO_INFORMATION = 1e-12
"""Information, in inverse squares of a parameter's typical size, below which recordings say nothing about it."""


def detectable_chi2(settings: SearchSettings, catalogue_size: int) -> float:
    """Expected rise of chi2 without an effect from which on recordings show it with 95 %, out of a catalogue."""
    needed = 2.0 * (settings.acceptance_nats + float(np.log(max(catalogue_size, 1))))
    return (DETECTION_Z + float(np.sqrt(DETECTION_Z**2 + needed))) ** 2


@dataclass(frozen=True)
class DetectionLimit:
    """Size from which on recordings show an effect.

    Attributes:
        parameter: the parameter of the effect that shows first, in typical sizes.
        size: its size from which on the recordings show it with 95 %, in its unit; infinite where they never do.
    """

    parameter: Parameter
    size: float

    @property
    def hides_typical_size(self) -> bool:
        """Whether the recordings may hide an effect of its typical size."""
        return self.size > self.parameter.typical

    def __str__(self) -> str:
        return f"{self.parameter.name} of {self.size:.2g} {self.parameter.unit}"


def detection_limit(study: Study, at: Fit, effect: Candidate) -> DetectionLimit:
    """Size from which on a study's runs show an effect.

    Args:
        study: the study.
        at: a fit of all that the runs may contain, with the effect or without it.
        effect: the effect.
    """
    noise = effective_noise(at)
    problem = Problem(
        at.problem.model, at.problem.runs, {key: noise[key[1]] for key in at.problem.noise}, at.problem.settings
    )
    own = problem.mask_of_unknowns(effect.names)
    places = np.flatnonzero(at.free | own)
    hessian = problem.expansion(at.values, at.free | own, guesses=False).hessian
    needed = detectable_chi2(study.settings.search, len(study.candidates))

    def limit(unknown: int) -> DetectionLimit:
        parameter = problem.columns[unknown].parameter
        left, _ = marginal_information(hessian, np.flatnonzero(places == unknown), np.flatnonzero(places != unknown))
        seen = float(left[0, 0]) * parameter.typical**2 > NO_INFORMATION
        return DetectionLimit(parameter, float(np.sqrt(needed / left[0, 0])) if seen else np.inf)

    return min(map(limit, np.flatnonzero(own).tolist()), key=lambda one: one.size / one.parameter.typical)


def hidden_effects(study: Study) -> dict[Candidate, DetectionLimit]:
    """Effects of which a study's runs may hide the typical size, with their detection limits."""
    at = study.first()
    limits = {c: detection_limit(study, at, c) for c in study.candidates}
    return {c: limit for c, limit in limits.items() if limit.hides_typical_size}


def rivals_hidden_in(study: Study, hidden: Collection[Candidate]) -> Rivals:
    """Rivals of a model that explains its runs: of the effects that they hide those that fit best, and no effect.

    Args:
        study: the study.
        hidden: at least one effect; see `hidden_effects`.
    """
    found = fit_rivals(study, [(), *((c,) for c in hidden)], study.first(), most=len(hidden) + 1)
    (nothing,) = (h for h in found.hypotheses if h.name == NO_EFFECT_NAME)
    others = [h for h in found.hypotheses if h is not nothing]
    return replace(found, hypotheses=(*others[: MAX_RIVALS - 1], nothing))
