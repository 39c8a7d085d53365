"""The guided calibration: ask for each weight, take samples, fit."""

from collections.abc import Callable, Sequence

from armdyn.errors import TaskFailedError
from pipeline.loadcell.faults import Fault
from pipeline.loadcell.fit import CalibrationFit, fit_calibration
from pipeline.loadcell.plateau import Plateau
from pipeline.loadcell.reader import CountReader
from pipeline.loadcell.weights import Weight

SETTLING_SAMPLES = 8
"""Samples left out after a weight was changed: the HX711's filter takes four to settle (datasheet, "Settling Time")."""


def calibrate(
    reader: CountReader,
    weights: Sequence[Weight],
    samples: int,
    ask: Callable[[Weight], None],
    progress: Callable[[Weight, int], None],
    wait: Callable[[float], None],
) -> CalibrationFit:
    """Take `samples` samples at each of `weights` and fit a line.

    Args:
        reader: of the cell.
        weights: in the order in which they are asked for.
        samples: per weight.
        ask: has the user hang a weight, and returns when it hangs still.
        progress: told the weight and how many of its samples there are.
        wait: lets so many seconds pass.

    Raises:
        TaskFailedError: the cell fails, or what it said is no calibration.
    """
    _until_first_sample(reader, wait)
    plateaus = []
    for weight in weights:
        ask(weight)
        plateaus.append(Plateau.of(weight, _take(reader, weight, samples, progress, wait)))
    return fit_calibration(plateaus)


def _until_first_sample(reader: CountReader, wait: Callable[[float], None]) -> None:
    while not reader.status().samples:
        _require_alive(reader)
        wait(0.02)


def _take(
    reader: CountReader,
    weight: Weight,
    samples: int,
    progress: Callable[[Weight, int], None],
    wait: Callable[[float], None],
) -> list[int]:
    reader.read()  # what was received while the weight was changed
    counts: list[int] = []
    while len(counts) < SETTLING_SAMPLES + samples:
        counts += [sample.counts for sample in reader.read()]
        _require_alive(reader)
        progress(weight, min(max(len(counts) - SETTLING_SAMPLES, 0), samples))
        wait(0.02)
    return counts[SETTLING_SAMPLES : SETTLING_SAMPLES + samples]


def _require_alive(reader: CountReader) -> None:
    status = reader.status()
    for fault in (Fault.DISCONNECTED, Fault.SILENT):
        if fault in status.active:
            seen = status.counts[Fault.MALFORMED]
            hint = f" ({seen} lines came that are not samples: is the baud rate right?)" if seen else ""
            raise TaskFailedError(f"load cell: {fault.value}{hint}")
