"""One step of Rodas, a linearly implicit method of order 4 that is stable for decays of any rate.

Hairer & Wanner, Solving Ordinary Differential Equations II, 1996, §IV.7 and §IV.10. It solves one linear system per
stage instead of taking steps as short as the fastest decay, and damps what is faster than a step to its rest.
"""

import casadi as ca

from armdyn.physics.definition import Expression

GAMMA = 0.25
TIMES = (0.0, 0.386, 0.21, 0.63, 1.0, 1.0)
"""Fraction of the step at which each stage looks at the inputs."""
TIME_SLOPES = (0.25, -0.1043, 0.1035, -0.0362, 0.0, 0.0)
"""Weight of the rate's derivative by time in each stage."""
A = (
    (), (1.544,), (0.9466785280815826, 0.2557011698983284),
    (3.314825187068521, 2.896124015972201, 0.9986419139977817),
    (1.221224509226641, 6.019134481288629, 12.53708332932087, -0.687886036105895),
    (1.221224509226641, 6.019134481288629, 12.53708332932087, -0.687886036105895, 1.0),
)  # fmt: skip
"""Weights of earlier stages in the state of each stage."""
C = (
    (), (-5.6688,), (-2.430093356833875, -0.2063599157091915),
    (-0.1073529058151375, -9.594562251023355, -20.47028614809616),
    (7.496443313967647, -10.24680431464352, -33.99990352819905, 11.7089089320616),
    (8.083246795921522, -7.981132988064893, -31.52159432874371, 16.31930543123136, -6.058818238834054),
)  # fmt: skip
"""Weights of earlier stages in the right-hand side of each stage."""


def rosenbrock_step(
    derivative: ca.Function, s: Expression, inputs: tuple[Expression, ...], theta: Expression, dt: Expression
) -> Expression:
    """The state after one step.

    Args:
        derivative: ``(s, w, theta) -> rates`` of the states.
        s: (n,) state at the start of the step.
        inputs: inputs at the start of the step, halfway and at its end; a parabola between them.
        theta: parameters.
        dt: length of the step, s.
    """
    here, middle, there = inputs
    given = [ca.SX.sym("given", *derivative.size_in(k)) for k in range(3)]
    value = derivative(*given)
    found = ca.Function("rate", given, [value, ca.jacobian(value, given[0]), ca.jacobian(value, given[1])])
    _, slopes, by_inputs = found(s, here, theta)
    by_time = by_inputs @ (4 * middle - 3 * here - there)  # times the step
    matrix = ca.inv(ca.SX.eye(s.numel()) / GAMMA - dt * slopes)  # times the step
    stages: list[Expression] = []
    for k, part in enumerate(TIMES):
        at = s + sum((a * u for a, u in zip(A[k], stages, strict=True)), start=ca.SX(s.numel(), 1))
        look = (1 - part) * (1 - 2 * part) * here + 4 * part * (1 - part) * middle + part * (2 * part - 1) * there
        right = dt * derivative(at, look, theta) + TIME_SLOPES[k] * dt * by_time
        right += sum((c * u for c, u in zip(C[k], stages, strict=True)), start=ca.SX(s.numel(), 1))
        stages.append(matrix @ right)
    return at + stages[-1]
