"""The plan: every kind of experiment that a laboratory can do, with what it promises, best first."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from armdyn.experiments.design import Designed, Say, designed
from armdyn.experiments.hypothesis import Experiment, Hypothesis
from armdyn.experiments.inseparable import Inseparable, inseparable
from armdyn.experiments.motion import Limits, Motion
from armdyn.experiments.rivals import Rivals, last_motion
from armdyn.experiments.separation import Outlook, beliefs, outlook

ANGLE_NOISE = 5e-3
"""rad; of an angle sensor that could be added, an encoder or a camera."""
WEIGHED = 5e-3
"""Share to which a load is weighed."""
MEASURED = 1e-3
"""m to which a string is measured with a ruler."""
OTHER_MASS = 2.0
"""The other load over this one: the same shape, filled."""
OTHER_LENGTH = 0.7
"""The other string over this one."""
REST = 60.0
"""s at rest."""
REST_STEP = 0.02
"""s between the nodes of a simulation at rest."""
HOPELESS = 0.05
"""Probability of a right verdict up to which an experiment is not worth doing."""
OF_THE_ROOM = ("wind",)
"""Effects whose direction belongs to the room: when the robot is turned round, they change sign along its line."""


@dataclass(frozen=True, eq=False)
class Proposal:
    """An experiment with what it promises.

    Attributes:
        experiment: what to do.
        outlook: what is expected of it.
        designed: how its motion was found; None for the other kinds.
    """

    experiment: Experiment
    outlook: Outlook
    designed: Designed | None = None

    @property
    def rank(self) -> tuple[float, bool, float]:
        """Smaller is better: the probability of a right verdict to a hundredth, no work by hand, the separation."""
        return -round(self.outlook.probability, 2), self.experiment.kind != "motion", -self.outlook.separation


@dataclass(frozen=True, eq=False)
class Plan:
    """What to do next.

    Attributes:
        rivals: what is to be told apart.
        proposals: best first.
        inseparable: pairs that no motion of the gripper tells apart, with the reason.
    """

    rivals: Rivals
    proposals: tuple[Proposal, ...]
    inseparable: tuple[Inseparable, ...]

    @property
    def sentence(self) -> str:
        """What is to be told apart, and by what, for a person."""
        names = [h.name for h in self.rivals.hypotheses]
        said = f"To tell {' from '.join(names) if len(names) == 2 else ', '.join(names) + ' apart'}"
        best = next((p for p in self.proposals if p.outlook.probability > HOPELESS), None)
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
        """Probability of each rival from the runs so far."""
        return [float(b) for b in beliefs(self.rivals.hypotheses)]

    @property
    def motion(self) -> Proposal | None:
        """The designed motion; None where none is offered."""
        return next((p for p in self.proposals if p.experiment.kind == "motion"), None)


def plan(
    rivals: Rivals, seconds: float = 8.0, limits: Limits | None = None, seed: int = 0, say: Say | None = None
) -> Plan:
    """Design a motion and hold every other kind of experiment against it.

    Args:
        rivals: what is to be told apart.
        seconds: duration of the motion.
        limits: of gripper and swing.
        seed: of everything random.
        say: told how far it is.
    """
    tell = say or (lambda _: None)
    moving = designed_motion(rivals, seconds, limits, seed, tell)
    pairs = inseparable(rivals.hypotheses, moving.outlook, moving.experiment)
    proposals = [moving]
    for experiment in other_kinds(rivals, seconds):
        tell(f"weighing up: {experiment.kind}")
        proposals.append(Proposal(experiment, outlook(rivals.hypotheses, experiment, seed)))
    return Plan(rivals, tuple(sorted(proposals, key=lambda p: p.rank)), pairs)


def designed_motion(
    rivals: Rivals, seconds: float, limits: Limits | None = None, seed: int = 0, say: Say | None = None
) -> Proposal:
    """The motion that tells the rivals apart best; pairs that no motion separates do not count in it."""
    experiment = Experiment("motion", "swing along the designed motion", noise=rivals.noise)
    best = designed(rivals.hypotheses, experiment, seconds, limits, seed, say)
    experiment = experiment.along(best.motion)
    return Proposal(experiment, outlook(rivals.hypotheses, experiment, seed), best)


def other_kinds(rivals: Rivals, seconds: float) -> list[Experiment]:
    """Everything else that could be done, along the last run's motion, and not what was done already."""
    last, best = rivals.last, rivals.hypotheses[0].model
    again, noise = last_motion(last, seconds), rivals.noise
    mass, length = best.value("mass"), best.value("length")
    other_mass, other_length = OTHER_MASS * mass, OTHER_LENGTH * length
    found = [
        Experiment(
            "mass",
            f"the last motion again, with a load of the same shape that weighs {1e3 * other_mass:.0f} g "
            f"+/- {1e3 * WEIGHED * other_mass:.1f} g",
            again, noise, changed={"mass": (other_mass, WEIGHED * other_mass)},
        ),
        Experiment(
            "length",
            f"the last motion again, on a string of {other_length:.3f} m +/- {1e3 * MEASURED:g} mm",
            again, noise, changed={"length": (other_length, MEASURED)},
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
    weighing = f'weigh the load and state it: mass = "... g +/- {1e3 * WEIGHED * mass:.1f} g"'
    measuring = f'measure the string and state it: length = "... m +/- {1e3 * MEASURED:g} mm"'
    for kind, name, std, what in (
        ("weigh", "mass", WEIGHED * mass, weighing),
        ("measure", "length", MEASURED, measuring),
    ):
        known = last.known.get(name)
        if known is None or (known.std or 0.0) > 2.0 * std:
            found.append(Experiment(kind, what, measured={name: std}))
    turned = tuple(n for h in rivals.hypotheses for n, p in h.model.parameters.items() if p.effect in OF_THE_ROOM)
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
        time = REST_STEP * np.arange(round(REST / REST_STEP) + 1)
        still = Motion(time, np.zeros((3, len(time))))
        found.append(Experiment("rest", f"record the load cell for {REST:g} s while all hangs at rest", still, noise))
    return found


def with_motion(proposal: Proposal, hypotheses: Sequence[Hypothesis], motion: Motion, what: str) -> Proposal:
    """The proposal along another motion, such as the one that an arm can follow, and what that promises."""
    experiment = replace(proposal.experiment.along(motion), what=what)
    return replace(proposal, experiment=experiment, outlook=outlook(hypotheses, experiment))
