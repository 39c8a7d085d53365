r"""The fastest speed along a path under limits that are linear in its acceleration and its squared speed.

On a path q(s) every limit of speed, acceleration and torque is a row a u + b x <= c in u = s'' and x = s'^2 (Bobrow,
Dubowsky & Gibson, Int. J. Robotics Research 4, 1985). Between two nodes u is constant: x_next = x + 2 (s_next - s) u.
Backwards from the end, the set of x from which the end can be reached is an interval at each node; forwards, the
largest u that stays within them gives the fastest speed (Pham & Pham, A New Approach to Time-Optimal Path
Parameterization based on Reachability Analysis, IEEE Trans. Robotics 34, 2018). Rows hold at both ends of an interval.
"""

from dataclasses import dataclass

import numpy as np

from urdf.robot import Array

ROUNDING = 1e-12
"""Size of a coefficient, as a share of the largest of its row, or of a step in x, below which it is zero."""
UNLIMITED = 1e9
"""Squared speed that stands for no limit."""
NEWTON_STEPS = 60
"""Most steps to the end of a set; each takes the next of its lines, and three or four are usual."""


@dataclass(frozen=True)
class PathSpeed:
    """Speed along a path.

    Attributes:
        s: nodes, (n,).
        x: squared speeds at the nodes, (n,).
        u: accelerations between them, (n - 1,).
    """

    s: Array
    x: Array
    u: Array


class NoSpeedError(Exception):
    """No speed is feasible at a node.

    Attributes:
        node: index of the node.
    """

    def __init__(self, node: int) -> None:
        self.node = node


def fastest_speed(s: Array, rows: tuple[Array, Array, Array], largest: Array, given: Array | None = None) -> PathSpeed:
    """The fastest speed.

    Args:
        s: increasing nodes, (n,).
        rows: a, b and c of the rows a u + b x <= c at each node, (n, m) each.
        largest: largest squared speed at each node, (n,).
        given: squared speeds, (n,), nan where none is given; those at the ends are. Without them both ends are at rest.

    Raises:
        NoSpeedError: no speed keeps the limits.
    """
    if given is None:
        given = np.where((s == s[0]) | (s == s[-1]), 0.0, np.nan)
    step = np.diff(s)
    a, b, c = rows
    here = [part[:-1] for part in rows]
    there = a[1:] + 2.0 * step[:, None] * b[1:], b[1:], c[1:]
    upper, lower, most = _lines(*(np.hstack([one, other]) for one, other in zip(here, there, strict=True)))
    most = np.minimum(np.minimum(most, largest[:-1]), UNLIMITED)
    low, high, reach = np.full(len(s), given[-1]), np.full(len(s), given[-1]), 0.5 / step
    # The last lines of a node lead to the ends of the next one's interval.
    upper[1][:, -1] = lower[1][:, -1] = -reach
    above, below = upper[0][:, :-1].min(axis=1), lower[0][:, :-1].max(axis=1)
    for i in range(len(step) - 1, -1, -1):
        upper[0][i, -1], lower[0][i, -1] = high[i + 1] * reach[i], low[i + 1] * reach[i]
        up, down = (upper[0][i], upper[1][i]), (lower[0][i], lower[1][i])
        rests = min(above[i], upper[0][i, -1]) >= max(below[i], lower[0][i, -1])
        first = 0.0 if rests else _end(up, down, 0.0, upwards=True)
        last = _end(up, down, float(most[i]), upwards=False)
        if not first <= last:
            raise NoSpeedError(i)
        if not np.isnan(given[i]):
            near = ROUNDING * max(given[i], 1.0)
            if not first - near <= given[i] <= last + near:
                raise NoSpeedError(i)
            first = last = float(given[i])
        low[i], high[i] = first, last
    x, u = np.full(len(s), given[0]), np.zeros(len(step))
    for i in range(len(step)):
        fastest = float((upper[0][i] + upper[1][i] * x[i]).min())
        x[i + 1] = min(max(x[i] + 2.0 * step[i] * fastest, low[i + 1]), high[i + 1])
        u[i] = (x[i + 1] - x[i]) / (2.0 * step[i])
    return PathSpeed(s, x, u)


def _lines(a: Array, b: Array, c: Array) -> tuple[tuple[Array, Array], tuple[Array, Array], Array]:
    """Rows as lines p + r x above and below u, (n, m + 1) each, and the largest x of rows without u, (n,).

    The last line is left to be filled in.
    """
    size = np.maximum(np.abs(a), np.abs(b)) * ROUNDING
    with np.errstate(divide="ignore", invalid="ignore"):
        p, r, alone = c / a, -b / a, c / b
    above, below, bound = a > size, a < -size, (np.abs(a) <= size) & (b > 0.0)
    most = np.where(bound, alone, np.inf).min(axis=1)
    lines = (np.where(above, p, np.inf), np.where(above, r, 0.0), np.where(below, p, -np.inf), np.where(below, r, 0.0))
    p, r, q, t = (np.pad(part, [(0, 0), (0, 1)]) for part in lines)
    return (p, r), (q, t), most


def _end(up: tuple[Array, Array], down: tuple[Array, Array], x: float, *, upwards: bool) -> float:
    """Nearest x in a direction at which some u lies between the lines `down` and `up`; nan if there is none.

    What is left between the lines is concave in x, so a root of its present line never lies beyond the end.
    """
    for _ in range(NEWTON_STEPS):
        above, below = up[0] + up[1] * x, down[0] + down[1] * x
        i, j = int(above.argmin()), int(below.argmax())
        room, slope = float(above[i] - below[j]), float(up[1][i] - down[1][j])
        if room >= 0.0:
            return x
        if not (slope > 0.0 if upwards else slope < 0.0):
            return np.nan
        step = -room / slope
        if abs(step) <= ROUNDING * max(x, 1.0):
            return max(x + step, 0.0)
        x += step
        if x < 0.0:
            return 0.0 if x > -ROUNDING else np.nan
    return np.nan
