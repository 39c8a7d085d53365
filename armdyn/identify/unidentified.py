r"""Find combinations of parameters that the runs do not identify, and measurements that would identify them.

J has the derivatives of all samples over their noise, and of the priors, with every parameter in typical sizes. A
singular value of J below 1 belongs to a direction v in which parameters may change together by more than their typical
size without a contradiction to recordings and priors (Golub & Van Loan, Matrix Computations, §5.3). A parameter on
which no sample depends is reported elsewhere as not fitted; reported here are parameters that would be identifiable
alone:

    |J_i| > 1,    |J v| < 1,    |v| = 1.

The standard deviations of such parameters are meaningless: a pseudo-inverse leaves the direction out and makes them far
too small.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import qr

from armdyn.identify.fit import Fit
from armdyn.identify.residual.noise_tests import compress_residuals
from armdyn.identify.sentence import join_names
from armdyn.object_cache import cached_with_first_argument
from armdyn.physics.simulated import as_simulated_model
from armdyn.threads import one_thread

MAX_IDENTIFIED_STD_TYPICAL_SIZES = 1.0
"""Standard deviation along a direction of the parameters, in typical sizes, above which it is not identified."""
SAME_CHANGE_TOLERANCE = 0.02
"""Difference of two relative changes up to which they are the same."""
MIN_DIRECTION_COMPONENT_SHARE = 0.02
"""Change of a parameter, as a share of the largest change in a direction, up to which it is not part of it."""


@dataclass(frozen=True)
class UnidentifiedCombination:
    """A combination of parameters that runs do not identify: together they can change without changing a prediction.

    Attributes:
        changes: change of each parameter in per cent of its value, or in its unit where the value is 0; the first
            parameter changes by 1.
        units: units of these changes, ``"%"`` or the parameter's unit.
        unidentified_parameters: names of all parameters whose standard deviations are meaningless because of this
            combination.
        identifying_states: states that no channel measures and whose recording would identify the parameters, with
            units.
        quotients: quotients of the parameters, with their values, where the runs determine these.
    """

    changes: dict[str, float]
    units: dict[str, str]
    unidentified_parameters: frozenset[str]
    identifying_states: tuple[str, ...] = ()
    quotients: tuple[str, ...] = ()

    @property
    def sentence(self) -> str:
        """One sentence for a reader: which parameters change together, and what would identify them."""
        moves = [f"{name} by {change:+.2g} {self.units[name]}" for name, change in self.changes.items()]
        if self.quotients:
            text = f"These runs determine only quotients: {join_names(list(self.quotients))}. State one of these values"
        else:
            text = f"These runs do not determine {join_names(list(self.changes))} one by one: if they change together "
            text += f"({', '.join(moves)}), no prediction changes. State the value of one of them"
        first = next(iter(self.changes))
        text += f' (--set {first}="... +/- ...")'
        return text + (f", or record {join_names(self.identifying_states, 'or')}" if self.identifying_states else "")


def with_quotients(combination: UnidentifiedCombination, fit: Fit, covariance: np.ndarray) -> UnidentifiedCombination:
    """Add the quotients of parameters that all change by the same percentage; the runs determine these.

    A drag and a friction of a pendulum, for example, are known per kilogram where the mass is not. Their standard
    deviations follow from any covariance (P, P) of the unknowns, as a quotient does not change along the direction that
    is not identified.
    """
    columns, changes = fit.problem.columns, combination.changes
    places = [i for i, c in enumerate(columns) if c.parameter.name in changes]
    described = [i for i in places if not fit.problem.is_effect[i]]
    same = np.allclose(list(changes.values()), 1.0, atol=SAME_CHANGE_TOLERANCE)
    if len(places) != len(changes) or len(described) != 1 or set(combination.units.values()) != {"%"} or not same:
        return combination
    below, said = described[0], list[str]()
    for above in (i for i in places if i != below):
        value = fit.values[above] / fit.values[below]
        slope = np.zeros(len(fit.values))
        slope[[above, below]] = value / fit.values[above], -value / fit.values[below]
        std = float(np.sqrt(slope @ np.nan_to_num(covariance, posinf=0.0) @ slope))
        one, other = columns[above].parameter, columns[below].parameter
        said.append(f"{one.name} / {other.name} = {value:.6g} +/- {std:.2g} {one.unit} per {other.unit}")
    return replace(combination, quotients=tuple(said))


@cached_with_first_argument
@one_thread
def find_unidentified_combinations(fit: Fit) -> tuple[UnidentifiedCombination, ...]:
    """Find combinations of parameters that a fit does not identify although it would identify each one alone."""
    problem = fit.problem
    asked = np.flatnonzero(fit.free | (problem.fitted & ~problem.is_effect))
    _, J = compress_residuals(problem, problem.blocks(fit.values), fit.values)
    J = J[:, asked] * problem.typical[asked]
    if not np.isfinite(J).all():
        return ()
    alone = np.linalg.norm(J, axis=0)
    told = np.flatnonzero(alone > MAX_IDENTIFIED_STD_TYPICAL_SIZES)
    if not len(told):
        return ()
    _, singular, rows = np.linalg.svd(J[:, told])
    weak = rows[np.concatenate([singular, np.zeros(len(told) - len(singular))]) < MAX_IDENTIFIED_STD_TYPICAL_SIZES]
    return tuple(_described(fit, asked[told], direction, alone[told]) for direction in _sparse(weak))


def _sparse(weak: np.ndarray) -> Sequence[np.ndarray]:
    """(m, n) directions that span the same space as (m, n), each without the leading values of the others."""
    if not len(weak):
        return ()
    _, _, order = qr(weak, pivoting=True, mode="economic")
    leading = order[: len(weak)]
    return list(np.linalg.solve(weak[:, leading], weak))


def _described(fit: Fit, columns: np.ndarray, direction: np.ndarray, alone: np.ndarray) -> UnidentifiedCombination:
    """Describe a (n,) direction of (n,) unknowns in typical sizes; `alone` (n,) are each value's own deviations."""
    problem, values = fit.problem, fit.values
    change = direction * problem.typical[columns]
    relative = np.where(
        values[columns] != 0.0, 100.0 * change / np.where(values[columns] != 0.0, values[columns], 1.0), 0.0
    )
    part = np.abs(direction) > MIN_DIRECTION_COMPONENT_SHARE * np.abs(direction).max()
    first = int(np.argmax(part & (np.abs(relative) > 0.0)))
    scale = relative[first] if relative[first] else change[first]
    changes, units = dict[str, float](), dict[str, str]()
    for k in np.flatnonzero(part).tolist():
        p = problem.columns[columns[k]].parameter
        whole = abs(relative[k]) > 0.0
        changes.setdefault(p.name, float((relative if whole else change)[k] / scale))
        units.setdefault(p.name, "%" if whole else p.unit)
    whole_direction = np.zeros(len(values))
    whole_direction[columns] = change / np.abs(direction).max()
    off = np.abs(direction) / np.linalg.norm(direction) * alone > 1.0
    unsure = frozenset(problem.columns[k].parameter.name for k in columns[off | part])
    return UnidentifiedCombination(changes, units, unsure, _settling(fit, whole_direction))


def _settling(fit: Fit, direction: np.ndarray) -> tuple[str, ...]:
    """States that no channel measures and that change along a (P,) direction of the values."""
    model = as_simulated_model(fit.problem.model)
    return model.states_sensitive_to(
        fit.problem.runs[0], *(fit.problem.theta(0, one) for one in (fit.values, direction))
    )
