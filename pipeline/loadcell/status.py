"""How a load cell is doing."""

from collections.abc import Mapping
from dataclasses import dataclass

from pipeline.loadcell.faults import Fault


@dataclass(frozen=True)
class LoadCellStatus:
    """How a load cell is doing at one moment.

    Attributes:
        connected: whether the port is open and there.
        samples: how many samples were received.
        rate: measured over the latest samples [Hz]; 0 while nothing arrives.
        latest: time of the latest sample [s], None before the first.
        active: faults that hold now, the gravest first.
        counts: per fault, how many lines or samples it concerned, or how often it began where it lasts.
    """

    connected: bool
    samples: int
    rate: float
    latest: float | None
    active: tuple[Fault, ...]
    counts: Mapping[Fault, int]

    @property
    def reliable(self) -> bool:
        """Whether the force can be used now."""
        return self.connected and self.samples > 0 and not self.active
