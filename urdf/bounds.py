"""Bounds of all input: one table of limits, one parser of numbers. docs/safety.md shows the table.

A limit is set where no honest file comes near and no machine is brought to its knees; what is met is said in one line.
"""

import math
import re

MIB = 2**20

LARGEST_RECORDING = 256 * MIB
"""Bytes of a CSV, MCAP or Parquet file. Text takes eight times as much memory."""
LARGEST_BAG = 2048 * MIB
"""Bytes of a ROS bag."""
LARGEST_TEXT = MIB
"""Bytes of a file that a person writes: TOML, JSON, Python."""
LARGEST_XML = 64 * MIB
"""Bytes of a URDF, SRDF or MJCF; the largest known description of a robot has 1 MiB."""
LARGEST_MESH = 64 * MIB
"""Bytes of a mesh that is read for a link's volume or shape."""
LARGEST_UPLOAD = 256 * MIB
"""Bytes that one request to the workbench may send."""
LARGEST_JOURNAL = 1024 * MIB
"""Bytes of a batch's journal: a million outcomes."""

LARGEST_CHUNK = 64 * MIB
"""Bytes of one chunk of an MCAP file when it is unpacked; writers close one after 1 to 4 MiB."""
LARGEST_CONTENT = 512 * MIB
"""Bytes of what is unpacked of an MCAP, Parquet or bag file: some five million messages, or 64 million numbers."""
LARGEST_ARRAY = 256 * MIB
"""Bytes of one array of a table; a metre of path at the usual spacing takes 100 kB."""

LARGEST_MESSAGE = 4 * MIB
"""Bytes of one message of a rosbridge; joint states have 2 kB."""
LARGEST_LINE = MIB
"""Bytes of one line of a batch's journal."""

MOST_ROWS = 5_000_000
"""Samples of a recording."""
MOST_COLUMNS = 2000
"""Of a table."""
MOST_LINKS = 2000
"""And joints of a robot; a humanoid with its hands has 100."""
LONGEST_NAME = 200
"""Letters of a joint, link, column or file."""
LONGEST_CELL = 1000
"""Letters of a cell of a table; a number has 25."""
DEEPEST_TABLE = 20
"""TOML tables and lists in one another; no file of ours has more than five. Of JSON: what Python's stack allows."""
DEEPEST_XML = 50
"""Elements in one another; a URDF has 6."""

CONNECTING = 5.0
"""s for the whole way until a rosbridge is connected, and for the answer of a service."""

SMALLEST_SIZE, LARGEST_SIZE = 1e-15, 1e15
"""Size of a number that a person or a program gives, 0 apart, in SI units: beyond, squares and products overflow or
vanish, and no robot has it."""
LARGEST_COUNT = 1e20
"""Of a column of others, in whatever unit: nanoseconds since 1970 are 2e18."""
LARGEST_INTEGER = 2**63
"""TOML promises integers of 64 bits; Python would also take one of 400 digits, which is no float."""

_NUMBER = re.compile(r"[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?")


def number(text: str) -> float:
    """Parse a number from a text: decimal digits, a point, an exponent.

    Python reads more: ``1_000``, digits of other scripts, ``nan``, ``1e999`` as infinite. To a person these are
    mistakes.

    Raises:
        ValueError: the text is no finite number.
    """
    plain = text.strip(" \t")
    if len(plain) > LONGEST_CELL or _NUMBER.fullmatch(plain) is None:
        raise ValueError(f"'{shown(plain)}' is not a number")
    value = float(plain)
    if not math.isfinite(value):
        raise ValueError(f"'{shown(plain)}' is too large for a number")
    return value


def is_sane(value: float) -> bool:
    """Whether a number is 0 or of a plausible size."""
    return value == 0.0 or SMALLEST_SIZE <= abs(value) <= LARGEST_SIZE


def shown(text: str, longest: int = 60) -> str:
    """A text shortened for a message, without control characters of a terminal."""
    cut = text if len(text) <= longest else f"{text[:longest]}..."
    return "".join(c if c.isprintable() else "?" for c in cut)
