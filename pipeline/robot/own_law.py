"""Effects of a user's own in the simulated robot: an effect on string or load from a file, ``FILE.py:NAME``."""

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

LAW_OUTPUT_SIZES = {"force": 3, "torque": 1, "dry": 1}
"""Quantities that a user's law may add, with their sizes: force on the load, torque and dry friction at the pivot."""


class LoadState(NamedTuple):
    """State of the load at one instant, in the frame of the gripper's line: x along the line, y across, z up.

    Attributes:
        time: time since the simulation began [s].
        mass: mass of the load [kg].
        length: distance from pivot to load [m].
        angle: swing angle, 0 for a hanging load; for a positive angle the load is at negative x [rad].
        rate: rate of the swing angle [rad/s].
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


class LoadLawForces(NamedTuple):
    """Forces of a user's law: on the load (3,) [N] in the line's frame, torque and dry friction at the pivot [N m]."""

    force: Vector
    torque: float
    dry: float


def read_own_law(name: str) -> tuple[Effect, Callable[[float, LoadState], LoadLawForces]]:
    """Read a user's effect for the simulated robot.

    Args:
        name: file and effect, ``FILE.py:NAME``.

    Returns:
        The effect, and a function from the value of its first parameter and the load's state to the added forces; its
        other parameters keep their null values, at which they change nothing.

    Raises:
        InputError: the file cannot be used, it has no such effect, or the effect changes more than forces on string or
            load.
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


def _compiled(name: str, effect: Effect) -> Callable[[float, LoadState], LoadLawForces]:
    value = ca.SX.sym("value")
    time, mass, length, angle, rate = scalars = [ca.SX.sym(field) for field in LoadState._fields[:5]]
    position, velocity = ca.SX.sym("position", 3), ca.SX.sym("velocity", 3)
    stages = {
        "string": String(time, angle, rate, mass, length, STANDARD_GRAVITY),
        "load": Load(time, mass, position, velocity, angle, rate),
    }
    given = stages[effect.acts_on]
    size, *others = effect.parameters()
    changed = effect.apply(given, {size.name: value, **{p.name: p.value for p in others}})
    for field in fields(given):
        if field.name not in LAW_OUTPUT_SIZES and getattr(changed, field.name) is not getattr(given, field.name):
            quantity = field.name.replace("_", " ")
            raise InputError(
                f"hidden effect '{name}' changes the {quantity} of the {effect.acts_on}: the simulated robot takes "
                "forces, torques and dry friction without a state of their own"
            )
    parts = [getattr(changed, what, ca.SX.zeros(rows)) for what, rows in LAW_OUTPUT_SIZES.items()]
    law = ca.Function("law", [value, *scalars, position, velocity], [ca.densify(ca.vertcat(*parts))])

    def added(size: float, swing: LoadState) -> LoadLawForces:
        *force, torque, dry = law(size, *swing).full().ravel().tolist()
        return LoadLawForces(np.array(force), torque, dry)

    return added
