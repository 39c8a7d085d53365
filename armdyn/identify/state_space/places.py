"""Thresholds of absent effects in runs that are linearised around their motion; see `thresholds`."""

from dataclasses import replace

import numpy as np

from armdyn.identify.state_space.grey_box import GreyBox, NoiseAndMotion
from armdyn.identify.state_space.noise_evidence import at_every_kick
from armdyn.identify.thresholds import likeliest


def places(
    box: GreyBox, point: NoiseAndMotion, base: np.ndarray, seen: np.ndarray
) -> tuple[dict[int, float], dict[int, float]]:
    """Find the likeliest threshold, by unknown, of every effect that has one, and of those with no other value.

    A limit that no run reaches is an effect without a size: it is absent at its null value, and present elsewhere.

    Args:
        box: all runs, linearised around their motion.
        point: point at which the base is optimised.
        base: (P,) bool, unknowns of the base that are fitted.
        seen: (P,) bool, unknowns that change something while all effects are absent.
    """
    problem, values = box.problem, point.values.copy()
    found, alone = dict[int, float](), dict[int, float]()
    hidden = problem.is_effect & box.removable & ~problem.per_run & ~seen
    for place in np.flatnonzero(hidden).tolist():
        effect = problem.columns[place].parameter
        own = np.array(
            [(c.parameter.effect, c.parameter.joint) == (effect.effect, effect.joint) for c in problem.columns]
        )
        sized = own.sum() > 1
        own[place] = not sized
        here = replace(point, values=values)
        if not sized or not box.seen(here)[place]:
            at = _likeliest(box, here, base | own, place)
            if np.isfinite(at) and sized:
                values[place] = found[place] = at
            elif np.isfinite(at):
                alone[place] = at
    return found, alone


def _likeliest(box: GreyBox, point: NoiseAndMotion, free: np.ndarray, place: int) -> float:
    """The likeliest threshold `place` with (P,) `free` unknowns; NaN where it has no influence."""
    problem, tried = box.problem, dict[float, float]()

    def evidence(at: np.ndarray) -> np.ndarray:
        if (key := float(at[0])) not in tried:
            values = point.values.copy()
            values[place] = key
            there = replace(point, values=values)
            arounds = box.around(there, free)
            finite = all(around.finite for around in arounds)
            worth = box.tables(arounds, there, at_every_kick).evidence(free).value if finite else -np.inf
            tried[key] = worth if np.isfinite(worth) else -np.inf
        return np.array([tried[key]])

    k = [place]
    return float(likeliest(evidence, point.values[k], problem.typical[k], problem.lower[k], problem.upper[k])[0])
