"""Candidate terms for a user's own base model: functions of states and inputs, added to the rate of a state."""

import keyword
import re
from collections.abc import Collection, Iterator, Mapping
from itertools import combinations
from typing import cast

import numpy as np

from armdyn.discovery import shapes
from armdyn.discovery.families import family_terms
from armdyn.discovery.term import CandidateTerm, TermLocation, TermVariable
from armdyn.discovery.units import divide_units
from armdyn.identify.fit import Fit
from armdyn.physics.definition import RATE_STAGE
from armdyn.physics.model import PhysicsModel
from armdyn.run import Run

MISSING_TERM_SHARE_OF_STATE_RATE = 0.05
"""Typical size of a missing term in the rate (time derivative) of a state, as a share of the rate."""
RESERVED_NAMES = ("k", "place", "stiffness", "friction", "coefficient", "width", "rate", "near", "total", "ca")
"""Names that formulas use for their own parameters, so that a state or input gets another name in them."""


def physics_formula_candidates(fit: Fit) -> Iterator[CandidateTerm]:
    """Candidate formulas for what is missing in the rate of each state, in the runs of a fit without added effects."""
    for site, variables in _states(fit):
        yield shapes.constant_term(site)
        for v in variables:
            yield from shapes.rate_terms(site, v)
        for one, other in combinations(variables, 2):
            what = f"{one.name_in_sentence} times {other.name_in_sentence}"
            yield shapes.product_term(site, "product", f"something in proportion to {what}", (one, 1), (other, 1))


def physics_family_candidates(fit: Fit, states: Collection[str]) -> Iterator[CandidateTerm]:
    """Candidate laws of every family for what is missing in the rates of some states, by name; see `families`."""
    for site, variables in _states(fit):
        if site.joint in states:
            yield from family_terms(site, variables)


def physics_curve_candidates(fit: Fit) -> Iterator[CandidateTerm]:
    """Candidate smooth curves for what is missing in the rate of each state, over each state and input."""
    for site, variables in _states(fit):
        for v in variables:
            yield shapes.curve_term(site, v)


def _states(fit: Fit) -> Iterator[tuple[TermLocation, list[TermVariable]]]:
    """Every state whose rate is not a state itself, with states and inputs and their ranges in the runs."""
    model = cast(PhysicsModel, fit.problem.model)
    units = {n: p.unit for n, p in model.physics.states.items()} | dict(model.physics.inputs)
    samples: dict[str, list[np.ndarray]] = {name: [] for name in units}
    rates: dict[str, list[np.ndarray]] = {}
    for i, run in enumerate(fit.problem.runs):
        theta = fit.problem.theta(i, fit.values)
        for name, values in _followed(model, run, theta).items():
            samples[name].append(values)
        for name, values in model.rates(run, theta).items():
            rates.setdefault(name, []).append(values)
    variables = [
        TermVariable(_called(name), f'rate["{name}"]', units[name], np.concatenate(parts))
        for name, parts in samples.items()
    ]
    variables = [variable for variable in variables if variable.span > 0.0]
    for name, parts in rates.items():
        unit = divide_units(units[name], ("s", 1))
        size = MISSING_TERM_SHARE_OF_STATE_RATE * float(np.sqrt(np.mean(np.concatenate(parts) ** 2)))
        yield (
            TermLocation(RATE_STAGE, unit, "rate.with_rate({})", max(size, np.finfo(float).tiny), "-", joint=name),
            variables,
        )


def _followed(model: PhysicsModel, run: Run, theta: np.ndarray) -> Mapping[str, np.ndarray]:
    """States as fitted, and inputs as recorded."""
    path = model.input_path(run)
    states = model.states_along(run, theta)[:, : len(model.physics.states)]
    inputs = {name: path.nodes[1 + 3 * k] for k, name in enumerate(model.physics.inputs)}
    found = {**dict(zip(model.physics.states, states.T, strict=True)), **inputs}
    return {name: values[np.isfinite(values)] for name, values in found.items()}


def _called(name: str) -> str:
    """The name of a state or input in formulas: a Python name that is not used otherwise."""
    short = re.sub(r"\W", "_", name.removeprefix("extra."))
    return f"{short}_" if short in RESERVED_NAMES or keyword.iskeyword(short) else short
