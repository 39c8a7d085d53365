"""A candidate term: a shape of the missing force with units, which can be written as an effect of a model."""

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
"""Length of the beginning of an effect's name, in characters; a number follows."""
MAX_RANGE_RATIO_OF_CONSTANT = 1e-6
"""Ratio of range to size below which a recorded quantity is constant, up to rounding."""


@dataclass(frozen=True, eq=False)
class Variable:
    """A quantity on which a force may depend.

    Attributes:
        name: its name in formulas, such as ``"angle"``.
        source: its expression in the stage, such as ``"string.angle"``.
        unit: its SI unit, or the unit that a user's own base gives it.
        samples: (n,) its values in the runs, in any order; they give the range for positions and widths.
        column: the recorded column that it is, in place of an expression; None for an expression.
    """

    name: str
    source: str
    unit: str
    samples: FloatArray = field(default_factory=lambda: np.zeros(1))
    column: RecordedColumn | None = None

    @property
    def quantity(self) -> str:
        """Its name in recordings: ``"angle"``, ``"extra.temperature"``."""
        return self.name if self.column is None else self.column.name

    @property
    def spoken(self) -> str:
        """Its name in a sentence: ``"angle"``, ``"temperature"``."""
        return self.quantity.rpartition(".")[2]

    @property
    def low(self) -> float:
        """Smallest value in the runs, without isolated samples."""
        return float(np.quantile(self.samples, 0.002))

    @property
    def high(self) -> float:
        """Largest value in the runs, without isolated samples."""
        return float(np.quantile(self.samples, 0.998))

    @property
    def span(self) -> float:
        """Range of its values in the runs."""
        return self.high - self.low

    @property
    def size(self) -> float:
        """Largest absolute value in the runs."""
        return max(abs(self.low), abs(self.high))

    @property
    def comes_near_zero(self) -> bool:
        """Whether it comes nearer to zero than half its size: else a term in proportion to it is nearly constant."""
        return self.span > self.size / 2


def check_same_units(runs: Iterable[Run]) -> None:
    """Refuse a recorded quantity whose unit is of another kind in another recording.

    Raises:
        InputError: it names the quantity and two of the recordings.
    """
    first: dict[str, tuple[str, str]] = {}
    for run in runs:
        for name, channel in run.extra.items():
            unit, where = first.setdefault(name, (channel.unit, run.name))
            if channel.unit != unit:
                raise InputError(f"'{name}' is in {unit} in {where}, in {channel.unit} in {run.name}: mend one unit")


def recorded_variables(runs: Sequence[Run]) -> list[Variable]:
    """Recorded quantities that all runs contain and that change; each has one unit, see `check_same_units`."""
    found = []
    for name, first in runs[0].extra.items():
        if all(name in run.extra for run in runs):
            samples = np.concatenate([run.extra[name].value for run in runs])
            column = RecordedColumn(name, first.unit, float(f"{samples.mean():.6g}"))
            variable = Variable(name.replace(".", "_"), "", column.unit, samples, column)
            found += [variable] if variable.span > MAX_RANGE_RATIO_OF_CONSTANT * variable.size else []
    return found


@dataclass(frozen=True, eq=False)
class Site:
    """A place in the equations where a term can be added.

    Attributes:
        stage: the stage on which the effect acts.
        unit: unit of the added term.
        adds: expression that returns the changed stage, with ``{}`` for the added term.
        typical: typical size of a missing term.
        resists: sign with which a term takes energy or pulls back: ``"-"`` for a force on the load, empty for a drive's
            torque.
        dry: expression that adds dry friction; its shapes are sizes, at least zero.
        shown: form of the added term in a formula, with ``{}`` for the term.
        joint: the joint of an arm; empty for other bases.
    """

    stage: str
    unit: str
    adds: str
    typical: float
    resists: str = "-"
    dry: "Site | None" = None
    shown: str = "{}"
    joint: str = ""


@dataclass(frozen=True)
class Constant:
    """A parameter of a term: its size, or a position, a width, a period.

    Attributes:
        unit: its SI unit.
        value: start value of a fit.
        spread: prior standard deviation about the start value: half the distance to the next value tried.
        lower: smallest value.
        upper: largest value.
        scale: factor by which an arm multiplies the declared value, to get the value of its joint.
        scope: ``"shared"`` by all runs, or ``"per_run"`` with one value for each run, such as a state's start.
        typical: typical difference from the value; 0 where it is the spread.
    """

    unit: str
    value: float
    spread: float
    lower: float = -np.inf
    upper: float = np.inf
    scale: float = 1.0
    scope: Scope = "shared"
    typical: float = 0.0

    def scaled(self, scale: float) -> "Constant":
        """The constant as an effect declares it, for an arm that multiplies it by `scale`."""
        declared = {name: getattr(self, name) / scale for name in ("value", "spread", "lower", "upper", "typical")}
        return replace(self, **declared, scale=scale)


@dataclass(frozen=True, eq=False)
class Term:
    """A sum of shapes at one site; each shape has a fitted size, whose unit follows from its quantities.

    Attributes:
        kind: kind of the law in a word or two, ``"stop"``, ``"cubic drag"``.
        says: what the force does, for a sentence.
        site: place in the equations.
        variables: quantities on which it depends, by name.
        shapes: CasADi expression of each shape, by the name of its size.
        size: each of the sizes: its unit, its typical value, and zero as its bound where friction takes energy.
        constants: further fitted parameters, by name.
        lines: lines of code before the force: a state of the effect, or a function that its shapes call.
        name: name of the effect.
    """

    kind: str
    says: str
    site: Site
    variables: tuple[Variable, ...]
    shapes: Mapping[str, str]
    size: Constant
    constants: Mapping[str, Constant] = field(default_factory=dict)
    lines: tuple[str, ...] = ()
    name: str = ""

    @property
    def stem(self) -> str:
        """Beginning of the name of its effect."""
        return f"discovered_{re.sub(r'[^A-Za-z0-9]+', '_', self.kind)}"[:MAX_NAME_STEM_LENGTH]

    @property
    def is_curve(self) -> bool:
        """Whether it is a smooth curve through values instead of a formula."""
        return self.kind.startswith("curve")

    @property
    def summands(self) -> list[str]:
        """CasADi expressions of quantities, sizes and constants, whose sum is added at the site."""
        parts = (f"{'-' * (s[0] == '-')}{size} * {_factor(s.removeprefix('-'))}" for size, s in self.shapes.items())
        return [part.replace(" * 1 / ", " / ").removesuffix(" * 1") for part in parts]

    @property
    def force(self) -> str:
        """CasADi expression of the whole sum."""
        return " + ".join(self.summands).replace("+ -", "- ")

    @property
    def formula(self) -> str:
        """The formula for a reader, such as ``"stiffness * max(0, angle - place)"``."""
        if self.is_curve:
            return f"smooth {self.kind} through {len(self.shapes)} values"
        return re.sub(r"\bca\.(f(?=abs|max|min))?", "", self.site.shown.format(self.force)).replace("**", "^")

    def at(self, values: Mapping[str, float]) -> "Term":
        """The same term with other start values of its constants."""
        moved = {n: replace(self.constants[n], value=float(x / self.constants[n].scale)) for n, x in values.items()}
        return replace(self, constants={**self.constants, **moved})


def named_terms(terms: Iterable[Term], taken: Collection[str] = ()) -> dict[str, Term]:
    """Terms with unique numbered names that are not `taken`; a joint's name may be too long to be part of them."""
    found: dict[str, Term] = {}
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
