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
        text = self.comparison.how_certain
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
        examined = any(q.exam_rmse is not None for q in c.channels.values())
        channels = [
            [
                name,
                f"{q.noise_std:.3g}",
                f"{q.rmse:.4g}",
                *(
                    f"{error:.4g}" if error is not None else "–"
                    for error in ((q.held_out_rmse, q.exam_rmse) if examined else (q.held_out_rmse,))
                ),
                f"{q.chi2_per_sample:.4g}",
                q.unit,
            ]
            for name, q in c.channels.items()
        ]
        errors = ["rms error", "held out", *(["exam"] if examined else [])]
        return [
            Table(["parameter", "value", "std", "unit"], parameters),
            Table(["channel", "noise", *errors, "χ² per sample", "unit"], channels),
        ]
