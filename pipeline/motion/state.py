"""Where the tool is on its line, and how it moves there."""

from __future__ import annotations

import math
from typing import NamedTuple


class LineState(NamedTuple):
    """State of the tool on the line.

    Attributes:
        s: position along the line [m].
        v: speed along the line [m/s].
        a: acceleration along the line [m/s^2].
    """

    s: float
    v: float = 0.0
    a: float = 0.0

    @property
    def is_finite(self) -> bool:
        """Whether all three numbers are finite."""
        return math.isfinite(self.s) and math.isfinite(self.v) and math.isfinite(self.a)
