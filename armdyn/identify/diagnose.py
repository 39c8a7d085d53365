"""Find which physical effect is missing from a model, with a verdict that may be "unknown"."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

from armdyn.displayable import Displayable
from armdyn.document import Document, ResultLevel, Section
from armdyn.identify.compare import Comparison, comparison
from armdyn.identify.explained_share import ChannelScale, percent_text
from armdyn.identify.failed_fit import failed_fit_sentence
from armdyn.identify.residual.block import blocks_by_channel, chi2_z_value
from armdyn.identify.residual.character import ResidualCharacter, characterise, residual_sentence
from armdyn.identify.residual.force_law import force_law_sentence
from armdyn.identify.residual.missing_force import ForceCurve
from armdyn.identify.selection.candidate import Candidate
from armdyn.identify.selection.path import ProgressCallback, SearchStep
from armdyn.identify.selection.ranking import RankedEffect
from armdyn.identify.selection.search import Search, repair_step, search
from armdyn.identify.sentence import RepairResidual, Verdict, at_most_named, repair_sentences
from armdyn.identify.study import Study
from armdyn.identify.tables import candidate_table, missing_force_columns, prediction_curves
from armdyn.identify.uncertainty import model_error_dominates
from armdyn.recording.spikes import outlier_sentence
from armdyn.threads import one_thread


@dataclass(frozen=True, eq=False, repr=False)
class Diagnosis(Displayable):
    """Result of a diagnosis: which effect is missing.

    Attributes:
        verdict: the result as one value of `Verdict`.
        sentence: the result in words, for a reader.
        comparison: the model as given, compared with the runs.
        ranked_effects: effects that may be missing, the most probable first.
        unidentified_effects: effects that these runs do not identify, each with the parameters that imitate it.
        remedies: commands or experiments that would distinguish effects which these runs cannot tell apart.
        residual_character: description of the residual where no effect of the catalogue explains it; else None.
        search: the steps of the search.
        missing_force: the force that the model as given lacks, and what remains of it with the effects of `search`.
        remarks: sentences on the law of the missing force, on the residual and on outliers of the recordings.
    """

    verdict: Verdict
    sentence: str
    comparison: Comparison
    ranked_effects: tuple[RankedEffect, ...]
    unidentified_effects: dict[str, tuple[str, ...]]
    remedies: tuple[str, ...]
    residual_character: ResidualCharacter | None
    search: Search
    missing_force: tuple[ForceCurve, ...] = ()
    remarks: str = ""

    def document(self, summaries: Mapping[str, str] | None = None) -> Document:
        """Build the tables: effects that may be missing with their evidence, then the quality of the model as given.

        Args:
            summaries: one sentence on each effect, by its name; None leaves them out.
        """
        given, steps = self.comparison, self.search.steps
        compared = given.document()
        if self.verdict is Verdict.LOST:
            return replace(compared, title="Diagnosis", verdict=self.sentence, level=ResultLevel.BAD)
        rmse = {name: channel.rmse for name, channel in given.channels.items()}
        candidates = candidate_table(self.ranked_effects, rmse, given.scale, summaries or {})
        evidence = Section(
            "Which effect is missing", self._evidence, tables=[candidates] if self.ranked_effects else []
        )
        fits = {"as given": given.fit} | ({"with what is missing": steps[-1].fit} if len(steps) > 1 else {})
        return replace(
            compared,
            title="Diagnosis",
            verdict=self.sentence,
            sections=[evidence, *compared.sections],
            level=ResultLevel.GOOD if self.verdict is Verdict.EXPLAINED else ResultLevel.CAUTION,
            data={**compared.data, "missing_force": lambda: missing_force_columns(self.missing_force)},
            curves=partial(prediction_curves, given.study, fits),
        )

    @property
    def _evidence(self) -> str:
        """A sentence on the evidence of the candidates and on the effects that these runs do not identify."""
        if not self.ranked_effects:
            text = "Nothing in the catalogue makes a difference."
        elif best := self.ranked_effects[0].tied_with:
            text = f"These runs cannot distinguish {self.ranked_effects[0].effect} from {', '.join(best)}."
            text += f" What would: {'; '.join(self.remedies)}." if self.remedies else ""
        else:
            text = (
                f"{self.ranked_effects[0].effect} explains most, and these runs distinguish it from every other effect."
            )
        unseen = (
            f"{name} cannot be identified in these runs: {', '.join(imitators)} has the same influence."
            for name, imitators in self.unidentified_effects.items()
        )
        return " ".join((text, *unseen, self.remarks)).strip()


@one_thread
def diagnose(study: Study, progress: ProgressCallback | None = None) -> Diagnosis:
    """Find the effect that is missing from the model of a study."""
    found = search(study, progress)
    start, last = found.steps[0], found.last
    if study.fit_has_failed(last.fit):
        given = comparison(study, start.fit, start.tests, process_error=False)
        return Diagnosis(Verdict.LOST, failed_fit_sentence(last.fit), given, (), {}, (), None, Search(found.steps[:1]))
    unseen = {
        s.candidate.effect: s.confounded_with for s in study.scores(start.fit, start.effects) if s.confounded_with
    }
    unknown = characterise(last.fit) if last.tests.fails else None
    verdict = decide_verdict(study, found, unknown)
    advice: tuple[str, ...] = ()
    if verdict is Verdict.CANNOT_TELL_APART:
        advice = (_next_experiment(study, [e.effect for e in (*_added(found), *_ties(study, found))]),)
    said = (
        diagnosis_sentence(study, found, unknown)
        if verdict is Verdict.EFFECT_MISSING
        else _sentence(verdict, found, unknown, advice, study.explained_share(start.fit, last.fit), _ties(study, found))
    )
    forces = found.missing_force()
    law = force_law_sentence(forces, {c.effect for c in last.effects}) if verdict is not Verdict.EXPLAINED else ""
    return Diagnosis(
        verdict=verdict,
        sentence=said,
        remarks=(law + residual_sentence(unknown) + outlier_sentence(study.runs)).strip(),
        comparison=comparison(study, start.fit, start.tests),
        ranked_effects=found.ranked_effects,
        unidentified_effects=unseen,
        remedies=advice,
        residual_character=unknown,
        search=found,
        missing_force=forces,
    )


def diagnosis_naming(study: Study, found: Diagnosis, names: Collection[str]) -> Diagnosis:
    """A diagnosis that names effects by the evidence of an experiment that was made to show them.

    Args:
        study: the study.
        found: its diagnosis, which names no effect.
        names: names of the effects.
    """
    given = found.search.steps[0]
    added = tuple(c for c in study.candidates if c.effect in names)
    effects = (*given.effects, *added)
    fit = study.fit_base_with_effects(effects, given.fit)
    step = SearchStep(added, (), effects, fit, study.tests(fit, effects))
    path = replace(found.search, steps=(given, step))
    unknown = characterise(fit) if step.tests.fails else None
    return replace(
        found,
        verdict=Verdict.EFFECT_MISSING,
        sentence=diagnosis_sentence(study, path, unknown),
        search=path,
        residual_character=unknown,
        missing_force=path.missing_force(),
        remarks=residual_sentence(unknown).strip(),
    )


def _next_experiment(study: Study, tied: Sequence[str]) -> str:
    """The command that computes an experiment to distinguish the tied effects.

    It takes seconds, so it is not run here.
    """
    names = ",".join(dict.fromkeys(tied))
    if any(run.joints for run in study.runs):
        return f"'armdyn excite --for {names}' designs the motion of the arm that tells them apart"
    if all("gripper_x" in run.channels for run in study.runs):
        return "'armdyn next' on the same files computes which experiment does, and designs the motion"
    return "record another motion, with other frequencies and amplitudes"


def diagnosis_sentence(study: Study, found: Search, unknown: ResidualCharacter | None) -> str:
    """Sentence for a reader: which effect is missing, how much of the error it explains, what the residual is like.

    Args:
        study: the runs and the model.
        found: the finished search for missing effects.
        unknown: description of the residual of the search's last step, where it is more than noise.
    """
    steps = [repair_step(study, step) for step in found.steps]
    scale = ChannelScale.of(found.last.fit.blocks)
    further = found.further_effect.name_in_sentence if found.further_effect is not None else ""
    left = RepairResidual(
        found.last.tests.fails, unknown.headline if unknown is not None else "", further_effect=further
    )
    return repair_sentences(steps, study.holdout_kinds[0], scale, left)


def decide_verdict(study: Study, found: Search, unknown: ResidualCharacter | None) -> Verdict:
    """Decide on the verdict after a search for missing effects.

    Args:
        study: the runs and the model.
        found: the finished search.
        unknown: description of the residual of the search's last step, where it is more than noise.
    """
    start, last = found.steps[0], found.last
    beyond = last.tests.fails and unknown is not None
    if unknown is None or not unknown.significant:  # A residual far above an estimated noise is not coloured noise.
        beyond = beyond and (_above_stated_noise(study, last) or model_error_dominates(study, last.fit))
    if study.ignores_input_errors:
        beyond = beyond and last.fit.chi2_per_sample > study.settings.noise.variance_ratio
    noise = study.leaves_noise(start.fit, last.fit) if beyond else None
    beyond = beyond if noise is None else not noise
    if len(found.steps) == 1:
        return Verdict.UNKNOWN_EFFECT if beyond else Verdict.EXPLAINED
    if beyond:
        words, weight = study.settings.verdict, study.model_error_weight(last.fit)
        needed = words.explained_at_noise + weight * (words.explained_above_noise - words.explained_at_noise)
        if (
            study.explained_share(start.fit, last.fit) < needed
            or study.explained_share(start.fit, found.steps[1].fit) < words.first_effect_share
        ):
            return Verdict.UNKNOWN_EFFECT
    return Verdict.CANNOT_TELL_APART if _ties(study, found) else Verdict.EFFECT_MISSING


def _ties(study: Study, found: Search) -> tuple[Candidate, ...]:
    """Effects that these runs cannot distinguish from the missing ones; for an arm, from the first of them."""
    return found.all_ties if study.later_ties else found.first_ties


def _above_stated_noise(study: Study, last: SearchStep) -> bool:
    """Whether the residual of a channel is larger than its stated noise, coloured or not."""
    noise = study.settings.noise
    for blocks in blocks_by_channel(last.fit.blocks).values():
        chi2, samples = study.chi2_by_stated_noise(blocks)
        if chi2 > noise.least_stated_chi2 * samples and chi2_z_value(chi2, samples) > noise.z:
            return True
    return False


def _sentence(
    verdict: Verdict,
    found: Search,
    unknown: ResidualCharacter | None,
    advice: tuple[str, ...],
    share: float,
    ties: tuple[Candidate, ...],
) -> str:
    start = found.steps[0]
    chi2 = f"χ² per sample {start.fit.chi2_per_sample:.3g}"
    if verdict is Verdict.EXPLAINED:
        if start.tests.fails:
            return f"{Verdict.EXPLAINED.value[:-1]}, and the noise is coloured ({chi2})."
        return f"{Verdict.EXPLAINED.value[:-1]} ({chi2})."
    if verdict is Verdict.UNKNOWN_EFFECT:
        known = unknown.headline if unknown is not None else ""
        text = f"{verdict.value[:-1]} ({chi2})" + (f": {known}" if known else "")
        if len(found.steps) > 1:
            text += f"; {_names(found)} would explain {percent_text(share)} of the misfit"
        return text + "."
    if verdict is Verdict.CANNOT_TELL_APART:
        added, tied = _added(found), ", ".join(at_most_named([t.name_in_sentence for t in ties]))
        if len(added) == 1:
            tied = f"Something is missing, and these runs cannot show which: {added[0].name_in_sentence}, {tied}"
        else:
            tied = f"{_names(found)} are missing, and these runs cannot distinguish {tied} from one of them"
        return f"{tied}. To find out: {'; '.join(advice)}."
    return verdict.value


def _added(found: Search) -> tuple[Candidate, ...]:
    return tuple(e for e in found.last.effects if e not in found.steps[0].effects)


def _names(found: Search) -> str:
    return " and ".join(e.name_in_sentence for e in _added(found))
