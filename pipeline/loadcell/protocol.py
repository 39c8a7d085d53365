r"""The line protocol: ``HX711 <sequence> <counts> <crc>``, one line per conversion.

- sequence: 0 to 65535, then 0 again; one more for every conversion, so that lost and repeated lines show.
- counts: what the HX711 gives, a 24-bit signed number.
- crc: CRC-16/XMODEM of everything before it (without the blank), in hexadecimal. It tells a sample from a damaged line
  that still looks like one: every burst of up to 16 wrong bits for certain, other damage but once in 65536.

Lines that start with ``#`` are remarks. Both ``\n`` and ``\r\n`` end a line.
"""

import binascii
import re
from typing import NamedTuple

MINIMUM_COUNTS = -0x800000
"""What the HX711 gives when its input is below its range (datasheet, "Output Data Rate and Format")."""
MAXIMUM_COUNTS = 0x7FFFFF
"""What the HX711 gives when its input is above its range."""
SEQUENCE_MODULUS = 0x10000
LONGEST_LINE = 64
"""Bytes; a sample takes at most 26, a remark should be no longer than this."""
START = b"HX711 "

_LINE = re.compile(rb"(HX711 (\d{1,5}) (-?\d{1,7})) ([0-9A-Fa-f]{1,4})")


class Reading(NamedTuple):
    """One conversion as the microcontroller sent it."""

    sequence: int
    counts: int


def encode(reading: Reading) -> bytes:
    """The line of one conversion, ended by a line feed."""
    payload = START + b"%d %d" % reading
    return payload + b" %04X\n" % checksum(payload)


def decode(line: bytes) -> Reading | None:
    """The conversion in one line without its end; None where it is not exactly one."""
    match = _LINE.fullmatch(line)
    if match is None:
        return None
    payload, sequence, counts, crc = match.groups()
    reading = Reading(int(sequence), int(counts))
    in_range = reading.sequence < SEQUENCE_MODULUS and MINIMUM_COUNTS <= reading.counts <= MAXIMUM_COUNTS
    return reading if in_range and int(crc, 16) == checksum(payload) else None


def checksum(payload: bytes) -> int:
    """CRC-16/XMODEM: polynomial 0x1021, initial value 0, nothing reflected; 0x31C3 for ``b"123456789"``."""
    return binascii.crc_hqx(payload, 0)
