"""Derive from a physics and its effects the functions that the simulator and the sensors need."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache

import casadi as ca

from armdyn.effects.effect import Effect, recorded_columns
from armdyn.errors import InputError, UnknownNameError
from armdyn.physics.definition import RATE_STAGE, Equations, Expression, Moment, Physics, Rate, Reading, Signal
from armdyn.physics.simulate import System
from armdyn.readout import SensorReadout

DERIVATIVES_PER_INPUT = 3
"""Number of entries per input: its value, rate and acceleration."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Formulation(System):
    """The equations of a physics with a set of effects, as CasADi functions.

    The states are those of the physics, which also define the start of a motion, then those of effects. The inputs are
    the time, then value, rate and acceleration of each recorded channel, then the further quantities that effects read.

    Attributes:
        slopes: ``(s, w, theta) -> (n, n)`` derivatives of the rates by the states.
        against: ``(s, w, theta) -> (n,)`` quantities on which a missing force may depend.
        against_units: names of these quantities, with their units.
        acting_parameters: parameters on which at least one function depends.
        channel_by_measured_state: by state, the channel that measures it directly.
        rates: by state, the other state that is its time derivative.
        stages: stages on which effects may act, with the joints of each.
        stage_classes: class of each stage, by its name.
    """

    slopes: ca.Function
    against: ca.Function
    against_units: dict[str, str]
    acting_parameters: frozenset[str]
    channel_by_measured_state: dict[str, str]
    rates: dict[str, str]
    stages: dict[str, tuple[str, ...]]
    stage_classes: dict[str, type]


@lru_cache(maxsize=128)
def formulate(
    physics: Physics, effects: tuple[Effect, ...], names: tuple[str, ...], *, stiff: bool = False
) -> Formulation:
    """Derive the equations of a physics together with its effects.

    Args:
        physics: the physics.
        effects: effects in their natural order.
        names: parameters in the order of theta, without those of the start.
        stiff: whether a simulation takes implicit steps.

    Raises:
        InputError: the equations or an effect cannot be used.
    """
    time, theta = ca.SX.sym("t"), ca.SX.sym("theta", len(names))
    by_name = dict(zip(names, ca.vertsplit(theta), strict=True))
    nothing = ca.SX(0, 1)
    own = {p.name: by_name[p.name] for p in physics.parameters}
    states = {name: ca.SX.sym(name) for name in physics.states}
    symbols = {channel: ca.SX.sym(channel.replace(".", "_"), DERIVATIVES_PER_INPUT) for channel in physics.inputs}
    signals = {channel: Signal(*ca.vertsplit(symbol)) for channel, symbol in symbols.items()}
    recorded = {column: ca.SX.sym("recorded") for column in recorded_columns(effects)}
    moment = Moment(time, {**own, **states}, signals, effects, by_name, recorded, tuple(states))
    found = _asked(physics, moment)
    rates_of = _with_rates(physics, moment, found, states)
    readings = {n: v if isinstance(v, Reading) else Reading(v) for n, v in found.outputs.items()}
    memory = moment.added_states
    s = ca.vertcat(nothing, *states.values(), *(m.symbol for m in memory))
    w = ca.vertcat(time, *symbols.values(), *recorded.values())
    rates = ca.vertcat(nothing, *rates_of.values(), *(m.rate for m in memory))
    values = ca.vertcat(*(readings[channel].value for channel in physics.outputs))
    timing = ca.vertcat(*(ca.horzcat(readings[c].lag, readings[c].delay) for c in physics.outputs))
    beginning = ca.vertcat(nothing, *states.values(), *(m.start for m in memory))
    _check(physics, ca.vertcat(rates, values), [s, w, theta], "depends on something that it was not given")
    _check(physics, timing, [theta], "lets a lag or delay change with the motion")
    _check(physics, beginning, [*states.values(), w, theta], "lets a state begin with a value that is not known then")
    against = dict(found.against) or {
        **{name: (states[name], p.unit) for name, p in physics.states.items()},
        **{channel: (signals[channel].value, unit) for channel, unit in physics.inputs.items()},
    }
    held_against = ca.densify(ca.vertcat(nothing, *(expression for expression, _ in against.values())))
    everything = ca.vertcat(rates, values, beginning, ca.reshape(timing, -1, 1))
    depends = ca.which_depends(everything, theta, 1, False)
    return Formulation(
        names=names,
        stiff=stiff,
        state_count=s.numel(),
        start_value_count=len(states),
        input_count=w.numel(),
        recorded_columns=tuple(recorded),
        outputs=tuple(physics.outputs),
        derivative=ca.Function("derivative", [s, w, theta], [ca.densify(rates)]),
        output=ca.Function("output", [s, w, theta], [ca.densify(values)]),
        initial=ca.Function("initial", [*states.values(), w, theta], [ca.densify(beginning)]),
        slopes=ca.Function("slopes", [s, w, theta], [ca.densify(ca.jacobian(rates, s))]),
        against=ca.Function("against", [s, w, theta], [held_against]),
        against_units={name: unit for name, (_, unit) in against.items()},
        sensors={n: SensorReadout(theta, lag=readings[n].lag, delay=readings[n].delay) for n in physics.outputs},
        acting_parameters=frozenset(name for name, used in zip(names, depends, strict=True) if used),
        channel_by_measured_state={
            n: c for c in physics.outputs for n, x in states.items() if _same(readings[c].value, x)
        },
        rates={n: m for n in states for m, x in states.items() if _same(rates_of[n], x)},
        stages={name: tuple(joints) for name, joints in moment.stages.items()},
        stage_classes=moment.kinds,
    )


def _with_rates(
    physics: Physics, moment: Moment, found: Equations, states: Mapping[str, Expression]
) -> dict[str, Expression]:
    """The rate of every state; effects may change those that are not states themselves."""
    for name, changed in moment.changed_rates.items():
        if not _same(found.rates[name], changed):
            raise InputError(
                f"the equations of '{physics.name}' ask for rate('{name}') and return another rate of '{name}': "
                f'return what it gave, rates={{"{name}": ...}}'
            )
    own = moment.kinds.get(RATE_STAGE, Rate) is not Rate
    rates = dict[str, Expression]()
    for name in states:
        rate, changed = found.rates[name], name in moment.changed_rates
        if not (own or changed or any(_same(rate, other) for other in states.values())):
            rate = moment.rate(name, rate)
        rates[name] = rate
    return rates


def _asked(physics: Physics, moment: Moment) -> Equations:
    """Evaluate the equations; errors of the user's file become messages."""
    try:
        found = physics.equations(moment)
    except (AttributeError, TypeError, ValueError, ZeroDivisionError, NotImplementedError) as error:
        fault = f"{type(error).__name__}: {error}"
        raise InputError(f"the equations of '{physics.name}' fail with {fault}: correct their file") from error
    if not isinstance(found, Equations):
        raise InputError(f"the equations of '{physics.name}' return a {type(found).__name__}: return Equations(...)")
    for what, given, wanted in (("state", found.rates, physics.states), ("output", found.outputs, physics.outputs)):
        for name in given:
            if name not in wanted:
                raise UnknownNameError(f"{what} of '{physics.name}'", name, wanted)
        if missing := [name for name in wanted if name not in given]:
            raise InputError(f"the equations of '{physics.name}' say nothing of the {what} '{missing[0]}'")
    return found


def _check(physics: Physics, expression: Expression, given: list[Expression], fault: str) -> None:
    known = {symbol.element_hash() for vector in given for symbol in ca.vertsplit(vector)}
    if any(symbol.element_hash() not in known for symbol in ca.symvar(ca.SX(expression))):
        raise InputError(f"physics '{physics.name}': an effect or the equations {fault}: correct their file")


def _same(one: Expression, other: Expression) -> bool:
    return bool(ca.is_equal(ca.SX(one), other, 2))
