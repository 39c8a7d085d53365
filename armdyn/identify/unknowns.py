"""The unknowns of a least-squares problem: the parameters of a model that all runs share, and those of each run."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from armdyn.errors import InputError
from armdyn.model import Model
from armdyn.parameter import Parameter, Prior
from armdyn.run import Run


@dataclass(frozen=True)
class Unknown:
    """One unknown of a least-squares problem: a parameter that all runs share, or a parameter of one run.

    Attributes:
        name: such as ``"length"``, or ``"initial_angle[a.csv]"`` for one run.
        parameter: the parameter, with its bounds and prior.
        index: position of the parameter in the model's parameter vector.
        run: position of the run to which it belongs; None if all runs share it.
    """

    name: str
    parameter: Parameter
    index: int
    run: int | None


def unknowns_of(model: Model, runs: Sequence[Run]) -> tuple[Unknown, ...]:
    """The unknowns of a model that is fitted to runs, those that all runs share first.

    Values that a run states (`Run.known`) are priors: one for all runs where they agree, else one for each run.

    Args:
        model: the model; a parameter of scope ``"per_run"`` is one unknown for each run.
        runs: recordings with different names.

    Raises:
        InputError: a value that a run states is outside the physical range.
    """
    differing = {name for name in model.names if len({run.known.get(name) for run in runs}) > 1}
    columns: list[Unknown] = []
    for index, parameter in enumerate(model.parameters.values()):
        if parameter.scope == "shared" and parameter.name not in differing:
            columns.append(Unknown(parameter.name, _informed(parameter, runs[0]), index, None))
    for i, run in enumerate(runs):
        guess = model.guess_start_state(run)
        for index, parameter in enumerate(model.parameters.values()):
            if parameter.scope == "shared" and parameter.name not in differing:
                continue
            own = replace(parameter, scope="per_run")
            if parameter.name in guess and parameter.fitted:
                own = own.with_value(float(np.clip(guess[parameter.name], own.lower, own.upper)))
            name = parameter.name if len(runs) == 1 else f"{parameter.name}[{run.name}]"
            columns.append(Unknown(name, _informed(own, run), index, i))
    return tuple(columns)


def _informed(parameter: Parameter, run: Run) -> Parameter:
    """The parameter with the value that was measured by hand for this run."""
    known = run.known.get(parameter.name)
    if known is None:
        return parameter
    if not parameter.lower <= known.value <= parameter.upper:
        raise InputError(
            f"{run.name}: known {parameter.name} = {known.value:g} {known.unit} is outside its physical range "
            f"{parameter.lower:g} to {parameter.upper:g} {parameter.unit}: measure it again"
        )
    if known.std is None:
        return replace(parameter, value=known.value, fitted=False, prior=None)
    return replace(parameter, value=known.value, prior=Prior(known.value, known.std))
