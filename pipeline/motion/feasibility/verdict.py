"""Values with their bounds, and the result of a check: every violation, and the margin to every limit."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from armdyn.errors import TaskFailedError
from pipeline.fields import fields
from urdf.robot import Array, read_only_copy

SCHEMA = "armdyn.check/1"

LIMIT_EXCESS_SHARE = 1e-6
"""Share of a limit by which a value may exceed it: a recording with seven digits is rounded."""
MIN_TOLERANCE_BOUND = 1e-3
"""Smallest size of a bound from which the tolerance is computed, in the bound's unit."""
MIN_VIOLATION_GAP_SECONDS = 0.05
"""Time for which a limit must be kept between two violations, to count them as two [s]."""


@dataclass(frozen=True)
class Bounded:
    """One kind of limit: a value per time and joint, and its bounds.

    Attributes:
        limit: what is limited, such as ``"velocity"``.
        unit: SI unit of values and bounds.
        names: of the k columns: joints or parts.
        time: (n,) [s].
        value: (n, k).
        lower: lower bounds (n, k); -inf for none.
        upper: upper bounds (n, k); inf for none.
    """

    limit: str
    unit: str
    names: tuple[str, ...]
    time: Array
    value: Array
    lower: Array
    upper: Array

    @classmethod
    def between(
        cls,
        limit: str,
        unit: str,
        names: tuple[str, ...],
        time: ArrayLike,
        value: ArrayLike,
        lower: ArrayLike = -np.inf,
        upper: ArrayLike = np.inf,
    ) -> Bounded:
        """Values with bounds of any shape that fits; a value per time (n,) is one column."""
        values = np.array(value, dtype=float).reshape(-1, len(names))
        bounds = [np.broadcast_to(np.asarray(bound, dtype=float), values.shape) for bound in (lower, upper)]
        return cls(limit, unit, names, *map(read_only_copy, (np.array(time, dtype=float), values, *bounds)))

    @property
    def is_two_sided(self) -> bool:
        """Whether every value is bounded from below and above."""
        return bool(np.all(np.isfinite(self.lower)) and np.all(np.isfinite(self.upper)))

    @property
    def margin(self) -> Array:
        """Distance from the nearer bound, negative beyond it (n, k)."""
        return np.minimum(self.value - self.lower, self.upper - self.value)

    @cached_property
    def used(self) -> Array:
        """Share of the limit that is used, 1 at the bound, more beyond it (n, k) [1].

        Between two bounds it counts from their middle. Of a lower bound alone, such as a distance, the whole is used
        where the value has come down to it.
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

    def extreme(self, i: int, k: int) -> Margin:
        """What there is to say of sample `i`, column `k`."""
        lower, upper, value = (float(array[i, k]) for array in (self.lower, self.upper, self.value))
        bound = lower if value - lower < upper - value else upper
        margin, used = float(min(value - lower, upper - value)), float(self.used[i, k])
        return Margin(self.limit, self.names[k], float(self.time[i]), value, bound, self.unit, margin, used)

    def margins(self) -> list[Margin]:
        """Where each column comes closest to a bound; columns without bounds are left out."""
        margin = self.margin
        bounded = np.flatnonzero(np.isfinite(margin).any(axis=0))
        return [self.extreme(int(np.argmin(margin[:, k])), int(k)) for k in bounded]

    def violations(self) -> list[Margin]:
        """The worst of each stretch beyond a bound; stretches closer than `MIN_VIOLATION_GAP_SECONDS` are one."""
        scale = np.max([np.where(np.isfinite(b), np.abs(b), 0.0) for b in (self.lower, self.upper)], axis=0)
        margin = self.margin
        beyond = margin < -LIMIT_EXCESS_SHARE * np.maximum(scale, MIN_TOLERANCE_BOUND)
        found = []
        for k, column in enumerate(beyond.T):
            samples = np.flatnonzero(column)
            stretches = np.split(samples, np.flatnonzero(np.diff(self.time[samples]) > MIN_VIOLATION_GAP_SECONDS) + 1)
            found += [
                self.extreme(int(stretch[np.argmin(margin[stretch, k])]), k) for stretch in stretches if len(stretch)
            ]
        return found


@dataclass(frozen=True)
class Margin:
    """Where a motion comes closest to one limit, or is furthest beyond it.

    Value, bound and margin (negative beyond the bound) are in the SI `unit`, ``"1"`` for a pure number; time is in s.
    `used` is the share of the limit that is used: 1 at the limit, more beyond it.
    """

    limit: str
    joint: str
    time: float
    value: float
    bound: float
    unit: str
    margin: float
    used: float

    def __str__(self) -> str:
        """Value and limit; of a distance, which must not be less, what is the least."""
        unit = self._unit
        if self.bound > 0.0 and abs(self.value - self.bound - self.margin) < abs(self.bound - self.value - self.margin):
            return f"{self.value:.4g}{unit}, at least {self.bound:.4g}{unit}, at {self.time:.3f} s"
        return f"{self.value:.4g} of {self.bound:.4g}{unit} at {self.time:.3f} s"

    @property
    def broken(self) -> str:
        """The same of a limit that is broken, with the limit and the joint."""
        value = f"{self.value:.4g}{self._unit} (limit {self.bound:.4g}{self._unit})"
        return f"{self.limit.replace('_', ' ')} of {self.joint} is {value} at {self.time:.3f} s"

    @property
    def _unit(self) -> str:
        return "" if self.unit == "1" else f" {self.unit}"


@dataclass(frozen=True)
class FeasibilityReport:
    """Whether a motion is feasible.

    Attributes:
        violations: every limit that is broken, once per stretch of time, the earliest first.
        margins: to every limit that was looked at.
        series: the values over time against their bounds, for plots.
    """

    violations: tuple[Margin, ...]
    margins: tuple[Margin, ...]
    series: tuple[Bounded, ...]

    def __repr__(self) -> str:
        return f"FeasibilityReport: {self.sentence}"

    @classmethod
    def of(cls, series: Iterable[Bounded]) -> FeasibilityReport:
        """Judge values against their bounds."""
        series = tuple(series)
        violations = sorted((v for b in series for v in b.violations()), key=lambda v: v.time)
        return cls(tuple(violations), tuple(m for b in series for m in b.margins()), series)

    @property
    def feasible(self) -> bool:
        """Whether no limit is broken."""
        return not self.violations

    @property
    def tightest(self) -> Margin:
        """The limit of which most is used; the ends of the line count only where they are exceeded."""
        return max(self.margins, key=lambda margin: (margin.used > 1.0 or margin.limit != "line", margin.used))

    @property
    def sentence(self) -> str:
        """The answer for a person, in one line."""
        if self.feasible:
            m = self.tightest
            return f"Feasible: the tightest limit is the {m.limit.replace('_', ' ')} of {m.joint}, {m}."
        more = f", and {len(self.violations) - 1} more" if len(self.violations) > 1 else ""
        return f"Not feasible: the {self.violations[0].broken}{more}."

    def require_feasible(self, motion: str) -> None:
        """Refuse an infeasible motion, which `motion` names, such as ``"swing"``.

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
            "violations": [fields(violation, "limit joint time value bound unit") for violation in self.violations],
            "margins": margins,
        }
