"""The unknowns of a fit to the motion of an arm: values of effects, gains and delays of drives."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from armdyn.arm.closed_loop.motion_model import MAX_DELAY_SECONDS, TYPICAL_DELAY_SECONDS, TYPICAL_GAIN_SHARE
from armdyn.arm.drives import Servo
from armdyn.arm.model import ArmModel
from armdyn.arm.slots import slots_of
from armdyn.recording.units import KnownQuantity

OF_EFFECTS = ("parameter", "input")
"""Kinds of unknowns that are parameters of effects."""


@dataclass(frozen=True)
class MotionUnknown:
    """One unknown of the fit: a parameter, or the gain or delay of a drive.

    Attributes:
        name: name of the parameter, or of the drive group for a gain or delay.
        of: ``"parameter"``, ``"input"`` for one that changes when something reaches a drive, ``"gain"`` or ``"delay"``.
        typical: typical size.
        lower: lower bound.
        upper: upper bound.
        prior: prior mean and standard deviation, in the unknown's own scale; the deviation is infinite without a prior.
    """

    name: str
    of: str
    typical: float
    lower: float
    upper: float
    prior: tuple[float, float]

    @property
    def acts_through_inputs(self) -> bool:
        """Whether it changes the inputs of the drives."""
        return self.of != "parameter"


def motion_unknowns(model: ArmModel, given: Mapping[str, Servo]) -> list[MotionUnknown]:
    """The unknowns of a fit: what an arm's model may fit, and what its drives as they are `given` leave open."""
    found = []
    held = model.background.names if model.background is not None else ()
    late = {effect.name for effect in model.effects if slots_of(effect).delays}
    for name, p in model.parameters.items():
        if p.effect == "torque_gain" or not (p.fitted or name in held):
            continue
        mean, spread = (0.0, np.inf) if p.prior is None else (p.prior.mean, p.prior.std)
        if name in held and model.background is not None:
            mean, spread = p.value, max(model.background.width, 1e-6) * p.typical
        found.append(
            MotionUnknown(
                name, "input" if p.effect in late else "parameter", p.typical, p.lower, p.upper, (mean, spread)
            )
        )
    for name, servo in model.drives.items():
        gain = given[name].gain
        known = (0.0, np.inf) if gain is None or gain.std is None else (np.log(gain.value), gain.std / gain.value)
        if servo.determined and (gain is None or gain.std is not None):
            found.append(MotionUnknown(name, "gain", TYPICAL_GAIN_SHARE, -np.inf, np.inf, known))
        if given[name].delay is None:
            free, largest = (0.0, np.inf), MAX_DELAY_SECONDS
            found.append(MotionUnknown(name, "delay", TYPICAL_DELAY_SECONDS, 0.0, largest, free))
    return found


def value_of_unknown(model: ArmModel, unknown: MotionUnknown) -> float:
    """The value that a model has of an unknown, in the unknown's own scale."""
    if unknown.of in OF_EFFECTS:
        return model.value(unknown.name)
    servo = model.drives[unknown.name]
    assert servo.gain is not None
    return float(np.log(servo.gain.value)) if unknown.of == "gain" else servo.delay or 0.0


def model_at(model: ArmModel, unknowns: Sequence[MotionUnknown], values: np.ndarray) -> ArmModel:
    """The model with (u,) values of u unknowns."""
    parameters, drives = {}, dict(model.drives)
    for unknown, value in zip(unknowns, values.tolist(), strict=True):
        if unknown.of in OF_EFFECTS:
            parameters[unknown.name] = replace(model.parameters[unknown.name], value=value)
        elif unknown.of == "delay":
            drives[unknown.name] = replace(drives[unknown.name], delay=value)
        else:
            gain = drives[unknown.name].gain
            assert gain is not None
            drives[unknown.name] = replace(drives[unknown.name], gain=_agreed(gain, float(np.exp(value))))
    return replace(model.with_parameters(parameters), drives=MappingProxyType(drives))


def _agreed(read: KnownQuantity, moved: float) -> KnownQuantity:
    """Combine the gain from readings with the gain from motion; its deviation covers the difference of the two."""
    return replace(read, value=moved, std=float(np.hypot(read.std or 0.0, moved - read.value)))
