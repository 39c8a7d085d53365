"""Declare a physics: its states, equations, inputs and outputs, and the stages at which effects may act.

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

A stage is any frozen dataclass that inherits `Stage`. The equations give it a name, and the joints on which it occurs,
where they call `Moment.stage`. All expressions are CasADi's, so every derivative is exact.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import inf
from numbers import Real
from types import MappingProxyType
from typing import Any, NamedTuple, Self, TypeAlias, TypeVar

import casadi as ca

from armdyn.effects.effect import Effect
from armdyn.errors import InputError, UnknownNameError, error_location
from armdyn.parameter import Parameter, RecordedColumn
from armdyn.recording.channels import channel_kind, channel_units, is_auxiliary
from armdyn.recording.units import to_base_units

Expression: TypeAlias = Any  # a casadi.SX, which carries no type information
ZERO: Expression = ca.SX(0)
"""Zero as an expression: the default of stage attributes to which effects add."""


class AddedState(NamedTuple):
    """A state that an effect adds to the model.

    Attributes:
        symbol: symbol of the state.
        rate: its time derivative.
        start: value of the state at the start of a run.
    """

    symbol: Expression
    rate: Expression
    start: Expression


@dataclass(frozen=True)
class Stage:
    """A part of the physics that effects can change.

    It is a bundle of immutable expressions: an effect takes a stage and returns a changed one.

    Attributes:
        added_states: states that effects have added.
    """

    added_states: tuple[AddedState, ...] = field(default=(), kw_only=True)

    def with_state(self, rate: Callable[[Expression], Expression], start: Expression = 0) -> tuple[Self, Expression]:
        """Add a state, such as a bristle's deflection; return the changed stage and the symbol of the state.

        Args:
            rate: function from the state to its time derivative.
            start: value of the state at the start of a run.
        """
        symbol = ca.SX.sym("memory")
        return replace(self, added_states=(*self.added_states, AddedState(symbol, rate(symbol), ca.SX(start)))), symbol


S = TypeVar("S", bound=Stage)


@dataclass(frozen=True)
class SensorStage(Stage):
    """A stage whose quantity is measured by a sensor with a lag and a delay, which depend on parameters only.

    Attributes:
        lag: first-order time constant, s.
        delay: delay of the reading, s.
    """

    lag: Expression = field(default=ZERO, kw_only=True)
    delay: Expression = field(default=ZERO, kw_only=True)

    def with_lag(self, time_constant: Expression) -> Self:
        """Add `time_constant`, s, to the first-order lag of the sensor's reading."""
        return replace(self, lag=self.lag + time_constant)

    def with_delay(self, time: Expression) -> Self:
        """Add `time`, s, to the delay of the sensor's reading."""
        return replace(self, delay=self.delay + time)


@dataclass(frozen=True)
class Reading(SensorStage):
    """A sensor's reading of one quantity.

    Equations return it as an output, so that effects can give this output a lag and a delay. Before a run the quantity
    is taken to have changed at its first rate.

    Attributes:
        value: value of the quantity, in the channel's unit.
    """

    value: Expression

    def with_value(self, value: Expression) -> Self:
        """Replace the value that the sensor reads, in the unit of its channel."""
        return replace(self, value=value)


@dataclass(frozen=True, eq=False)
class Rate(Stage):
    """The stage ``"rate"``: time derivative of a state. It exists for states whose derivative is not another state.

    Attributes:
        state: name of the state.
        value: its time derivative, in the state's unit per s.
        time: time since the start of the run, s.
        given: states and inputs by name.
    """

    state: str
    value: Expression
    time: Expression
    given: Mapping[str, Expression]

    def __getitem__(self, name: str) -> Expression:
        """Value of the state or input `name`, such as ``"extra.voltage"``."""
        if name not in self.given:
            raise UnknownNameError("state or input", name, self.given)
        return self.given[name]

    def with_rate(self, more: Expression) -> Self:
        """Add `more`, in the state's unit per s, to the rate of the state."""
        return replace(self, value=self.value + more)


RATE_STAGE = "rate"
"""Name of the stage that contains the time derivative of a state; see `Rate`."""


@dataclass(frozen=True)
class Signal:
    """A recorded input of the equations, with its time derivatives.

    Attributes:
        value: value in the channel's unit.
        rate: first time derivative, per s.
        acceleration: second time derivative, per s^2.
    """

    value: Expression
    rate: Expression
    acceleration: Expression


@dataclass(frozen=True)
class Equations:
    """Result of a user's equations at one moment: rates of the states, and predicted readings.

    Attributes:
        rates: time derivative of every state, by name.
        outputs: predicted readings, by channel.
        against: quantities on which a missing force may depend, with units, by name; by default states and inputs. For
            a channel ``"q.<joint>"`` only names that end in the joint are used.
    """

    rates: Mapping[str, Expression]
    outputs: Mapping[str, "Expression | Reading"]
    against: Mapping[str, tuple[Expression, str]] = field(default_factory=dict)


class Moment:
    """Arguments of a user's equations at one moment: the time, and parameters, states and inputs by name.

    Args:
        time: time since the start of the run, s.
        values: values of parameters and states, by name.
        inputs: inputs by channel.
        effects: effects that act, in their order.
        by_name: values of the effects' parameters, by name.
        recorded: further recorded quantities that effects read; one that is missing has its usual value.
        states: names of the states among `values`.

    Attributes:
        changed_rates: rates of states with the effects on them, as `rate` returned them.
    """

    def __init__(
        self,
        time: Expression,
        values: Mapping[str, Expression],
        inputs: Mapping[str, Signal],
        effects: Sequence[Effect],
        by_name: Mapping[str, Expression],
        recorded: Mapping[RecordedColumn, Expression] = MappingProxyType({}),
        states: Collection[str] = (),
    ) -> None:
        self.time = time
        self.changed_rates: dict[str, Expression] = {}
        self.added_states: list[AddedState] = []
        self.stages: dict[str, list[str]] = {}
        self.kinds: dict[str, type] = {}
        self._values, self._inputs, self._effects, self._by_name = values, inputs, effects, by_name
        self._recorded, self._states = recorded, states

    def __getitem__(self, name: str) -> Expression:
        """Value of the parameter or state `name`."""
        if name not in self._values:
            raise UnknownNameError("parameter or state", name, self._values)
        return self._values[name]

    def input(self, channel: str) -> Signal:
        """The recorded input of this channel, with its derivatives."""
        if channel not in self._inputs:
            raise UnknownNameError("input", channel, self._inputs)
        return self._inputs[channel]

    def stage(self, name: str, stage: S, joint: str = "") -> S:
        """Apply all effects that act on a stage, and return the changed stage.

        Args:
            name: name of the stage, which effects state in `acts_on`.
            stage: the stage without any effect.
            joint: name of the joint, ``""`` where the stage occurs only once.
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
        self.added_states += stage.added_states
        return stage

    def rate(self, state: str, value: Expression) -> Expression:
        """Apply all effects that act on the rate of a state, and return the changed rate.

        Equations need it only where an output feels this rate, as an accelerometer does: then the output feels laws
        and other effects on the rate too. Return it as the rate of the state as well.

        Args:
            state: name of the state, whose rate is not just another state.
            value: its time derivative without effects, in the state's unit per s.
        """
        if state not in self._states:
            raise UnknownNameError("state", state, self._states)
        if state in self.changed_rates:
            raise ValueError(f"rate('{state}') is asked for twice: keep its result in a variable")
        states = {name: self._values[name] for name in self._states}
        if any(ca.is_equal(ca.SX(value), other, 2) for other in states.values()):
            raise ValueError(
                f"rate('{state}') is itself a state, which no effect changes: use that state in place of the call"
            )
        given = {**states, **{channel: signal.value for channel, signal in self._inputs.items()}}
        changed = self.stage(RATE_STAGE, Rate(state, value, self.time, given), state).value
        self.changed_rates[state] = changed
        return changed


@dataclass(frozen=True, eq=False)
class Physics:
    """A physics that a user declared: its parameters, states, inputs, outputs and equations.

    Attributes:
        name: its name.
        summary: one sentence about it.
        source: source of the equations.
        parameters: parameters that all runs share.
        states: by name, the value at the start of a run, one parameter per run; empty where the equations are
            algebraic.
        inputs: channels that must be recorded, with their units.
        held: inputs that keep their value from each sample to the next one.
        outputs: channels that are predicted, with their units.
        equations: function from a moment to the equations.
        period: approximate period of the motion, s. A run of this length determines the state at its start.
        step: longest step of the integration, s.
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
    """Decorate a function from a `Moment` to `Equations`, so that it becomes a `Physics`; arguments as its attributes.

    Between its samples an input is a smooth curve with a rate and an acceleration. An input that is `held`, such as the
    command of a controller, keeps its value until the next sample, and both derivatives are 0; so do a recorded
    ``q_cmd`` or ``v_cmd``, and an input that changes only in single jumps of unequal sizes.

    Raises:
        InputError: a channel is unknown or has another unit, a name is used twice, or there is nothing to fit.
    """
    for what, given in (("parameters", parameters), ("states", states), ("held", held)):
        if isinstance(given, Parameter | str):
            raise InputError(f"physics '{name}': {what} is not a tuple: write {what}=(...,), with a comma at its end")
    if not parameters or not outputs:
        raise InputError(f"physics '{name}': declare a parameter and an output at least")
    _check_declaration(f"physics '{name}'", "", period=period, step=step)
    step = DEFAULT_STEP_PERIODS * period if step is None else step
    for channel, unit in (*inputs.items(), *outputs.items()):
        if is_auxiliary(channel):
            with error_location(f"physics '{name}': {channel}"):
                to_base_units(unit)
        elif unit not in channel_units(channel, "channel"):
            raise InputError(f"physics '{name}': {channel} is in {' or '.join(channel_units(channel))}, not in {unit}")
    for channel in held:
        if channel not in inputs:
            raise UnknownNameError(f"held input of '{name}'", channel, inputs)
    if (
        not MIN_DECLARED_PERIOD_SECONDS <= period <= MAX_DECLARED_PERIOD_SECONDS
        or not MIN_DECLARED_PERIOD_SECONDS / 100 <= step <= period
    ):
        raise InputError(
            f"physics '{name}': its period is {period!r} s and its step {step!r} s: write a period from "
            f"{MIN_DECLARED_PERIOD_SECONDS:g} to {MAX_DECLARED_PERIOD_SECONDS:g} s, and a step of at most the period"
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
DEFAULT_STEP_PERIODS = 0.01
"""Default step of the integration, in periods of the motion: a Runge-Kutta step of this length is exact to 1e-7."""
MIN_DECLARED_PERIOD_SECONDS, MAX_DECLARED_PERIOD_SECONDS = 1e-6, 1e7
"""Shortest and longest period that a physics may declare, s; no recording contains a faster motion."""


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
        name: name without a dot.
        unit: SI unit as text.
        value: first guess.
        typical: a realistic size; by default the first guess.
        lower: smallest physical value.
        upper: largest physical value.
        summary: one phrase on the meaning of the number.
    """
    _check_declaration(f"parameter '{name}'", unit, value=value, typical=typical, lower=lower, upper=upper)
    size = abs(value) if typical is None else typical
    if not size > 0:
        raise InputError(f"parameter '{name}': give a typical size, above 0")
    return Parameter(name, unit, value, size, null=value, lower=lower, upper=upper, source=summary)


def state(
    name: str, unit: str, *, typical: float, start: float = 0.0, lower: float = -inf, upper: float = inf
) -> Parameter:
    """Declare a state of a physics; its value at the start of a run is fitted to every run.

    Args:
        name: name without a dot.
        unit: SI unit as text.
        typical: a realistic size.
        start: first guess of the value at the start of a run.
        lower: smallest physical value at the start.
        upper: largest physical value at the start.
    """
    _check_declaration(f"state '{name}'", unit, typical=typical, start=start, lower=lower, upper=upper)
    summary = f"{name} at the start of a run"
    return Parameter(f"{_START}{name}", unit, start, typical, start, None, lower, upper, None, "per_run", True, summary)


def _check_declaration(what: str, unit: object, **numbers: object) -> None:
    """Check the types of a declaration, whose arguments a user may have exchanged."""
    if not isinstance(unit, str):
        raise InputError(f"{what}: its unit is {unit!r}: write the name, then the unit as text, then numbers")
    for name, value in numbers.items():
        if value is not None and (isinstance(value, bool) or not isinstance(value, Real)):
            raise InputError(f"{what}: {name} is {value!r}: give a number")
