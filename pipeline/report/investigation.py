"""How the robot found out what its model lacked: experiment by experiment, what was expected and what came."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import plotly.graph_objects as go

from pipeline.report.page import Chart, Section, Table
from pipeline.report.theme import TIME_AXIS

if TYPE_CHECKING:
    from pipeline.trial.investigation import Investigation, Stage


@dataclass(frozen=True)
class InvestigationSection(Section):
    """The experiments before the swing."""

    title: ClassVar[str] = "What the model lacked"

    found: "Investigation"

    def sentence(self) -> str:
        """How it ended."""
        said = self.found.sentence
        return f"{said[:1].upper()}{said[1:]}."

    def charts(self) -> Sequence[Chart]:
        """Belief over the effects, and the gripper in every experiment."""
        stages = self.found.stages
        charts = []
        names = list(dict.fromkeys(name for stage in stages for name in stage.belief))
        if names:
            belief = go.Figure(layout={"height": 300, "barmode": "group", "yaxis": {"title": {"text": "belief"}}})
            labels = [f"experiment {i}" for i in range(1, len(stages) + 1)]
            for name in names:
                belief.add_bar(x=labels, y=[stage.belief.get(name, 0.0) for stage in stages], name=name)
            charts.append(Chart(belief, "Belief in each effect that was in question, after each experiment."))
        moved = go.Figure(
            layout={
                "height": 260, "xaxis": {"title": {"text": TIME_AXIS}}, "yaxis": {"title": {"text": "gripper [m]"}},
            }
        )  # fmt: skip
        for i, stage in enumerate(stages, start=1):
            x = stage.run.channels["gripper_x"]
            moved.add_scatter(
                x=x.time - x.time[0], y=x.value, name=f"experiment {i}", mode="lines",
                line={"dash": "dot" if i == 1 else "solid"},
            )  # fmt: skip
        charts.append(Chart(moved, "Dotted: as SAC chose, to learn the length. The others were designed for rivals."))
        return charts

    def tables(self) -> Sequence[Table]:
        """What was expected of each experiment, and what it brought."""
        rows = [_row(i, stage) for i, stage in enumerate(self.found.stages, start=1)]
        header = ["experiment", "expected", "what came", "left over the noise", "may be missing now"]
        caption = (
            "Expected: standard deviations between the rivals that are hardest to tell apart, and probability of a "
            "right verdict. What came: by how much χ² of the second best effect is larger than that of the best."
        )
        return [Table(header, rows, caption)]


def _row(number: int, stage: "Stage") -> list[str]:
    expected = "the length"
    if stage.proposal is not None:
        outlook, motion = stage.proposal.outlook, stage.proposal.experiment.motion
        expected = f"{outlook.separation:.1f} std, {outlook.probability:.0%}"
        if motion is not None:
            expected += f", effort {motion.effort:.1f} m²/s³"
    came = "–" if stage.gap is None else f"{stage.gap:.1f}"
    return [str(number), expected, came, f"{stage.residual:.2f}", ", ".join(stage.candidates) or "nothing"]
