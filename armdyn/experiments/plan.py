"""Plan the next experiment: compare all kinds of experiments that a laboratory can do by their expected results.

Pairs that no motion of the gripper separates are named, with the reason, as far as the equations give one.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations
from typing import Any

import numpy as np

from armdyn.displayable import Displayable
from armdyn.document import Column, Curve, Document, Section, Table
from armdyn.experiments.gripper import design_motion
from armdyn.experiments.hypothesis import Hypothesis, PlannedExperiment, PredictedExperiment
from armdyn.experiments.limits import GripperLimits
from armdyn.experiments.process import is_possible
from armdyn.experiments.rivals import Rivals, last_motion
from armdyn.experiments.search import ReportProgress
from armdyn.experiments.separation import ExpectedOutcome, RivalRefitCost, expected_outcome, hypothesis_probabilities
from armdyn.identify.sentence import join_names
from armdyn.pendulum.path import GripperPath, gripper_path
from armdyn.run import Run
from armdyn.threads import one_thread

MIN_CHI2_RISE_OF_SEPARABLE_PAIR = 1.0
"""Rise of chi2 by a motion designed for a pair of hypotheses, below which no motion separates the pair."""
SAME_REST_ANGLE_RELATIVE_TOLERANCE = 0.02
"""Relative difference up to which two rest angles count as equal."""
MIN_REPORTED_REST_ANGLE_RADIANS = 1e-3
"""Smallest rest angle of the load that a sentence mentions, rad."""
MIN_REPORTED_CHANGE_TYPICAL_SIZES = 0.02
"""Smallest change of an unknown that a sentence mentions, in typical sizes."""
ADDED_ANGLE_SENSOR_NOISE_RADIANS = 5e-3
"""Noise of an angle sensor that could be added, an encoder or a camera, rad."""
WEIGHING_ERROR_SHARE = 5e-3
"""Relative accuracy with which a load is weighed."""
RULER_ERROR_METRES = 1e-3
"""Accuracy with which a string is measured with a ruler, m."""
OTHER_LOAD_MASS_RATIO = 2.0
"""Ratio of the other load's mass to the present one: the same shape, filled."""
OTHER_STRING_LENGTH_RATIO = 0.7
"""Ratio of the other string's length to the present one."""
USUAL_MOTION_SECONDS = 8.0
"""Duration of a designed motion of the gripper, s."""
RECORDING_AT_REST_SECONDS = 60.0
"""Duration of a recording at rest, s."""
REST_NODE_INTERVAL_SECONDS = 0.02
"""Time between the nodes of a simulation at rest, s."""
MIN_RIGHT_VERDICT_PROBABILITY = 0.2
"""Probability of a right verdict up to which an experiment is not recommended: four of five would decide nothing."""
MAX_RELEASED_SECONDS, LONGER_DURATION_RATIO = 30.0, 3.0
"""Longest swing whose repetition is compared, s, and ratio of a longer one to it."""
MAX_RELEASED_ANGLE_RADIANS, USUAL_RELEASED_ANGLE_RADIANS = 1.2, 0.3
"""Largest angle from which a release is proposed, and the angle that is taken where none was measured, rad."""
ROOM_FIXED_EFFECTS = ("wind",)
"""Effects with a direction that is fixed in the room: if the robot is turned by 180 degrees, their sign changes."""


@dataclass(frozen=True)
class InseparablePair:
    """A pair of effects that no motion of the gripper separates.

    Attributes:
        effects: names of the two effects.
        why: sentence with the reason.
    """

    effects: tuple[str, str]
    why: str


def inseparable_pairs(
    hypotheses: Sequence[Hypothesis], outlook: ExpectedOutcome, experiment: PlannedExperiment
) -> tuple[InseparablePair, ...]:
    """Pairs of hypotheses that the motion designed for them does not separate, whichever of the two is true."""
    rises = np.maximum(outlook.chi2_increase, outlook.chi2_increase.T)
    pairs = [pair for pair in combinations(range(len(hypotheses)), 2) if rises[pair] < MIN_CHI2_RISE_OF_SEPARABLE_PAIR]
    both = [(hypotheses[i], hypotheses[j]) for i, j in pairs]
    return tuple(InseparablePair((one.name, other.name), _why(one, other, experiment)) for one, other in both)


def _why(first: Hypothesis, second: Hypothesis, experiment: PlannedExperiment) -> str:
    """Changes of the second hypothesis with which it predicts the same as the first."""
    truth, rival = PredictedExperiment(first, experiment), PredictedExperiment(second, experiment)
    readings, _ = truth.predict(truth.start)
    rise, best = RivalRefitCost(rival, readings).chi2_increase_and_refit()
    said = (
        f"along every motion {second.name} with {_changes(first, rival, best)} predicts what {first.name} does "
        f"({float(np.sqrt(rise / max(len(readings), 1))):.1g} of the noise apart)"
    )
    model = second.pendulum
    values = {n: float(v) for n, v in zip(rival.names, best, strict=True) if n not in model.start_names}
    hangs = model.with_values(values).rest_angle()
    if abs(hangs) > MIN_REPORTED_REST_ANGLE_RADIANS and abs(
        hangs - first.rest_angle
    ) < SAME_REST_ANGLE_RELATIVE_TOLERANCE * abs(hangs):
        said += (
            f": both turn the direction in which the load hangs by {abs(hangs):.3g} rad, and apart from that nothing: "
            "a rotation of the frame"
        )
    return said


def _changes(first: Hypothesis, rival: PredictedExperiment, best: np.ndarray) -> str:
    base = {name: first.model.value(name) for name in first.model.names}
    base |= dict.fromkeys(rival.hypothesis.model.start_names, 0.0) | {"initial_angle": first.rest_angle}
    parts = []
    for name, value in zip(rival.names, best, strict=True):
        p = rival.hypothesis.model.parameters[name]
        if name not in first.model.names and p.effect:
            parts.append(f"{name} = {value:.3g} {p.unit}")
        elif name in first.model.names and abs(value - base[name]) > MIN_REPORTED_CHANGE_TYPICAL_SIZES * p.typical:
            parts.append(f"{name} off by {value - base[name]:.3g} {p.unit}")
    return " and ".join(parts) or "the same values"


@dataclass(frozen=True, eq=False)
class ProposedExperiment:
    """An experiment that is proposed, with its expected result.

    Attributes:
        experiment: the experiment.
        expected: its expected result.
        random_motion_chi2_increase: smallest rise of chi2 for the median of random motions; None without a designed
            motion.
    """

    experiment: PlannedExperiment
    expected: ExpectedOutcome
    random_motion_chi2_increase: float | None = None

    @property
    def rank(self) -> tuple[float, bool, float]:
        """Sort key, the best experiment first: by probability of a right verdict, manual work, and separation."""
        return -round(self.expected.probability, 2), self.experiment.kind != "motion", -self.expected.separation


@dataclass(frozen=True, eq=False, repr=False)
class ExperimentPlan(Displayable):
    """Plan of the next experiment: all proposed experiments, the best first.

    Attributes:
        rivals: the hypotheses to distinguish.
        proposals: experiments, the best first.
        inseparable: pairs of hypotheses that no motion of the gripper separates, with the reason.
    """

    rivals: Rivals
    proposals: tuple[ProposedExperiment, ...]
    inseparable: tuple[InseparablePair, ...]

    def __str__(self) -> str:
        return self.sentence

    __repr__ = __str__

    def document(self) -> Document:
        """Build a document with the experiments, the probabilities of the hypotheses, and the designed motion."""
        outlooks = [p.expected for p in self.proposals]
        chances, beliefs = [one.probability for one in outlooks], list(self.rival_probabilities)
        experiments = [
            Column("experiment", [p.experiment.kind for p in self.proposals]),
            Column("separation [std]", [one.separation for one in outlooks], ".1f"),
            Column("right verdict", chances, ".0%", bar_lengths=chances),
            Column("what to do", [p.experiment.what for p in self.proposals]),
        ]
        promise = (
            "Separation: by how many standard deviations of the noise the two most similar hypotheses differ over the "
            "whole experiment, after the wrong one was fitted to what the right one predicts; below 2 noise can hide "
            "the difference. Right verdict: probability that the diagnosis of all runs then names one effect, and the "
            "right one."
        )
        names = [h.name for h in self.rivals.hypotheses]
        believed = [Column("may be true", names), Column("belief so far", beliefs, ".0%", bar_lengths=beliefs)]
        tables = [
            Table(experiments, promise, "experiments"),
            Table(believed, "From how well each fits the runs so far."),
        ]
        if self.inseparable:
            pairs = [[" / ".join(pair.effects), pair.why] for pair in self.inseparable]
            tables.append(Table.of(["no motion separates", "why"], pairs))
        section = Section("Which experiment", self.sentence, tables=tables)
        drawn = next((p.experiment for p in self.proposals if p.experiment.run is not None), None)
        curves = partial(_curves, self.rivals.hypotheses, drawn) if drawn is not None else None
        return Document("Next experiment", self.sentence, [section], curves=curves)

    @property
    def sentence(self) -> str:
        """Sentence that names the hypotheses to distinguish and the best experiment."""
        names = [h.name for h in self.rivals.hypotheses]
        said = f"To distinguish {join_names(names)}"
        parameters = {name.partition(" = ")[0] for name in names}
        if len(parameters) == 1 < len(names):  # two values of one parameter
            values = " or ".join(name.partition(" = ")[2] for name in names)
            said = f"To know {parameters.pop()} better, {values}"
        best = next((p for p in self.proposals if p.expected.probability > MIN_RIGHT_VERDICT_PROBABILITY), None)
        if best is None:
            return f"{said}: none of these experiments does."
        motion, size = best.experiment.motion, ""
        if best.experiment.kind == "motion" and motion is not None:
            x, _, a = motion.peaks
            size = f", in {motion.duration:g} s, at most {x:.2f} m to the side, {a:.1f} m/s^2, "
            size += f"effort {motion.effort:.1f} m^2/s^3"
        return (
            f"{said}: {best.experiment.what} ({best.expected.separation:.1f} standard deviations, "
            f"a right verdict with {best.expected.probability:.0%}){size}."
        )

    @property
    def rival_probabilities(self) -> list[float]:
        """Probability of each rival, given the runs so far."""
        return [float(b) for b in hypothesis_probabilities(self.rivals.hypotheses)]

    @property
    def motion(self) -> ProposedExperiment | None:
        """The proposed experiment with a designed motion; None without one."""
        return next((p for p in self.proposals if p.experiment.kind == "motion"), None)


def _curves(hypotheses: Sequence[Hypothesis], experiment: PlannedExperiment) -> list[Curve]:
    """What each hypothesis predicts for an experiment, above it the gripper's motion."""
    recorded = (
        experiment.run.document().curves if experiment.motion is not None and experiment.run is not None else None
    )
    moved = [c for c in recorded() if c.panel.startswith("gripper") and np.ptp(c.value)] if recorded is not None else []
    return [*moved, *(curve for h in hypotheses for curve in PredictedExperiment(h, experiment).curves())]


@one_thread
def plan_experiment(
    rivals: Rivals,
    seconds: float = USUAL_MOTION_SECONDS,
    limits: GripperLimits | None = None,
    seed: int = 0,
    say: ReportProgress = lambda _: None,
) -> ExperimentPlan:
    """Design a motion that takes `seconds`, and compare it with every other kind of experiment.

    Below a pivot that stands still, the experiments are swings that a hand releases, as long as the last run.
    """
    proposals, pairs = list[ProposedExperiment](), tuple[InseparablePair, ...]()
    if rivals.pivot_stands:
        others = released_experiments(rivals)
    else:
        moving = designed_motion(rivals, seconds, limits, seed, say)
        pairs = inseparable_pairs(rivals.hypotheses, moving.expected, moving.experiment)
        proposals, others = [moving], other_experiments(rivals, seconds)
    proposals += _weighed_up(rivals, others, limits, seed, say)
    return ExperimentPlan(rivals, tuple(sorted(proposals, key=lambda p: p.rank)), pairs)


@one_thread
def plan_process_experiment(
    rivals: Rivals,
    experiments: Sequence[PlannedExperiment],
    seed: int = 0,
    say: ReportProgress = lambda _: None,
) -> ExperimentPlan:
    """Compare experiments with a process of one's own by their expected results; see `process_experiments`."""
    possible = [e for e in experiments if is_possible(rivals.hypotheses, e)]
    proposals = _expected(rivals, possible, seed, say)
    return ExperimentPlan(rivals, tuple(sorted(proposals, key=lambda p: p.rank)), ())


def best_without_designed_motion(
    rivals: Rivals, seconds: float, limits: GripperLimits | None = None
) -> ProposedExperiment | None:
    """The best experiment without a designed motion, such as weighing the load; None if none is worth its work."""
    proposals = _weighed_up(rivals, other_experiments(rivals, seconds), limits)
    best = min(proposals, key=lambda p: p.rank, default=None)
    return best if best is not None and best.expected.probability > MIN_RIGHT_VERDICT_PROBABILITY else None


def _weighed_up(
    rivals: Rivals,
    experiments: Sequence[PlannedExperiment],
    limits: GripperLimits | None,
    seed: int = 0,
    say: ReportProgress = lambda _: None,
) -> list[ProposedExperiment]:
    """The safe ones of some experiments, with their expected results."""
    safe = [e for e in experiments if is_safe(rivals, e, limits.swing if limits is not None else np.inf)]
    return _expected(rivals, safe, seed, say)


def _expected(
    rivals: Rivals, experiments: Sequence[PlannedExperiment], seed: int, say: ReportProgress
) -> list[ProposedExperiment]:
    """Experiments with their expected results."""
    found = []
    for experiment in experiments:
        say(f"weighing up: {experiment.kind}")
        found.append(ProposedExperiment(experiment, expected_outcome(rivals.hypotheses, experiment, seed)))
    return found


def is_safe(rivals: Rivals, experiment: PlannedExperiment, swing: float) -> bool:
    """Whether every rival predicts a taut string and swing angles up to `swing`, rad, in an experiment.

    An experiment that repeats the last run may reach the swing angles of that run, even above the limit.
    """
    if experiment.motion is None:
        return True
    last = experiment.along_motion(last_motion(rivals.last, experiment.motion.duration))
    begun = None if experiment.released is None else released_angle(rivals.last)
    plain = replace(last, changed={}, released=begun)
    for hypothesis in rivals.hypotheses:
        there, before = PredictedExperiment(hypothesis, experiment), PredictedExperiment(hypothesis, plain)
        allowed = max(swing, float(np.abs(before.swing(before.start)).max()))
        if not (np.abs(there.swing(there.start)).max() <= allowed and there.tension(there.start).min() > 0.0):
            return False
    return True


def designed_motion(
    rivals: Rivals,
    seconds: float,
    limits: GripperLimits | None = None,
    seed: int = 0,
    say: ReportProgress = lambda _: None,
    elapsed: float = 0.0,
) -> ProposedExperiment:
    """The experiment with the motion that separates the rivals best; pairs that no motion separates are ignored.

    It begins `elapsed` s after the beginning of the recordings; for the other arguments see `plan_experiment`.
    """
    experiment = PlannedExperiment("motion", "swing along the designed motion", noise=rivals.noise, elapsed=elapsed)
    motion, random = design_motion(rivals.hypotheses, experiment, seconds, limits, seed, say)
    experiment = experiment.along_motion(motion)
    return ProposedExperiment(experiment, expected_outcome(rivals.hypotheses, experiment, seed), random)


def released_experiments(rivals: Rivals) -> list[PlannedExperiment]:
    """Swings below a pivot that stands still: from other angles, longer, and the kinds of `other_experiments`."""
    angle = released_angle(rivals.last)
    recorded = gripper_path(rivals.last).duration
    seconds = min(recorded, MAX_RELEASED_SECONDS)
    still = last_motion(rivals.last, seconds)
    longer = GripperPath(0.0, still.dt, *np.zeros((3, round(LONGER_DURATION_RATIO * seconds / still.dt) + 1)))
    larger, smaller = min(2.0 * angle, max(angle, MAX_RELEASED_ANGLE_RADIANS)), 0.25 * angle

    def swing(kind: str, what: str, path: GripperPath, begins: float) -> PlannedExperiment:
        return PlannedExperiment(kind, what, path, rivals.noise, released=begins)

    of = f"record a swing of {seconds:.0f} s from"
    found = [swing("smaller", f"{of} {np.rad2deg(smaller):.2g} degrees", still, smaller)]
    if larger > angle:
        found.append(swing("larger", f"{of} {np.rad2deg(larger):.0f} degrees", still, larger))
    found.append(
        swing(
            "longer", f"record a swing from {np.rad2deg(angle):.0f} degrees for {longer.duration:.0f} s", longer, angle
        )
    )
    return [*found, *other_experiments(rivals, seconds)]


def released_angle(run: Run) -> float:
    """Angle from which the load of a run was released, rad; a usual one where only its force was measured."""
    measured = run.channels.get("swing_angle")
    if measured is None:
        return USUAL_RELEASED_ANGLE_RADIANS
    first = measured.value[measured.time <= measured.time[0] + 0.5 * (measured.time[-1] - measured.time[0])]
    return float(np.ptp(first)) / 2.0


def other_experiments(rivals: Rivals, seconds: float) -> list[PlannedExperiment]:
    """Experiments without a designed motion that were not done yet, such as another load or weighing."""
    best, noise, last = rivals.hypotheses[0].model, rivals.noise, last_motion(rivals.last, seconds)
    released = released_angle(rivals.last) if rivals.pivot_stands else None
    mass, length = best.value("mass"), OTHER_STRING_LENGTH_RATIO * best.value("length")
    weight, weighing = OTHER_LOAD_MASS_RATIO * mass, WEIGHING_ERROR_SHARE * mass

    def varied(kind: str, how: str, noise: Mapping[str, float] = noise, **changes: Any) -> PlannedExperiment:
        again = "repeat the last motion" if released is None else "repeat the last swing"
        return PlannedExperiment(kind, f"{again} {how}", last, noise, released=released, **changes)

    found = [
        varied(
            "mass", f"with a load of the same shape that weighs {1e3 * weight:.0f} g "
            f"+/- {1e3 * WEIGHING_ERROR_SHARE * weight:.1f} g",
            changed={"mass": (weight, WEIGHING_ERROR_SHARE * weight)},
        ),
        varied(
            "length", f"on a string of {length:.3f} m +/- {1e3 * RULER_ERROR_METRES:g} mm",
            changed={"length": (length, RULER_ERROR_METRES)},
        ),
    ]  # fmt: skip
    if not {"swing_angle", "swing_rate"} & noise.keys():
        what = f"with a sensor of the swing angle (noise {1e3 * ADDED_ANGLE_SENSOR_NOISE_RADIANS:g} mrad)"
        found.append(varied("angle_sensor", what, noise={**noise, "swing_angle": ADDED_ANGLE_SENSOR_NOISE_RADIANS}))
    for kind, name, std, what in (
        ("weigh", "mass", weighing, f'weigh the load and state it: mass = "... g +/- {1e3 * weighing:.1f} g"'),
        ("measure", "length", RULER_ERROR_METRES,
         f'measure the string and state it: length = "... m +/- {1e3 * RULER_ERROR_METRES:g} mm"'),
    ):  # fmt: skip
        known = rivals.last.known.get(name)
        if known is None or (known.std or 0.0) > 2.0 * std:
            found.append(PlannedExperiment(kind, what, measured={name: std}))
    turned = [n for h in rivals.hypotheses for n, p in h.model.parameters.items() if p.effect in ROOM_FIXED_EFFECTS]
    if turned and not rivals.pivot_stands:
        what = "with the robot turned round by 180 degrees: what belongs to the room changes sign along the line, what "
        what += "belongs to the robot does not"
        found.append(varied("turn", what, sign_reversed=tuple(dict.fromkeys(turned))))
    if "load_force" in noise:
        still = GripperPath(
            0.0,
            REST_NODE_INTERVAL_SECONDS,
            *np.zeros((3, round(RECORDING_AT_REST_SECONDS / REST_NODE_INTERVAL_SECONDS) + 1)),
        )
        what = f"record the load cell for {RECORDING_AT_REST_SECONDS:g} s while all hangs at rest"
        found.append(PlannedExperiment("rest", what, still, noise))
    return found


def along_other_motion(
    proposal: ProposedExperiment, hypotheses: Sequence[Hypothesis], motion: GripperPath, what: str
) -> ProposedExperiment:
    """A proposed experiment with another motion, such as one that an arm can follow, and its expected result."""
    experiment = replace(proposal.experiment.along_motion(motion), what=what)
    return replace(proposal, experiment=experiment, expected=expected_outcome(hypotheses, experiment))
