"""How close the trial came to each limit."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from pipeline.report.section import Section, Table
from pipeline.report.text import number, percent
from pipeline.report.trial_data import Margin


@dataclass(frozen=True)
class MarginSection(Section):
    """All limits, the tightest first."""

    title: ClassVar[str] = "Limits"

    margins: Sequence[Margin]

    def sentence(self) -> str:
        """Whether every limit was kept."""
        broken = [margin for margin in self.margins if margin.used > 1.0]
        if broken:
            worst = max(broken, key=lambda margin: margin.used)
            return (
                f"Limits broken: {len(broken)} of {len(self.margins)}; worst the {worst.limit} of {worst.where}, "
                f"{number(worst.value, worst.unit)} against {number(worst.bound, worst.unit)} at {worst.time:.2f} s."
            )
        tightest = max(self.margins, key=lambda margin: margin.used)
        return (
            f"All {len(self.margins)} limits were kept; the tightest is the {tightest.limit} of {tightest.where}, "
            f"of which {percent(tightest.used)} was used."
        )

    def tables(self) -> Sequence[Table]:
        """A row per limit."""
        ordered = sorted(self.margins, key=lambda margin: -margin.used)
        rows = [
            [m.limit, m.where, f"{m.value:.3g}", f"{m.bound:.3g}", m.unit, f"{m.time:.2f}", percent(m.used)]
            for m in ordered
        ]
        header = ["limit", "of", "closest", "bound", "unit", "at [s]", "used"]
        return [Table(header, rows, shares=[margin.used for margin in ordered])]
