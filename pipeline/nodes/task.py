"""The task node: plans the swing with the estimated length, has it checked, and plays it open loop."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from math import cos, sin

import numpy as np

from armdyn.control.task import SwingPlan, SwingState, TaskCost, TaskPlanner
from armdyn.errors import TaskFailedError
from armdyn.pendulum.model import PendulumModel
from pipeline.box import Box
from pipeline.motion import LineLimits, LineTrajectory, finish_over_box
from pipeline.motion.reference import smooth_reference
from pipeline.nodes.drive import DriveNode

DT = 0.01
"""Control cycle and step of the variational integrator [s]."""
PLAN_TOLERANCE = 0.004
"""How far smoothing may move the gripper off its plan [m]; the load then misses its target by about as much."""
NEAR_WALL = 0.05
"""A load that swings otherwise than planned may touch the box where the plan is nearer to it than this [m]."""
END_MARGIN = 0.01
"""Distance that plans keep from the ends of the line [m]."""

Check = Callable[[LineTrajectory, SwingPlan], None]
"""Raises `TaskFailedError` when a trajectory, with the swing that belongs to it, is not feasible."""


@dataclass(frozen=True)
class TaskSettings:
    """The swing into the box, and its finish over it.

    Attributes:
        target_x: where the load should be at the end of the swing, from the line's zero [m].
        target_below: how far below the gripper's line [m].
        travel_weight: cost of the gripper's distance from zero [1/(m^2 s)]; not in the paper; it keeps the plans
            for long strings on the line.
        duration: of the swing [s].
        settling: time to bring the load to rest before it [s].
        finish_x: where the gripper comes to rest over the box [m].
        box: where the robot believes the box to be.
        cautious: whether the plan avoids the wall, a slack string and the ends of the line; the paper's plan does not.
        clearance: height over that rim at which the load's centre should pass [m].
        least_tension: share of the load's weight with which the string should stay taut.
    """

    target_x: float = 0.45
    target_below: float = 0.08
    travel_weight: float = 1.0
    duration: float = 5.0
    settling: float = 3.0
    finish_x: float = 0.46
    box: Box = field(default_factory=Box)
    cautious: bool = True
    clearance: float = 0.025
    least_tension: float = 0.1

    def swing_cost(self, limits: LineLimits) -> TaskCost:
        """Load at the target, at rest, at the end."""
        cost = TaskCost(target=(self.target_x, -self.target_below), travel_weight=self.travel_weight)
        if not self.cautious:
            return cost
        return replace(
            cost,
            wall=(self.box.near_wall, -self.box.rim),
            clearance=self.clearance,
            least_tension=self.least_tension,
            reach=(float(limits.s[0]) + END_MARGIN, float(limits.s[-1]) - END_MARGIN),
        )

    def settling_cost(self, length: float, angle: float) -> TaskCost:
        """Load hanging at rest below the middle of the line, at an angle that is not 0 in wind."""
        return TaskCost(
            target=(-length * sin(angle), -length * cos(angle)),
            position_weights=(1e4, 1e4),
            velocity_weights=(1e4, 1e4),
            gripper_weights=(1e4, 1e4),
            travel_weight=self.travel_weight,
        )


class TaskNode:
    """Plans on request and plays what it planned; a request is carried out in its next step.

    Attributes:
        swing: the plan of the last swing.
        trajectory: what the gripper was told to do in it, finish included.
        started: time at which the swing began [s].
    """

    name = "task"
    period = 0.1

    def __init__(
        self, model: PendulumModel, drive: DriveNode, limits: LineLimits, check: Check, settings: TaskSettings
    ) -> None:
        self._drive, self._limits, self._check, self.settings = drive, limits, check, settings
        self._swing_planner = TaskPlanner(model, round(settings.duration / DT), DT)
        self._settle_planner = TaskPlanner(model, round(settings.settling / DT), DT)
        self._request: Callable[[float], None] | None = None
        self.swing: SwingPlan | None = None
        self.trajectory: LineTrajectory | None = None
        self.started: float | None = None

    @property
    def idle(self) -> bool:
        """Whether nothing is asked for and nothing is played."""
        return self._request is None and self._drive.at_rest

    def step(self, now: float) -> None:
        """Carry out the request, if there is one."""
        if self._request is not None:
            request, self._request = self._request, None
            request(now)

    def cancel(self) -> None:
        """Forget the request."""
        self._request = None

    def settle(self, model: PendulumModel, state: Callable[[], SwingState]) -> None:
        """Ask for the load to be brought to rest.

        Args:
            model: with the present estimate.
            state: gives gripper and load at the time of planning.
        """

        def carry_out(_now: float) -> None:
            cost = self.settings.settling_cost(model.value("length"), model.rest_angle())
            plan = self._settle_planner.plan(model, cost, state())
            trajectory = self._feasible(plan)
            self._check(trajectory, plan)
            self._drive.play(trajectory)

        self._request = carry_out

    def throw(self, model: PendulumModel, begun: float | None, announce: Callable[[float], None]) -> None:
        """Ask for the swing into the box, from rest.

        Args:
            model: with the present estimate.
            begun: when the model's time began [s]; now if not given.
            announce: is told the time from which the load may touch the box [s], when the swing begins.
        """

        def carry_out(now: float) -> None:
            elapsed = 0.0 if begun is None else now - begun
            start = SwingState(self._drive.state.s, angle=model.rest_angle(), time=elapsed)
            self.swing = self._swing_planner.plan(model, self.settings.swing_cost(self._limits), start)
            swing = self._feasible(self.swing)
            finish = finish_over_box(swing.end, self.settings.finish_x, self._limits, DT)
            self.trajectory = swing.then(finish)
            self._check(self.trajectory, self.swing)
            self.started = now
            announce(now + self._approach(self.swing))
            self._drive.play(self.trajectory)

        self._request = carry_out

    def _approach(self, swing: SwingPlan) -> float:
        """Time in the swing from which the load may touch the box [s]."""
        close = swing.load[:, 0] > self.settings.box.near_wall - NEAR_WALL
        return float(swing.time[int(close.argmax())]) if close.any() else float(swing.time[-1])

    def _feasible(self, plan: SwingPlan) -> LineTrajectory:
        """The motion within the limits of the line that is nearest to the plan, from the drive's present state."""
        if not all(np.isfinite(part).all() for part in (plan.x, plan.v, plan.a, plan.load, plan.tension)):
            raise TaskFailedError("the plan holds a NaN or an infinity: check the model and the target")
        v = np.gradient(plan.x, DT)
        v[-1] = plan.v[-1] + DT / 2 * plan.a[-1]  # the plan's speeds belong to the middle of each step
        motion = smooth_reference(plan.x, v, DT, self._limits, start=self._drive.state)
        missed = np.abs(motion.s - plan.x)
        if not missed.max() <= PLAN_TOLERANCE:
            k = int(missed.argmax())
            raise TaskFailedError(
                f"the plan is not feasible: at {plan.time[k]:.2f} s it wants the gripper at {plan.x[k]:.3f} m with "
                f"{v[k]:.2f} m/s, and within the line's range, speed and acceleration it comes no nearer than "
                f"{1e3 * missed[k]:.0f} mm: choose a nearer target or more time"
            )
        return LineTrajectory(motion.time[1:], motion.s[1:], motion.v[1:], motion.a[1:])
