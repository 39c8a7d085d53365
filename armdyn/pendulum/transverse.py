r"""The swing of a load across the gripper's line, described by its second moments.

With y the load's displacement across the line, Y = y^2, Z = y y', W = y'^2 obey

    Y' = 2 Z,      Z' = W - kappa Y,      W' = -2 kappa Z,      kappa = N / (m rho),

where rho = sqrt(l^2 - Y) is the string seen along y and N its pull in the plane of the line. Y, Z, W start at given
values; they enter rho and the tension exactly, and unlike y itself they have a slope at zero, so that a small swing
across shows in a score test.

    N = (N0 + m W/rho + m Z^2/rho^3) / (1 + Y/rho^2),      T = N l/rho,      N0 = N without rho''.

(Landau & Lifshitz, Mechanics, 3rd ed., §14, for the spherical pendulum.)
"""

from typing import NamedTuple

import casadi as ca

from armdyn.pendulum.physics import Expression

TRANSVERSE_MOMENTS = 3
"""Number of second moments Y, Z, W that describe the swing of a load across the gripper's line."""


class StringShortening(NamedTuple):
    """Apparent stretch of the string in the plane of the line, m, and its rate, m/s; negative for a swing across."""

    stretch: Expression
    stretch_rate: Expression


def string_shortening(moments: Expression, length: Expression) -> StringShortening:
    """Shortening of the string in the plane of the line by the moments (Y, Z, W) of the swing across it."""
    square, product, _ = ca.vertsplit(moments)
    visible = ca.sqrt(length**2 - square)
    return StringShortening(-square / (length + visible), -product / visible)


def moment_rates_and_tension(
    moments: Expression, in_plane: Expression, mass: Expression, length: Expression
) -> tuple[Expression, Expression]:
    """(3,) time derivatives of the moments (Y, Z, W), and the tension T, N, from the pull N0, N, in the plane."""
    square, product, square_rate = ca.vertsplit(moments)
    visible = length + string_shortening(moments, length).stretch
    pull = (in_plane + mass * square_rate / visible + mass * product**2 / visible**3) / (1 + square / visible**2)
    stiffness = pull / (mass * visible)
    rates = ca.vertcat(2 * product, square_rate - stiffness * square, -2 * stiffness * product)
    return rates, pull * (length / visible)
