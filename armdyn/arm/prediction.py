"""Torques of one run with exact derivatives: what does not depend on the parameters is computed once per run."""

from collections.abc import Callable, Sequence
from functools import cache, cached_property, lru_cache
from typing import NamedTuple

import numpy as np

from armdyn.arm.arm import Arm
from armdyn.arm.bodies import OF_BASE, Bodies, Stretch
from armdyn.arm.composition import LOAD, JointFunctions, Term
from armdyn.arm.motion import measured_motion
from armdyn.arm.prepared import PreparedRun, interior, prepare, settled
from armdyn.arm.rigid import described_parameters
from armdyn.faults import without_spikes
from armdyn.readout import Interpolated, LowPassed, Sampler
from armdyn.run import Channel, Run


class Signal:
    """A torque while its parts are added up, with its derivatives by the joints that matter.

    Args:
        size: N, coefficients or samples.
        widths: number of parameters by joint.

    Attributes:
        block: (N, 1 + sum of the widths), the torque first.
        value: (N,) view of the torque.
        columns: by joint, where its parameters are in the block.
    """

    def __init__(self, size: int, widths: dict[int, int]) -> None:
        ends = np.cumsum([1, *widths.values()]).tolist()
        self.columns = {joint: slice(*ends[i : i + 2]) for i, joint in enumerate(widths)}
        self.block = np.zeros((size, ends[-1]))
        self.value = self.block[:, 0]

    def by(self, joint: int) -> np.ndarray:
        """(N, k) view of the derivatives by a joint's parameters."""
        return self.block[:, self.columns[joint]]


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
        # Not a method: large arrays in a circle of references would stay until Python looks for circles.
        self.weight = cache(lambda link: _reduced_weight(reduce, stretch.gravity_regressor[:, joint, link]))
        self.linear: dict[Term, np.ndarray] = {}
        self.rests: dict[Term, _Rest] = {}

    @cached_property
    def described(self) -> np.ndarray:
        """(N,) the torque of the arm as described."""
        return self.reduce(self._stretch.described[:, [self._joint]])[:, 0]

    @cached_property
    def per_gravity(self) -> np.ndarray:
        """(N, 3) the torque of the arm as described per component of gravity."""
        weights = described_parameters(self._stretch.model)[:, :4]
        return self.reduce(np.einsum("nlkp,lp->nk", self._stretch.gravity_regressor[:, self._joint], weights))


def _reduced_weight(reduce: Callable[[np.ndarray], np.ndarray], columns: np.ndarray) -> np.ndarray:
    """(N, 3, 4) of (n, 3, 4) torques per gravity and per mass and first moment of a link."""
    return reduce(columns.reshape(len(columns), -1)).reshape(-1, *columns.shape[1:])


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
        self._coefficients = _Reduction(sampler.coefficients, stretch, joint)
        # Without lag and delay the samples are all that is asked for: a few of them for many coefficients.
        on_time = sampler.matrix(0.0)
        self._samples = _Reduction(lambda signals: on_time @ sampler.coefficients(signals), stretch, joint)
        self._nodes = _Reduction(lambda signals: signals, stretch, joint)

    def predict(
        self, functions: Sequence[JointFunctions], theta: Sequence[np.ndarray], bodies: Bodies
    ) -> tuple[np.ndarray, dict[int, np.ndarray]]:
        """Samples (n,) of the channel, and by joint that matters their derivatives (n, k) by its parameters.

        Args:
            functions: of all joints.
            theta: (k,) parameters of each joint.
            bodies: at these parameters.
        """
        sensor, own = functions[self._joint].sensor, theta[self._joint]
        given = functions, theta, bodies
        if sensor.lags:
            total = self._total(self._nodes, *given)
            read = sensor.read(total.block, self._sampler, own)
        elif not sensor.delays or sensor.delay(own) == 0.0:
            total = self._total(self._samples, *given)
            whole = self._total(self._coefficients, *given).value if sensor.delays else total.value
            read = sensor.moved(total.block, whole, self._sampler, own)
        else:
            total = self._total(self._coefficients, *given)
            read = sensor.sampled(total.block, self._sampler, own)
        return read[:, 0], {i: read[:, columns] for i, columns in total.columns.items()}

    def _total(
        self, reduced: "_Reduction", functions: Sequence[JointFunctions], theta: Sequence[np.ndarray], bodies: Bodies
    ) -> Signal:
        """The sensor's reading without lag and delay."""
        j, own = self._joint, functions[self._joint]
        outer = [
            i for i in range(len(functions)) if self._stretch.parent(i) == j and not functions[i].inner_torque.empty
        ]
        carried = [i for i in bodies.links if self._stretch.carries(j, i)]
        loading = [i for k in outer for i in bodies.links if self._stretch.carries(k, i)]
        widths = {i: len(theta[i]) for i in dict.fromkeys((j, *outer, *carried, *loading))}
        if bodies.gravity is not None:
            widths[OF_BASE] = bodies.derivatives[OF_BASE].shape[1]
        total = Signal(len(reduced.described), widths)
        total.value += reduced.described
        for term in own.torque:
            self._add(total, term, j, theta[j], bodies, reduced)
        for i in carried:
            columns = reduced.link(i)
            total.value += columns @ bodies.links[i]
            total.by(i)[:] += columns @ bodies.derivatives[i]
        if bodies.gravity is not None:
            self._add_gravity(total, carried, bodies, bodies.gravity, reduced)
        for i in outer:
            self._add(total, functions[i].inner_torque, i, theta[i], bodies, reduced)
        total.block = own.sensor.amplified(total.block, theta[j])
        total.value = total.block[:, 0]
        self._add(total, own.offset, j, theta[j], bodies, reduced)
        return total

    def _add_gravity(
        self, total: Signal, carried: Sequence[int], bodies: Bodies, gravity: np.ndarray, reduced: "_Reduction"
    ) -> None:
        """Add the torque that follows from a gravity other than the described one."""
        columns = reduced.per_gravity
        for i in carried:
            if bodies.links[i].any():
                columns = columns + reduced.weight(i) @ bodies.links[i][:4]
            if gravity.any():
                by_weight = np.einsum("k,nkp->np", gravity, reduced.weight(i))
                total.by(i)[:] += by_weight @ bodies.derivatives[i][:4]
        total.value += columns @ gravity
        total.by(OF_BASE)[:] += columns @ bodies.derivatives[OF_BASE]

    def _add(
        self, total: Signal, term: Term, joint: int, theta: np.ndarray, bodies: Bodies, reduced: "_Reduction"
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
            rest = self._rest(term, joint, theta, bodies, reduced)
            total.value += rest.coefficients[:, 0]
            for column, i in zip(rest.coefficients[:, 1:].T, term.nonlinear, strict=True):
                own[:, i] += column
            for i, slopes in rest.slopes.items():
                total.by(i)[:] += slopes @ bodies.derivatives[i]

    def _rest(self, term: Term, joint: int, theta: np.ndarray, bodies: Bodies, reduced: "_Reduction") -> _Rest:
        """Most fits leave most of these parameters alone, so that the last answer often still holds."""
        carried = [i for i in bodies.links if self._stretch.carries(joint, i)] if term.loaded else []
        changes = [bodies.links[i] for i in carried]
        if term.loaded and bodies.gravity is not None:
            changes.append(bodies.gravity)
        key = b"".join([theta[list(term.nonlinear)].tobytes(), *(change.tobytes() for change in changes)])
        last = reduced.rests.get(term)
        if last is not None and last.key == key:
            return last
        inputs = self._inputs(joint)
        if changes:
            inputs = inputs.copy()
            inputs[LOAD] += self._stretch.rigid(joint, bodies)
        rest = term.rest(inputs, theta)
        per_load, slopes = rest[:, -1:], {}
        if per_load.any():
            for i in carried:  # ten columns for a link, however many parameters it has
                slopes[i] = reduced.reduce(per_load * self._stretch.by_link(joint, i, bodies))
            if term.loaded and bodies.gravity is not None:
                slopes[OF_BASE] = reduced.reduce(per_load * self._stretch.per_gravity(joint, bodies))
        found = _Rest(key, reduced.reduce(rest[:, :-1]), slopes)
        reduced.rests[term] = found
        return found


@lru_cache(maxsize=64)
def prepared_once(run: Run, arm: Arm, measured: tuple[str, ...]) -> PreparedRun:
    """See `prepare`; isolated outliers are left out before."""
    motion = (f"{kind}.{joint}" for joint in arm.joints for kind in "qva")
    clean = without_spikes(run, (*(name for name in motion if name in run.channels), *measured))
    return prepare(clean, arm.model, arm.joints, measured)


@lru_cache(maxsize=512)
def predictor_of(arm: Arm, run: Run, channel: Channel, name: str) -> ChannelPredictor:
    """What predicts the samples of a torque channel called `name`; filtered as the run was, where it was."""
    joint = arm.joints.index(name.removeprefix("tau."))
    sampler: Sampler
    if run.recording is not run:
        stretch = _stretch(run.recording, arm, name, True)
        stamps, cutoff = stretch.motion.time, run.preparations[name].cutoff
        known = settled(measured_motion(run.recording, arm.joints), joint, stamps, cutoff)
        sampler = LowPassed(stamps, cutoff, channel.time, known)
    else:
        stretch = _stretch(run, arm, name, False)
        sampler = Interpolated(channel.time, channel.time)
    return ChannelPredictor(stretch, sampler, joint)


@lru_cache(maxsize=64)
def _stretch(run: Run, arm: Arm, name: str, without_ends: bool) -> Stretch:
    """The motion at the stamps of a channel; channels that were sampled together share it."""
    channel = run.channels[name]
    for other in run.channels:
        if other == name:
            break
        if other.startswith("tau.") and np.array_equal(run.channels[other].time, channel.time):
            return _stretch(run, arm, other, without_ends)
    motion = measured_motion(run, arm.joints)
    time = channel.time[interior(channel, motion)] if without_ends else channel.time
    start = min(float(c.time[0]) for c in run.channels.values())
    return Stretch(arm.model, motion.at(time), time - start)
