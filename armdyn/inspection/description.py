"""Correct possible errors in the description of an arm, and in what its torque sensors measure."""

from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from armdyn.readout import first_order_lag


@dataclass(frozen=True)
class DescriptionCorrection:
    """Correction of possible errors in the description of an arm and in what its torque sensors measure.

    Attributes:
        gravity: (3,) gravity in the frame of the base, m/s^2; None means that of the model.
        mass: factor on all masses and inertias.
        length: factor on all lengths.
        lag: time constant of a low-pass on the torques, s.
        magnitudes: whether the torques were recorded without sign.
        compensated: whether the weight of the described arm, without a payload, was subtracted from the torques.
    """

    gravity: tuple[float, float, float] | None = None
    mass: float = 1.0
    length: float = 1.0
    lag: float = 0.0
    magnitudes: bool = False
    compensated: bool = False

    @property
    def of_logger(self) -> bool:
        """Whether only what a logger recorded of the torques is corrected, not the description."""
        return replace(self, lag=0.0, magnitudes=False, compensated=False) == DescriptionCorrection()

    def corrected_model(self, model: pin.Model) -> pin.Model:
        """The rigid-body model of the arm with these errors corrected."""
        if self.of_logger:
            return model
        changed = model.copy()
        if self.gravity is not None:
            changed.gravity.linear = np.array(self.gravity)
        if self.length != 1.0:
            for i, placement in enumerate(list(model.jointPlacements)):
                changed.jointPlacements[i] = pin.SE3(placement.rotation, self.length * placement.translation)
        for i, inertia in enumerate(list(model.inertias)):
            lever, moment = self.length * inertia.lever, self.mass * self.length**2 * inertia.inertia
            changed.inertias[i] = pin.Inertia(self.mass * inertia.mass, lever, moment)
        return changed

    def as_recorded(self, time: np.ndarray, *parts: np.ndarray) -> tuple[np.ndarray, ...]:
        """Torques (J, n) and their derivatives (J, n, k) as they would be recorded at times (n,), s."""
        if self.lag:
            parts = tuple(_lagged(time, part, self.lag) for part in parts)
        return with_sign_of_total(parts[0], *parts) if self.magnitudes else parts


def with_sign_of_total(whole: np.ndarray, *parts: np.ndarray) -> tuple[np.ndarray, ...]:
    """Multiply parts (J, n, ...) of torques `whole` (J, n) by the sign of the torques, as in recorded magnitudes."""
    sign = np.where(whole < 0.0, -1.0, 1.0)
    return tuple(sign.reshape(sign.shape + (1,) * (part.ndim - 2)) * part for part in parts)


def _lagged(time: np.ndarray, value: np.ndarray, lag: float) -> np.ndarray:
    """(J, n, ...) values after a first-order lag, exact for straight lines between the times (n,)."""
    series = np.moveaxis(value, 1, 0)
    found, _ = first_order_lag(series.reshape(len(time), -1), lag, np.diff(time))
    return np.moveaxis(found.reshape(series.shape), 0, 1)


AS_DESCRIBED = DescriptionCorrection()
NOTHING_DESCRIBED = (DescriptionCorrection(mass=0.0), DescriptionCorrection(mass=0.0, length=0.0))
"""Corrections that remove all masses, and all lengths, so that the model explains no torque."""
