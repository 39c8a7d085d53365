"""The serial line: what a line is, and how a stream of them is taken apart, whatever happens to it."""

import re
import shutil
import subprocess
from collections import Counter
from itertools import accumulate
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.loadcell.faults import LoadCellFault
from pipeline.loadcell.protocol import (
    LoadCellLineDecoder,
    RawLoadCellReading,
    crc16,
    decode_load_cell_line,
    encode_load_cell_line,
)

readings = st.builds(RawLoadCellReading, st.integers(0, 0xFFFF), st.integers(-0x800000, 0x7FFFFF))
DOCUMENT = (Path(__file__).parents[3] / "docs" / "loadcell.md").read_text()


def bitwise_crc(data):
    """CRC-16/XMODEM by long division, from its definition."""
    register = 0
    for byte in data + b"\0\0":
        for bit in range(7, -1, -1):
            carry = register >> 15
            register = (register << 1 | byte >> bit & 1) & 0xFFFF
            register ^= 0x1021 if carry else 0
    return register


@given(st.binary(max_size=40))
def test_the_checksum_is_the_remainder_of_the_long_division(data):
    assert crc16(data) == bitwise_crc(data)
    assert crc16(b"123456789") == 0x31C3  # as published


@given(readings, st.data())
def test_only_a_whole_and_undamaged_line_gives_back_its_reading(reading, data):
    line = encode_load_cell_line(reading)
    assert len(line) <= 26
    assert line.endswith(b"\n")
    assert decode_load_cell_line(line[:-1]) == reading
    assert decode_load_cell_line(line[: data.draw(st.integers(0, len(line) - 6))]) is None
    wrong = bytearray(line[:-1])
    wrong[data.draw(st.integers(0, len(wrong) - 1))] ^= 1 << data.draw(st.integers(0, 7))
    # A wrong bit may make a small letter of a hexadecimal digit, which changes nothing.
    assert decode_load_cell_line(bytes(wrong)) in (None, reading)


@pytest.mark.parametrize(
    "text", [b"HX711 65536 0", b"HX711 1 8388608", b"HX711 1 -8388609", b"HX711 -1 0", b"HX712 1 0"]
)
def test_a_right_checksum_does_not_make_a_sample_of_what_is_out_of_range(text):
    assert decode_load_cell_line(text + b" %04X" % crc16(text)) is None


def test_the_example_of_the_document_is_a_sample():
    assert decode_load_cell_line(
        re.search(r"For example `(HX711 [^`]*)`", DOCUMENT).group(1).encode()
    ) == RawLoadCellReading(4711, 259390)


ARDUINO = r"""
#include <cstdint>
#include <cstdio>
enum { LOW, HIGH, INPUT_PULLUP, OUTPUT };
static const int32_t values[] = {VALUES};
static int conversion_number = 0, pulses = 0, level = LOW;
static void pinMode(int, int) {}
static void noInterrupts() {}
static void interrupts() {}
static void delayMicroseconds(int) {}
static void digitalWrite(int, int to) {              // the clock: the HX711 shifts at its rising edge
  if (to == HIGH && level == LOW && ++pulses == 25) { pulses = 0; conversion_number++; }
  level = to;
}
static int digitalRead(int) {                        // the data line: low when ready, then the bits, highest first
  return pulses == 0 ? LOW : (values[conversion_number] >> (24 - pulses)) & 1;
}
static struct { void begin(long) {} void print(const char *text) { fputs(text, stdout); } } Serial;
#include "sketch.h"
int main() { setup(); while (conversion_number < (int)(sizeof values / sizeof *values)) loop(); }
"""


@pytest.mark.skipif(shutil.which("g++") is None, reason="needs a C++ compiler")
def test_the_documents_arduino_program_sends_what_its_hx711_measures(tmp_path):
    values = [0, 1, -1, 123456, -123456, 0x7FFFFF, -0x800000, 84213]
    (tmp_path / "sketch.h").write_text(re.search(r"```cpp\n(.*?)```", DOCUMENT, re.DOTALL).group(1))
    (tmp_path / "main.cpp").write_text(ARDUINO.replace("VALUES", ", ".join(map(str, values))))
    command = ["g++", "-Wall", "-Werror", "-o", tmp_path / "sketch", tmp_path / "main.cpp"]
    subprocess.run(command, check=True, timeout=60)
    sent = subprocess.run([tmp_path / "sketch"], check=True, capture_output=True, timeout=60).stdout
    assert decode_all([sent]) == ([RawLoadCellReading(number, counts) for number, counts in enumerate(values)], {})


def lines(*numbers):
    return [encode_load_cell_line(RawLoadCellReading(number % 0x10000, 1000 + number)) for number in numbers]


def decode_all(pieces):
    decoder, readings, faults = LoadCellLineDecoder(), [], Counter()
    for piece in pieces:
        decoded = decoder.decode_bytes(piece)
        readings += decoded.readings
        faults += decoded.faults
    return readings, faults


@given(st.lists(st.sampled_from([*lines(*range(6)), b"noise\n", b"# remark\r\n", b"HX711 3 ", b"\r\n"])), st.data())
def test_the_size_of_the_pieces_changes_nothing(parts, data):
    stream = b"".join(parts)
    cuts = sorted(data.draw(st.lists(st.integers(0, len(stream)), max_size=12)))
    pieces = [stream[a:b] for a, b in zip([0, *cuts], [*cuts, len(stream)], strict=True)]
    assert decode_all(pieces) == decode_all([stream])


MALFORMED, DROPPED = LoadCellFault.MALFORMED, LoadCellFault.DROPPED


@pytest.mark.parametrize(
    ("stream", "numbers", "faults"),
    [
        ([b"# load cell with HX711\r\n", lines(0)[0][:-1] + b"\r\n", b"\n", *lines(1)], [0, 1], {}),
        ([lines(7)[0][9:], *lines(8, 9)], [8, 9], {}),  # the port was opened in the middle of a line
        (lines(7), [7], {}),
        ([*lines(0), b"\xff\x00\xfeHX7 \x80", *lines(1, 2)], [0, 1, 2], {MALFORMED: 1}),  # noise before a sample
        ([*lines(0), lines(1)[0][:-1], *lines(2, 3)], [0, 2, 3], {MALFORMED: 1, DROPPED: 1}),  # a lost line feed
        ([*lines(0), b"HX711 1 1001\n", b"1001\n", b"HX711 1 1001 zzzz\n"], [0], {MALFORMED: 3}),
        (lines(*range(65530, 65545)), [n % 65536 for n in range(65530, 65545)], {}),
        (lines(0, 1, 1, 1, 2), [0, 1, 2], {LoadCellFault.REPEATED: 2}),
        (lines(500, 501, 0, 1), [500, 501, 0, 1], {LoadCellFault.RESTARTED: 1}),
    ],
)
def test_what_is_a_sample_is_taken_and_what_is_not_is_counted(stream, numbers, faults):
    found, counted = decode_all(stream)
    assert [reading.sequence for reading in found] == numbers
    assert counted == faults


def test_endless_noise_without_a_line_feed_is_one_fault_and_does_not_pile_up():
    decoder = LoadCellLineDecoder()
    decoder.decode_bytes(lines(0)[0])
    for _ in range(1000):
        assert not decoder.decode_bytes(b"x" * 1000).readings
    assert len(decoder._rest) < 100
    decoded = decoder.decode_bytes(lines(1)[0])
    assert (decoded.readings, decoded.faults) == ([RawLoadCellReading(1, 1001)], {MALFORMED: 1})


@given(st.lists(st.integers(1, 5), min_size=1, max_size=60), st.integers(0, 0xFFFF))
def test_every_sequence_number_left_out_is_one_dropped_sample(steps, first):
    found, faults = decode_all(lines(*accumulate([first, *steps])))
    assert len(found) == len(steps) + 1
    assert faults[DROPPED] == sum(steps) - len(steps)
    assert set(faults) <= {DROPPED}
