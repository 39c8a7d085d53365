"""What could be added to a model, refitted, and which of it to prefer."""

from dataclasses import dataclass

import numpy as np

from armdyn.identify.evidence import Weighed, Whitening
from armdyn.identify.fit import Fit
from armdyn.identify.problem import Block
from armdyn.identify.score import Candidate

SIGNIFICANCE = 0.01
"""Probability of adding a superfluous effect, over the whole catalogue."""
TIE = 6.0
"""Difference of evidence below which effects count as tied: above it the first was right in 320 of 320."""
LEAST_SHARE = 0.25
"""Each effect must explain this share of what is left above the noise: errors of the measured motion and effects that
are missing still leave a residual that small gains only happen to look like."""
NEARLY = 0.9
"""Share of the best effect's gain at which a simpler one is preferred, where the best leaves more unexplained than its
further unknowns gain: dry friction before asymmetric dry friction."""


@dataclass(frozen=True, eq=False)
class Option:
    """One effect, or two, added and refitted.

    Attributes:
        added: what was added.
        effects: all effects of the refitted model.
        fit: its minimum.
        weighed: under the whitening of the comparison.
        delta_bic: BIC without minus BIC with it, whitened; larger is better.
        p_value: probability that superfluous effects lower the cost as much, times the number that were tried.
        held_out_gain: fall of the whitened cost of held-out runs; None where none was held out or it was not tried.
        held_out_fell: whether it fell, or rose no more than by chance; None likewise.
        held_out: residuals there.
        share: of the misfit above the noise that it explains.
        far: whether the model without it is far above the noise.
    """

    added: tuple[Candidate, ...]
    effects: tuple[Candidate, ...]
    fit: Fit
    weighed: Weighed
    delta_bic: float
    p_value: float
    share: float
    far: bool
    held_out_gain: float | None = None
    held_out_fell: bool | None = None
    held_out: tuple[Block, ...] | None = None

    @property
    def accepted(self) -> bool:
        """Significant, worth its unknowns, and confirmed by held-out runs where there are any."""
        attributable = self.share > LEAST_SHARE * len(self.added)
        return self.p_value < SIGNIFICANCE and self.delta_bic > 0 and self.held_out_fell is not False and attributable


@dataclass(frozen=True, eq=False)
class Ranking:
    """Options, best first.

    Attributes:
        options: refitted candidates.
        evidence: of each, on training and held-out runs together.
        whitening: under which all were compared.
        present: the model without any of them, under the same whitening.
    """

    options: tuple[Option, ...]
    evidence: tuple[float, ...]
    whitening: Whitening
    present: Weighed

    @property
    def best(self) -> Option | None:
        """The best that is accepted, or one with fewer unknowns that does nearly as much: the rest can come later."""
        accepted = [option for option in self.options if option.accepted]
        if not accepted:
            return None
        first = accepted[0]
        enough = NEARLY * (self.present.cost - first.weighed.cost)
        # What the best leaves unexplained may be what its further unknowns imitate; where it leaves only noise, they
        # are needed.
        unexplained = max(first.fit.cost - first.fit.samples, 0.0)
        tied = self.tied_with(first)
        simpler = [
            option
            for option in accepted
            if _complexity(option) < _complexity(first)
            and (
                option in tied
                or (self.present.cost - option.weighed.cost > enough and option.fit.cost - first.fit.cost < unexplained)
            )
        ]
        return min(simpler, key=lambda o: (*_complexity(o), o.weighed.cost), default=first)

    def tied_with(self, option: Option) -> tuple[Option, ...]:
        """Options that these runs cannot tell from this one."""
        mine = self.evidence[self.options.index(option)]
        return tuple(
            other
            for other, theirs in zip(self.options, self.evidence, strict=True)
            if other is not option and abs(theirs - mine) < TIE and _alike(option, other)
        )


def _complexity(option: Option) -> tuple[int, int]:
    """Number of unknowns that were fitted, and of those that the added effects have."""
    return option.weighed.count, sum(len(c.names) for c in option.added)


def _alike(one: Option, other: Option) -> bool:
    """Whether two options change the residual in much the same way."""
    a = np.concatenate([block.residual for block in one.fit.blocks])
    b = np.concatenate([block.residual for block in other.fit.blocks])
    return bool(a @ b > 0.5 * np.linalg.norm(a) * np.linalg.norm(b))
