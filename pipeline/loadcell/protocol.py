r"""The serial line of the load cell: ``HX711 <sequence> <counts> <crc>``, one line per conversion, ended by ``\n``.

- sequence: 0 to 65535, then 0 again; one more for every conversion, so that lost and repeated lines show.
- counts: what the HX711 gives, a 24-bit signed number.
- crc: CRC-16/XMODEM of everything before it (without the blank), in hexadecimal. It finds damaged lines that
  still look like a sample: every burst of up to 16 wrong bits, and all other damage except one case in 65536.

Lines that start with ``#`` are remarks. Both ``\n`` and ``\r\n`` end a line.
"""

import binascii
import contextlib
import errno
import re
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from armdyn.errors import InputError
from pipeline.loadcell.faults import Fault

if TYPE_CHECKING:
    import serial

MINIMUM_COUNTS = -0x800000
"""What the HX711 gives when its input is below its range (datasheet, "Output Data Rate and Format")."""
MAXIMUM_COUNTS = 0x7FFFFF
"""What the HX711 gives when its input is above its range."""
SEQUENCE_MODULUS = 0x10000
MAX_LINE_BYTES = 64
"""Bytes; a sample takes at most 26, a remark should be no longer than this."""
LINE_START = b"HX711 "

_LINE = re.compile(rb"(HX711 (\d{1,5}) (-?\d{1,7})) ([0-9A-Fa-f]{1,4})")


class CellReading(NamedTuple):
    """One conversion as the microcontroller sent it."""

    sequence: int
    counts: int


def encode(reading: CellReading) -> bytes:
    """The line of one conversion, ended by a line feed."""
    payload = LINE_START + b"%d %d" % reading
    return payload + b" %04X\n" % checksum(payload)


def decode(line: bytes) -> CellReading | None:
    """The conversion in one line without its end; None where it is not exactly one."""
    match = _LINE.fullmatch(line)
    if match is None:
        return None
    payload, sequence, counts, crc = match.groups()
    reading = CellReading(int(sequence), int(counts))
    in_range = reading.sequence < SEQUENCE_MODULUS and MINIMUM_COUNTS <= reading.counts <= MAXIMUM_COUNTS
    return reading if in_range and int(crc, 16) == checksum(payload) else None


def checksum(payload: bytes) -> int:
    """CRC-16/XMODEM: polynomial 0x1021, initial value 0, nothing reflected; 0x31C3 for ``b"123456789"``."""
    return binascii.crc_hqx(payload, 0)


MAX_SEQUENCE_GAP = 1000
"""Largest gap in the sequence numbers, 10 s at 100 Hz; a larger jump means that the microcontroller restarted."""


@dataclass
class Decoded:
    """Content of a piece of the stream: conversions, oldest first, and the number of faults of each kind."""

    readings: list[CellReading] = field(default_factory=list)
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
        """Decode the next piece of the stream."""
        decoded = Decoded()
        *lines, self._rest = (self._rest + data).split(b"\n")
        for line in lines:
            self._line(line, decoded)
            self._torn = self._too_long = False
        if len(self._rest) > MAX_LINE_BYTES:
            # Noise without a line feed must not fill the memory; the end of it may be the start of a sample.
            self._rest, self._too_long = self._rest[-MAX_LINE_BYTES:], True
        return decoded

    def _line(self, line: bytes, decoded: Decoded) -> None:
        line = line.rstrip(b"\r")
        # A sample that follows noise on the same line is still valid, because its checksum is right.
        start = max(line.rfind(LINE_START), 0)
        reading = decode(line[start:])
        if (start > 0 or self._too_long or (reading is None and not _is_remark(line))) and not self._torn:
            decoded.faults[Fault.MALFORMED] += 1
        if reading is not None and self._is_new(reading.sequence, decoded.faults):
            decoded.readings.append(reading)

    def _is_new(self, sequence: int, faults: Counter[Fault]) -> bool:
        last, self._sequence = self._sequence, sequence
        step = 1 if last is None else (sequence - last) % SEQUENCE_MODULUS
        if step == 0:
            faults[Fault.REPEATED] += 1
        elif step > MAX_SEQUENCE_GAP:
            faults[Fault.RESTARTED] += 1
        elif step > 1:
            faults[Fault.DROPPED] += step - 1
        return step != 0


def _is_remark(line: bytes) -> bool:
    return not line or (line.startswith(b"#") and line.isascii() and line.decode("ascii").isprintable())


BAUD = 115200
READ_TIMEOUT_SECONDS = 0.05
"""How long a read waits for the first byte [s], and so how soon a reader notices that it shall end."""


def open_port(port: str, baud: int = BAUD) -> "serial.Serial":
    """Open `port` for this program alone; reading waits for `READ_TIMEOUT_SECONDS`, and raises OSError once it is gone.

    Raises:
        InputError: the port is missing, forbidden, in use, no serial port, or does not support the baud rate.
    """
    import serial

    try:
        line = serial.Serial(port, baud, timeout=READ_TIMEOUT_SECONDS, exclusive=True)
    except (OSError, ValueError) as error:
        raise InputError(f"{port}: {_reason(port, baud, error)}") from error
    # Without this an FTDI adapter collects bytes for 16 ms, and every ms of delay shifts the estimated length by
    # 0.25 mm. Other kinds of port do not have this setting.
    with contextlib.suppress(OSError, ValueError, AttributeError, NotImplementedError):
        line.set_low_latency_mode(True)
    return line


def _reason(port: str, baud: int, error: OSError | ValueError) -> str:
    if isinstance(error, ValueError):
        return f"baud rate {baud} does not exist: use the one of the microcontroller's program, such as {BAUD}"
    number = error.errno
    if number in (errno.ENOENT, errno.ENODEV, errno.ENXIO):
        return f"there is no such port: {_present()}"
    if number in (errno.EACCES, errno.EPERM):
        group = "dialout"
        with contextlib.suppress(OSError, KeyError, NotImplementedError):
            group = Path(port).group()
        return f"permission denied: 'sudo usermod -aG {group} $USER', then log in again"
    if number in (errno.EBUSY, errno.EAGAIN):
        return "another program has it open: close that (a serial monitor?) and try again"
    return f"is not a serial port{f' ({error.strerror})' if error.strerror else ''}: {_present()}"


def _present() -> str:
    from serial.tools.list_ports import comports

    names = sorted(info.device for info in comports())
    if not names:
        return "none is present, so plug the microcontroller in, or write 'emulated' to try without one"
    return f"choose one of {', '.join(names)}"
