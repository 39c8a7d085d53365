"""Common part of models that simulate a motion in time and read it with sensors."""

from abc import abstractmethod
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from typing import Self

import numpy as np

from armdyn.errors import InputError
from armdyn.model import Model, Prediction, prediction_from_channels
from armdyn.physics.following import Following
from armdyn.physics.recorded import InputPath
from armdyn.physics.simulate import Rollout, Simulator, System
from armdyn.readout import InterpolatingSampler
from armdyn.recording.channels import Channel
from armdyn.recording.noise import ABS_NORMAL_MEDIAN_OVER_STD, NoiseByChannel, noise_std_from_differences
from armdyn.recording.spikes import without_faulty_samples
from armdyn.run import Run

MIN_SAVED_STEPS_TIMES_DERIVATIVES = 70_000
"""Least saving by a smaller model, in simulation steps times derivatives, for which its compilation of 0.2 s pays off
in the thirty predictions of a fit."""
START_PARABOLA_SECONDS, MIN_START_PARABOLA_SAMPLES = 0.1, 5
"""Length of the first part of a run, s, and its least number of samples, to which a parabola is fitted for the value
and rate of a channel at the start."""
LOCAL_FIT_HALF_WIDTH_PERIODS = 0.125
"""Half the time over which a polynomial is fitted to a channel for its value and rate, in periods of the
oscillation."""
REST_AMPLITUDE_SHARE = 0.04
"""Amplitude of an oscillation that counts as rest, as a share of its largest amplitude."""
MIN_MEDIAN_SQUARE_EXCESS_STDS = 4.0
"""Standard deviations by which the median of n squares must exceed that of noise alone; its standard deviation is
nearly the noise's variance over the root of n."""
ZERO_PADDING_FACTOR = 8
"""Factor by which zeros lengthen a signal before its Fourier transform, which makes the spectrum finer."""


@dataclass(frozen=True, repr=False)
class SimulatedModel(Model):
    """Model that simulates a motion along recorded inputs, and sensors that read it with lag, delay and sampling.

    Attributes:
        following: how it follows a recorded motion.
    """

    following: Following = field(default=Following(), kw_only=True)

    @property
    @abstractmethod
    def inputs(self) -> tuple[str, ...]:
        """Names of the channels that drive the motion, if a run has them."""

    @property
    @abstractmethod
    def start_names(self) -> tuple[str, ...]:
        """Names of the parameters that are the state at the start of a motion, in the simulator's order."""

    @property
    @abstractmethod
    def speed_states(self) -> Mapping[int, str | None]:
        """States that are speeds: index in `start_names`, and name, None if the model has a single speed."""

    @property
    @abstractmethod
    def effects_with_states(self) -> frozenset[str]:
        """Names of the effects that add states."""

    @property
    def slow_effects(self) -> frozenset[str]:
        """Names of the effects that make a simulation at least twice as slow."""
        return self.effects_with_states

    def reduced_model(self, needed: Collection[str], runs: Sequence[Run]) -> Self:
        """A smaller model with at least the `needed` effects, if it saves more time than its compilation takes."""
        lean, steps = self.with_only_effects(needed), sum(self.input_path(run).nodes.shape[1] for run in runs)
        if steps * (len(self.names) - len(lean.names)) > MIN_SAVED_STEPS_TIMES_DERIVATIVES:
            return lean
        return self.with_only_effects(
            {effect.name for effect in self.effects}.difference(self.slow_effects).union(needed)
        )

    @abstractmethod
    def measured_motion(self, run: Run, times: np.ndarray, theta: np.ndarray, swing: float) -> np.ndarray | None:
        """(J, starts) measured states, as start values of a motion from each of (J,) times, s; None if not measured.

        `theta` are (p,) parameters in the order of `names`, and `swing` is the period of the motion, s.
        """

    @abstractmethod
    def force_covariates(
        self, run: Run, time: np.ndarray, motion: np.ndarray, speed: int, theta: np.ndarray
    ) -> dict[str, tuple[np.ndarray, str]]:
        """(J,) values and unit of each quantity on which a missing acceleration may depend, by name.

        `motion` are (J, starts) measured states at (J,) times, s, `speed` is the index of the speed that the missing
        acceleration changes, and `theta` are (p,) parameters in the order of `names`.
        """

    def time_of_rest(self, run: Run, swing: float) -> float:
        """Time, s, at which a motion without drive comes to rest, after which friction hides all forces.

        `swing` is the period of the motion, s; the result is infinite for a motion that does not come to rest.
        """
        del run, swing
        return np.inf

    def states_sensitive_to(self, run: Run, theta: np.ndarray, direction: np.ndarray) -> tuple[str, ...]:
        """Unmeasured states, with units, that change if the parameters (p,) `theta` change along (p,) `direction`."""
        del run, theta, direction
        return ()

    def direct_estimates(self, run: Run, theta: np.ndarray) -> dict[str, float]:
        """Parameters that a run determines without a fit, by name: the period of a swing determines a length."""
        del run, theta
        return {}

    @abstractmethod
    def oscillation_period(self, run: Run, theta: np.ndarray) -> float:
        """Period of the motion in a run, s; `theta` are (p,) parameters in the order of `names`."""

    @property
    @abstractmethod
    def system(self) -> System:
        """The equations of the model with its effects."""

    @property
    @abstractmethod
    def formulation(self) -> str:
        """Identifier of the equations; models with the same identifier differ only in parameter values."""

    @abstractmethod
    def input_path(self, run: Run) -> InputPath:
        """The recorded inputs of a run on an even grid."""

    def simulation_inputs(self, path: InputPath, physics: np.ndarray) -> InputPath:
        """Inputs of the simulation for the recorded inputs `path`, at (p,) parameters as in `physics_names`."""
        del physics
        return path.with_columns(self.system.recorded_columns)

    @property
    def physics_names(self) -> tuple[str, ...]:
        """Names of all parameters except the start values, in the order of the parameter vector of the equations."""
        return self.system.names

    def rollout(self, path: InputPath, theta: np.ndarray, channels: tuple[str, ...] | None = None) -> Rollout:
        """Simulate `channels` (None means all) along recorded inputs; `theta` are (p,) parameters as in `names`."""
        system, physics = self.system, theta[self.parameter_positions[1]]
        channels = system.outputs if channels is None else channels
        start = (float(theta[self.names.index(name)]) for name in self.start_names)
        return _simulator(system, self.formulation, channels).rollout(
            self.simulation_inputs(path, physics), physics, *start
        )

    def physics_theta(self) -> np.ndarray:
        """(p,) values of the parameters in the order of `physics_names`."""
        return np.array([self.parameters[name].value for name in self.physics_names])

    def predicted_channels(self, run: Run) -> tuple[str, ...]:
        """Channels of a run that the model predicts, in the order of the prediction."""
        outputs = self.system.outputs
        channels = tuple(name for name in outputs if name in run.channels)
        if not channels:
            raise InputError(
                f"{run.name}: holds none of {', '.join(outputs)}, so there is nothing to compare: it has {run.summary}"
            )
        return channels

    def prepare_run(self, run: Run, beside: Sequence[Run] = ()) -> Run:
        """The run without faulty samples, averaged to a lower rate if it was sampled fast."""
        del beside
        return without_faulty_samples(run, self.predicted_channels(run), self.inputs)

    def suited_to(self, runs: Sequence[Run], noise: NoiseByChannel) -> Self:
        """The model, which follows these runs as its equations need; by default itself.

        Args:
            runs: the runs.
            noise: standard deviation of a sample by run and channel, in the channel's unit.
        """
        del runs, noise
        return self

    def refined_for(self, runs: Sequence[Run], noise: NoiseByChannel, thetas: Sequence[np.ndarray]) -> Self:
        """The model with steps that are short enough for these runs at (p,) parameters each; by default itself."""
        del runs, noise, thetas
        return self

    def predict(self, run: Run, theta: np.ndarray) -> Prediction:
        """Predict the channels of a run at (p,) parameters in the order of `names`."""
        channels, path = self.predicted_channels(run), self.input_path(run)
        return self.sensor_readings(run, path, self.rollout(path, theta, channels), theta, channels)

    def sensor_readings(
        self, run: Run, path: InputPath, rollout: Rollout, theta: np.ndarray, channels: tuple[str, ...]
    ) -> Prediction:
        """Sensor readings of a simulation at the time stamps of a run, with their derivatives by the parameters."""
        columns, places = self.parameter_positions
        given = path.start, path.dt, len(rollout.outputs)
        physics, parts = theta[places], []
        for row, name in enumerate(channels):
            time = run.channels[name].time
            signal = np.column_stack([rollout.outputs[:, row], rollout.sensitivities[:, row]])
            sampler = _interpolated(*given, run.channels[name], run.spread.get(name, 0.0))
            read = self.system.sensors[name].read(signal, sampler, physics)
            parts.append((name, time, read[:, 0], read[:, 1:][:, columns]))
        return prediction_from_channels(parts)

    @cached_property
    def parameter_positions(self) -> tuple[list[int], list[int]]:
        """Indices of `names` among a rollout's derivative columns, and of `physics_names` among `names`."""
        place = {name: i for i, name in enumerate((*self.physics_names, *self.start_names))}
        return [place[name] for name in self.names], [self.names.index(name) for name in self.physics_names]


def as_model_with_motion(model: Model) -> SimulatedModel | None:
    """The model if it simulates a motion that begins at a state; else None."""
    return model if isinstance(model, SimulatedModel) and model.start_names else None


def as_simulated_model(model: Model) -> SimulatedModel:
    """The model, whose class must be `SimulatedModel`: a cast that checks the class."""
    assert isinstance(model, SimulatedModel), f"a model of base '{model.base}' does not simulate"
    return model


@lru_cache(maxsize=128)
def _simulator(system: System, name: str, channels: tuple[str, ...]) -> Simulator:
    return Simulator(system, name, channels)


@lru_cache(maxsize=16)
def _interpolated(start: float, dt: float, size: int, channel: Channel, spread: float) -> InterpolatingSampler:
    """Interpolation from an even grid to the stamps of a channel; cached, because all steps of a fit share it."""
    return InterpolatingSampler(start + dt * np.arange(size), channel.time, spread)


def local_values_and_rates(channel: Channel, times: np.ndarray, reach: float) -> np.ndarray:
    """(J, 2) value and rate of a channel at (J,) times, s, by fits of cubic polynomials.

    Each fit uses the samples up to `reach` s before and after its time, and at least eight samples.
    """
    found = np.empty((len(times), 2))
    for j, at in enumerate(times):
        middle = int(np.searchsorted(channel.time, at))
        first, last = (int(np.searchsorted(channel.time, at + side * reach)) for side in (-1.0, 1.0))
        first, last = max(0, min(first, middle - 4)), min(len(channel.time), max(last, middle + 4))
        since = channel.time[first:last] - at
        curve = np.polyfit(since, channel.value[first:last], min(3, last - first - 2))
        found[j] = curve[-1], curve[-2]
    return found


def dominant_period(channel: Channel) -> float:
    """Period of the strongest oscillation of a channel about its mean, s."""
    time = np.linspace(channel.time[0], channel.time[-1], max(len(channel), 16))
    value = np.interp(time, channel.time, channel.value)
    value = (value - value.mean()) * np.hanning(len(value))
    power = np.abs(np.fft.rfft(value, ZERO_PADDING_FACTOR * len(value))) ** 2
    lowest = ZERO_PADDING_FACTOR  # one period in the whole recording
    best = lowest + int(np.argmax(power[lowest:]))
    return float(ZERO_PADDING_FACTOR * len(value) * (time[1] - time[0]) / best)


def rest_time(channel: Channel, swing: float) -> float:
    """Time at which an oscillation has come to rest, s: after it the amplitude is below a share of the largest one.

    The amplitude is estimated from the median of the squares in every half period, which glitches do not change, less
    the noise: single samples of a noisy sensor remain large for ever. `swing` is the period, s.
    """
    left = channel.time[-1] - channel.time
    rest = np.median(channel.value[-max(8, len(channel) // 20) :])
    part = (left // (0.5 * swing)).astype(int)  # the last part is whole: near a turning point it seems at rest
    begins = np.flatnonzero(np.diff(part, prepend=-1))
    squares = np.array([np.median(one) for one in np.split((channel.value - rest) ** 2, begins[1:])])
    count = np.diff(begins, append=len(left))
    noise = noise_std_from_differences(channel.time, channel.value) ** 2 * (
        ABS_NORMAL_MEDIAN_OVER_STD**2 + MIN_MEDIAN_SQUARE_EXCESS_STDS / np.sqrt(count)
    )
    moving = np.flatnonzero(squares > noise + REST_AMPLITUDE_SHARE**2 * squares.max())
    last = begins[moving[-1] + 1] if len(moving) and moving[-1] + 1 < len(begins) else -1
    return float(channel.time[last])


def first_value_and_rate(channel: Channel, stretch: float = START_PARABOLA_SECONDS) -> tuple[float, float]:
    """Value and rate of a channel at its first sample, from a parabola through the first `stretch` s."""
    since = channel.time - channel.time[0]
    near = max(MIN_START_PARABOLA_SAMPLES, int(np.searchsorted(since, stretch)))
    curve = np.polyfit(since[:near], channel.value[:near], 2)
    return float(curve[2]), float(curve[1])
