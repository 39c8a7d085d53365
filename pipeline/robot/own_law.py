"""A user's law in the simulated robot: an effect on string or load from a user's file, ``FILE.py:NAME``."""

from collections.abc import Callable
from dataclasses import fields
from typing import NamedTuple

import casadi as ca
import numpy as np

from armdyn.effects.effect import Effect
from armdyn.effects.user import load_effects
from armdyn.errors import InputError, UnknownNameError, error_location
from armdyn.pendulum.physics import STANDARD_GRAVITY, Load, String
from pipeline.robot.protocol import Vector

FORCES = {"force": 3, "torque": 1, "dry": 1}
"""What a law may add to a stage, with its rows: a force on the load, a torque at the pivot, dry friction there."""


class Swing(NamedTuple):
    """Motion of the load in the frame of the line: x along the line, y across, z up.

    Attributes:
        time: time since the simulation began [s].
        mass: mass of the load [kg].
        length: from pivot to load [m].
        angle: 0 hanging; positive puts the load on the negative side [rad].
        rate: rate of the angle [rad/s].
        position: position of the load (3,) [m].
        velocity: velocity of the load (3,) [m/s].
    """

    time: float
    mass: float
    length: float
    angle: float
    rate: float
    position: Vector
    velocity: Vector


class Added(NamedTuple):
    """Result of a law: a force on the load (3,) [N] in the line's frame, a torque [N m], and dry friction [N m]."""

    force: Vector
    torque: float
    dry: float


def read_own_law(name: str) -> tuple[Effect, Callable[[float, Swing], Added]]:
    """The effect named by ``FILE.py:NAME``, and the function that gives what it adds to the simulation.

    That follows from the value of its first parameter and from the swing; other parameters are at their null values.

    Raises:
        InputError: the file cannot be used or has no such effect, or that changes something else than forces on string
            or load.
    """
    path, _, called = name.rpartition(":")
    own = {effect.name: effect for effect in load_effects(path)}
    with error_location(path):
        if called not in own:
            raise UnknownNameError("effect", called, own)
    effect = own[called]
    if effect.acts_on not in ("string", "load") or not effect.quantities:
        raise InputError(
            f"hidden effect '{name}' acts on '{effect.acts_on}': the simulated robot takes one with a parameter, "
            "on string or load"
        )
    return effect, _compiled(name, effect)


def _compiled(name: str, effect: Effect) -> Callable[[float, Swing], Added]:
    value = ca.SX.sym("value")
    time, mass, length, angle, rate = scalars = [ca.SX.sym(field) for field in Swing._fields[:5]]
    position, velocity = ca.SX.sym("position", 3), ca.SX.sym("velocity", 3)
    stages = {
        "string": String(time, angle, rate, mass, length, STANDARD_GRAVITY),
        "load": Load(time, mass, position, velocity, angle, rate),
    }
    given = stages[effect.acts_on]
    size, *others = effect.parameters()
    changed = effect.apply(given, {size.name: value, **{p.name: p.value for p in others}})
    for field in fields(given):
        if field.name not in FORCES and getattr(changed, field.name) is not getattr(given, field.name):
            raise InputError(
                f"hidden effect '{name}' changes the {field.name} of the {effect.acts_on}: the simulated robot takes "
                "forces, torques and dry friction without a state of their own"
            )
    parts = [getattr(changed, what, ca.SX.zeros(rows)) for what, rows in FORCES.items()]
    law = ca.Function("law", [value, *scalars, position, velocity], [ca.densify(ca.vertcat(*parts))])

    def added(size: float, swing: Swing) -> Added:
        *force, torque, dry = law(size, *swing).full().ravel().tolist()
        return Added(np.array(force), torque, dry)

    return added
