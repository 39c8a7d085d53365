"""Candidate terms for a pendulum: torques on its string, forces on its load, a gripper's rail that is not straight."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from armdyn.discovery import shapes
from armdyn.discovery.term import CandidateTerm, TermLocation, TermVariable, recorded_variables
from armdyn.identify.fit import Fit

MISSING_FORCE_SHARE_OF_WEIGHT = 0.02
"""Typical size of a missing force, as a share of the load's weight."""


def pendulum_formula_candidates(fit: Fit) -> Iterator[CandidateTerm]:
    """Candidate formulas for the missing force in the runs of a fit of a pendulum without added effects."""
    string, load, rail, v = _sites(fit)
    widths = (0.1 * v["speed"].size, 0.4 * v["speed"].size)
    yield from shapes.hinge_terms(string, v["angle"], v["speed"], v["time"], widths, "drag", "damping")
    yield from shapes.recorded_terms(string, recorded_variables(fit.problem.runs), v["speed"])
    if v["along"].span > 0.0:
        below = "load.with_force({} * ca.vertcat({away}, 0, 1))"  # for its small width, the load is below the line
        yield from shapes.magnet_terms(load, v["position"])
        under = replace(load, code=below, formula_pattern="{} * ({away} along the line, 1 upwards)")
        yield from shapes.magnet_terms(under, v["position"])
        for n in (1, 2, 3):
            yield shapes.power_term(rail, v["along"], n, "rail", "the rail is not level along the way")


def pendulum_curve_candidates(fit: Fit) -> Iterator[CandidateTerm]:
    """Candidate smooth curves for the missing force, over each quantity on which it may depend."""
    string, load, rail, v = _sites(fit)
    yield from shapes.curve_terms(string, (v["angle"], v["speed"]), recorded_variables(fit.problem.runs), v["speed"])
    if v["along"].span > 0.0:
        yield shapes.curve_term(load, v["position"])
        yield shapes.curve_term(rail, v["along"])


def _sites(fit: Fit) -> tuple[TermLocation, TermLocation, TermLocation, dict[str, TermVariable]]:
    """String, load and rail, and the quantities on which forces there may depend, with their ranges in the runs."""
    problem, model = fit.problem, fit.problem.model
    at = [problem.theta(i, fit.values) for i in range(len(problem.runs))]
    mass, length, gravity = (at[0][model.names.index(name)] for name in ("mass", "length", "gravity"))
    seen: dict[str, list[np.ndarray]] = {}
    for run, theta in zip(problem.runs, at, strict=True):
        states = model.covariates(run, theta)
        measured = run.channels.get("swing_angle") or states["swing_angle"]
        time, rate = states["swing_rate"].time, states["swing_rate"].value
        along = states["gripper_x"].value if "gripper_x" in states else np.zeros(len(time))
        angle = np.interp(time, measured.time, measured.value)
        found = {"angle": angle, "speed": rate, "time": time - time[0], "along": along}
        for name, value in {**found, "position": along - length * np.sin(angle)}.items():
            seen.setdefault(name, []).append(value)
    samples = {name: np.concatenate(parts) for name, parts in seen.items()}
    torque = MISSING_FORCE_SHARE_OF_WEIGHT * mass * gravity * length
    dry = TermLocation("string", "N m", "string.with_dry_torque({})", torque, formula_pattern="-sign(speed) * {}")
    string = TermLocation("string", "N m", "string.with_torque({})", torque, dry_friction_site=dry)
    load = TermLocation("load", "N", "load.with_force(ca.vertcat({}, 0, 0))", torque / length)
    rail = TermLocation(
        "gripper",
        "m",
        "gripper.with_position(gripper.position + ca.vertcat(0, 0, {}))",
        0.1 * MISSING_FORCE_SHARE_OF_WEIGHT * length,
    )
    of = {"angle": ("string.angle", "rad"), "speed": ("string.rate", "rad/s"), "time": ("string.time", "s"),
          "position": ("load.position[0]", "m"), "along": ("gripper.x", "m")}  # fmt: skip
    return string, load, rail, {name: TermVariable(name, *what, samples[name]) for name, what in of.items()}
