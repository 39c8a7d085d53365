r"""The regression of all joints together, from which the gains of their drives follow.

The equation of a joint, of kind k, is linear in w = (c_k, its own coefficients, c_k m), so that its squared error is
known from the sums X'X, X'y and y'y over its samples for any values (armdyn/estimation/equations.py). It is minimised
by the kernel's descent, with the derivatives dw/d(c, m, own).
"""

from collections.abc import Mapping, Sequence

import numpy as np

from armdyn.arm.drive_gain.joint_readings import (
    JOINT_OWN_COLUMN_COUNT,
    LOAD_COLUMNS,
    LOAD_FRICTION_COLUMN,
    NONNEGATIVE_COLUMN_MASK,
    JointReadings,
    ridge,
    variance,
)
from armdyn.arm.rigid import INERTIAL_PARAMETERS_PER_BODY
from armdyn.effects.joint import payload
from armdyn.estimation.descent import DescentSettings, descend
from armdyn.estimation.equations import NormalEquations
from armdyn.estimation.expansion import BoundedExpansion
from armdyn.recording.units import KnownQuantity

GAIN_STD_FACTOR_FOR_MODEL_ERROR = 3.0
"""Factor on the standard deviations for frictions that no column describes: gains of a Go2's thighs had errors of 28 %
with a standard deviation of 2 to 3 %; the reported one of an SO-101 hardly changes by it."""
UNKNOWN_LOAD_MASS_STD_KG, UNKNOWN_LOAD_DISTANCE_STD_METRES = (
    payload.quantities["mass"].typical,
    payload.quantities["x"].spread or 0.0,
)
UNKNOWN_LOAD_PRIOR_STDS = UNKNOWN_LOAD_MASS_STD_KG * UNKNOWN_LOAD_DISTANCE_STD_METRES ** np.array(
    [0, 1, 1, 1, 2, 2, 2, 2, 2, 2]
)
"""Standard deviations of an unknown load's mass, first and second moments, about the frame's origin."""
FRICTION_PER_LOAD_PRIOR_STD = 0.1
"""Standard deviation of the friction per load: without it, a joint that lifts as much as it lowers determines no gain,
because friction could have any size."""
MIN_RESIDUAL_REDUCTION_BY_LOAD = 1.5
"""Factor by which a load must reduce the residual of parts of the recordings that were not fitted, to be assumed; with
it, the gain is less certain. Of 40 generated arms, those with a load had 6.3 and more, those without at most 1.05."""
GAIN_DESCENT = DescentSettings(most_steps=6, tolerance=1e-6, uphill=True)
"""Steps to the minimum: six are enough, of the product of 1/k and the load."""
LEAST_COMPLIANCE_SHARE = 0.1
"""Share of 1/k that a step leaves of it at least."""
_OWN = JOINT_OWN_COLUMN_COUNT - 1


def compliances(
    rows: Sequence[JointReadings], gains: Mapping[str, KnownQuantity | None]
) -> dict[str, tuple[float, float, float]]:
    """By kind of drive: 1/k from all joints together, its standard deviation, and that with an unknown load.

    A load is assumed where it predicts parts of the recordings that were not fitted. The differences of the values
    between the parts are errors as much as noise is, because no model is complete (jackknife, Efron 1979).
    """
    parts = 1 + max(int(row.part[-1]) for row in rows)
    equations = [row.equations(parts, GAIN_STD_FACTOR_FOR_MODEL_ERROR) for row in rows]
    held = np.flatnonzero(sum(each.count for each in equations)).tolist()
    fits = [[_JointFit(rows, equations, gains, carried=c, left_out=part) for part in held] for c in (False, True)]
    costs = [sum(fit.cost_of(part) for fit, part in zip(each, held, strict=True)) for each in fits]
    carried = costs[0] > MIN_RESIDUAL_REDUCTION_BY_LOAD * costs[1]
    whole = _JointFit(rows, equations, gains, carried=carried, left_out=None)
    jackknife = np.sqrt((len(held) - 1) * np.var([fit.compliance for fit in fits[carried]], axis=0))
    stds = np.hypot([whole.std, whole.loaded_std], jackknife)
    return {k: (c, *both) for k, c, both in zip(gains, whole.compliance.tolist(), stds.T.tolist(), strict=True)}


class _JointFit:
    """Regression of all joints together, without the part `left_out` of the recordings.

    Unknowns are 1/k of each kind, the ten parameters of the load, and six of each joint.

    Attributes:
        compliance: (kinds,) 1/k.
        std: (kinds,) its standard deviations.
        loaded_std: (kinds,) those with a usual load, where none is `carried`.
    """

    def __init__(
        self,
        rows: Sequence[JointReadings],
        equations: Sequence[NormalEquations],
        gains: Mapping[str, KnownQuantity | None],
        *,
        carried: bool,
        left_out: int | None,
    ) -> None:
        self._equations, self._carried, self._gains = equations, carried, list(gains.values())
        self._kind = [list(gains).index(row.drive) for row in rows]
        count = len(gains)
        self._load = slice(count, count + INERTIAL_PARAMETERS_PER_BODY)
        self._first = self._load.stop
        fitted = np.flatnonzero(np.arange(len(equations[0].count)) != left_out)
        self._sums = [each.weighted(np.ones(len(fitted)), fitted) for each in equations]
        self._square = sum(float(each.square[fitted].sum()) for each in equations)
        start = np.zeros(self._first + _OWN * len(rows))
        start[:count] = [_first_guess(rows, kind, gain) for kind, gain in gains.items()]
        positive = NONNEGATIVE_COLUMN_MASK[LOAD_COLUMNS] + NONNEGATIVE_COLUMN_MASK[1:JOINT_OWN_COLUMN_COUNT] * len(rows)
        self.lower = np.append(np.zeros(count), np.where(positive, 0.0, -np.inf))
        self.upper = np.full(len(start), np.inf)
        found = descend(self, start, GAIN_DESCENT)
        self._values, self.compliance = found.values, found.values[:count]
        # 1/k would go on to nothing where its next step ends on its bound.
        step, _ = found.expansion.step(self.lower - self._values, self.upper - self._values, 0.0)
        free = self._values + step > self.lower
        self.std = self.loaded_std = np.sqrt(variance(self._information(self._values, carried), free)[:count])
        if not carried:
            A = self._information(self._values, carried=True)
            A[self._load, self._load] += np.diag(UNKNOWN_LOAD_PRIOR_STDS**-2.0)
            free[self._load] = True
            self.loaded_std = np.sqrt(variance(A, free)[:count])

    def value(self, values: np.ndarray, limit: float) -> float:
        """Half the squared residuals, in units of the noise, with the priors of the last expansion."""
        del limit
        each = zip(self._sums, self._coefficients(values), strict=True)
        fall = sum(float(w @ (2.0 * slope - gram @ w)) for (gram, slope), w in each)
        return 0.5 * (self._square - fall + float(self._prior @ (values - self._centre) ** 2))

    def expand(self, values: np.ndarray) -> BoundedExpansion:
        """Expand the cost; the prior of the friction per load is relative to the gain that is found."""
        self.lower[: len(self._gains)] = LEAST_COMPLIANCE_SHARE * values[: len(self._gains)]
        prior, centre = self._priors(values)
        A = self._information(values, self._carried)
        if not self._carried:
            A[self._load, self._load] += np.eye(INERTIAL_PARAMETERS_PER_BODY)
        little = ridge(A)
        self._prior, self._centre = prior + little, centre
        gradient = self._prior * (values - centre)
        each = zip(self._sums, self._coefficients(values), range(len(self._sums)), strict=True)
        for (gram, slope), w, k in each:
            gradient += self._derivatives(k, values, self._carried).T @ (gram @ w - slope)
        return BoundedExpansion(self.value(values, np.inf), gradient, A + np.diag(little))

    def _priors(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(unknowns,) inverse variances and means of the priors: stated gains, and frictions per load."""
        prior, centre = np.zeros((2, len(values)))
        for i, gain in enumerate(self._gains):
            if gain is not None:
                prior[i], centre[i] = (gain.value**2 / (gain.std or 1e-6 * gain.value)) ** 2, 1.0 / gain.value
        for k, kind in enumerate(self._kind):
            friction = self._first + _OWN * k + LOAD_FRICTION_COLUMN - 1
            prior[friction] = (FRICTION_PER_LOAD_PRIOR_STD * values[kind]) ** -2.0
        return prior, centre

    def _information(self, values: np.ndarray, carried: bool) -> np.ndarray:
        """(unknowns, unknowns) information matrix of the readings and the priors at (unknowns,) values."""
        A = np.diag(self._priors(values)[0])
        for k, (gram, _) in enumerate(self._sums):
            T = self._derivatives(k, values, carried)
            A += T.T @ gram @ T
        return A

    def _coefficients(self, values: np.ndarray) -> list[np.ndarray]:
        """(17,) coefficients of each joint's columns."""
        own = values[self._first :].reshape(-1, _OWN)
        c = values[self._kind]
        return [np.concatenate([[c[k]], own[k], c[k] * values[self._load]]) for k in range(len(c))]

    def _derivatives(self, k: int, values: np.ndarray, carried: bool) -> np.ndarray:
        """(17, unknowns) derivatives of a joint's coefficients; without those by the load if none is `carried`."""
        T, i = np.zeros((LOAD_COLUMNS.stop, len(values))), self._kind[k]
        T[0, i], T[LOAD_COLUMNS, i] = 1.0, values[self._load]
        if carried:
            T[LOAD_COLUMNS, self._load] = values[i] * np.eye(INERTIAL_PARAMETERS_PER_BODY)
        T[1:JOINT_OWN_COLUMN_COUNT, self._first + _OWN * k : self._first + _OWN * (k + 1)] = np.eye(_OWN)
        return T

    def cost_of(self, part: int) -> float:
        """Half of the sum of squared residuals in a part of the recordings, in units of the noise."""
        each = zip(self._equations, self._coefficients(self._values), strict=True)
        return 0.5 * sum(float(equations.squared_error(w, np.array([part]))[0]) for equations, w in each)


def _first_guess(rows: Sequence[JointReadings], kind: str, gain: KnownQuantity | None) -> float:
    """1/k of a kind: as stated, or the weighted mean of its joints' own values."""
    if gain is not None:
        return 1.0 / gain.value
    alone = [row.compliance for row in rows if row.drive == kind and row.compliance[0] > 0.0]
    weights = [1.0 / max(squared, 1e-300) for _, squared in alone]
    return float(np.average([c for c, _ in alone], weights=weights)) if alone and sum(weights) > 0.0 else 1.0
