"""Largest sizes and values of input that armdyn accepts, and the parser of numbers; docs/safety.md lists the limits.

Each limit is far above what real files need, and low enough that reading them does not exhaust a computer's memory.
Input beyond a limit is refused with a message of one line.
"""

import math
import re

MIB = 2**20
"""Bytes of one mebibyte."""

MAX_RECORDING_BYTES = 256 * MIB
"""Largest size of a CSV, MCAP or Parquet file [bytes]; reading a text file takes eight times its size in memory."""
MAX_BAG_BYTES = 2048 * MIB
"""Largest size of a ROS bag [bytes]."""
MAX_TEXT_FILE_BYTES = MIB
"""Largest size of a file that a person writes, such as TOML, JSON or Python [bytes]."""
MAX_XML_BYTES = 64 * MIB
"""Largest size of a URDF, SRDF or MJCF file [bytes]; the largest known robot description has 1 MiB."""
MAX_MESH_BYTES = 64 * MIB
"""Largest size of an STL file that is read for the volume or shape of a link [bytes]."""
MAX_TEXT_MESH_BYTES = 24 * MIB
"""Largest size of a mesh file of another kind, such as OBJ or DAE [bytes]; reading one takes 25 times its size."""
MAX_MJCF_COUNT = 10_000
"""Largest number of copies, keys, states or user's numbers that an MJCF file asks for; a humanoid robot has 100."""
MAX_MJCF_PIXELS = 2**26
"""Largest number of points of all textures, or of all height fields, of an MJCF file: 64 million."""
MAX_UPLOAD_BYTES = 256 * MIB
"""Largest size of one request to the workbench [bytes]."""
MAX_JOURNAL_BYTES = 1024 * MIB
"""Largest size of a batch's journal, the file with a line per finished job [bytes]; enough for a million jobs."""

MAX_CHUNK_BYTES = 64 * MIB
"""Largest size of one chunk of an MCAP file or bag after decompression [bytes]; writers end one after 1 to 4 MiB."""
MAX_DECOMPRESSED_FILE_BYTES = 512 * MIB
"""Largest size of an MCAP or bag file after decompression [bytes]: five million messages."""
MAX_IK_TABLE_ARRAY_BYTES = 256 * MIB
"""Largest size of one array in the file of an IK table [bytes]; one metre of path takes about 100 kB."""

MAX_ROSBRIDGE_MESSAGE_BYTES = 4 * MIB
"""Largest size of one message from a rosbridge [bytes]; a message of joint states has about 2 kB."""
MAX_JOURNAL_LINE_BYTES = MIB
"""Largest size of one line of a batch's journal [bytes]."""

MAX_RECORDING_ROWS = 5_000_000
"""Largest number of samples in a recording."""
MAX_TABLE_COLUMNS = 2000
"""Largest number of columns in a table."""
MAX_TABLE_CELLS = 20_000_000
"""Largest number of cells in a table; ten quantities of seven joints at 100 Hz take 25 million in an hour."""
MAX_LINE_BYTES = MIB
"""Largest size of a line of a text table [bytes]; 2000 numbers take 50 kB, a list of an arm's readings 1 kB."""
MAX_ROBOT_LINKS = 2000
"""Largest number of links, and of joints, of a robot; a humanoid robot with hands has about 100."""
MAX_NAME_CHARACTERS = 200
"""Largest number of characters in the name of a joint, link, column or file."""
MAX_TABLE_CELL_CHARACTERS = 1000
"""Largest number of characters in a cell of a table; a number takes at most 25."""
MAX_TOML_DEPTH = 20
"""Largest depth of nested tables and lists in a TOML file; armdyn's own files need at most five."""
MAX_XML_DEPTH = 50
"""Largest depth of nested XML elements; a URDF needs six."""

ROSBRIDGE_TIMEOUT_SECONDS = 5.0
"""Longest time to connect to a rosbridge, and longest wait for the answer of a ROS service [s]."""

MIN_NONZERO_INPUT_MAGNITUDE, MAX_INPUT_MAGNITUDE = 1e-15, 1e15
"""Smallest and largest absolute value of a number other than 0 that a person or program gives, in SI units.

No quantity of a robot lies beyond, and squares and products of such numbers would overflow or underflow.
"""
MAX_VALUE_BEFORE_UNIT_CONVERSION = 1e20
"""Largest absolute value in a recording's column before its unit is converted; nanoseconds since 1970 are 2e18."""
TOML_INTEGER_LIMIT = 2**63
"""Integers of a TOML file lie from minus this value to one below it: TOML guarantees 64 bits."""

_NUMBER = re.compile(r"[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?")


def parse_number(text: str) -> float:
    """Parse a decimal number with an optional sign, point and exponent, such as ``-1.5e-3``.

    Python's `float` also accepts ``1_000``, digits of other scripts, ``nan`` and ``1e999``; in a file these are
    probably mistakes, and they are refused here.

    Raises:
        ValueError: the text is not a finite number.
    """
    plain = text.strip(" \t")
    if len(plain) > MAX_TABLE_CELL_CHARACTERS or _NUMBER.fullmatch(plain) is None:
        raise ValueError(f"'{printable_excerpt(plain)}' is not a number")
    value = float(plain)
    if not math.isfinite(value):
        raise ValueError(f"'{printable_excerpt(plain)}' is too large for a number")
    return value


def has_plausible_magnitude(value: float) -> bool:
    """Whether a number is 0, or its size lies between `MIN_NONZERO_INPUT_MAGNITUDE` and `MAX_INPUT_MAGNITUDE`."""
    return value == 0.0 or MIN_NONZERO_INPUT_MAGNITUDE <= abs(value) <= MAX_INPUT_MAGNITUDE


def printable_excerpt(text: str, longest: int = 60) -> str:
    """A text cut to at most `longest` characters for a message, with unprintable characters replaced by '?'."""
    cut = text if len(text) <= longest else f"{text[:longest]}..."
    return "".join(c if c.isprintable() else "?" for c in cut)
