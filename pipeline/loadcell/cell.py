"""The real load cell: forces, faults and status from a serial port."""

import time
from collections.abc import Callable
from types import TracebackType

from pipeline.loadcell.calibration import Calibration
from pipeline.loadcell.faults import FaultEvent
from pipeline.loadcell.port import BAUD, open_port
from pipeline.loadcell.reader import QUEUE, CountReader, count_limits
from pipeline.loadcell.sample import ForceSample
from pipeline.loadcell.status import LoadCellStatus


class LoadCell:
    """An HX711 on a microcontroller that speaks the line protocol of `pipeline.loadcell.protocol`.

    It reads in a thread of its own from creation to `close`; use it as a context manager. After a disconnection nothing
    more arrives: a cell that was unplugged in the middle of a motion must not come back unnoticed.

    Args:
        port: such as ``/dev/ttyUSB0`` or ``COM3``.
        calibration: of this cell.
        baud: of the microcontroller's program.
        clock: gives the time of reception [s].
        silent_after: so long without a sample is silence [s].
        queue: how many samples may wait to be taken; the oldest go first.

    Raises:
        InputError: the port cannot be opened.
    """

    def __init__(
        self,
        port: str,
        calibration: Calibration,
        *,
        baud: int = BAUD,
        clock: Callable[[], float] = time.monotonic,
        silent_after: float = 0.2,
        queue: int = QUEUE,
    ) -> None:
        self._calibration = calibration
        limits = count_limits(calibration.count_noise, silent_after)
        self._reader = CountReader(open_port(port, baud), limits, clock, queue)

    def __enter__(self) -> "LoadCell":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def read(self) -> list[ForceSample]:
        """Samples received since the last call, oldest first; those of a faulty cell are among them, see `status`."""
        return [ForceSample(sample.time, self._calibration.force(sample.counts)) for sample in self._reader.read()]

    def events(self) -> list[FaultEvent]:
        """Faults that began or ended since the last call, oldest first."""
        return self._reader.events()

    def status(self) -> LoadCellStatus:
        """How the cell is doing now."""
        return self._reader.status()

    def close(self) -> None:
        """End the thread and let go of the port; twice is once."""
        self._reader.close()
