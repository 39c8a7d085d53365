"""Whether a table that does not end in a newline may have been cut off in the middle of its last cell.

What is left of a number is a number, too: nobody can be sure. But a cut leaves a cell that is unlike the others of its
column: fewer digits, no exponent, a tenth of the value, half a word.
"""

import re
from collections.abc import Sequence
from itertools import pairwise

from urdf.bounds import shown

ORDINARY = 0.05
"""Share of the other cells that end as early as the last one, from which it is whole. Of numbers that are written with
all their digits, 15 to 17, one in ten ends a digit early; what a cut takes away then is of no size."""
LOOKED_AT = 1000
"""Rows before the last one with which it is compared."""
_NUMBER = re.compile(r"[-+]?[0-9]*(?P<point>[.,](?P<digits>[0-9]*))?(?P<exponent>[eE][-+]?[0-9]+)?")


def is_whole(cells: Sequence[str]) -> bool:
    """Whether the last cell of a column, which ends the file without a newline, is as whole as the others.

    Args:
        cells: the last ones of the column, as written; the last of them is the one in question.
    """
    *others, last = (cell.strip() for cell in cells[-LOOKED_AT - 1 :])
    found = _NUMBER.fullmatch(last)
    if found is None or not any(map(str.isdigit, last)):
        return last in others  # a word, or the empty cell of a missing sample
    numbers = [match for match in map(_NUMBER.fullmatch, others) if match is not None and match[0]]
    if not numbers:
        return False
    exponents = {len(match["exponent"]) for match in numbers if match["exponent"]}
    if found["exponent"]:
        return exponents == {len(found["exponent"])}
    if found["point"] is None and all(match["point"] is None for match in numbers):
        return _continues([float(match[0]) for match in numbers], float(last))
    early = [m for m in numbers if not m["exponent"] and len(m["digits"] or "") <= len(found["digits"] or "")]
    return len(early) >= max(1.0, ORDINARY * len(numbers))


def _continues(before: Sequence[float], last: float) -> bool:
    """Whether a whole number is no farther from the one before than they are from one another; a cut divides by ten."""
    steps = [abs(b - a) for a, b in pairwise(before)]
    return abs(last - before[-1]) <= max(steps, default=0.0)


def cut_off(row: int, cell: str, column: str) -> str:
    """What is said of a file that ends in the middle of a row, or may do so."""
    return (
        f"row {row}, column '{shown(column)}': the file ends at '{shown(cell.strip(), 40)}' without a newline, and may "
        "be cut off in the middle of a number: copy it again; if that is its whole last row, end it in a newline "
        "(echo >> FILE)"
    )
