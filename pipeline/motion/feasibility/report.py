"""What a feasibility check says: every violation, and the margin to every limit."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from armdyn.errors import TaskFailedError
from pipeline.motion.feasibility.bounded import Bounded

SCHEMA = "armdyn.check/1"


def in_words(unit: str) -> str:
    """A unit as it stands behind a number: nothing for a pure number."""
    return "" if unit == "1" else f" {unit}"


@dataclass(frozen=True)
class Violation:
    """One limit that is broken, where it is broken most.

    Attributes:
        limit: what is limited, such as ``"velocity"``.
        joint: which joint or part.
        time: when it is broken most, within one stretch of time in which it is broken [s].
        value: the value then, in `unit`.
        bound: the limit then, in `unit`.
        unit: SI unit.
    """

    limit: str
    joint: str
    time: float
    value: float
    bound: float
    unit: str

    def __str__(self) -> str:
        unit = in_words(self.unit)
        value = f"{self.value:.4g}{unit} (limit {self.bound:.4g}{unit})"
        return f"{self.limit.replace('_', ' ')} of {self.joint} is {value} at {self.time:.3f} s"


@dataclass(frozen=True)
class Margin:
    """The closest that a motion comes to one limit.

    Attributes:
        limit: what is limited.
        joint: which joint or part.
        time: when it comes closest [s].
        value: the value then, in `unit`.
        bound: the limit then, in `unit`.
        unit: SI unit.
        margin: distance from the limit, negative beyond it, in `unit`.
        used: share of the limit that is used: 1 at the limit, more beyond it [1].
    """

    limit: str
    joint: str
    time: float
    value: float
    bound: float
    unit: str
    margin: float
    used: float


@dataclass(frozen=True)
class FeasibilityReport:
    """Whether a motion is feasible.

    Attributes:
        violations: every limit that is broken, once per stretch of time, the earliest first.
        margins: to every limit that was looked at.
        series: the values over time against their bounds, for plots.
    """

    violations: tuple[Violation, ...]
    margins: tuple[Margin, ...]
    series: tuple[Bounded, ...]

    @classmethod
    def of(cls, series: Iterable[Bounded]) -> FeasibilityReport:
        """Judge values against their bounds.

        Args:
            series: what was looked at.
        """
        series = tuple(series)
        violations = [
            Violation(b.limit, b.names[k], float(b.time[i]), float(b.value[i, k]), b.bound(i, k), b.unit)
            for b in series
            for i, k in b.violations()
        ]
        margins = [
            Margin(
                b.limit,
                b.names[k],
                float(b.time[i]),
                float(b.value[i, k]),
                b.bound(i, k),
                b.unit,
                float(b.margin[i, k]),
                b.used(i, k),
            )
            for b in series
            for i, k in b.closest()
        ]
        return cls(tuple(sorted(violations, key=lambda v: v.time)), tuple(margins), series)

    @property
    def feasible(self) -> bool:
        """Whether no limit is broken."""
        return not self.violations

    @property
    def tightest(self) -> Margin:
        """The limit of which most is used; to stand at an end of the line uses nothing up."""
        return max(self.margins, key=lambda margin: (margin.used > 1.0 or margin.limit != "line", margin.used))

    @property
    def sentence(self) -> str:
        """The answer for a person, in one line."""
        if self.feasible:
            m = self.tightest
            return (
                f"Feasible: the tightest limit is the {m.limit.replace('_', ' ')} of {m.joint}, "
                f"{m.value:.4g} of {m.bound:.4g}{in_words(m.unit)} at {m.time:.3f} s."
            )
        more = f", and {len(self.violations) - 1} more" if len(self.violations) > 1 else ""
        return f"Not feasible: the {self.violations[0]}{more}."

    def require_feasible(self, motion: str) -> None:
        """Refuse an infeasible motion.

        Args:
            motion: what it is, such as ``"swing"``.

        Raises:
            TaskFailedError: with the first violation.
        """
        if not self.feasible:
            raise TaskFailedError(f"{motion}: {self.sentence[0].lower()}{self.sentence[1:]}")

    def to_json(self) -> dict[str, Any]:
        """As in the contract, section 4; margins are distances from the limit in its unit."""
        margins: dict[str, dict[str, float]] = {}
        for margin in self.margins:
            margins.setdefault(margin.limit, {})[margin.joint] = margin.margin
        return {
            "schema": SCHEMA,
            "feasible": self.feasible,
            "sentence": self.sentence,
            "violations": [vars(violation) for violation in self.violations],
            "margins": margins,
        }
