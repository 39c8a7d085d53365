"""A candidate term: a shape of the missing force with units, written as an effect that a model can have."""

import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import count

import numpy as np

from armdyn.errors import InputError
from armdyn.parameter import RecordedColumn, Scope
from armdyn.recording.channels import FloatArray
from armdyn.run import Run

MAX_STEM_LENGTH = 50
"""Characters with which the name of an effect begins; a number follows."""
CONSTANT_RANGE_RATIO = 1e-6
"""Range over size of a recorded quantity that does not change: rounding."""


@dataclass(frozen=True, eq=False)
class Variable:
    """What a force may depend on.

    Attributes:
        name: as formulas call it, ``"angle"``.
        source: expression of the stage that it is, ``"string.angle"``.
        unit: SI.
        samples: (n,) its values in the runs, in any order; they say where places and widths are looked for.
        column: of the recordings that it is, in place of an expression; None where there is none.
    """

    name: str
    source: str
    unit: str
    samples: FloatArray = field(default_factory=lambda: np.zeros(1))
    column: RecordedColumn | None = None

    @property
    def quantity(self) -> str:
        """What it is called where it is measured: ``"angle"``, ``"extra.temperature"``."""
        return self.name if self.column is None else self.column.name

    @property
    def spoken(self) -> str:
        """For a sentence: ``"angle"``, ``"temperature"``."""
        return self.quantity.rpartition(".")[2]

    @property
    def low(self) -> float:
        """Smallest value in the runs, isolated ones apart."""
        return float(np.quantile(self.samples, 0.002))

    @property
    def high(self) -> float:
        """Largest value in the runs, isolated ones apart."""
        return float(np.quantile(self.samples, 0.998))

    @property
    def span(self) -> float:
        """Range in the runs."""
        return self.high - self.low

    @property
    def size(self) -> float:
        """Largest distance from zero in the runs."""
        return max(abs(self.low), abs(self.high))

    @property
    def comes_near_zero(self) -> bool:
        """Whether it goes half of the way to zero: what is in proportion to it then differs from a constant."""
        return self.span > self.size / 2


def check_same_units(runs: Iterable[Run]) -> None:
    """Refuse a further quantity that is of another kind in another recording.

    Raises:
        InputError: names it and two of the recordings.
    """
    first: dict[str, tuple[str, str]] = {}
    for run in runs:
        for name, channel in run.extra.items():
            unit, where = first.setdefault(name, (channel.unit, run.name))
            if channel.unit != unit:
                raise InputError(f"'{name}' is in {unit} in {where}, in {channel.unit} in {run.name}: mend one unit")


def recorded_variables(runs: Sequence[Run]) -> list[Variable]:
    """Further quantities that all of these runs hold and that change; each has one unit, see `check_same_units`."""
    found = []
    for name, first in runs[0].extra.items():
        if all(name in run.extra for run in runs):
            samples = np.concatenate([run.extra[name].value for run in runs])
            column = RecordedColumn(name, first.unit, float(f"{samples.mean():.6g}"))
            variable = Variable(name.replace(".", "_"), "", column.unit, samples, column)
            found += [variable] if variable.span > CONSTANT_RANGE_RATIO * variable.size else []
    return found


@dataclass(frozen=True, eq=False)
class Site:
    """Where a term enters the equations.

    Attributes:
        stage: that the effect acts on.
        unit: of what is added there.
        adds: expression that returns the changed stage, with ``{}`` for what is added.
        typical: size of what may be missing there.
        resists: sign with which what is added takes energy or pulls back: ``"-"`` of a force on the load, nothing of
            a drive's torque.
        dry: where dry friction enters; its shapes are sizes, at least zero.
        shown: how a formula writes what is added, with ``{}`` for it.
        joint: the joint of an arm; empty for every other base.
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
    """A number of a term that is not its size: a place, a width, a period.

    Attributes:
        unit: SI.
        value: from which a fit begins.
        spread: standard deviation about it before the runs are asked: half the distance to the next one tried.
        lower: smallest value.
        upper: largest value.
        scale: by which an arm multiplies what the effect declares, to have the value of its joint.
        scope: ``"shared"`` by all runs, or one value ``"per_run"``, as of where a state begins.
        typical: by how much it may differ from the value, where it is looked for and has no spread.
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
        """The same constant as an effect declares it that an arm multiplies by `scale`."""
        value, spread, lower, upper = (x / scale for x in (self.value, self.spread, self.lower, self.upper))
        return replace(self, value=value, spread=spread, lower=lower, upper=upper, scale=scale)


@dataclass(frozen=True, eq=False)
class Term:
    """A sum of shapes at one site, each with a size that is fitted and a unit that follows from its variables.

    Attributes:
        kind: of the law in a word or two, ``"stop"``, ``"cubic drag"``.
        says: what the force does, for a sentence.
        site: where it acts.
        variables: by name, those that it depends on.
        shapes: by name of its size, the CasADi expression that it multiplies.
        units: of the sizes, by their names.
        typical: of the sizes, by their names.
        constants: by name; they are fitted as well.
        positive: whether sizes are at least zero: friction takes energy.
        lines: of code before the force: a state of the effect's own, or a function that its shapes call.
        name: of the effect that it is written as.
    """

    kind: str
    says: str
    site: Site
    variables: tuple[Variable, ...]
    shapes: Mapping[str, str]
    units: Mapping[str, str]
    typical: Mapping[str, float]
    constants: Mapping[str, Constant] = field(default_factory=dict)
    positive: bool = False
    lines: tuple[str, ...] = ()
    name: str = ""

    @property
    def stem(self) -> str:
        """With which the name of its effect begins."""
        return f"discovered_{re.sub(r'[^A-Za-z0-9]+', '_', self.kind)}"[:MAX_STEM_LENGTH]

    @property
    def is_curve(self) -> bool:
        """Whether it is a smooth curve through values and no formula."""
        return self.kind.startswith("curve")

    @property
    def summands(self) -> list[str]:
        """CasADi expressions of variables, sizes and constants, whose sum is added at the site."""
        parts = (
            f"-{size} * {_factor(shape[1:])}" if shape.startswith("-") else f"{size} * {_factor(shape)}"
            for size, shape in self.shapes.items()
        )
        return [part.replace(" * 1 / ", " / ").removesuffix(" * 1") for part in parts]

    @property
    def force(self) -> str:
        """Their sum."""
        return " + ".join(self.summands).replace("+ -", "- ")

    @property
    def formula(self) -> str:
        """The same for a reader: ``"stiffness * max(0, angle - place)"``."""
        if self.is_curve:
            return f"smooth {self.kind} through {len(self.shapes)} values"
        text = (
            self.site.shown.format(self.force)
            .replace("ca.fabs", "abs")
            .replace("ca.fmax", "max")
            .replace("ca.fmin", "min")
        )
        return re.sub(r"\bca\.", "", text).replace("**", "^")

    def named(self, name: str) -> "Term":
        """The same term as another effect."""
        return replace(self, name=name)

    def at(self, values: Mapping[str, float]) -> "Term":
        """The same term whose constants begin at other values."""
        moved = {
            n: replace(c, value=float(values[n] / c.scale) if n in values else c.value)
            for n, c in self.constants.items()
        }
        return replace(self, constants=moved)


def named_terms(terms: Iterable[Term], taken: Collection[str] = ()) -> dict[str, Term]:
    """Terms by numbered names that are not `taken`: a joint's name may be too long for that of an effect."""
    found: dict[str, Term] = {}
    numbers = count()
    for term in terms:
        name = next(n for number in numbers if (n := f"{term.stem}_{number}") not in taken)
        found[name] = term.named(name)
    return found


def _factor(shape: str) -> str:
    """A shape that can be multiplied: in brackets where it is a sum."""
    depth = 0
    for i, letter in enumerate(shape):
        depth += (letter in "([") - (letter in ")]")
        if depth == 0 and i and letter in "+-" and shape[i - 1] == " ":
            return f"({shape})"
    return shape
