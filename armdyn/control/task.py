"""Plan a swing of the load to a point with a wanted velocity, by moving the gripper along its line."""

from dataclasses import dataclass, replace
from functools import lru_cache

import casadi as ca
import numpy as np

from armdyn.control.projection import DiscreteOptimalControlProblem, ProjectionOptimizer, Solution
from armdyn.errors import InputError, TaskFailedError
from armdyn.pendulum.model import PendulumModel
from armdyn.pendulum.variational import VARIATIONAL_STATE_SIZE, VariationalStep

EFFECT_CONTINUATION_SHARES = (0.0, 0.2, 0.4, 0.7, 1.0)
"""Shares of the effects' values for which a plan is computed one after another, if it is not found directly."""


WALL_ROOF_SLOPE, WALL_ROOF_RIDGE_RADIUS_METRES = 1.0, 0.005
"""Slope of a roof over the wall, above which the load must stay, and radius, m, of its ridge. The wall alone is too
thin: it would push a load inside it to the side, and a fast load passes it between two nodes."""


@dataclass(frozen=True)
class TaskCost:
    """Cost of a planned swing of the load to a target.

    1/2 (|position - target|_P^2 + |velocity - target velocity|_Q^2 + |gripper|_S^2) at the end, plus
    dt/2 sum (R a^2 + W x_gripper^2).

    Attributes:
        target: (x, z) position of the load relative to the gripper's start, z up, m.
        target_velocity: (x, z) velocity of the load, m/s.
        position_weights: (x, z) 1/m^2.
        velocity_weights: (x, z) s^2/m^2.
        gripper_weights: S on the gripper's position 1/m^2 and velocity s^2/m^2; a load stays at rest only where the
            gripper is at rest above it.
        control_weight: R, s^3/m^2, > 0.
        travel_weight: W, 1/(m^2 s); keeps the gripper near the middle of its line.
        wall: (x, z) of the top of a wall that the load must pass over, from the gripper's start, m; None for none.
        clearance: least height of the load's centre above the wall that costs nothing, m; it decreases to both sides.
        wall_weight: cost of a squared metre below that height, 1/(m^2 s).
        least_tension: least tension of the string as a share of the load's weight; None for no such term.
        slack_weight: cost of a squared weight below that tension, 1/s.
        reach: least and largest x of the gripper, m; None for a line without ends.
        reach_weight: cost of a squared metre beyond, 1/(m^2 s).
    """

    target: tuple[float, float]
    target_velocity: tuple[float, float] = (0.0, 0.0)
    position_weights: tuple[float, float] = (1000.0, 1000.0)
    velocity_weights: tuple[float, float] = (100.0, 100.0)
    gripper_weights: tuple[float, float] = (0.0, 0.0)
    control_weight: float = 0.1
    travel_weight: float = 0.0
    wall: tuple[float, float] | None = None
    clearance: float = 0.0
    wall_weight: float = 1e6
    least_tension: float | None = None
    slack_weight: float = 1e4
    reach: tuple[float, float] | None = None
    reach_weight: float = 1e5

    def __post_init__(self) -> None:
        if not np.all(np.isfinite(self.vector())):
            raise InputError("a task cost has an entry that is not a number: give finite targets and weights")
        if self.control_weight <= 0:
            raise InputError(f"control weight {self.control_weight:g}: it must be positive, or the plan is not unique")

    def problem_arguments(self) -> dict[str, float]:
        """The cost's numbers by name, in the order of the optimisation problem; unused terms have weight 0."""
        pairs = {
            "": self.target, "v": self.target_velocity, "w_": self.position_weights, "w_v": self.velocity_weights
        }  # fmt: skip
        named = {prefix + axis: pair[i] for prefix, pair in pairs.items() for i, axis in enumerate("xz")}
        wall_x, wall_z = self.wall or (0.0, 0.0)
        reach_least, reach_most = self.reach or (0.0, 0.0)
        return named | {
            "w_gripper_x": self.gripper_weights[0],
            "w_gripper_v": self.gripper_weights[1],
            "w_control": self.control_weight,
            "w_travel": self.travel_weight,
            "wall_x": wall_x,
            "wall_z": wall_z,
            "w_wall": self.wall_weight if self.wall else 0.0,
            "clearance": self.clearance,
            "least_tension": self.least_tension or 0.0,
            "w_slack": 0.0 if self.least_tension is None else self.slack_weight,
            "reach_least": reach_least,
            "reach_most": reach_most,
            "w_reach": self.reach_weight if self.reach else 0.0,
        }

    def vector(self) -> np.ndarray:
        """(21,) values of `problem_arguments` as an array."""
        return np.array(list(self.problem_arguments().values()))


TASK_COST_NAMES = tuple(TaskCost((0.0, 0.0)).problem_arguments())


@dataclass(frozen=True)
class SwingState:
    """State at the start of a planned swing.

    Attributes:
        x: position of the string's upper end, which follows the gripper with a lag, m.
        v: velocity of the string's upper end, m/s.
        angle: swing angle, rad.
        rate: swing rate, rad/s.
        time: time since the start of the run, s, for effects that depend on time.
    """

    x: float = 0.0
    v: float = 0.0
    angle: float = 0.0
    rate: float = 0.0
    time: float = 0.0


@dataclass(frozen=True)
class SwingPlan:
    """A planned swing of the load, with one value for each node in time.

    Attributes:
        time: (N+1,) time from the swing's start, s.
        x: (N+1,) position of the gripper, m.
        v: (N+1,) velocity of the gripper over the interval that ends at the node, m/s.
        a: (N+1,) acceleration of the gripper, m/s^2; the last one is repeated.
        angle: (N+1,) swing angle, rad.
        tension: (N,) tension at each node but the last, N.
        load: (N+1, 2) x and z of the load, m; z is relative to the gripper's line.
        solution: result of the optimiser.
    """

    time: np.ndarray
    x: np.ndarray
    v: np.ndarray
    a: np.ndarray
    angle: np.ndarray
    tension: np.ndarray
    load: np.ndarray
    solution: Solution


class TaskPlanner:
    """Plans swings of a load to a target, for a model with fixed effects; parameter values and targets may change."""

    def __init__(self, model: PendulumModel, steps: int = 500, dt: float = 0.01) -> None:
        if steps < 2 or not dt > 0:
            raise InputError(f"{steps} steps of {dt:g} s: a plan needs two steps or more and a positive step")
        self.steps, self.dt = steps, dt
        self._names = model.physics_names
        self._variational = model.variational()
        self._formulation = model.formulation
        self._tension = self._variational.tension.map(steps)
        self._load = self._variational.load.map(steps + 1)

    def optimizer(self, *, constrained: bool) -> ProjectionOptimizer:
        """The optimiser of the task; `constrained` includes the wall, a slack string and the ends of the line."""
        return _optimizer(self._variational, self._formulation, self.steps, constrained)

    def plan(
        self, model: PendulumModel, cost: TaskCost, start: SwingState | None = None, *, tolerance: float = 1e-6,
    ) -> SwingPlan:  # fmt: skip
        """Plan the swing of least cost from `start`, by default from rest.

        Raises:
            InputError: the model has other effects than the one that the planner was built for.
            TaskFailedError: the optimiser did not converge.
        """
        if model.physics_names != self._names:
            raise InputError("this planner was built for a model with other effects: build a new one")
        start = start or SwingState()
        theta = model.physics_theta()
        unconstrained = replace(cost, wall=None, least_tension=None, reach=None)
        optimizer = self.optimizer(constrained=cost != unconstrained)
        time = start.time + self.dt * np.arange(self.steps + 1)
        lag = float(self._variational.lag(theta))
        initial = np.array([start.x, start.v, start.angle, start.rate])

        def solve(of: TaskCost, guess: np.ndarray | None = None, values: np.ndarray = theta) -> Solution:
            parameters = np.concatenate([values, of.vector(), [self.dt]])
            return optimizer.solve(initial, time, parameters, guess, tolerance=tolerance)

        # The constraints make the problem non-convex: the search starts from the unconstrained optimum.
        try:
            free = solve(unconstrained)
        except TaskFailedError:
            # From rest, strong friction hides the swing: it is found while the effects grow from zero.
            null = np.array([model.parameters[n].null if "." in n else model.value(n) for n in self._names])
            controls = None
            for share in EFFECT_CONTINUATION_SHARES:
                free = solve(unconstrained, controls, null + share * (theta - null))
                controls = free.controls
        solution = free
        if cost != unconstrained:
            bent = solve(cost, free.controls)
            steps, seconds = free.iterations + bent.iterations, free.seconds + bent.seconds
            solution = replace(bent, iterations=steps, seconds=seconds)
        s, u = solution.states, solution.controls
        parameter_columns = np.tile(theta[:, None], (1, self.steps + 1))
        step = np.full((1, self.steps + 1), self.dt)
        N = self.steps
        tension = self._tension(s[:, :-1], u[None], time[None, :-1], step[:, :N], parameter_columns[:, :N], s[:, 1:])
        load, _ = self._load(s, time[None], step, parameter_columns)
        x, v, a = _ahead_of(s[0], s[1], u, lag, self.dt)
        return SwingPlan(
            time=time - start.time, x=x, v=v, a=a, angle=s[2].copy(),
            tension=np.asarray(tension).ravel(), load=np.asarray(load)[[0, 2]].T.copy(), solution=solution,
        )  # fmt: skip


def _ahead_of(
    x: np.ndarray, v: np.ndarray, u: np.ndarray, lag: float, dt: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The gripper's positions, backward velocities and accelerations (N+1,) for a lagged position x: x + lag x'."""
    a = np.append(u, u[-1])
    if lag == 0.0:
        return x.copy(), v.copy(), a
    lead = x + lag * (v + dt / 2 * a)
    backward = np.diff(lead, prepend=lead[0] - dt * v[0]) / dt
    return lead, backward, np.append(np.diff(backward), backward[-1] - backward[-2]) / dt


@lru_cache(maxsize=16)
def _optimizer(variational: VariationalStep, formulation: str, steps: int, constrained: bool) -> ProjectionOptimizer:
    return ProjectionOptimizer(task_problem(variational, formulation, constrained=constrained), steps)


def task_problem(
    variational: VariationalStep, name: str, *, constrained: bool = False
) -> DiscreteOptimalControlProblem:
    """The task as an optimal control problem; its p is (theta, cost in the order of `TASK_COST_NAMES`, dt).

    Args:
        variational: the equations.
        name: identifier of the equations.
        constrained: whether walls, slack and the ends of the line are included; otherwise their entries of p are
            ignored.
    """
    thetas = len(variational.names)
    size = thetas + len(TASK_COST_NAMES) + 1
    s, u, t, p = ca.SX.sym("s", VARIATIONAL_STATE_SIZE), ca.SX.sym("u"), ca.SX.sym("t"), ca.SX.sym("p", size)
    following, costate = ca.SX.sym("s_next", VARIATIONAL_STATE_SIZE), ca.SX.sym("costate", VARIATIONAL_STATE_SIZE)
    theta, dt = p[:thetas], p[size - 1]
    c = dict(zip(TASK_COST_NAMES, ca.vertsplit(p[thetas : size - 1]), strict=True))
    position, velocity = variational.load(s, t, dt, theta)
    arrival = (position[0] - c["x"], position[2] - c["z"], velocity[0] - c["vx"], velocity[2] - c["vz"])
    error = ca.vertcat(*arrival, s[0], s[1])
    weights = ca.vertcat(c["w_x"], c["w_z"], c["w_vx"], c["w_vz"], c["w_gripper_x"], c["w_gripper_v"])
    effort = dt / 2 * (c["w_control"] * u**2 + c["w_travel"] * s[0] ** 2)
    aside = ca.sqrt((position[0] - c["wall_x"]) ** 2 + WALL_ROOF_RIDGE_RADIUS_METRES**2) - WALL_ROOF_RIDGE_RADIUS_METRES
    roof = c["wall_z"] + c["clearance"] - WALL_ROOF_SLOPE * aside
    inside = ca.sqrt(dt * c["w_wall"]) * ca.fmax(0, roof - position[2])
    at = (s, u, t, dt, theta)
    # The tension hardly depends on the exact next node, so the extrapolated one suffices.
    onward = ca.vertcat(s[0] + dt * (s[1] + dt * u), s[1] + dt * u, s[2] + dt * s[3], s[3])
    gravity, mass = (theta[variational.names.index(name)] for name in ("gravity", "mass"))
    slack = c["least_tension"] - variational.tension(*at, onward) / (mass * gravity)
    loose = ca.sqrt(dt * c["w_slack"]) * ca.fmax(0, slack)
    beyond = ca.sqrt(dt * c["w_reach"]) * ca.fmax(0, ca.fmax(s[0] - c["reach_most"], c["reach_least"] - s[0]))
    constraints = ca.vertcat(inside, loose, beyond) if constrained else ca.SX(0, 1)
    return DiscreteOptimalControlProblem(
        name=f"{'constrained_' if constrained else ''}swing_{name}",
        states=VARIATIONAL_STATE_SIZE,
        parameters=size,
        step=ca.Function("f", [s, u, t, p], [variational.step(*at)]),
        linearised=ca.Function("df", [s, u, t, p, following], variational.linearised(*at, following)),
        curvature=ca.Function(
            "d2f", [s, u, t, p, following, costate], [variational.curvature(*at, following, costate)]
        ),
        running=ca.Function("running", [s, u, t, p], [effort]),
        running_residual=ca.Function("constraints", [s, u, t, p], [constraints]),
        terminal_residual=ca.Function("end", [s, t, p], [ca.sqrt(weights) * error]),
    )
