"""The rigid bodies of an arm in one run: the torques that they need, and the changes that effects make to them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import pinocchio as pin

from armdyn.arm.composition import InertialOrGravityChange, JointTorqueFunctions
from armdyn.arm.motion import Motion
from armdyn.arm.rigid import (
    INERTIAL_PARAMETERS_PER_BODY,
    GravityTorques,
    inverse_dynamics,
    parent_joints,
    torque_regressor,
)
from armdyn.object_cache import cached_with_first_argument
from armdyn.parameter import RecordedColumn
from armdyn.recording.channels import Channel, DriveReading

BASE_INDEX = -1
"""Number that stands for the base where a joint's index is expected."""


@dataclass(frozen=True, eq=False)
class RigidBodyChanges:
    """Changes of links and gravity by effects, at given parameter values.

    Attributes:
        links: (10,) changes of the inertial parameters, by joints with effects on their links.
        gravity: (3,) change of gravity, m/s^2; None for a base without effects.
        derivatives: derivatives of these changes, (10, k) by joint, and (3, k) for `BASE_INDEX`.
    """

    links: Mapping[int, np.ndarray]
    gravity: np.ndarray | None
    derivatives: Mapping[int, np.ndarray]

    @classmethod
    def at(
        cls,
        functions: Sequence[JointTorqueFunctions],
        theta: Sequence[np.ndarray],
        shapes: np.ndarray,
        base: tuple[InertialOrGravityChange, np.ndarray, np.ndarray] | None = None,
    ) -> "RigidBodyChanges":
        """The changes at parameter values.

        Args:
            functions: functions of all joints.
            theta: (k,) parameters of each joint.
            shapes: (nj, 4, 4) factors of the described pseudo-inertias.
            base: function, described gravity (3,), m/s^2, and parameters (k,) of the base; None for a base without
                effects.
        """
        links, gravity, derivatives = dict[int, np.ndarray](), None, dict[int, np.ndarray]()
        for i, (joint, values, shape) in enumerate(zip(functions, theta, list(shapes), strict=True)):
            if joint.link is not None:
                links[i], derivatives[i] = joint.link.at(shape, values)
        if base is not None:
            function, described, values = base
            gravity, derivatives[BASE_INDEX] = function.at(described, values)
        return cls(links, gravity, derivatives)


@dataclass(frozen=True, eq=False)
class MotionSamples:
    """The motion of an arm at n time stamps, with the torques of its rigid bodies.

    Attributes:
        model: the described arm.
        motion: the motion at the time stamps.
        time: (n,) time since the start of the run, s.
        extra: channels that effects read: further recorded quantities, ``enabled.<joint>``, and drives' readings.
    """

    model: pin.Model
    motion: Motion
    time: np.ndarray
    extra: Mapping[str, Channel] = field(default_factory=dict)

    @cached_property
    def described(self) -> np.ndarray:
        """(n, nj) torques of the described arm without effects, N m or N."""
        return inverse_dynamics(self.model, self.motion.q, self.motion.v, self.motion.a)

    @cached_property
    def carried(self) -> tuple[tuple[int, ...], ...]:
        """The links that each joint carries, its own first."""
        count = len(self.parents)
        return tuple(tuple(i for i in range(j, count) if self.carries(j, i)) for j in range(count))

    @cached_property
    def by_inertia(self) -> tuple[np.ndarray, ...]:
        """(n, k, 10) derivatives of each joint's torque by the inertial parameters of the k links that it carries."""
        # One array per joint, in the order in which it is read: products with slices of a whole one take longer.
        every = torque_regressor(self.model, self.motion.q, self.motion.v, self.motion.a)
        return tuple(np.ascontiguousarray(every[:, j][:, links]) for j, links in enumerate(self.carried))

    @cached_property
    def per_gravity(self) -> GravityTorques:
        """Torques per component of gravity."""
        return GravityTorques(self.model, self.motion.q)

    def rigid(self, joint: int, bodies: RigidBodyChanges) -> np.ndarray:
        """(n,) change of a joint's torque by the changes of the rigid bodies."""
        links = [bodies.links.get(i, np.zeros(INERTIAL_PARAMETERS_PER_BODY)) for i in self.carried[joint]]
        change = self.by_inertia[joint].reshape(len(self.time), -1) @ np.concatenate(links)
        if bodies.gravity is not None and bodies.gravity.any():
            change += self.changed_per_gravity(joint, bodies) @ bodies.gravity
        return change

    def by_links(self, joint: int, links: Sequence[int], bodies: RigidBodyChanges) -> np.ndarray:
        """(n, k, 10) derivatives of a joint's torque by inertial parameters of k links, with changed gravity."""
        own, columns = self.carried[joint], self.by_inertia[joint]
        if tuple(links) != own:
            columns = columns[:, [own.index(i) for i in links]]
        if bodies.gravity is not None and bodies.gravity.any():
            columns = columns.copy()
            for k, i in enumerate(links):
                columns[:, k, :4] += self.per_gravity.under(bodies.gravity, joint, i)
        return columns

    def changed_per_gravity(self, joint: int, bodies: RigidBodyChanges) -> np.ndarray:
        """(n, 3) derivatives of a joint's torque by gravity, with changed links."""
        described, change = self.per_gravity.described[joint], _change_per_gravity(bodies, self)
        return described if change is None else described + change[joint]

    @cached_property
    def parents(self) -> tuple[int, ...]:
        """(nj,) index of each joint's neighbour towards the base, -1 for none."""
        return parent_joints(self.model)

    def carries(self, joint: int, link: int) -> bool:
        """Whether `joint` carries the link that joint `link` moves."""
        while link > joint:
            link = self.parents[link]
        return link == joint

    @cached_with_first_argument
    def inputs(self, joint: int, columns: tuple[RecordedColumn, ...] = ()) -> np.ndarray:
        """(15 + c, n) inputs of a joint's functions, with the load of the described arm, and c recorded quantities."""
        m, inner = self.motion, self.parents[joint]
        rows = [self.time, m.q[:, joint], m.v[:, joint], m.a[:, joint], m.direction[:, joint], self.described[:, joint]]
        none = np.zeros(len(self.time))
        rows += [m.q[:, inner], m.v[:, inner], m.a[:, inner]] if inner >= 0 else [none, none, none]
        enabled, read = (self.extra.get(f"{kind}.{self.model.names[joint + 1]}") for kind in ("enabled", "tau"))
        rows.append(
            np.ones(len(self.time)) if enabled is None else (enabled.zero_order_hold_values(m.time) > 0.5).astype(float)
        )
        told = read.commands if isinstance(read, DriveReading) else np.zeros((0, 0))
        rows += [np.interp(m.time, read.time, row) for row in told] if read is not None and len(told) else [none] * 5
        return np.vstack([*rows, *(column.interpolate(self.extra, m.time) for column in columns)])


@cached_with_first_argument
def _change_per_gravity(bodies: RigidBodyChanges, stretch: MotionSamples) -> np.ndarray | None:
    """(nj, n, 3) changes of the torques per component of gravity by changed links; None where none is changed."""
    changed = {i: link[:4] for i, link in bodies.links.items() if link[:4].any()}
    return stretch.per_gravity.of_bodies(changed) if changed else None
