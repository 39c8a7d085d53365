"""What a set of effects would do, foretold at once from sums around the fit of the model as given."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from armdyn.channels import FloatArray
from armdyn.identify.candidate import Candidate
from armdyn.identify.fit import Fit
from armdyn.identify.study import Study
from armdyn.identify.summed import Summed
from armdyn.identify.sums import sums_at

Residuals = Mapping[tuple[str, str], FloatArray]
"""By run and channel: (n,) measured minus predicted, in the channel's unit."""


@dataclass(frozen=True, eq=False)
class Foretold:
    """A set of effects, fitted by sums.

    Attributes:
        residuals: of the runs whose prediction follows the expansion.
        values: (P,) of the study's unknowns.
    """

    residuals: Residuals
    values: FloatArray


class Foretelling:
    """Fits of sets of effects by one expansion.

    Exact for an arm's effects that are linear, and its links and payloads; for a pendulum near the fit of the model as
    given, so that a refit follows.

    Args:
        study: model, runs and catalogue.
        first: the fit of the model as given.
    """

    def __init__(self, study: Study, first: Fit) -> None:
        self._study = study
        self._linear = bool(study.model.linear)
        self._around = study.appraiser(first) if self._linear else _around(study, first)

    def of(self, effects: Sequence[Candidate]) -> Foretold:
        """What these effects would leave.

        Args:
            effects: of the study's candidates, each on one joint.
        """
        sums = self._around.sums
        columns, change, values = self._around.minimum(effects)
        residuals = {
            (sums.runs[sums.run[unit]], sums.channels[sums.channel[unit]]): sums.residual(unit, columns, change)
            for unit in range(len(sums.count))
            if self._linear or sums.training[unit]
        }
        return Foretold(residuals, self._study.own(values, sums.problem))


def _around(study: Study, first: Fit) -> Summed:
    """An expansion with every effect at the fit of a model that is not linear in them."""
    problem = study.problem
    candidates = tuple(atom for c in study.candidates for atom in c.apart())
    base = problem.fitted & ~problem.of([name for c in study.candidates for name in c.names])
    return Summed(sums_at(first, problem.blocks(first.values)), base, candidates)
