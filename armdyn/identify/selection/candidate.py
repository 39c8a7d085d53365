"""One effect that could be added to a model, on one joint or several."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property


@dataclass(frozen=True)
class Candidate:
    """One effect that could be added to a model.

    Attributes:
        effect: name of the effect.
        parts: names of its parameters by joint; the joint is ``""`` where the effect acts on the whole model.
    """

    effect: str
    parts: tuple[tuple[str, tuple[str, ...]], ...]

    @classmethod
    def of(cls, effect: str, parts: Mapping[str, tuple[str, ...]]) -> "Candidate":
        """Build a candidate from the names of its parameters by joint."""
        return cls(effect, tuple(parts.items()))

    @cached_property
    def joints(self) -> tuple[str, ...]:
        """Joints on which it acts, for an arm; empty where it acts on the whole model."""
        return tuple(joint for joint, _ in self.parts if joint)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of all its parameters."""
        return tuple(name for _, names in self.parts for name in names)

    @property
    def label(self) -> str:
        """Name of the candidate with its joints, in the form that commands take."""
        return f"{self.effect}:{','.join(self.joints)}" if self.joints else self.effect

    @property
    def spoken(self) -> str:
        """Name of the candidate for a reader, with the names of one or two joints, or with their number."""
        if not self.joints:
            return self.effect
        return f"{self.effect} on " + (
            " and ".join(self.joints) if len(self.joints) < 3 else f"{len(self.joints)} joints"
        )

    def split_by_joint(self) -> tuple["Candidate", ...]:
        """One candidate for each joint."""
        return tuple(Candidate(self.effect, (part,)) for part in self.parts)

    def on(self, joints: Collection[str]) -> "Candidate":
        """The same effect on some of its joints only."""
        return Candidate(self.effect, tuple(part for part in self.parts if part[0] in joints))

    def without(self, taken: Collection[str]) -> "Candidate":
        """The candidate without the parameters `taken` that the model has already; without parts where none remain."""
        left = ((joint, tuple(n for n in names if n not in taken)) for joint, names in self.parts)
        return Candidate(self.effect, tuple(part for part in left if part[1]))


def group_by_effect(candidates: Sequence[Candidate]) -> tuple[Candidate, ...]:
    """Combine candidates on one joint each into one candidate for each effect, in the order of first occurrence."""
    found: dict[str, Candidate] = {}
    for c in candidates:
        known = found.get(c.effect)
        found[c.effect] = c if known is None else Candidate(c.effect, (*known.parts, *c.parts))
    return tuple(found.values())
