"""Parameters of a model: name, bounds, prior and value; and recorded quantities that effects read."""

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
    """Prior knowledge of a parameter, such as a weighing: a normal density.

    Attributes:
        mean: mean in the parameter's unit.
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
        needs: channels of which a recording must have one to make it identifiable; any channel where empty.
        beside: further channels of which the recording must also have one: a delay is visible only against another
            clock.
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
        """Whether it has a prior whose standard deviation counts although no fit changes it (a consider parameter)."""
        return not self.fitted and self.prior is not None and not self.effect

    def shows_in(self, channels: Collection[str]) -> bool:
        """Whether recordings of these channels can determine it."""
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
    """Channels of which one is missing in a recording of `channels`; empty where none is missing.

    Args:
        channels: channels of the recording.
        needs: channels of which one is needed, on any joint where none is named; any channel where empty.
        beside: further channels of which one is needed as well.
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
        summary: one phrase on the meaning of the number.
        spread: prior standard deviation about the null value of what occurs in nature; it keeps a fit stable where a
            run does not identify the number, such as the place of a mass of zero.
        needs: channels of which a recording must have one to make it identifiable; any channel where empty.
        beside: further channels of which the recording must also have one; see `Parameter`.
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
        """The parameter of an effect whose short name is `short`, on a joint or on none, at its null value."""
        return Parameter(
            name=f"{effect}.{short}[{joint}]" if joint else f"{effect}.{short}", effect=effect, joint=joint,
            unit=self.unit, value=self.null, typical=self.typical, null=self.null,
            lower=self.lower, upper=self.upper, scope=self.scope, source=self.summary,
            prior=None if self.spread is None else Prior(self.null, self.spread), needs=self.needs, beside=self.beside,
        )  # fmt: skip


quantity: Any = Quantity
"""A `Quantity` as the default value of an argument, which is an expression when the effect is applied."""


@dataclass(frozen=True)
class RecordedColumn:
    """Declares a recorded quantity that an effect reads, as the default value of an argument of its function.

    Attributes:
        name: name of the column, such as ``"extra.temperature"``.
        unit: SI base unit of its values, ``"1"`` for a plain number.
        usual: value where it was not recorded: in runs without the column, in plans, in control, in exports.
    """

    name: str
    unit: str
    usual: float

    def over(self, recorded: Mapping[str, Channel], time: FloatArray) -> FloatArray:
        """(n,) values at (n,) times, s: linear between the samples, constant before the first and after the last.

        Args:
            recorded: further quantities of a run, by name.
            time: (n,) times on the run's clock, s.

        Raises:
            InputError: the quantity was recorded in another unit.
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
"""A `RecordedColumn` as the default value of an argument, which is an expression like that of a `quantity`."""
