"""Hypotheses on the true model, each as fitted to the runs, and their predictions for an experiment."""

from collections.abc import Mapping
from copy import copy
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache

import numpy as np

from armdyn.experiments.series import Basis
from armdyn.pendulum.model import PendulumModel
from armdyn.pendulum.path import GripperPath
from armdyn.physics.adjoint import Adjoint
from armdyn.physics.recorded import halfway, slope
from armdyn.physics.simulate import Rollout, System
from armdyn.readout import Interpolated, lagged
from armdyn.recording.channels import Channel
from armdyn.run import Run

CHANNELS = ("load_force", "swing_angle")
START_SPREAD = {"initial_angle": 0.01, "initial_rate": 0.03}
"""Standard deviation of the start of a load that is said to hang at rest, rad and rad/s."""


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """One hypothesis on the true model.

    Attributes:
        name: name of the effects that it adds.
        model: model with the fitted values.
        free: parameters that a fit may change and that all runs share.
        information: (k, k) information of runs and priors on `free`, in the inverse squares of their units.
        misfit: chi2 less that of the best hypothesis so far.
    """

    name: str
    model: PendulumModel
    free: tuple[str, ...]
    information: np.ndarray
    misfit: float = 0.0

    @cached_property
    def rest_angle(self) -> float:
        """Angle at which its load hangs at rest, rad."""
        return self.model.rest_angle()


@dataclass(frozen=True, eq=False)
class Experiment:
    """One experiment that could be made.

    Attributes:
        kind: motion, mass, length, angle_sensor, weigh, measure, turn or rest.
        what: what to do, for a reader.
        motion: motion of the gripper from rest to rest, its time from 0; None where nothing is recorded.
        noise: by channel, standard deviation of one sample, increased for the samples' correlation, in the channel's
            unit.
        changed: parameters with another value in this run only, with that value and its standard deviation.
        measured: parameters that are measured by hand, with the standard deviation of the measurement.
        turned: parameters whose sign is opposite in this run.
        rate: sampling rate of each channel, Hz.
    """

    kind: str
    what: str
    motion: GripperPath | None = None
    noise: Mapping[str, float] = field(default_factory=dict)
    changed: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    measured: Mapping[str, float] = field(default_factory=dict)
    turned: tuple[str, ...] = ()
    rate: float = 100.0

    def along(self, motion: GripperPath) -> "Experiment":
        """The same experiment with another motion."""
        return replace(self, motion=motion)

    @cached_property
    def run(self) -> Run | None:
        """A recording of the experiment, whose measured values do not matter."""
        if self.motion is None:
            return None
        time, units = self.motion.time, ("m", "m/s", "m/s^2")
        gripper = {
            name: Channel(time, row, unit)
            for name, row, unit in zip(("gripper_x", "gripper_v", "gripper_a"), self.motion.along, units, strict=True)
        }
        nothing = np.zeros(len(time))
        empty = {name: Channel(time, nothing, unit) for name, unit in zip(CHANNELS, ("N", "rad"), strict=True)}
        return Run("experiment", {**gripper, **empty})


class PredictedExperiment:
    """Prediction of a hypothesis for an experiment, over the noise, with the prior knowledge of its unknowns.

    Attributes:
        names: names of the unknowns: those that all runs share, then those of this experiment.
        prior: (m, m) information on them before the experiment.
        spread: (m, m) square root of the covariance of the true values, if the hypothesis is true.
        start: (m,) values of the unknowns before the experiment.
    """

    def __init__(self, hypothesis: Hypothesis, experiment: Experiment) -> None:
        self.hypothesis, self.experiment = hypothesis, experiment
        model, k = hypothesis.model, len(hypothesis.free)
        own = (*model.start_names, *experiment.changed) if experiment.motion is not None else ()
        self.names = (*hypothesis.free, *own)
        self._shared = k
        size = k + len(own)
        self.prior, self.spread = np.zeros((size, size)), np.zeros((size, size))
        self.prior[:k, :k] = hypothesis.information
        self.spread[:k, :k] = _root_of_inverse(hypothesis.information)
        begin = {"initial_angle": hypothesis.rest_angle, "initial_rate": 0.0}
        values = {**{name: model.value(name) for name in hypothesis.free}, **begin}
        values |= {name: value for name, (value, _) in experiment.changed.items()}
        self.start = np.array([model.value(name) for name in hypothesis.free] + [values[name] for name in own])
        for i, name in enumerate(own, start=k):
            if name in experiment.changed:
                std = experiment.changed[name][1]
                self.prior[i, i], self.spread[i, i] = std**-2.0, std
            else:
                self.spread[i, i] = START_SPREAD[name]
        bounded = [model.parameters[name] for name in self.names]
        self.lower = np.array([p.lower for p in bounded])
        self.upper = np.array([p.upper for p in bounded])
        self.typical = np.array([p.typical for p in bounded])
        self._sign = np.array([-1.0 if name in experiment.turned else 1.0 for name in model.names])
        # Where a name occurs twice, the last one counts: the value in this run.
        self._place = {name: i for i, name in enumerate(self.names)}
        self._known: tuple[bytes, tuple[np.ndarray, np.ndarray]] | None = None
        self._rolled: tuple[bytes, Rollout] | None = None

    def along(self, motion: GripperPath) -> "PredictedExperiment":
        """The same prediction for another motion."""
        other = copy(self)
        other.experiment, other._known, other._rolled = self.experiment.along(motion), None, None
        other.__dict__.pop("weights", None)
        return other

    def theta(self, values: np.ndarray) -> np.ndarray:
        """(p,) parameter vector of the model in this experiment, at (m,) values of the unknowns."""
        model = self.hypothesis.model
        given = [values[self._place[name]] if name in self._place else model.value(name) for name in model.names]
        return np.array(given) * self._sign

    def predict(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(n,) readings over their noise at (m,) values, and (n, m) derivatives; values measured by hand come last."""
        key = values.tobytes()
        if self._known is None or self._known[0] != key:
            self._known = key, self._predicted(values)
        return self._known[1]

    def _predicted(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        e, model = self.experiment, self.hypothesis.model
        readings, slopes = [np.zeros(0)], [np.zeros((0, len(self.names)))]
        if e.run is not None and e.motion is not None:
            measured, whole = tuple(self.weights), self.rollout(values)
            rows = [CHANNELS.index(channel) for channel in measured]
            rolled = whole._replace(outputs=whole.outputs[:, rows], sensitivities=whole.sensitivities[:, rows])
            found = model.readings(e.run, e.motion, rolled, self.theta(values), measured)
            columns = [model.names.index(name) for name in self.names]
            for channel, weight in self.weights.items():
                here = found.slices[channel]
                readings.append(found.values[here] * weight)
                slopes.append(found.sensitivities[here][:, columns] * (self._sign[columns] * weight))
            for name in e.changed:
                if name in self.hypothesis.free:  # the value of the other runs does not act in this one
                    for part in slopes:
                        part[:, self.hypothesis.free.index(name)] = 0.0
        for name, std in e.measured.items():
            row = np.zeros((1, len(self.names)))
            if name in self._place:
                row[0, self._place[name]] = 1.0 / std
            value = values[self._place[name]] if name in self._place else model.value(name)
            readings.append(np.array([value / std]))
            slopes.append(row)
        return np.concatenate(readings), np.vstack(slopes)

    @cached_property
    def weights(self) -> dict[str, float]:
        """One over the noise of every channel that the experiment measures, in the order of the readings."""
        e = self.experiment
        per_node = np.sqrt(e.motion.dt * e.rate) if e.motion is not None else 1.0
        return {channel: per_node / e.noise[channel] for channel in CHANNELS if channel in e.noise}

    def rollout(self, values: np.ndarray) -> Rollout:
        """Both channels along the motion; the last result is cached."""
        key = values.tobytes()
        if self._rolled is None or self._rolled[0] != key:
            assert self.experiment.motion is not None, "an experiment without a motion moves nothing"
            self._rolled = key, self.hypothesis.model.rollout(self.experiment.motion, self.theta(values), CHANNELS)
        return self._rolled[1]

    def swing(self, values: np.ndarray) -> np.ndarray:
        """(K,) angle of the load along the motion, rad."""
        return np.asarray(self.rollout(values).outputs[:, CHANNELS.index("swing_angle")])

    def tension(self, values: np.ndarray) -> np.ndarray:
        """(K,) tension of the string along the motion, N."""
        return np.asarray(self.rollout(values).outputs[:, CHANNELS.index("load_force")])

    def by_coefficients(
        self, values: np.ndarray, basis: Basis, readings: np.ndarray, swing: np.ndarray | None = None
    ) -> np.ndarray:
        """(size,) derivative of a weighted sum of readings with respect to the coefficients of the motion.

        Args:
            values: (m,) values of the unknowns.
            basis: functions of which the motion consists, at its nodes.
            readings: (n,) weights of the readings over their noise.
            swing: (K,) weights of the load's angle, besides the readings.
        """
        model, motion = self.hypothesis.model, self.experiment.motion
        assert motion is not None, "an experiment without a motion has no coefficients"
        physics = np.array([self.theta(values)[model.names.index(name)] for name in model.physics_names])
        sampler, count = Interpolated(motion.time, motion.time), len(motion.time)
        outputs = np.zeros((count, len(CHANNELS)))
        for i, (channel, weight) in enumerate(self.weights.items()):
            part = readings[i * count : (i + 1) * count] * weight
            sensor = model.system.sensors[channel]
            outputs[:, CHANNELS.index(channel)] += sensor.adjoint(part, sampler, physics)
        if swing is not None:
            outputs[:, CHANNELS.index("swing_angle")] += swing
        path = model.driven_by(motion, physics)
        adjoint = _adjoint(model.system, model.formulation)
        nodes, middle = adjoint.gradient(path, physics, self.rollout(values).states, outputs)
        at_nodes, between = _driving(basis, model.gripper_lag(physics))
        jerk = slice(7, 8) if len(nodes) > 7 else slice(0, 0)
        rows = [*nodes[1:4], *nodes[jerk]], [*middle[1:4], *middle[jerk]]
        return (
            np.concatenate(rows[0]) @ at_nodes[: count * len(rows[0])]
            + np.concatenate(rows[1]) @ between[: (count - 1) * len(rows[1])]
        )


@lru_cache(maxsize=32)
def _adjoint(system: System, name: str) -> Adjoint:
    return Adjoint(system, name, CHANNELS)


@lru_cache(maxsize=8)
def _driving(basis: Basis, lag: float) -> tuple[np.ndarray, np.ndarray]:
    """Position, velocity, acceleration and jerk of the string's upper end for each coefficient, stacked.

    The shapes are (4 K, size) at the nodes and (4 (K - 1), size) halfway between.
    """
    _, count, size = basis.functions.shape
    rows, step = basis.functions, float(basis.time[1] - basis.time[0])
    if lag > 0.0:
        rows = np.stack([lagged(part, lag, step)[0] for part in rows])
    between = np.asarray(halfway(rows, step)).reshape(3, count - 1, size)
    jerk = slope(rows[2], step)
    return (np.concatenate([*rows, jerk]), np.concatenate([*between, (jerk[1:] + jerk[:-1]) / 2]))


def _root_of_inverse(information: np.ndarray) -> np.ndarray:
    """(k, k) A with A A' the inverse; directions without information get no error."""
    if not len(information):
        return information.copy()
    scale = np.sqrt(np.maximum(np.diag(information), np.finfo(float).tiny))
    values, vectors = np.linalg.eigh(information / np.outer(scale, scale))
    kept = values > 1e-12 * values[-1]
    roots = np.where(kept, 1.0 / np.sqrt(np.where(kept, values, 1.0)), 0.0)
    return np.asarray(vectors * roots / scale[:, None])
