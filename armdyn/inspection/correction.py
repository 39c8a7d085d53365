r"""Correct a mistaken recording: every channel is one of the recorded channels, scaled and shifted.

A mistake of a unit, a sign, a column, a zero or a clock is the same kind of transformation of readings,

    y_channel(t) = factor y_source(t + late + pace (t - t_0)) + offset,      t_0 the source's first stamp,

so that one class corrects all of them. The density of the readings changes by the factor |factor|.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from armdyn.recording.channels import Channel
from armdyn.run import Run


@dataclass(frozen=True, order=True)
class CorrectedReading:
    """Source of a channel's values, and how they are to be read.

    Attributes:
        source: channel of the recording that contains the values.
        factor: factor on these values.
        offset: offset added after the factor, in the channel's unit.
        delay: delay of the recording's stamps at its beginning, s.
        clock_rate_error: relative rate error of the stamps' clock; positive where it runs fast.
        wrap_period: period, in the source's unit, after which the values wrap around; 0 where they do not.
    """

    source: str
    factor: float = 1.0
    offset: float = 0.0
    delay: float = 0.0
    clock_rate_error: float = 0.0
    wrap_period: float = 0.0

    def values(self, recorded: np.ndarray) -> np.ndarray:
        """(n,) values of the channel from (n,) recorded ones."""
        whole = np.unwrap(recorded, period=self.wrap_period) if self.wrap_period else recorded
        return np.asarray(self.factor * whole + self.offset)

    def stamps_at(self, time: np.ndarray, begin: float) -> np.ndarray:
        """Stamps of the recording at the true times (n,), s, of a channel whose stamps begin at `begin`."""
        return time + self.delay + self.clock_rate_error * (time - begin)

    def true_times(self, stamps: np.ndarray) -> np.ndarray:
        """True times (n,), s, of a channel's stamps."""
        begin = stamps[:1]
        return np.asarray((stamps - self.delay + self.clock_rate_error * begin) / (1.0 + self.clock_rate_error))


@dataclass(frozen=True)
class Correction:
    """How to read a recording; channels that are not named are read as they are.

    Attributes:
        readings: how to read a channel, by its name.
    """

    readings: Mapping[str, CorrectedReading] = field(default_factory=dict)

    def reading(self, channel: str) -> CorrectedReading:
        """How to read one channel."""
        return self.readings.get(channel, CorrectedReading(channel))

    def followed_by(self, later: "Correction") -> "Correction":
        """The correction that applies this one first, then `later`."""
        found = dict(self.readings)
        for channel, second in later.readings.items():
            first = self.reading(second.source)
            found[channel] = CorrectedReading(
                first.source,
                second.factor * first.factor,
                second.factor * first.offset + second.offset,
                first.delay + second.delay,
                (1.0 + first.clock_rate_error) * (1.0 + second.clock_rate_error) - 1.0,
                first.wrap_period or second.wrap_period,
            )
        return Correction(found)

    def applied_to(self, run: Run) -> Run:
        """The corrected recording."""
        channels, noise = dict(run.channels), dict(run.noise)
        for name, reading in self.readings.items():
            if name not in run.channels or reading.source not in run.channels:
                continue
            source = run.channels[reading.source]
            channels[name] = Channel(
                reading.true_times(source.time), reading.values(source.value), run.channels[name].unit
            )
            noise.pop(name, None)
            if reading.source in run.noise:
                noise[name] = abs(reading.factor) * run.noise[reading.source]
        return replace(run, channels=channels, noise=noise)
