"""Predict the wrench that a force/torque sensor reads in a run, with exact derivatives."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import pinocchio as pin

from armdyn.arm.arm import Arm
from armdyn.arm.bodies import BASE_INDEX, MotionSamples, RigidBodyChanges
from armdyn.arm.composition import JointTorqueFunctions
from armdyn.arm.prediction import (
    add_derivatives_by_bodies,
    motion_samples,
    sampler_of_channel,
    stamps_shared_with,
    torque_of_bodies,
)
from armdyn.arm.prepared import PreparedRun, motion_of_run, torque_noise
from armdyn.arm.reduction import CoefficientReduction, Reduction, SampleReduction, TorqueWithDerivatives
from armdyn.arm.rigid import INERTIAL_PARAMETERS_PER_BODY
from armdyn.arm.wrench.reading import WrenchReading
from armdyn.arm.wrench.sensor import CutArm, WrenchSensor, cut_at_sensor
from armdyn.errors import InputError
from armdyn.object_cache import cached_with_first_argument
from armdyn.parameter import RecordedColumn
from armdyn.readout import InterpolatingSampler, Sampler
from armdyn.run import Run


@dataclass(frozen=True, eq=False)
class CutMotionSamples(MotionSamples):
    """The motion of an arm that is cut at a sensor, at n time stamps, with the wrench on the sensor."""

    cut: CutArm = field(kw_only=True)

    @classmethod
    def of(cls, cut: CutArm, arm: MotionSamples) -> "CutMotionSamples":
        """The samples of an arm that is cut, from those of the arm."""
        return cls(cut.model, cut.motion(arm.motion), arm.time, arm.extra, cut=cut)

    @cached_property
    def by_inertia(self) -> tuple[np.ndarray, ...]:
        """(n, k, 10) derivatives of each axis of the sensor by the k links behind it; nothing for other joints."""
        data, m = self.model.createData(), self.motion
        links = self.carried[self.cut.tool]
        columns = (
            np.arange(self.model.nv * INERTIAL_PARAMETERS_PER_BODY).reshape(self.model.nv, -1)[list(links)].ravel()
        )
        found = np.empty((len(self.cut.axes), len(self.time), len(columns)))
        for i, row in enumerate(zip(m.q, m.v, m.a, strict=True)):
            found[:, i] = pin.computeJointTorqueRegressor(self.model, data, *row)[
                np.ix_(np.array(self.cut.axes), columns)
            ]
        axes = iter(found.reshape(*found.shape[:2], len(links), -1))
        return tuple(next(axes) if j in self.cut.axes else np.zeros((0, 0, 0)) for j in range(self.model.nv))

    @cached_property
    def carried(self) -> tuple[tuple[int, ...], ...]:
        """The links that each joint carries; of the sensor's joints only those behind the sensor have a mass."""
        whole = super().carried
        return tuple(whole[self.cut.tool] if j in self.cut.axes else links for j, links in enumerate(whole))

    @cached_property
    def poses(self) -> np.ndarray:
        """(n, 13) time, rotation from the base to the sensor column by column, and position of the sensor, m."""
        rotation, place = self.cut.poses(self.motion.q[:, self.cut.moved])
        return np.column_stack([self.time, rotation.reshape(-1, 9), place])


class WrenchPredictor:
    """Predicts one axis of a sensor in one run.

    Args:
        stretch: the motion at the stamps of the channel.
        sampler: map from signals at the stamps to the samples.
        axis: index of the axis.
    """

    def __init__(self, stretch: CutMotionSamples, sampler: Sampler, axis: int) -> None:
        self._stretch, self._sampler, self._axis = stretch, sampler, axis
        self._coefficients = [CoefficientReduction(sampler, stretch, joint) for joint in stretch.cut.axes]
        self._late: tuple[float, list[Reduction]] | None = None
        self._inputs: dict[tuple[RecordedColumn, ...], np.ndarray] = {}

    def predict(
        self, reading: WrenchReading, theta: np.ndarray, bodies: RigidBodyChanges
    ) -> tuple[np.ndarray, np.ndarray, dict[int, np.ndarray]]:
        """(n,) samples, (n, k) derivatives by the sensor's parameters, and those by the parameters of each body.

        Args:
            reading: reading of the sensor with its effects.
            theta: (k,) parameters of these effects.
            bodies: changes of the bodies behind the sensor.
        """
        widths = {i: by_theta.shape[1] for i, by_theta in bodies.derivatives.items()}
        axes = []
        for reduced in self._delayed(reading.readout.delay(theta) if reading.readout.delays else 0.0):
            axes.append(TorqueWithDerivatives(len(reduced.described), widths))
            axes[-1].value += torque_of_bodies(reduced, list(bodies.links), bodies)
            add_derivatives_by_bodies(axes[-1], reduced, list(bodies.links), bodies)
        found = self._read(reading, theta, [axis.value for axis in axes])
        own, by_axis = found[1 : 1 + len(theta)].T, found[1 + len(theta) :]
        if reading.readout.delays:
            for by, reduced in zip(by_axis, self._coefficients, strict=True):
                true, none = torque_of_bodies(reduced, list(bodies.links), bodies), np.zeros((len(by), 1 + len(theta)))
                late = reading.readout.add_delay_derivatives(none, true, self._sampler, theta)
                own = own + by[:, None] * late[:, 1:]
        by_bodies = {i: sum(by[:, None] * axis.by(i) for by, axis in zip(by_axis, axes, strict=True)) for i in widths}
        return found[0], own, by_bodies

    def values(self, reading: WrenchReading, theta: np.ndarray, bodies: RigidBodyChanges) -> np.ndarray:
        """(n,) predicted samples of one force or torque, N or N m, with the parameters theta; without derivatives."""
        reduced = self._delayed(reading.readout.delay(theta) if reading.readout.delays else 0.0)
        return self._read(reading, theta, [torque_of_bodies(r, list(bodies.links), bodies) for r in reduced])[0]

    def _read(self, reading: WrenchReading, theta: np.ndarray, true: Sequence[np.ndarray]) -> np.ndarray:
        """(1 + k + 6, n) reading and its derivatives by theta and by the true wrench, given by six (n,) samples."""
        columns = reading.recorded
        if columns not in self._inputs:
            stretch = self._stretch
            beside = [column.interpolate(stretch.extra, stretch.motion.time) for column in columns]
            signals = np.column_stack([stretch.poses, *beside])
            self._inputs[columns] = np.asarray(self._sampler.matrix(0.0) @ self._sampler.coefficients(signals)).T
        inputs = np.split(self._inputs[columns], [self._stretch.poses.shape[1]])
        return reading.axes[self._axis](np.vstack([inputs[0], *true, inputs[1]]), theta)

    def _delayed(self, delay: float) -> list[Reduction]:
        """Reductions of the six axes to samples with a delay, s."""
        if self._late is None or self._late[0] != delay:
            matrix = self._sampler.matrix(delay)
            self._late = delay, [SampleReduction(one, matrix) for one in self._coefficients]
        return self._late[1]


class SensorWithEffects:
    """A sensor with its effects, of an arm with its own, at parameter values.

    What is fixed to the link that has the sensor hangs behind the sensor; what changes this link itself does not.

    Args:
        arm: the arm.
        sensor: the sensor.
        reading: what it reads with its effects.
        theta: (k,) parameters of these effects.
        functions: functions of all joints of the arm.
        joints: parameters of each joint.
        bodies: changes of the rigid bodies of the arm.
    """

    def __init__(
        self,
        arm: Arm,
        sensor: WrenchSensor,
        reading: WrenchReading,
        theta: np.ndarray,
        functions: Sequence[JointTorqueFunctions],
        joints: Sequence[np.ndarray],
        bodies: RigidBodyChanges,
    ) -> None:
        self._arm, self.sensor, self._given = arm, sensor, (reading, theta)
        self.cut = cut = cut_at_sensor(arm, sensor)
        self._joint_of = {cut.moved[i]: i for i in bodies.links if cut.behind(i)}
        links = {body: bodies.links[i] for body, i in self._joint_of.items()}
        derivatives = {body: bodies.derivatives[i] for body, i in self._joint_of.items()}
        load = functions[cut.host].load if cut.host >= 0 else None
        if load is not None:
            change, by_theta = load.at(np.eye(4), joints[cut.host])
            links[cut.tool], derivatives[cut.tool] = cut.transfer @ change, cut.transfer @ by_theta
            self._joint_of[cut.tool] = cut.host
        if bodies.gravity is not None:
            derivatives[BASE_INDEX] = bodies.derivatives[BASE_INDEX]
            self._joint_of[BASE_INDEX] = BASE_INDEX
        self._bodies = RigidBodyChanges(links, bodies.gravity, derivatives)

    @property
    def links(self) -> list[np.ndarray]:
        """(10,) inertial parameters of each link of the cut arm; of those before the sensor as described."""
        described = [inertia.toDynamicParameters() for inertia in list(self.cut.model.inertias)[1:]]
        return [link + self._bodies.links.get(body, 0.0) for body, link in enumerate(described)]

    def channels(self, run: Run) -> tuple[str, ...]:
        """Channels of a run that the sensor predicts."""
        return self.sensor.recorded(run)

    def predict(self, run: Run, name: str) -> tuple[np.ndarray, dict[int | str, np.ndarray]]:
        """(n,) samples of a channel, and (n, k) derivatives by the parameters of each joint, base, and the sensor."""
        values, own, by_bodies = self._predictor(run, name).predict(*self._given, self._bodies)
        return values, {self.sensor.name: own} | {self._joint_of[body]: columns for body, columns in by_bodies.items()}

    def values(self, run: Run, name: str) -> np.ndarray:
        """(n,) samples of a channel; see `predict`."""
        return self._predictor(run, name).values(*self._given, self._bodies)

    def at_states(self, stretch: MotionSamples) -> list[tuple[np.ndarray, dict[int | str, np.ndarray]]]:
        """Of each axis (n,) readings at n separate states, and derivatives as those of `predict`.

        Raises:
            InputError: the sensor is late, so that it reads what was before.
        """
        if self._given[0].readout.delays:
            raise InputError(f"the readings of the sensor '{self.sensor.name}' are late: leave out the effect")
        apart = np.arange(len(stretch.time), dtype=float)
        sampler, moved = InterpolatingSampler(apart, apart), CutMotionSamples.of(self.cut, stretch)
        found = []
        for axis in range(len(self.cut.axes)):
            values, own, by_bodies = WrenchPredictor(moved, sampler, axis).predict(*self._given, self._bodies)
            columns = {self._joint_of[body]: by for body, by in by_bodies.items()}
            found.append((values, {self.sensor.name: own} | columns))
        return found

    def noise(self, run: PreparedRun) -> dict[str, float]:
        """Standard deviation of the noise of a prepared run by channel."""
        cut, rigid = self.cut, self.cut.model.copy()
        for body, changed in enumerate(self.links):
            if body in self._bodies.links and changed[0] > 0.0:  # a body without mass has no centre
                rigid.inertias[body + 1] = pin.Inertia.FromDynamicParameters(changed)
        axes = {n: axis for n, axis in zip(self.sensor.channels, cut.axes, strict=True) if n in run.preparations}
        return torque_noise(run, rigid, cut.model, self._arm.joints, axes, cut.moved)

    def _predictor(self, run: Run, name: str) -> "WrenchPredictor":
        return wrench_predictor(run, self._arm, self.sensor, name)


@cached_with_first_argument
def wrench_predictor(run: Run, arm: Arm, sensor: WrenchSensor, name: str) -> WrenchPredictor:
    """The predictor of the channel `name` of a sensor, with the filter that was applied to the measured one."""
    stretch = _cut_stretch(run, arm, sensor, stamps_shared_with(run, name))
    sampler = sampler_of_channel(run, name, stretch, motion_of_run(run, arm.joints), None)
    return WrenchPredictor(stretch, sampler, sensor.channels.index(name))


@cached_with_first_argument
def _cut_stretch(run: Run, arm: Arm, sensor: WrenchSensor, name: str) -> CutMotionSamples:
    """The motion at the recorded stamps of a channel, of an arm that is cut at a sensor."""
    return CutMotionSamples.of(cut_at_sensor(arm, sensor), motion_samples(run, arm, name))
