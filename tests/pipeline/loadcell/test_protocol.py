import re
import shutil
import subprocess
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.loadcell.protocol import Decoder, Reading, checksum, decode, encode

readings = st.builds(Reading, st.integers(0, 0xFFFF), st.integers(-0x800000, 0x7FFFFF))
DOCUMENT = Path(__file__).parents[3] / "docs" / "loadcell.md"


def bitwise_crc(data):
    """CRC-16/XMODEM by long division, from its definition."""
    register = 0
    for byte in data + b"\0\0":
        for bit in range(7, -1, -1):
            carry = register >> 15
            register = (register << 1 | byte >> bit & 1) & 0xFFFF
            register ^= 0x1021 if carry else 0
    return register


def test_the_checksum_of_the_standard_text_is_the_published_one():
    assert checksum(b"123456789") == 0x31C3


@given(st.binary(max_size=40))
def test_the_checksum_is_the_remainder_of_the_long_division(data):
    assert checksum(data) == bitwise_crc(data)


@given(readings)
def test_a_line_gives_back_its_reading(reading):
    line = encode(reading)
    assert len(line) <= 26
    assert line.endswith(b"\n")
    assert decode(line[:-1]) == reading


@given(readings, st.data())
def test_no_line_with_a_wrong_bit_is_a_sample(reading, data):
    line = bytearray(encode(reading)[:-1])
    line[data.draw(st.integers(0, len(line) - 1))] ^= 1 << data.draw(st.integers(0, 7))
    # A wrong bit may make a small letter of a hexadecimal digit, which changes nothing.
    assert decode(bytes(line)) in (None, reading)


@given(readings, st.data())
def test_no_line_that_lost_its_end_is_a_sample(reading, data):
    line = encode(reading)[:-1]
    assert decode(line[: data.draw(st.integers(0, len(line) - 5))]) is None


@pytest.mark.parametrize(
    "text", [b"HX711 65536 0", b"HX711 1 8388608", b"HX711 1 -8388609", b"HX711 -1 0", b"HX712 1 0"]
)
def test_a_right_checksum_does_not_make_a_sample_of_what_is_out_of_range(text):
    assert decode(text + b" %04X" % checksum(text)) is None


def test_the_example_of_the_document_is_a_sample():
    example = re.search(r"For example `(HX711 [^`]*)`", DOCUMENT.read_text()).group(1)
    assert decode(example.encode()) == Reading(4711, 259390)


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
    sketch = re.search(r"```cpp\n(.*?)```", DOCUMENT.read_text(), re.DOTALL).group(1)
    (tmp_path / "sketch.h").write_text(sketch)
    (tmp_path / "main.cpp").write_text(ARDUINO.replace("VALUES", ", ".join(map(str, values))))
    command = ["g++", "-Wall", "-Werror", "-o", tmp_path / "sketch", tmp_path / "main.cpp"]
    subprocess.run(command, check=True, timeout=60)
    sent = subprocess.run([tmp_path / "sketch"], check=True, capture_output=True, timeout=60).stdout
    decoded = Decoder().feed(sent)
    assert decoded.readings == [Reading(number, counts) for number, counts in enumerate(values)]
    assert not decoded.faults
