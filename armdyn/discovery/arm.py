"""Candidate terms for a joint of an arm: torques of its drive in addition to those that move the rigid bodies."""

from collections.abc import Iterator
from dataclasses import replace
from typing import cast

import numpy as np

from armdyn.arm.model import ArmModel
from armdyn.discovery import shapes
from armdyn.discovery.term import CandidateTerm, TermLocation, TermParameter, TermVariable, recorded_variables
from armdyn.identify.fit import Fit
from armdyn.parameter import Quantity
from armdyn.recording.channels import FloatArray

MISSING_TORQUE_SHARE_OF_RMS = 0.1
"""Typical size of a missing torque, as a share of the joint's root mean square torque."""
COGGING_PERIODS_TRIED = 28
"""Number of periods that are tried for a torque that repeats along the position; neighbours differ by 15 %, so that a
fit from the nearest one reaches any period between them."""
MIN_COGGING_PERIOD_SHARE_OF_RANGE, MAX_COGGING_PERIOD_SHARE_OF_RANGE = 0.03, 1.5
"""Shortest and longest period that is tried for a torque that repeats along a joint's position, as a share of the range
of the position."""


def arm_formula_candidates(fit: Fit) -> Iterator[CandidateTerm]:
    """Candidate formulas for the missing torque of every joint whose torque was measured, in the runs of a fit."""
    recorded = recorded_variables(fit.problem.runs)
    for site, v in _joints(fit):
        for term in (*_of_joint(site, **v), *shapes.recorded_terms(site, recorded, v["speed"])):
            yield _as_declared(fit, term)


def arm_curve_candidates(fit: Fit) -> Iterator[CandidateTerm]:
    """Candidate smooth curves for the missing torque of every joint, over each quantity on which it may depend."""
    recorded = recorded_variables(fit.problem.runs)
    for site, v in _joints(fit):
        for term in shapes.curve_terms(site, (v["position"], v["speed"], v["load"]), recorded, v["speed"]):
            yield _as_declared(fit, term)


def _of_joint(
    site: TermLocation, position: TermVariable, speed: TermVariable, load: TermVariable, time: TermVariable
) -> Iterator[CandidateTerm]:
    yield from shapes.hinge_terms(site, position, speed, time, (0.05 * speed.size, 0.3 * speed.size))
    yield shapes.power_term(site, load, 2, "saturating motor", "a torque with the square of the load")
    yield shapes.power_term(
        site, load, 3, "saturating motor", "a torque with the cube of the load: a motor that saturates"
    )
    yield from shapes.cable_terms(site, position)
    yield from shapes.magnet_terms(site, position)
    yield from shapes.gear_play_terms(site, speed, position, (0.01 * position.span, 0.05 * position.span))
    periods = position.span * np.geomspace(
        MIN_COGGING_PERIOD_SHARE_OF_RANGE, MAX_COGGING_PERIOD_SHARE_OF_RANGE, COGGING_PERIODS_TRIED
    )
    yield from shapes.cogging_terms(site, position, periods.tolist())


def _joints(fit: Fit) -> Iterator[tuple[TermLocation, dict[str, TermVariable]]]:
    """Every joint, with the quantities on which its torque may depend and their ranges in the runs."""
    model = cast(ArmModel, fit.problem.model)
    seen: dict[str, list[FloatArray]] = {}
    for run in fit.problem.runs:
        states = model.covariates(run, fit.values)
        for name, channel in {**states, **{c: run.channels[c] for c in model.force_channels(run)}}.items():
            seen.setdefault(name, []).append(channel.value)
            seen.setdefault("time", []).append(channel.time - channel.time[0])
    time = np.concatenate(seen["time"])
    for joint in model.joints:
        if f"tau.{joint}" not in seen:
            continue
        q, speed, torque = (np.concatenate(seen[f"{kind}.{joint}"]) for kind in ("q", "v", "tau"))
        typical = MISSING_TORQUE_SHARE_OF_RMS * float(np.sqrt(np.mean(torque**2)))
        rubs = "joint.with_torque(joint.direction * ({}))"
        dry = TermLocation("joint", "N m", rubs, typical, "", formula_pattern="sign(speed) * ({})", joint=joint)
        site = TermLocation("joint", "N m", "joint.with_torque({})", typical, "", dry, joint=joint)
        yield (
            site,
            {
                "position": TermVariable("position", "joint.position", "rad", q),
                "speed": TermVariable("speed", "joint.velocity", "rad/s", speed),
                "load": TermVariable("load", "joint.load", "N m", torque),
                "time": TermVariable("time", "joint.time", "s", time),
            },
        )


def _as_declared(fit: Fit, term: CandidateTerm) -> CandidateTerm:
    """A term in the units of a typical joint, which the arm scales to the actual joint; see `Arm.parameter`."""
    model, joint = cast(ArmModel, fit.problem.model), term.location.joint

    def declared(constant: TermParameter) -> TermParameter:
        return constant.scaled(model.arm.parameter(Quantity(constant.unit, 1.0), "term", "size", joint).typical)

    constants = {name: declared(constant) for name, constant in term.parameters.items()}
    return replace(term, size_parameter=declared(term.size_parameter), parameters=constants)
