"""The report of a plan, what each experiment promises; and of an investigation, what was expected and what came."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import plotly.graph_objects as go

from armdyn.document import Chart, Document, KeyFigure, Level, NextStep, Section, Table
from armdyn.experiments.hypothesis import Motion, PredictedExperiment
from armdyn.experiments.plan import HOPELESS, Plan, Proposal
from armdyn.experiments.separation import Rival
from pipeline.report.theme import ACTUAL, GREY, ORANGE, TIME_AXIS, stacked

if TYPE_CHECKING:
    from pipeline.trial.investigation import Investigation, Stage


def designed_motion_section(plan: Plan, proposal: Proposal, motion: Motion) -> Section:
    """The designed motion: gripper, angle, and the differences that a refit of the rivals leaves along it."""
    sentence = ""
    if proposal.random is not None:
        rise, random = proposal.outlook.separation**2, proposal.random
        sentence = (
            f"Chi² rises by at least {rise:.0f} when the wrong effect is refitted to what the right one predicts; "
            f"along the median of the random motions with the same limits that the design began with, by {random:.2g}."
        )
    hypotheses = plan.rivals.hypotheses
    figure = stacked({"gripper [m]": 0.3, "swing [rad]": 0.3, "left by a refit [σ]": 0.4}, 560)
    figure.add_scatter(x=motion.time, y=motion.along[0], name="gripper", **ACTUAL)
    helds = [PredictedExperiment(h, proposal.experiment) for h in hypotheses]
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
    return Section("The designed motion", sentence, [Chart(figure, caption)])


def _add_left(
    figure: go.Figure, truth: PredictedExperiment, rival: PredictedExperiment, readings: np.ndarray, colour: str
) -> None:
    _, best = Rival(rival, truth.predict(truth.start)[0]).refitted()
    left = readings - rival.predict(best)[0][: len(readings)]
    time = np.linspace(0.0, 1.0, len(left)) * (truth.experiment.motion.seconds if truth.experiment.motion else 1.0)
    figure.add_scatter(
        x=time, y=left, yaxis="y3", name=f"less {rival.hypothesis.name}", mode="lines", line={"color": colour}
    )


def next_document(plan: Plan | None, sentence: str, output: Path | None) -> Document:
    """What `armdyn next` found.

    Args:
        plan: None where nothing is left to be told apart.
        sentence: for a person.
        output: the file with a motion that Baxter can make; None where there is none.
    """
    hopeful = plan is None or any(p.outlook.probability > HOPELESS for p in plan.proposals)
    steps = []
    if output is not None:
        steps = [
            NextStep("check it", f"armdyn check {output}"),
            NextStep("make it", f"armdyn trial --motion {output}"),
        ]
    return replace(
        Document("", "") if plan is None else plan.document(),
        title="The next experiment",
        verdict=sentence,
        level=Level.GOOD if hopeful else Level.CAUTION,
        next_steps=steps,
    )


def next_report(document: Document, plan: Plan | None) -> Document:
    """The same with figures of the designed motion."""
    figures: list[KeyFigure] = []
    sections = [*document.sections]
    if plan is not None:
        if plan.proposals:
            best = plan.proposals[0]
            figures.append(KeyFigure("Best experiment", best.experiment.kind, best.experiment.what))
            figures.append(KeyFigure("Right verdict", f"{best.outlook.probability:.0%}", "expected after it"))
        moving = plan.motion
        if moving is not None and moving.experiment.motion is not None:
            motion = moving.experiment.motion
            sections.append(designed_motion_section(plan, moving, motion))
            x, v, a = motion.peaks
            figures.append(KeyFigure("Motion", f"{motion.seconds:g} s", f"peaks {x:.2f} m, {v:.2f} m/s, {a:.1f} m/s²"))
            figures.append(KeyFigure("Effort", f"{motion.effort:.1f} m²/s³", "integral of the squared acceleration"))
    return replace(document, sections=sections, key_figures=figures)


def investigation_section(found: "Investigation") -> Section:
    """The experiments before the swing: belief over the effects, the gripper, what was expected and what it brought."""
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
    header = ["experiment", "expected", "what came", "left over the noise", "may be missing now"]
    caption = (
        "Expected: standard deviations between the rivals that are hardest to tell apart, and probability of a "
        "right verdict. What came: by how much χ² of the second best effect is larger than that of the best."
    )
    table = Table.of(header, [_row(i, stage) for i, stage in enumerate(stages, start=1)], caption)
    sentence = f"{found.sentence[:1].upper()}{found.sentence[1:]}."
    return Section("What the model lacked", sentence, charts, [table])


def _row(number: int, stage: "Stage") -> list[str]:
    expected = "the length"
    if stage.proposal is not None:
        outlook, motion = stage.proposal.outlook, stage.proposal.experiment.motion
        expected = f"{outlook.separation:.1f} std, {outlook.probability:.0%}"
        if motion is not None:
            expected += f", effort {motion.effort:.1f} m²/s³"
    came = "–" if stage.gap is None else f"{stage.gap:.1f}"
    return [str(number), expected, came, f"{stage.residual:.2f}", ", ".join(stage.candidates) or "nothing"]
