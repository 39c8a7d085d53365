"""Reduce the parts of a predicted torque to samples of its channel; parts without parameters are cached."""

from collections.abc import Callable
from functools import cache, cached_property
from typing import NamedTuple

import numpy as np

from armdyn.arm.bodies import MotionSamples
from armdyn.arm.composition import DIRECTION_INPUT_INDEX, PartlyLinearTorque
from armdyn.arm.motion import MeasuredMotion
from armdyn.parameter import RecordedColumn


class TorqueWithDerivatives:
    """Sum of the parts of a predicted torque, with derivatives by the parameters of several joints.

    Args:
        size: number N of coefficients or samples.
        widths: number of parameters by joint.

    Attributes:
        block: (N, 1 + sum of the widths) torque and derivatives.
        value: (N,) view of the torque.
        columns: columns of the block by joint.
    """

    def __init__(self, size: int, widths: dict[int, int]) -> None:
        ends = np.cumsum([1, *widths.values()]).tolist()
        self.columns = {joint: slice(*ends[i : i + 2]) for i, joint in enumerate(widths)}
        self.block = np.zeros((size, ends[-1]))
        self.value = self.block[:, 0]

    def by(self, joint: int) -> np.ndarray:
        """(N, k) view of the derivatives by a joint's parameters."""
        return self.block[:, self.columns[joint]]


class NonlinearTerm(NamedTuple):
    """Last value of the nonlinear rest of a term: the values that it depends on, coefficients, slopes by link."""

    key: bytes
    coefficients: np.ndarray
    slopes: dict[int, np.ndarray]


class Reduction:
    """Reduction of signals at the stamps of a torque, with a cache of reduced signals.

    Args:
        reduce: linear map of (n, m) signals at the stamps to (N, m).
        stretch: the motion at the stamps.
        joint: index of the joint whose torque is predicted.
        earlier: signals some time before each stamp; None means those at the stamps.
    """

    def __init__(
        self,
        reduce: Callable[[np.ndarray], np.ndarray],
        stretch: MotionSamples,
        joint: int,
        earlier: "DelayedInputs | None" = None,
    ) -> None:
        self.reduce = reduce
        self._stretch, self._joint = stretch, joint
        self.inputs = cache(stretch.inputs if earlier is None else earlier.inputs)
        self.signal: Callable[[np.ndarray], np.ndarray] = (lambda s: s) if earlier is None else earlier.signal
        self.link = cache(lambda link: reduce(stretch.regressor[:, joint, link]))
        # No method: a circle of references would keep the large arrays until Python collects circles.
        self.weight = cache(
            lambda link: _reduced_weight(reduce, stretch.per_gravity.gravity_torque_of_link(joint, link))
        )
        self.linear: dict[PartlyLinearTorque, np.ndarray] = {}
        self.rests: dict[PartlyLinearTorque, NonlinearTerm] = {}

    @cached_property
    def described(self) -> np.ndarray:
        """(N,) torque of the described arm."""
        return self.reduce(self._stretch.described[:, [self._joint]])[:, 0]

    @cached_property
    def per_gravity(self) -> np.ndarray:
        """(N, 3) torque of the described arm per component of gravity."""
        return self.reduce(self._stretch.per_gravity.described[self._joint])


class DelayedInputs:
    """Inputs of the joints' functions at a fixed time before each time stamp, for a delayed torque.

    A dry friction changes its sign between two stamps, at a time that its samples do not contain.

    Args:
        stretch: the motion at the stamps.
        motion: the motion at any time.
        delay: time before each stamp, s.
    """

    def __init__(self, stretch: MotionSamples, motion: MeasuredMotion, delay: float) -> None:
        self._stretch, self._motion = stretch, motion
        time = stretch.motion.time
        self._time = np.clip(time - delay, time[0], time[-1])
        self._after = np.clip(np.searchsorted(time, self._time), 1, len(time) - 1)
        before = time[self._after - 1]
        self._share = (self._time - before) / (time[self._after] - before)

    def signal(self, at_stamps: np.ndarray) -> np.ndarray:
        """(n, ...) earlier values of a smooth signal, linear between the stamps."""
        share = self._share.reshape(-1, *[1] * (at_stamps.ndim - 1))
        return (1.0 - share) * at_stamps[self._after - 1] + share * at_stamps[self._after]

    def inputs(self, joint: int, columns: tuple[RecordedColumn, ...] = ()) -> np.ndarray:
        """(15 + c, n) inputs of a joint's functions at the earlier times, with c recorded quantities."""
        found = self.signal(self._stretch.inputs(joint, columns).T).T
        found[DIRECTION_INPUT_INDEX] = self._motion.direction(joint, self._time)
        return found


def _reduced_weight(reduce: Callable[[np.ndarray], np.ndarray], columns: np.ndarray) -> np.ndarray:
    """Reduce (n, 3, 4) torques per gravity and per mass and first moment of a link to (N, 3, 4)."""
    return reduce(columns.reshape(len(columns), -1)).reshape(-1, *columns.shape[1:])
