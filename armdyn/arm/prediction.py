"""Predict the torques of a run with exact derivatives; parts without parameters are computed once per run."""

from collections.abc import Mapping, Sequence

import numpy as np

from armdyn.arm.arm import Arm
from armdyn.arm.bodies import BASE_INDEX, MotionSamples, RigidBodyChanges
from armdyn.arm.composition import LOAD_INPUT_INDEX, JointTorqueFunctions, PartlyLinearTorque
from armdyn.arm.drive import DriveLowPass, TorqueRecording, drive_low_passes
from armdyn.arm.motion import MeasuredMotion, mostly_resting_joint_mask
from armdyn.arm.prepared import (
    POSITION_NOISE_FREQUENCIES_HZ,
    PreparedRun,
    low_passed_and_thinned,
    motion_of_run,
    recorded_torques,
    samples_inside_motion,
    samples_with_known_direction,
)
from armdyn.arm.reduction import DelayedInputs, NonlinearTerm, Reduction, TorqueWithDerivatives
from armdyn.errors import InputError
from armdyn.object_cache import cached_with_first_argument
from armdyn.readout import InterpolatingSampler, LowPassSampler, Sampler
from armdyn.recording.channels import DriveReading
from armdyn.recording.spikes import without_spikes
from armdyn.run import Channel, Run


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
        self._late: tuple[float, Reduction] | None = None
        self._coefficients = Reduction(sampler.coefficients, stretch, joint)
        # Without lag and delay only the samples are needed, which are fewer than the coefficients.
        on_time = sampler.matrix(0.0)
        self._samples = Reduction(lambda signals: on_time @ sampler.coefficients(signals), stretch, joint)
        self._nodes = Reduction(lambda signals: signals, stretch, joint)

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
            total = self._total(self._nodes, *given)
            read = sensor.read(total.block, self._sampler, own)
        elif not sensor.delays or sensor.delay(own) == 0.0:
            total = self._total(self._samples, *given)
            whole = self._total(self._coefficients, *given).value if sensor.delays else total.value
            read = sensor.add_delay_derivatives(total.block, whole, self._sampler, own)
        else:
            total = self._total(self._coefficients, *given, of_joints=False)
            at_joints = self._total(self._read_late(sensor.delay(own)), *given, of_bodies=False)
            read = sensor.sample(total.block, self._sampler, own)
            on_time = np.asarray(self._sampler.matrix(0.0) @ at_joints.block)
            read += sensor.add_delay_derivatives(on_time, at_joints.value, self._sampler, own, 0.0)
        return read[:, 0], {i: read[:, columns] for i, columns in total.columns.items()}

    def _read_late(self, delay: float) -> Reduction:
        """The reduction to coefficients of signals `delay` s before each stamp."""
        if self._late is None or self._late[0] != delay:
            assert self._motion is not None, "a delayed reading needs the motion at any time"
            earlier = DelayedInputs(self._stretch, self._motion, delay)
            self._late = delay, Reduction(self._sampler.coefficients, self._stretch, self._joint, earlier)
        return self._late[1]

    def _total(
        self,
        reduced: Reduction,
        functions: Sequence[JointTorqueFunctions],
        theta: Sequence[np.ndarray],
        bodies: RigidBodyChanges,
        *,
        of_bodies: bool = True,
        of_joints: bool = True,
    ) -> TorqueWithDerivatives:
        """The sensor's reading without lag and delay: the sum of rigid bodies and effects in the joints."""
        j, own = self._joint, functions[self._joint]
        outer = [
            i for i, inner in enumerate(self._stretch.parents) if inner == j and not functions[i].inner_torque.empty
        ]
        carried = [i for i in bodies.links if self._stretch.carries(j, i)]
        loading = [i for k in outer for i in bodies.links if self._stretch.carries(k, i)]
        widths = {i: len(theta[i]) for i in dict.fromkeys((j, *outer, *carried, *loading))}
        if bodies.gravity is not None:
            widths[BASE_INDEX] = bodies.derivatives[BASE_INDEX].shape[1]
        total = TorqueWithDerivatives(len(reduced.described), widths)
        if of_bodies:
            total.value += reduced.described
        if of_joints:
            for term in own.torque:
                self._add(total, term, j, theta[j], bodies, reduced)
        if of_bodies:
            for i in carried:
                columns = reduced.link(i)
                total.value += columns @ bodies.links[i]
                total.by(i)[:] += columns @ bodies.derivatives[i]
        if of_bodies and bodies.gravity is not None:
            columns = reduced.per_gravity
            for i in carried:
                if bodies.links[i].any():
                    columns = columns + reduced.weight(i) @ bodies.links[i][:4]
                if bodies.gravity.any():
                    by_weight = np.einsum("k,nkp->np", bodies.gravity, reduced.weight(i))
                    total.by(i)[:] += by_weight @ bodies.derivatives[i][:4]
            total.value += columns @ bodies.gravity
            total.by(BASE_INDEX)[:] += columns @ bodies.derivatives[BASE_INDEX]
        if of_joints:
            for i in outer:
                self._add(total, functions[i].inner_torque, i, theta[i], bodies, reduced)
        total.block = own.sensor.amplify(total.block, theta[j])
        total.value = total.block[:, 0]
        if of_joints:
            self._add(total, own.offset, j, theta[j], bodies, reduced)
        return total

    def _add(
        self,
        total: TorqueWithDerivatives,
        term: PartlyLinearTorque,
        joint: int,
        theta: np.ndarray,
        bodies: RigidBodyChanges,
        reduced: Reduction,
    ) -> None:
        """Add a term of a joint's functions."""
        if term.empty:
            return
        if term not in reduced.linear:
            reduced.linear[term] = reduced.reduce(term.columns(reduced.inputs(joint, term.recorded), len(theta)))
        own = total.by(joint)
        for column, i in zip(reduced.linear[term].T, term.linear, strict=True):
            # One after the other: a further effect at zero changes no digit.
            total.value += column * theta[i]
            own[:, i] += column
        if term.has_rest:
            rest = self._rest(term, joint, theta, bodies, reduced)
            total.value += rest.coefficients[:, 0]
            for column, i in zip(rest.coefficients[:, 1:].T, term.nonlinear, strict=True):
                own[:, i] += column
            for i, slopes in rest.slopes.items():
                total.by(i)[:] += slopes @ bodies.derivatives[i]

    def _rest(
        self, term: PartlyLinearTorque, joint: int, theta: np.ndarray, bodies: RigidBodyChanges, reduced: Reduction
    ) -> NonlinearTerm:
        """Nonlinear rest of a term; the last one is reused while the values that it depends on do not change."""
        carried = [i for i in bodies.links if self._stretch.carries(joint, i)] if term.loaded else []
        changes = [bodies.links[i] for i in carried]
        if term.loaded and bodies.gravity is not None:
            changes.append(bodies.gravity)
        key = b"".join([theta[list(term.nonlinear)].tobytes(), *(change.tobytes() for change in changes)])
        last = reduced.rests.get(term)
        if last is not None and last.key == key:
            return last
        inputs = reduced.inputs(joint, term.recorded)
        if changes:
            inputs = inputs.copy()
            inputs[LOAD_INPUT_INDEX] += reduced.signal(self._stretch.rigid(joint, bodies))
        rest = term.rest(inputs, theta)
        per_load, slopes = rest[:, -1:], {}
        if per_load.any():
            for i in carried:  # ten columns for a link, however many parameters it has
                slopes[i] = reduced.reduce(per_load * reduced.signal(self._stretch.by_link(joint, i, bodies)))
            if term.loaded and bodies.gravity is not None:
                slopes[BASE_INDEX] = reduced.reduce(
                    per_load * reduced.signal(self._stretch.changed_per_gravity(joint, bodies))
                )
        found = NonlinearTerm(key, reduced.reduce(rest[:, :-1]), slopes)
        reduced.rests[term] = found
        return found


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
def prepared_without_outliers(run: Run, arm: Arm, beside: tuple[Run, ...]) -> PreparedRun:
    """The run with low-passed and thinned torques, without isolated outliers.

    Args:
        run: a recording.
        arm: the arm.
        beside: recordings from which the low-passes of the arm's drives are found; if empty, `run` alone.
    """
    clean, own = _recorded(run, arm)
    first, *others = beside or (run,)
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
    names = (f"{kind}.{joint}" for joint in arm.joints for kind in ("q", "v", "a", "tau"))
    clean = without_spikes(run, [name for name in names if name in run.channels])
    return clean, recorded_torques(clean, arm.model, arm.joints)


@cached_with_first_argument
def joint_torque_predictor(run: Run, arm: Arm, channel: Channel, name: str) -> JointTorquePredictor:
    """The predictor of the torque channel `name`, with the filter that was applied to the measured torque."""
    joint = arm.joints.index(name.removeprefix("tau."))
    sampler: Sampler
    motion, stretch = motion_of_run(run, arm.joints), _stretch(run, arm, name)
    if run.recording is not run:
        stamps, done = stretch.motion.time, run.preparations[name]
        known = samples_with_known_direction(motion, joint, stamps, done.cutoff)
        sampler = LowPassSampler(stamps, done.cutoff, channel.time, known, done.smoothed)
    else:
        sampler = InterpolatingSampler(channel.time, channel.time)
    return JointTorquePredictor(stretch, sampler, joint, motion)


@cached_with_first_argument
def _stretch(run: Run, arm: Arm, name: str) -> MotionSamples:
    """The motion at the recorded stamps of a channel; channels with the same stamps share it."""
    recording = run.recording
    channel = recording.channels[name]
    torques = (other for other in recording.channels if other.startswith("tau.") or other == name)
    first = next(o for o in torques if np.array_equal(recording.channels[o].time, channel.time))
    if first != name:
        return _stretch(run, arm, first)
    motion = motion_of_run(run, arm.joints)
    time = channel.time if recording is run else channel.time[samples_inside_motion(channel, motion)]
    start = min(float(c.time[0]) for c in recording.channels.values())
    drives = {
        key: c for key, c in recording.channels.items() if key.startswith("enabled.") or isinstance(c, DriveReading)
    }
    return MotionSamples(arm.model, motion.at(time), time - start, {**recording.extra, **drives})
