"""Search for start values of thresholds (see `identify.thresholds`) in runs that are linearised around their motion."""

from dataclasses import replace

import numpy as np

from armdyn.identify.state_space.grey_box import GreyBox, LinearisationPoint
from armdyn.identify.state_space.noise_evidence import evaluate_all_kicks
from armdyn.identify.thresholds import likeliest_thresholds


def find_thresholds(
    box: GreyBox, point: LinearisationPoint, base: np.ndarray, seen: np.ndarray
) -> tuple[dict[int, float], dict[int, float]]:
    """Find the likeliest value of every threshold: an unknown without influence while its effect is absent.

    A limit that no run reaches is an effect without a size: it is absent at its null value, and present elsewhere.

    Args:
        box: all runs, which can be linearised around their motion.
        point: point at which the base model is optimised without effects.
        base: (P,) bool, unknowns of the base model that are fitted.
        seen: (P,) bool, unknowns that have an influence while all effects are absent.

    Returns:
        Thresholds by index of the unknown; those without any influence are left out. First those of effects that have
        a size too, then those that are the only value of their effect.
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
        itself = np.arange(len(own)) == place
        if not sized or not box.influential(here, itself)[place]:
            at = _likeliest(box, here, base | own, place)
            if np.isfinite(at) and sized:
                values[place] = found[place] = at
            elif np.isfinite(at):
                alone[place] = at
    return found, alone


def _likeliest(box: GreyBox, point: LinearisationPoint, free: np.ndarray, place: int) -> float:
    """The likeliest threshold `place` with (P,) `free` unknowns; NaN where it has no influence."""
    problem, tried = box.problem, dict[float, float]()

    def evidence(at: np.ndarray) -> np.ndarray:
        if (key := float(at[0])) not in tried:
            values = point.values.copy()
            values[place] = key
            there = replace(point, values=values)
            arounds = box.linearise(there, free)
            finite = all(around.finite for around in arounds)
            tables = box.evaluate_noises(arounds, there, evaluate_all_kicks) if finite else None
            worth = tables.evidence(free).log_evidence if tables is not None else -np.inf
            tried[key] = worth if np.isfinite(worth) else -np.inf
        return np.array([tried[key]])

    k = [place]
    return float(
        likeliest_thresholds(evidence, point.values[k], problem.typical[k], problem.lower[k], problem.upper[k])[0]
    )
