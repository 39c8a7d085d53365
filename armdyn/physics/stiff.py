"""Choose the step of an integration so that it is stable with any equations and effects.

An explicit Runge-Kutta step h of order 4 damps a decay with rate r only where r h < 2.78 (Hairer & Wanner, Solving
Ordinary Differential Equations II, 1996, §IV.2). Dry friction of 5 N on 1 kg that reverses over 1 mm/s decays at
5000/s: with steps of 0.01 s the motion would oscillate by the friction's impulse for ever, instead of resting.
"""

from functools import lru_cache
from itertools import product
from math import ceil, log2

import casadi as ca
import numpy as np

from armdyn.effects.effect import Effect
from armdyn.physics.definition import Physics
from armdyn.physics.formulation import Formulation, formulate

TYPICAL_STEP_TIMES_DECAY_RATE = 1.4
"""Product of the step and the fastest decay rate for typical effects: half the stability limit, since an effect may
have twice its typical size."""
MAX_STEP_TIMES_DECAY_RATE = 2.1
"""Largest product of the step and the fastest decay rate at fitted values: three quarters of the stability limit. Above
it the step is divided."""
EIGENVALUE_BOUND_SQUARINGS = 4
"""Number of squarings of a matrix in the bound of its largest eigenvalue; the bound is rarely 1.5 times too large."""
MAX_STEP_SHORTENING_FACTOR = 50.0
"""Largest factor by which integration steps are shortened; for faster decays they are implicit, as long as declared."""
MAX_STATE_COMBINATIONS = 729
"""Largest number of combinations of states at which decay rates are computed; with more states only one state at a time
is varied."""


def stable_step(physics: Physics, effects: tuple[Effect, ...]) -> float:
    """Step of the integration, s: the declared step of the physics, or a shorter one that all effects need."""
    fastest = _fastest_of_all(physics, effects)
    if fastest == 0.0 or is_stiff(physics, effects):
        return physics.step
    return min(physics.step, TYPICAL_STEP_TIMES_DECAY_RATE / fastest)


def is_stiff(physics: Physics, effects: tuple[Effect, ...]) -> bool:
    """Whether a state decays so fast that steps of the declared length must be implicit."""
    longest = MAX_STEP_SHORTENING_FACTOR * TYPICAL_STEP_TIMES_DECAY_RATE
    return _fastest_of_all(physics, effects) * physics.step > longest


@lru_cache(maxsize=512)
def _fastest_of_all(physics: Physics, effects: tuple[Effect, ...]) -> float:
    """Largest rate, 1/s, with no effect or one of the effects."""
    return max(_fastest(physics, some) for some in ((), *((one,) for one in effects)))


@lru_cache(maxsize=512)
def _fastest(physics: Physics, effects: tuple[Effect, ...]) -> float:
    """Largest rate, 1/s, of decay or oscillation near the start of the states; 0 without states."""
    bare = formulate(physics, (), tuple(p.name for p in physics.parameters))
    sizes = {p.name: p.value for p in physics.parameters}
    for one in effects:
        for joint in one.joints or bare.stages.get(one.acts_on, ()):
            for short, quantity in one.quantities.items():
                p = quantity.parameter(one.name, short, joint)
                on = p.null if p.null else p.null + p.typical
                sizes[p.name] = float(np.clip(on, p.lower, p.upper))
    system = formulate(physics, effects, tuple(sizes))
    if not system.state_count:
        return 0.0
    return float(np.abs(np.linalg.eigvals(_slopes(system, physics, np.array(list(sizes.values()))))).max(initial=0.0))


def stable_step_divisions(system: Formulation, physics: Physics, theta: np.ndarray, step: float) -> int:
    """Number of parts, a power of two, into which a `step`, s, is divided so that it is stable at (p,) `theta`.

    A fit may make a value many times larger than its first guess or typical size.
    """
    if not system.state_count or system.stiff:
        return 1
    slopes = _slopes(system, physics, theta)
    power = slopes
    for _ in range(EIGENVALUE_BOUND_SQUARINGS):
        power = power @ power
    # The root of the norm of a power is at least the largest rate, and near it (Gelfand 1941).
    bound = np.linalg.norm(power, axis=(1, 2)) ** (1.0 / 2**EIGENVALUE_BOUND_SQUARINGS)
    near = slopes[bound * step > MAX_STEP_TIMES_DECAY_RATE]
    fastest = float(np.abs(np.linalg.eigvals(near)).max(initial=0.0))
    needed = min(fastest * step / MAX_STEP_TIMES_DECAY_RATE, MAX_STEP_SHORTENING_FACTOR * step / physics.step)
    return 2 ** ceil(log2(needed)) if needed > 1.0 else 1


def _slopes(system: Formulation, physics: Physics, theta: np.ndarray) -> np.ndarray:
    """(k, n, n) derivatives of the rates by the states at their start and to both sides, where they are finite."""
    n, states = system.state_count, _states(system, physics)
    found = np.asarray(_many(system, len(states))(states.T, np.zeros(system.input_count), theta))
    slopes = found.reshape(n, len(states), n).transpose(1, 0, 2)
    return np.asarray(slopes[np.isfinite(slopes).all(axis=(1, 2))])


@lru_cache(maxsize=64)
def _many(system: Formulation, points: int) -> ca.Function:
    return system.slopes.map(points)


@lru_cache(maxsize=64)
def _states(system: Formulation, physics: Physics) -> np.ndarray:
    """(k, n) states at their start and, of those on which the derivatives depend, to both sides."""
    s, w, theta = (ca.SX.sym("x", size) for size in (system.state_count, system.input_count, len(system.names)))
    matters = ca.which_depends(ca.vec(system.slopes(s, w, theta)), s, 1, False)
    starts = [p.value + p.typical * np.array([0.0, -1.0, 1.0][: 3 if matters[k] else 1])
              for k, p in enumerate(physics.states.values())]  # fmt: skip
    if np.prod([len(each) for each in starts]) <= MAX_STATE_COMBINATIONS:
        points = np.array(list(product(*starts)))
    else:
        middle = np.array([each[0] for each in starts])
        points = np.array([np.where(np.arange(len(middle)) == k, value, middle)
                           for k, each in enumerate(starts) for value in each])  # fmt: skip
    states = np.zeros((len(points), system.state_count))
    states[:, : points.shape[1]] = points
    return states
