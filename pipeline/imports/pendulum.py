"""Columns of a load on a string, a pendulum or a crane: motion of the pivot, swing, tension of the string.

A video's tracker writes the load's place in the picture, x and y; the swing angle is that of the line from the pivot to
the load, and the pivot is the centre of the circle on which the load moves.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares

from armdyn.errors import InputError
from armdyn.recording.channels import MIN_COMPARED_CHANNEL_SAMPLES, FloatArray
from pipeline.imports.claims import Claim
from pipeline.imports.foreign import ForeignColumn
from pipeline.imports.joints import JointRange, RobotJoints
from pipeline.imports.mapping import ColumnEntry
from pipeline.imports.words import COMMAND_WORDS, ColumnHeaderParts, is_unit_like, word_set

FORCE_WORDS = word_set("force tension loadcell load kraft weight hx711")
WEIGHT_UNITS = {"g": "gram_force", "gram": "gram_force", "grams": "gram_force", "kg": "kilogram_force"}
"""Units of force in which a scale's reading in grams is written, by the word in a header."""
PIVOT_WORDS = word_set("gripper cart pivot trolley carriage slider hand")
SWING_WORDS = word_set("swing phi pendulum pend pole theta th angle ang alpha bob winkel encoder")
RATE_WORDS = word_set("gyro gyroscope omega phidot thetadot dtheta")
HEIGHT_WORDS = word_set("z height")
"""Words of a column's header that name a part or a quantity of a pendulum."""
PENDULUM_CHANNELS = {
    ("q", "swing"): "swing_angle", ("v", "swing"): "swing_rate",
    ("q", "gripper"): "gripper_x", ("v", "gripper"): "gripper_v", ("a", "gripper"): "gripper_a",
    ("q", "height"): "gripper_z", ("force", "load"): "load_force",
}  # fmt: skip
"""Channels of a pendulum's recording, by quantity and part of the pendulum."""
PENDULUM_PARTS = RobotJoints(ranges={part: JointRange(True, np.inf, np.inf) for part in ("gripper", "height")})
"""Moving parts of a pendulum in the form of prismatic joints with unknown ranges."""


def pendulum_claims(labels: Mapping[str, ColumnHeaderParts]) -> list[Claim]:
    """Possible meanings of columns in the recording of a pendulum, from their parsed headers."""
    swings = any(set(label.words) & SWING_WORDS for label in labels.values())
    plane = any("y" in label.words for label in labels.values())  # x beside y is the load's place in a picture
    claims = []
    for column, label in labels.items():
        part = "" if COMMAND_WORDS & set(label.words) else _part(label, swings and not plane)
        quantity = "force" if part == "load" else "v" if set(label.words) & RATE_WORDS else label.quantity
        quantity = quantity if quantity in ("v", "a", "force") else "q"
        if channel := PENDULUM_CHANNELS.get((quantity, part)):
            doubts = (label.doubt,) if label.doubt else ()
            weights = [WEIGHT_UNITS[word] for word in label.words if word in WEIGHT_UNITS]
            if quantity == "force" and not label.unit and weights:
                label = replace(label, unit=weights[-1])
            claims.append(Claim(column, channel, part, replace(label, quantity=quantity), doubts))
    return claims


def _part(label: ColumnHeaderParts, swings: bool) -> str:
    words, quantity = set(label.words), label.quantity
    if words & RATE_WORDS:
        return "swing"
    if words & FORCE_WORDS and quantity in ("", "force", "tau"):
        return "load"
    if words & PIVOT_WORDS:
        return "height" if words & HEIGHT_WORDS and quantity in ("", "q") else "gripper"
    if words & SWING_WORDS or (quantity and label.unit and is_unit_like(label.unit, "rad", "rad/s")):
        return "swing"
    return "gripper" if swings and ("x" in words or (quantity in ("q", "v") and len(label.words) == 1)) else ""


MAX_CERTAIN_RADIUS_SHARE, MAX_CERTAIN_MISFIT_SHARE = 0.03, 0.02
"""Standard deviation of a circle's radius, and distance of the points from it, beyond which a guess asks for the pivot,
as shares of the radius: the angle's error is the first, and the second shows a pivot that moves or a camera's slant."""


@dataclass(frozen=True)
class LoadCircle:
    """Circle on which a load moves in a picture, in the unit of its coordinates.

    Attributes:
        pivot: coordinates of the centre (2,).
        radius: distance of the load from the pivot.
        radius_std: standard deviation of the radius, if the points' errors are independent.
        misfit: root mean square distance of the points from the circle.
    """

    pivot: tuple[float, float]
    radius: float
    radius_std: float
    misfit: float

    @property
    def doubt(self) -> str:
        """Open question on the pivot; empty where the points determine it."""
        if self.misfit > MAX_CERTAIN_MISFIT_SHARE * self.radius:
            off = f"the points lie {self.misfit:.3g} off a circle of radius {self.radius:.4g}"
            return f"{off}: does the pivot stand still?"
        if self.radius_std > MAX_CERTAIN_RADIUS_SHARE * self.radius:
            return f"the arc is short, the radius {self.radius:.4g} +/- {self.radius_std:.2g}: where is the pivot?"
        return ""


def fit_circle(x: FloatArray, y: FloatArray) -> LoadCircle:
    """Circle through points (n,), (n,) by least squares of their distances, from an algebraic fit.

    I. Kasa, "A circle fitting procedure and its error analysis", IEEE Trans. Instrum. Meas. 25, 1976.

    Raises:
        InputError: there are too few points, or they are all the same.
    """
    there = np.isfinite(x) & np.isfinite(y)
    points = np.column_stack([x, y])[there]
    size = float(np.ptp(points, axis=0).max()) if len(points) else 0.0
    if len(points) < MIN_COMPARED_CHANNEL_SAMPLES or not 0.0 < size < np.inf:
        raise InputError('its points lie on no circle: give the pivot, as pivot = "X Y" in their unit')
    middle = points.mean(axis=0)
    scaled = (points - middle) / size
    columns = np.column_stack([2.0 * scaled, np.ones(len(points))])
    kasa = np.linalg.lstsq(columns, (scaled**2).sum(axis=1), rcond=None)[0]
    start = np.array([kasa[0], kasa[1], np.sqrt(kasa[2] + kasa[:2] @ kasa[:2])])
    fit = least_squares(lambda c: np.hypot(*(scaled - c[:2]).T) - c[2], start, x_scale="jac")
    misfit = float(np.sqrt(np.mean(fit.fun**2)))
    radius_std = misfit * float(np.sqrt(np.linalg.pinv(fit.jac.T @ fit.jac)[2, 2]))
    across, along = size * fit.x[:2] + middle
    return LoadCircle((float(across), float(along)), size * float(fit.x[2]), size * radius_std, size * misfit)


def swing_of_points(x: FloatArray, y: FloatArray, pivot: tuple[float, float]) -> FloatArray:
    """Swing angles (n,) [rad] of points around a pivot, 0 hanging; down is the side where the load is fast.

    The load is at x = pivot - l sin(angle): the channel's sign.
    """
    right, across = x - pivot[0], y - pivot[1]
    speed_square = np.gradient(x) ** 2 + np.gradient(y) ** 2
    angle = np.arctan2(-right, across if np.nansum(across * speed_square) > 0.0 else -across)
    there = np.isfinite(angle)
    angle[there] = np.unwrap(angle[there])
    return angle


def tracked_entries(
    columns: Mapping[str, ForeignColumn], labels: Mapping[str, ColumnHeaderParts]
) -> dict[str, ColumnEntry]:
    """Mapping entry of a load's place in a picture, x and y, which becomes its swing; empty without such columns."""
    places = {
        axis: min((name for name, label in labels.items() if axis in label.words), key=len, default="") for axis in "xy"
    }
    if not all(places.values()):
        return {}
    circle = fit_circle(columns[places["x"]].value, columns[places["y"]].value)
    why = f"circle of radius {circle.radius:.4g} around {circle.pivot[0]:.5g}, {circle.pivot[1]:.5g}"
    entry = ColumnEntry("swing_angle", "rad", height=places["y"], pivot="fit", check=circle.doubt, why=why)
    return {places["x"]: entry}


def tracked_swing(x: FloatArray, y: FloatArray, pivot: str) -> tuple[FloatArray, str]:
    """Swing angles (n,) [rad] of tracked points, and a sentence on a fitted pivot; empty for a given one.

    Args:
        x: first coordinates (n,).
        y: second coordinates (n,), up or down.
        pivot: its two coordinates, or ``fit`` for the centre of the points' circle.

    Raises:
        InputError: `pivot` is neither, or there is no circle.
    """
    if pivot != "fit":
        try:
            across, along = (float(word) for word in pivot.replace(",", " ").split())
        except ValueError:
            raise InputError(f'pivot \'{pivot}\': write "fit", or its place "X Y" in the columns\' unit') from None
        return swing_of_points(x, y, (across, along)), ""
    circle = fit_circle(x, y)
    said = (
        f"the pivot is at {circle.pivot[0]:.5g}, {circle.pivot[1]:.5g}: the load moves on a circle of radius "
        f"{circle.radius:.4g} +/- {circle.radius_std:.2g}, its points are {circle.misfit:.2g} off it"
    )
    return swing_of_points(x, y, circle.pivot), f"{said}; {circle.doubt}" if circle.doubt else said
