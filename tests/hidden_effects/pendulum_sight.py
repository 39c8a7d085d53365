"""What recordings of a pendulum show of the effects that are hidden in it: whether it is fair to ask for each.

From the derivatives of the true motion, which is exact for small effects, the ones in question.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from .output_error import Derivatives, sizes

VISIBLE = 2.0
"""Error without an effect, over the noise, from which on it is fair to ask for it."""
ALIKE = 4.0
"""Root of the rise of chi2, were the noise white, when a rival takes the place of an effect, up to which either name is
right."""
AS_LARGE = 1.25
"""Of two effects, what either leaves alone, up to which either may be named first."""
ROTATIONS = ("path_tilt", "wind")
"""What an offset of the angle cannot be told from while the pivot stands."""


@dataclass(frozen=True)
class Sight:
    """What training runs show of hidden effects; see `World`."""

    visible: Mapping[str, float]
    first: tuple[str, ...]
    alike: Mapping[str, frozenset[str]]


def sight_of(found: Derivatives, rivals: Sequence[str], samples: int, *, driven: bool) -> Sight | None:
    """None where something hidden is not visible."""
    hidden, adapted = tuple(found.pendulum.effects), found.nuisances
    if not hidden:
        return Sight({}, (), {})
    true = {effect: found.by(effect) * size for effect, size in sizes(found.pendulum, found.pendulum.effects).items()}
    beside = {effect: [adapted, *(found.by(e) for e in hidden if e != effect)] for effect in hidden}
    visible = {effect: left(true[effect], beside[effect]) for effect in hidden}
    if min(visible.values()) < VISIBLE:
        return None
    every = [r for r in dict.fromkeys([*rivals, *(() if driven else ("linear_drag",))]) if r not in hidden]
    close = ALIKE / np.sqrt(samples)
    alike = {
        effect: frozenset(
            [rival for rival in every if left(true[effect], [*beside[effect], found.by(rival)]) < close]
            + ([*ROTATIONS] if effect == "angle_offset" and not driven else [])
        )
        for effect in hidden
    }
    total = np.sum([*true.values()], axis=0)
    alone = {effect: left(total, [adapted, found.by(effect)]) for effect in hidden}
    least = max(min(alone.values()), close)
    return Sight(visible, tuple(effect for effect in hidden if alone[effect] <= AS_LARGE * least), alike)


def left(target: np.ndarray, adapted: Sequence[np.ndarray]) -> float:
    """Root mean square that a linear combination of columns leaves of a target."""
    columns = np.column_stack(adapted)
    columns = columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    rest = target - columns @ np.linalg.lstsq(columns, target, rcond=1e-9)[0]
    return float(np.sqrt(np.mean(rest**2)))
