"""From bytes in pieces of any size to conversions, each once, with every fault of the line counted."""

from collections import Counter
from dataclasses import dataclass, field

from pipeline.loadcell.faults import Fault
from pipeline.loadcell.protocol import LONGEST_LINE, SEQUENCE_MODULUS, START, Reading, decode

LONGEST_GAP = 1000
"""Conversions, 10 s at 100 Hz; a line loses a few at a time, so a greater jump of the sequence is a new count."""


@dataclass
class Decoded:
    """What a piece of the stream held: conversions, oldest first, and the lines or samples of each fault."""

    readings: list[Reading] = field(default_factory=list)
    faults: Counter[Fault] = field(default_factory=Counter)


class Decoder:
    """Splits the stream into lines, drops what is not a sample, and follows the sequence numbers.

    The first line is usually a torn one, because the port was opened in its middle: that is no fault.
    """

    def __init__(self) -> None:
        self._rest = b""
        self._torn = True
        self._too_long = False
        self._sequence: int | None = None

    def feed(self, data: bytes) -> Decoded:
        """Take in the next piece of the stream."""
        decoded = Decoded()
        *lines, self._rest = (self._rest + data).split(b"\n")
        for line in lines:
            self._line(line, decoded)
            self._torn = self._too_long = False
        if len(self._rest) > LONGEST_LINE:
            # Noise without a line feed must not fill the memory; its end may be the start of a sample.
            self._rest, self._too_long = self._rest[-LONGEST_LINE:], True
        return decoded

    def _line(self, line: bytes, decoded: Decoded) -> None:
        line = line.rstrip(b"\r")
        # What comes after noise on the same line is still a sample: the checksum vouches for it.
        start = max(line.rfind(START), 0)
        reading = decode(line[start:])
        if (start > 0 or self._too_long or (reading is None and not _says_nothing(line))) and not self._torn:
            decoded.faults[Fault.MALFORMED] += 1
        if reading is not None and self._is_new(reading.sequence, decoded.faults):
            decoded.readings.append(reading)

    def _is_new(self, sequence: int, faults: Counter[Fault]) -> bool:
        last, self._sequence = self._sequence, sequence
        step = 1 if last is None else (sequence - last) % SEQUENCE_MODULUS
        if step == 0:
            faults[Fault.REPEATED] += 1
        elif step > LONGEST_GAP:
            faults[Fault.RESTARTED] += 1
        elif step > 1:
            faults[Fault.DROPPED] += step - 1
        return step != 0


def _says_nothing(line: bytes) -> bool:
    """Whether it is empty or a remark."""
    return not line or (line.startswith(b"#") and line.isascii() and line.decode("ascii").isprintable())
