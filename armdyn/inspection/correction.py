r"""Correct mistakes in a recording: every corrected channel is a recorded channel, scaled and shifted.

A mistake of a unit, a sign, a column, a zero or a clock is the same kind of transformation of readings,

    y_channel(t) = factor y_source(t + delay + clock_rate_error (t - t_0)) + offset,      t_0 the source's first stamp,

so that one class corrects all of them. The density of the readings changes by the factor |factor|.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from armdyn.recording.channels import Channel
from armdyn.run import Run


@dataclass(frozen=True, order=True)
class CorrectedReading:
    """Correction of one channel: the recorded channel with its values, their scale and offset, and their clock error.

    Attributes:
        source: channel of the recording that contains the values.
        factor: factor on these values.
        offset: offset added after the factor, in the channel's unit.
        delay: delay of the time stamps at the beginning of the recording, s.
        clock_rate_error: relative error of the stamps' clock rate; positive for a fast clock.
        wrap_period: period, in the source's unit, after which the values wrap around; 0 for none.
    """

    source: str
    factor: float = 1.0
    offset: float = 0.0
    delay: float = 0.0
    clock_rate_error: float = 0.0
    wrap_period: float = 0.0

    def values(self, recorded: np.ndarray) -> np.ndarray:
        """(n,) corrected values from (n,) recorded values."""
        whole = np.unwrap(recorded, period=self.wrap_period) if self.wrap_period else recorded
        return np.asarray(self.factor * whole + self.offset)

    def stamps_at(self, time: np.ndarray, begin: float) -> np.ndarray:
        """Recorded time stamps for true times (n,), s, of a channel whose stamps begin at `begin`, s."""
        return time + self.delay + self.clock_rate_error * (time - begin)

    def true_times(self, stamps: np.ndarray) -> np.ndarray:
        """True times (n,), s, for recorded time stamps (n,), s."""
        begin = stamps[:1]
        return np.asarray((stamps - self.delay + self.clock_rate_error * begin) / (1.0 + self.clock_rate_error))


@dataclass(frozen=True)
class Correction:
    """Correction of a recording, channel by channel; other channels remain unchanged.

    Attributes:
        readings: corrected reading of each channel, by its name.
    """

    readings: Mapping[str, CorrectedReading] = field(default_factory=dict)

    def reading(self, channel: str) -> CorrectedReading:
        """The corrected reading of `channel`; unchanged if the correction does not contain it."""
        return self.readings.get(channel, CorrectedReading(channel))

    def followed_by(self, later: "Correction") -> "Correction":
        """The correction that applies this correction first and then `later`."""
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
        """Apply the correction to a recording."""
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
