"""Investigation: the robot finds what its model lacks by experiments (swing, diagnose, design the next motion).

Each swing is an experiment of its own that leaves the load at rest; between two of them the arm stands and the
recordings are thought over. It knows neither whether the robot is simulated nor where its recordings go.
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
from armdyn.experiments.plan import MIN_RIGHT_PROBABILITY, Proposal, designed_motion
from armdyn.experiments.rivals import Rivals, contested, of_diagnosis, refitted
from armdyn.experiments.separation import TIE_CHI2, beliefs
from armdyn.identify.diagnose import Diagnosis, diagnose
from armdyn.identify.repair import fitted_model
from armdyn.identify.sentence import Verdict
from armdyn.identify.study import Study
from armdyn.pendulum.model import PendulumModel
from armdyn.run import Run
from ik import LineTable
from pipeline.motion import LineTrajectory
from pipeline.motion.feasible_motion import fit_motion_to_arm
from pipeline.trial.ending import Ending
from pipeline.trial.experiment import REST_SECONDS, Experiment, Phase
from pipeline.trial.settings import ProtocolSettings

MOTION_SECONDS = 8.0
"""Duration of a designed motion [s]."""
SWING_LIMITS = GripperLimits(swing=0.5)
"""A load that swings farther begins to swing across the line as well (on the simulated arm by 0.1 rad in 8 s at 1 rad,
by 0.05 at 0.6 rad), and no motion along the line brings that to rest."""
MIN_LENGTH_STD = 1e-3
"""Least standard deviation of the learnt length [m], that of a ruler."""
QUESTIONED_EFFECTS = ("linear_drag",)
"""Nuisances of a trial that are candidates in an investigation, because they hide others: drag hides friction."""

Swing = Callable[[ProtocolSettings, int, float], tuple["SwingExperiment", Ending]]
"""``(settings, number, where the gripper stands) -> the experiment that was made, and how it ended``."""


class Stop(Enum):
    """Reason why an investigation ended; the value is a sentence for a person."""

    EXPLAINED = "nothing is missing"
    NAMED = "one verdict stands"
    INSEPARABLE = "no motion of the gripper tells apart what is left"
    UNKNOWN = "something is missing that no effect of the catalogue explains"
    SPENT = "no experiment is left"
    INTERRUPTED = "an experiment was ended before its time"


ENDS_WITH_MODEL = (Stop.NAMED, Stop.INSEPARABLE, Stop.SPENT)
"""Ends after which the best model of all that was recorded is worth more than the one before."""


class SwingExperiment(Experiment):
    """An experiment that only learns: it ends with the load at rest below the gripper."""

    def _protocol(self) -> bool:
        self._run(Phase.REST, 0.0, REST_SECONDS)
        self._learn()
        self._settle()
        return True

    def recording(self, name: str) -> Run:
        """Recording of the learning phase; its noise is measured too, and includes the arm's contribution."""
        self.measurement.update_path()
        return replace(self.measurement.run(), name=name, noise={})


@dataclass(frozen=True, eq=False)
class InvestigationStage:
    """One experiment of an investigation, and its results.

    Attributes:
        run: the recording.
        proposal: the designed experiment with its expected results; None for the first.
        diagnosis: diagnosis from all runs so far.
        belief: probability of each effect that has been a candidate.
        gap: increase of chi2 from the best to the second-best effect; None where there is only one.
        close: effects that fit nearly as well as those that the diagnosis names; see `rivals.contested`.
    """

    run: Run
    proposal: Proposal | None
    diagnosis: Diagnosis
    belief: dict[str, float] = field(default_factory=dict)
    gap: float | None = None
    close: tuple[str, ...] = ()

    @property
    def candidates(self) -> tuple[str, ...]:
        """Effects that may be missing; empty where none is missing, or no known effect explains the runs."""
        if self.diagnosis.verdict is Verdict.EXPLAINED:
            return ()
        search = self.diagnosis.search
        given = search.steps[0].effects
        found = [c.effect for c in search.last.effects if c not in given]
        return tuple(dict.fromkeys([*found, *(c.effect for c in search.tied), *self.close]))

    @property
    def residual(self) -> float:
        """Root mean square of the best model's force residual, divided by the force's noise."""
        return float(np.sqrt(self.diagnosis.search.last.fit.chi2_per_sample))


@dataclass(frozen=True, eq=False)
class Investigation:
    """Result of an investigation.

    Attributes:
        stages: experiments in order.
        stop: reason why the experiments ended.
        model: model with the found effects; None where none was added.
        ending: ending of an experiment that was stopped early; None otherwise.
        place: present position of the gripper [m].
        signal: number of the signal that ended it; None where none did.
    """

    stages: tuple[InvestigationStage, ...]
    stop: Stop
    model: PendulumModel | None
    ending: Ending | None = None
    place: float = 0.0
    signal: int | None = None

    @property
    def sentence(self) -> str:
        """The investigation's result in one sentence."""
        count = len(self.stages)
        what = ", ".join(self.stages[-1].candidates) if self.stages else ""
        made = f"after {count} experiment{'s' if count != 1 else ''}"
        return f"{made} {self.stop.value}" + (f": {what}" if what else "")


def investigate(
    settings: ProtocolSettings,
    swing: Swing,
    arm: urdf.Robot,
    table: LineTable,
    say: Callable[[str], None],
) -> Investigation:
    """Repeat experiments (swing, diagnose, design the next motion) until the missing effects are known.

    Args:
        settings: settings of the trial that follows; `investigate` is the largest number of experiments.
        swing: makes one experiment.
        arm: arm that moves.
        table: IK table of the arm's line.
        say: called to report the progress.

    Raises:
        InputError: the number of experiments is below one.
    """
    if settings.investigate < 1:
        raise InputError(f"--investigate {settings.investigate}: allow at least one experiment")
    model = model_in_question(settings)
    stages: list[InvestigationStage] = []
    questions: dict[tuple[str, ...], None] = {}
    motion: LineTrajectory | None = None
    proposal: Proposal | None = None
    place = 0.0
    while True:
        number = len(stages) + 1
        now = replace(settings, estimate=True, motion=motion, hangs_still=number == 1)
        experiment, ending = swing(now, number, place)
        place = experiment.drive.state.s
        if ending.stopped:
            return Investigation(tuple(stages), Stop.INTERRUPTED, None, ending, place, experiment.interrupted)
        run = experiment.recording(f"experiment {number}")
        say(f"thinking over {number} experiment{'s' if number > 1 else ''}")
        asked = {name for names in questions for name in names}
        study = Study.of(model, [*(stage.run for stage in stages), run], [], tuple(CATALOGUE.values()), asked=asked)
        found = diagnose(study)
        rivals = of_diagnosis(study, found)
        close: tuple[str, ...] = ()
        if rivals is None and found.verdict is Verdict.EFFECT_MISSING:
            rivals = contested(study, found, designed=proposal is not None)
            close = () if rivals is None else tuple(name for names in _names(rivals, study) for name in names)
        if rivals is not None:
            questions.update(dict.fromkeys(_names(rivals, study)))
        belief, gap = _believed(study, list(questions))
        stages.append(InvestigationStage(run, proposal, found, belief, gap, close))
        stop = _stop(found, rivals, gap)
        if stop is None and number >= settings.investigate:
            stop = Stop.SPENT
        if stop is None and rivals is not None:
            say("designing the next motion")
            proposal = designed_motion(rivals, MOTION_SECONDS, SWING_LIMITS, seed=number)
            assert proposal.experiment.motion is not None, "it was designed"
            made = fit_motion_to_arm(proposal.experiment.motion, rivals.hypotheses, arm, table, settings.load_radius)
            if made is None or not _promising(proposal):
                stop = Stop.INSEPARABLE
            else:
                motion = made.trajectory
        if stop is not None:
            better = fitted_model(study, found.search.last) if stop in ENDS_WITH_MODEL else None
            return Investigation(tuple(stages), stop, cast("PendulumModel | None", better), None, place)


S = TypeVar("S", bound=ProtocolSettings)


def settings_after(settings: S, found: Investigation) -> S:
    """Settings of the trial that follows an investigation, with the found model."""
    settings = replace(settings, hangs_still=False)
    if found.model is None:
        return settings
    length = found.model.parameters["length"]
    # The string is the same: its learnt length stays known, but no better than a ruler measures it.
    model = found.model.with_prior("length", length.value, max(length.std or 0.0, MIN_LENGTH_STD))
    return replace(settings, model=model, length_guess=length.value)


def ending_before(experiment: Experiment, found: Investigation | None) -> Ending | None:
    """Ending of the trial where an earlier experiment was stopped early; None where the trial may go on."""
    if found is None or found.ending is None:
        return None
    experiment.interrupted = found.signal
    return found.ending


def model_in_question(settings: ProtocolSettings) -> PendulumModel:
    """The model that is compared with the recordings: the robot's, with drag as a candidate, not as a nuisance.

    Its start is nearly at rest, and not held there: the robot may have left the load swaying.
    """
    model = replace(settings, hangs_still=False).starting_model()
    for name in QUESTIONED_EFFECTS:
        if settings.model is None or not settings.model.joints_with(name):
            model = model.without_effect(name)
    return model


def _stop(found: Diagnosis, rivals: Rivals | None, gap: float | None) -> Stop | None:
    if found.verdict is Verdict.EXPLAINED:
        return Stop.EXPLAINED
    if rivals is not None:
        return None
    # A rival that has won is kept, even where the arm adds more residual than the load cell's noise.
    won = gap is not None and gap > TIE_CHI2
    nothing = found.verdict in (Verdict.UNKNOWN_EFFECT, Verdict.LOST)
    return Stop.UNKNOWN if nothing and not won else Stop.NAMED


def _promising(proposal: Proposal) -> bool:
    """Whether a motion may distinguish at least one pair of rivals."""
    return proposal.outlook.probability > MIN_RIGHT_PROBABILITY or bool(
        np.any(proposal.outlook.chi2_increase > MIN_EXPECTED_GAP)
    )


MIN_EXPECTED_GAP = 12.0
"""Least expected rise of chi2 of a motion that is made: twice the margin of a tie."""


def _names(rivals: Rivals, study: Study) -> list[tuple[str, ...]]:
    """The effects of every rival that the model of the study lacks."""
    lacking = {c.effect for c in study.candidates}
    return [tuple(e.name for e in h.model.effects if e.name in lacking) for h in rivals.hypotheses]


def _believed(study: Study, questions: Sequence[tuple[str, ...]]) -> tuple[dict[str, float], float | None]:
    """Probability of each rival after all experiments so far, and the chi2 gap from the best to the second best."""
    if len(questions) < 2:
        return {}, None
    rivals = refitted(study, questions)
    shares = beliefs(rivals.hypotheses)
    return {h.name: float(b) for h, b in zip(rivals.hypotheses, shares, strict=True)}, rivals.hypotheses[1].misfit
