"""Candidate terms for a joint of an arm: torques that its drive gives besides moving the rigid bodies."""

from collections.abc import Iterator
from dataclasses import replace
from typing import cast

import numpy as np

from armdyn.arm.model import ArmModel
from armdyn.discovery import shapes
from armdyn.discovery.term import Constant, Site, Term, Variable, recorded_variables
from armdyn.identify.fit import Fit
from armdyn.parameter import Quantity
from armdyn.recording.channels import FloatArray

MISSING_TORQUE_SHARE = 0.1
"""Typical size of a missing torque, as a share of the joint's root mean square torque."""
WAVE_PERIODS = 28
"""Number of periods of waves along the position, evenly in the logarithm: neighbours are 15 % apart, as far as a fit
reaches."""
MIN_WAVE_PERIOD, MAX_WAVE_PERIOD = 0.03, 1.5
"""Shortest and longest period of these waves, over the range of the position."""


def arm_terms(fit: Fit) -> Iterator[Term]:
    """All candidate formulas, for every joint whose torque was measured."""
    recorded = recorded_variables(fit.problem.runs)
    for site, v in _joints(fit):
        for term in (*_of_joint(site, **v), *shapes.of_recorded(site, recorded, v["speed"])):
            yield _as_declared(fit, term)


def arm_curves(fit: Fit) -> Iterator[Term]:
    """Smooth curves over the quantities on which a joint's torque may depend."""
    recorded = recorded_variables(fit.problem.runs)
    for site, v in _joints(fit):
        for term in shapes.curves(site, (v["position"], v["speed"], v["load"]), recorded, v["speed"]):
            yield _as_declared(fit, term)


def _of_joint(site: Site, position: Variable, speed: Variable, load: Variable, time: Variable) -> Iterator[Term]:
    yield from shapes.of_hinge(site, position, speed, time, (0.05 * speed.size, 0.3 * speed.size))
    yield shapes.power(site, load, 2, "saturating motor", "a torque with the square of the load")
    yield shapes.power(site, load, 3, "saturating motor", "a torque with the cube of the load: a motor that saturates")
    yield from shapes.growing(site, position)
    yield shapes.magnet(site, position)
    yield from shapes.play(site, speed, position, (0.01 * position.span, 0.05 * position.span))
    periods = position.span * np.geomspace(MIN_WAVE_PERIOD, MAX_WAVE_PERIOD, WAVE_PERIODS)
    yield from shapes.waves(site, position, periods.tolist())


def _joints(fit: Fit) -> Iterator[tuple[Site, dict[str, Variable]]]:
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
        typical = MISSING_TORQUE_SHARE * float(np.sqrt(np.mean(torque**2)))
        rubs = "joint.with_torque(joint.direction * ({}))"
        dry = Site("joint", "N m", rubs, typical, "", shown="sign(speed) * ({})", joint=joint)
        site = Site("joint", "N m", "joint.with_torque({})", typical, "", dry, joint=joint)
        yield (
            site,
            {
                "position": Variable("position", "joint.position", "rad", q),
                "speed": Variable("speed", "joint.velocity", "rad/s", speed),
                "load": Variable("load", "joint.load", "N m", torque),
                "time": Variable("time", "joint.time", "s", time),
            },
        )


def _as_declared(fit: Fit, term: Term) -> Term:
    """A term in the units of a typical joint, which the arm scales to its own joint; see `Arm.parameter`."""
    model, joint = cast(ArmModel, fit.problem.model), term.site.joint

    def declared(constant: Constant) -> Constant:
        return constant.scaled(model.arm.parameter(Quantity(constant.unit, 1.0), "term", "size", joint).typical)

    constants = {name: declared(constant) for name, constant in term.constants.items()}
    return replace(term, size=declared(term.size), constants=constants)
