r"""The motion of least cost inside the limits: an augmented Lagrangian over the coefficients of a Fourier series.

    min f(F(x))   subject to   c_i(x) <= 0

by the multiplier method of Powell, Hestenes and Rockafellar (Nocedal & Wright, Numerical Optimization, 2006, §17.3),
each step by L-BFGS. Limits hold on a grid of times. Distances to collisions are linearised about the
last motion at the postures near them, again in every round.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import ceil

import numpy as np
from scipy.optimize import minimize

from armdyn.excitation.columns import Columns
from armdyn.excitation.criteria import Criterion
from armdyn.excitation.room import Postures, Room
from armdyn.excitation.series import Motions, Series

GRID = 8.0
"""Instants per second at which information and torques are worked out: eight times the highest frequency."""
FINER = 3
"""Times as many for positions, speeds and accelerations, whose peaks cost little to look for."""
STEPS = (20, 40, 40, 30, 20, 15)
"""L-BFGS steps of the rounds; limits are worked in a little more sharply in each."""
STIFFNESS = 0.5
"""Of the first round's penalty: an excess of 5 % at 20 instants costs as much as a standard deviation 1 % larger."""
HARDER = 3.0
"""Growth of the penalty from round to round."""
NEAR = 0.3
"""Margin of a posture, see `Postures.margins`, from which its distance is watched."""
DEEPEST = -0.4
"""Margin below which a posture is too deep in what is forbidden to be led out of it."""
NUDGE = 1e-4
"""rad or m: of the finite differences of margins."""


@dataclass(frozen=True, eq=False)
class Cuts:
    """Half-spaces in which postures must stay: at instant `when` of the finer grid, normal . q >= bound.

    Attributes:
        when: (m,) indices.
        kind: (m,) which margin of `Postures`.
        normal: (m, nj).
        bound: (m,).
    """

    when: np.ndarray
    kind: np.ndarray
    normal: np.ndarray
    bound: np.ndarray


@dataclass(eq=False)
class _Multipliers:
    """Multipliers of the limits, by kind; those of cuts by instant and kind."""

    penalty: float
    kinematic: list[np.ndarray]
    torque: np.ndarray
    cuts: dict[tuple[int, int], float] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Design:
    """What to find a motion for.

    Attributes:
        columns: what is wanted and what else is unknown.
        series: of which motions are made.
        room: limits.
        postures: which are free.
    """

    columns: Columns
    series: Series
    room: Room
    postures: Postures

    @cached_property
    def time(self) -> np.ndarray:
        """(n,) s of one period, at which information and torques are worked out."""
        count = max(ceil(GRID * self.series.period), 4 * self.series.harmonics)
        return self.series.period * np.arange(count) / count

    @cached_property
    def functions(self) -> list[np.ndarray]:
        """(n, size) of position, velocity, acceleration at `time`."""
        return [self.series.functions(self.time, k) for k in range(3)]

    @cached_property
    def finer(self) -> list[np.ndarray]:
        """The same at instants `FINER` times as dense."""
        count = FINER * len(self.time)
        return [self.series.functions(self.series.period * np.arange(count) / count, k) for k in range(3)]

    @property
    def weight(self) -> float:
        """Samples of the recording per instant of the grid."""
        return self.columns.rate * self.series.seconds / len(self.time)

    @cached_property
    def unit(self) -> np.ndarray:
        """(nj,) size of a coefficient: a motion over half the range, or at full speed and the middle of the band."""
        reach = self.room.velocity * self.series.period / (np.pi * self.series.harmonics)
        return np.minimum(self.room.half, reach)

    def motion(self, x: np.ndarray) -> Motions:
        """The motion at `time` of (nj, size) coefficients."""
        return Motions(*(B @ x.T for B in self.functions))

    def information(self, x: np.ndarray) -> np.ndarray:
        """(P, P) Fisher information of a recording of the whole motion."""
        columns = self.columns.at(self.motion(x))
        X = columns.reshape(-1, columns.shape[2])
        return np.asarray(self.weight * X.T @ X)

    def excess(self, x: np.ndarray) -> float:
        """Largest share by which a limit of positions, speeds, accelerations or torques is exceeded."""
        torque = self.columns.torque(self.motion(x))
        over = [float(np.max(over)) for over in self._kinematic(x)[0]]
        return max(*over, float(np.max(np.abs(torque) / self.room.effort)) - 1.0)

    def _kinematic(self, x: np.ndarray) -> tuple[list[np.ndarray], list[np.ndarray]]:
        """(2, n, nj) shares beyond the limits of position, speed and acceleration, and (nj,) the sizes of 1."""
        room = self.room
        sizes = [room.half, room.velocity, room.acceleration]
        found = []
        for B, size, middle in zip(self.finer, sizes, (room.middle, 0.0, 0.0), strict=True):
            share = (B @ x.T - middle) / size
            found.append(np.stack([share - 1.0, -share - 1.0]))
        return found, sizes

    def optimised(
        self,
        start: np.ndarray,
        criterion: Criterion,
        rounds: int = len(STEPS),
        *,
        first: int = 0,
        done: Callable[[int], None] = lambda _: None,
    ) -> np.ndarray:
        """(nj, size) coefficients of a motion with less of a criterion, nearly inside the limits.

        Args:
            start: (nj, size).
            criterion: to be made small.
            rounds: of the multiplier method.
            first: the round to begin with.
            done: told the number of each round that is done.
        """
        shapes = [(2, len(self.finer[0]), len(start))] * 3
        held = _Multipliers(
            STIFFNESS * HARDER**first, [np.zeros(s) for s in shapes], np.zeros((2, len(self.time), len(start)))
        )
        x = start
        for k in range(first, rounds):
            cuts = self.cuts(x)
            objective = _Objective(self, criterion, held, cuts)
            found = minimize(
                objective, (x / self.unit[:, None]).ravel(), jac=True, method="L-BFGS-B",
                options={"maxiter": STEPS[min(k, len(STEPS) - 1)], "maxcor": 20},
            )  # fmt: skip
            x = self._shallow(x, found.x.reshape(start.shape) * self.unit[:, None])
            objective.learn(x)
            held.penalty *= HARDER
            done(k)
        return x

    def _shallow(self, before: np.ndarray, after: np.ndarray) -> np.ndarray:
        """The motion after a round, or one between, so that no posture is deep in what is forbidden.

        Linearised about a deep posture, the way out may lead on through an obstacle.
        """
        for share in (1.0, 0.5, 0.25, 0.1):
            x = before + share * (after - before)
            touching = (q for q in self.motion(x).q if not self.postures.free(q))  # quick, where distances are not
            if all(self.postures.margins(q).min() > DEEPEST for q in touching):
                return x
        return before

    def cuts(self, x: np.ndarray) -> Cuts:
        """Half-spaces about the postures that are near something forbidden."""
        when, kinds, normals, bounds = [], [], [], []
        finer = self.finer[0] @ x.T
        for i, q in enumerate(self.motion(x).q):
            margins = self.postures.margins(q)
            if margins.min() > NEAR:
                continue
            moved = np.array([self.postures.margins(q + step) for step in NUDGE * np.eye(len(q))])
            slopes = (moved - margins).T / NUDGE
            for k in range(FINER * i - FINER // 2, FINER * i + FINER // 2 + 1):
                here = finer[k % len(finer)]
                left = margins if k == FINER * i else self.postures.margins(here)
                for kind in np.flatnonzero(margins <= NEAR):
                    when.append(k % len(finer))
                    kinds.append(kind)
                    normals.append(slopes[kind])
                    bounds.append(slopes[kind] @ here - left[kind])
        nj = len(x)
        return Cuts(
            np.array(when, dtype=int), np.array(kinds, dtype=int), np.array(normals).reshape(-1, nj), np.array(bounds)
        )

    def narrower(self, limit: str, joint: int, factor: float) -> "Design":
        """The same with less room."""
        return replace(self, room=self.room.narrower(limit, joint, factor))


class _Objective:
    """Criterion and penalties with their gradient, over coefficients in units of `Design.unit`."""

    def __init__(self, design: Design, criterion: Criterion, held: _Multipliers, cuts: Cuts) -> None:
        self._design, self._criterion, self._held, self._cuts = design, criterion, held, cuts
        keys = zip(cuts.when.tolist(), cuts.kind.tolist(), strict=True)
        self._of_cuts = np.array([held.cuts.get(key, 0.0) for key in keys])

    def __call__(self, scaled: np.ndarray) -> tuple[float, np.ndarray]:
        design, held = self._design, self._held
        x = scaled.reshape(len(design.unit), -1) * design.unit[:, None]
        motion = design.motion(x)
        slopes = design.columns.with_slopes(motion)
        X = slopes.columns.reshape(-1, slopes.columns.shape[2])
        value, by_information = self._criterion(design.weight * X.T @ X)
        by_columns = (2.0 * design.weight * X @ by_information).reshape(slopes.columns.shape)
        effort = design.room.effort
        share = slopes.torque / effort
        cost, by_share = self._penalty(np.stack([share - 1.0, -share - 1.0]), held.torque)
        value += cost
        by_motion = list(slopes.gradient(by_columns, (by_share[0] - by_share[1]) / effort))
        gradient = sum((g.T @ B for g, B in zip(by_motion, design.functions, strict=True)), np.zeros_like(x))
        cost, by_left = self._penalty(self._left(x), self._of_cuts)
        value += cost
        gradient -= (by_left[:, None] * self._cuts.normal).T @ design.finer[0][self._cuts.when]
        over, sizes = design._kinematic(x)
        for B, beyond, size, multipliers in zip(design.finer, over, sizes, held.kinematic, strict=True):
            cost, by = self._penalty(beyond, multipliers)
            value += cost
            gradient += ((by[0] - by[1]) / size).T @ B
        return value, (gradient * design.unit[:, None]).ravel()

    def learn(self, x: np.ndarray) -> None:
        """Update the multipliers at the end of a round."""
        design, held = self._design, self._held
        motion = design.motion(x)
        share = design.columns.torque(motion) / design.room.effort
        held.torque = self._updated(np.stack([share - 1.0, -share - 1.0]), held.torque)
        over, _ = design._kinematic(x)
        held.kinematic = [self._updated(beyond, old) for beyond, old in zip(over, held.kinematic, strict=True)]
        fresh = self._updated(self._left(x), self._of_cuts)
        keys = zip(self._cuts.when.tolist(), self._cuts.kind.tolist(), strict=True)
        held.cuts = dict(zip(keys, fresh.tolist(), strict=True))

    def _left(self, x: np.ndarray) -> np.ndarray:
        """(m,) how far postures are beyond the cuts."""
        q = self._design.finer[0][self._cuts.when] @ x.T
        return np.asarray(self._cuts.bound - np.einsum("mj,mj->m", self._cuts.normal, q))

    def _penalty(self, beyond: np.ndarray, multipliers: np.ndarray) -> tuple[float, np.ndarray]:
        """(rho/2) sum max(0, c + lambda/rho)^2, and its derivatives by c."""
        rho = self._held.penalty
        active = np.maximum(beyond + multipliers / rho, 0.0)
        return 0.5 * rho * float(np.sum(active**2)), rho * active

    def _updated(self, beyond: np.ndarray, multipliers: np.ndarray) -> np.ndarray:
        return np.maximum(multipliers + self._held.penalty * beyond, 0.0)
