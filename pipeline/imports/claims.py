"""What a column may be, and which of several columns a channel is taken from: the same of an arm and of a pendulum."""

from collections.abc import Iterable
from dataclasses import dataclass, replace

from pipeline.imports.words import Label


@dataclass(frozen=True)
class Claim:
    """That a column is a quantity of a body.

    Attributes:
        column: its name.
        channel: of the contract, that it would become.
        body: whose quantity it is: a joint, or the part of a pendulum.
        label: what its header says, with the quantity that it is taken for.
        doubts: why a person must look; empty where it is sure.
    """

    column: str
    channel: str
    body: str
    label: Label
    doubts: tuple[str, ...] = ()

    @property
    def rank(self) -> tuple[bool, bool, bool]:
        """Smaller is better: a torque before a current, the joint's before the motor's, the sure before the unsure."""
        return self.label.quantity == "current", "motor" in self.label.words, bool(self.doubts)


def best_claims(claims: Iterable[Claim]) -> list[Claim]:
    """The best claim to every channel, in the order of the columns; of equals the first, with a doubt."""
    groups: dict[str, list[Claim]] = {}
    for claim in claims:
        groups.setdefault(claim.channel, []).append(claim)
    best = []
    for group in groups.values():
        first = min(group, key=lambda claim: claim.rank)
        equals = [f"or is it '{claim.column}'?" for claim in group if claim is not first and claim.rank == first.rank]
        best.append(replace(first, doubts=(*first.doubts, *equals[:1])))
    return best
