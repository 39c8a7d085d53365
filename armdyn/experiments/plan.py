"""The plan: every kind of experiment that a laboratory can do, with its expected result, the best first.

Pairs that no motion of the gripper separates are named, with the reason, as far as the equations give one.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from armdyn.document import Column, Curve, Document, Section, Table
from armdyn.experiments.gripper import design_motion
from armdyn.experiments.hypothesis import Experiment, Hypothesis, PredictedExperiment
from armdyn.experiments.limits import GripperLimits
from armdyn.experiments.rivals import Rivals, last_motion
from armdyn.experiments.search import Say
from armdyn.experiments.separation import ExpectedOutcome, Rival, beliefs, outlook
from armdyn.pendulum.path import GripperPath
from armdyn.shown import Displayable
from armdyn.threads import one_thread

INSEPARABLE_RISE = 1.0
"""Rise of chi2 by a motion designed for a pair, below which motion cannot separate the pair: far below any margin."""
SAME_ANGLE_SHARE = 0.02
"""Relative difference up to which two angles are the same."""
MIN_REPORTED_TURN = 1e-3
"""Smallest turn that is reported, rad."""
MIN_REPORTED_CHANGE = 0.02
"""Smallest change of an unknown that is reported, in typical sizes."""


@dataclass(frozen=True)
class Inseparable:
    """A pair of effects that a designed motion does not separate.

    Attributes:
        effects: names of the two effects.
        why: the reason, a sentence.
    """

    effects: tuple[str, str]
    why: str


def inseparable(
    hypotheses: Sequence[Hypothesis], outlook: ExpectedOutcome, experiment: Experiment
) -> tuple[Inseparable, ...]:
    """All pairs that the motion designed for them does not separate in either direction."""
    found = []
    for i, first in enumerate(hypotheses):
        for j in range(i + 1, len(hypotheses)):
            second = hypotheses[j]
            if max(outlook.chi2_increase[i, j], outlook.chi2_increase[j, i]) < INSEPARABLE_RISE:
                found.append(Inseparable((first.name, second.name), _why(first, second, experiment)))
    return tuple(found)


def _why(first: Hypothesis, second: Hypothesis, experiment: Experiment) -> str:
    """Changes of the second hypothesis with which it predicts the same as the first."""
    truth, rival = PredictedExperiment(first, experiment), PredictedExperiment(second, experiment)
    rise, best = Rival(rival, truth.predict(truth.start)[0]).refitted()
    whole = float(np.sqrt(rise / max(len(truth.predict(truth.start)[0]), 1)))
    said = (
        f"along every motion {second.name} with {_changes(first, rival, best)} predicts what {first.name} does "
        f"({whole:.1g} of the noise apart)"
    )
    values = {name: float(value) for name, value in zip(rival.names, best, strict=True)}
    own = second.model.start_names
    hangs = second.model.with_values({n: v for n, v in values.items() if n not in own}).rest_angle()
    if abs(hangs) > MIN_REPORTED_TURN and abs(hangs - first.rest_angle) < SAME_ANGLE_SHARE * abs(hangs):
        said += (
            f": both turn the direction in which the load hangs by {abs(hangs):.3g} rad, and apart from that nothing: "
            "a rotation of the frame"
        )
    return said


def _changes(first: Hypothesis, rival: PredictedExperiment, best: np.ndarray) -> str:
    own = {n: p for n, p in rival.hypothesis.model.parameters.items() if p.effect and n not in first.model.names}
    parts = []
    for i, name in enumerate(rival.names):
        p = rival.hypothesis.model.parameters[name]
        if name in own:
            parts.append(f"{name} = {best[i]:.3g} {p.unit}")
        elif name in first.model.names:
            given = first.model.value(name) if name not in rival.hypothesis.model.start_names else None
            base = first.rest_angle if name == "initial_angle" else 0.0 if given is None else given
            if abs(best[i] - base) > MIN_REPORTED_CHANGE * p.typical:
                parts.append(f"{name} off by {best[i] - base:.3g} {p.unit}")
    return " and ".join(parts) or "the same values"


ANGLE_NOISE = 5e-3
"""Noise of an angle sensor that could be added, an encoder or a camera, rad."""
WEIGHING_ERROR_SHARE = 5e-3
"""Relative accuracy with which a load is weighed."""
RULER_ERROR = 1e-3
"""Accuracy with which a string is measured with a ruler, m."""
OTHER_MASS_RATIO = 2.0
"""Ratio of the other load's mass to the present one: the same shape, filled."""
OTHER_LENGTH_RATIO = 0.7
"""Ratio of the other string's length to the present one."""
REST_SECONDS = 60.0
"""Duration of a recording at rest, s."""
REST_NODE_SECONDS = 0.02
"""Time between the nodes of a simulation at rest, s."""
MIN_RIGHT_PROBABILITY = 0.05
"""Probability of a right verdict up to which an experiment is not worth doing."""
ROOM_FIXED_EFFECTS = ("wind",)
"""Effects whose direction is fixed to the room: when the robot is turned round, they change sign along its line."""


@dataclass(frozen=True, eq=False)
class Proposal:
    """An experiment with its expected result.

    Attributes:
        experiment: the experiment.
        outlook: its expected result.
        random: smallest rise of chi2 for the median of random motions; None where no motion was designed.
    """

    experiment: Experiment
    outlook: ExpectedOutcome
    random: float | None = None

    @property
    def rank(self) -> tuple[float, bool, float]:
        """Sort key, smaller first: the probability of a right verdict to a hundredth, manual work, the separation."""
        return -round(self.outlook.probability, 2), self.experiment.kind != "motion", -self.outlook.separation


@dataclass(frozen=True, eq=False, repr=False)
class Plan(Displayable):
    """Result of planning: which experiment to do next.

    Attributes:
        rivals: the hypotheses to distinguish.
        proposals: experiments, the best first.
        inseparable: pairs that no motion of the gripper separates, with the reason.
    """

    rivals: Rivals
    proposals: tuple[Proposal, ...]
    inseparable: tuple[Inseparable, ...]

    def __str__(self) -> str:
        return self.sentence

    __repr__ = __str__

    def document(self) -> Document:
        """Build the tables: every experiment with its expected result, present beliefs, and the designed motion."""
        chances = [p.outlook.probability for p in self.proposals]
        experiments = [
            Column("experiment", [p.experiment.kind for p in self.proposals]),
            Column("separation [std]", [p.outlook.separation for p in self.proposals], ".1f"),
            Column("right verdict", chances, ".0%", shares=chances),
            Column("what to do", [p.experiment.what for p in self.proposals]),
        ]
        promise = (
            "Separation: root of the rise of chi² when the rival is refitted to what the other predicts, of the two "
            "that are hardest to tell apart. Right verdict: probability that the diagnosis of all runs then names one "
            "effect, and the right one."
        )
        names = [h.name for h in self.rivals.hypotheses]
        believed = [Column("may be true", names), Column("belief so far", self.belief, ".0%", shares=self.belief)]
        tables = [
            Table(experiments, promise, "experiments"),
            Table(believed, "From how well each fits the runs so far."),
        ]
        if self.inseparable:
            pairs = [Column("no motion separates", [" / ".join(p.effects) for p in self.inseparable])]
            tables.append(Table([*pairs, Column("why", [p.why for p in self.inseparable])]))
        moves = self.motion is not None and self.motion.experiment.run is not None
        section = Section("Which experiment", self.sentence, tables=tables)
        return Document("Next experiment", self.sentence, [section], curves=self._curves if moves else None)

    def _curves(self) -> list[Curve]:
        """The designed motion over time, as curves."""
        run = None if self.motion is None else self.motion.experiment.run
        drawn = None if run is None else run.document().curves
        return [] if drawn is None else [curve for curve in drawn() if curve.row.startswith("gripper")]

    @property
    def sentence(self) -> str:
        """Which hypotheses to distinguish, and by which experiment, for a reader."""
        names = [h.name for h in self.rivals.hypotheses]
        said = f"To tell {' from '.join(names) if len(names) == 2 else ', '.join(names) + ' apart'}"
        best = next((p for p in self.proposals if p.outlook.probability > MIN_RIGHT_PROBABILITY), None)
        if best is None:
            return f"{said}: none of these experiments does."
        text = (
            f"{said}: {best.experiment.what} ({best.outlook.separation:.1f} standard deviations, "
            f"a right verdict with {best.outlook.probability:.0%})"
        )
        motion = best.experiment.motion
        if best.experiment.kind == "motion" and motion is not None:
            x, _, a = motion.peaks
            text += (
                f", in {motion.seconds:g} s, at most {x:.2f} m to the side, {a:.1f} m/s², "
                f"effort {motion.effort:.1f} m²/s³"
            )
        return text + "."

    @property
    def belief(self) -> list[float]:
        """Probability of each rival, given the runs so far."""
        return [float(b) for b in beliefs(self.rivals.hypotheses)]

    @property
    def motion(self) -> Proposal | None:
        """The designed motion; None where none is proposed."""
        return next((p for p in self.proposals if p.experiment.kind == "motion"), None)


@one_thread
def plan(
    rivals: Rivals, seconds: float = 8.0, limits: GripperLimits | None = None, seed: int = 0, say: Say = lambda _: None
) -> Plan:
    """Design a motion and compare it with every other kind of experiment.

    Args:
        rivals: the hypotheses to distinguish.
        seconds: duration of the motion, s.
        limits: limits of gripper and swing.
        seed: seed of everything random.
        say: called with a text on the progress.
    """
    moving = designed_motion(rivals, seconds, limits, seed, say)
    pairs = inseparable(rivals.hypotheses, moving.outlook, moving.experiment)
    proposals = [moving]
    for experiment in other_kinds(rivals, seconds):
        if not safe(rivals, experiment, limits.swing if limits is not None else np.inf):
            continue
        say(f"weighing up: {experiment.kind}")
        proposals.append(Proposal(experiment, outlook(rivals.hypotheses, experiment, seed)))
    return Plan(rivals, tuple(sorted(proposals, key=lambda p: p.rank)), pairs)


def safe(rivals: Rivals, experiment: Experiment, swing: float) -> bool:
    """Whether every rival predicts a taut string and a swing within `swing`, rad, for an experiment.

    The last run itself, which was made, may exceed that limit.
    """
    if experiment.motion is None:
        return True
    last = experiment.along(last_motion(rivals.last, experiment.motion.seconds))
    plain = replace(last, changed={})
    for hypothesis in rivals.hypotheses:
        there, before = PredictedExperiment(hypothesis, experiment), PredictedExperiment(hypothesis, plain)
        allowed = max(swing, float(np.abs(before.swing(before.start)).max()))
        if not (np.abs(there.swing(there.start)).max() <= allowed and there.tension(there.start).min() > 0.0):
            return False
    return True


def designed_motion(
    rivals: Rivals, seconds: float, limits: GripperLimits | None = None, seed: int = 0, say: Say = lambda _: None
) -> Proposal:
    """The motion that separates the rivals best; pairs that no motion separates are not counted."""
    experiment = Experiment("motion", "swing along the designed motion", noise=rivals.noise)
    motion, random = design_motion(rivals.hypotheses, experiment, seconds, limits, seed, say)
    experiment = experiment.along(motion)
    return Proposal(experiment, outlook(rivals.hypotheses, experiment, seed), random)


def other_kinds(rivals: Rivals, seconds: float) -> list[Experiment]:
    """All other experiments that could be done, along the last run's motion, except those already done."""
    last, best = rivals.last, rivals.hypotheses[0].model
    again, noise = last_motion(last, seconds), rivals.noise
    mass, length = best.value("mass"), best.value("length")
    other_mass, other_length = OTHER_MASS_RATIO * mass, OTHER_LENGTH_RATIO * length
    found = [
        Experiment(
            "mass",
            f"the last motion again, with a load of the same shape that weighs {1e3 * other_mass:.0f} g "
            f"+/- {1e3 * WEIGHING_ERROR_SHARE * other_mass:.1f} g",
            again, noise, changed={"mass": (other_mass, WEIGHING_ERROR_SHARE * other_mass)},
        ),
        Experiment(
            "length",
            f"the last motion again, on a string of {other_length:.3f} m +/- {1e3 * RULER_ERROR:g} mm",
            again, noise, changed={"length": (other_length, RULER_ERROR)},
        ),
    ]  # fmt: skip
    if "swing_angle" not in noise and "swing_rate" not in noise:
        found.append(
            Experiment(
                "angle_sensor",
                f"the last motion again, with a sensor of the swing angle (noise {1e3 * ANGLE_NOISE:g} mrad)",
                again, {**noise, "swing_angle": ANGLE_NOISE},
            )
        )  # fmt: skip
    weighing = f'weigh the load and state it: mass = "... g +/- {1e3 * WEIGHING_ERROR_SHARE * mass:.1f} g"'
    measuring = f'measure the string and state it: length = "... m +/- {1e3 * RULER_ERROR:g} mm"'
    for kind, name, std, what in (
        ("weigh", "mass", WEIGHING_ERROR_SHARE * mass, weighing),
        ("measure", "length", RULER_ERROR, measuring),
    ):
        known = last.known.get(name)
        if known is None or (known.std or 0.0) > 2.0 * std:
            found.append(Experiment(kind, what, measured={name: std}))
    turned = tuple(
        n for h in rivals.hypotheses for n, p in h.model.parameters.items() if p.effect in ROOM_FIXED_EFFECTS
    )
    if turned:
        found.append(
            Experiment(
                "turn",
                "the last motion again, with the robot turned round by 180 degrees: what belongs to the room changes "
                "sign along the line, what belongs to the robot does not",
                again, noise, turned=tuple(dict.fromkeys(turned)),
            )
        )  # fmt: skip
    if "load_force" in noise:
        still = GripperPath(0.0, REST_NODE_SECONDS, *np.zeros((3, round(REST_SECONDS / REST_NODE_SECONDS) + 1)))
        found.append(
            Experiment("rest", f"record the load cell for {REST_SECONDS:g} s while all hangs at rest", still, noise)
        )
    return found


def with_motion(proposal: Proposal, hypotheses: Sequence[Hypothesis], motion: GripperPath, what: str) -> Proposal:
    """The proposal along another motion, such as one that an arm can follow, with its expected result."""
    experiment = replace(proposal.experiment.along(motion), what=what)
    return replace(proposal, experiment=experiment, outlook=outlook(hypotheses, experiment))
