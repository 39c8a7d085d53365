"""Choose the step of an integration so that it is stable for any base and effects.

An explicit Runge-Kutta step h of order 4 damps a decay with rate r only where r h < 2.78 (Hairer & Wanner, Solving
Ordinary Differential Equations II, 1996, §IV.2). Dry friction of 5 N on 1 kg that reverses over 1 mm/s decays at
5000/s: with steps of 0.01 s the motion would oscillate by the friction's impulse for ever, instead of resting.
"""

from functools import lru_cache
from itertools import product

import numpy as np

from armdyn.effects.effect import Effect
from armdyn.physics.definition import Physics
from armdyn.physics.formulation import Formulation, formulated

STABLE_STEP_RATE = 1.4
"""Step times the fastest rate: half of the stable limit, since an effect may be twice its typical size."""
MAX_STEP_DIVISION = 50.0
"""Largest factor by which steps are shortened; a faster motion needs a smoother law."""
MAX_STATE_COMBINATIONS = 729
"""Number of combinations of states that are evaluated, at their start and to both sides; above it single states are
varied."""


@lru_cache(maxsize=512)
def longest_step(physics: Physics, effects: tuple[Effect, ...]) -> float:
    """Step of the integration, s: the one that the physics declares, or a shorter one, stable with each effect."""
    fastest = max(_fastest(physics, some) for some in ((), *((one,) for one in effects)))
    return max(
        min(physics.step, STABLE_STEP_RATE / fastest if fastest > 0.0 else np.inf), physics.step / MAX_STEP_DIVISION
    )


@lru_cache(maxsize=512)
def _fastest(physics: Physics, effects: tuple[Effect, ...]) -> float:
    """Largest rate, 1/s, of decay or oscillation near the start of the states; 0 without states."""
    bare = formulated(physics, (), tuple(p.name for p in physics.parameters))
    sizes = {p.name: p.value for p in physics.parameters}
    for one in effects:
        for joint in one.joints or bare.stages.get(one.acts_on, ()):
            for short, quantity in one.quantities.items():
                p = quantity.parameter(one.name, short, joint)
                on = p.null if p.null else p.null + p.typical
                sizes[p.name] = float(np.clip(on, p.lower, p.upper))
    system = formulated(physics, effects, tuple(sizes))
    return _largest_rate(system, physics, np.array(list(sizes.values()))) if system.states else 0.0


def _largest_rate(system: Formulation, physics: Physics, theta: np.ndarray) -> float:
    starts = [p.value + p.typical * np.array([0.0, -1.0, 1.0]) for p in physics.states.values()]
    if 3 ** len(starts) <= MAX_STATE_COMBINATIONS:
        points = np.array(list(product(*starts)))
    else:
        middle = np.array([each[0] for each in starts])
        points = np.array([np.where(np.arange(len(middle)) == k, each[i], middle)
                           for k, each in enumerate(starts) for i in range(3)])  # fmt: skip
    states = np.zeros((len(points), system.states))
    states[:, : points.shape[1]] = points
    return max(_rate(system, state, theta) for state in states)


def _rate(system: Formulation, state: np.ndarray, theta: np.ndarray) -> float:
    found = np.asarray(system.slopes(state, np.zeros(system.inputs), theta))
    return float(np.abs(np.linalg.eigvals(found)).max()) if np.isfinite(found).all() else 0.0
