"""A mistake that may have been made in a recording, with the correction that undoes it."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace

from armdyn.inspection.check import CheckKind
from armdyn.inspection.correction import CorrectedReading, Correction
from armdyn.inspection.description import AS_DESCRIBED, DescriptionCorrection

TRIED_SENSOR_LAGS_SECONDS = (0.03, 0.06, 0.09)
"""Lags of a gripper or a sensor that are tried, s; they are effects rather than mistakes."""
MIN_CLOCK_SHIFT_SECONDS = 5e-3
"""Clock shift, s, below which time stamps count as right."""


@dataclass(frozen=True)
class Mistake:
    """A mistake that may have been made in a recording.

    Attributes:
        kind: kind of the mistake.
        channels: channels concerned.
        in_words: the mistake in words.
        remedy: what to do if the correction does not solve it.
        correction: correction of the recording.
        description: correction of the arm's description.
        prior_odds_nats: log prior odds against the mistake, nats.
        correctable: whether the correction is known exactly; an estimated one would hide faults of the model.
        is_effect: whether it is an effect instead of a mistake, so that it is not reported.
        clock: sentence on a clock, with a placeholder for its error, which is fitted; empty for other mistakes.
    """

    kind: CheckKind
    channels: tuple[str, ...]
    in_words: str
    remedy: str = ""
    correction: Correction = field(default_factory=Correction)
    description: DescriptionCorrection = AS_DESCRIBED
    prior_odds_nats: float = 0.0
    correctable: bool = True
    is_effect: bool = False
    clock: str = ""

    @property
    def family(self) -> tuple[object, ...]:
        """Key that is equal for mistakes that differ only in the error of a clock."""
        return self.kind, self.channels, self.clock or self.in_words

    def with_clock(self, late: float, pace: float) -> "Mistake":
        """A copy of the mistake with a clock that has the delay `late`, s, and the relative rate error `pace`."""
        readings = {name: replace(r, delay=late, clock_rate_error=pace) for name, r in self.correction.readings.items()}
        return replace(
            self, in_words=self.clock.format(clock_error_in_words(late, pace)), correction=Correction(readings)
        )


def clock_error_in_words(late: float, pace: float) -> str:
    """Describe a clock error in words: a delay `late`, s, and a relative rate error `pace`."""
    shift = f"{abs(late):.3g} s too {'late' if late > 0.0 else 'early'}"
    drift = f"by a clock that runs {100.0 * abs(pace):.2g} % {'fast' if pace > 0.0 else 'slow'}"
    return drift if pace and abs(late) < MIN_CLOCK_SHIFT_SECONDS else f"{shift} and {drift}" if pace else shift


def scaled_channels_mistake(
    kind: CheckKind, channels: Iterable[str], said: str, factor: float = 1.0, *, offset: float = 0.0, price: float = 0.0
) -> Mistake:
    """Mistake that is corrected by a factor and an offset on some channels; `price` are log odds against it, nats."""
    readings = {name: CorrectedReading(name, factor, offset) for name in channels}
    return Mistake(kind, tuple(readings), said, correction=Correction(readings), prior_odds_nats=price)


def shifted_clock_mistakes(
    channels: Iterable[str], said: str, price: float, shifts: Iterable[float], rates: Iterable[float] = ()
) -> Iterator[Mistake]:
    """Clock mistakes of some channels: shifts, s, and relative rate errors; `TRIED_SENSOR_LAGS_SECONDS` are effects."""
    of_channels = replace(scaled_channels_mistake("clock_shift", channels, said, price=price), clock=said)
    for late, pace in (*((late, 0.0) for late in shifts), *((0.0, pace) for pace in rates)):
        yield replace(of_channels.with_clock(late, pace), is_effect=late in TRIED_SENSOR_LAGS_SECONDS)
