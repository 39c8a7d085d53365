"""Predict the torques of a run with exact derivatives; parts without parameters are computed once per run."""

from collections.abc import Mapping, Sequence

import numpy as np

from armdyn.arm.arm import Arm
from armdyn.arm.bodies import BASE_INDEX, MotionSamples, RigidBodyChanges
from armdyn.arm.composition import JointTorqueFunctions, PartlyLinearTorque
from armdyn.arm.drive import DriveLowPass, RecordedTorque, TorqueRecording, drive_low_passes
from armdyn.arm.motion import MeasuredMotion, mostly_resting_joint_mask
from armdyn.arm.prepared import (
    POSITION_NOISE_FREQUENCIES_HZ,
    PreparedRun,
    low_passed_and_thinned,
    motion_of_run,
    recorded_torques,
    recorded_wrench,
    samples_inside_motion,
    samples_with_known_direction,
)
from armdyn.arm.reduction import (
    CoefficientReduction,
    DelayedInputs,
    Reduction,
    SampleReduction,
    TorqueWithDerivatives,
)
from armdyn.arm.wrench.sensor import WrenchSensor, cut_at_sensor
from armdyn.errors import InputError
from armdyn.object_cache import cached_with_first_argument
from armdyn.readout import InterpolatingSampler, LowPassSampler, Sampler
from armdyn.recording.channels import WRENCH_CHANNELS, DriveReading, channel_kind
from armdyn.recording.spikes import without_spikes
from armdyn.run import Run


class JointTorquePredictor:
    """Predicts the torque of one joint in one run.

    Args:
        stretch: the motion at the stamps of the channel.
        sampler: map from signals at the stamps to the samples.
        joint: index of the joint.
        motion: the motion at any time; None where no reading has a delay.
    """

    def __init__(
        self, stretch: MotionSamples, sampler: Sampler, joint: int, motion: MeasuredMotion | None = None
    ) -> None:
        self._stretch, self._sampler, self._joint, self._motion = stretch, sampler, joint, motion
        self._late: tuple[float, tuple[CoefficientReduction, Reduction, Reduction]] | None = None
        self._coefficients = CoefficientReduction(sampler, stretch, joint)
        self._samples = SampleReduction(self._coefficients, sampler.matrix(0.0))
        self._nodes = CoefficientReduction(InterpolatingSampler(sampler.nodes, sampler.nodes), stretch, joint)

    def predict(
        self, functions: Sequence[JointTorqueFunctions], theta: Sequence[np.ndarray], bodies: RigidBodyChanges
    ) -> tuple[np.ndarray, dict[int, np.ndarray]]:
        """(n,) samples of the channel, and (n, k) derivatives by the parameters of each joint that it depends on.

        Args:
            functions: functions of all joints.
            theta: (k,) parameters of each joint.
            bodies: changes of the rigid bodies at these parameters.
        """
        sensor, own = functions[self._joint].sensor, theta[self._joint]
        given = functions, theta, bodies
        if sensor.lags:
            total = self._total(self._nodes, self._nodes, *given)
            read = sensor.read(total.block, self._sampler, own)
        else:
            joints, joint_samples, rigid_samples = self._delayed(sensor.delay(own) if sensor.delays else 0.0)
            total = self._total(rigid_samples, joint_samples, *given)
            read = total.block
            if sensor.delays:
                # The rigid bodies are late in their samples, the effects in the joints already in their inputs.
                rigid = self._of_rigid_bodies(self._coefficients, *given)
                read = sensor.add_delay_derivatives(read, rigid, self._sampler, own)
                read = sensor.add_delay_derivatives(read, self._of_effects(joints, *given), self._sampler, own, 0.0)
        return read[:, 0], {i: read[:, columns] for i, columns in total.columns.items()}

    def values(
        self, functions: Sequence[JointTorqueFunctions], theta: Sequence[np.ndarray], bodies: RigidBodyChanges
    ) -> np.ndarray:
        """(n,) samples of the channel, up to rounding those of `predict`, in a fraction of the time."""
        sensor, given = functions[self._joint].sensor, (functions, theta, bodies)
        if sensor.lags:
            return self.predict(*given)[0]
        delay = sensor.delay(theta[self._joint]) if sensor.delays else 0.0
        effects = self._sampler.matrix(0.0) @ self._of_effects(self._delayed(delay)[0], *given)
        if delay == 0.0:
            return self._of_rigid_bodies(self._samples, *given) + effects
        return self._sampler.matrix(delay) @ self._of_rigid_bodies(self._coefficients, *given) + effects

    def _of_rigid_bodies(
        self,
        reduced: Reduction,
        functions: Sequence[JointTorqueFunctions],
        theta: Sequence[np.ndarray],
        bodies: RigidBodyChanges,
    ) -> np.ndarray:
        """(N,) part of the reading by the rigid bodies, without lag and delay."""
        torque = torque_of_bodies(reduced, self._carried_by(self._joint, bodies), bodies)
        return functions[self._joint].sensor.gain(theta[self._joint]) * torque

    def _of_effects(
        self,
        reduced: CoefficientReduction,
        functions: Sequence[JointTorqueFunctions],
        theta: Sequence[np.ndarray],
        bodies: RigidBodyChanges,
    ) -> np.ndarray:
        """(N,) part of the reading by effects in the joints, without lag: one signal is reduced instead of many."""
        own = functions[self._joint]
        torque, offset = (
            sum(
                (reduced.at_stamps(term, i, theta[i], bodies) for i, term in terms if not term.empty),
                np.zeros(self._stretch.motion.time.shape),
            )
            for terms in (self._terms(functions), [(self._joint, own.offset)])
        )
        return reduced.coefficients((own.sensor.gain(theta[self._joint]) * torque + offset)[:, None])[:, 0]

    def _terms(self, functions: Sequence[JointTorqueFunctions]) -> list[tuple[int, PartlyLinearTorque]]:
        """Torques of the joint's own effects, and of those of its outer neighbours on it, each with its joint."""
        j = self._joint
        outer = [(i, functions[i].inner_torque) for i, inner in enumerate(self._stretch.parents) if inner == j]
        return [(i, term) for i, term in [*((j, term) for term in functions[j].torque), *outer] if not term.empty]

    def _carried_by(self, joint: int, bodies: RigidBodyChanges) -> list[int]:
        """Links with effects that a joint carries."""
        return [i for i in bodies.links if self._stretch.carries(joint, i)]

    def _delayed(self, delay: float) -> tuple[CoefficientReduction, Reduction, Reduction]:
        """Reductions with a delay, s: coefficients of effects in the joints, their samples, those of rigid bodies."""
        if delay == 0.0:
            return self._coefficients, self._samples, self._samples
        if self._late is None or self._late[0] != delay:
            assert self._motion is not None, "a delayed reading needs the motion at any time"
            earlier = DelayedInputs(self._stretch, self._motion, delay)
            joints = CoefficientReduction(self._sampler, self._stretch, self._joint, earlier)
            samples = SampleReduction(joints, self._sampler.matrix(0.0))
            self._late = delay, (joints, samples, SampleReduction(self._coefficients, self._sampler.matrix(delay)))
        return self._late[1]

    def _total(
        self,
        rigid: Reduction,
        joints: Reduction,
        functions: Sequence[JointTorqueFunctions],
        theta: Sequence[np.ndarray],
        bodies: RigidBodyChanges,
    ) -> TorqueWithDerivatives:
        """The sensor's reading without lag and delay: the sum of rigid bodies and effects in the joints.

        Args:
            rigid: reduction of the torque of the rigid bodies.
            joints: reduction of the effects in the joints.
            functions: functions of all joints.
            theta: (k,) parameters of each joint.
            bodies: changes of the rigid bodies at these parameters.
        """
        j, own, terms = self._joint, functions[self._joint], self._terms(functions)
        concerned = dict.fromkeys([j, *(i for i, _ in terms)])
        widths = {i: len(theta[i]) for i in [*concerned, *(i for k in concerned for i in self._carried_by(k, bodies))]}
        if bodies.gravity is not None:
            widths[BASE_INDEX] = bodies.derivatives[BASE_INDEX].shape[1]
        total = TorqueWithDerivatives(len(rigid.described), widths)
        carried = self._carried_by(j, bodies)
        total.value += torque_of_bodies(rigid, carried, bodies)
        add_derivatives_by_bodies(total, rigid, carried, bodies)
        self._add_terms(total, terms, theta, bodies, joints)
        total.block = own.sensor.amplify(total.block, theta[j])
        total.value = total.block[:, 0]
        if not own.offset.empty:
            self._add_terms(total, [(j, own.offset)], theta, bodies, joints)
        return total

    def _add_terms(
        self,
        total: TorqueWithDerivatives,
        terms: Sequence[tuple[int, PartlyLinearTorque]],
        theta: Sequence[np.ndarray],
        bodies: RigidBodyChanges,
        reduced: Reduction,
    ) -> None:
        """Add terms of the joints' functions, each with its joint, and their derivatives."""
        by_load: dict[int, np.ndarray] = {}
        for joint, term in terms:
            own = total.by(joint)
            if term.linear:
                columns = reduced.linear(term, joint, len(theta[joint]))
                for column, i in zip(columns.T, term.linear, strict=True):
                    total.value += column * theta[joint][i]  # one after the other: one more at zero changes no digit
                own[:, term.linear] += columns
            if term.has_rest:
                rest = reduced.rest(term, joint, theta[joint], bodies)
                total.value += rest.reduced[:, 0]
                own[:, term.nonlinear] += rest.reduced[:, 1:]
                if term.loaded:
                    by_load[joint] = by_load.get(joint, 0.0) + rest.per_load
        for joint, per_load in by_load.items():
            links = self._carried_by(joint, bodies)
            if not per_load.any() or not (links or bodies.gravity is not None):
                continue
            through = reduced.through_load(joint, per_load, links, bodies)
            for k, i in enumerate(links):
                total.by(i)[:] += through.links[:, k] @ bodies.derivatives[i]
            if bodies.gravity is not None:
                total.by(BASE_INDEX)[:] += through.gravity @ bodies.derivatives[BASE_INDEX]


def torque_of_bodies(reduced: Reduction, carried: Sequence[int], bodies: RigidBodyChanges) -> np.ndarray:
    """(N,) torque of the rigid bodies of a joint that carries the links with effects `carried`."""
    torque = reduced.described.copy()
    for i in carried:
        torque += reduced.link(i) @ bodies.links[i]
    if bodies.gravity is not None:
        torque += _per_gravity(reduced, carried, bodies) @ bodies.gravity
    return torque


def _per_gravity(reduced: Reduction, carried: Sequence[int], bodies: RigidBodyChanges) -> np.ndarray:
    """(N, 3) torque of changed rigid bodies per component of gravity."""
    columns = reduced.per_gravity
    for i in carried:
        if bodies.links[i].any():
            columns = columns + (reduced.weight(i).reshape(-1, 4) @ bodies.links[i][:4]).reshape(columns.shape)
    return columns


def add_derivatives_by_bodies(
    total: TorqueWithDerivatives, reduced: Reduction, carried: Sequence[int], bodies: RigidBodyChanges
) -> None:
    """Add the derivatives of `torque_of_bodies` by the parameters of links and of the base.

    Args:
        total: torques of a joint with derivatives; they are changed in place.
        reduced: rigid-body torques of this joint at the compared times.
        carried: indices of the links that the joint carries.
        bodies: changes of links and of gravity, with their derivatives.
    """
    for i in carried:
        total.by(i)[:] += reduced.link(i) @ bodies.derivatives[i]
        if bodies.gravity is not None and bodies.gravity.any():
            by_weight = np.einsum("k,nkp->np", bodies.gravity, reduced.weight(i))
            total.by(i)[:] += by_weight @ bodies.derivatives[i][:4]
    if bodies.gravity is not None:
        total.by(BASE_INDEX)[:] += _per_gravity(reduced, carried, bodies) @ bodies.derivatives[BASE_INDEX]


def predict_at_states(
    stretch: MotionSamples,
    functions: Sequence[JointTorqueFunctions],
    theta: Sequence[np.ndarray],
    bodies: RigidBodyChanges,
) -> list[tuple[np.ndarray, dict[int, np.ndarray]]]:
    """Predicted torques of each joint at n separate states, rather than along a motion.

    Raises:
        InputError: an effect makes a torque depend on the past.
    """
    for own in functions:
        if own.depends_on_past:
            late = ", ".join(dict.fromkeys(name.partition(".")[0] for name in own.names))
            raise InputError(
                f"among the effects {late} is one by which a torque depends on what was before, a delay or a state "
                "of its own: leave it out"
            )
    apart = np.arange(len(stretch.time), dtype=float)
    sampler = InterpolatingSampler(apart, apart)
    return [JointTorquePredictor(stretch, sampler, j).predict(functions, theta, bodies) for j in range(len(functions))]


@cached_with_first_argument
def prepared_without_outliers(
    run: Run, arm: Arm, beside: tuple[Run, ...], sensors: tuple[WrenchSensor, ...] = ()
) -> PreparedRun:
    """The run with low-passed and thinned torques and wrenches, without isolated outliers.

    Args:
        run: a recording.
        arm: the arm.
        beside: recordings from which the low-passes of the arm's drives are found; if empty, `run` alone.
        sensors: force/torque sensors of the arm.
    """
    clean, own = _recorded(run, arm)
    first, *others = beside or (run,)
    wrenches = dict[str, RecordedTorque]()
    for sensor in sensors:
        cut = cut_at_sensor(arm, sensor)
        wrenches |= recorded_wrench(clean, sensor.channels, cut.model, own.motion, cut.moved, cut.axes)
    own = own._replace(torques={**own.torques, **wrenches})
    return low_passed_and_thinned(clean, arm.joints, own, *_shown_together(first, arm, tuple(others)))


@cached_with_first_argument
def _shown_together(
    first: Run, arm: Arm, others: tuple[Run, ...]
) -> tuple[Mapping[str, DriveLowPass], tuple[bool, ...]]:
    """Low-passes of the drives in several recordings, and whether each joint hardly moved in them."""
    every = [_recorded(run, arm)[1] for run in (first, *others)]
    return drive_low_passes(every, arm.model, POSITION_NOISE_FREQUENCIES_HZ), mostly_resting_joint_mask(
        [one.motion for one in every]
    )


@cached_with_first_argument
def _recorded(run: Run, arm: Arm) -> tuple[Run, TorqueRecording]:
    """A run without isolated outliers, and its torques and motion."""
    names = {f"{kind}.{joint}" for joint in arm.joints for kind in ("q", "v", "a", "tau")}
    clean = without_spikes(run, [n for n in run.channels if n in names or n.partition(".")[0] in WRENCH_CHANNELS])
    return clean, recorded_torques(clean, arm.model, arm.joints)


@cached_with_first_argument
def joint_torque_predictor(run: Run, arm: Arm, name: str) -> JointTorquePredictor:
    """The predictor of the torque channel `name`, with the filter that was applied to the measured torque."""
    joint = arm.joints.index(name.removeprefix("tau."))
    motion, stretch = motion_of_run(run, arm.joints), motion_samples(run, arm, name)
    return JointTorquePredictor(stretch, sampler_of_channel(run, name, stretch, motion, joint), joint, motion)


def sampler_of_channel(
    run: Run, name: str, stretch: MotionSamples, motion: MeasuredMotion, joint: int | None
) -> Sampler:
    """The map from signals at the stamps of a channel to its samples, with the filter that was applied to it.

    Args:
        run: the run.
        name: name of the channel.
        stretch: the motion at the stamps.
        motion: the motion at any time.
        joint: index of the joint whose friction is a part of the channel; None for a wrench.
    """
    channel = run.channels[name]
    if run.recording is run:
        return InterpolatingSampler(channel.time, channel.time)
    stamps, done = stretch.motion.time, run.preparations[name]
    known = samples_with_known_direction(motion, joint, stamps, done.cutoff)
    return LowPassSampler(stamps, done.cutoff, channel.time, known, done.smoothed)


def stamps_shared_with(run: Run, name: str) -> str:
    """The first measured channel of a recording that has the same stamps as the channel `name`."""
    channels = run.recording.channels
    compared = (other for other in channels if channel_kind(other).measured or other == name)
    return next(o for o in compared if np.array_equal(channels[o].time, channels[name].time))


@cached_with_first_argument
def motion_samples(run: Run, arm: Arm, name: str) -> MotionSamples:
    """The motion at the recorded stamps of a channel; channels with the same stamps share it."""
    recording = run.recording
    channel = recording.channels[name]
    first = stamps_shared_with(run, name)
    if first != name:
        return motion_samples(run, arm, first)
    motion = motion_of_run(run, arm.joints)
    time = channel.time if recording is run else channel.time[samples_inside_motion(channel, motion)]
    start = min(float(c.time[0]) for c in recording.channels.values())
    drives = {
        key: c for key, c in recording.channels.items() if key.startswith("enabled.") or isinstance(c, DriveReading)
    }
    return MotionSamples(arm.model, motion.at(time), time - start, {**recording.extra, **drives})
