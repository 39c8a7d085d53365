"""Whether the computer kept up."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from pipeline.report.section import Section, Table
from pipeline.report.text import number
from pipeline.report.trial_data import NodeTiming


@dataclass(frozen=True)
class TimingSection(Section):
    """Computing time of every node."""

    title: ClassVar[str] = "Computing time"

    nodes: Sequence[NodeTiming]

    def sentence(self) -> str:
        """Whether a step took longer than its period."""
        late = [node for node in self.nodes if node.overruns]
        if not late:
            return "Every node finished its steps in time."
        names = ", ".join(f"{node.name} {node.overruns} of {node.steps} times" for node in late)
        return f"Some steps took longer than their period: {names}."

    def tables(self) -> Sequence[Table]:
        """A row per node."""
        rows = [
            [
                node.name,
                "once" if node.period is None else f"{1 / node.period:.4g} Hz",
                str(node.steps),
                number(node.mean, "s", 2),
                number(node.longest, "s", 2),
                str(node.overruns),
            ]
            for node in self.nodes
        ]
        return [Table(["node", "rate", "steps", "mean", "longest", "overruns"], rows)]
