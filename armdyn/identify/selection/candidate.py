"""One effect that could be added to a model, on one joint or several."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property


@dataclass(frozen=True)
class Candidate:
    """An effect that could be added to a model, on one joint or several.

    Attributes:
        effect: name of the effect.
        parameter_names_by_joint: pairs of a joint and the names of the effect's parameters on it; the joint is ``""``
            where the effect acts on the whole model.
    """

    effect: str
    parameter_names_by_joint: tuple[tuple[str, tuple[str, ...]], ...]

    @classmethod
    def of(cls, effect: str, parts: Mapping[str, tuple[str, ...]]) -> "Candidate":
        """Build a candidate from the names of its parameters by joint."""
        return cls(effect, tuple(parts.items()))

    @cached_property
    def joints(self) -> tuple[str, ...]:
        """Joints on which the effect acts, for an arm; empty where it acts on the whole model."""
        return tuple(joint for joint, _ in self.parameter_names_by_joint if joint)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of all parameters of the effect, on all its joints."""
        return tuple(name for _, names in self.parameter_names_by_joint for name in names)

    @property
    def label(self) -> str:
        """Name of the effect with its joints in the form that commands take, such as ``"joint_spring:elbow,wrist"``."""
        return f"{self.effect}:{','.join(self.joints)}" if self.joints else self.effect

    @property
    def name_in_sentence(self) -> str:
        """Name of the effect for a sentence, such as ``"joint_spring on elbow"`` or ``"joint_spring on 5 joints"``."""
        if not self.joints:
            return self.effect
        return f"{self.effect} on " + (
            " and ".join(self.joints) if len(self.joints) < 3 else f"{len(self.joints)} joints"
        )

    def split_by_joint(self) -> tuple["Candidate", ...]:
        """Split the candidate into one for each joint."""
        return tuple(Candidate(self.effect, (part,)) for part in self.parameter_names_by_joint)

    def on(self, joints: Collection[str]) -> "Candidate":
        """A candidate with the same effect on some of its joints only."""
        return Candidate(self.effect, tuple(part for part in self.parameter_names_by_joint if part[0] in joints))

    def without_parameters(self, taken: Collection[str]) -> "Candidate":
        """A copy without the parameters `taken`, which a model already has; its `parts` are empty if none remains."""
        left = ((joint, tuple(n for n in names if n not in taken)) for joint, names in self.parameter_names_by_joint)
        return Candidate(self.effect, tuple(part for part in left if part[1]))


def group_by_effect(candidates: Sequence[Candidate]) -> tuple[Candidate, ...]:
    """Combine candidates on one joint each into one candidate for each effect, in the order of first occurrence."""
    found: dict[str, Candidate] = {}
    for c in candidates:
        known = found.get(c.effect)
        found[c.effect] = (
            c if known is None else Candidate(c.effect, (*known.parameter_names_by_joint, *c.parameter_names_by_joint))
        )
    return tuple(found.values())
