"""The links of a fitted arm in physical units."""

from typing import TYPE_CHECKING

import numpy as np

from armdyn.identify.fit import Fit
from armdyn.identify.study import Study
from armdyn.identify.uncertainty import uncertainty

if TYPE_CHECKING:
    from armdyn.arm.links import LinkChange


def links_of(study: Study, fit: Fit) -> tuple["LinkChange", ...]:
    """Links that the fit changed; empty for a model without links."""
    if study.model.base != "arm":
        return ()
    from armdyn.arm.links import link_changes
    from armdyn.arm.model import ArmModel

    problem = fit.problem
    assert isinstance(problem.model, ArmModel)
    places = problem.places(0)  # links are the same in every run
    certain = uncertainty(study, fit)
    return link_changes(
        problem.model,
        problem.theta(0, fit.values),
        certain.covariance[np.ix_(places, places)],
        certain.of_runs_alone[np.ix_(places, places)],
        fit.free[places],
    )
