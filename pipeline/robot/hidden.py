"""Physical effects that can be hidden in the simulated robot, by their names in the catalogue of effects.

They share no code with the models that are tested against the simulation; the only exception are laws of a user's file
(`own_law`). Effects that change the MuJoCo model or the control of the robot have no function here: `scene`, `plant`,
`devices` and `simulated` read their values, which are zero for an absent effect. Of the pendulum's catalogue only
effects of an angle sensor (`angle_*`) are left out: a trial has none.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum
from functools import partial
from types import MappingProxyType
from typing import Any

import numpy as np

from armdyn.errors import InputError, UnknownNameError
from armdyn.pendulum.physics import STANDARD_GRAVITY
from pipeline.robot.own_law import LoadLawForces, LoadState, read_own_law


class HiddenEffectStage(Enum):
    """Stage of a simulation step at which an effect adds a quantity; the value names this quantity and its inputs."""

    LOAD = "force on the load (3,) [N], from its velocity (3,) [m/s]"
    POSITION = "force on the load along the line [N], from its position along the line [m]"
    PIVOT = "resistance to the swing [N m s/rad], from its rate [rad/s] and the rate that 1 N m reverses in a step"
    JOINTS = "dry friction (n,) [N m], from the share of effort, velocity and gravity torque of every joint (n,)"
    FORCE = "error of the load cell [N], from the force [N] and the time [s]"
    OWN = "force on the load, torque and dry friction at the pivot (`LoadLawForces`), from its motion (`LoadState`)"
    EFFORT = "error of the measured efforts (n,) [N m], from the torques of the motors (n,) [N m]"
    BUILT_IN = "nothing at a step: the effect changes the MuJoCo model or the control"


@dataclass(frozen=True)
class HiddenEffect:
    """A physical effect that the simulated robot can have, with one number as its size.

    Attributes:
        unit: unit of the size.
        typical: default size.
        summary: one sentence.
        lower: smallest possible size.
        upper: largest size with which the integration in steps of 1 ms is accurate.
        stage: stage of the simulation at which the effect adds a quantity.
        term: function from the size and the stage's inputs to the added quantity; None for the stage `BUILT_IN`.
    """

    unit: str
    typical: float
    summary: str
    lower: float = 0.0
    upper: float = math.inf
    stage: HiddenEffectStage = HiddenEffectStage.BUILT_IN
    term: Callable[..., Any] | None = None


FULL_DRY_FRICTION_SWING_RATE = 1e-3
"""Rate of the swing angle below which the dry friction at the pivot is smaller than its full value [rad/s]."""
STRIBECK_SPEED = 0.1
"""Stribeck speed of the joints: the additional friction near standstill falls as exp(-(v / speed)²) [rad/s]."""
MAGNET_POSITION_ALONG_LINE, MAGNET_DEPTH_BELOW_LOAD = 0.1, 0.04
"""Position of the magnet along the gripper's line, and its depth below the load [m]."""


def magnet_force(value: float, along: float) -> float:
    """Force of a magnet (a dipole) on the load along the gripper's line [N].

    Args:
        value: strength of the magnet [N].
        along: coordinate of the load on the line [m].
    """
    away = (along - MAGNET_POSITION_ALONG_LINE) / MAGNET_DEPTH_BELOW_LOAD
    return -value * away / (1.0 + away**2) ** 2.5


def pivot_coulomb_friction(value: float, rate: float, reversal: float) -> float:
    """Resistance of dry friction at the pivot to the swing: friction torque over swing rate [N m s/rad].

    Args:
        value: size of the friction torque [N m].
        rate: rate of the swing angle, not negative [rad/s].
        reversal: change of the rate by a torque of 1 N m in one step of the simulation [rad/s].
    """
    # A regularised sign is stable where friction cannot reverse the motion within one step.
    standstill = max(FULL_DRY_FRICTION_SWING_RATE, 2.0 * value * reversal)
    return value * math.tanh(rate / standstill) / rate if rate > 0.0 else 0.0


def _pull_at_rest(state: LoadState) -> float:
    """Pull of the string for a gripper that stands still, not negative [N]."""
    return max(0.0, state.mass * (STANDARD_GRAVITY * math.cos(state.angle) + state.length * state.rate**2))


HIDDEN_EFFECTS: Mapping[str, HiddenEffect] = MappingProxyType({
    "gripper_lag": HiddenEffect(
        "s", 0.02, "The gripper trails what the encoders report, as a first-order lag.", 0.0, 0.2),
    "gripper_scale": HiddenEffect(
        "1", 0.03, "The gripper moves further along the line than the encoders say, by this share.", -0.5, 0.5),
    "gripper_bob": HiddenEffect(
        "1/m", 0.5, "The gripper rises by this times the square of its way from the line's middle.", -5.0, 5.0),
    "gripper_compliance": HiddenEffect(
        "m/N", 5e-3, "The string's upper end gives way along the line, by this times the string's pull along it.",
        0.0, 0.02),
    "path_tilt": HiddenEffect(
        "rad", 0.01, "The robot stands tilted: gravity has a component along the line, towards + for > 0.", -0.5, 0.5),
    "string_elasticity": HiddenEffect(
        "m/N", 2e-3, "The string stretches in proportion to its tension (replaces the nearly rigid one).", 1e-4, 0.05),
    "string_creep": HiddenEffect("m/s", 5e-5, "The string grows longer at a constant rate.", -0.01, 0.01),
    "string_mass": HiddenEffect("kg", 5e-3, "The string is a uniform rod of this mass.", 0.0, 1.0),
    "wind": HiddenEffect("N", 5e-3, "A constant horizontal force on the load, along the line.", -1.0, 1.0),
    "load_inertia": HiddenEffect(
        "kg m^2", 2e-4, "The load turns with the string and has this moment of inertia about its centre.", 0.0, 0.1),
    "out_of_plane_swing": HiddenEffect(
        "rad", 0.05, "The load starts displaced across the line by this angle.", -1.0, 1.0),
    "sensor_lag": HiddenEffect("s", 0.02, "The cell follows the force as a first-order lag.", 0.0, 1.0),
    "sensor_delay": HiddenEffect("s", 0.02, "The force arrives late (on top of the drawn latency).", 0.0, 1.0),
    "vertical_sensing_axis": HiddenEffect(
        "1", 1.0, "The cell measures the vertical part of the string's pull; between 0 and 1 a mixture.", 0.0, 1.0),
    "cross_axis_sensitivity": HiddenEffect(
        "1", 0.02, "The cell also feels this share of the string's pull along the line, T sin(angle).", -1.0, 1.0),
    # joint; the effort limit scales the value, so that Baxter's wrist has 0.3 of the shoulder's
    "joint_viscous_friction": HiddenEffect("N m s/rad", 3.0, "More viscous friction in every joint.", 0.0, 50.0),
    "joint_coulomb_friction": HiddenEffect("N m", 1.0, "More dry friction in every joint.", 0.0, 20.0),
    "rotor_inertia": HiddenEffect(
        "kg m^2", 0.1, "More rotor inertia in every joint, as seen behind the gears.", 0.0, 10.0),
    "gravity_spring": HiddenEffect(
        "1", 1.0, "Baxter's gravity springs on s1, as a share of the real ones: 8.2 sin q + 35.3 cos q N m.", 0.0, 2.0),
    "payload": HiddenEffect("kg", 0.5, "A mass at the gripper's frame that the arm's model does not know.", 0.0, 5.0),
    "link_inertia": HiddenEffect("1", 0.1, "Mass and inertia of every arm link are larger by this share.", -0.9, 5.0),
    "linear_drag": HiddenEffect(
        "N s/m", 5e-3, "Air drag proportional to the load's speed.", 0.0, 5.0,
        HiddenEffectStage.LOAD, lambda c, v: -c * v),
    "quadratic_drag": HiddenEffect(
        "N s^2/m^2", 3e-3, "Air drag growing with the square of the load's speed.", 0.0, 5.0,
        HiddenEffectStage.LOAD, lambda c, v: -(c * math.sqrt(v @ v)) * v),
    "magnet": HiddenEffect(
        "N", 0.1, "A magnet under the track, 0.1 m along the line, pulls the load to itself: the part along the line "
        "of a dipole.", -1.0, 1.0, HiddenEffectStage.POSITION, magnet_force),
    "pivot_viscous_friction": HiddenEffect(
        "N m s/rad", 1e-3, "A torque at the string's upper end, proportional to the swing rate.", 0.0, 0.5,
        HiddenEffectStage.PIVOT, lambda c, _rate, _reversal: c),
    "pivot_coulomb_friction": HiddenEffect(
        "N m", 1e-3, "A torque of constant size at the string's upper end, against the swing.", 0.0, 0.5,
        HiddenEffectStage.PIVOT, pivot_coulomb_friction),
    "pivot_load_friction": HiddenEffect(
        "m", 1e-3, "Dry friction at the string's upper end, this times the string's pull, against the swing.", 0.0, 0.1,
        HiddenEffectStage.OWN, lambda r, s: LoadLawForces(np.zeros(3), 0.0, r * _pull_at_rest(s))),
    "pivot_stiffness": HiddenEffect(
        "N m/rad", 0.01, "A torque at the string's upper end back to the vertical, in proportion to the angle.", 0.0,
        1.0, HiddenEffectStage.OWN, lambda k, s: LoadLawForces(np.zeros(3), -k * s.angle, 0.0)),
    "joint_stribeck_friction": HiddenEffect(
        "N m", 1.0, "More dry friction in every joint near standstill, fading as exp(-(v/0.1 rad/s)^2).", 0.0, 20.0,
        HiddenEffectStage.JOINTS, lambda c, share, v, _gravity: c * share * np.exp(-((v / STRIBECK_SPEED) ** 2))),
    "joint_asymmetric_friction": HiddenEffect(
        "N m", 1.0, "More dry friction in every joint while it turns positively.", 0.0, 20.0,
        HiddenEffectStage.JOINTS, lambda c, share, v, _gravity: c * share * (v > 0.0)),
    "joint_load_friction": HiddenEffect(
        "1", 0.05, "Dry friction in every joint proportional to the gravity torque that it carries.", 0.0, 1.0,
        HiddenEffectStage.JOINTS, lambda c, _share, _v, gravity: c * np.abs(gravity)),
    "sensor_bias": HiddenEffect(
        "N", 0.02, "A constant added to the force (on top of the drawn bias).", -math.inf, math.inf,
        HiddenEffectStage.FORCE, lambda c, _force, _time: c),
    "sensor_gain": HiddenEffect(
        "1", 0.03, "Relative error of the force's scale.", -0.9, math.inf,
        HiddenEffectStage.FORCE, lambda c, force, _time: c * force),
    "sensor_drift": HiddenEffect(
        "N/s", 1e-3, "The force's zero moves at a constant rate.", -math.inf, math.inf,
        HiddenEffectStage.FORCE, lambda c, _force, time: c * time),
    "sensor_nonlinearity": HiddenEffect(
        "1/N", 0.02, "The reading curves: this times the force squared is added.", -math.inf, math.inf,
        HiddenEffectStage.FORCE, lambda c, force, _time: c * force**2),
    "torque_offset": HiddenEffect(
        "N m", 0.5, "A constant added to every measured effort.", -math.inf, math.inf,
        HiddenEffectStage.EFFORT, lambda c, torque: np.full_like(torque, c)),
    "torque_gain": HiddenEffect(
        "1", 0.05, "Relative error of the scale of every measured effort.", -0.9, math.inf,
        HiddenEffectStage.EFFORT, lambda c, torque: c * torque),
})  # fmt: skip
"""Every effect that the simulated robot can have, by name, apart from laws of a user's own."""
_OWN: dict[str, HiddenEffect] = {}
"""Laws of users' files that were read, by ``FILE.py:NAME``."""


def hidden_effect_terms(hidden: Mapping[str, float], stage: HiddenEffectStage) -> tuple[Callable[..., Any], ...]:
    """Functions of the present effects that add a quantity at a stage, from the stage's inputs.

    Args:
        hidden: size of every effect, zero for an absent one.
        stage: stage of the simulation.
    """
    there = ((HIDDEN_EFFECTS.get(name) or _OWN[name], value) for name, value in hidden.items() if value != 0.0)
    return tuple(partial(e.term, value) for e, value in there if e.term is not None and e.stage is stage)


def resolve_hidden(hidden: Mapping[str, float | None]) -> Mapping[str, float]:
    """Size of every effect of the simulated robot: zero for an effect that was not named.

    Args:
        hidden: size of each present effect in its unit, or None for its typical size, by its name in `HIDDEN_EFFECTS`
            or by ``FILE.py:NAME`` of a user's effect.

    Returns:
        Read-only sizes of all `HIDDEN_EFFECTS` and of the named user's effects.

    Raises:
        UnknownNameError: the simulated robot has no effect of this name.
        InputError: a size is not finite or outside the effect's range, or a file cannot be used.
    """
    values = dict.fromkeys(HIDDEN_EFFECTS, 0.0)
    for name, value in hidden.items():
        if ".py:" in name:
            law, added = read_own_law(name)
            size = next(iter(law.quantities.values()))
            _OWN[name] = HiddenEffect(
                size.unit, size.typical, law.summary, size.lower, size.upper, HiddenEffectStage.OWN, added
            )
        elif name not in HIDDEN_EFFECTS:
            raise UnknownNameError("hidden effect", name, HIDDEN_EFFECTS)
        effect = HIDDEN_EFFECTS.get(name) or _OWN[name]
        number = effect.typical if value is None else float(value)
        if number != 0.0 and not (math.isfinite(number) and effect.lower <= number <= effect.upper):
            raise InputError(
                f"hidden effect '{name}' is {number:g} {effect.unit}: give 0 or a value from {effect.lower:g} to "
                f"{effect.upper:g} (typical {effect.typical:g})"
            )
        values[name] = number
    return MappingProxyType(values)
