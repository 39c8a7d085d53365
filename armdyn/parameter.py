"""A parameter of a model: what it is called, what it may be, what is known of it; and what was recorded beside it."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from math import inf, isfinite
from typing import Any, Literal

import numpy as np

from armdyn.errors import InputError
from armdyn.recording.channels import Channel, FloatArray

Scope = Literal["shared", "per_run"]


@dataclass(frozen=True)
class Prior:
    """Knowledge from outside the data, such as a weighing: a normal density.

    Attributes:
        mean: in the parameter's unit.
        std: standard deviation in the parameter's unit, > 0.
    """

    mean: float
    std: float

    def __post_init__(self) -> None:
        if not (isfinite(self.mean) and isfinite(self.std) and self.std > 0):
            raise InputError(f"prior {self.mean} +/- {self.std}: give a finite mean and a positive standard deviation")


@dataclass(frozen=True)
class Parameter:
    """One number of a model.

    Attributes:
        name: ``"length"`` or ``"quadratic_drag.coefficient"``.
        unit: SI unit as text.
        value: the present value.
        typical: a realistic size of the parameter; it scales finite steps, searches and first guesses.
        null: the value at which the physics behind it is absent (equal to ``value`` for base parameters).
        std: standard deviation after a fit, None before.
        lower: smallest physical value.
        upper: largest physical value.
        prior: knowledge from outside the data.
        scope: ``"shared"`` by all runs, or one value ``"per_run"``.
        fitted: whether a fit may change it.
        source: where the value comes from.
        effect: name of the effect that it belongs to, ``""`` for a parameter of the base.
        joint: the joint that it belongs to, ``""`` for none.
        needs: channels of which a recording must have one to show it; any will do where empty.
        beside: further channels of which it must have one as well: a delay shows only against another clock.
    """

    name: str
    unit: str
    value: float
    typical: float
    null: float = 0.0
    std: float | None = None
    lower: float = -inf
    upper: float = inf
    prior: Prior | None = None
    scope: Scope = "shared"
    fitted: bool = True
    source: str = ""
    effect: str = ""
    joint: str = ""
    needs: tuple[str, ...] = ()
    beside: tuple[str, ...] = ()

    @property
    def considered(self) -> bool:
        """Whether no fit changes it, but its standard deviation counts: a base's that is only known to a prior."""
        return not self.fitted and self.prior is not None and not self.effect

    def shows_in(self, channels: Collection[str]) -> bool:
        """Whether recordings of these channels can show it."""
        return not asked_for(channels, self.needs, self.beside)

    def __post_init__(self) -> None:
        if not isfinite(self.value):
            raise InputError(f"parameter '{self.name}' is {self.value}: give a finite number in {self.unit}")
        if not self.lower <= self.value <= self.upper:
            raise InputError(
                f"parameter '{self.name}' = {self.value:g} {self.unit} is outside its physical range "
                f"{self.lower:g} to {self.upper:g} {self.unit}"
            )

    def with_value(self, value: float, std: float | None = None) -> "Parameter":
        """The same parameter with another value (in its unit) and, after a fit, its standard deviation."""
        return replace(self, value=float(value), std=std)


def asked_for(channels: Collection[str], needs: tuple[str, ...], beside: tuple[str, ...] = ()) -> tuple[str, ...]:
    """Channels of which a recording of `channels` lacks one to show something; empty where it lacks none.

    Args:
        channels: that it has.
        needs: of these one, of any joint where none is named; any will do where empty.
        beside: of these one as well, likewise.
    """
    held = {*channels, *(name.partition(".")[0] for name in channels)}
    return next((names for names in (needs, beside) if names and not held & set(names)), ())


@dataclass(frozen=True)
class Quantity:
    """Declares a parameter of an effect, as the default value of an argument of the effect's function.

    Attributes:
        unit: SI unit as text, such as ``"N s/m"``.
        typical: a realistic size, used for scaling and for first guesses.
        null: the value at which the effect is absent; there it must change nothing to the last digit.
        lower: smallest physical value.
        upper: largest physical value.
        scope: ``"shared"`` by all runs or ``"per_run"``.
        summary: one phrase on what the number is.
        spread: standard deviation, about the null value, of what nature has; it keeps a fit sound where a run does
            not determine the number, such as the place of a mass of zero.
        needs: channels of which a recording must have one to show it; any will do where empty.
        beside: further channels of which it must have one as well, see `Parameter`.
    """

    unit: str
    typical: float
    null: float = 0.0
    lower: float = -inf
    upper: float = inf
    scope: Scope = "shared"
    summary: str = ""
    spread: float | None = None
    needs: tuple[str, ...] = ()
    beside: tuple[str, ...] = ()

    def parameter(self, effect: str, short: str, joint: str = "") -> Parameter:
        """The parameter `short` of an effect, on a joint or on none, at its null value."""
        return Parameter(
            name=f"{effect}.{short}[{joint}]" if joint else f"{effect}.{short}", effect=effect, joint=joint,
            unit=self.unit, value=self.null, typical=self.typical, null=self.null,
            lower=self.lower, upper=self.upper, scope=self.scope, source=self.summary,
            prior=None if self.spread is None else Prior(self.null, self.spread), needs=self.needs, beside=self.beside,
        )  # fmt: skip


quantity: Any = Quantity
"""A `Quantity` where it is the default value of an argument, which is an expression when the effect is applied."""


@dataclass(frozen=True)
class RecordedColumn:
    """Declares a further recorded quantity that an effect reads, as the default value of an argument of its function.

    Attributes:
        name: of the column, ``"extra.temperature"``.
        unit: SI base unit in which it is read, ``"1"`` for a plain number.
        usual: its value wherever it was not recorded: in runs without the column, in plans, in control, in exports.
    """

    name: str
    unit: str
    usual: float

    def over(self, recorded: Mapping[str, Channel], time: FloatArray) -> FloatArray:
        """(n,) values at (n,) times, s: linear between the samples, held before the first one and after the last one.

        Args:
            recorded: further quantities of a run, by name.
            time: on the run's clock.

        Raises:
            InputError: it was recorded in another unit.
        """
        if self.name not in recorded:
            return np.full(len(time), self.usual)
        channel = recorded[self.name]
        if channel.unit != self.unit:
            raise InputError(
                f"'{self.name}' is in {channel.unit}, where an effect reads it in {self.unit}: mend the unit of one"
            )
        return np.interp(time, channel.time, channel.value)


column: Any = RecordedColumn
"""A `RecordedColumn` where it is the default value of an argument, which is an expression like that of a `quantity`."""
