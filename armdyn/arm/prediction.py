"""Torques of one run with exact derivatives: what does not depend on the parameters is computed once per run."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from armdyn.arm.composition import LOAD, JointFunctions, Term
from armdyn.arm.motion import Motion
from armdyn.arm.rigid import inverse_dynamics, torque_regressor
from armdyn.arm.sampling import Sampler


@dataclass(frozen=True, eq=False)
class Stretch:
    """The motion at the stamps of one or more torque channels, and what rigid bodies make of it.

    Attributes:
        model: the arm as described.
        motion: at the stamps.
        time: (n,) s since the start of the run.
    """

    model: pin.Model
    motion: Motion
    time: np.ndarray

    @cached_property
    def described(self) -> np.ndarray:
        """(n, nj) torques of the arm as described."""
        return inverse_dynamics(self.model, self.motion)

    @cached_property
    def regressor(self) -> np.ndarray:
        """(n, nj, nj, 10) torques per inertial parameter."""
        return torque_regressor(self.model, self.motion)

    @cached_property
    def parents(self) -> tuple[int, ...]:
        """(nj,) index of each joint's neighbour towards the base, -1 for none."""
        return tuple(int(parent) - 1 for parent in list(self.model.parents)[1:])

    def parent(self, joint: int) -> int:
        """Index of the next joint towards the base, -1 for none."""
        return self.parents[joint]

    def carries(self, joint: int, link: int) -> bool:
        """Whether the link that joint `link` moves hangs on `joint`."""
        while link > joint:
            link = self.parent(link)
        return link == joint

    def inputs(self, joint: int) -> np.ndarray:
        """(9, n) inputs of a joint's functions, with the load of the arm as described."""
        m, inner = self.motion, self.parent(joint)
        rows = [self.time, m.q[:, joint], m.v[:, joint], m.a[:, joint], m.direction[:, joint], self.described[:, joint]]
        none = np.zeros(len(self.time))
        return np.vstack(
            [*rows, *((m.q[:, inner], m.v[:, inner], m.a[:, inner]) if inner >= 0 else (none, none, none))]
        )


class Links:
    """The links' inertial parameters, less those described, at one vector of parameters.

    Args:
        functions: of all joints.
        theta: (k,) parameters of each joint.
        shapes: (nj, 4, 4) factors of the described pseudo-inertias.

    Attributes:
        change: by joint with effects on its link, (10,).
        derivatives: by joint, (10, k).
    """

    def __init__(self, functions: Sequence[JointFunctions], theta: Sequence[np.ndarray], shapes: np.ndarray) -> None:
        self.change: dict[int, np.ndarray] = {}
        self.derivatives: dict[int, np.ndarray] = {}
        for i, (joint, values, shape) in enumerate(zip(functions, theta, list(shapes), strict=True)):
            if joint.link is not None:
                self.change[i], self.derivatives[i] = joint.link.change(shape, values)


class Signal:
    """Coefficients of a torque while its parts are added up, with its derivatives by the joints that matter.

    Args:
        size: N, coefficients or samples.
        widths: number of parameters by joint.

    Attributes:
        value: (N,).
        derivatives: (N, sum of the widths).
        columns: by joint, where its parameters are.
    """

    def __init__(self, size: int, widths: dict[int, int]) -> None:
        self.value = np.zeros(size)
        self.columns: dict[int, slice] = {}
        last = 0
        for joint, width in widths.items():
            self.columns[joint] = slice(last, last + width)
            last += width
        self.derivatives = np.zeros((size, last))

    def by(self, joint: int) -> np.ndarray:
        """(N, k) view of the derivatives by a joint's parameters."""
        return self.derivatives[:, self.columns[joint]]


class _Rest(NamedTuple):
    """What a term that is not linear came to last: for which parameters, and the coefficients."""

    key: bytes
    coefficients: np.ndarray
    slopes: dict[int, np.ndarray]


class _Reduction:
    """What signals at the stamps are reduced to, and what was reduced before.

    Args:
        reduce: linear map of (n, m) signals at the stamps to (N, m).
        stretch: the motion at the stamps.
        joint: index of the joint whose torque is predicted.
    """

    def __init__(self, reduce: Callable[[np.ndarray], np.ndarray], stretch: Stretch, joint: int) -> None:
        self.reduce = reduce
        self._stretch, self._joint = stretch, joint
        self.link = cache(lambda link: reduce(stretch.regressor[:, joint, link]))
        self.linear: dict[Term, np.ndarray] = {}
        self.rests: dict[Term, _Rest] = {}

    @cached_property
    def described(self) -> np.ndarray:
        """(N,) the torque of the arm as described."""
        return self.reduce(self._stretch.described[:, [self._joint]])[:, 0]


class ChannelPredictor:
    """Predicts the torque of one joint in one run.

    Args:
        stretch: the motion at the stamps of the channel.
        sampler: from there to the samples.
        joint: index of the joint.
    """

    def __init__(self, stretch: Stretch, sampler: Sampler, joint: int) -> None:
        self._stretch, self._sampler, self._joint = stretch, sampler, joint
        self._inputs = cache(stretch.inputs)
        on_time, self._slope_on_time = sampler.matrix(0.0), sampler.matrix(0.0, 1)
        self._coefficients = _Reduction(sampler.coefficients, stretch, joint)
        # Without a delay the samples are all that is asked for: a few of them for many coefficients.
        self._samples = _Reduction(lambda signals: on_time @ sampler.coefficients(signals), stretch, joint)

    def predict(
        self, functions: Sequence[JointFunctions], theta: Sequence[np.ndarray], links: Links
    ) -> tuple[np.ndarray, dict[int, np.ndarray]]:
        """Samples (n,) of the channel, and by joint that matters their derivatives (n, k) by its parameters.

        Args:
            functions: of all joints.
            theta: (k,) parameters of each joint.
            links: at these parameters.
        """
        sensor = functions[self._joint].sensor
        _, delay, by_sensor = sensor.at(theta[self._joint])
        if delay == 0.0:
            total = self._total(self._samples, functions, theta, links)
            values, derivatives = total.value, {i: total.by(i) for i in total.columns}
            if sensor.delayed:
                slope = self._slope_on_time @ self._total(self._coefficients, functions, theta, links).value
        else:
            total = self._total(self._coefficients, functions, theta, links)
            matrix, slope = self._sampler.matrix(delay), self._sampler.matrix(delay, 1) @ total.value
            sampled = np.asarray(matrix @ total.derivatives)
            values, derivatives = np.asarray(matrix @ total.value), {i: sampled[:, c] for i, c in total.columns.items()}
        if sensor.delayed:
            derivatives[self._joint] -= np.outer(slope, by_sensor[1])
        return values, derivatives

    def _total(
        self, reduced: "_Reduction", functions: Sequence[JointFunctions], theta: Sequence[np.ndarray], links: Links
    ) -> Signal:
        """The sensor's reading without its delay."""
        j, own = self._joint, functions[self._joint]
        outer = [
            i for i in range(len(functions)) if self._stretch.parent(i) == j and not functions[i].inner_torque.empty
        ]
        carried = [i for i in links.change if self._stretch.carries(j, i)]
        loading = [i for k in outer for i in links.change if self._stretch.carries(k, i)]
        widths = {i: len(theta[i]) for i in dict.fromkeys((j, *outer, *carried, *loading))}
        total = Signal(len(reduced.described), widths)
        total.value += reduced.described
        for term in own.torque:
            self._add(total, term, j, theta[j], links, reduced)
        for i in carried:
            columns = reduced.link(i)
            total.value += columns @ links.change[i]
            total.by(i)[:] += columns @ links.derivatives[i]
        for i in outer:
            self._add(total, functions[i].inner_torque, i, theta[i], links, reduced)
        gain, _, by_sensor = own.sensor.at(theta[j])
        torque = total.value
        if own.sensor.scaled:
            total.derivatives *= gain
            total.by(j)[:] += np.outer(torque, by_sensor[0])
            total.value = gain * torque
        self._add(total, own.offset, j, theta[j], links, reduced)
        return total

    def _add(
        self, total: Signal, term: Term, joint: int, theta: np.ndarray, links: Links, reduced: "_Reduction"
    ) -> None:
        """Add a term of a joint's functions."""
        if term.empty:
            return
        if term not in reduced.linear:
            reduced.linear[term] = reduced.reduce(term.columns(self._inputs(joint), len(theta)))
        own = total.by(joint)
        for column, i in zip(reduced.linear[term].T, term.linear, strict=True):
            # One after the other, so that one more with a factor of zero changes no digit.
            total.value += column * theta[i]
            own[:, i] += column
        if term.has_rest:
            rest = self._rest(term, joint, theta, links, reduced)
            total.value += rest.coefficients[:, 0]
            for column, i in zip(rest.coefficients[:, 1:].T, term.nonlinear, strict=True):
                own[:, i] += column
            for i, slopes in rest.slopes.items():
                total.by(i)[:] += slopes @ links.derivatives[i]

    def _rest(self, term: Term, joint: int, theta: np.ndarray, links: Links, reduced: "_Reduction") -> _Rest:
        """Most fits leave most of these parameters alone, so that the last answer often still holds."""
        carried = [i for i in links.change if self._stretch.carries(joint, i)] if term.loaded else []
        key = b"".join([theta[list(term.nonlinear)].tobytes(), *(links.change[i].tobytes() for i in carried)])
        last = reduced.rests.get(term)
        if last is not None and last.key == key:
            return last
        inputs = self._inputs(joint)
        if term.loaded:
            inputs = inputs.copy()
            for i in carried:
                inputs[LOAD] += self._stretch.regressor[:, joint, i] @ links.change[i]
        rest = term.rest(inputs, theta)
        per_load, slopes = rest[:, -1:], {}
        if per_load.any():
            for i in carried:  # ten columns for a link, however many parameters it has
                slopes[i] = reduced.reduce(per_load * self._stretch.regressor[:, joint, i])
        found = _Rest(key, reduced.reduce(rest[:, :-1]), slopes)
        reduced.rests[term] = found
        return found
