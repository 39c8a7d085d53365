"""Torques of one run with exact derivatives: what does not depend on the parameters is computed once per run."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np
import pinocchio as pin

from armdyn.arm.composition import LOAD, JointFunctions, Term
from armdyn.arm.motion import Motion
from armdyn.arm.rigid import inverse_dynamics, torque_regressor
from armdyn.arm.sampling import Sampler

Derivatives = dict[int, np.ndarray]
"""By joint: derivatives by its parameters, one column for each."""


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

    def parent(self, joint: int) -> int:
        """Index of the next joint towards the base, -1 for none."""
        return int(self.model.parents[joint + 1]) - 1

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
        self.derivatives: Derivatives = {}
        for i, (joint, values, shape) in enumerate(zip(functions, theta, list(shapes), strict=True)):
            if joint.link is not None:
                parameters, derivatives = joint.link(shape, values)
                # The described link is what the same function gives at the null values: no effect, no change at all.
                described, _ = joint.link(shape, joint.null)
                self.change[i] = np.asarray(parameters - described).ravel()
                self.derivatives[i] = np.asarray(derivatives)


class ChannelPredictor:
    """Predicts the torque of one joint in one run.

    Args:
        stretch: the motion at the stamps of the channel.
        sampler: from there to the samples.
        joint: index of the joint.
    """

    def __init__(self, stretch: Stretch, sampler: Sampler, joint: int) -> None:
        self._stretch, self._sampler, self._joint = stretch, sampler, joint
        self._described = sampler.coefficients(stretch.described[:, [joint]])[:, 0]
        self._on_time = sampler.matrix(0.0)
        self._inputs = cache(stretch.inputs)
        self._link = cache(lambda link: sampler.coefficients(stretch.regressor[:, joint, link]))
        self._linear: dict[Term, np.ndarray] = {}

    def predict(
        self, functions: Sequence[JointFunctions], theta: Sequence[np.ndarray], links: Links
    ) -> tuple[np.ndarray, Derivatives]:
        """Samples (n,) of the channel, and their derivatives (n, k) by the parameters of each joint that matters.

        Args:
            functions: of all joints.
            theta: (k,) parameters of each joint.
            links: at these parameters.
        """
        j, own = self._joint, functions[self._joint]
        sensor, by_sensor = (np.asarray(x) for x in own.sensor(theta[j]))
        gain, delay = float(sensor[0, 0]), float(sensor[1, 0])
        torque, by_torque = self._drive(functions, theta, links)
        offset, by_offset = self._term(own.offset, j, theta[j], links)
        reading = gain * torque + offset
        derivatives = {i: gain * d for i, d in by_torque.items()}
        _add(derivatives, by_offset)
        _add(derivatives, {j: np.outer(torque, by_sensor[0])})
        matrix = self._on_time if delay == 0.0 else self._sampler.matrix(delay)
        sampled = {i: np.asarray(matrix @ d) for i, d in derivatives.items()}
        if own.delayed:
            slope = self._sampler.matrix(delay, 1) @ reading
            _add(sampled, {j: -np.outer(slope, by_sensor[1])})
        return np.asarray(matrix @ reading), sampled

    def _drive(
        self, functions: Sequence[JointFunctions], theta: Sequence[np.ndarray], links: Links
    ) -> tuple[np.ndarray, Derivatives]:
        """Coefficients (N,) of the drive's torque, and (N, k) of its derivatives."""
        j = self._joint
        torque, derivatives = self._term(functions[j].torque, j, theta[j], links)
        total = self._described + torque
        for i, change in links.change.items():
            if self._stretch.carries(j, i):
                columns = self._link(i)
                total = total + columns @ change
                _add(derivatives, {i: columns @ links.derivatives[i]})
        for i, outer in enumerate(functions):
            if self._stretch.parent(i) == j and not outer.inner_torque.empty:
                torque, more = self._term(outer.inner_torque, i, theta[i], links)
                total = total + torque
                _add(derivatives, more)
        return total, derivatives

    def _term(self, term: Term, joint: int, theta: np.ndarray, links: Links) -> tuple[np.ndarray, Derivatives]:
        """Coefficients (N,) of a term of a joint's functions, and (N, k) of its derivatives."""
        size, count = len(self._described), len(theta)
        value, by_own = np.zeros(size), np.zeros((size, count))
        if term.empty:
            return value, {joint: by_own}
        if term not in self._linear:
            self._linear[term] = self._sampler.coefficients(term.columns(self._inputs(joint), count))
        columns = self._linear[term]
        linear, nonlinear = list(term.linear), list(term.nonlinear)
        value = columns @ theta[linear]
        by_own[:, linear] = columns
        derivatives = {joint: by_own}
        if term.has_rest:
            inputs = self._loaded_inputs(joint, links) if term.loaded else self._inputs(joint)
            rest = term.rest(inputs, theta)
            coefficients = self._sampler.coefficients(rest[:, :-1])
            value = value + coefficients[:, 0]
            by_own[:, nonlinear] = coefficients[:, 1:]
            per_load = rest[:, -1]
            if term.loaded and per_load.any():
                for i, change in links.derivatives.items():
                    if self._stretch.carries(joint, i):
                        # Ten columns however many parameters there are.
                        slopes = self._sampler.coefficients(per_load[:, None] * self._stretch.regressor[:, joint, i])
                        _add(derivatives, {i: slopes @ change})
        return value, derivatives

    def _loaded_inputs(self, joint: int, links: Links) -> np.ndarray:
        inputs = self._inputs(joint).copy()
        for i, change in links.change.items():
            if change.any() and self._stretch.carries(joint, i):
                inputs[LOAD] += self._stretch.regressor[:, joint, i] @ change
        return inputs


def _add(total: Derivatives, more: Derivatives) -> None:
    for i, d in more.items():
        total[i] = total[i] + d if i in total else d
