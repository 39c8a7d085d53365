"""Check that the values of a fitted model are physically possible; otherwise the recording is probably wrong."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from armdyn.arm.model import ArmModel
from armdyn.arm.rigid import torque_regressor
from armdyn.identify.compare import Comparison
from armdyn.inspection.arm import MIN_EFFORT_LIMIT_MEANING_NONE, NEARLY_ZERO_SHARE_OF_EFFORT_LIMIT
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
MIN_WEIGHT_SHARE_OF_DESCRIBED = 0.1
"""Least possible mass of a link, and least possible torques that hold the arm, as shares of the described ones."""
WEIGHED_POSTURES = 50
"""Number of postures of a recording in which the arm's weight is computed."""
CHECK_REMEDY = "check your recording: armdyn inspect M.toml RUN..., with --report a page of every channel"


MIN_REPORTED_EXCESS_STDS = 2.0
"""Standard deviations by which a fitted value must exceed its possible range to be reported."""


def min_credible_magnitude(p: Parameter) -> float:
    """Absolute value of a parameter less two standard deviations: its least probable size."""
    return abs(p.value) - MIN_REPORTED_EXCESS_STDS * (p.std or 0.0)


def implausible_values(model: Model, runs: Sequence[Run] = ()) -> list[Check]:
    """Findings on impossible values of a fitted model, such as a payload heavier than the robot.

    In a base of a user's own the bounds of a value define what is possible, so that there are none. Small values
    without a name are not findings: nobody reads them, and the recordings do not determine each of them.

    Args:
        model: the fitted model.
        runs: recordings, whose postures show whether the model has a weight.
    """
    of_base = IMPOSSIBLE_BY_BASE.get(model.base)
    if of_base is None:
        return []
    return [
        Check("implausible_model", Severity.WRONG, None, (name,), f"{said}.", CHECK_REMEDY)
        for name, said in (*_sizes(model), *of_base(model, runs))
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
    had = {check.channels for check in implausible_values(given, runs)}
    found = [check for check in implausible_values(model, runs) if check.channels not in had]
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
    for name, p in _named(model).items():
        effect = p.effect or ""
        pushes = ("friction" in effect or "drag" in effect) and p.lower >= 0.0
        if pushes and p.value < 0.0 < min_credible_magnitude(p):
            yield name, f"{name} = {rounded(p.value)} {p.unit} is a friction that pushes"
        if effect and p.unit == "s" and min_credible_magnitude(p) > MAX_TIME_CONSTANT_SECONDS:
            yield name, f"{name} = {rounded(p.value)} s is a time that nothing of a robot takes"


def _named(model: Model) -> Mapping[str, Parameter]:
    """Parameters of a model that are not in its background."""
    unnamed = frozenset(model.background.names if model.background is not None else ())
    return {name: p for name, p in model.parameters.items() if name not in unnamed}


def _of_arm(model: ArmModel, runs: Sequence[Run]) -> Iterator[tuple[str, str]]:
    whole = float(model.arm.described[:, 0].sum())
    limits = dict(zip(model.arm.joints, model.arm.model.effortLimit.tolist(), strict=True))
    for name, p in _named(model).items():
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
    yield from _links(model, max(whole, 1.0))
    yield from _weight(model, runs)
    described, found = np.array(model.arm.model.gravity.linear), model.gravity()
    size = float(np.linalg.norm(described) * np.linalg.norm(found))
    lean = np.arccos(np.clip(described @ found / size, -1.0, 1.0)) if size > 0.0 else 0.0
    if lean > MAX_BASE_TILT_RADIANS:
        yield "base_tilt", f"the base would lean by {np.rad2deg(lean):.0f} degrees against its description"


def _links(model: ArmModel, whole: float) -> Iterator[tuple[str, str]]:
    """Findings on links that certainly weigh more than the arm of `whole` kg, or next to nothing."""
    named = {name: p for name, p in _named(model).items() if p.effect != "payload"}  # what is held is judged by itself
    # A link's mass depends on one parameter, so that covariances do not matter.
    variance = np.diag([(named[name].std or 0.0) ** 2 if name in named else 0.0 for name in model.names])
    theta = np.array([p.value if name in named else p.null for name, p in model.parameters.items()])
    free = np.array([name in named for name in model.names])
    for link in model.link_inertia_changes(theta, variance, variance, free):
        mass, name = link.mass, f"link_inertia.mass[{link.joint}]"
        excess = MIN_REPORTED_EXCESS_STDS * mass.std
        said = f"the link of {link.joint} would weigh {rounded(mass.value)} kg"
        if mass.determined and mass.value - excess > whole:
            yield name, f"{said}, more than the arm of {rounded(whole)} kg"
        if mass.determined and mass.value + excess < MIN_WEIGHT_SHARE_OF_DESCRIBED * mass.described:
            yield name, f"{said}, next to nothing of the {rounded(mass.described)} kg of its description"


def _weight(model: ArmModel, runs: Sequence[Run]) -> Iterator[tuple[str, str]]:
    """A finding on an arm that no torque holds: gravity was not in the torques to which it was fitted."""
    arm, joints = model.arm.model, [f"q.{joint}" for joint in model.arm.joints]
    q = np.concatenate([np.zeros((0, len(joints))), *(_postures(run, joints) for run in runs)])
    repaired = np.array([model.link_parameters()[joint] for joint in model.arm.joints])
    held = torque_regressor(arm, q, np.zeros_like(q), np.zeros_like(q))  # (n, nj, nj, 10)
    limits = np.array(arm.effortLimit)
    described, fitted = (
        np.sqrt(np.mean(np.square(np.einsum("njkp,kp->nj", held, links) / limits))) if len(q) else 0.0
        for links in (model.arm.described, repaired)
    )
    nearly = MIN_WEIGHT_SHARE_OF_DESCRIBED * described
    if described > NEARLY_ZERO_SHARE_OF_EFFORT_LIMIT and fitted < nearly:
        share = rounded(100.0 * float(fitted / described))
        yield "weight", f"the arm would need {share} % of the torques that hold it: gravity is not in the torques"


def _postures(run: Run, joints: Sequence[str]) -> np.ndarray:
    """(n, nj) postures of a recording, rad or m; none where a position is missing."""
    channels = [run.channels[name] for name in joints if name in run.channels]
    if len(channels) < len(joints):
        return np.zeros((0, len(joints)))
    time = np.linspace(max(c.time[0] for c in channels), min(c.time[-1] for c in channels), WEIGHED_POSTURES)
    return np.column_stack([np.interp(time, c.time, c.value) for c in channels])


def _of_swing(model: Model, _: Sequence[Run]) -> Iterator[tuple[str, str]]:
    length, mass, gravity = (model.parameters[name].value for name in ("length", "mass", "gravity"))
    for name in ("length", "mass"):
        p = model.parameters[name]
        if p.fitted and p.value in (p.lower, p.upper):
            yield name, f"{name} = {rounded(p.value)} {p.unit} is the end of what a load that swings can have"
    for name, p in model.parameters.items():
        if p.effect == "pivot_coulomb_friction" and p.value > mass * gravity * length:
            yield name, f"{name} = {rounded(p.value)} {p.unit} would hold the load at any angle"


IMPOSSIBLE_BY_BASE: Mapping[str, Callable[[Any, Sequence[Run]], Iterator[tuple[str, str]]]] = {
    "arm": _of_arm, "pendulum": _of_swing,
}  # fmt: skip
"""Function that finds impossible values of a model, by the model's base; it yields the parameter and the fault."""
