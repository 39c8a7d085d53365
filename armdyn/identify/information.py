"""How much a motion tells about the parameters: Fisher information and the bound that follows from it."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from armdyn.errors import InputError
from armdyn.model import Model
from armdyn.run import Run


@dataclass(frozen=True)
class Information:
    """Fisher information of one or more runs.

    Attributes:
        names: parameters, in the order of the matrix.
        matrix: (p, p) sum of s s' / sigma^2 over the samples, with the priors' 1/std^2 on the diagonal.
    """

    names: tuple[str, ...]
    matrix: np.ndarray

    def covariance(self) -> np.ndarray:
        """(p, p) Cramér-Rao bound on the covariance of any unbiased estimate.

        Raises:
            InputError: the runs do not determine the parameters; the message names the worst.
        """
        scale = np.sqrt(np.diag(self.matrix))
        if not np.all(scale > 0):
            blind = [n for n, s in zip(self.names, scale, strict=True) if not s > 0]
            raise InputError(f"these runs say nothing about {', '.join(blind)}: fix them or give a richer motion")
        values, vectors = np.linalg.eigh(self.matrix / np.outer(scale, scale))
        if values[0] < 1e-14 * values[-1]:
            tangled = [n for n, w in zip(self.names, vectors[:, 0], strict=True) if abs(w) > 0.1]
            raise InputError(
                f"these runs cannot tell {' from '.join(tangled)}: fix one of them or give a richer motion"
            )
        return (vectors / values) @ vectors.T / np.outer(scale, scale)

    def std(self) -> dict[str, float]:
        """Smallest possible standard deviation by parameter, in its unit."""
        return dict(zip(self.names, np.sqrt(np.diag(self.covariance())).tolist(), strict=True))


def fisher_information(model: Model, run: Run, noise: Mapping[str, float], names: tuple[str, ...]) -> Information:
    """Information of a run about some parameters of a model, the others being known.

    I = sum_i (dy_i/dtheta) (dy_i/dtheta)' / sigma_i^2 + diag(1/prior std^2)   (Kay, Estimation Theory, 1993, §3.9).

    Args:
        model: at the parameters where the information is wanted.
        run: gives the motion and the sample times; its measured values do not matter.
        noise: standard deviation per channel, in the channel's unit.
        names: parameters of interest.
    """
    prediction = model.predict(run, model.theta())
    columns = [model.names.index(name) for name in names]
    scaled = prediction.sensitivities[:, columns].copy()
    for channel, rows in prediction.slices.items():
        scaled[rows] /= noise[channel]
    matrix = scaled.T @ scaled
    for i, name in enumerate(names):
        prior = model.parameters[name].prior
        if prior is not None:
            matrix[i, i] += 1.0 / prior.std**2
    return Information(names, matrix)
