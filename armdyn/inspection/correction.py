r"""What was done to a recording by mistake, undone: every channel is one of the recorded ones, scaled and moved.

A mistake of a unit, a sign, a column, a zero or a clock is one and the same transformation of readings,

    y_channel(t) = factor y_source(t + late + pace (t - t_0)) + offset,      t_0 the source's first stamp,

so that one class undoes all of them, and the logarithm of |factor| is what the density of the readings changes by.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from armdyn.recording.channels import Channel
from armdyn.run import Run


@dataclass(frozen=True, order=True)
class Reading:
    """Where the values of a channel are, and how they are to be read.

    Attributes:
        source: channel of the recording.
        factor: of its values.
        offset: added then, in the channel's unit.
        late: s; the recording's stamps are so much too large at its beginning.
        pace: by so much, of the time that passes, does their clock run fast.
        turn: in the source's unit, after which it counts from the other end again; 0 for none.
    """

    source: str
    factor: float = 1.0
    offset: float = 0.0
    late: float = 0.0
    pace: float = 0.0
    turn: float = 0.0

    def values(self, recorded: np.ndarray) -> np.ndarray:
        """(n,) values of recorded ones."""
        whole = np.unwrap(recorded, period=self.turn) if self.turn else recorded
        return np.asarray(self.factor * whole + self.offset)

    def stamped(self, time: np.ndarray, begin: float) -> np.ndarray:
        """Stamps of the recording at these times, (n,) s, of a channel whose stamps begin at `begin`."""
        return time + self.late + self.pace * (time - begin)

    def right(self, stamps: np.ndarray) -> np.ndarray:
        """(n,) times of a channel's stamps."""
        begin = stamps[:1]
        return np.asarray((stamps - self.late + self.pace * begin) / (1.0 + self.pace))


@dataclass(frozen=True)
class Correction:
    """How to read a recording; channels that are not named are right.

    Attributes:
        readings: by channel.
    """

    readings: Mapping[str, Reading] = field(default_factory=dict)

    def reading(self, channel: str) -> Reading:
        """How one channel is read."""
        return self.readings.get(channel, Reading(channel))

    def then(self, later: "Correction") -> "Correction":
        """Both, one after the other."""
        found = dict(self.readings)
        for channel, second in later.readings.items():
            first = self.reading(second.source)
            found[channel] = Reading(
                first.source,
                second.factor * first.factor,
                second.factor * first.offset + second.offset,
                first.late + second.late,
                (1.0 + first.pace) * (1.0 + second.pace) - 1.0,
                first.turn or second.turn,
            )
        return Correction(found)

    def of(self, run: Run) -> Run:
        """The recording, mended."""
        channels, noise = dict(run.channels), dict(run.noise)
        for name, reading in self.readings.items():
            if name not in run.channels or reading.source not in run.channels:
                continue
            source = run.channels[reading.source]
            channels[name] = Channel(reading.right(source.time), reading.values(source.value), run.channels[name].unit)
            noise.pop(name, None)
            if reading.source in run.noise:
                noise[name] = abs(reading.factor) * run.noise[reading.source]
        return replace(run, channels=channels, noise=noise)
