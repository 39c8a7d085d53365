"""Describe the result of a diagnosis or repair: the verdict, and at most two sentences.

The sentences name the missing effects, the fall of the error, and the residual.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from itertools import pairwise

from armdyn.identify.explained_share import (
    ChannelScale,
    RepairStep,
    explained_share,
    percent_text,
)
from armdyn.identify.holdout import HoldoutKind


class Verdict(Enum):
    """Verdict on a model after a comparison, diagnosis or repair; the value is a sentence for a reader."""

    EXPLAINED = "The model explains these runs: what is left is noise."
    EFFECT_MISSING = "An effect is missing, and these runs name it."
    CANNOT_TELL_APART = "Something is missing, and these runs cannot show which of several effects it is."
    UNKNOWN_EFFECT = "Something is missing, and nothing in the catalogue explains it."
    NOT_EXPLAINED = "The model does not explain these runs: what is left is more than noise."
    LOST = "The fit is lost: it says nothing of what the model lacks."

    @property
    def key(self) -> str:
        """Name of the verdict in JSON files, such as ``"effect_missing"``."""
        return self.name.lower()


HOLDOUT_KIND_TEXT = {
    HoldoutKind.EXAM: "on the exam",
    HoldoutKind.HELD_OUT: "on the held-out runs",
    HoldoutKind.LEAVE_ONE_OUT: "of runs predicted from the others",
    HoldoutKind.TRAINING: "on the run that was fitted",
}
MIN_NOTICEABLE_ERROR_CHANGE_SHARE = 0.01
"""Smallest relative change of an error that a sentence calls a change."""
MAX_NAMED_JOINTS = 3
"""Largest number of joints of an effect that a sentence names; of more joints only the number is given."""
MAX_NAMED_EFFECTS = 5
"""Largest number of effects that a sentence names; of further effects only the number is given."""
MAX_ERROR_TO_NOISE_CALLED_NOISE = 1.1
"""Ratio of error to noise up to which a sentence calls an error noise."""


@dataclass(frozen=True)
class RepairResidual:
    """The residual after a repair, as sentences describe it.

    Attributes:
        exceeds_noise: whether the residual is more than noise.
        description: short description of the residual, without a full stop; may be empty.
        searched: whether the catalogue was searched for more effects.
        further_effect: name of an effect that would explain a little more of the error; empty where there is none.
        warnings: sentences that a reader must know, the first of which is told, such as that a link would have a mass
            of 241 kg.
    """

    exceeds_noise: bool
    description: str = ""
    searched: bool = True
    further_effect: str = ""
    warnings: Sequence[str] = ()


def repair_sentences(steps: Sequence[RepairStep], judge: HoldoutKind, scale: ChannelScale, left: RepairResidual) -> str:
    """Describe the result of a repair in two sentences: the added effects with the fall of the error, and the residual.

    Args:
        steps: steps of the repair; the first is the model as given.
        judge: kind of the runs whose errors are given.
        scale: units and noise of the channels.
        left: the residual.
    """
    first, last = steps[0], steps[-1]
    before, after = (total_errors(step.independent_errors(scale), scale.units) for step in (first, last))
    return f"{_found(steps, judge, scale, before, after, left.searched)} {_left(steps, scale, after, left)}"


def total_errors(errors: Mapping[str, float], units: Mapping[str, str]) -> dict[str, float]:
    """Total error of the channels of each unit: the root of their summed squares, by unit.

    Args:
        errors: root mean square error by channel.
        units: unit by channel; other channels are left out.
    """
    known = {channel: error for channel, error in errors.items() if channel in units}
    return {
        unit: math.hypot(*(error for channel, error in known.items() if units[channel] == unit))
        for unit in dict.fromkeys(units[channel] for channel in known)
    }


@dataclass(frozen=True)
class NamedEffect:
    """One effect that a repair added, on all its joints.

    Attributes:
        effect: name of the effect.
        joints: joints on which it acts, for an arm.
        share: share of the misfit that the steps with this effect remove.
        headline: whether the first sentence names it.
    """

    effect: str
    joints: tuple[str, ...]
    share: float
    headline: bool = False

    @property
    def text(self) -> str:
        """A text such as ``"joint_spring on elbow"``."""
        return _on(self.effect, self.joints)


def named_effects(steps: Sequence[RepairStep], scale: ChannelScale) -> list[NamedEffect]:
    """The effects that a repair added, that with the largest share of the misfit first.

    The share of a step that adds several effects together counts for its first one. The order does not depend on an
    exam, although the shares are measured on it where there is one.

    Args:
        steps: steps of the repair; the first is the model as given.
        scale: units and noise of the channels.
    """
    joints, shares = dict[str, list[str]](), _shares(steps, scale)
    for step in steps:
        for name in () if step.values else step.added:
            # The joints of a step that added several effects are listed together.
            own = step.joints if len(step.added) == 1 else ()
            joints.setdefault(name, []).extend(joint for joint in own if joint not in joints.get(name, []))
    chosen = _shares([step.without_exam() for step in steps], scale)
    order = sorted(joints, key=lambda name: -chosen[name])
    return [
        NamedEffect(name, tuple(joints[name]), shares[name], place < MAX_NAMED_EFFECTS)
        for place, name in enumerate(order)
    ]


def _shares(steps: Sequence[RepairStep], scale: ChannelScale) -> dict[str, float]:
    """Share of the misfit that the steps with each effect remove, by its name."""
    shares = dict[str, float]()
    for before, step in pairwise(steps):
        rise = explained_share(steps[0], step, scale) - explained_share(steps[0], before, scale)
        for i, name in enumerate(() if step.values else step.added):
            shares[name] = shares.get(name, 0.0) + (rise if i == 0 else 0.0)
    return shares


def _found(
    steps: Sequence[RepairStep],
    judge: HoldoutKind,
    scale: ChannelScale,
    before: Mapping[str, float],
    after: Mapping[str, float],
    searched: bool,
) -> str:
    added, small = named_effects(steps, scale), steps[-1].values
    held = f"a background of {small} small values without a name" if small else ""
    if not (added or small):
        sizes = join_names([f"{plain_number(error)} {unit}" for unit, error in before.items()])
        return f"Nothing was added: the error {HOLDOUT_KIND_TEXT[judge]} is {sizes}."
    further = len(added) - MAX_NAMED_EFFECTS
    rest = [f"{further} more effect{'s' if further > 1 else ''}"] if further > 0 else []
    several = len(added) > 1
    share = explained_share(steps[0], steps[-1], scale)
    helps = share > 0.0
    is_missing = "missing" if searched and helps else "added"
    verb = ("are" if several else "is") if is_missing == "missing" else ("were" if several else "was")
    text = f"{_grouped(added, rest)} {verb} {is_missing}" if added else ""
    if held:
        text += f", and {held} was added" if added else f"{held[:1].upper()}{held[1:]} was added"
    if helps:
        text += (
            f": {'they explain' if several or (held and added) else 'it explains'} {percent_text(share)} of the misfit"
        )
    return f"{text}{', and' if helps else ';'} the error {HOLDOUT_KIND_TEXT[judge]} {_change(before, after)}."


def _grouped(added: Sequence[NamedEffect], rest: Sequence[str]) -> str:
    """The effects of a first sentence, those on the same joints together, with a text on the `rest` of them."""
    groups = dict[frozenset[str], list[NamedEffect]]()
    for one in added:
        if one.headline:
            groups.setdefault(frozenset(one.joints or [one.effect]), []).append(one)
    texts = [_on(join_names([one.effect for one in own]), own[0].joints) for own in groups.values()]
    every = [*texts, *rest]
    if not any(" and " in text for text in texts):
        return join_names(every)
    return ", and ".join(part for part in ("; ".join(every[:-1]), every[-1]) if part)


def _ties(steps: Sequence[RepairStep]) -> str:
    """Half a sentence on effects that explain the runs as well as an added one; empty without such effects."""
    names = {name for step in steps for name in step.added}
    ties = list(dict.fromkeys(tied for step in steps for tied in step.tied_with if tied not in names))
    if not ties:
        return ""
    of = {name for step in steps if not names.issuperset(step.tied_with) for name in step.added}
    it = "it" if len(names) == 1 else next(iter(of)) if len(of) == 1 else "one of them"
    return f"; these runs cannot distinguish {join_names(at_most_named(ties), 'or')} from {it}"


def _left(steps: Sequence[RepairStep], scale: ChannelScale, after: Mapping[str, float], left: RepairResidual) -> str:
    last, ending = steps[-1], _ties(steps) + "".join(f"; but {warning}" for warning in left.warnings[:1])
    noise = total_errors({channel: scale.noise[channel] for channel in last.rmse}, scale.units)
    ratio = max((after[unit] / noise[unit] for unit in after if noise.get(unit)), default=0.0)
    small = ratio <= MAX_ERROR_TO_NOISE_CALLED_NOISE
    if not left.exceeds_noise and small:
        return f"The remaining error is noise{ending}."
    size = "as small as the noise, but not random" if small else f"{plain_number(ratio, 2)} times the noise"
    described = f" ({left.description})" if left.description else ""
    text = f"The remaining error is {size}{described}"
    if not left.exceeds_noise:
        return f"{text}{'' if described else ', and armdyn finds no structure in it'}{ending}."
    if not left.searched:
        text += ": run `armdyn diagnose` to look for more"
    elif left.further_effect:
        text += f"; {left.further_effect} would explain a little of it, too little to be named"
    else:
        text += ", and nothing in the catalogue explains it"
    return f"{text}{ending}."


def _change(before: Mapping[str, float], after: Mapping[str, float]) -> str:
    parts, last = [], ""
    for unit, old in before.items():
        new = after.get(unit, math.nan)
        verb = (
            "falls"
            if new < (1 - MIN_NOTICEABLE_ERROR_CHANGE_SHARE) * old
            else "rises"
            if new > (1 + MIN_NOTICEABLE_ERROR_CHANGE_SHARE) * old
            else ""
        )
        said = f"from {plain_number(old)} to {plain_number(new)} {unit}"
        parts.append(f"stays at {plain_number(old)} {unit}" if not verb else said if verb == last else f"{verb} {said}")
        last = verb
    return join_names(parts)


def _on(name: str, joints: Sequence[str]) -> str:
    if not joints:
        return name
    return f"{name} on {join_names(list(joints)) if len(joints) <= MAX_NAMED_JOINTS else f'{len(joints)} joints'}"


def plain_number(value: float, digits: int = 3) -> str:
    """Format a number without an exponent, as long as that is easier to read."""
    return f"{float(f'{value:.{digits}g}'):g}"


def at_most_named(names: Sequence[str]) -> list[str]:
    """The first `MAX_NAMED_EFFECTS` names, and in place of the others a text such as ``"2 more"``."""
    more = len(names) - MAX_NAMED_EFFECTS
    return [*names[:MAX_NAMED_EFFECTS], *([f"{more} more"] if more > 0 else [])]


def join_names(names: Sequence[str], word: str = "and") -> str:
    """Join names to a text such as ``"a, b and c"``, with `word` before the last one."""
    return f" {word} ".join(part for part in (", ".join(names[:-1]), names[-1]) if part)
