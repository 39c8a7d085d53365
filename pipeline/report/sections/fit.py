"""A run against the model: measured and predicted, and what is left, with the stretches where it fails."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from armdyn.identify.fit import Fit
from armdyn.identify.localise import Place
from armdyn.identify.problem import Block
from armdyn.preparation import of_all_runs, sentence
from armdyn.run import Channel
from pipeline.report.section import Chart, Section
from pipeline.report.sections.over_time import add_band, stacked
from pipeline.report.text import number
from pipeline.report.theme import GREY, MEASURED, MODEL, RECORDED, Phase

MOST_POINTS = 3000
"""Per trace; more makes the page heavy and the picture no clearer."""

FEW_POINTS, LARGE = 400, 5
"""Fewer are drawn larger, in px: small dots far apart are overlooked beside a line."""


@dataclass(frozen=True)
class FitSection(Section):
    """Every channel of every run over time."""

    title: ClassVar[str] = "Measured and predicted"

    fit: Fit
    places: Sequence[Place]

    def sentence(self) -> str:
        """What is shaded."""
        shaded = any(place.against == "time" for place in self.places)
        text = "Shaded: where the residual is far above the noise." if shaded else "No stretch of time stands out."
        problem = self.fit.problem
        return f"{text} {sentence(of_all_runs(map(problem.model.preparations, problem.runs)))}".strip()

    def charts(self) -> Sequence[Chart]:
        """One figure per channel and run."""
        return [self._chart(block) for block in self.fit.blocks]

    def _chart(self, block: Block) -> Chart:
        model = self.fit.problem.model
        run = next(run for run in self.fit.problem.runs if run.name == block.run)
        channel = run.channels[block.channel]
        done = model.preparations(run).get(block.channel)
        measured = np.interp(block.time, channel.time, channel.value)
        every = slice(None, None, max(1, len(block.time) // MOST_POINTS))
        phases = [
            Phase("", place.start, place.end)
            for place in self.places
            if place.against == "time" and place.run == block.run and place.channel == block.channel
        ]
        title = f"{block.channel} [{channel.unit}]"
        figure = stacked([title, f"residual [{channel.unit}]"], [0.6, 0.4], phases, 400)
        shown = channel if done is None else model.recording(run).channels[block.channel]
        figure.update_layout(xaxis_range=[float(shown.time[0]), float(shown.time[-1])])
        time = block.time[every]
        if done is not None:
            figure.add_scatter(**_thinned(shown), name="as recorded", **RECORDED)
        below = "" if done is None else f", below {done.cutoff:.3g} Hz"
        dots = MEASURED if len(time) > FEW_POINTS else {**MEASURED, "marker": {"color": GREY, "size": LARGE}}
        figure.add_scatter(x=time, y=measured[every], name=f"measured{below}", **dots)
        figure.add_scatter(x=time, y=(measured - block.misfit)[every], name="predicted", **MODEL)
        band = np.full(2, 2 * block.noise)
        ends = block.time[[0, -1]]
        add_band(figure, ends, 0 * band, band, "± 2 std of the noise", axis="y2")
        figure.add_scatter(x=time, y=block.misfit[every], yaxis="y2", showlegend=False, name="residual", **dots)
        rms = float(np.sqrt(np.mean(block.misfit**2)))
        caption = f"{block.run}: residual {number(rms, channel.unit)} rms."
        if done is not None:
            caption += f" {done.samples} samples, {done.rate:.3g} per second, of {done.recorded} recorded."
        return Chart(figure, caption)


def _thinned(channel: Channel) -> dict[str, np.ndarray]:
    """Points of a signal at its full rate; of more than `MOST_POINTS` the extremes of each stretch; they look alike."""
    time, value = channel.time, channel.value
    if len(value) > MOST_POINTS:
        width = 2 * -(-len(value) // MOST_POINTS)
        whole = len(value) // width * width
        stretches = value[:whole].reshape(-1, width)
        extremes = np.sort([stretches.argmin(axis=1), stretches.argmax(axis=1)], axis=0)
        kept = np.append((extremes + width * np.arange(len(stretches))).T.ravel(), len(value) - 1)
        time, value = time[kept], value[kept]
    return {"x": time, "y": value}


@dataclass(frozen=True)
class FormulaSection(FitSection):
    """A formula that is known to be wrong, at the motion and parameters that the right one finds."""

    title: ClassVar[str] = "The wrong formula at the right motion"

    def sentence(self) -> str:
        """Where it fails."""
        ranges = [f"{p.against} {p.start:.3g} to {p.end:.3g} {p.unit}" for p in self.places[:3]]
        return "Nothing is fitted here. It fails most at " + "; ".join(ranges) + "." if ranges else "It does not fail."
