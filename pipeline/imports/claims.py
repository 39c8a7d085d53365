"""Claims of columns to channels; the best claim to each channel is used."""

from collections.abc import Iterable
from dataclasses import dataclass, replace

from pipeline.imports.words import ColumnHeaderParts


@dataclass(frozen=True)
class Claim:
    """A possible meaning of a column of an imported recording.

    Attributes:
        column: name of the column.
        channel: channel of armdyn's recordings that the column would become, such as ``q.elbow``.
        body: joint, or part of a pendulum, to which the quantity belongs.
        label: the column's header, with the claimed quantity.
        doubts: reasons why a person must look; empty where the meaning is certain.
    """

    column: str
    channel: str
    body: str
    label: ColumnHeaderParts
    doubts: tuple[str, ...] = ()

    @property
    def rank(self) -> tuple[bool, bool, bool]:
        """Sort key; a smaller key is better: torque before current, joint before motor, certain before uncertain."""
        return self.label.quantity == "current", "motor" in self.label.words, bool(self.doubts)


def best_claims(claims: Iterable[Claim]) -> list[Claim]:
    """The best claim for every channel, in the order of the columns; of equally good claims the first, with a doubt."""
    groups: dict[str, list[Claim]] = {}
    for claim in claims:
        groups.setdefault(claim.channel, []).append(claim)
    best = []
    for group in groups.values():
        first = min(group, key=lambda claim: claim.rank)
        equals = [f"or is it '{claim.column}'?" for claim in group if claim is not first and claim.rank == first.rank]
        best.append(replace(first, doubts=(*first.doubts, *equals[:1])))
    return best
