"""Effects that can be hidden in the simulated robot, each registered by its name in the catalogue, with what it adds.

None of it shares code with the models under test, a law of a user's file (`own_law`) apart. An effect that adds to a
force, a friction or a reading is one function here. One that changes how the plant is built or driven is declared in
`BUILT_IN`; `scene`, `forces`, `devices` and `simulated` ask for its value. A value is zero where its effect is absent.
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
from pipeline.robot.own_law import read_own_law
from pipeline.robot.protocol import Vector


class Stage(Enum):
    """Place in the simulation where an effect adds something; the value says what it adds, and from which inputs."""

    LOAD = "force on the load (3,) [N], from its velocity (3,) [m/s]"
    PLACE = "force on the load along the line [N], from its position along the line [m]"
    PIVOT = "resistance to the swing [N m s/rad], from its rate [rad/s] and the rate that 1 N m reverses in a step"
    JOINTS = "dry friction (n,) [N m], from the share of effort, velocity and gravity torque of every joint (n,)"
    FORCE = "what the load cell shows more [N], from the force [N] and the time [s]"
    OWN = "force on the load, torque and dry friction at the pivot (`own_law.Added`), from the swing (`own_law.Swing`)"
    EFFORT = "what is measured of efforts more (n,) [N m], from the torques of the motors (n,) [N m]"
    BUILT_IN = "nothing at a step: the plant is built or driven otherwise"


@dataclass(frozen=True)
class HiddenEffect:
    """One effect that the plant can have.

    Attributes:
        unit: unit of its value.
        typical: value that it has when none is given.
        summary: one sentence.
        lower: smallest value that makes sense.
        upper: largest value that the 1 ms integration stays accurate for.
        stage: place where it adds something.
        term: function that gives the added quantity from the effect's value and the stage's inputs.
    """

    unit: str
    typical: float
    summary: str
    lower: float = 0.0
    upper: float = math.inf
    stage: Stage = Stage.BUILT_IN
    term: Callable[..., Any] | None = None


_BOTH = -math.inf

BUILT_IN: Mapping[str, HiddenEffect] = MappingProxyType({
    "gripper_lag": HiddenEffect(
        "s", 0.02, "The gripper trails what the encoders report, as a first-order lag.", 0.0, 0.2),
    "path_tilt": HiddenEffect(
        "rad", 0.01, "The robot stands tilted: gravity has a component along the line, towards + for > 0.", -0.5, 0.5),
    "string_elasticity": HiddenEffect(
        "m/N", 2e-3, "The string stretches in proportion to its tension (replaces the nearly rigid one).", 1e-4, 0.05),
    "string_creep": HiddenEffect("m/s", 5e-5, "The string grows longer at a constant rate.", -0.01, 0.01),
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
})  # fmt: skip

HIDDEN_EFFECTS: dict[str, HiddenEffect] = dict(BUILT_IN)
"""All that there are, by name."""
_OWN: dict[str, HiddenEffect] = {}
"""Laws of users' files by ``FILE.py:NAME``, as they were read last."""

Term = Callable[..., Any]


def hidden_effect(
    stage: Stage, unit: str, typical: float, lower: float = 0.0, upper: float = math.inf
) -> Callable[[Term], Term]:
    """Register a function of the value, and of what the stage gives, under its own name; its docstring is the summary.

    The other arguments are the fields of `HiddenEffect`.
    """

    def register(term: Term) -> Term:
        HIDDEN_EFFECTS[term.__name__] = HiddenEffect(
            unit, typical, (term.__doc__ or "").strip(), lower, upper, stage, term
        )
        return term

    return register


def terms(hidden: Mapping[str, float], stage: Stage) -> tuple[Callable[..., Any], ...]:
    """Functions that give what the present effects add at a stage."""
    there = ((HIDDEN_EFFECTS.get(name) or _OWN[name], value) for name, value in hidden.items() if value != 0.0)
    return tuple(partial(e.term, value) for e, value in there if e.term is not None and e.stage is stage)


STANDSTILL_RATE = 1e-3
"""Swing rate within which dry friction at the pivot grows to its full value [rad/s]."""
STRIBECK_SPEED = 0.1
"""Joint speed over which the excess friction of standstill fades [rad/s]."""


@hidden_effect(Stage.LOAD, "N s/m", 5e-3, upper=5.0)
def linear_drag(value: float, velocity: Vector) -> Vector:
    """Air drag proportional to the load's speed."""
    return -value * velocity


@hidden_effect(Stage.LOAD, "N s^2/m^2", 3e-3, upper=5.0)
def quadratic_drag(value: float, velocity: Vector) -> Vector:
    """Air drag growing with the square of the load's speed."""
    return -(value * math.sqrt(velocity @ velocity)) * velocity


MAGNET_PLACE, MAGNET_DEPTH = 0.1, 0.04
"""Of the magnet under the track: along the line, and below the load [m]."""


@hidden_effect(Stage.PLACE, "N", 0.1, lower=-1.0, upper=1.0)
def magnet(value: float, along: float) -> float:
    """A magnet under the track, 0.1 m along the line, pulls the load to itself: the part along the line of a dipole."""
    away = (along - MAGNET_PLACE) / MAGNET_DEPTH
    return -value * away / (1.0 + away**2) ** 2.5


@hidden_effect(Stage.PIVOT, "N m s/rad", 1e-3, upper=0.5)
def pivot_viscous_friction(value: float, _rate: float, _reversal: float) -> float:
    """A torque at the string's upper end, proportional to the swing rate."""
    return value


@hidden_effect(Stage.PIVOT, "N m", 1e-3, upper=0.5)
def pivot_coulomb_friction(value: float, rate: float, reversal: float) -> float:
    """A torque of constant size at the string's upper end, against the swing."""
    # A regularised sign is stable where friction cannot reverse the motion within one step.
    standstill = max(STANDSTILL_RATE, 2.0 * value * reversal)
    return value * math.tanh(rate / standstill) / rate if rate > 0.0 else 0.0


@hidden_effect(Stage.JOINTS, "N m", 1.0, upper=20.0)
def joint_stribeck_friction(value: float, share: Vector, velocity: Vector, _gravity: Vector) -> Vector:
    """More dry friction in every joint near standstill, fading as exp(-(v/0.1 rad/s)^2)."""
    return np.asarray(value * share * np.exp(-((velocity / STRIBECK_SPEED) ** 2)))


@hidden_effect(Stage.JOINTS, "N m", 1.0, upper=20.0)
def joint_asymmetric_friction(value: float, share: Vector, velocity: Vector, _gravity: Vector) -> Vector:
    """More dry friction in every joint while it turns positively."""
    return np.asarray(value * share * (velocity > 0.0))


@hidden_effect(Stage.JOINTS, "1", 0.05, upper=1.0)
def joint_load_friction(value: float, _share: Vector, _velocity: Vector, gravity: Vector) -> Vector:
    """Dry friction in every joint proportional to the gravity torque that it carries."""
    return np.asarray(value * np.abs(gravity))


@hidden_effect(Stage.FORCE, "N", 0.02, lower=_BOTH)
def sensor_bias(value: float, _force: float, _time: float) -> float:
    """A constant added to the force (on top of the drawn bias)."""
    return value


@hidden_effect(Stage.FORCE, "1", 0.03, lower=-0.9)
def sensor_gain(value: float, force: float, _time: float) -> float:
    """Relative error of the force's scale."""
    return value * force


@hidden_effect(Stage.FORCE, "N/s", 1e-3, lower=_BOTH)
def sensor_drift(value: float, _force: float, time: float) -> float:
    """The force's zero moves at a constant rate."""
    return value * time


@hidden_effect(Stage.FORCE, "1/N", 0.02, lower=_BOTH)
def sensor_nonlinearity(value: float, force: float, _time: float) -> float:
    """The reading curves: this times the force squared is added."""
    return value * force**2


@hidden_effect(Stage.EFFORT, "N m", 0.5, lower=_BOTH)
def torque_offset(value: float, torque: Vector) -> Vector:
    """A constant added to every measured effort."""
    return np.full_like(torque, value)


@hidden_effect(Stage.EFFORT, "1", 0.05, lower=-0.9)
def torque_gain(value: float, torque: Vector) -> Vector:
    """Relative error of the scale of every measured effort."""
    return value * torque


def resolve_hidden(hidden: Mapping[str, float | None]) -> Mapping[str, float]:
    """Value of every effect: typical where ``None`` was given, zero where the effect was not named.

    Names are those of `HIDDEN_EFFECTS`, or ``FILE.py:NAME`` of a user's effect; values are in the effect's unit.

    Returns:
        All names of `HIDDEN_EFFECTS`, and the user's that were given, with their value, read-only.

    Raises:
        UnknownNameError: a name that the plant does not have.
        InputError: a value that is not finite or outside the effect's range, or a file that cannot be used.
    """
    values = dict.fromkeys(HIDDEN_EFFECTS, 0.0)
    for name, value in hidden.items():
        if ".py:" in name:
            law, added = read_own_law(name)
            size = next(iter(law.quantities.values()))
            _OWN[name] = HiddenEffect(size.unit, size.typical, law.summary, size.lower, size.upper, Stage.OWN, added)
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
