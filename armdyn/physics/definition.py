"""The definition of a physics: states, equations, inputs, outputs, and where effects may act.

```python
@physics(
    "spring",
    summary="A mass on a spring.",
    source="Goldstein, Classical Mechanics, 3rd ed., §6.1",
    parameters=(constant("stiffness", "N/m", 10.0, lower=0.0), constant("mass", "kg", 1.0, lower=1e-3)),
    states=(state("position", "m", typical=0.1), state("speed", "m/s", typical=0.3)),
    outputs={"q.mass": "m"},
)
def spring(at: Moment) -> Equations:
    slider = at.stage("slider", Slider(at["position"], at["speed"], force=0))  # effects act here
    force = slider.force - at["stiffness"] * at["position"]
    return Equations(
        rates={"position": at["speed"], "speed": force / at["mass"]},
        outputs={"q.mass": at["position"]},
    )
```

A stage is any frozen dataclass that inherits `Stage`; its name, and the joints on which it occurs, are those with which
the equations ask for it. All expressions are CasADi's, so that every derivative is exact.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import inf
from types import MappingProxyType
from typing import Any, NamedTuple, Self, TypeAlias, TypeVar

import casadi as ca

from armdyn.effects.effect import Effect
from armdyn.errors import InputError, UnknownNameError, at
from armdyn.parameter import Parameter, RecordedColumn
from armdyn.recording.channels import channel_kind, channel_units, is_auxiliary
from armdyn.recording.units import to_base_units

Expression: TypeAlias = Any  # a casadi.SX, which carries no type information
NONE: Expression = ca.SX(0)
"""What a stage has none of before effects add to it."""


class Memory(NamedTuple):
    """A state that an effect brings.

    Attributes:
        symbol: the state.
        rate: its time derivative.
        start: its value at the start of a run.
    """

    symbol: Expression
    rate: Expression
    start: Expression


@dataclass(frozen=True)
class Stage:
    """Where effects may act: an immutable bundle of expressions; an effect takes one and returns a changed one.

    Attributes:
        memory: states that effects have brought.
    """

    memory: tuple[Memory, ...] = field(default=(), kw_only=True)

    def with_state(self, rate: Callable[[Expression], Expression], start: Expression = 0) -> tuple[Self, Expression]:
        """The stage with one state more, such as a bristle's deflection, and the state.

        Args:
            rate: from the state to its time derivative.
            start: its value at the start of a run.
        """
        symbol = ca.SX.sym("memory")
        return replace(self, memory=(*self.memory, Memory(symbol, rate(symbol), ca.SX(start)))), symbol


S = TypeVar("S", bound=Stage)


@dataclass(frozen=True)
class Timed(Stage):
    """A stage that ends in a sensor with a lag and a delay; both depend on parameters only.

    Attributes:
        lag: first-order time constant, s.
        delay: how late the reading is, s.
    """

    lag: Expression = field(default=NONE, kw_only=True)
    delay: Expression = field(default=NONE, kw_only=True)

    def with_lag(self, time_constant: Expression) -> Self:
        """Let the reading pass a first-order lag, s."""
        return replace(self, lag=self.lag + time_constant)

    def with_delay(self, time: Expression) -> Self:
        """Let the reading arrive late, s."""
        return replace(self, delay=self.delay + time)


@dataclass(frozen=True)
class Reading(Timed):
    """What a sensor reads of a quantity; return it among the outputs to give the quantity a lag and a delay.

    Attributes:
        value: in the channel's unit.
    """

    value: Expression

    def with_value(self, value: Expression) -> Self:
        """Let the sensor read `value`."""
        return replace(self, value=value)


@dataclass(frozen=True, eq=False)
class Rate(Stage):
    """The rate of a state: a stage, called ``"rate"``, that every base has for each state whose rate is no state.

    Attributes:
        state: name of the state.
        value: its time derivative, in the state's unit per s.
        time: s since the start of the run.
        given: states and inputs, by name.
    """

    state: str
    value: Expression
    time: Expression
    given: Mapping[str, Expression]

    def __getitem__(self, name: str) -> Expression:
        """A state, or an input such as ``"extra.voltage"``."""
        if name not in self.given:
            raise UnknownNameError("state or input", name, self.given)
        return self.given[name]

    def with_rate(self, more: Expression) -> Self:
        """Let the state change faster, by `more` of its unit per s."""
        return replace(self, value=self.value + more)


RATE = "rate"
"""Name of that stage."""


@dataclass(frozen=True)
class Signal:
    """A recorded input.

    Attributes:
        value: in the channel's unit.
        rate: per second.
        acceleration: per second squared.
    """

    value: Expression
    rate: Expression
    acceleration: Expression


@dataclass(frozen=True)
class Equations:
    """The equations of a physics at one moment.

    Attributes:
        rates: time derivative of every state, by name.
        outputs: what is measured, by channel.
        against: covariates of a residual, with units; states and inputs where they are not given. For a channel
            ``"q.<joint>"`` only names that end in the joint are looked at.
    """

    rates: Mapping[str, Expression]
    outputs: Mapping[str, "Expression | Reading"]
    against: Mapping[str, tuple[Expression, str]] = field(default_factory=dict)


class Moment:
    """What the equations are given: the time, and by name parameters, states and inputs.

    Args:
        time: s since the start of the run.
        values: of parameters and states, by name.
        inputs: by channel.
        effects: that act, in their order.
        by_name: values of the effects' parameters.
        recorded: further recorded quantities that effects read; those that are not among them have their usual values.
    """

    def __init__(
        self,
        time: Expression,
        values: Mapping[str, Expression],
        inputs: Mapping[str, Signal],
        effects: Sequence[Effect],
        by_name: Mapping[str, Expression],
        recorded: Mapping[RecordedColumn, Expression] = MappingProxyType({}),
    ) -> None:
        self.time = time
        self.memory: list[Memory] = []
        self.stages: dict[str, list[str]] = {}
        self.kinds: dict[str, type] = {}
        self._values, self._inputs, self._effects, self._by_name = values, inputs, effects, by_name
        self._recorded = recorded

    def __getitem__(self, name: str) -> Expression:
        """A parameter or a state."""
        if name not in self._values:
            raise UnknownNameError("parameter or state", name, self._values)
        return self._values[name]

    def input(self, channel: str) -> Signal:
        """A recorded input."""
        if channel not in self._inputs:
            raise UnknownNameError("input", channel, self._inputs)
        return self._inputs[channel]

    def stage(self, name: str, stage: S, joint: str = "") -> S:
        """The stage after the effects that act on it.

        Args:
            name: what effects call it in `acts_on`.
            stage: without any effect.
            joint: which of several it is, ``""`` where there is one only.
        """
        self.stages.setdefault(name, []).append(joint)
        self.kinds[name] = type(stage)
        for effect in self._effects:
            if effect.acts_on == name and (joint in effect.joints or not effect.joints):
                tail = f"[{joint}]" if joint else ""
                names = {f"{effect.name}.{short}": f"{effect.name}.{short}{tail}" for short in effect.quantities}
                if all(name in self._by_name for name in names.values()):  # it may change nothing on other joints
                    values = {key: self._by_name[name] for key, name in names.items()}
                    stage = effect.apply(stage, values, self._recorded)
        self.memory += stage.memory
        return stage


@dataclass(frozen=True, eq=False)
class Physics:
    """A physics: what is its own.

    Attributes:
        name: for a person and in answers.
        summary: one sentence.
        source: where the equations come from.
        parameters: of all runs.
        states: by name, what each is at the start of a run, one parameter per run; none where all is algebra.
        inputs: channels that must be recorded, with their units.
        held: those of them that stay as they are from each sample to the next one.
        outputs: channels that are predicted, with their units.
        equations: from a moment to what holds there.
        period: s; about one swing: the length of a run from which its start can be found.
        step: s; longest step of the integration.
    """

    name: str
    summary: str
    source: str
    parameters: tuple[Parameter, ...]
    states: Mapping[str, Parameter]
    inputs: Mapping[str, str]
    held: frozenset[str]
    outputs: Mapping[str, str]
    equations: Callable[[Moment], Equations]
    period: float
    step: float


def physics(
    name: str,
    *,
    summary: str,
    source: str,
    parameters: Sequence[Parameter],
    states: Sequence[Parameter],
    outputs: Mapping[str, str],
    inputs: Mapping[str, str] = MappingProxyType({}),
    held: Collection[str] = (),
    period: float = 1.0,
    step: float | None = None,
) -> Callable[[Callable[[Moment], Equations]], Physics]:
    """Make a `Physics` of a function from a `Moment` to its `Equations`; see `Physics` and the head of this file.

    Between its samples an input is a smooth curve, with a rate and an acceleration. One that is `held`, such as the
    command of a controller, keeps its value until the next sample, and both are 0; so are a recorded ``q_cmd`` or
    ``v_cmd``, and an input that changes in single jumps of unlike sizes and stands still between them.

    Raises:
        InputError: a channel is unknown or has another unit, a name is used twice, or there is nothing to fit.
    """
    if not parameters or not outputs:
        raise InputError(f"physics '{name}': declare a parameter and an output at least")
    step = USUAL_STEP * period if step is None else step
    for channel, unit in (*inputs.items(), *outputs.items()):
        if is_auxiliary(channel):
            with at(f"physics '{name}': {channel}"):
                to_base_units(unit)
        elif unit not in channel_units(channel, "channel"):
            raise InputError(f"physics '{name}': {channel} is in {' or '.join(channel_units(channel))}, not in {unit}")
    for channel in held:
        if channel not in inputs:
            raise UnknownNameError(f"held input of '{name}'", channel, inputs)
    if not SHORTEST <= period <= LONGEST or not SHORTEST / 100 <= step <= period:
        raise InputError(
            f"physics '{name}': its period is {period!r} s and its step {step!r} s: write a period from {SHORTEST:g} "
            f"to {LONGEST:g} s, and a step that is no longer"
        )
    names = [p.name for p in (*parameters, *states)]
    if twice := {n for n in names if names.count(n) > 1 or "." in n}:
        raise InputError(f"physics '{name}': give '{min(twice)}' a name without a dot that is used only once")
    by_name = {p.name.removeprefix(_START): p for p in states}
    kept = frozenset(held) | {channel for channel in inputs if channel_kind(channel).held}

    def make(function: Callable[[Moment], Equations]) -> Physics:
        return Physics(
            name, summary, source, tuple(parameters), by_name, dict(inputs), kept, dict(outputs), function, period, step
        )

    return make


_START = "initial_"
USUAL_STEP = 0.01
"""Of a period, the step of the integration where none is given: a Runge-Kutta step is exact to 1e-7 there."""
SHORTEST, LONGEST = 1e-6, 1e7
"""s of a swing or of whatever a base does again and again; what is faster no recording shows."""


def constant(
    name: str,
    unit: str,
    value: float,
    *,
    typical: float | None = None,
    lower: float = -inf,
    upper: float = inf,
    summary: str = "",
) -> Parameter:
    """Declare a parameter of a physics.

    Args:
        name: without a dot.
        unit: SI unit as text.
        value: first guess.
        typical: a realistic size; the first guess where it is not given.
        lower: smallest physical value.
        upper: largest physical value.
        summary: one phrase on what the number is.
    """
    size = abs(value) if typical is None else typical
    if not size > 0:
        raise InputError(f"parameter '{name}': give a typical size, above 0")
    return Parameter(name, unit, value, size, null=value, lower=lower, upper=upper, source=summary)


def state(
    name: str, unit: str, *, typical: float, start: float = 0.0, lower: float = -inf, upper: float = inf
) -> Parameter:
    """Declare a state of a physics; its value at the start of a run is fitted to every run.

    Args:
        name: without a dot.
        unit: SI unit as text.
        typical: a realistic size.
        start: first guess of the value at the start of a run.
        lower: smallest physical value at the start.
        upper: largest physical value at the start.
    """
    summary = f"{name} at the start of a run"
    return Parameter(f"{_START}{name}", unit, start, typical, start, None, lower, upper, None, "per_run", True, summary)
