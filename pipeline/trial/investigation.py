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
from armdyn.experiments.limits import GripperLimits
from armdyn.experiments.plan import MIN_RIGHT_VERDICT_PROBABILITY, ProposedExperiment, designed_motion
from armdyn.experiments.rivals import Rivals, rivals_of_diagnosis, rivals_of_first_effect, rivals_refitted_to
from armdyn.experiments.separation import TIE_CHI2, hypothesis_probabilities
from armdyn.identify.diagnose import Diagnosis, diagnose
from armdyn.identify.repair import fitted_model
from armdyn.identify.sentence import Verdict
from armdyn.identify.studies import make_study
from armdyn.identify.study import Study
from armdyn.pendulum.model import PendulumModel
from armdyn.run import Run
from ik import LineTable
from pipeline.motion import LineTrajectory
from pipeline.motion.feasible_motion import fit_motion_to_arm
from pipeline.trial.ending import TrialEnding
from pipeline.trial.experiment import REST_BEFORE_MOTION_SECONDS, Experiment, Phase
from pipeline.trial.settings import ProtocolSettings

DESIGNED_MOTION_SECONDS = 8.0
"""Duration of a designed motion [s]."""
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
    """

    run: Run
    proposal: ProposedExperiment | None
    diagnosis: Diagnosis
    belief: dict[str, float] = field(default_factory=dict)
    gap: float | None = None
    close: tuple[str, ...] = ()

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
    """

    stages: tuple[InvestigationStage, ...]
    stop: InvestigationEndReason
    model: PendulumModel | None
    ending: TrialEnding | None = None
    place: float = 0.0
    signal: int | None = None

    @property
    def sentence(self) -> str:
        """Result of the investigation in one sentence."""
        count = len(self.stages)
        what = ", ".join(self.stages[-1].candidates) if self.stages else ""
        made = f"after {count} experiment{'s' if count != 1 else ''}"
        return f"{made} {self.stop.value}" + (f": {what}" if what else "")


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
    while True:
        number = len(stages) + 1
        now = replace(settings, estimate=True, motion=motion, load_at_rest_at_start=number == 1)
        experiment, ending = swing(now, number, place)
        place = experiment.drive.state.s
        if ending.stopped:
            return Investigation(
                tuple(stages), InvestigationEndReason.INTERRUPTED, None, ending, place, experiment.interrupted
            )
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
        if rivals is not None:
            questions.update(dict.fromkeys(_names(rivals, study)))
        belief, gap = _believed(study, list(questions))
        stages.append(InvestigationStage(run, proposal, found, belief, gap, close))
        stop = _stop(found, rivals, gap)
        if stop is None and number >= settings.investigate:
            stop = InvestigationEndReason.SPENT
        if stop is None and rivals is not None:
            say("designing the next motion")
            proposal = designed_motion(rivals, DESIGNED_MOTION_SECONDS, DESIGNED_MOTION_LIMITS, seed=number)
            assert proposal.experiment.motion is not None, "it was designed"
            made = fit_motion_to_arm(proposal.experiment.motion, rivals.hypotheses, arm, table, settings.load_radius)
            if made is None or not _promising(proposal):
                stop = InvestigationEndReason.INSEPARABLE
            else:
                motion = made.trajectory
        if stop is not None:
            better = fitted_model(study, found.search) if stop in ENDS_WITH_BETTER_MODEL else None
            return Investigation(tuple(stages), stop, cast("PendulumModel | None", better), None, place)


S = TypeVar("S", bound=ProtocolSettings)


def settings_after_investigation(settings: S, found: Investigation) -> S:
    """Settings of the trial after an investigation: the given settings, with the model that was found."""
    settings = replace(settings, load_at_rest_at_start=False)
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
    if found.verdict is Verdict.EXPLAINED:
        return InvestigationEndReason.EXPLAINED
    if rivals is not None:
        return None
    # A rival that has won is kept, even where the arm adds more residual than the load cell's noise.
    won = gap is not None and gap > TIE_CHI2
    nothing = found.verdict in (Verdict.UNKNOWN_EFFECT, Verdict.LOST)
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


def _believed(study: Study, questions: Sequence[tuple[str, ...]]) -> tuple[dict[str, float], float | None]:
    """Probability of each rival after all experiments so far, and the chi2 gap from the best to the second best."""
    if len(questions) < 2:
        return {}, None
    rivals = rivals_refitted_to(study, questions)
    shares = hypothesis_probabilities(rivals.hypotheses)
    return {h.name: float(b) for h, b in zip(rivals.hypotheses, shares, strict=True)}, rivals.hypotheses[1].misfit
