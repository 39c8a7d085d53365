"""The load cell against the model."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from pipeline.report.section import Chart, Section
from pipeline.report.sections.over_time import add_band, stacked
from pipeline.report.text import number
from pipeline.report.theme import MEASURED, MODEL, Phase
from pipeline.report.trial_data import ForceTrace


@dataclass(frozen=True)
class ForceSection(Section):
    """Force measured and predicted, and what is left between them."""

    title: ClassVar[str] = "Load cell"

    force: ForceTrace
    phases: Sequence[Phase] = ()

    def sentence(self) -> str:
        """The residual against the noise, and whether it is white."""
        residual = self.force.measured - self.force.predicted
        if not np.isfinite(residual).any():
            return "The model was not run against the load cell."
        rms = float(np.sqrt(np.nanmean(residual**2)))
        text = f"With the final estimate the model misses the measured tension by {number(rms, 'N')} rms"
        if self.force.noise is not None:
            text += f", {rms / self.force.noise:.2f} times the sensor's noise of {number(self.force.noise, 'N')}"
        whiteness = {
            None: "",
            True: "; what is left is white",
            False: "; what is left is not white: something is missing",
        }
        return text + whiteness[self.force.residual_is_white] + "."

    def charts(self) -> Sequence[Chart]:
        """Force over residual."""
        force, residual = self.force, 1e3 * (self.force.measured - self.force.predicted)
        figure = stacked(["tension [N]", "residual [mN]"], [0.62, 0.38], self.phases, 440)
        figure.add_scatter(x=force.time, y=force.measured, name="measured", **MEASURED)
        figure.add_scatter(x=force.time, y=force.predicted, name="predicted", **MODEL)
        caption = "Residual: measured minus predicted."
        if force.noise is not None:
            band = np.full(force.time.shape, 2e3 * force.noise)
            add_band(figure, force.time, 0 * band, band, "± 2 std of the noise", axis="y2")
            caption += " A right model leaves 95 % of the points in the band."
        figure.add_scatter(x=force.time, y=residual, yaxis="y2", name="residual", showlegend=False, **MEASURED)
        return [Chart(figure, caption)]
