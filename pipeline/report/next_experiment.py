"""Reports of a plan of experiments (expected results), and of an investigation (expected and actual results)."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import plotly.graph_objects as go

from armdyn.document import Chart, Column, Document, KeyFigure, NextStep, ResultLevel, Section, Table
from armdyn.experiments.hypothesis import PredictedExperiment
from armdyn.experiments.plan import MIN_RIGHT_VERDICT_PROBABILITY, ExperimentPlan, ProposedExperiment
from armdyn.experiments.separation import RivalRefitCost
from armdyn.pendulum.path import GripperPath
from pipeline.report.theme import ACTUAL_STYLE, GREY, ORANGE, TIME_AXIS, stacked_figure

if TYPE_CHECKING:
    from pipeline.trial.investigation import Investigation, InvestigationStage


def designed_motion_section(plan: ExperimentPlan, proposal: ProposedExperiment, motion: GripperPath) -> Section:
    """Section on a motion designed to distinguish rival models: gripper, swing angle, and remaining differences.

    Args:
        plan: planned experiments and rival models.
        proposal: experiment with the designed motion, and its expected result.
        motion: the designed motion of the gripper.
    """
    sentence = ""
    if proposal.random_motion_chi2_increase is not None:
        random = proposal.random_motion_chi2_increase**0.5
        sentence = (
            f"Fitted to what the right effect predicts, the wrong one stays {proposal.expected.separation:.1f} "
            "standard deviations away or more; along the median of the random motions with the same limits, with "
            f"which the design began, {random:.1f}."
        )
    first, *others = [PredictedExperiment(h, proposal.experiment) for h in plan.rivals.hypotheses]
    figure = stacked_figure({"gripper [m]": 0.3, "swing [rad]": 0.3, "remaining after a refit [σ]": 0.4}, 560)
    figure.add_scatter(x=motion.time, y=motion.x, name="gripper", **ACTUAL_STYLE)
    grey = {"mode": "lines", "line": {"color": GREY}}
    figure.add_scatter(x=motion.time, y=first.swing(first.start), name="swing", yaxis="y2", showlegend=False, **grey)
    predicted = first.predict(first.start)[0]
    for rival, colour in zip(others[:2], (ORANGE, GREY), strict=False):
        _, best = RivalRefitCost(rival, predicted).chi2_increase_and_refit()
        left = (predicted - rival.predict(best)[0])[: len(motion.time)]
        time = np.linspace(0.0, motion.duration, len(left))
        line = {"mode": "lines", "line": {"color": colour}}
        figure.add_scatter(x=time, y=left, yaxis="y3", name=f"less {rival.hypothesis.name}", **line)
    caption = (
        f"Below: what {first.hypothesis.name} predicts less what a rival predicts that was refitted to it, in "
        "standard deviations of one sample of the load cell."
    )
    return Section("The designed motion", sentence, [Chart(figure, caption)])


def next_experiment_document(plan: ExperimentPlan | None, sentence: str, output: Path | None) -> Document:
    """Document of `armdyn next`: the planned experiments and what each is expected to distinguish.

    Args:
        plan: None where no effects remain to be distinguished.
        sentence: summary for a person.
        output: file with the designed motion, for a next step; None where no motion was written.
    """
    hopeful = plan is None or any(p.expected.probability > MIN_RIGHT_VERDICT_PROBABILITY for p in plan.proposals)
    steps = [NextStep("check it", f"armdyn check {output}"), NextStep("make it", f"armdyn trial --motion {output}")]
    return replace(
        Document("", "") if plan is None else plan.document(),
        title="The next experiment",
        verdict=sentence,
        level=ResultLevel.GOOD if hopeful else ResultLevel.CAUTION,
        next_steps=steps if output is not None else (),
    )


def next_experiment_report(document: Document, plan: ExperimentPlan | None) -> Document:
    """Report of `armdyn next`: its document, with key figures and a section on the designed motion, if any."""
    figures: list[KeyFigure] = []
    sections = [*document.sections]
    if plan is not None:
        if plan.proposals:
            best = plan.proposals[0]
            figures.append(KeyFigure("Best experiment", best.experiment.kind, best.experiment.what))
            figures.append(KeyFigure("Right verdict", f"{best.expected.probability:.0%}", "expected after it"))
        moving = plan.motion
        if moving is not None and moving.experiment.motion is not None:
            motion = moving.experiment.motion
            sections.append(designed_motion_section(plan, moving, motion))
            x, v, a = motion.peaks
            figures.append(
                KeyFigure("Motion", f"{motion.duration:g} s", f"peaks {x:.2f} m, {v:.2f} m/s, {a:.1f} m/s^2")
            )
            figures.append(KeyFigure("Effort", f"{motion.effort:.1f} m^2/s^3", "integral of the squared acceleration"))
    return replace(document, sections=sections, key_figures=figures)


def investigation_section(found: "Investigation") -> Section:
    """Section on the experiments of an investigation: belief in effects, motions, expected and actual results."""
    stages, charts = found.stages, []
    names = list(dict.fromkeys(name for stage in stages for name in stage.belief))
    if names:
        belief = go.Figure(layout={"height": 300, "barmode": "group", "yaxis": {"title": {"text": "belief"}}})
        labels = [f"experiment {i}" for i in range(1, len(stages) + 1)]
        for name in names:
            belief.add_bar(x=labels, y=[stage.belief.get(name, 0.0) for stage in stages], name=name)
        charts.append(Chart(belief, "Belief in each effect that was in question, after each experiment."))
    moved = go.Figure(
        layout={"height": 260, "xaxis": {"title": {"text": TIME_AXIS}}, "yaxis": {"title": {"text": "gripper [m]"}}}
    )
    for i, stage in enumerate(stages, start=1):
        x = stage.run.channels["gripper_x"]
        moved.add_scatter(
            x=x.time - x.time[0], y=x.value, name=f"experiment {i}", mode="lines",
            line={"dash": "dot" if i == 1 else "solid"},
        )  # fmt: skip
    charts.append(Chart(moved, "Dotted: as SAC chose, to learn the length. The others were designed for rivals."))
    caption = (
        "Expected: standard deviations between the rivals that are hardest to distinguish, and probability of a "
        "right verdict. What came: by how much χ² of the second best effect is larger than that of the best."
    )
    table = Table([
        Column("experiment", [str(i) for i in range(1, len(stages) + 1)]),
        Column("expected", list(map(_expected, stages))),
        Column("what came", [stage.gap for stage in stages], ".1f"),
        Column("left over the noise", [stage.residual for stage in stages], ".2f"),
        Column("may be missing now", [stage.candidates or "nothing" for stage in stages]),
    ], caption)  # fmt: skip
    sentence = f"{found.sentence[:1].upper()}{found.sentence[1:]}."
    return Section("What the model lacked", sentence, charts, [table])


def _expected(stage: "InvestigationStage") -> str:
    if stage.proposal is None:
        return "the length"
    outlook, motion = stage.proposal.expected, stage.proposal.experiment.motion
    effort = "" if motion is None else f", effort {motion.effort:.1f} m^2/s^3"
    return f"{outlook.separation:.1f} std, {outlook.probability:.0%}{effort}"
