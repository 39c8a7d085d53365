"""Compare quantities of a motion with their limits, and report every violation and the margin to every limit."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from armdyn.errors import TaskFailedError
from pipeline.fields import attributes_as_json
from urdf.robot import Array, read_only_copy

CHECK_SCHEMA = "armdyn.check/1"

RELATIVE_LIMIT_TOLERANCE = 1e-6
"""Relative tolerance by which a value may exceed its limit, because recordings are rounded to seven digits."""
MIN_LIMIT_FOR_TOLERANCE = 1e-3
"""Smallest size of a limit for its tolerance [the limit's unit]: smaller limits have the tolerance of this one."""
MIN_VIOLATION_GAP_SECONDS = 0.05
"""Two violations of one limit count as one if less time lies between them [s]."""


@dataclass(frozen=True)
class LimitedQuantity:
    """A limited quantity of a motion over time, with its lower and upper bounds.

    Attributes:
        limit: name of the quantity, such as ``"velocity"``.
        unit: SI unit of values and bounds.
        names: name of each of the k columns: a joint or a pair of bodies.
        time: times, (n,) [s].
        value: values, (n, k).
        lower: lower bounds, (n, k); -inf for none.
        upper: upper bounds, (n, k); inf for none.
    """

    limit: str
    unit: str
    names: tuple[str, ...]
    time: Array
    value: Array
    lower: Array
    upper: Array

    @classmethod
    def from_values(
        cls,
        limit: str,
        unit: str,
        names: tuple[str, ...],
        time: ArrayLike,
        value: ArrayLike,
        lower: ArrayLike = -np.inf,
        upper: ArrayLike = np.inf,
    ) -> LimitedQuantity:
        """Make a limited quantity from values and bounds of any shapes that numpy can broadcast to (n, k).

        Args:
            limit: name of the quantity, such as ``"velocity"``.
            unit: SI unit of values and bounds.
            names: name of each of the k columns.
            time: times, (n,) [s].
            value: values, (n, k), or (n,) for one column.
            lower: lower bounds; by default none.
            upper: upper bounds; by default none.
        """
        values = np.array(value, dtype=float).reshape(-1, len(names))
        bounds = [np.broadcast_to(np.asarray(bound, dtype=float), values.shape) for bound in (lower, upper)]
        return cls(limit, unit, names, *map(read_only_copy, (np.array(time, dtype=float), values, *bounds)))

    @property
    def is_two_sided(self) -> bool:
        """Whether every value is bounded from below and above."""
        return bool(np.all(np.isfinite(self.lower)) and np.all(np.isfinite(self.upper)))

    @property
    def margin(self) -> Array:
        """Distance of each value from the nearer bound, negative beyond it, (n, k)."""
        return np.minimum(self.value - self.lower, self.upper - self.value)

    @cached_property
    def used_share(self) -> Array:
        """Used share of the limit, (n, k): 1 at a bound, more beyond it.

        With two bounds, 0 is at their middle. With a lower bound only, such as for a distance, it is the bound divided
        by the value.
        """
        value, lower, upper = self.value, self.lower, self.upper
        with np.errstate(divide="ignore", invalid="ignore"):
            middle, half = (lower + upper) / 2.0, (upper - lower) / 2.0
            above, below = np.isfinite(upper), np.isfinite(lower)
            return np.select(
                [above & below & (half > 0.0), above & below, above & (upper > 0.0), above,
                 below & (value > np.maximum(lower, 0.0)), below],
                [np.abs(value - middle) / half, value != middle, value / upper, value > upper,
                 lower / value, 1.0 + np.maximum(lower - value, 0.0)],
                0.0,
            )  # fmt: skip

    def margin_at(self, i: int, k: int) -> LimitMargin:
        """Margin of the value in sample `i` and column `k`."""
        lower, upper, value = (float(array[i, k]) for array in (self.lower, self.upper, self.value))
        bound = lower if value - lower < upper - value else upper
        margin, used = float(min(value - lower, upper - value)), float(self.used_share[i, k])
        return LimitMargin(self.limit, self.names[k], float(self.time[i]), value, bound, self.unit, margin, used)

    def margins(self) -> list[LimitMargin]:
        """For each column with bounds, the margin of the value that comes closest to a bound."""
        margin = self.margin
        bounded = np.flatnonzero(np.isfinite(margin).any(axis=0))
        return [self.margin_at(int(np.argmin(margin[:, k])), int(k)) for k in bounded]

    def violations(self) -> list[LimitMargin]:
        """The worst value of each time interval in which a bound is exceeded.

        Intervals that are less than `MIN_VIOLATION_GAP_SECONDS` apart count as one.
        """
        scale = np.max([np.where(np.isfinite(b), np.abs(b), 0.0) for b in (self.lower, self.upper)], axis=0)
        margin = self.margin
        beyond = margin < -RELATIVE_LIMIT_TOLERANCE * np.maximum(scale, MIN_LIMIT_FOR_TOLERANCE)
        found = []
        for k, column in enumerate(beyond.T):
            samples = np.flatnonzero(column)
            stretches = np.split(samples, np.flatnonzero(np.diff(self.time[samples]) > MIN_VIOLATION_GAP_SECONDS) + 1)
            found += [
                self.margin_at(int(stretch[np.argmin(margin[stretch, k])]), k) for stretch in stretches if len(stretch)
            ]
        return found


@dataclass(frozen=True)
class LimitMargin:
    """The value of a motion that comes closest to a limit, or is furthest beyond it.

    Attributes:
        limit: name of the limited quantity, such as ``"velocity"``.
        joint: name of the joint or of the pair of bodies.
        time: time of the value [s].
        value: the value, in `unit`.
        bound: the limit, in `unit`.
        unit: SI unit; ``"1"`` for a number without unit.
        margin: distance of the value from the limit, negative beyond it, in `unit`.
        used_share: used share of the limit: 1 at the limit, more beyond it.
    """

    limit: str
    joint: str
    time: float
    value: float
    bound: float
    unit: str
    margin: float
    used_share: float

    def __str__(self) -> str:
        """Value, limit and time, as a part of a sentence."""
        unit = self._unit
        if self.bound > 0.0 and abs(self.value - self.bound - self.margin) < abs(self.bound - self.value - self.margin):
            return f"{self.value:.4g}{unit}, at least {self.bound:.4g}{unit}, at {self.time:.3f} s"
        return f"{self.value:.4g} of {self.bound:.4g}{unit} at {self.time:.3f} s"

    @property
    def violation_text(self) -> str:
        """Text about a violated limit, with the names of the limit and the joint, as a part of a sentence."""
        value = f"{self.value:.4g}{self._unit} (limit {self.bound:.4g}{self._unit})"
        return f"{self.limit.replace('_', ' ')} of {self.joint} is {value} at {self.time:.3f} s"

    @property
    def _unit(self) -> str:
        return "" if self.unit == "1" else f" {self.unit}"


@dataclass(frozen=True)
class TrackingError:
    """How far a joint is from a trajectory that its servo follows.

    Attributes:
        joint: name of the joint.
        unit: rad or m.
        largest: largest distance, in `unit`.
        rms: root mean square of the distance, in `unit`.
        saturated: share of the time in which the servo is at its limit.
    """

    joint: str
    unit: str
    largest: float
    rms: float
    saturated: float


@dataclass(frozen=True)
class FeasibilityReport:
    """Result of checking whether a motion is feasible.

    Attributes:
        violations: violated limits, one entry per time interval, the earliest first.
        margins: margin to every limit that was checked.
        series: the limited quantities over time with their bounds, for charts.
        tracking: how far joints are from the motion that their servos follow; empty without a model of servos.
        notes: sentences on what was assumed.
    """

    violations: tuple[LimitMargin, ...]
    margins: tuple[LimitMargin, ...]
    series: tuple[LimitedQuantity, ...]
    tracking: tuple[TrackingError, ...] = ()
    notes: tuple[str, ...] = ()

    def __repr__(self) -> str:
        return f"FeasibilityReport: {self.sentence}"

    @classmethod
    def from_quantities(cls, series: Iterable[LimitedQuantity]) -> FeasibilityReport:
        """Make a report from the limited quantities of a motion."""
        series = tuple(series)
        violations = sorted((v for b in series for v in b.violations()), key=lambda v: v.time)
        return cls(tuple(violations), tuple(m for b in series for m in b.margins()), series)

    @property
    def feasible(self) -> bool:
        """Whether no limit is violated."""
        return not self.violations

    @property
    def tightest(self) -> LimitMargin:
        """The limit with the largest used share; the ends of the line count only if they are exceeded."""
        return max(
            self.margins, key=lambda margin: (margin.used_share > 1.0 or margin.limit != "line", margin.used_share)
        )

    @property
    def sentence(self) -> str:
        """The result as a sentence: the tightest limit of a feasible motion, or the first violation."""
        if self.feasible:
            m = self.tightest
            shapeless = any(note.startswith("mesh ") for note in self.notes)
            unchecked = " Links whose meshes are missing were not checked for collisions." if shapeless else ""
            return f"Feasible: the tightest limit is the {m.limit.replace('_', ' ')} of {m.joint}, {m}.{unchecked}"
        more = f", and {len(self.violations) - 1} more" if len(self.violations) > 1 else ""
        return f"Not feasible: the {self.violations[0].violation_text}{more}."

    def require_feasible(self, motion: str) -> None:
        """Check that the motion is feasible; `motion` is its name for the message, such as ``"swing"``.

        Raises:
            TaskFailedError: the motion is not feasible; the message has the first violation.
        """
        if not self.feasible:
            raise TaskFailedError(f"{motion}: {self.sentence[0].lower()}{self.sentence[1:]}")

    def to_json(self) -> dict[str, Any]:
        """JSON output of the command `check`, ``armdyn.check/1``."""
        margins: dict[str, dict[str, float]] = {}
        for margin in self.margins:
            margins.setdefault(margin.limit, {})[margin.joint] = margin.margin
        return {
            "schema": CHECK_SCHEMA,
            "feasible": self.feasible,
            "sentence": self.sentence,
            "violations": [
                attributes_as_json(violation, "limit joint time value bound unit") for violation in self.violations
            ],
            "margins": margins,
            **(
                {"tracking": [attributes_as_json(one, "joint unit largest rms saturated") for one in self.tracking]}
                if self.tracking
                else {}
            ),
            **({"notes": list(self.notes)} if self.notes else {}),
        }
