"""One effect that could be added, on one joint or several."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property


@dataclass(frozen=True)
class Candidate:
    """One effect that could be added.

    Attributes:
        effect: its name.
        parts: by joint, ``""`` where it acts on the whole model: the names of its parameters there.
    """

    effect: str
    parts: tuple[tuple[str, tuple[str, ...]], ...]

    @classmethod
    def of(cls, effect: str, parts: Mapping[str, tuple[str, ...]]) -> "Candidate":
        """With its parameters' names by joint."""
        return cls(effect, tuple(parts.items()))

    @cached_property
    def joints(self) -> tuple[str, ...]:
        """Where, for an arm; empty where it acts on the whole model."""
        return tuple(joint for joint, _ in self.parts if joint)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Of all its parameters."""
        return tuple(name for _, names in self.parts for name in names)

    @property
    def label(self) -> str:
        """The name, with the joints, as commands take it."""
        return f"{self.effect}:{','.join(self.joints)}" if self.joints else self.effect

    @property
    def spoken(self) -> str:
        """For a person: the name, with a joint or two, or with how many they are."""
        if not self.joints:
            return self.effect
        return f"{self.effect} on " + (
            " and ".join(self.joints) if len(self.joints) < 3 else f"{len(self.joints)} joints"
        )

    def split_by_joint(self) -> tuple["Candidate", ...]:
        """One candidate for each joint."""
        return tuple(Candidate(self.effect, (part,)) for part in self.parts)

    def on(self, joints: Collection[str]) -> "Candidate":
        """The same effect on some of its joints."""
        return Candidate(self.effect, tuple(part for part in self.parts if part[0] in joints))

    def without(self, taken: Collection[str]) -> "Candidate":
        """What is left of it when these parameters are in the model already; without parts where nothing is."""
        left = ((joint, tuple(n for n in names if n not in taken)) for joint, names in self.parts)
        return Candidate(self.effect, tuple(part for part in left if part[1]))


def group_by_effect(candidates: Sequence[Candidate]) -> tuple[Candidate, ...]:
    """Candidates on one joint each as one candidate for each effect, in the order in which they come."""
    found: dict[str, Candidate] = {}
    for c in candidates:
        known = found.get(c.effect)
        found[c.effect] = c if known is None else Candidate(c.effect, (*known.parts, *c.parts))
    return tuple(found.values())
