"""Investigation: the robot identifies effects that its model lacks, by a series of experiments.

Each experiment swings the load, brings it to rest and records the motion. Then the arm stands still while the
recordings are diagnosed and the next motion is designed.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from typing import TypeVar, cast

import numpy as np

import urdf
from armdyn.effects.catalogue import CATALOGUE
from armdyn.errors import InputError
from armdyn.experiments.detection import DetectionLimit, hidden_effects, rivals_hidden_in
from armdyn.experiments.limits import GripperLimits
from armdyn.experiments.plan import (
    MIN_RIGHT_VERDICT_PROBABILITY,
    USUAL_MOTION_SECONDS,
    ProposedExperiment,
    best_without_designed_motion,
    designed_motion,
)
from armdyn.experiments.rivals import (
    NO_EFFECT_NAME,
    Rivals,
    rivals_of_diagnosis,
    rivals_of_first_effect,
    rivals_refitted_to,
)
from armdyn.experiments.separation import TIE_CHI2, hypothesis_probabilities
from armdyn.identify.diagnose import Diagnosis, diagnose, diagnosis_naming
from armdyn.identify.repair import fitted_model
from armdyn.identify.sentence import Verdict
from armdyn.identify.studies import make_study
from armdyn.identify.study import Study
from armdyn.pendulum.model import PendulumModel, pendulum_model
from armdyn.run import Run
from ik import LineTable
from pipeline.motion import LineTrajectory
from pipeline.motion.feasible_motion import fit_motion_to_arm
from pipeline.trial.ending import TrialEnding
from pipeline.trial.experiment import REST_BEFORE_MOTION_SECONDS, Experiment, Phase
from pipeline.trial.settings import ProtocolSettings

DESIGNED_MOTION_LIMITS = GripperLimits(swing=0.5)
"""Limits of a designed motion: a load with a larger swing angle also begins to swing across the line (on the simulated
arm by 0.1 rad in 8 s at 1 rad, by 0.05 rad at 0.6 rad), which no motion along the line can damp."""
MIN_STRING_LENGTH_STD = 1e-3
"""Smallest standard deviation of the string's length after an investigation [m], that of a ruler."""
NUISANCE_CANDIDATES = ("linear_drag",)
"""Nuisance effects of a trial's model that an investigation removes and tests as candidates; drag can hide friction."""

RunSwingExperiment = Callable[[ProtocolSettings, int, float], tuple["SwingExperiment", TrialEnding]]
"""Function that makes one experiment, from settings, number of the experiment and position of the gripper [m]."""


class InvestigationEndReason(Enum):
    """Reason why an investigation ended; the value is a sentence for the user."""

    EXPLAINED = "nothing is missing"
    NAMED = "one verdict stands"
    INSEPARABLE = "no motion of the gripper tells apart what is left"
    UNKNOWN = "something is missing that no effect of the catalogue explains"
    SPENT = "no experiment is left"
    INTERRUPTED = "an experiment was ended before its time"


ENDS_WITH_BETTER_MODEL = (
    InvestigationEndReason.NAMED,
    InvestigationEndReason.INSEPARABLE,
    InvestigationEndReason.SPENT,
)
"""Reasons after which the model that fits all recordings best replaces the robot's model."""


class SwingExperiment(Experiment):
    """One experiment of an investigation: identify the length, then bring the load to rest below the gripper."""

    def _protocol(self) -> bool:
        self._run(Phase.REST, 0.0, REST_BEFORE_MOTION_SECONDS)
        self._learn()
        self._settle()
        return True

    def recording(self, name: str) -> Run:
        """Recording of the experiment's motion under a name, without a stated noise, so that the noise is estimated."""
        self.measurement.append_to_smoothed_path()
        return replace(self.measurement.run(), name=name, noise={})


@dataclass(frozen=True, eq=False)
class InvestigationStage:
    """One experiment of an investigation, and its results.

    Attributes:
        run: recording of the experiment.
        proposal: designed experiment with its expected results; None for the first experiment.
        diagnosis: diagnosis from all recordings up to this one.
        belief: probability of each effect that has been a candidate.
        gap: increase of χ² from the best to the second-best effect; None for a single effect.
        close: effects that explain the recordings nearly as well as those that the diagnosis names; see
            `rivals.contested`.
        limits: detection limits of the effects whose typical size the recordings may hide; empty where one is missing.
    """

    run: Run
    proposal: ProposedExperiment | None
    diagnosis: Diagnosis
    belief: dict[str, float] = field(default_factory=dict)
    gap: float | None = None
    close: tuple[str, ...] = ()
    limits: tuple[DetectionLimit, ...] = ()

    @property
    def candidates(self) -> tuple[str, ...]:
        """Effects that the model may lack; empty if it lacks none, or if no known effect explains the recordings."""
        if self.diagnosis.verdict is Verdict.EXPLAINED:
            return ()
        search = self.diagnosis.search
        given = search.steps[0].effects
        found = [c.effect for c in search.last.effects if c not in given]
        return tuple(dict.fromkeys([*found, *(c.effect for c in search.all_ties), *self.close]))

    @property
    def residual(self) -> float:
        """Root mean square of the force residual of the best model, divided by the noise of the force."""
        return float(np.sqrt(self.diagnosis.search.last.fit.chi2_per_sample))


@dataclass(frozen=True, eq=False)
class Investigation:
    """Result of an investigation.

    Attributes:
        stages: experiments in order.
        stop: reason why the investigation ended.
        model: model with the found effects; None if the robot's model is kept.
        ending: how an experiment that was stopped early ended; None if none was.
        place: position of the gripper at the end [m].
        signal: number of the operating system's signal that ended the investigation; None for no signal.
        remedy: experiment by hand that would tell the remaining effects apart; None where none is needed or known.
        clock: time of the robot at which the first experiment's motion began, from which effects count time [s].
    """

    stages: tuple[InvestigationStage, ...]
    stop: InvestigationEndReason
    model: PendulumModel | None
    ending: TrialEnding | None = None
    place: float = 0.0
    signal: int | None = None
    remedy: ProposedExperiment | None = None
    clock: float | None = None

    @property
    def sentence(self) -> str:
        """Result of the investigation in one sentence."""
        count = len(self.stages)
        what = ", ".join(self.stages[-1].candidates) if self.stages else ""
        made = f"after {count} experiment{'s' if count != 1 else ''}"
        limits = self.stages[-1].limits if self.stages else ()
        hidden = sorted((limit for limit in limits if np.isfinite(limit.size)), key=str)
        small = f"; too small to show would be {', '.join(map(str, hidden))}" if hidden else ""
        said = f"{made} {self.stop.value}" + (f": {what}" if what else small)
        if self.remedy is None:
            return said
        return f"{said}; to tell: {self.remedy.experiment.what} (right with {self.remedy.expected.probability:.0%})"


def investigate(
    settings: ProtocolSettings,
    swing: RunSwingExperiment,
    arm: urdf.Robot,
    table: LineTable,
    say: Callable[[str], None],
) -> Investigation:
    """Repeat experiments (swing, diagnose, design the next motion) until the missing effects are known.

    Args:
        settings: settings of the trial that follows; `investigate` is the largest number of experiments.
        swing: function that makes one experiment.
        arm: description of the arm.
        table: IK table of the arm's line.
        say: called with a sentence on the progress.

    Raises:
        InputError: the number of experiments is below one.
    """
    if settings.investigate < 1:
        raise InputError(f"--investigate {settings.investigate}: allow at least one experiment")
    model = investigated_model(settings)
    stages: list[InvestigationStage] = []
    questions: dict[tuple[str, ...], None] = {}
    motion: LineTrajectory | None = None
    proposal: ProposedExperiment | None = None
    place = 0.0
    clock: float | None = None
    learnt: float | None = None
    while True:
        number = len(stages) + 1
        now = replace(settings, estimate=True, motion=motion, load_at_rest_at_start=number == 1, clock=clock)
        if learnt is not None:  # a designed motion is larger than those from which a poor guess converges
            given = settings.model or pendulum_model(settings.length_guess, settings.mass)
            known = given.with_prior("length", learnt, settings.max_length_std_for_swing)
            now = replace(now, model=known, length_guess=learnt)
        experiment, ending = swing(now, number, place)
        place = experiment.drive.state.s
        if ending.stopped:
            return Investigation(
                tuple(stages), InvestigationEndReason.INTERRUPTED, None, ending, place, experiment.interrupted
            )
        clock = experiment.estimator.start if clock is None else clock
        learnt = experiment.estimator.model.value("length")
        run = experiment.recording(f"experiment {number}")
        say(f"thinking over {number} experiment{'s' if number > 1 else ''}")
        asked = {name for names in questions for name in names}
        study = make_study(model, [*(stage.run for stage in stages), run], [], tuple(CATALOGUE.values()), asked=asked)
        found = diagnose(study)
        rivals = rivals_of_diagnosis(study, found)
        close: tuple[str, ...] = ()
        if rivals is None and found.verdict is Verdict.EFFECT_MISSING:
            rivals = rivals_of_first_effect(study, found, designed=proposal is not None)
            close = () if rivals is None else tuple(name for names in _names(rivals, study) for name in names)
        asked_now = _refitted(study, list(questions))
        if asked_now is not None and _decide(found, rivals, asked_now, study):
            found, rivals = _named_by_rivals(study, found, asked_now)
            close = () if rivals is None else tuple(name for names in _names(rivals, study) for name in names)
        hidden = hidden_effects(study) if found.verdict is Verdict.EXPLAINED else {}
        if hidden and number == 1:  # a motion that was not made to show them says little
            rivals = rivals_hidden_in(study, hidden)
        if rivals is not None:
            questions.update(dict.fromkeys(_names(rivals, study)))
        belief, gap = _believed(_refitted(study, list(questions)))
        stages.append(InvestigationStage(run, proposal, found, belief, gap, close, tuple(hidden.values())))
        stop = _stop(found, rivals, gap)
        if stop is None and number >= settings.investigate:
            stop = InvestigationEndReason.EXPLAINED if hidden else InvestigationEndReason.SPENT
        if stop is None and rivals is not None:
            say("designing the next motion")
            last = experiment.drive.last_command_time or 0.0
            elapsed = experiment.measurement.model_time(last) + REST_BEFORE_MOTION_SECONDS
            proposal = designed_motion(
                rivals, USUAL_MOTION_SECONDS, DESIGNED_MOTION_LIMITS, seed=number, elapsed=elapsed
            )
            assert proposal.experiment.motion is not None, "it was designed"
            made = fit_motion_to_arm(proposal.experiment.motion, rivals.hypotheses, arm, table, settings.load_radius)
            if made is None or not _promising(proposal):
                stop = InvestigationEndReason.EXPLAINED if hidden else InvestigationEndReason.INSEPARABLE
            else:
                motion = made.trajectory
        if stop is not None:
            better = fitted_model(study, found.search) if stop in ENDS_WITH_BETTER_MODEL else None
            remedy = None
            if rivals is not None and stop in (InvestigationEndReason.INSEPARABLE, InvestigationEndReason.SPENT):
                remedy = best_without_designed_motion(rivals, USUAL_MOTION_SECONDS, DESIGNED_MOTION_LIMITS)
            return Investigation(
                tuple(stages), stop, cast("PendulumModel | None", better), place=place, remedy=remedy, clock=clock
            )


S = TypeVar("S", bound=ProtocolSettings)


def settings_after_investigation(settings: S, found: Investigation) -> S:
    """Settings of the trial after an investigation: the given settings, with the model that was found."""
    settings = replace(settings, load_at_rest_at_start=False, clock=found.clock)
    if found.model is None:
        return settings
    length = found.model.parameters["length"]
    # The string is the same: its learnt length stays known, but no better than a ruler measures it.
    model = found.model.with_prior("length", length.value, max(length.std or 0.0, MIN_STRING_LENGTH_STD))
    return replace(settings, model=model, length_guess=length.value)


def early_ending(experiment: Experiment, found: Investigation | None) -> TrialEnding | None:
    """Ending of a trial whose investigation was stopped early; None if the trial may continue.

    Args:
        experiment: the trial after the investigation, not yet started.
        found: result of the investigation; None for a trial without one.
    """
    if found is None or found.ending is None:
        return None
    experiment.interrupted = found.signal
    return found.ending


def investigated_model(settings: ProtocolSettings) -> PendulumModel:
    """Model that an investigation compares with the recordings.

    It is the starting model of a trial without drag, which becomes a candidate effect. Start angle and rate are
    parameters with small standard deviations, because the load may still sway.
    """
    model = replace(settings, load_at_rest_at_start=False).starting_model()
    for name in NUISANCE_CANDIDATES:
        if settings.model is None or not settings.model.joints_having_effect(name):
            model = model.without_effect(name)
    return model


def _stop(found: Diagnosis, rivals: Rivals | None, gap: float | None) -> InvestigationEndReason | None:
    if rivals is not None:
        return None
    if found.verdict is Verdict.EXPLAINED:
        return InvestigationEndReason.EXPLAINED
    # A rival that has won is kept, even where the arm adds more residual than the load cell's noise.
    won = gap is not None and gap > TIE_CHI2
    nothing = found.verdict in (Verdict.UNKNOWN_EFFECT, Verdict.LOST)
    won = won and len(found.search.steps) > 1
    return InvestigationEndReason.UNKNOWN if nothing and not won else InvestigationEndReason.NAMED


def _promising(proposal: ProposedExperiment) -> bool:
    """Whether a motion may distinguish at least one pair of rivals."""
    return proposal.expected.probability > MIN_RIGHT_VERDICT_PROBABILITY or bool(
        np.any(proposal.expected.chi2_increase > MIN_EXPECTED_CHI2_INCREASE)
    )


MIN_EXPECTED_CHI2_INCREASE = 12.0
"""Smallest expected increase of χ² for which a designed motion is made: twice that which separates two effects."""


def _names(rivals: Rivals, study: Study) -> list[tuple[str, ...]]:
    """The effects of every rival that the model of the study lacks."""
    lacking = {c.effect for c in study.candidates}
    return [tuple(e.name for e in h.model.effects if e.name in lacking) for h in rivals.hypotheses]


def _refitted(study: Study, questions: Sequence[tuple[str, ...]]) -> Rivals | None:
    """All rivals that were in question, fitted to all experiments; None for fewer than two."""
    return rivals_refitted_to(study, questions) if len(questions) > 1 else None


def _believed(rivals: Rivals | None) -> tuple[dict[str, float], float | None]:
    """Probability of each rival after all experiments so far, and the chi2 gap from the best to the second best."""
    if rivals is None:
        return {}, None
    shares = hypothesis_probabilities(rivals.hypotheses)
    return {h.name: float(b) for h, b in zip(rivals.hypotheses, shares, strict=True)}, rivals.hypotheses[1].misfit


def _decide(found: Diagnosis, tied: Rivals | None, asked: Rivals, study: Study) -> bool:
    """Whether the rivals that were in question decide, by their fits to all experiments, against a diagnosis.

    Its evidence has process noise, which excuses what adds up over many swings: where one rival has won, it is the
    answer instead of another one. Where "nothing" was a rival, something is missing if it is excluded.
    """
    names = _names(asked, study)
    if found.verdict in (Verdict.EXPLAINED, Verdict.UNKNOWN_EFFECT):
        needed = 2.0 * (study.settings.search.acceptance_nats + float(np.log(len(study.candidates))))
        return tied is None and any(h.name == NO_EFFECT_NAME and h.misfit > needed for h in asked.hypotheses)
    given, last = found.search.steps[0].effects, found.search.last.effects
    mine = tuple(dict.fromkeys(c.effect for c in last if c not in given))
    return asked.hypotheses[1].misfit > TIE_CHI2 and mine in names[1:]


def _named_by_rivals(study: Study, found: Diagnosis, rivals: Rivals) -> tuple[Diagnosis, Rivals | None]:
    """The diagnosis that names the best rival, and the rivals that are still tied with it, None without one.

    Where more than noise is left, it must explain what each of its values must explain in any search.
    """
    best, *_ = _names(rivals, study)
    named = diagnosis_naming(study, found, best)
    if found.verdict is not Verdict.EXPLAINED:
        given, last = named.search.steps
        values = int(last.fit.free.sum() - given.fit.free.sum())
        if study.squared_error(last.fit) > study.settings.search.needed_share(values) * study.squared_error(given.fit):
            return found, None
    tied = tuple(h for h in rivals.hypotheses if h.misfit <= TIE_CHI2)
    return named, replace(rivals, hypotheses=tied) if len(tied) > 1 else None
