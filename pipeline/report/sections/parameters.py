"""The parameters of a fitted model."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from armdyn.identify.compare import Comparison
from pipeline.report.section import Section, Table


@dataclass(frozen=True)
class ParameterSection(Section):
    """Values with their intervals, or the statement that those do not hold."""

    title: ClassVar[str] = "Parameters"

    comparison: Comparison

    def sentence(self) -> str:
        """Whether the intervals can be trusted."""
        text = (
            "The residual is white: the intervals hold."
            if self.comparison.intervals_hold
            else "The residual is more than white noise: the standard deviations are too small to be intervals."
        )
        if self.comparison.at_bound:
            text += f" On a physical bound, and pulled beyond it: {', '.join(self.comparison.at_bound)}."
        if self.comparison.undetermined:
            text += f" Not determined by these runs: {', '.join(self.comparison.undetermined)}."
        return " ".join([text, *(f"{left_out}." for left_out in self.comparison.left_out)])

    def tables(self) -> Sequence[Table]:
        """Parameters, then channels."""
        c = self.comparison
        parameters = [
            [name, f"{p.value:.6g}", f"{p.std:.2g}" if p.std is not None else "not fitted", p.unit]
            for name, p in c.parameters.items()
        ]
        channels = [
            [
                name,
                f"{q.noise_std:.3g}",
                f"{q.rmse:.4g}",
                f"{q.held_out_rmse:.4g}" if q.held_out_rmse is not None else "–",
                f"{q.chi2_per_sample:.4g}",
                q.unit,
            ]
            for name, q in c.channels.items()
        ]
        return [
            Table(["parameter", "value", "std", "unit"], parameters),
            Table(["channel", "noise", "rms error", "held out", "χ² per sample", "unit"], channels),
        ]
