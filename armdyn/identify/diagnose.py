"""Which effect is missing, with an honest verdict."""

from dataclasses import dataclass

import numpy as np

from armdyn.identify.compare import Comparison, comparison
from armdyn.identify.remedies import remedies
from armdyn.identify.score import Candidate
from armdyn.identify.search import Progress, Search, Step, search
from armdyn.identify.study import Study
from armdyn.identify.suspects import Suspect
from armdyn.identify.unknown import Unknown, characterise
from armdyn.identify.verdict import Verdict
from armdyn.identify.whiteness import LARGEST_Z

EXPLAINED_SHARE = 0.97
"""Share of the misfit that the catalogue must explain: its effects are idealised, and may be off by a sixth of their
size; more than that is something else, which the nearest effect of the catalogue imitates."""


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """What is missing.

    Attributes:
        verdict: in one word.
        sentence: for a person.
        comparison: of the model as given.
        suspects: best first.
        unseen: effects that cannot be seen in these runs, with the parameters that imitate them.
        remedies: what would tell tied effects apart.
        unknown: what is known of an effect outside the catalogue; None where there is none.
        search: the steps that led here.
    """

    verdict: Verdict
    sentence: str
    comparison: Comparison
    suspects: tuple[Suspect, ...]
    unseen: dict[str, tuple[str, ...]]
    remedies: tuple[str, ...]
    unknown: Unknown | None
    search: Search


def diagnose(study: Study, progress: Progress | None = None) -> Diagnosis:
    """Find out what is missing from the model of a study."""
    found = search(study, progress, most_steps=3)
    start, last = found.steps[0], found.last
    unseen = {s.candidate.effect: s.same_as for s in study.scores(start.fit, start.effects) if s.same_as}
    unknown = characterise(last.fit) if last.remainder.fails else None
    verdict = judge(study, found, unknown)
    advice: tuple[str, ...] = ()
    if verdict is Verdict.CANNOT_TELL_APART:
        advice = remedies([e.effect for e in (*_added(found), *found.tied)])
    return Diagnosis(
        verdict=verdict,
        sentence=_sentence(verdict, found, unknown, advice),
        comparison=comparison(study, start.fit, start.remainder),
        suspects=found.suspects,
        unseen=unseen,
        remedies=advice,
        unknown=unknown,
        search=found,
    )


def judge(study: Study, found: Search, unknown: Unknown | None) -> Verdict:
    """The verdict on a finished search."""
    start, last = found.steps[0], found.last
    if not start.remainder.fails:
        return Verdict.EXPLAINED
    beyond = last.remainder.fails and unknown is not None and (unknown.significant or _above_stated_noise(study, last))
    if len(found.steps) == 1:
        return Verdict.UNKNOWN_EFFECT if beyond else Verdict.EXPLAINED
    if beyond and explained_share(start, last) < EXPLAINED_SHARE:
        return Verdict.UNKNOWN_EFFECT
    return Verdict.CANNOT_TELL_APART if found.tied else Verdict.EFFECT_MISSING


def explained_share(start: Step, last: Step) -> float:
    """Share of the misfit above the noise that the added effects explain."""
    before, after = (max(step.fit.chi2_per_sample - 1.0, 0.0) for step in (start, last))
    return 1.0 - after / before if before > 0 else 1.0


def _above_stated_noise(study: Study, last: Step) -> bool:
    """Whether a channel's residual is larger than its noise as stated, whatever the colour of that."""
    for channel in dict.fromkeys(block.channel for block in last.fit.blocks):
        blocks = [b for b in last.fit.blocks if b.channel == channel]
        stated = [study.stated_noise.get((b.run, channel)) for b in blocks]
        chi2 = sum(float(b.misfit @ b.misfit) / s**2 for b, s in zip(blocks, stated, strict=True) if s)
        samples = sum(len(b.residual) for b, s in zip(blocks, stated, strict=True) if s)
        if chi2 > 1.1 * samples and chi2 - samples > LARGEST_Z * np.sqrt(2 * samples):
            return True
    return False


def _sentence(verdict: Verdict, found: Search, unknown: Unknown | None, advice: tuple[str, ...]) -> str:
    start, last = found.steps[0], found.last
    chi2 = f"χ² per sample {start.fit.chi2_per_sample:.3g}"
    if verdict is Verdict.EXPLAINED:
        if start.remainder.fails:
            return f"{Verdict.EXPLAINED.value[:-1]}, and the noise is coloured ({chi2})."
        return f"{Verdict.EXPLAINED.value[:-1]} ({chi2})."
    if verdict is Verdict.UNKNOWN_EFFECT:
        known = unknown.sentence if unknown is not None else ""
        text = f"{verdict.value[:-1]} ({chi2})" + (f": {known}" if known else "")
        if len(found.steps) > 1:
            text += f"; {_names(found)} would explain {100 * explained_share(start, last):.0f} % of it"
        return text + "."
    if verdict is Verdict.CANNOT_TELL_APART:
        added, tied = _added(found), ", ".join(t.spoken for t in found.tied)
        if len(added) == 1:
            tied = f"Something is missing, and these runs cannot tell which: {added[0].spoken}, {tied}"
        else:
            tied = f"{_names(found)} are missing, and these runs cannot tell {tied} from one of them"
        return f"{tied}. To find out: {'; '.join(advice)}."
    text = f"{_names(found)} {'is' if len(last.effects) - len(start.effects) == 1 else 'are'} missing: "
    text += f"χ² per sample falls from {start.fit.chi2_per_sample:.3g} to {last.fit.chi2_per_sample:.3g}."
    if unknown is not None and unknown.significant:
        text += f" Something is left beyond that{': ' + unknown.sentence if unknown.sentence else ''}."
    return text


def _added(found: Search) -> tuple[Candidate, ...]:
    return tuple(e for e in found.last.effects if e not in found.steps[0].effects)


def _names(found: Search) -> str:
    return " and ".join(e.spoken for e in _added(found))
