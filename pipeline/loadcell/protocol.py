r"""The text protocol of the load cell: one line ``HX711 <sequence> <counts> <crc>`` per sample on a serial port.

- sequence: sequence number from 0 to 65535, then 0 again; it shows lost and repeated lines.
- counts: the output of the HX711, a 24-bit signed number.
- crc: CRC-16/XMODEM of the text before it, without the blank, in hexadecimal. It detects every burst of up to 16 wrong
  bits, and all other damage except one case in 65536.

Lines that start with ``#`` are comments. A line ends with ``\n`` or ``\r\n``.
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
from pipeline.loadcell.faults import LoadCellFault

if TYPE_CHECKING:
    import serial

MINIMUM_COUNTS = -0x800000
"""Output of the HX711 if its input is below its range (datasheet, "Output Data Rate and Format")."""
MAXIMUM_COUNTS = 0x7FFFFF
"""Output of the HX711 if its input is above its range."""
SEQUENCE_MODULUS = 0x10000
"""Number of different sequence numbers."""
MAX_LINE_BYTES = 64
"""Largest length of a line from the load cell's board [bytes]; a sample takes at most 26 bytes."""
LINE_START = b"HX711 "
"""First bytes of a line with a sample."""

_LINE = re.compile(rb"(HX711 (\d{1,5}) (-?\d{1,7})) ([0-9A-Fa-f]{1,4})")


class RawLoadCellReading(NamedTuple):
    """One sample from the load cell's microcontroller: its sequence number, and its value in counts."""

    sequence: int
    counts: int


def encode_load_cell_line(reading: RawLoadCellReading) -> bytes:
    """Encode a sample as a line of the protocol, with a line feed at the end."""
    payload = LINE_START + b"%d %d" % reading
    return payload + b" %04X\n" % crc16(payload)


def decode_load_cell_line(line: bytes) -> RawLoadCellReading | None:
    """Decode a line of the protocol, without its line feed; None if it is not a valid sample."""
    match = _LINE.fullmatch(line)
    if match is None:
        return None
    payload, sequence, counts, crc = match.groups()
    reading = RawLoadCellReading(int(sequence), int(counts))
    in_range = reading.sequence < SEQUENCE_MODULUS and MINIMUM_COUNTS <= reading.counts <= MAXIMUM_COUNTS
    return reading if in_range and int(crc, 16) == crc16(payload) else None


def crc16(payload: bytes) -> int:
    """CRC-16/XMODEM of bytes: polynomial 0x1021, initial value 0, no reflection; 0x31C3 for ``b"123456789"``."""
    return binascii.crc_hqx(payload, 0)


MAX_LOST_SAMPLES_WITHOUT_RESTART = 1000
"""Largest number of lost samples, 10 s at 100 Hz; a larger jump of the sequence number is a restart."""


@dataclass
class DecodedSamples:
    """Result of decoding a part of the byte stream: samples, oldest first, and the number of faults of each kind."""

    readings: list[RawLoadCellReading] = field(default_factory=list)
    faults: Counter[LoadCellFault] = field(default_factory=Counter)


class LoadCellLineDecoder:
    """Decodes the byte stream of a load cell: splits it into lines, and checks checksums and sequence numbers.

    The first line may be incomplete, because the port was opened in its middle; this is not a fault.
    """

    def __init__(self) -> None:
        self._rest = b""
        self._torn = True
        self._too_long = False
        self._sequence: int | None = None

    def decode_bytes(self, data: bytes) -> DecodedSamples:
        """Decode the next bytes of the stream."""
        decoded = DecodedSamples()
        *lines, self._rest = (self._rest + data).split(b"\n")
        for line in lines:
            self._line(line, decoded)
            self._torn = self._too_long = False
        if len(self._rest) > MAX_LINE_BYTES:
            # Noise without a line feed must not fill the memory; the end of it may be the start of a sample.
            self._rest, self._too_long = self._rest[-MAX_LINE_BYTES:], True
        return decoded

    def _line(self, line: bytes, decoded: DecodedSamples) -> None:
        line = line.rstrip(b"\r")
        # A sample that follows noise on the same line is still valid, because its checksum is right.
        start = max(line.rfind(LINE_START), 0)
        reading = decode_load_cell_line(line[start:])
        if (start > 0 or self._too_long or (reading is None and not _is_remark(line))) and not self._torn:
            decoded.faults[LoadCellFault.MALFORMED] += 1
        if reading is not None and self._is_new(reading.sequence, decoded.faults):
            decoded.readings.append(reading)

    def _is_new(self, sequence: int, faults: Counter[LoadCellFault]) -> bool:
        last, self._sequence = self._sequence, sequence
        step = 1 if last is None else (sequence - last) % SEQUENCE_MODULUS
        if step == 0:
            faults[LoadCellFault.REPEATED] += 1
        elif step > MAX_LOST_SAMPLES_WITHOUT_RESTART:
            faults[LoadCellFault.RESTARTED] += 1
        elif step > 1:
            faults[LoadCellFault.DROPPED] += step - 1
        return step != 0


def _is_remark(line: bytes) -> bool:
    return not line or (line.startswith(b"#") and line.isascii() and line.decode("ascii").isprintable())


DEFAULT_BAUD_RATE = 115200
"""Default baud rate of the serial connection to the load cell's board [bit/s]."""
READ_TIMEOUT_SECONDS = 0.05
"""Longest wait of a read for the first byte [s]."""


def open_port(port: str, baud: int = DEFAULT_BAUD_RATE) -> "serial.Serial":
    """Open a serial port for this program alone.

    Reading from the port waits at most `READ_TIMEOUT_SECONDS`, and raises OSError after a disconnection.

    Args:
        port: name of the port, such as ``/dev/ttyUSB0``.
        baud: baud rate.

    Raises:
        InputError: the port does not exist, is not a serial port, may not be used, is used by another program, or does
            not support the baud rate.
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
        usual = DEFAULT_BAUD_RATE
        return f"baud rate {baud} does not exist: use the one of the microcontroller's program, such as {usual}"
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
