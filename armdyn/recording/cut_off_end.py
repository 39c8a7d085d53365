"""Detect a text table that was cut off in the middle of its last cell.

A part of a number is a number as well, so that a cut cannot be proved. But a cut leaves a cell that differs from the
others of its column: fewer digits, no exponent, a tenth of the value, half a word.
"""

import re
from collections.abc import Sequence
from itertools import pairwise

from urdf.bounds import printable_excerpt

MAX_CUT_ERROR_SHARE_OF_ROW_STEP = 1e-6
"""Largest error by a cut of the last number that is accepted, as a share of the usual step from row to row: of numbers
with 15 to 17 digits one in ten has a digit less, whether it was cut there or not."""
ROWS_COMPARED_WITH_LAST = 1000
"""Number of rows with which the last row is compared."""
_NUMBER = re.compile(r"[-+]?[0-9]*(?P<point>[.,](?P<digits>[0-9]*))?(?P<exponent>[eE][-+]?[0-9]+)?")


def is_complete_cell(cells: Sequence[str]) -> bool:
    """Whether the last cell of a column, which ends the file without a newline, is as complete as the others.

    Args:
        cells: last cells of the column, as written; the last of them is checked.
    """
    *others, last = (cell.strip() for cell in cells[-ROWS_COMPARED_WITH_LAST - 1 :])
    found = _NUMBER.fullmatch(last)
    if found is None or not any(map(str.isdigit, last)):
        return last in others  # a word, or the empty cell of a missing sample
    numbers = [match for match in map(_NUMBER.fullmatch, others) if match is not None and match[0]]
    if not numbers:
        return False
    exponents = {len(match["exponent"]) for match in numbers if match["exponent"]}
    if exponents or found["exponent"]:
        return exponents == {len(found["exponent"] or "")}
    values = [float(match[0].replace(",", ".")) for match in (*numbers, found)]
    steps = sorted(abs(b - a) for a, b in pairwise(values[:-1]))
    if not any(match["point"] for match in (*numbers, found)):  # a cut divides an integer by ten
        return abs(values[-1] - values[-2]) <= max(steps, default=0.0)
    behind = [len(match["digits"] or "") for match in (*numbers, found)]
    # Either all have as many digits after the point, or all have as many significant digits.
    counts = [behind, [len(m[0].replace(",", ".").lstrip("+-0.").replace(".", "")) for m in (*numbers, found)]]
    *before, digits = counts[0 if len(set(behind[:-1])) == 1 else 1]
    return digits >= max(before) or (
        bool(steps) and 10.0 ** -behind[-1] <= MAX_CUT_ERROR_SHARE_OF_ROW_STEP * steps[len(steps) // 2]
    )


def cut_off_message(row: int, cell: str, column: str) -> str:
    """Message about a file that ends in the middle of a row, or may do so."""
    return (
        f"row {row}, column '{printable_excerpt(column)}': "
        f"the file ends at '{printable_excerpt(cell.strip(), 40)}' without a newline, and may "
        "be cut off in the middle of a number: copy it again; if that is its whole last row, end it in a newline "
        "(echo >> FILE)"
    )
