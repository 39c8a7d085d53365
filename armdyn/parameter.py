"""The parameters of a model, with bounds, prior and value, and the recorded quantities that its effects use."""

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
    """A parameter of a model: a number with a unit, bounds and perhaps a prior, which a fit may change.

    Attributes:
        name: such as ``"length"`` or ``"quadratic_drag.coefficient"``.
        unit: SI unit as text.
        value: the present value, in `unit`.
        typical: a realistic size of the parameter, its "typical size"; it scales steps, searches and first guesses.
        null: the value at which the parameter's effect is absent (equal to `value` for parameters of the base model).
        std: standard deviation after a fit, None before.
        lower: smallest physical value.
        upper: largest physical value.
        prior: knowledge from outside the data.
        scope: ``"shared"`` by all runs, or one value ``"per_run"``.
        fitted: whether a fit may change it.
        source: where the value comes from.
        effect: name of the effect that it belongs to, ``""`` for a parameter of the base.
        joint: the joint that it belongs to, ``""`` for none.
        needs: channels of which a recording must have one to make the parameter identifiable; any channel where empty.
        beside: further channels of which the recording must also have one: a delay is visible only relative to
            another sensor.
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
    def is_consider_parameter(self) -> bool:
        """Whether it is a consider parameter: no fit changes it, but the standard deviation of its prior counts."""
        return not self.fitted and self.prior is not None and not self.effect

    def is_identifiable_from(self, channels: Collection[str]) -> bool:
        """Whether recordings of these channels can determine the parameter."""
        return not missing_channels(channels, self.needs, self.beside)

    def __post_init__(self) -> None:
        if not isfinite(self.value):
            raise InputError(f"parameter '{self.name}' is {self.value}: give a finite number in {self.unit}")
        if not self.lower <= self.value <= self.upper:
            raise InputError(
                f"parameter '{self.name}' = {self.value:g} {self.unit} is outside its physical range "
                f"{self.lower:g} to {self.upper:g} {self.unit}"
            )

    def with_value(self, value: float, std: float | None = None) -> "Parameter":
        """A copy with another value, in the parameter's unit, and, after a fit, its standard deviation."""
        return replace(self, value=float(value), std=std)


def missing_channels(
    channels: Collection[str], needs: tuple[str, ...], beside: tuple[str, ...] = ()
) -> tuple[str, ...]:
    """Channels of which a recording would need one in addition to its own; empty where it has what is needed.

    Args:
        channels: channels of the recording.
        needs: channels of which one is needed; ``"tau"`` means that of any joint; any channel where empty.
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
        spread: standard deviation of a prior about the null value, as large as values that occur in nature; it keeps a
            fit stable where a run does not identify the parameter, such as the position of a mass of zero.
        needs: channels of which a recording must have one to make the parameter identifiable; any channel where empty.
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
        """Make the declared parameter of an effect, at its null value.

        Args:
            effect: name of the effect.
            short: name of the parameter within the effect.
            joint: name of the joint; empty where the effect acts on no joint.
        """
        return Parameter(
            name=f"{effect}.{short}[{joint}]" if joint else f"{effect}.{short}", effect=effect, joint=joint,
            unit=self.unit, value=self.null, typical=self.typical, null=self.null,
            lower=self.lower, upper=self.upper, scope=self.scope, source=self.summary,
            prior=None if self.spread is None else Prior(self.null, self.spread), needs=self.needs, beside=self.beside,
        )  # fmt: skip


quantity: Any = Quantity
"""`Quantity`, for use as the default value of an argument of an effect's function: when the effect is applied, the
function gets a CasADi expression for the argument."""


@dataclass(frozen=True)
class RecordedColumn:
    """Declares a recorded quantity that an effect uses, as the default value of an argument of the effect's function.

    Attributes:
        name: name of the column, such as ``"extra.temperature"``.
        unit: SI base unit of its values, ``"1"`` for a plain number.
        usual: value that is used where the quantity was not recorded: in other runs, in plans, in control, in exports.
    """

    name: str
    unit: str
    usual: float

    def interpolate(self, recorded: Mapping[str, Channel], time: FloatArray) -> FloatArray:
        """Interpolate the quantity, (n,), linearly between its samples; constant before the first and after the last.

        Args:
            recorded: recorded quantities of a run, by name; without this one, all values are `usual`.
            time: (n,) times on the run's clock, s.

        Raises:
            InputError: the quantity was recorded in another unit.
        """
        if self.name not in recorded:
            return np.full(len(time), self.usual)
        channel = recorded[self.name]
        if channel.unit != self.unit:
            raise InputError(
                f"'{self.name}' is in {channel.unit}, where an effect reads it in {self.unit}: correct the unit of one"
            )
        return np.interp(time, channel.time, channel.value)


column: Any = RecordedColumn
"""`RecordedColumn`, for use as the default value of an argument of an effect's function: when the effect is applied,
the function gets a CasADi expression for the argument."""
