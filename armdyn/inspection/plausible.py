"""Whether the values of a fitted model can be those of a thing: else the recording is not what it says it is."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from armdyn.arm.model import ArmModel
from armdyn.identify.compare import Comparison
from armdyn.inspection.check import Check, Inspection, Severity, WrongRecordingError, amount
from armdyn.model import Model
from armdyn.parameter import Parameter
from armdyn.run import Run

SLOWEST = 10.0
"""s; no sensor, gripper or string remembers for longer."""
OVER = np.deg2rad(60.0)
"""By which a base leans at most; a wall or ceiling belongs into the description."""
STRONG = 1.0
"""Of a joint's effort limit: a torque that acts always cannot be larger, or the drive could not carry it."""
CHECK = "check your recording: armdyn inspect M.toml RUN..., with --report a page of every channel"


DETERMINED = 2.0
"""Standard deviations by which a value must be beyond what a thing has: what runs do not determine is no finding."""


def least(p: Parameter) -> float:
    """How large a parameter is at least, as far as the runs determine it."""
    return abs(p.value) - DETERMINED * (p.std or 0.0)


def implausible(model: Model) -> list[Check]:
    """Values that nothing has: a payload heavier than the robot, a friction that pushes, a base upside down."""
    return [
        Check("implausible_model", Severity.WRONG, None, (name,), f"{said}: check your recording", CHECK)
        for name, said in (*_sizes(model), *(_of_arm(model) if isinstance(model, ArmModel) else _of_swing(model)))
    ]


def require_plausible(model: Model, runs: Sequence[Run], given: Model) -> None:
    """Refuse a model that no thing can have.

    Args:
        model: that was fitted.
        runs: to these.
        given: from this one; what it has already is its user's own doing.

    Raises:
        WrongRecordingError: has the checks.
    """
    had = {check.channels for check in implausible(given)}
    found = [check for check in implausible(model) if check.channels not in had]
    if found:
        raise WrongRecordingError(Inspection(tuple(runs), tuple(found)))


def compared_model(model: Model, found: Comparison) -> Model:
    """The model of a study with the values that a comparison found; those of a single run stay."""
    changed = {
        name: replace(p, value=found.parameters[name].value, std=found.parameters[name].std)
        for name, p in model.parameters.items()
        if name in found.parameters and p.scope == "shared"
    }
    return model.with_parameters(changed)


def _sizes(model: Model) -> Iterator[tuple[str, str]]:
    """Whatever the base: signs and times."""
    for name, p in model.parameters.items():
        effect = p.effect or ""
        pushes = ("friction" in effect or "drag" in effect) and p.lower >= 0.0
        if pushes and p.value < 0.0 < least(p):
            yield name, f"{name} = {amount(p.value)} {p.unit} is a friction that pushes"
        if effect and p.unit == "s" and least(p) > SLOWEST:
            yield name, f"{name} = {amount(p.value)} s is a time that nothing of a robot takes"


def _of_arm(model: ArmModel) -> Iterator[tuple[str, str]]:
    whole = float(model.arm.described[:, 0].sum())
    for name, p in model.parameters.items():
        if p.effect == "payload" and p.unit == "kg" and least(p) > whole:
            yield name, f"{name} = {amount(p.value)} kg is a payload heavier than the arm of {amount(whole)} kg"
        limit = _effort(model, p)
        if limit is not None and p.unit in ("N m", "N") and least(p) > STRONG * limit and "spring" not in p.effect:
            yield (
                name,
                f"{name} = {amount(p.value)} {p.unit} is more than the joint's limit of {amount(limit)} {p.unit}",
            )
    if any(p.effect == "link_inertia" for p in model.parameters.values()):
        for joint, inertial in model.link_parameters().items():
            own = model.parameters.get(f"link_inertia.mass[{joint}]")
            if inertial[0] - (DETERMINED * (own.std or 0.0) if own is not None else 0.0) > max(whole, 1.0):
                said = (
                    f"the link of {joint} would weigh {amount(inertial[0])} kg, more than the arm of {amount(whole)} kg"
                )
                yield f"link_inertia.mass[{joint}]", said
    described, found = np.array(model.arm.model.gravity.linear), model.gravity()
    size = float(np.linalg.norm(described) * np.linalg.norm(found))
    if size > 0.0 and np.arccos(np.clip(described @ found / size, -1.0, 1.0)) > OVER:
        lean = float(np.rad2deg(np.arccos(np.clip(described @ found / size, -1.0, 1.0))))
        yield "base_tilt", f"the base would lean by {lean:.0f} degrees against its description"


def _effort(model: ArmModel, p: Parameter) -> float | None:
    if not p.effect or p.joint not in model.joints:
        return None
    limit = float(model.arm.model.effortLimit[model.arm.joints.index(p.joint)])
    return limit if 0.0 < limit < 1e4 else None


def _of_swing(model: Model) -> Iterator[tuple[str, str]]:
    if model.base != "pendulum":
        return
    length, mass, gravity = (model.parameters[name].value for name in ("length", "mass", "gravity"))
    for name in ("length", "mass"):
        p = model.parameters[name]
        if p.fitted and p.value in (p.lower, p.upper):
            yield name, f"{name} = {amount(p.value)} {p.unit} is the end of what a load that swings can have"
    for name, p in model.parameters.items():
        if p.effect == "pivot_coulomb_friction" and p.value > mass * gravity * length:
            yield name, f"{name} = {amount(p.value)} {p.unit} would hold the load at any angle"
