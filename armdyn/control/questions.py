"""Objective of a gripper's motion: to determine the length or several parameters, or to distinguish two rival models.

All but the first are criteria of one matrix. The load cell's signals g are the derivatives of its reading with respect
to the wanted parameters and to the nuisance ones; for two rivals, the wanted signal is the difference of their
readings, and the nuisance signals are the derivatives with respect to the rival's unknowns. With the Gram matrix G of
the signals in blocks, w wanted and n nuisance, the information on the wanted ones is the Schur complement

    S = G_ww - G_wn G_nn^-1 G_nw :

It is the Fisher information on the wanted parameters with the others unknown (Kay, Estimation Theory, 1993, §3.7), and
for rivals the rise of chi2 when the rival is refitted. Either log det S is maximised (D-optimal), or log tr S^-1 is
minimised (A-optimal), or log d' S^-1 d, the variance in one direction d (Pukelsheim, Optimal Design of Experiments,
2006, ch. 6).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Any

import casadi as ca
import numpy as np

from armdyn.errors import InputError, UnknownNameError
from armdyn.pendulum.model import PendulumModel


class Criterion(Enum):
    """Criterion of the information matrix that a motion minimises.

    `DETERMINANT` is D-optimality, `INVERSE` A-optimality (trace of the inverse), `DIRECTION` the variance in one
    direction of the parameters, and `FLOOR` a cost of the length alone at each moment.
    """

    DETERMINANT = "determinant"
    INVERSE = "inverse"
    DIRECTION = "direction"
    FLOOR = "floor"


@dataclass(frozen=True)
class MotionObjective:
    """Objective of a motion; `information_objective` and `separation_objective` make one.

    Attributes:
        wanted: parameters to determine; empty for rivals.
        nuisance: further unknown parameters; for rivals, those of the rival model.
        criterion: criterion of the information.
        direction: weights of the wanted parameters, each in its typical size, for the criterion of one direction.
        rivals: whether the objective is to distinguish two models.
    """

    wanted: tuple[str, ...]
    nuisance: tuple[str, ...] = ()
    criterion: Criterion = Criterion.DETERMINANT
    direction: tuple[float, ...] = ()
    rivals: bool = False

    @property
    def logarithmic(self) -> bool:
        """Whether the cost is a logarithm of the summed information, rather than a cost at each moment."""
        return self.criterion is not Criterion.FLOOR

    @property
    def parameters(self) -> tuple[str, ...]:
        """Parameters with respect to which readings are differentiated."""
        return (*self.wanted, *self.nuisance)

    @property
    def differentiated_parameters(self) -> tuple[tuple[str, ...], ...]:
        """Parameters with respect to which readings are differentiated, for each model."""
        return ((), self.nuisance) if self.rivals else (self.parameters,)

    @property
    def wanted_signal_count(self) -> int:
        """Number of signals on the wanted parameters, which precede the nuisance signals."""
        return 1 if self.rivals else len(self.wanted)

    @property
    def signal_count(self) -> int:
        """Number of all signals: wanted and nuisance."""
        return self.wanted_signal_count + len(self.nuisance)

    @property
    def cache_key(self) -> str:
        """Identifier of the objective, for the cache of compiled code."""
        return f"_{self.criterion.value}_{self.signal_count}" if self.logarithmic else ""

    def check(self, models: Sequence[PendulumModel]) -> None:
        """Refuse parameters that a model lacks.

        Raises:
            UnknownNameError: a model lacks a parameter.
        """
        for name in self.parameters:
            if name not in models[-1].physics_names:
                raise UnknownNameError("parameter", name, models[-1].physics_names)

    def signals(self, readings: Sequence[Any], slopes: Sequence[Any], scales: Any) -> Any:
        """(k,) signals: derivatives of the force by the parameters, over its noise, the wanted ones first.

        Args:
            readings: force of every model, N.
            slopes: (1, m) derivatives of each model's force by `differentiated_parameters`.
            scales: (m + 1,) typical size of every parameter, followed by the noise of the force.
        """
        if not self.logarithmic:
            return slopes[0]
        typical, noise = scales[:-1], scales[-1]
        scaled = (slopes[-1].T * typical) / noise
        return ca.vertcat((readings[0] - readings[1]) / noise, scaled) if self.rivals else scaled

    def criterion_function(self) -> ca.Function:
        """The criterion as a function ``G (k, k) -> cost, F (k, k)`` of the Gram matrix G, with F = d cost/dG."""
        k, wanted = self.signal_count, self.wanted_signal_count
        if not self.logarithmic:
            return ca.Function("criterion", [ca.SX(0, 0)], [0, ca.SX(0, 0)])
        G = ca.SX.sym("G", k, k)
        S = ca.SX(G)
        for last in reversed(range(wanted, k)):  # eliminate the nuisance signals one after the other
            S = S[:last, :last] - S[:last, last] @ S[last, :last] / S[last, last]
        if self.criterion is Criterion.DETERMINANT:
            cost = 0
            for last in reversed(range(wanted)):  # the determinant is the product of the pivots
                cost -= ca.log(S[last, last])
                S = S[:last, :last] - S[:last, last] @ S[last, :last] / S[last, last]
        else:
            d = ca.DM(np.diag(np.ones(wanted)) if self.criterion is Criterion.INVERSE else np.array(self.direction))
            cost = ca.log(ca.trace(d.T @ ca.solve(S, ca.SX(d))))
        return ca.Function("criterion", [G], [cost, ca.densify(ca.reshape(ca.gradient(cost, ca.vec(G)), k, k))])


LENGTH_OBJECTIVE = MotionObjective(("length",), criterion=Criterion.FLOOR)
"""Objective to determine the string's length alone, with a cost at each moment (Ansari & Murphey 2016)."""


def information_objective(
    wanted: Sequence[str],
    nuisance: Sequence[str] = (),
    criterion: Criterion = Criterion.DETERMINANT,
    direction: Sequence[float] = (),
) -> MotionObjective:
    """Objective to determine the `wanted` parameters, while the `nuisance` parameters are unknown too.

    Raises:
        InputError: no parameter is wanted, one is given twice, or the direction does not fit.
    """
    if not wanted or len({*wanted, *nuisance}) < len(wanted) + len(nuisance):
        raise InputError("name at least one parameter that is wanted, and none twice")
    if criterion is Criterion.FLOOR:
        raise InputError("the floor is for the length alone: choose determinant, inverse or direction")
    if (criterion is Criterion.DIRECTION) != bool(direction) or (direction and len(direction) != len(wanted)):
        raise InputError("the criterion 'direction' needs one weight for each parameter of interest")
    return MotionObjective(tuple(wanted), tuple(nuisance), criterion, tuple(float(d) for d in direction))


def separation_objective(unknowns: Sequence[str]) -> MotionObjective:
    """Objective to distinguish two models, for any values of the rival model's `unknowns`."""
    return MotionObjective((), tuple(unknowns), rivals=True)
