"""The residual against what it may depend on: angle, rate, gripper motion, joint position and speed."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import plotly.graph_objects as go

from armdyn.identify.fit import Fit
from pipeline.report.section import Chart, Section
from pipeline.report.theme import LIMIT, MEASURED, MODEL

BINS = 24
MOST_POINTS = 1500
MOST_CHARTS = 12


@dataclass(frozen=True)
class DependenceSection(Section):
    """One figure per channel and circumstance, all runs together, those that matter most first."""

    title: ClassVar[str] = "What the residual depends on"

    fit: Fit

    def sentence(self) -> str:
        """How to read it."""
        return "A line that leaves the band has a cause: a step at zero speed is dry friction, a slope is viscous."

    def charts(self) -> Sequence[Chart]:
        """Residual in units of the noise, and its mean in bins."""
        found = sorted(self._gathered(), key=lambda item: -item[0])[:MOST_CHARTS]
        return [chart for _, chart in found]

    def _gathered(self) -> list[tuple[float, Chart]]:
        problem, points = self.fit.problem, dict[tuple[str, str], list[tuple[np.ndarray, np.ndarray]]]()
        units = {}
        for i, run in enumerate(problem.runs):
            circumstances = problem.model.circumstances(run, problem.theta(i, self.fit.values))
            for block in (b for b in self.fit.blocks if b.run == run.name):
                for name, channel in circumstances.items():
                    if name.startswith(("q.", "v.")) and name[2:] != block.channel.removeprefix("tau."):
                        continue  # a joint's torque is shown against that joint
                    at = np.interp(block.time, channel.time, channel.value)
                    points.setdefault((block.channel, name), []).append((at, block.residual))
                    units[name] = channel.unit
        return [_chart(*key, units[key[1]], parts) for key, parts in points.items()]


def _chart(
    channel: str, against: str, unit: str, parts: Sequence[tuple[np.ndarray, np.ndarray]]
) -> tuple[float, Chart]:
    at, residual = (np.concatenate([part[i] for part in parts]) for i in range(2))
    edges = np.quantile(at, np.linspace(0, 1, BINS + 1))
    place = np.clip(np.searchsorted(edges, at, side="right") - 1, 0, BINS - 1)
    count = np.maximum(np.bincount(place, minlength=BINS), 1)
    mean = np.bincount(place, residual, minlength=BINS) / count
    middle = np.bincount(place, at, minlength=BINS) / count
    every = slice(None, None, max(1, len(at) // MOST_POINTS))
    figure = go.Figure(layout={"height": 280})
    figure.update_xaxes(title_text=f"{against} [{unit}]")
    figure.update_yaxes(title_text=f"{channel} residual / noise")
    figure.add_scatter(x=at[every], y=residual[every], name="samples", opacity=0.4, **MEASURED)
    figure.add_scatter(x=middle, y=mean, name="mean", **MODEL)
    bound = 3 / np.sqrt(count)
    for sign in (-1, 1):
        figure.add_scatter(x=middle, y=sign * bound, name="3 std of the mean", showlegend=sign > 0, **LIMIT)
    return float(np.sum((mean / bound) ** 2)), Chart(figure, f"{channel} against {against}.")
