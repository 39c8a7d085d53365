"""How well the arm followed its reference."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from pipeline.report.section import Chart, Section
from pipeline.report.sections.over_time import stacked
from pipeline.report.text import number
from pipeline.report.theme import ACTUAL, REFERENCE, Phase
from pipeline.report.trial_data import GripperTrace


@dataclass(frozen=True)
class GripperSection(Section):
    """Reference and actual position of the gripper, and the error."""

    title: ClassVar[str] = "Gripper"

    gripper: GripperTrace
    phases: Sequence[Phase] = ()

    def sentence(self) -> str:
        """Mean and largest error along the line."""
        error = self.gripper.actual - self.gripper.reference
        if not np.isfinite(error).any():
            return "The gripper did not move."
        worst = int(np.nanargmax(np.abs(error)))
        rms = float(np.sqrt(np.nanmean(error**2)))
        return (
            f"The gripper follows its reference to {number(rms, 'm', 2)} rms; the largest error is "
            f"{number(abs(error[worst]), 'm', 2)} at {self.gripper.time[worst]:.2f} s."
        )

    def charts(self) -> Sequence[Chart]:
        """Position over error."""
        gripper = self.gripper
        figure = stacked(["along the line [m]", "error [mm]"], [0.62, 0.38], self.phases, 420)
        figure.add_scatter(x=gripper.time, y=gripper.actual, name="actual", **ACTUAL)
        figure.add_scatter(x=gripper.time, y=gripper.reference, name="reference", **REFERENCE)
        error = 1e3 * (gripper.actual - gripper.reference)
        figure.add_scatter(x=gripper.time, y=error, yaxis="y2", name="error", showlegend=False, **ACTUAL)
        return [Chart(figure, "Error: actual minus reference, the lag of the arm included.")]
