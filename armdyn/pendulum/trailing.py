"""A gripper that trails its measured path."""

from dataclasses import dataclass
from functools import cached_property
from typing import TypeAlias

import numpy as np

from armdyn.pendulum.path import GripperPath, jerk
from armdyn.physics.motion import halfway
from armdyn.readout import lagged

_Signals: TypeAlias = tuple[np.ndarray, np.ndarray, tuple[np.ndarray, np.ndarray]]


@dataclass(frozen=True, eq=False)
class TrailingPath:
    """The path behind a first-order lag, with its derivative with respect to the lag.

    tau z' + z = x, from a start at constant acceleration: z(0) = x - tau v + tau^2 a. Position, velocity and
    acceleration pass the same lag, each exactly for the signal that is linear between the nodes.

    Attributes:
        measured: what the encoders say.
        lag: tau, s.
    """

    measured: GripperPath
    lag: float

    @property
    def start(self) -> float:
        """Time of the first node, s."""
        return self.measured.start

    @property
    def dt(self) -> float:
        """Grid step, s."""
        return self.measured.dt

    def rows(self, *, with_jerk: bool) -> tuple[np.ndarray, np.ndarray]:
        """As of `GripperPath`, followed by their derivatives with respect to the lag."""
        parts = [self.inputs, *([self.jerk] if with_jerk else ()), self.inputs_by_lag]
        if with_jerk:
            parts.append(self.jerk_by_lag)
        nodes, middle = zip(*parts, strict=True)
        return np.vstack(nodes), np.vstack(middle)

    @property
    def inputs(self) -> tuple[np.ndarray, np.ndarray]:
        """As of `GripperPath`."""
        return self._values[:2]

    @property
    def jerk(self) -> tuple[np.ndarray, np.ndarray]:
        """As of `GripperPath`."""
        return self._values[2]

    @property
    def inputs_by_lag(self) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of `inputs` with respect to the lag."""
        return self._slopes[:2]

    @property
    def jerk_by_lag(self) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of `jerk` with respect to the lag."""
        return self._slopes[2]

    @property
    def _values(self) -> _Signals:
        return self._signals[0]

    @property
    def _slopes(self) -> _Signals:
        return self._signals[1]

    @cached_property
    def _signals(self) -> tuple[_Signals, _Signals]:
        path, tau = self.measured, self.lag
        starts = (path.x[0] - tau * path.v[0] + tau**2 * path.a[0], path.v[0] - tau * path.a[0], path.a[0])
        slopes = (2 * tau * path.a[0] - path.v[0], -path.a[0], 0.0)
        pairs = [
            lagged(signal[:, None], tau, path.dt, start, slope)
            for signal, start, slope in zip((path.x, path.v, path.a), starts, slopes, strict=True)
        ]
        trailed, by_lag = (np.vstack([signal.ravel() for signal in signals]) for signals in zip(*pairs, strict=True))
        nodes, middle = path.inputs
        return (
            (_with_motion(nodes, trailed), _with_motion(middle, halfway(trailed, path.dt)), jerk(trailed[2], path.dt)),
            (
                _with_motion(0 * nodes, by_lag),
                _with_motion(0 * middle, halfway(by_lag, path.dt)),
                jerk(by_lag[2], path.dt),
            ),
        )


def _with_motion(rows: np.ndarray, motion: np.ndarray) -> np.ndarray:
    """Inputs with other x, v, a."""
    return np.vstack([rows[:1], motion, rows[4:]])
