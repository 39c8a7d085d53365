"""Hypotheses on mistakes in recordings, and mistakes that were found."""

from dataclasses import dataclass
from functools import cached_property, reduce
from math import comb, log

from armdyn.inspection.arm import RecordingHypothesis
from armdyn.inspection.correction import Correction
from armdyn.inspection.description import AS_DESCRIBED
from armdyn.inspection.mistake import Mistake

MISTAKE_PRICE_NATS = 8.0
"""Log prior odds against each mistake, nats: about one recording in ten has one of about a hundred mistakes."""
CERTAIN_MISTAKE_NATS = 12.0
"""Log odds, in nats, over no mistake from which a mistake is certain; see docs/inspect.md."""


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """Mistakes that some of several recordings may have.

    Attributes:
        mistakes: the mistakes, in the order in which they are corrected.
        runs: indices of the recordings that have them.
        run_count: number of all recordings.
    """

    mistakes: tuple[Mistake, ...]
    runs: tuple[int, ...]
    run_count: int

    @cached_property
    def meaning(self) -> RecordingHypothesis:
        """The corrections of one mistake after the other."""
        correction = reduce(Correction.followed_by, (m.correction for m in self.mistakes), Correction())
        return correction, self.mistakes[-1].description

    @property
    def families(self) -> frozenset[tuple[object, ...]]:
        """Key that is equal for mistakes that differ only in the error of a clock."""
        return frozenset(m.family for m in self.mistakes)

    @property
    def price(self) -> float:
        """Log prior odds, nats, against these mistakes, and against just these of all recordings."""
        which = log(comb(self.run_count, len(self.runs)))
        return which + sum(m.prior_odds_nats + MISTAKE_PRICE_NATS for m in self.mistakes)

    def concerns(self, unit: tuple[int, str]) -> bool:
        """Whether a mistake concerns a channel of a recording."""
        return unit[0] in self.runs and any(unit[1] in m.channels for m in self.mistakes)

    def excludes(self, further: Mistake) -> bool:
        """Whether a further mistake is not independent of these, or cannot be corrected after them.

        A joint in another unit, which hardly moves then, may have any zero.
        """
        units = {m.kind for m in (*self.mistakes, further)} >= {"angle_unit", "position_offset"}
        alike = (m for m in self.mistakes if m.kind == further.kind or units)
        return further.description != AS_DESCRIBED or any(set(m.channels) & set(further.channels) for m in alike)


@dataclass(frozen=True, eq=False)
class FoundMistake:
    """A mistake that was found in recordings, with its evidence.

    Attributes:
        mistake: the mistake.
        runs: indices of the recordings that have it.
        log_odds_over_unchanged: log odds of the mistake over no mistake, nats.
        log_odds_over_next_best: log odds of the mistake over the next best hypothesis, nats.
        rival: another mistake that explains the recordings as well; None without one.
    """

    mistake: Mistake
    runs: tuple[int, ...]
    log_odds_over_unchanged: float
    log_odds_over_next_best: float
    rival: Mistake | None = None

    @property
    def certain(self) -> bool:
        """Whether the mistake is certain, rather than possible."""
        return self.log_odds_over_unchanged >= CERTAIN_MISTAKE_NATS

    @property
    def correction(self) -> Correction | None:
        """The correction of the recordings; None if the mistake or its correction is not certain."""
        known = self.certain and self.rival is None and self.mistake.correctable
        return self.mistake.correction if known and self.mistake.correction.readings else None
