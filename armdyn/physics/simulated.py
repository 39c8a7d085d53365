"""Common part of models that simulate a motion in time and read it with sensors."""

from abc import abstractmethod
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Self

import numpy as np

from armdyn.errors import InputError
from armdyn.model import Model, Prediction, join_channels
from armdyn.physics.recorded import InputPath
from armdyn.physics.simulate import Rollout, Simulator, System
from armdyn.readout import InterpolatingSampler
from armdyn.recording.channels import Channel
from armdyn.recording.noise import NORMAL_MEDIAN, quiet_std
from armdyn.recording.spikes import clean
from armdyn.run import Run

MIN_SAVED_STEPS = 70_000
"""Saving of a smaller model, in steps times derivatives of a prediction (6 ms), from which on its compilation of 0.2 s
pays off in the thirty predictions of a fit."""
START_FIT_SECONDS, MIN_START_SAMPLES = 0.1, 5
"""First part of a run, s, and its least number of samples, to which a parabola is fitted for the start value and
rate."""
LOCAL_FIT_PERIODS = 0.125
"""Half the time over which a parabola is fitted to a channel for its value and rate, in periods of the swing."""
REST_AMPLITUDE_SHARE = 0.04
"""Amplitude that counts as rest, as a share of the largest one."""
MIN_AMPLITUDE_DEVIATES = 4.0
"""Standard deviations by which the median of n squares must exceed that of noise alone; its standard deviation is
nearly the noise's variance over the root of n."""
ZERO_PADDING_FACTOR = 8
"""Factor by which a signal is extended with zeros, which refines its spectrum by as much."""


@dataclass(frozen=True, repr=False)
class SimulatedModel(Model):
    """A model that simulates a motion along recorded inputs and reads it with sensors (lag, delay, sampling)."""

    @property
    @abstractmethod
    def inputs(self) -> tuple[str, ...]:
        """Channels that drive the motion, as far as a run has them."""

    @property
    @abstractmethod
    def start_names(self) -> tuple[str, ...]:
        """Parameters of the start of the motion, in the order of the simulator."""

    @property
    @abstractmethod
    def forced(self) -> Mapping[int, str | None]:
        """Indices of the `start_names` that a force changes, the speeds, each with its state; None for the only one."""

    @property
    @abstractmethod
    def remembering(self) -> frozenset[str]:
        """Names of the effects that add states."""

    @property
    def slow(self) -> frozenset[str]:
        """Names of the effects with which a simulation takes at least twice as long."""
        return self.remembering

    def reduced_model(self, needed: Collection[str], runs: Sequence[Run]) -> Self:
        """A model with at least the `needed` effects, if its compilation pays off; see `Model.reduced_model`."""
        lean, steps = self.with_only_effects(needed), sum(self.path(run).nodes.shape[1] for run in runs)
        if steps * (len(self.names) - len(lean.names)) > MIN_SAVED_STEPS:
            return lean
        return self.with_only_effects({effect.name for effect in self.effects}.difference(self.slow).union(needed))

    @abstractmethod
    def measured_motion(self, run: Run, times: np.ndarray, theta: np.ndarray, swing: float) -> np.ndarray | None:
        """(J, starts) start values of the motion at (J,) times, s, from measured channels; None without such channels.

        `theta` are (p,) parameters in the order of `names`, and `swing` is the period of the swing, s.
        """

    @abstractmethod
    def force_covariates(
        self, run: Run, time: np.ndarray, motion: np.ndarray, speed: int, theta: np.ndarray
    ) -> dict[str, tuple[np.ndarray, str]]:
        """(J,) values and unit of each quantity on which the missing rate of the start value `speed` may depend.

        `motion` are (J, starts) start values at (J,) times, s, and `theta` (p,) parameters in the order of `names`.
        """

    def comes_to_rest(self, run: Run, swing: float) -> float:
        """Time, s, at which an undriven motion with a period of `swing` s rests; then friction hides all forces."""
        del run, swing
        return np.inf

    def states_moved(self, run: Run, theta: np.ndarray, direction: np.ndarray) -> tuple[str, ...]:
        """Unmeasured states, with their units, that change with the parameters (p,) `theta` along (p,) `direction`."""
        del run, theta, direction
        return ()

    def direct_estimates(self, run: Run, theta: np.ndarray) -> dict[str, float]:
        """Values of parameters that a run gives without a fit, as the period of a swing gives a length."""
        del run, theta
        return {}

    @abstractmethod
    def swing(self, run: Run, theta: np.ndarray) -> float:
        """Period of the motion in a run, s; `theta` is (p,) in the order of `names`."""

    @property
    @abstractmethod
    def system(self) -> System:
        """The equations with their effects."""

    @property
    @abstractmethod
    def formulation(self) -> str:
        """Identifier of the equations; models that share it differ only in numbers."""

    @abstractmethod
    def path(self, run: Run) -> InputPath:
        """The recorded inputs of a run on an even grid."""

    def driven_by(self, path: InputPath, physics: np.ndarray) -> InputPath:
        """The inputs that drive the motion when `path` was recorded; `physics` is (p,) as `physics_theta`."""
        del physics
        return path.with_columns(self.system.columns)

    @property
    def physics_names(self) -> tuple[str, ...]:
        """Parameters of the equations and sensors, in the order of theta there: all but those of the start."""
        return self.system.names

    def rollout(self, path: InputPath, theta: np.ndarray, channels: tuple[str, ...] | None = None) -> Rollout:
        """Simulate `channels` (None means all) along recorded inputs; `theta` is (p,) in the order of `names`."""
        system, physics = self.system, theta[self.places[1]]
        channels = system.outputs if channels is None else channels
        start = (float(theta[self.names.index(name)]) for name in self.start_names)
        return _simulator(system, self.formulation, channels).rollout(self.driven_by(path, physics), physics, *start)

    def physics_theta(self) -> np.ndarray:
        """(p,) present values in the order of `physics_names`."""
        return np.array([self.parameters[name].value for name in self.physics_names])

    def predicted_channels(self, run: Run) -> tuple[str, ...]:
        """Channels of a run that the model predicts; see `Model.predicted_channels`."""
        outputs = self.system.outputs
        channels = tuple(name for name in outputs if name in run.channels)
        if not channels:
            raise InputError(f"{run.name}: holds none of {', '.join(outputs)}, so there is nothing to compare")
        return channels

    def prepare_run(self, run: Run, beside: Sequence[Run] = ()) -> Run:
        """The run without faulty samples, at a reduced rate; see `Model.prepare_run`."""
        del beside
        return clean(run, self.predicted_channels(run), self.inputs)

    def predict(self, run: Run, theta: np.ndarray) -> Prediction:
        """Predict the channels of a run; see `Model.predict`."""
        channels, path = self.predicted_channels(run), self.path(run)
        return self.readings(run, path, self.rollout(path, theta, channels), theta, channels)

    def readings(
        self, run: Run, path: InputPath, rollout: Rollout, theta: np.ndarray, channels: tuple[str, ...]
    ) -> Prediction:
        """Sensor readings of a rollout of `channels` along a path, at the stamps of a run."""
        columns, places = self.places
        given = path.start, path.dt, len(rollout.outputs)
        physics, parts = theta[places], []
        for row, name in enumerate(channels):
            time = run.channels[name].time
            signal = np.column_stack([rollout.outputs[:, row], rollout.sensitivities[:, row]])
            sampler = _interpolated(*given, run.channels[name], run.spread.get(name, 0.0))
            read = self.system.sensors[name].read(signal, sampler, physics)
            parts.append((name, time, read[:, 0], read[:, 1:][:, columns]))
        return join_channels(parts)

    @cached_property
    def places(self) -> tuple[list[int], list[int]]:
        """Positions of a rollout's columns, and of the physics' parameters, among `names`."""
        place = {name: i for i, name in enumerate((*self.physics_names, *self.start_names))}
        return [place[name] for name in self.names], [self.names.index(name) for name in self.physics_names]


def with_motion(model: Model) -> SimulatedModel | None:
    """The model, where it has a motion with states that begins somewhere; else None."""
    return model if isinstance(model, SimulatedModel) and model.start_names else None


def simulated(model: Model) -> SimulatedModel:
    """The model as one that simulates; for code that is never called with another model."""
    assert isinstance(model, SimulatedModel), f"a model of base '{model.base}' does not simulate"
    return model


@lru_cache(maxsize=128)
def _simulator(system: System, name: str, channels: tuple[str, ...]) -> Simulator:
    return Simulator(system, name, channels)


@lru_cache(maxsize=16)
def _interpolated(start: float, dt: float, size: int, channel: Channel, spread: float) -> InterpolatingSampler:
    """Interpolation from an even grid to the stamps of a channel; cached, because all steps of a fit share it."""
    return InterpolatingSampler(start + dt * np.arange(size), channel.time, spread)


def local_motion(channel: Channel, times: np.ndarray, reach: float) -> np.ndarray:
    """(J, 2) value and rate of a channel at (J,) times, s, from local cubic polynomials.

    A local fit has twice the length `reach`, s, and at least eight samples.
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


def main_period(channel: Channel) -> float:
    """Period of the strongest oscillation of a channel about its mean, s."""
    time = np.linspace(channel.time[0], channel.time[-1], max(len(channel), 16))
    value = np.interp(time, channel.time, channel.value)
    value = (value - value.mean()) * np.hanning(len(value))
    power = np.abs(np.fft.rfft(value, ZERO_PADDING_FACTOR * len(value))) ** 2
    lowest = ZERO_PADDING_FACTOR  # one period in the whole recording
    best = lowest + int(np.argmax(power[lowest:]))
    return float(ZERO_PADDING_FACTOR * len(value) * (time[1] - time[0]) / best)


def end_of_motion(channel: Channel, swing: float) -> float:
    """Time at which an oscillation has come to rest, s: its amplitude stays below a share of the largest one.

    The amplitude is estimated from the median of the squares in every half period, which glitches do not change, less
    the noise: single samples of a noisy sensor remain large for ever. `swing` is the period, s.
    """
    left = channel.time[-1] - channel.time
    rest = np.median(channel.value[-max(8, len(channel) // 20) :])
    part = (left // (0.5 * swing)).astype(int)  # the last part is whole: near a turning point it seems at rest
    begins = np.flatnonzero(np.diff(part, prepend=-1))
    squares = np.array([np.median(one) for one in np.split((channel.value - rest) ** 2, begins[1:])])
    count = np.diff(begins, append=len(left))
    noise = quiet_std(channel.time, channel.value) ** 2 * (NORMAL_MEDIAN**2 + MIN_AMPLITUDE_DEVIATES / np.sqrt(count))
    moving = np.flatnonzero(squares > noise + REST_AMPLITUDE_SHARE**2 * squares.max())
    last = begins[moving[-1] + 1] if len(moving) and moving[-1] + 1 < len(begins) else -1
    return float(channel.time[last])


def measured_start(channel: Channel, stretch: float = START_FIT_SECONDS) -> tuple[float, float]:
    """Value and rate of a channel at its first sample, from a parabola through the first `stretch` s."""
    since = channel.time - channel.time[0]
    near = max(MIN_START_SAMPLES, int(np.searchsorted(since, stretch)))
    curve = np.polyfit(since[:near], channel.value[:near], 2)
    return float(curve[2]), float(curve[1])
