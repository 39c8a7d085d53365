"""Reduce the parts of a predicted torque to samples of its channel; parts without parameters are cached."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Hashable, Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_matrix

from armdyn.arm.bodies import MotionSamples, RigidBodyChanges
from armdyn.arm.composition import DIRECTION_INPUT_INDEX, LOAD_INPUT_INDEX, PartlyLinearTorque
from armdyn.arm.motion import MeasuredMotion
from armdyn.parameter import RecordedColumn
from armdyn.readout import Sampler


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
    """Nonlinear rest of a term.

    Attributes:
        reduced: (N, 1 + k) the rest and its derivatives by k parameters.
        per_load: (n,) its derivatives by the load at the stamps.
    """

    reduced: np.ndarray
    per_load: np.ndarray


class LoadDerivatives(NamedTuple):
    """Derivatives of terms through the load: (N, k, 10) by the inertial parameters of k links, (N, 3) by gravity."""

    links: np.ndarray
    gravity: np.ndarray


class Reduction(ABC):
    """Parts of one joint's torque in a run, reduced from n stamps to N numbers."""

    @property
    @abstractmethod
    def described(self) -> np.ndarray:
        """(N,) torque of the described arm."""

    @property
    @abstractmethod
    def per_gravity(self) -> np.ndarray:
        """(N, 3) torque of the described arm per component of gravity."""

    @abstractmethod
    def link(self, link: int) -> np.ndarray:
        """(N, 10) derivatives of the torque by a link's inertial parameters."""

    @abstractmethod
    def weight(self, link: int) -> np.ndarray:
        """(N, 3, 4) torques per gravity and per mass and first moment of a link."""

    @abstractmethod
    def linear(self, term: PartlyLinearTorque, joint: int, size: int) -> np.ndarray:
        """(N, linear) columns of a term of a joint with `size` parameters."""

    @abstractmethod
    def rest(self, term: PartlyLinearTorque, joint: int, theta: np.ndarray, bodies: RigidBodyChanges) -> NonlinearTerm:
        """Nonlinear rest of a term of a joint with parameters (k,) `theta`."""

    @abstractmethod
    def through_load(
        self, joint: int, per_load: np.ndarray, links: Sequence[int], bodies: RigidBodyChanges
    ) -> LoadDerivatives:
        """Derivatives through the load of a joint, on which terms depend by (n,) `per_load`."""


class CoefficientReduction(Reduction):
    """Reduction to the coefficients of a sampler.

    Args:
        sampler: map from signals at the stamps to coefficients.
        stretch: the motion at the stamps.
        joint: index of the joint whose torque is predicted.
        earlier: signals some time before each stamp; None means those at the stamps.
    """

    def __init__(
        self, sampler: Sampler, stretch: MotionSamples, joint: int, earlier: "DelayedInputs | None" = None
    ) -> None:
        self._sampler, self._stretch, self._joint, self._earlier = sampler, stretch, joint, earlier
        self._kept: dict[Hashable, np.ndarray] = {}
        self._rests: dict[PartlyLinearTorque, tuple[bytes, np.ndarray]] = {}
        self._reduced_rests: dict[PartlyLinearTorque, tuple[bytes, NonlinearTerm]] = {}
        self._through_load: dict[int, tuple[bytes, LoadDerivatives]] = {}

    @cached_property
    def described(self) -> np.ndarray:
        """(N,) torque of the described arm."""
        return self.coefficients(self._stretch.described[:, [self._joint]])[:, 0]

    @cached_property
    def per_gravity(self) -> np.ndarray:
        """(N, 3) torque of the described arm per component of gravity."""
        return self.coefficients(self._stretch.per_gravity.described[self._joint])

    def link(self, link: int) -> np.ndarray:
        """(N, 10) derivatives of the torque by a link's inertial parameters."""
        stretch, j = self._stretch, self._joint
        return _once(
            self._kept,
            ("link", link),
            lambda: self.coefficients(stretch.by_inertia[j][:, stretch.carried[j].index(link)]),
        )

    def weight(self, link: int) -> np.ndarray:
        """(N, 3, 4) torques per gravity and per mass and first moment of a link."""
        return _once(
            self._kept,
            ("weight", link),
            lambda: _reduced(self.coefficients, self._stretch.per_gravity.gravity_torque_of_link(self._joint, link)),
        )

    def linear(self, term: PartlyLinearTorque, joint: int, size: int) -> np.ndarray:
        """(N, linear) columns of a term of a joint with `size` parameters."""
        return _once(
            self._kept, term, lambda: self.coefficients(term.columns(self._inputs(joint, term.recorded), size))
        )

    def rest(self, term: PartlyLinearTorque, joint: int, theta: np.ndarray, bodies: RigidBodyChanges) -> NonlinearTerm:
        """Nonlinear rest of a term; the last one is reused while the values that it depends on do not change."""
        key, rest = self._rest_at_stamps(term, joint, theta, bodies)
        if term not in self._reduced_rests or self._reduced_rests[term][0] != key:
            self._reduced_rests[term] = key, NonlinearTerm(self.coefficients(rest[:, :-1]), rest[:, -1])
        return self._reduced_rests[term][1]

    def _rest_at_stamps(
        self, term: PartlyLinearTorque, joint: int, theta: np.ndarray, bodies: RigidBodyChanges
    ) -> tuple[bytes, np.ndarray]:
        """Values on which the nonlinear rest of a term depends, and the rest (n, 2 + k); see `rest`."""
        changes = _changes(bodies, self._stretch.carried[joint]) if term.loaded else []
        key = b"".join([theta[list(term.nonlinear)].tobytes(), *(change.tobytes() for change in changes)])
        if term not in self._rests or self._rests[term][0] != key:
            inputs = self._inputs(joint, term.recorded)
            if changes:
                inputs = inputs.copy()
                inputs[LOAD_INPUT_INDEX] += self._signal(self._stretch.rigid(joint, bodies))
            self._rests[term] = key, term.rest(inputs, theta)
        return self._rests[term]

    def at_stamps(
        self, term: PartlyLinearTorque, joint: int, theta: np.ndarray, bodies: RigidBodyChanges
    ) -> np.ndarray:
        """(n,) values of a term at the stamps, before they are reduced."""
        found = np.zeros(self._stretch.motion.time.shape)
        if term.linear:
            columns = term.columns(self._inputs(joint, term.recorded), len(theta))
            for column, i in zip(columns.T, term.linear, strict=True):
                found += column * theta[i]
        return found + self._rest_at_stamps(term, joint, theta, bodies)[1][:, 0] if term.has_rest else found

    def coefficients(self, signals: np.ndarray) -> np.ndarray:
        """(N, m) coefficients of (n, m) signals."""
        return self._sampler.coefficients(signals)

    def through_load(
        self, joint: int, per_load: np.ndarray, links: Sequence[int], bodies: RigidBodyChanges
    ) -> LoadDerivatives:
        """Derivatives through the load; the last ones are reused while the values that they depend on do not change.

        A link has ten columns, however many parameters it has.
        """
        changes = [] if bodies.gravity is None else _changes(bodies, self._stretch.carried[joint])
        key = b"".join([per_load.tobytes(), bytes(links), *(change.tobytes() for change in changes)])
        if joint not in self._through_load or self._through_load[joint][0] != key:

            def reduced(signals: np.ndarray) -> np.ndarray:
                return self._sampler.weighted_coefficients(per_load, self._signal(signals))

            stretch = self._stretch
            of_links = _reduced(reduced, stretch.by_links(joint, links, bodies))
            none = np.zeros((len(of_links), 0))
            of_gravity = none if bodies.gravity is None else reduced(stretch.changed_per_gravity(joint, bodies))
            self._through_load[joint] = key, LoadDerivatives(of_links, of_gravity)
        return self._through_load[joint][1]

    def _inputs(self, joint: int, columns: tuple[RecordedColumn, ...]) -> np.ndarray:
        """(15 + c, n) inputs of a joint's functions, with c recorded quantities."""
        source = self._stretch if self._earlier is None else self._earlier
        return _once(self._kept, (joint, columns), lambda: source.inputs(joint, columns))

    def _signal(self, at_stamps: np.ndarray) -> np.ndarray:
        return at_stamps if self._earlier is None else self._earlier.signal(at_stamps)


class SampleReduction(Reduction):
    """Reduction to samples of the curves of another reduction.

    Args:
        of: reduction to N coefficients.
        matrix: (m, N) matrix from coefficients to samples.
    """

    def __init__(self, of: Reduction, matrix: csr_matrix) -> None:
        self._of, self._matrix = of, matrix
        self._kept: dict[Hashable, np.ndarray] = {}

    @cached_property
    def described(self) -> np.ndarray:
        """(m,) torque of the described arm."""
        return self._sampled(self._of.described)

    @cached_property
    def per_gravity(self) -> np.ndarray:
        """(m, 3) torque of the described arm per component of gravity."""
        return self._sampled(self._of.per_gravity)

    def link(self, link: int) -> np.ndarray:
        """(m, 10) derivatives of the torque by a link's inertial parameters."""
        return _once(self._kept, ("link", link), lambda: self._sampled(self._of.link(link)))

    def weight(self, link: int) -> np.ndarray:
        """(m, 3, 4) torques per gravity and per mass and first moment of a link."""
        return _once(self._kept, ("weight", link), lambda: _reduced(self._sampled, self._of.weight(link)))

    def linear(self, term: PartlyLinearTorque, joint: int, size: int) -> np.ndarray:
        """(m, linear) columns of a term of a joint with `size` parameters."""
        return _once(self._kept, term, lambda: self._sampled(self._of.linear(term, joint, size)))

    def rest(self, term: PartlyLinearTorque, joint: int, theta: np.ndarray, bodies: RigidBodyChanges) -> NonlinearTerm:
        """Nonlinear rest of a term of a joint with parameters (k,) `theta`."""
        found = self._of.rest(term, joint, theta, bodies)
        return found._replace(reduced=self._sampled(found.reduced))

    def through_load(
        self, joint: int, per_load: np.ndarray, links: Sequence[int], bodies: RigidBodyChanges
    ) -> LoadDerivatives:
        """Derivatives through the load of a joint, on which terms depend by (n,) `per_load`."""
        found = self._of.through_load(joint, per_load, links, bodies)
        return LoadDerivatives(_reduced(self._sampled, found.links), self._sampled(found.gravity))

    def _sampled(self, coefficients: np.ndarray) -> np.ndarray:
        return np.asarray(self._matrix @ coefficients)


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
        after, count = np.clip(np.searchsorted(time, self._time), 1, len(time) - 1), len(time)
        share = (self._time - time[after - 1]) / (time[after] - time[after - 1])
        entries = np.column_stack([1.0 - share, share]).ravel(), np.column_stack([after - 1, after]).ravel()
        self._between = csr_matrix((*entries, 2 * np.arange(count + 1)), shape=(count, count))

    def signal(self, at_stamps: np.ndarray) -> np.ndarray:
        """(n,) or (n, m) earlier values of smooth signals, linear between the stamps."""
        return np.asarray(self._between @ at_stamps)

    def inputs(self, joint: int, columns: tuple[RecordedColumn, ...] = ()) -> np.ndarray:
        """(15 + c, n) inputs of the functions of a joint's effects, at times earlier by the delay of the torque.

        Args:
            joint: number of the joint.
            columns: c recorded quantities, which follow the 15 of the joint's motion.
        """
        found = self.signal(self._stretch.inputs(joint, columns).T).T
        found[DIRECTION_INPUT_INDEX] = self._motion.direction(joint, self._time)
        return found


def _changes(bodies: RigidBodyChanges, carried: Sequence[int]) -> list[np.ndarray]:
    """Changes of links and gravity on which the load of a joint depends that carries these links."""
    return [bodies.links[i] for i in carried if i in bodies.links] + (
        [bodies.gravity] if bodies.gravity is not None else []
    )


def _once(kept: dict[Hashable, np.ndarray], key: Hashable, make: Callable[[], np.ndarray]) -> np.ndarray:
    """The array with a `key`, which is made only once."""
    if key not in kept:
        kept[key] = make()
    return kept[key]


def _reduced(reduce: Callable[[np.ndarray], np.ndarray], columns: np.ndarray) -> np.ndarray:
    """Reduce (n, a, b) columns to (N, a, b)."""
    size = int(np.prod(columns.shape[1:]))  # may be 0: no -1 in a shape then
    reduced = reduce(columns.reshape(len(columns), size))
    return reduced.reshape(len(reduced), *columns.shape[1:])
