"""What models have in common that simulate a motion in time and read it with sensors."""

from abc import abstractmethod
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Self

import numpy as np

from armdyn.errors import InputError
from armdyn.model import Model, Prediction, join_channels
from armdyn.physics.recorded import Path
from armdyn.physics.simulate import Rollout, Simulator, System, evaluated
from armdyn.readout import Interpolated
from armdyn.recording.channels import Channel
from armdyn.recording.differences import NORMAL_MEDIAN, quiet_std
from armdyn.recording.spikes import clean
from armdyn.run import Run

REPAID = 70_000
"""Steps times derivatives that a smaller model saves in a prediction, 6 ms, from which on it repays the 0.2 s of its
compilation in the thirty predictions of a fit."""
FIRST_STRETCH, FIRST_SAMPLES = 0.1, 5
"""s, and at least as many samples, through which a parabola gives a value and its rate at the start."""

REACH = 0.125
"""Of a swing, to either side, through which a parabola shows what was measured and its rate."""
RESTING = 0.04
"""Of the largest amplitude, what counts as rest."""
SURELY = 4.0
"""Standard deviations by which the median of n squares must exceed that of noise alone, where it varies by nearly the
noise's variance over the root of n."""
PADDED = 8
"""Times its length that a signal is continued by zeros: its spectrum is looked at so much more finely."""


@dataclass(frozen=True, repr=False)
class SimulatedModel(Model):
    """A motion simulated along recorded inputs, its outputs read by sensors with lag, delay and sampling."""

    @property
    @abstractmethod
    def inputs(self) -> tuple[str, ...]:
        """Channels that drive the motion, as far as a run has them."""

    @property
    @abstractmethod
    def start_names(self) -> tuple[str, ...]:
        """Parameters that say how the motion begins, in the order of the simulator."""

    @property
    def kicked(self) -> list[int]:
        """Those of `start_names` that a force changes: the speeds."""
        return list(range(len(self.start_names)))

    @property
    @abstractmethod
    def remembering(self) -> frozenset[str]:
        """Effects that bring states of their own."""

    @property
    def slow(self) -> frozenset[str]:
        """Effects with which a simulation takes twice as long, or longer."""
        return self.remembering

    def holding(self, needed: Collection[str], runs: Sequence[Run]) -> Self:
        """See `Model.holding`: every set of effects is compiled, which short runs do not repay."""
        lean, steps = self.with_only(needed), sum(self.path(run).nodes.shape[1] for run in runs)
        if steps * (len(self.names) - len(lean.names)) > REPAID:
            return lean
        return self.with_only({effect.name for effect in self.effects}.difference(self.slow).union(needed))

    @property
    def guessed(self) -> tuple[str, ...]:
        """Parameters whose values are no more than guesses, so that a fit begins from other ones as well."""
        return ()

    def measured_motion(self, run: Run, times: np.ndarray, theta: np.ndarray, swing: float) -> np.ndarray | None:
        """(J, starts) values that would begin the motion at (J,) times, from what was measured; None where it was not.

        Args:
            run: prepared.
            times: (J,) s.
            theta: (p,) in the order of `names`.
            swing: period, s.
        """
        del run, theta, swing
        return None if self.start_names else np.zeros((len(times), 0))

    def shown_against(
        self, run: Run, time: np.ndarray, motion: np.ndarray, speed: int, theta: np.ndarray
    ) -> dict[str, tuple[np.ndarray, str]]:
        """What a missing acceleration may depend on, (J,) with a unit each.

        Args:
            run: prepared.
            time: (J,) s.
            motion: (J, starts) values that would begin the motion then.
            speed: which of them is the one whose rate of change is missing.
            theta: (p,) in the order of `names`.
        """
        del run, time, motion, speed, theta
        return {}

    def comes_to_rest(self, run: Run, swing: float) -> float:
        """When what nothing drives, with a period of `swing` s, rests, s: there friction holds it, no force shows."""
        del run, swing
        return np.inf

    def states_moved(self, run: Run, theta: np.ndarray, direction: np.ndarray) -> tuple[str, ...]:
        """States, with their units, that no channel of a run measures and that move with the parameters.

        Args:
            run: prepared.
            theta: (p,) in the order of `names`.
            direction: (p,) in which they move.
        """
        del run, theta, direction
        return ()

    def shown_by(self, run: Run, theta: np.ndarray) -> dict[str, float]:
        """Values of parameters that a run shows without a fit, as a swing's period shows a length."""
        del run, theta
        return {}

    @abstractmethod
    def swing(self, run: Run, theta: np.ndarray) -> float:
        """Period of what a run shows of the motion, s; `theta` (p,) in the order of `names`."""

    @property
    @abstractmethod
    def system(self) -> System:
        """The equations with their effects."""

    @property
    @abstractmethod
    def formulation(self) -> str:
        """Identifier of the equations: two models that share it differ in numbers only."""

    @abstractmethod
    def path(self, run: Run) -> Path:
        """The recorded inputs of a run on an even grid."""

    def driven_by(self, path: Path, physics: np.ndarray) -> Path:
        """What drives the motion where `path` was recorded; `physics` as `physics_theta`."""
        del physics
        return path.with_columns(self.system.columns)

    @property
    def physics_names(self) -> tuple[str, ...]:
        """Parameters of the equations and of the sensors, in the order of theta there: all but those of the start."""
        return self.system.names

    def rollout(self, path: Path, theta: np.ndarray, channels: tuple[str, ...] | None = None) -> Rollout:
        """Simulate `channels`, all when not given, along recorded inputs; `theta` (p,) in the order of `names`."""
        system, physics = self.system, theta[self.places[1]]
        channels = system.outputs if channels is None else channels
        if not system.states:
            return evaluated(system, self.driven_by(path, physics), physics, channels)
        start = (float(theta[self.names.index(name)]) for name in self.start_names)
        return _simulator(system, self.formulation, channels).rollout(self.driven_by(path, physics), physics, *start)

    def physics_theta(self) -> np.ndarray:
        """(p,) present values in the order of `physics_names`."""
        return np.array([self.parameters[name].value for name in self.physics_names])

    def predicted_channels(self, run: Run) -> tuple[str, ...]:
        """See `Model.predicted_channels`."""
        outputs = self.system.outputs
        channels = tuple(name for name in outputs if name in run.channels)
        if not channels:
            raise InputError(f"{run.name}: holds none of {', '.join(outputs)}, so there is nothing to compare")
        return channels

    def prepared(self, run: Run, beside: Sequence[Run] = ()) -> Run:
        """See `Model.prepared`: without faulty samples, thinned."""
        del beside
        return clean(run, self.predicted_channels(run), self.inputs)

    def predict(self, run: Run, theta: np.ndarray) -> Prediction:
        """See `Model.predict`."""
        channels, path = self.predicted_channels(run), self.path(run)
        return self.readings(run, path, self.rollout(path, theta, channels), theta, channels)

    def readings(
        self, run: Run, path: Path, rollout: Rollout, theta: np.ndarray, channels: tuple[str, ...]
    ) -> Prediction:
        """What the sensors make of a rollout of `channels` along a path, at the stamps of a run."""
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
        """Where the columns of a rollout are among `names`, and where the physics' parameters are."""
        place = {name: i for i, name in enumerate((*self.physics_names, *self.start_names))}
        return [place[name] for name in self.names], [self.names.index(name) for name in self.physics_names]


@lru_cache(maxsize=128)
def _simulator(system: System, name: str, channels: tuple[str, ...]) -> Simulator:
    return Simulator(system, name, channels)


@lru_cache(maxsize=16)
def _interpolated(start: float, dt: float, size: int, channel: Channel, spread: float) -> Interpolated:
    """From an even grid to the stamps of a channel: the same in every step of a fit."""
    return Interpolated(start + dt * np.arange(size), channel.time, spread)


def local_motion(channel: Channel, times: np.ndarray, reach: float) -> np.ndarray:
    """(J, 2) value and rate of a channel at (J,) times, by parabolas of third degree through what is near.

    Args:
        channel: its samples.
        times: (J,) s.
        reach: to either side, s; more where there are fewer than eight samples.
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
    power = np.abs(np.fft.rfft(value, PADDED * len(value))) ** 2
    lowest = PADDED  # one period in the whole recording
    best = lowest + int(np.argmax(power[lowest:]))
    return float(PADDED * len(value) * (time[1] - time[0]) / best)


def end_of_motion(channel: Channel, swing: float) -> float:
    """When an oscillation has come to rest, s: its amplitude stays below `RESTING` of the largest one.

    The median of the squares in every half period tells the amplitude, also beside glitches, less what noise adds: the
    samples of a noisy sensor go on to be large for ever.

    Args:
        channel: of the oscillation.
        swing: period, s.
    """
    left = channel.time[-1] - channel.time
    rest = np.median(channel.value[-max(8, len(channel) // 20) :])
    part = (left // (0.5 * swing)).astype(int)  # the last one is whole: near a turning point a motion seems at rest
    begins = np.flatnonzero(np.diff(part, prepend=-1))
    squares = np.array([np.median(one) for one in np.split((channel.value - rest) ** 2, begins[1:])])
    count = np.diff(begins, append=len(left))
    noise = quiet_std(channel.time, channel.value) ** 2 * (NORMAL_MEDIAN**2 + SURELY / np.sqrt(count))
    moving = np.flatnonzero(squares > noise + RESTING**2 * squares.max())
    last = begins[moving[-1] + 1] if len(moving) and moving[-1] + 1 < len(begins) else -1
    return float(channel.time[last])


def measured_start(channel: Channel, stretch: float = FIRST_STRETCH) -> tuple[float, float]:
    """Value and rate of a channel at its first sample, by a parabola through what was measured in the first stretch."""
    since = channel.time - channel.time[0]
    near = max(FIRST_SAMPLES, int(np.searchsorted(since, stretch)))
    curve = np.polyfit(since[:near], channel.value[:near], 2)
    return float(curve[2]), float(curve[1])
