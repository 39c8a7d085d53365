"""A user's own effect in ten lines: a magnet under the table that pulls the load when it is near the middle."""

import casadi as ca

from armdyn.effects.effect import effect
from armdyn.parameter import quantity


@effect("magnet", acts_on="load", summary="A magnet below the middle of the line.", source="a dipole near its axis")
def magnet(load, strength=quantity("N", typical=0.02, lower=0.0, summary="pull when the load is above it")):
    distance = load.position[0] / 0.05
    return load.with_force(ca.vertcat(-strength * distance, 0, -strength) / (1 + distance**2) ** 2)
