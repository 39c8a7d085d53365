r"""Projection-based trajectory optimisation of a discrete system with one control.

A curve is made a trajectory by feedback (the projection), the descent direction is the solution of a linear-quadratic
problem along it, and the step is projected again:

    P(xi): u_k = mu_k - K_k (s_k - alpha_k),  s_{k+1} = f(s_k, u_k);      zeta = argmin Dg zeta + 1/2 D2g(zeta, zeta).

With the cost's own Hessian (Gauss-Newton at the end point) it is a quasi-Newton step; with the costate-weighted
curvature of f added it is Newton's. It stops when the derivative of the cost along the direction is below `tolerance`.
(Hauser, IFAC 2002; discrete: Schultz, Johnson & Murphey, IEEE CASE 2015.)
"""

from dataclasses import dataclass
from time import perf_counter
from typing import NamedTuple

import casadi as ca
import numpy as np

from armdyn.codegen import PreallocatedFunction, compile_functions
from armdyn.errors import TaskFailedError

FIRST_QUASI_NEWTON_STEPS = 2
"""Number of quasi-Newton steps before Newton's method, which from a guess at rest can end at a motion without a
swing."""
ARMIJO_SHARE = 1e-4
MIN_LINE_SEARCH_STEP = 2.0**-20


@dataclass(frozen=True)
class DiscreteOptimalControlProblem:
    """Optimal control problem in discrete time: minimise ``sum_k l(s_k, u_k) + m(s_N)`` with ``s_{k+1} = f(s_k, u_k)``.

    Quasi-Newton steps use the Gauss-Newton Hessian of squared residuals, Newton steps the exact one.

    The argument p contains every number that may change between solutions.

    Attributes:
        name: identifier, used for the cache of compiled code.
        states: number of states n.
        parameters: number of entries of p.
        step: ``(s, u, t, p) -> s_next``.
        linearised: ``(s, u, t, p, s_next) -> A (n, n), B (n,)``.
        curvature: ``(s, u, t, p, s_next, costate) -> (n+1, n+1)``.
        running: ``(s, u, t, p) -> ()``, convex, with a positive second derivative in u.
        running_residual: ``(s, u, t, p) -> (r,)``; |residual|^2 / 2 is added to `running`, convex or not.
        terminal_residual: ``(s, t, p) -> (m,)``; the cost at the end is m = |residual|^2 / 2.
    """

    name: str
    states: int
    parameters: int
    step: ca.Function
    linearised: ca.Function
    curvature: ca.Function
    running: ca.Function
    running_residual: ca.Function
    terminal_residual: ca.Function


@dataclass(frozen=True)
class Solution:
    """A locally optimal trajectory of a discrete problem.

    Attributes:
        states: (n, N+1) states at the nodes.
        controls: (N,) controls.
        cost: value of the cost.
        iterations: the cost after each step.
        seconds: computing time, s.
    """

    states: np.ndarray
    controls: np.ndarray
    cost: float
    iterations: tuple[float, ...]
    seconds: float


class ProjectionOptimizer:
    """Solves a `DiscreteOptimalControlProblem` with a fixed number of steps for any start states and parameters."""

    def __init__(self, problem: DiscreteOptimalControlProblem, steps: int) -> None:
        self.problem, self.steps = problem, steps
        built = compile_functions(
            f"projection_{problem.name}",
            {
                "project": _projection(problem, steps),
                "backward": _backward(problem, steps),
                "forward": _forward(problem.states, steps),
            },
        )
        self._project, self._backward, self._forward = (
            PreallocatedFunction(built[k]) for k in ("project", "backward", "forward")
        )

    def solve(
        self,
        initial: np.ndarray,
        times: np.ndarray,
        parameters: np.ndarray,
        guess: np.ndarray | None = None,
        *,
        tolerance: float = 1e-6,
        most_iterations: int = 60,
    ) -> Solution:
        """Minimise the cost, starting from the trajectory with the controls `guess`.

        Args:
            initial: (n,) state at step 0.
            times: (N+1,) node times, s.
            parameters: values of p.
            guess: (N,) controls; zero by default.
            tolerance: bound on the magnitude of the cost's derivative along the descent direction.
            most_iterations: largest number of iterations; a descent that needs more has not converged.

        Raises:
            TaskFailedError: the optimiser did not converge, or the states became infinite.
        """
        started = perf_counter()
        n, N = self.problem.states, self.steps
        start = np.asarray(initial, dtype=float)[:, None]
        case = np.asarray(times)[None, :N], float(times[N]), parameters

        def project(states: np.ndarray, controls: np.ndarray, gains: np.ndarray) -> _Trajectory:
            """Project a curve onto a trajectory, by feedback."""
            x, u, cost = self._project(start[:, 0], states[:, :-1], controls, gains, *case)
            return _Trajectory(np.hstack([start, x]), u.copy(), float(cost[0, 0]))

        def quadratic_model(newton: bool) -> _QuadraticModel:
            outputs = self._backward(at.states, at.controls, *case, float(newton))
            K, k, H, A, B = (a.copy() for a in outputs)
            return _QuadraticModel(K, k, A, B, -float(np.sum(k * k * H)), float(H.min()))

        controls = np.zeros((1, N)) if guess is None else np.asarray(guess, dtype=float).reshape(1, N)
        at = project(np.tile(start, (1, N + 1)), controls, np.zeros((n, N)))
        history: list[float] = []
        while len(history) < most_iterations:
            newton = len(history) >= FIRST_QUASI_NEWTON_STEPS
            model = quadratic_model(newton)
            if newton and not (model.least_curvature > 0 and np.isfinite(model.slope)):
                newton = False
                model = quadratic_model(newton)
            if not np.isfinite(model.slope):
                raise TaskFailedError("the plan left the finite numbers: check the length, the mass and the horizon")
            if -model.slope < tolerance:
                return Solution(at.states, at.controls[0], at.cost, tuple(history), perf_counter() - started)
            dz, dv = (a.copy() for a in self._forward(model.A, model.B, model.gains, model.feedforward))
            size = 1.0
            while size >= MIN_LINE_SEARCH_STEP:
                trial = project(at.states + size * dz, at.controls + size * dv, model.gains)
                if np.isfinite(trial.cost) and trial.cost <= at.cost + ARMIJO_SHARE * size * model.slope:
                    break
                size /= 2
            else:
                raise TaskFailedError(
                    f"the optimiser stalled at a cost derivative of {model.slope:.1e} after {len(history)} steps: "
                    "the target may be out of reach"
                )
            at = trial
            history.append(at.cost)
        raise TaskFailedError(
            f"the optimiser did not converge in {most_iterations} steps (cost derivative {model.slope:.1e})"
        )


class _Trajectory(NamedTuple):
    states: np.ndarray  # (n, N+1)
    controls: np.ndarray  # (1, N)
    cost: float


class _QuadraticModel(NamedTuple):
    """The linear-quadratic problem along a trajectory, solved backwards."""

    gains: np.ndarray  # (n, N)
    feedforward: np.ndarray  # (1, N)
    A: np.ndarray  # (n, n N), last step first
    B: np.ndarray  # (n, N), last step first
    slope: float
    least_curvature: float


def _projection(problem: DiscreteOptimalControlProblem, steps: int) -> ca.Function:
    n, m = problem.states, problem.parameters
    s, cost, alpha, mu, K, t, p = (
        ca.SX.sym(name, *shape)
        for name, shape in (
            ("s", (n,)), ("J", ()), ("alpha", (n,)), ("mu", ()), ("K", (n,)), ("t", ()), ("p", (m,)),
        )
    )  # fmt: skip
    u = mu - ca.dot(K, s - alpha)
    following = problem.step(s, u, t, p)
    running = problem.running(s, u, t, p) + ca.sumsqr(problem.running_residual(s, u, t, p)) / 2
    stage = ca.Function("stage", [s, cost, alpha, mu, K, t, p], [following, cost + running, u])
    over = stage.mapaccum("over", steps, 2)
    s0, te, P = ca.MX.sym("s0", n), ca.MX.sym("te"), ca.MX.sym("p", m)
    curves = [
        ca.MX.sym("alpha", n, steps),
        ca.MX.sym("mu", 1, steps),
        ca.MX.sym("K", n, steps),
        ca.MX.sym("t", 1, steps),
    ]
    X, J, U = over(s0, 0, *curves, ca.repmat(P, 1, steps))
    residual = problem.terminal_residual(X[:, -1], te, P)
    return ca.Function("project", [s0, *curves, te, P], [X, U, J[-1] + ca.sumsqr(residual) / 2])


def _backward(problem: DiscreteOptimalControlProblem, steps: int) -> ca.Function:
    """Riccati recursion: gain K, feed-forward k and curvature H of the control at every node."""
    n, m = problem.states, problem.parameters
    V, r = ca.SX.sym("V", n, n), ca.SX.sym("r", n)
    s, u, following = ca.SX.sym("s", n), ca.SX.sym("u"), ca.SX.sym("s_next", n)
    t, p, newton = ca.SX.sym("t"), ca.SX.sym("p", m), ca.SX.sym("newton")
    z = ca.vertcat(s, u)
    A, B = problem.linearised(s, u, t, p, following)
    second, gradient = ca.hessian(problem.running(s, u, t, p), z)
    squares, square_gradient, square_curvature = _squares(problem.running_residual(s, u, t, p), z)
    gradient = gradient + square_gradient
    second = second + squares + newton * (square_curvature - squares + problem.curvature(s, u, t, p, following, r))
    VA, VB = V @ A, V @ B
    H = second[n, n] + ca.dot(B, VB)
    slope = gradient[n] + ca.dot(B, r)
    K = (second[n, :n].T + VA.T @ B) / H
    k = slope / H
    V_before = second[:n, :n] + A.T @ VA - H * K @ K.T
    r_before = gradient[:n] + A.T @ r - K * slope
    stage = ca.Function(
        "riccati",
        [V, r, s, u, following, t, p, newton],
        [ca.densify((V_before + V_before.T) / 2), ca.densify(r_before), K, k, H, ca.densify(A), ca.densify(B)],
    )
    over = stage.mapaccum("over", steps, 2)

    se, te = ca.SX.sym("s", n), ca.SX.sym("t")
    residual = problem.terminal_residual(se, te, p)
    gauss_newton, end_gradient, exact = _squares(residual, se)
    terminal = ca.Function(
        "terminal",
        [se, te, p, newton],
        [ca.densify(gauss_newton + newton * (exact - gauss_newton)), ca.densify(end_gradient)],
    )

    X, U, T = ca.MX.sym("X", n, steps + 1), ca.MX.sym("U", 1, steps), ca.MX.sym("t", 1, steps)
    end, P, flag = ca.MX.sym("te"), ca.MX.sym("p", m), ca.MX.sym("newton")
    V_end, r_end = terminal(X[:, -1], end, P, flag)
    back = ca.Slice(steps - 1, -(steps + 1), -1)
    outputs = over(
        V_end, r_end, X[:, :steps][:, back], U[:, back], X[:, 1:][:, back], T[:, back],
        ca.repmat(P, 1, steps), ca.repmat(flag, 1, steps),
    )[2:]  # fmt: skip
    K, k, H = (output[:, back] for output in outputs[:3])
    return ca.Function("backward", [X, U, T, end, P, flag], [K, k, H, outputs[3], outputs[4]])


def _squares(residual: ca.SX, variables: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Gauss-Newton Hessian, gradient and exact Hessian of |residual|^2 / 2."""
    slope = ca.jacobian(residual, variables)
    exact, gradient = ca.hessian(ca.sumsqr(residual) / 2, variables)
    return slope.T @ slope, gradient, exact


def _forward(n: int, steps: int) -> ca.Function:
    """Solution of the linear-quadratic problem; the Jacobians come in the order of the backward pass."""
    dz, A, B = ca.SX.sym("dz", n), ca.SX.sym("A", n, n), ca.SX.sym("B", n)
    K, k = ca.SX.sym("K", n), ca.SX.sym("k")
    dv = -k - ca.dot(K, dz)
    over = ca.Function("linear", [dz, A, B, K, k], [ca.densify(A @ dz + B * dv), dz, dv]).mapaccum("over", steps)
    As, Bs = ca.MX.sym("A", n, n * steps), ca.MX.sym("B", n, steps)
    Ks, ks = ca.MX.sym("K", n, steps), ca.MX.sym("k", 1, steps)
    blocks = ca.horzcat(*ca.horzsplit(As, n)[::-1])
    back = ca.Slice(steps - 1, -(steps + 1), -1)
    Z, before, dV = over(ca.MX.zeros(n), blocks, Bs[:, back], Ks, ks)
    return ca.Function("forward", [As, Bs, Ks, ks], [ca.horzcat(before, Z[:, -1]), dV])
