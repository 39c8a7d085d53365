"""How much an effect does in recordings: what a model loses that must do without it."""

from collections.abc import Collection

import numpy as np

from armdyn.identify.fit import Fit


def contribution(fit: Fit, effects: Collection[str]) -> dict[str, float]:
    """By channel, root mean square of what `effects` change in the predictions of the fitted runs, in its unit."""
    problem = fit.problem
    own = np.array([column.parameter.effect in effects for column in problem.columns])
    without = np.where(own, problem.null, fit.values)
    changed: dict[str, list[np.ndarray]] = {}
    for here, there in zip(problem.blocks(fit.values), problem.blocks(without), strict=True):
        changed.setdefault(here.channel, []).append(there.misfit - here.misfit)
    return {channel: float(np.sqrt(np.mean(np.concatenate(parts) ** 2))) for channel, parts in changed.items()}
