"""The report of a plan: what each experiment promises, and the designed motion with what the rivals predict for it."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np
import plotly.graph_objects as go

from armdyn.experiments.hypothesis import Held
from armdyn.experiments.plan import HOPELESS, Plan
from armdyn.experiments.separation import Rival
from pipeline.report.page import Chart, KeyFigure, Level, NextStep, Report, Section, Table
from pipeline.report.theme import ACTUAL, GREY, ORANGE, stacked


@dataclass(frozen=True)
class PlanSection(Section):
    """Every experiment, best first."""

    title: ClassVar[str] = "Which experiment"

    plan: Plan

    def sentence(self) -> str:
        """What is to be told apart, and by what."""
        return self.plan.sentence

    def tables(self) -> Sequence[Table]:
        """Promises, beliefs, and pairs that no motion separates."""
        plan = self.plan
        rows = [
            [p.experiment.kind, p.experiment.what, f"{p.outlook.separation:.1f}", f"{p.outlook.probability:.0%}"]
            for p in plan.proposals
        ]
        tables = [
            Table(
                ["kind", "what to do", "separation [std]", "right verdict"], rows,
                "Separation: root of the rise of chi² when the rival is refitted to what the other predicts, of the "
                "two that are hardest to tell apart. Right verdict: probability that the diagnosis of all runs then "
                "names one effect, and the right one.",
                bars={3: [p.outlook.probability for p in plan.proposals]},
            ),
            Table(
                ["may be true", "belief so far"],
                [[h.name, f"{b:.0%}"] for h, b in zip(plan.rivals.hypotheses, plan.belief, strict=True)],
                "From how well each fits the runs so far.",
                bars={1: plan.belief},
            ),
        ]  # fmt: skip
        if plan.inseparable:
            pairs = [[" / ".join(p.effects), p.why] for p in plan.inseparable]
            tables.append(Table(["no motion separates", "why"], pairs))
        return tables


@dataclass(frozen=True)
class DesignedMotionSection(Section):
    """The designed motion, and where the rivals differ along it."""

    title: ClassVar[str] = "The designed motion"

    plan: Plan

    def sentence(self) -> str:
        """How it compares with random motions."""
        proposal = self.plan.motion
        if proposal is None or proposal.designed is None:
            return ""
        rise, random = proposal.outlook.separation**2, proposal.designed.start
        return (
            f"Chi² rises by at least {rise:.0f} when the wrong effect is refitted to what the right one predicts; "
            f"along the median of the random motions with the same limits that the design began with, by {random:.2g}."
        )

    def charts(self) -> Sequence[Chart]:
        """Gripper, angle, and the differences that a refit leaves."""
        proposal = self.plan.motion
        if proposal is None or proposal.experiment.motion is None:
            return ()
        motion, hypotheses = proposal.experiment.motion, self.plan.rivals.hypotheses
        figure = stacked(["gripper [m]", "swing [rad]", "left by a refit [σ]"], [0.3, 0.3, 0.4], (), 560)
        figure.add_scatter(x=motion.time, y=motion.along[0], name="gripper", **ACTUAL)
        helds = [Held(h, proposal.experiment) for h in hypotheses]
        figure.add_scatter(
            x=motion.time, y=helds[0].swing(helds[0].start), name="swing", yaxis="y2", showlegend=False,
            mode="lines", line={"color": GREY},
        )  # fmt: skip
        truth = helds[0]
        readings = truth.predict(truth.start)[0][: len(motion.time)]
        for rival, colour in zip(helds[1:3], (ORANGE, GREY), strict=False):
            _add_left(figure, truth, rival, readings, colour)
        caption = (
            f"Below: what {hypotheses[0].name} predicts less what a rival predicts that was refitted to it, in "
            "standard deviations of one sample of the load cell."
        )
        return [Chart(figure, caption)]


def _add_left(figure: go.Figure, truth: Held, rival: Held, readings: np.ndarray, colour: str) -> None:
    _, best = Rival(rival, truth.predict(truth.start)[0]).refitted()
    left = readings - rival.predict(best)[0][: len(readings)]
    time = np.linspace(0.0, 1.0, len(left)) * (truth.experiment.motion.seconds if truth.experiment.motion else 1.0)
    figure.add_scatter(
        x=time, y=left, yaxis="y3", name=f"less {rival.hypothesis.name}", mode="lines", line={"color": colour}
    )


def next_report(plan: Plan | None, sentence: str, command: str, output: Path | None) -> Report:
    """The report of `armdyn next`.

    Args:
        plan: None where nothing is left to be told apart.
        sentence: for a person.
        command: how to make it again.
        output: the file with the motion; None where there is none.
    """
    figures: list[KeyFigure] = []
    sections: list[Section] = []
    hopeful = plan is None or any(p.outlook.probability > HOPELESS for p in plan.proposals)
    if plan is not None:
        sections.append(PlanSection(plan))
        if plan.proposals:
            best = plan.proposals[0]
            figures.append(KeyFigure("Best experiment", best.experiment.kind, best.experiment.what))
            figures.append(KeyFigure("Right verdict", f"{best.outlook.probability:.0%}", "expected after it"))
        moving = plan.motion
        if moving is not None and moving.experiment.motion is not None:
            sections.append(DesignedMotionSection(plan))
            motion = moving.experiment.motion
            x, v, a = motion.peaks
            figures.append(KeyFigure("Motion", f"{motion.seconds:g} s", f"peaks {x:.2f} m, {v:.2f} m/s, {a:.1f} m/s²"))
            figures.append(KeyFigure("Effort", f"{motion.effort:.1f} m²/s³", "integral of the squared acceleration"))
    steps = []
    if output is not None:
        steps = [
            NextStep("Check the motion on the whole arm:", f"armdyn check {output}"),
            NextStep("Make it:", f"armdyn trial --motion {output}"),
        ]
    return Report(
        title="The next experiment",
        level=Level.GOOD if hopeful else Level.CAUTION,
        verdict=sentence,
        sections=sections,
        key_figures=tuple(figures),
        command=command,
        next_steps=tuple(steps),
    )
