"""Check that the values of a fitted model are physically possible; otherwise the recording is probably wrong."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from armdyn.arm.model import ArmModel
from armdyn.identify.compare import Comparison
from armdyn.inspection.arm import MIN_EFFORT_LIMIT_MEANING_NONE
from armdyn.inspection.check import Check, Inspection, Severity, WrongRecordingError, rounded
from armdyn.model import Model
from armdyn.parameter import Parameter
from armdyn.run import Run

MAX_TIME_CONSTANT_SECONDS = 10.0
"""Longest possible time constant of a sensor, gripper or string, s."""
MAX_BASE_TILT_RADIANS = np.deg2rad(60.0)
"""Largest possible tilt of a base against its description, rad."""
MAX_PERMANENT_SHARE_OF_EFFORT_LIMIT = 1.0
"""Largest possible permanent torque on a joint, as a share of its effort limit."""
CHECK_REMEDY = "check your recording: armdyn inspect M.toml RUN..., with --report a page of every channel"


MIN_REPORTED_EXCESS_STDS = 2.0
"""Standard deviations by which a fitted value must exceed its possible range to be reported."""


def min_credible_magnitude(p: Parameter) -> float:
    """Absolute value of a parameter less two standard deviations: its least probable size."""
    return abs(p.value) - MIN_REPORTED_EXCESS_STDS * (p.std or 0.0)


def implausible_values(model: Model) -> list[Check]:
    """Findings on impossible values of a fitted model, such as a payload heavier than the robot.

    In a base of a user's own the bounds of a value define what is possible, so that there are none.
    """
    of_base = IMPOSSIBLE_BY_BASE.get(model.base)
    if of_base is None:
        return []
    return [
        Check("implausible_model", Severity.WRONG, None, (name,), f"{said}: check your recording", CHECK_REMEDY)
        for name, said in (*_sizes(model), *of_base(model))
    ]


def require_plausible(model: Model, runs: Sequence[Run], given: Model) -> None:
    """Refuse a model with impossible values.

    Args:
        model: the fitted model.
        runs: the runs to which it was fitted.
        given: the model before the fit, whose impossible values are ignored because its user set them.

    Raises:
        WrongRecordingError: a value is impossible; the error has the findings.
    """
    had = {check.channels for check in implausible_values(given)}
    found = [check for check in implausible_values(model) if check.channels not in had]
    if found:
        raise WrongRecordingError(Inspection(tuple(runs), tuple(found)))


def with_fitted_values(model: Model, found: Comparison) -> Model:
    """The model with the values that a comparison fitted; parameters with one value per run keep their values."""
    changed = {
        name: replace(p, value=found.parameters[name].value, std=found.parameters[name].std)
        for name, p in model.parameters.items()
        if name in found.parameters and p.scope == "shared"
    }
    return model.with_parameters(changed)


def _sizes(model: Model) -> Iterator[tuple[str, str]]:
    """Findings that hold for arms and pendulums: signs and times."""
    for name, p in model.parameters.items():
        effect = p.effect or ""
        pushes = ("friction" in effect or "drag" in effect) and p.lower >= 0.0
        if pushes and p.value < 0.0 < min_credible_magnitude(p):
            yield name, f"{name} = {rounded(p.value)} {p.unit} is a friction that pushes"
        if effect and p.unit == "s" and min_credible_magnitude(p) > MAX_TIME_CONSTANT_SECONDS:
            yield name, f"{name} = {rounded(p.value)} s is a time that nothing of a robot takes"


def _of_arm(model: ArmModel) -> Iterator[tuple[str, str]]:
    whole = float(model.arm.described[:, 0].sum())
    limits = dict(zip(model.arm.joints, model.arm.model.effortLimit.tolist(), strict=True))
    for name, p in model.parameters.items():
        if p.effect == "payload" and p.unit == "kg" and min_credible_magnitude(p) > whole:
            yield (
                name,
                f"{name} = {rounded(p.value)} kg is a payload heavier than the arm of {rounded(whole)} kg",
            )
        limit = limits.get(p.joint, 0.0) if p.effect and p.unit in ("N m", "N") and "spring" not in p.effect else 0.0
        if (
            0.0 < limit < MIN_EFFORT_LIMIT_MEANING_NONE
            and min_credible_magnitude(p) > MAX_PERMANENT_SHARE_OF_EFFORT_LIMIT * limit
        ):
            said = f"{name} = {rounded(p.value)} {p.unit} is more than the joint's limit of {rounded(limit)} {p.unit}"
            yield name, said
    links = model.link_parameters() if any(p.effect == "link_inertia" for p in model.parameters.values()) else {}
    for joint, (mass, *_) in links.items():
        own = model.parameters.get(f"link_inertia.mass[{joint}]")
        if mass - MIN_REPORTED_EXCESS_STDS * ((own.std if own is not None else 0.0) or 0.0) > max(whole, 1.0):
            said = f"the link of {joint} would weigh {rounded(mass)} kg, more than the arm of {rounded(whole)} kg"
            yield f"link_inertia.mass[{joint}]", said
    described, found = np.array(model.arm.model.gravity.linear), model.gravity()
    size = float(np.linalg.norm(described) * np.linalg.norm(found))
    lean = np.arccos(np.clip(described @ found / size, -1.0, 1.0)) if size > 0.0 else 0.0
    if lean > MAX_BASE_TILT_RADIANS:
        yield "base_tilt", f"the base would lean by {np.rad2deg(lean):.0f} degrees against its description"


def _of_swing(model: Model) -> Iterator[tuple[str, str]]:
    length, mass, gravity = (model.parameters[name].value for name in ("length", "mass", "gravity"))
    for name in ("length", "mass"):
        p = model.parameters[name]
        if p.fitted and p.value in (p.lower, p.upper):
            yield name, f"{name} = {rounded(p.value)} {p.unit} is the end of what a load that swings can have"
    for name, p in model.parameters.items():
        if p.effect == "pivot_coulomb_friction" and p.value > mass * gravity * length:
            yield name, f"{name} = {rounded(p.value)} {p.unit} would hold the load at any angle"


IMPOSSIBLE_BY_BASE: Mapping[str, Callable[[Any], Iterator[tuple[str, str]]]] = {"arm": _of_arm, "pendulum": _of_swing}
"""Function that finds impossible values of a model, by the model's base; it yields the parameter and the fault."""
