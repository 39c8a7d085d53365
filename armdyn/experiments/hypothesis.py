"""Hypotheses on the true model, each fitted to the runs, and their predictions for an experiment."""

from collections.abc import Callable, Mapping
from copy import copy
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from typing import Any, TypeVar, cast

import numpy as np
from scipy.linalg import block_diag

from armdyn.document import Curve
from armdyn.estimation.covariance import covariance_root
from armdyn.experiments.series import SeriesBasis
from armdyn.model import Prediction
from armdyn.pendulum.model import PendulumModel
from armdyn.pendulum.path import GripperPath
from armdyn.physics.adjoint import Adjoint
from armdyn.physics.simulate import Rollout, System
from armdyn.physics.simulated import SimulatedModel
from armdyn.readout import InterpolatingSampler, first_order_lag
from armdyn.recording.channels import Channel
from armdyn.run import Run
from armdyn.smoothing.even import first_derivative, motion_at_midpoints

T = TypeVar("T")
EXPERIMENT_CHANNELS = ("load_force", "swing_angle")
START_STD = {"initial_angle": 0.01, "initial_rate": 0.03}
"""Standard deviation of angle, rad, and rate, rad/s, at the start of an experiment with a load that hangs at rest."""
RELEASE_STD = {"initial_angle": 0.05, "initial_rate": 0.1}
"""The same of a load that a hand releases."""


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """A hypothesis on the true model: a model with the values that fit the runs best.

    Attributes:
        name: name of the effects that it adds.
        model: model with the fitted values.
        free: parameters that a fit may change and that all runs share.
        information: (k, k) information of runs and priors on `free`, in inverse squares of the parameters' units.
        misfit: chi2 less that of the best hypothesis so far.
        begun: state at the start of the last run, by name of its start value.
    """

    name: str
    model: SimulatedModel
    free: tuple[str, ...]
    information: np.ndarray
    misfit: float = 0.0
    begun: Mapping[str, float] = field(default_factory=dict)

    @cached_property
    def rest_angle(self) -> float:
        """Angle, rad, at which the load hangs at rest by this hypothesis."""
        return self.pendulum.rest_angle()

    @property
    def pendulum(self) -> PendulumModel:
        """The model, which must be that of a pendulum."""
        return cast(PendulumModel, self.model)  # see `require_plannable`


@dataclass(frozen=True, eq=False)
class PlannedExperiment:
    """An experiment that could be done.

    Attributes:
        kind: motion, mass, length, angle_sensor, weigh, measure, turn or rest; below a pivot that stands still also
            larger, smaller or longer; with a process of one's own step, small_step, steps, chirp, longer, larger or
            smaller.
        what: instruction for the experimenter.
        motion: motion of the gripper from rest to rest, its time from 0; None where nothing is recorded.
        noise: by channel, standard deviation of one sample, increased for the samples' correlation, in the channel's
            unit.
        changed: parameters with another value in this run only, with that value and its standard deviation.
        measured: parameters that are measured by hand, with the standard deviation of the measurement.
        sign_reversed: parameters that have the opposite sign in this run.
        released: angle from which a hand releases the load, rad; None for a load that hangs at rest.
        rate: sampling rate of each channel, Hz.
        elapsed: time from the beginning of the recordings to that of the experiment, s, for effects that change with
            time.
        recording: of a process of one's own, inputs and time stamps of what is measured; None for a pendulum.
        begins: of such a process, value and standard deviation of each state at the start, by name.
    """

    kind: str
    what: str
    motion: GripperPath | None = None
    noise: Mapping[str, float] = field(default_factory=dict)
    changed: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    measured: Mapping[str, float] = field(default_factory=dict)
    sign_reversed: tuple[str, ...] = ()
    released: float | None = None
    rate: float = 100.0
    elapsed: float = 0.0
    recording: Run | None = None
    begins: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    def along_motion(self, motion: GripperPath) -> "PlannedExperiment":
        """This experiment with another motion of the gripper."""
        return replace(self, motion=motion.begun_at(self.elapsed) if self.elapsed else motion)

    @cached_property
    def run(self) -> Run | None:
        """A recording with the motion of the experiment and with zeros as measured values."""
        if self.motion is None:
            return self.recording
        time = self.motion.time
        rows = [
            *zip(
                ("gripper_x", "gripper_v", "gripper_a"),
                self.motion.motion_along_line,
                ("m", "m/s", "m/s^2"),
                strict=True,
            ),
            *((name, np.zeros(len(time)), unit) for name, unit in zip(EXPERIMENT_CHANNELS, ("N", "rad"), strict=True)),
        ]
        return Run("experiment", {name: Channel(time, row, unit) for name, row, unit in rows})

    def start_state(self, hypothesis: Hypothesis) -> Mapping[str, tuple[float, float]]:
        """Value and standard deviation of each state at the start, by name, if the hypothesis is true."""
        if self.motion is None:
            return self.begins
        angle, std = hypothesis.rest_angle, START_STD
        if self.released is not None:
            angle, std = self.released, RELEASE_STD
        return {"initial_angle": (angle, std["initial_angle"]), "initial_rate": (0.0, std["initial_rate"])}


class PredictedExperiment:
    """Prediction of a hypothesis for an experiment, divided by the noise, with priors on its unknowns.

    Attributes:
        names: names of the unknowns: those that all runs share, then those of this experiment.
        prior: (m, m) information on the unknowns before the experiment.
        covariance_root: (m, m) square root of the unknowns' covariance, if the hypothesis is true.
        start: (m,) values of the unknowns before the experiment.
        lower: (m,) smallest values of the unknowns.
        upper: (m,) largest values of the unknowns.
        typical: (m,) typical sizes of the unknowns.
    """

    def __init__(self, hypothesis: Hypothesis, experiment: PlannedExperiment) -> None:
        self.hypothesis, self.experiment = hypothesis, experiment
        model, free, changed = hypothesis.model, hypothesis.free, experiment.changed
        begin = {**experiment.start_state(hypothesis), **changed}
        own = (*model.start_names, *changed) if experiment.run is not None else ()
        self.names = (*free, *own)
        self.start = np.array([*(model.value(name) for name in free), *(begin[name][0] for name in own)])
        stds = [begin[name][1] for name in own]
        known = [stds[i] ** -2.0 if name in changed else 0.0 for i, name in enumerate(own)]
        self.prior = block_diag(hypothesis.information, np.diag(known))
        self.covariance_root = block_diag(covariance_root(hypothesis.information), np.diag(stds))
        bounded = [model.parameters[name] for name in self.names]
        self.lower, self.upper, self.typical = np.array([(p.lower, p.upper, p.typical) for p in bounded]).T
        self._sign = np.array([-1.0 if name in experiment.sign_reversed else 1.0 for name in model.names])
        # Where a name occurs twice, the last one counts: the value in this run.
        self._place = {name: i for i, name in enumerate(self.names)}
        self._last: dict[str, tuple[bytes, Any]] = {}

    def along_motion(self, motion: GripperPath) -> "PredictedExperiment":
        """The prediction of the same hypothesis for another motion of the gripper."""
        other = copy(self)
        other.experiment, other._last = self.experiment.along_motion(motion), {}
        other.__dict__.pop("weights", None)
        return other

    def theta(self, values: np.ndarray) -> np.ndarray:
        """(p,) parameter vector of the model in this experiment, at (m,) values of the unknowns."""
        model = self.hypothesis.model
        given = [values[self._place[name]] if name in self._place else model.value(name) for name in model.names]
        return np.array(given) * self._sign

    def _at(self, values: np.ndarray, what: str, compute: Callable[[np.ndarray], T]) -> T:
        """A result at (m,) values of the unknowns; the last one is cached."""
        key = values.tobytes()
        if what not in self._last or self._last[what][0] != key:
            self._last[what] = key, compute(values)
        return cast(T, self._last[what][1])

    def predict(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(n,) readings over their noise at (m,) unknowns, and (n, m) derivatives; hand-measured values come last."""
        return self._at(values, "prediction", self._predicted)

    def _predicted(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        e, model = self.experiment, self.hypothesis.model
        readings, slopes = [np.zeros(0)], [np.zeros((0, len(self.names)))]
        if e.run is not None:
            found = self._readings(e.run, values)
            columns = [model.names.index(name) for name in self.names]
            # The value of the other runs does not act in this one.
            acts = np.array([name not in e.changed or i == self._place[name] for i, name in enumerate(self.names)])
            for channel, weight in self.weights.items():
                here = found.slices[channel]
                readings.append(found.values[here] * weight)
                slopes.append(found.sensitivities[here][:, columns] * (self._sign[columns] * weight * acts))
        for name, std in e.measured.items():
            place = self._place.get(name)
            readings.append(np.array([(model.value(name) if place is None else values[place]) / std]))
            slopes.append((np.arange(len(self.names)) == place)[None] / std)
        return np.concatenate(readings), np.vstack(slopes)

    def curves(self) -> list[Curve]:
        """Expected readings over time of every channel that the experiment measures, at the values before it."""
        run = self.experiment.run
        if run is None:
            return []
        found, name = self._readings(run, self.start), self.hypothesis.name
        panels = {channel: f"{channel} [{run.channels[channel].unit}]" for channel in self.weights}
        return [
            Curve(panel, name, found.time[rows], found.values[rows])
            for panel, rows in ((panel, found.slices[channel]) for channel, panel in panels.items())
        ]

    def _readings(self, run: Run, values: np.ndarray) -> Prediction:
        """Readings of the experiment's sensors at (m,) values of the unknowns."""
        model, motion = self.hypothesis.model, self.experiment.motion
        if motion is None:
            return model.predict(run, self.theta(values))
        measured, whole = tuple(self.weights), self.rollout(values)
        rows = [EXPERIMENT_CHANNELS.index(channel) for channel in measured]
        rolled = whole._replace(outputs=whole.outputs[:, rows], sensitivities=whole.sensitivities[:, rows])
        return model.sensor_readings(run, motion, rolled, self.theta(values), measured)

    @cached_property
    def weights(self) -> dict[str, float]:
        """Inverse of the noise of every channel that the experiment measures, by name."""
        e = self.experiment
        per_node = np.sqrt(e.motion.dt * e.rate) if e.motion is not None else 1.0
        measured = e.noise if e.recording is not None else EXPERIMENT_CHANNELS
        return {channel: per_node / e.noise[channel] for channel in measured if channel in e.noise}

    @property
    def motion(self) -> GripperPath:
        """The gripper's motion in the experiment, which must have one."""
        assert self.experiment.motion is not None, "an experiment without a motion moves nothing"
        return self.experiment.motion

    def rollout(self, values: np.ndarray) -> Rollout:
        """Simulated channels along the motion, at (m,) values of the unknowns."""
        return self._at(
            values,
            "rollout",
            lambda at: self.hypothesis.model.rollout(self.motion, self.theta(at), EXPERIMENT_CHANNELS),
        )

    def swing(self, values: np.ndarray) -> np.ndarray:
        """(K,) swing angle along the motion, rad, at (m,) values of the unknowns."""
        return np.asarray(self.rollout(values).outputs[:, EXPERIMENT_CHANNELS.index("swing_angle")])

    def tension(self, values: np.ndarray) -> np.ndarray:
        """(K,) tension of the string along the motion, N, at (m,) values of the unknowns."""
        return np.asarray(self.rollout(values).outputs[:, EXPERIMENT_CHANNELS.index("load_force")])

    def coefficient_gradient(
        self, values: np.ndarray, basis: SeriesBasis, readings: np.ndarray, swing: np.ndarray | None = None
    ) -> np.ndarray:
        """(size,) derivative of a weighted sum of readings with respect to the Fourier coefficients of the motion.

        Args:
            values: (m,) values of the unknowns.
            basis: functions of which the motion consists, at its nodes.
            readings: (n,) weights of the readings, which are divided by their noise.
            swing: (K,) weights of the swing angle, in addition to the readings.
        """
        model, motion = self.hypothesis.pendulum, self.motion
        physics = np.array([self.theta(values)[model.names.index(name)] for name in model.physics_names])
        sampler, count = InterpolatingSampler(motion.time, motion.time), len(motion.time)
        outputs = np.zeros((count, len(EXPERIMENT_CHANNELS)))
        for i, (channel, weight) in enumerate(self.weights.items()):
            part = readings[i * count : (i + 1) * count] * weight
            sensor = model.system.sensors[channel]
            outputs[:, EXPERIMENT_CHANNELS.index(channel)] += sensor.adjoint(part, sampler, physics)
        if swing is not None:
            outputs[:, EXPERIMENT_CHANNELS.index("swing_angle")] += swing
        path, adjoint = model.simulation_inputs(motion, physics), _adjoint(model.system, model.formulation)
        by_input = adjoint.gradient(path, physics, self.rollout(values).states, outputs)
        driving = _driving(basis, model.gripper_lag(physics))
        total = np.zeros(basis.functions.shape[2])
        for rows, functions in zip(by_input, driving, strict=True):
            inputs = rows[
                list(GRIPPER_MOTION_ROWS if len(rows) > GRIPPER_MOTION_ROWS[-1] else GRIPPER_MOTION_ROWS[:-1])
            ].ravel()
            total += inputs @ functions[: len(inputs)]
        return total


GRIPPER_MOTION_ROWS = (1, 2, 3, 7)
"""Rows of a path's inputs with position, velocity, acceleration and jerk of the gripper; not all models have a jerk."""


@lru_cache(maxsize=32)
def _adjoint(system: System, name: str) -> Adjoint:
    return Adjoint(system, name, EXPERIMENT_CHANNELS)


@lru_cache(maxsize=8)
def _driving(basis: SeriesBasis, lag: float) -> tuple[np.ndarray, np.ndarray]:
    """Position, velocity, acceleration and jerk of the string's upper end for each coefficient, stacked.

    The shapes are (4 K, size) at the nodes and (4 (K - 1), size) halfway between.
    """
    _, count, size = basis.functions.shape
    rows, step = basis.functions, float(basis.time[1] - basis.time[0])
    if lag > 0.0:
        rows = np.stack([first_order_lag(part, lag, step)[0] for part in rows])
    between = np.asarray(motion_at_midpoints(rows, step)).reshape(3, count - 1, size)
    jerk = first_derivative(rows[2], step)
    return np.concatenate([*rows, jerk]), np.concatenate([*between, (jerk[1:] + jerk[:-1]) / 2])
