"""What the equations of a physics say without effects: its states, what measures them, and which effects change it."""

from collections.abc import Callable, Iterable, Sequence
from functools import lru_cache
from itertools import product
from typing import Any

import numpy as np

from armdyn.effects.catalogue import CATALOGUE
from armdyn.effects.effect import Effect
from armdyn.parameter import Parameter
from armdyn.physics.definition import Physics
from armdyn.physics.formulation import Formulation, formulate
from armdyn.run import Channel, Run

START_VALUES_TRIED_BY_STATE_COUNT = {1: 9, 2: 7, 3: 5, 4: 3}
"""Number of values tried for each unmeasured state at the start of a run, by the number of such states."""
MAX_START_DISTANCE_TYPICAL_SIZES = 2.0
"""Largest distance of tried start values from the first guess, in typical sizes."""


def shown_states(physics: Physics, run: Run, look: Callable[[Channel], Iterable[Any]]) -> dict[str, Any]:
    """Values of states by name, from channels of a run that measure them.

    Args:
        physics: the physics.
        run: the run.
        look: gives value and rate of a channel.
    """
    bare, values, rates = bare_formulation(physics), {}, {}
    for name, channel in bare.channel_by_measured_state.items():
        if channel in run.channels:
            values[name], rate = look(run.channels[channel])
            if name in bare.rates:
                rates[bare.rates[name]] = rate
    return {**rates, **values}  # a measured value is better than a slope


def start_grid(unknown: Sequence[Parameter]) -> list[dict[str, float]]:
    """Values of unknown start parameters, by name, from which a fit is tried; empty for none of them, and too many."""
    if len(unknown) not in START_VALUES_TRIED_BY_STATE_COUNT:
        return []
    levels = np.linspace(
        -MAX_START_DISTANCE_TYPICAL_SIZES,
        MAX_START_DISTANCE_TYPICAL_SIZES,
        START_VALUES_TRIED_BY_STATE_COUNT[len(unknown)],
    )
    values = [np.clip(p.value + levels * p.typical, p.lower, p.upper).tolist() for p in unknown]
    names = [p.name for p in unknown]
    return [dict(zip(names, at, strict=True)) for at in product(*values)]


@lru_cache(maxsize=64)
def bare_formulation(physics: Physics) -> Formulation:
    """The equations of a physics without effects."""
    return formulate(physics, (), tuple(p.name for p in physics.parameters))


@lru_cache(maxsize=512)
def joints_changed_by(physics: Physics, effect: Effect) -> tuple[str, ...]:
    """Joints of its stage on which an effect changes something; empty where the stage is of another type."""
    kind = bare_formulation(physics).stage_classes.get(effect.acts_on)
    if kind is None or (effect.name in CATALOGUE and not issubclass(kind, effect.stage_class)):
        return ()
    joints = bare_formulation(physics).stages[effect.acts_on]
    names = {j: [q.parameter(effect.name, short, j).name for short, q in effect.quantities.items()] for j in joints}
    everything = (*(p.name for p in physics.parameters), *(n for ns in names.values() for n in ns))
    depends = formulate(physics, (effect.on(),), everything).acting_parameters
    return tuple(joint for joint in joints if any(name in depends for name in names[joint]))


@lru_cache(maxsize=512)
def adds_states(physics: Physics, effect: Effect) -> bool:
    """Whether an effect adds states to a physics."""
    joints = effect.joints or bare_formulation(physics).stages[effect.acts_on]
    names = [q.parameter(effect.name, short, j).name for j in joints for short, q in effect.quantities.items()]
    with_it = formulate(physics, (effect,), (*(p.name for p in physics.parameters), *names))
    return with_it.state_count > bare_formulation(physics).state_count
