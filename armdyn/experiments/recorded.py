"""What the next motion of an arm should tell, from a diagnosis of the recordings that there are."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from armdyn.arm.arm import Arm
from armdyn.arm.composition import depends_on_past
from armdyn.arm.model import ArmModel, required_arm
from armdyn.arm.prepared import motion_of_run
from armdyn.arm.wrench.reading import wrench_reading
from armdyn.effects.effect import Effect
from armdyn.errors import InputError, TaskFailedError, UnknownNameError
from armdyn.estimation.correlation import correlation_time
from armdyn.experiments.arm import EVALUATED_INSTANTS_PER_SECOND
from armdyn.experiments.columns import EarlierRuns
from armdyn.experiments.goal import MotionGoal, goal_to_determine, goal_to_separate
from armdyn.experiments.rivals import WELL_KNOWN_STD_TYPICAL_SIZES, undistinguished_effect_sets
from armdyn.experiments.series import AxisMotion
from armdyn.identify.compare import fitted_parameters
from armdyn.identify.diagnose import Diagnosis, diagnose
from armdyn.identify.fit import Fit
from armdyn.identify.repair import model_of_step
from armdyn.identify.residual.block import blocks_by_channel
from armdyn.identify.sentence import Verdict, join_names
from armdyn.identify.study import Study
from armdyn.run import Run
from armdyn.threads import one_thread

MOTION_RATE_HZ = 100.0
"""Samples per second of the designed motion, and of its recording."""


@dataclass(frozen=True, eq=False)
class ArmQuestion:
    """What the recordings of an arm leave open.

    Attributes:
        verdict: verdict of their diagnosis.
        sentence: the diagnosis in words.
        model: the model with the effects that were found, at the fitted values.
        goal: what the next motion should tell; None where nothing is open.
    """

    verdict: Verdict
    sentence: str
    model: ArmModel
    goal: MotionGoal | None


@one_thread
def question_of_study(
    study: Study, names: Sequence[str] | None = None, say: Callable[[str], None] | None = None
) -> ArmQuestion:
    """Diagnose the recordings of an arm, and find what its next motion should tell.

    Two effects are to be distinguished if the diagnosis cannot; otherwise the values are wanted that the recordings do
    not determine well.

    Args:
        study: the recordings, with an arm's model.
        names: effects to distinguish, or one to determine, in place of those of the diagnosis.
        say: function that is called with a sentence about the progress.

    Raises:
        InputError: no motion can be designed for these effects.
        TaskFailedError: the fit has failed, or no motion can distinguish them.
    """
    found = diagnose(study, say)
    if found.verdict is Verdict.LOST:
        raise TaskFailedError(found.sentence)
    last = found.search.last
    model = _of_an_instant(required_arm(model_of_step(study, last), "a motion is designed", "give an arm's"))
    earlier = earlier_runs(model, study.runs, last.fit)
    tied = found.verdict is Verdict.CANNOT_TELL_APART
    wanted = _named(study, names) if names else _tied(study, found) if tied else _uncertain(study, last.fit, model)
    said, goal = found.sentence, None
    if not wanted and found.verdict is Verdict.UNKNOWN_EFFECT:
        said += " No experiment can be designed for an effect that no model describes."
    elif not wanted:
        said += " No effects remain to be distinguished, and all values are known well."
    elif len(wanted) == 2 and (names or tied):
        goal = goal_to_separate(model, wanted[0], wanted[1], MOTION_RATE_HZ, earlier)
    else:
        goal = goal_to_determine(model, wanted, MOTION_RATE_HZ, earlier)
        if np.isin(goal.wanted, goal.unidentifiable).all():
            said += f" No motion determines {join_names([e.name for e in wanted])}: other values make the same torques."
            goal = None
    return ArmQuestion(found.verdict, said, model, goal)


def earlier_runs(model: ArmModel, runs: Sequence[Run], fit: Fit) -> EarlierRuns:
    """What prepared runs contain: their residuals count as noise, as long as they are correlated."""
    noise = {}
    for channel, blocks in blocks_by_channel(fit.blocks).items():
        rate = sum(len(block.time) for block in blocks) / sum(float(np.ptp(block.time)) for block in blocks)
        misfits = [block.misfit for block in blocks]
        std = max(float(np.sqrt(np.mean(np.concatenate(misfits) ** 2))), *(block.noise for block in blocks))
        noise[channel] = std * float(np.sqrt(correlation_time(misfits) * MOTION_RATE_HZ / rate))
    channels = [f"tau.{joint}" for joint in model.arm.joints]
    channels += [channel for sensor in model.sensors.values() for channel in sensor.channels]
    stds = np.array([noise.get(channel, np.inf) for channel in channels])
    return EarlierRuns(stds, tuple(_states(run, model.arm) for run in runs))


def _states(run: Run, arm: Arm) -> tuple[AxisMotion, np.ndarray, float]:
    """Evenly spaced states of a run, their times since its start, s, and the samples of the given rate for each."""
    times = [run.channels[name].time for name in run.predictable_channels or run.channels]
    begin, end = min(float(t[0]) for t in times), max(float(t[-1]) for t in times)
    time = np.linspace(begin, end, max(round((end - begin) * EVALUATED_INSTANTS_PER_SECOND), 2))
    motion = motion_of_run(run, arm.joints).at(time)
    return AxisMotion(motion.q, motion.v, motion.a), time - begin, MOTION_RATE_HZ * (end - begin) / len(time)


def _of_an_instant(model: ArmModel) -> ArmModel:
    """The model without effects by which readings depend on what was before."""
    for effect in model.effects:
        if depends_on_past(effect) or (effect.acts_on == "wrench" and wrench_reading([effect]).readout.delays):
            model = model.without_effect(effect.name)
    return model


def _named(study: Study, names: Sequence[str]) -> list[Effect]:
    for name in names:
        if name not in study.effects:
            raise UnknownNameError("effect", name, study.effects)
    if len(names) > 2:
        raise InputError(f"--rivals {','.join(names)}: name two effects to distinguish, or one to determine")
    return [study.effects[name] for name in names]


def _tied(study: Study, found: Diagnosis) -> list[Effect]:
    """Two effects that the recordings do not distinguish, each on its joints."""
    best, other = (dict.fromkeys(one) for one in undistinguished_effect_sets(found)[:2])
    pair = [next((c for c in one if c not in beside), None) for one, beside in ((best, other), (other, best))]
    return [study.effects[c.effect].on(*c.joints) for c in pair if c is not None]


def _uncertain(study: Study, fit: Fit, model: ArmModel) -> list[Effect]:
    """Effects of a model with values that the recordings do not determine well, each on its joints."""
    values = fitted_parameters(study, fit)
    unknown = {
        p.effect for p in values.values()
        if p.effect and (p.std is None or p.std > WELL_KNOWN_STD_TYPICAL_SIZES * p.typical)
    }  # fmt: skip
    return [effect for effect in model.effects if effect.name in unknown]
