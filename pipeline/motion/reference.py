"""Offline smoothing: find the feasible motion along the line that deviates least from a reference motion."""

from dataclasses import replace

import clarabel
import numpy as np
from scipy import sparse

from armdyn.errors import InputError, TaskFailedError
from pipeline.motion.limits import LineLimits
from pipeline.motion.planner import LinePlanner
from pipeline.motion.smoother import LineSmoother
from pipeline.motion.trajectory import LineState, LineTrajectory
from urdf.robot import Array

FIRST_GUESS_SHARE_OF_LIMITS = 0.95
"""Share of the limits that the first guess uses, because its jerk may change within a sample."""
MAX_LINEARISATION_ROUNDS = 12
"""Largest number of rounds; in each, the limits are linearised at the last solution."""
CONVERGED_POSITION_CHANGE = 1e-4
"""Change of the positions between two rounds below which the iteration has converged [m]."""
MAX_POSITION_CHANGE_PER_ROUND = 0.05
"""Largest change of a position in one round, for which the linearised limits are accurate [m]."""
SPEED_DEVIATION_WEIGHT = 0.1
"""Weight of a squared deviation of the speed in the cost [s^2/m^2]; the weight of the position is 1/m^2."""
JERK_WEIGHT = 1e-12
"""Weight of the squared jerk in the cost, which makes parts without demands smooth [s^6/m^2]."""
TRUST_SHRINK_ROUND_AND_FACTOR = (3, 0.4)
"""Number of rounds after which the trust region shrinks, and the factor by which each further round shrinks it; this
prevents oscillations."""


def smooth_reference(
    s_ref: Array,
    v_ref: Array,
    dt: float,
    limits: LineLimits,
    start: LineState | None = None,
    end: LineState | None = None,
) -> LineTrajectory:
    """Find the feasible motion nearest to a reference, by a sequence of quadratic programs.

    With a jerk ``j_k`` that is constant between samples, minimises
    ``sum_k (s_k - s_ref_k)^2 + w_v (v_k - v_ref_k)^2 + w_j j_k^2`` under the limits of range, speed, acceleration
    and jerk. Limits that depend on the position are linearised at the last solution until it converges. Between samples
    the speed is bounded by its Bézier points.

    Args:
        s_ref: reference positions, (n,) [m].
        v_ref: reference speeds, (n,) [m/s].
        dt: time between samples [s].
        limits: limits along the line.
        start: first state; by default that of the reference, or the nearest one from which the tool can stop.
        end: last state; by default any state.

    Returns:
        The motion, sampled at the times of the reference.

    Raises:
        InputError: the reference is not finite or too short, or its arrays have different shapes.
        TaskFailedError: no motion within the limits leads from start to end.
    """
    s_ref, v_ref = np.asarray(s_ref, dtype=float), np.asarray(v_ref, dtype=float)
    if s_ref.ndim != 1 or s_ref.shape != v_ref.shape or s_ref.size < 4:
        raise InputError("reference: positions and speeds must be one-dimensional, equally long, and at least 4")
    if not (np.all(np.isfinite(s_ref)) and np.all(np.isfinite(v_ref)) and np.isfinite(dt) and dt > 0.0):
        raise InputError("reference: positions, speeds and the time step must be finite, the step greater than 0")
    easy = replace(
        limits.scaled(FIRST_GUESS_SHARE_OF_LIMITS, FIRST_GUESS_SHARE_OF_LIMITS),
        jerk=FIRST_GUESS_SHARE_OF_LIMITS * limits.jerk,
    )
    planner = LinePlanner(easy)
    if start is None:
        start = planner.nearest_stoppable_state(LineState(float(s_ref[0]), float(v_ref[0])))
    # The headroom covers errors of the linearisation, and what happens between samples.
    program = _Program(s_ref, v_ref, dt, limits.limits_reduced_for_planning(), start, end)
    s, v, a = _smoothed_online(s_ref, v_ref, dt, limits if planner.stop(start) is None else easy, start)
    for k in range(MAX_LINEARISATION_ROUNDS):
        before, trust = (
            s,
            MAX_POSITION_CHANGE_PER_ROUND
            * TRUST_SHRINK_ROUND_AND_FACTOR[1] ** max(k - TRUST_SHRINK_ROUND_AND_FACTOR[0], 0),
        )
        # Where the first motion misses the end, the quadratic program may have to leave the trust region.
        solved = program.solve(s, v, trust) or program.solve(s, v, np.inf)
        if solved is None:
            raise TaskFailedError(
                "reference: no motion within the limits of the line joins its start and its end: give it more time, "
                "or start and end slower"
            )
        s, v, a = solved
        if np.max(np.abs(s - before)) < CONVERGED_POSITION_CHANGE:
            break
    motion = LineTrajectory(np.linspace(0.0, dt * (s.size - 1), s.size), s, v, a)
    if not limits.respected_by(s, v, a, 1e-9):
        raise TaskFailedError(
            "reference: the limits of the line change too fast to follow: give the motion more time, or smooth the "
            "limits"
        )
    return motion


def _smoothed_online(
    s_ref: Array, v_ref: Array, dt: float, limits: LineLimits, start: LineState
) -> tuple[Array, Array, Array]:
    """First guess for the quadratic program: the reference smoothed by the online smoother."""
    smoother = LineSmoother(limits, dt, start)
    a_ref = np.gradient(v_ref, dt)
    targets = [LineState(*map(float, row)) for row in zip(s_ref, v_ref, a_ref, strict=True)]
    states = [smoother.state, *(smoother.update(targets[k : k + 50]) for k in range(1, len(targets)))]
    s, v, a = np.array(states).T
    return s, v, a


class _Program:
    """The quadratic program in (s, v, a, j); only the linearised limits change between rounds."""

    def __init__(
        self, s_ref: Array, v_ref: Array, dt: float, limits: LineLimits, start: LineState, end: LineState | None
    ) -> None:
        n = self._n = s_ref.size
        self._limits, self._dt = limits, dt
        one = sparse.identity(n, format="csr")
        none = sparse.csr_matrix((n, n))
        # Blocks of columns: s, v, a of every sample, then the jerk after it; the last jerk is 0.
        self._s, self._v, self._a, self._j = (
            sparse.hstack([one if k == i else none for k in range(4)], format="csr") for i in range(4)
        )
        cost = np.concatenate([np.ones(n), np.full(n, SPEED_DEVIATION_WEIGHT), np.zeros(n), np.full(n, JERK_WEIGHT)])
        self._quadratic = sparse.diags(2.0 * cost, format="csc")
        self._linear = np.concatenate([-2.0 * s_ref, -2.0 * SPEED_DEVIATION_WEIGHT * v_ref, np.zeros(2 * n)])
        now, after = slice(0, n - 1), slice(1, n)
        s, v, a, j = self._s, self._v, self._a, self._j
        rows = [
            s[after] - s[now] - dt * v[now] - dt**2 / 2.0 * a[now] - dt**3 / 6.0 * j[now],
            v[after] - v[now] - dt * a[now] - dt**2 / 2.0 * j[now],
            a[after] - a[now] - dt * j[now],
            j[-1],
        ]
        right = [np.zeros(3 * (n - 1) + 1)]
        for state, at in ((start, 0), (end, -1)):
            if state is not None:
                rows += [s[at], v[at], a[at]]
                right.append(np.array(state))
        self._equal, self._equal_right = sparse.vstack(rows, format="csc"), np.concatenate(right)

    def solve(self, s: Array, v: Array, trust: float) -> tuple[Array, Array, Array] | None:
        """Solve one round, with the limits linearised at positions s and speeds v; None without a solution."""
        limits, n = self._limits, self._n
        speed, speed_slope = _linearised(limits.s, limits.speed, s)
        strength, strength_slope = _linearised(limits.s, limits.acceleration, s)
        # Between samples the speed is a parabola and the position a cubic; both stay among their Bézier points.
        v_between, s_between = self._v + self._dt / 2.0 * self._a, self._s + self._dt / 3.0 * self._v
        s_before_next = self._s[1:] - self._dt / 3.0 * self._v[1:]
        halfway = np.clip(s + self._dt / 2.0 * v, limits.s_min, limits.s_max)
        speed_between, slope_between = _linearised(limits.s, limits.speed, halfway)
        rows = [self._s, -self._s, s_between, -s_between, s_before_next, -s_before_next]
        bounds = [np.minimum(limits.s_max, s + trust), -np.maximum(limits.s_min, s - trust)]
        bounds += [np.full(n, limits.s_max), np.full(n, -limits.s_min)]
        bounds += [np.full(n - 1, limits.s_max), np.full(n - 1, -limits.s_min)]
        for row, bound, slope in (
            (self._v, speed, speed_slope),
            (v_between, speed_between, slope_between),
            (self._a, strength, strength_slope),
            (self._j, np.full(n, limits.jerk), np.zeros(n)),
        ):
            # |row x| <= bound + slope (s - s_before)
            moving = sparse.diags(slope) @ self._s
            rows += [row - moving, -row - moving]
            bounds += 2 * [bound - slope * s]
        matrix = sparse.vstack([self._equal, *rows], format="csc")
        right = np.concatenate([self._equal_right, *bounds])
        equal = self._equal.shape[0]
        cones = [clarabel.ZeroConeT(equal), clarabel.NonnegativeConeT(right.size - equal)]
        settings = clarabel.DefaultSettings()
        settings.verbose = False
        solution = clarabel.DefaultSolver(self._quadratic, self._linear, matrix, right, cones, settings).solve()
        if solution.status not in (clarabel.SolverStatus.Solved, clarabel.SolverStatus.AlmostSolved):
            return None
        x = np.array(solution.x)
        return x[:n], x[n : 2 * n], x[2 * n : 3 * n]


def _linearised(nodes: Array, value: Array, at: Array) -> tuple[Array, Array]:
    """Values and slopes at positions `at` of a function that is linear between nodes."""
    k = np.clip(np.searchsorted(nodes, at, side="right") - 1, 0, nodes.size - 2)
    slope = (value[k + 1] - value[k]) / (nodes[k + 1] - nodes[k])
    return value[k] + slope * (at - nodes[k]), slope
