"""How far one effect can stand in for another in given runs, so that neither swallows the other unseen."""

from collections.abc import Mapping, Sequence

import numpy as np

from armdyn.effects.effect import Effect
from armdyn.model import Model
from armdyn.run import Run


def imitated_share(
    model: Model, runs: Sequence[Run], noise: Mapping[str, float], effect: Effect, by: Effect
) -> Mapping[str, float]:
    """Squared multiple correlation of each parameter of `effect` with all parameters of `by` and of the model.

    1 - |d - Q Q' d|^2 / |d|^2, d the derivative by the parameter over the noise, Q = orth(derivatives by the others): 1
    where these runs cannot tell the parameter from the others at all. A gravity spring on a shoulder and the first
    moment of the upper arm come to 0.999 and more; what then decides is whether a body could have that moment.

    Args:
        model: without either effect.
        runs: as `Model.prepared` returns them.
        noise: standard deviation by channel, in its unit.
        effect: the one that may be imitated.
        by: the one that may imitate it.

    Returns:
        By parameter of `effect`; those that change nothing in these runs are left out.
    """
    both = model.with_effect(effect).with_effect(by)
    own = [name for name in both.names if name.startswith(f"{effect.name}.")]
    derivatives = np.vstack([_weighted(both, run, noise) for run in runs])
    columns = [both.names.index(name) for name in own]
    others = np.delete(derivatives, columns, axis=1)
    size = np.linalg.norm(others, axis=0)
    U, s, _ = np.linalg.svd(others[:, size > 0] / size[size > 0], full_matrices=False)
    Q = U[:, s > 1e-10 * s.max(initial=0.0)]
    shares = {}
    for name, i in zip(own, columns, strict=True):
        d = derivatives[:, i]
        total = float(d @ d)
        if total > 0.0:
            left = d - Q @ (Q.T @ d)
            shares[name] = 1.0 - float(left @ left) / total
    return shares


def _weighted(model: Model, run: Run, noise: Mapping[str, float]) -> np.ndarray:
    prediction = model.predict(run, model.theta())
    rows = prediction.sensitivities.copy()
    for channel, samples in prediction.slices.items():
        rows[samples] /= noise[channel]
    return rows
