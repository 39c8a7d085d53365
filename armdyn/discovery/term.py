"""Candidate terms: formulas for a missing force, with units, which can be written as effects of a model."""

import ast
import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import count

import numpy as np

from armdyn.errors import InputError
from armdyn.parameter import RecordedColumn, Scope
from armdyn.recording.channels import FloatArray
from armdyn.run import Run

MAX_NAME_STEM_LENGTH = 50
"""Largest number of characters of an effect's name before its number."""
ZERO_BY_UNIT = {"degC": -273.15, "degF": -459.67}
"""The absolute zero in units whose zero is elsewhere."""
MAX_RANGE_RATIO_OF_CONSTANT = 1e-6
"""Ratio of a recorded quantity's range to its largest value up to which it is constant, except for rounding."""


@dataclass(frozen=True, eq=False)
class TermVariable:
    """A quantity on which a force may depend.

    Attributes:
        name: name in formulas, such as ``"angle"``.
        source: expression in the code of an effect, such as ``"string.angle"``; empty for a recorded quantity.
        unit: SI unit, or the unit that a user's own base gives it.
        samples: (n,) values in the runs, in any order, from which the range of the quantity follows.
        column: declaration of a recorded quantity; None for a quantity of the equations.
    """

    name: str
    source: str
    unit: str
    samples: FloatArray = field(default_factory=lambda: np.zeros(1))
    column: RecordedColumn | None = None

    @property
    def quantity(self) -> str:
        """Full name of the quantity, such as ``"angle"`` or ``"extra.temperature"``."""
        return self.name if self.column is None else self.column.name

    @property
    def name_in_sentence(self) -> str:
        """Name of the quantity in a sentence, such as ``"angle"`` or ``"temperature"``."""
        return self.quantity.rpartition(".")[2]

    @property
    def zero(self) -> float:
        """Where the quantity is nothing, in its unit: a temperature counts from the absolute zero."""
        return ZERO_BY_UNIT.get(self.unit, 0.0)

    @property
    def from_zero(self) -> str:
        """Expression of the quantity, counted from where it is nothing."""
        return f"({self.name} + {-self.zero:g})" if self.zero else self.name

    @property
    def low(self) -> float:
        """Smallest value of the quantity in the runs, without outliers (0.2 % quantile)."""
        return float(np.quantile(self.samples, 0.002))

    @property
    def high(self) -> float:
        """Largest value of the quantity in the runs, without outliers (99.8 % quantile)."""
        return float(np.quantile(self.samples, 0.998))

    @property
    def span(self) -> float:
        """Difference of the quantity's largest and smallest value in the runs."""
        return self.high - self.low

    @property
    def size(self) -> float:
        """Largest absolute value of the quantity in the runs."""
        return max(abs(self.low), abs(self.high))

    @property
    def comes_near_zero(self) -> bool:
        """Whether the quantity varies by more than half its size; else a term in proportion is nearly constant."""
        return self.span > self.size / 2


def check_same_units(runs: Iterable[Run]) -> None:
    """Check that every recorded quantity, such as a temperature, has the same unit in all recordings.

    Raises:
        InputError: a quantity has two units; the message names it and two of the recordings.
    """
    first: dict[str, tuple[str, str]] = {}
    for run in runs:
        for name, channel in run.extra.items():
            unit, where = first.setdefault(name, (channel.unit, run.name))
            if channel.unit != unit:
                raise InputError(f"'{name}' is in {unit} in {where}, in {channel.unit} in {run.name}: correct one unit")


def recorded_variables(runs: Sequence[Run]) -> list[TermVariable]:
    """Recorded quantities, such as a temperature, that all runs contain and that are not constant."""
    found = []
    for name, first in runs[0].extra.items():
        if all(name in run.extra for run in runs):
            samples = np.concatenate([run.extra[name].value for run in runs])
            column = RecordedColumn(name, first.unit, float(f"{samples.mean():.6g}"))
            variable = TermVariable(name.replace(".", "_"), "", column.unit, samples, column)
            found += [variable] if variable.span > MAX_RANGE_RATIO_OF_CONSTANT * variable.size else []
    return found


@dataclass(frozen=True, eq=False)
class TermLocation:
    """A place in a model's equations where a term can be added, such as the torque of one joint.

    Attributes:
        stage: name of the stage on which the term's effect acts.
        unit: unit of the added term.
        code: code that returns the changed stage, with ``{}`` for the added term.
        typical: typical size of a missing term, in `unit`.
        resisting_sign: sign of a term that opposes the motion: ``"-"`` for a force on the load, empty for a drive's
            torque, which is positive where it overcomes friction.
        dry_friction_site: the place where the size of a dry friction can be added; None where there is none.
        formula_pattern: form of the added term in a formula, with ``{}`` for the term.
        joint: the joint of an arm; empty for other bases.
    """

    stage: str
    unit: str
    code: str
    typical: float
    resisting_sign: str = "-"
    dry_friction_site: "TermLocation | None" = None
    formula_pattern: str = "{}"
    joint: str = ""


@dataclass(frozen=True)
class TermParameter:
    """Declaration of a parameter of a term: its size, a position, a width or a period.

    Attributes:
        unit: SI unit.
        start_value: start value of a fit.
        prior_std: prior standard deviation about the start value: half the distance to the next start value; 0 for
            none.
        lower: smallest value.
        upper: largest value.
        scale: factor from the value that an effect declares to the value for its joint of an arm.
        scope: ``"shared"`` by all runs, or ``"per_run"`` with one value for each run.
        typical: typical difference from the start value; 0 where `spread` is used instead.
    """

    unit: str
    start_value: float
    prior_std: float
    lower: float = -np.inf
    upper: float = np.inf
    scale: float = 1.0
    scope: Scope = "shared"
    typical: float = 0.0

    def scaled(self, scale: float) -> "TermParameter":
        """A copy whose start value, bounds and typical size are divided by `scale`.

        A joint of an arm multiplies declared values by this factor, so that they are as declared again.
        """
        scaled = ("start_value", "prior_std", "lower", "upper", "typical")
        declared = {name: getattr(self, name) / scale for name in scaled}
        return replace(self, **declared, scale=scale)


@dataclass(frozen=True, eq=False)
class CandidateTerm:
    """A candidate term: a sum of fitted sizes times given shapes, added at one place of a model's equations.

    Attributes:
        kind: kind of the law in a word or two, such as ``"stop"`` or ``"cubic drag"``.
        description: what the force does, for a sentence.
        location: the place in the equations.
        variables: quantities on which the term depends.
        shapes: CasADi expression of each shape, by the name of the size that multiplies it.
        size_parameter: declaration of each size; its lower bound is zero for friction, which only takes energy.
        parameters: declarations of further parameters, such as a position, by name.
        preceding_code: lines of code that are needed before the shapes, such as a state or a function.
        name: name of the term's effect.
        acts_beyond: 1 where the term acts above its place only, -1 where below it only, 0 where it acts everywhere; the
            place is one of the first variable.
    """

    kind: str
    description: str
    location: TermLocation
    variables: tuple[TermVariable, ...]
    shapes: Mapping[str, str]
    size_parameter: TermParameter
    parameters: Mapping[str, TermParameter] = field(default_factory=dict)
    preceding_code: tuple[str, ...] = ()
    name: str = ""
    acts_beyond: int = 0

    @property
    def stem(self) -> str:
        """First part of the name of the term's effect; a number may follow."""
        return f"discovered_{re.sub(r'[^A-Za-z0-9]+', '_', self.kind)}"[:MAX_NAME_STEM_LENGTH]

    @property
    def is_curve(self) -> bool:
        """Whether the term is a smooth curve through fitted values instead of a formula."""
        return self.kind.startswith("curve")

    @property
    def summands(self) -> list[str]:
        """CasADi expressions of size times shape, whose sum is the term."""
        parts = (f"{'-' * (s[0] == '-')}{size} * {_factor(s.removeprefix('-'))}" for size, s in self.shapes.items())
        return [part.replace(" * 1 / ", " / ").removesuffix(" * 1") for part in parts]

    @property
    def force(self) -> str:
        """CasADi expression of the whole term."""
        return " + ".join(self.summands).replace("+ -", "- ")

    @property
    def formula(self) -> str:
        """The formula for a reader, such as ``"stiffness * max(0, angle - place)"``."""
        if self.is_curve:
            return f"smooth {self.kind} through {len(self.shapes)} values"
        return re.sub(r"\bca\.(f(?=abs|max|min))?", "", self.location.formula_pattern.format(self.force)).replace(
            "**", "^"
        )

    def share_without(self, place: float) -> float:
        """Share of the samples in the runs in which the term does not act, if it acts beyond a `place` only."""
        beyond = self.acts_beyond * (self.variables[0].samples - place)
        return float(np.mean(beyond <= 0.0))

    def with_start_values(self, values: Mapping[str, float]) -> "CandidateTerm":
        """A copy of the term with other start values of its constants, given by name."""
        moved = {
            n: replace(self.parameters[n], start_value=float(x / self.parameters[n].scale)) for n, x in values.items()
        }
        return replace(self, parameters={**self.parameters, **moved})


def named_terms(terms: Iterable[CandidateTerm], taken: Collection[str] = ()) -> dict[str, CandidateTerm]:
    """Give terms unique names with numbers, such as ``"discovered_stop_3"``, that are not among `taken`."""
    found: dict[str, CandidateTerm] = {}
    numbers = count()
    for term in terms:
        name = next(n for number in numbers if (n := f"{term.stem}_{number}") not in taken)
        found[name] = replace(term, name=name)
    return found


def _factor(shape: str) -> str:
    """A shape as a factor: in brackets where it is a sum without brackets."""
    top = ast.parse(shape, mode="eval").body
    is_sum = isinstance(top, ast.BinOp) and isinstance(top.op, ast.Add | ast.Sub)
    return f"({shape})" if is_sum and top.col_offset == 0 else shape
