"""The task node: plans the swing with the estimated length, has it checked, and plays it open loop.

Planning takes one to three seconds. On a simulated clock the motion begins at once. On a real one the arm comes to rest
first, the plan is made beside the loop for an instant ahead, and is played when that instant comes.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from math import cos, nan, sin

import numpy as np

from armdyn.control.task import SwingPlan, SwingState, TaskCost, TaskPlanner
from armdyn.errors import ArmdynError, TaskFailedError
from armdyn.pendulum.model import PendulumModel
from pipeline.box import Box
from pipeline.motion import LineLimits, LineState, LineTrajectory, finish_over_box
from pipeline.motion.feasibility import FeasibilityReport
from pipeline.motion.gate import PERIOD
from pipeline.motion.reference import smooth_reference
from pipeline.nodes.background import BackgroundWorker
from pipeline.nodes.drive import DriveNode
from pipeline.robot.protocol import Vector

PLAN_TOLERANCE = 0.004
"""How far smoothing may move the gripper off its plan [m]; the load then misses its target by about as much."""
TOUCH_DISTANCE = 0.05
"""A load that swings otherwise than planned may touch the box where the plan is nearer to it than this [m]."""
END_MARGIN = 0.01
"""Distance that plans keep from the ends of the line [m]."""
FIRST_LEAD_SECONDS = 2.0
"""So far ahead is planned on a real clock [s]; planning and check take 1 s on a quiet core."""
MAX_PLANS = 3
"""Plans that may come too late before it is given up; each is made for an instant twice as far ahead."""
MAX_PLANNING_SECONDS = MAX_PLANS * FIRST_LEAD_SECONDS * 2 ** (MAX_PLANS - 1) + 2.0
"""Time that planning, and coming to rest before it, may take on a real clock [s]: a plan that comes too late is waited
for, and one that takes longer than the last lead is not tried again."""

Check = Callable[[LineTrajectory, SwingPlan, PendulumModel, Vector], FeasibilityReport]
"""Judges a trajectory with the swing that belongs to it, for an arm that is at joint positions (n,) [rad]."""


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
        """Cost of the swing: the load shall be at the target, at rest, at the end."""
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
        """Cost of settling: the load shall hang at rest below the line's middle; in wind its angle is not 0."""
        return TaskCost(
            target=(-length * sin(angle), -length * cos(angle)),
            position_weights=(1e4, 1e4),
            velocity_weights=(1e4, 1e4),
            gripper_weights=(1e4, 1e4),
            travel_weight=self.travel_weight,
        )


@dataclass(frozen=True)
class _Task:
    """A planning task, which can be copied to another process.

    The motion minimises `cost` from `start` of gripper and load, with these values of the model; the arm is
    at the last commanded state `here` and at joint positions `at` (n,) [rad]. The finish over the box follows a swing.
    """

    cost: TaskCost
    values: Mapping[str, float]
    start: SwingState
    here: LineState
    at: Vector
    finish: bool


@dataclass(frozen=True)
class _Planned:
    """Result of a planning task; `problem` says why there is no trajectory."""

    plan: SwingPlan
    trajectory: LineTrajectory | None = None
    report: FeasibilityReport | None = None
    problem: str | None = None


@dataclass
class _Request:
    """A requested motion.

    Attributes:
        task: gives the planning task for a starting instant [s].
        announce: for a swing, called with the time from which the load may touch the box [s].
        lead: time between planning and motion on a real clock [s].
        tries: number of plans that were begun.
        due: instant at which the motion begins [s]; None before it is chosen.
        ready: the plan for it; None before it is made.
    """

    task: Callable[[float], _Task]
    announce: Callable[[float], None] | None = None
    lead: float = FIRST_LEAD_SECONDS
    tries: int = 0
    due: float = nan
    ready: _Planned | None = None


class TaskNode:
    """Plans motions on request and plays them; a request is carried out from the node's next step on.

    Attributes:
        swing: plan of the last swing.
        started: time at which the swing began [s].
        feasibility: report on the last planned motion; None before there is one.
    """

    name = "task"
    period = 0.1

    def __init__(
        self,
        model: PendulumModel,
        drive: DriveNode,
        limits: LineLimits,
        check: Check,
        measured: Callable[[], Vector],
        settings: TaskSettings,
        worker: BackgroundWorker,
    ) -> None:
        self._drive, self._limits, self._check, self.settings = drive, limits, check, settings
        self._model, self._measured, self._worker = model, measured, worker
        self._planners = {
            seconds: TaskPlanner(model, round(seconds / PERIOD), PERIOD)
            for seconds in (settings.duration, settings.settling)
        }
        self._worker.provide(self.name, self._plan)
        self._request: _Request | None = None
        self.swing: SwingPlan | None = None
        self.started: float | None = None
        self.feasibility: FeasibilityReport | None = None

    @property
    def idle(self) -> bool:
        """Whether no motion is requested or played."""
        return self._request is None and self._drive.at_rest

    @property
    def longest_planning(self) -> float:
        """Longest time before a requested motion begins [s]."""
        return 0.0 if self._worker.at_once else MAX_PLANNING_SECONDS

    def step(self, now: float) -> None:
        """Carry out the present request, if any.

        Raises:
            TaskFailedError: there is no feasible plan, or planning takes too long.
        """
        request = self._request
        if request is None:
            return
        if self._worker.at_once:
            self._ask(request, now)
        elif request.ready is None:
            if not self._worker.busy(self.name) and self._drive.at_rest:
                request.tries += 1
                if request.tries > MAX_PLANS:
                    raise TaskFailedError(
                        f"planning took longer than {request.lead / 2:g} s: this computer is too busy"
                    )
                self._ask(request, now + request.lead)
        elif now > request.due + self.period / 2:  # the plan came too late: the next one gets a longer lead
            request.ready, request.lead = None, 2.0 * request.lead
        if request.ready is not None and now > request.due - self.period / 2:
            self._begin(request, request.ready)

    def cancel(self) -> None:
        """Cancel the present request."""
        self._request = None

    def settle(self, model: PendulumModel, state: Callable[[float], SwingState]) -> None:
        """Request a motion that brings the load to rest, by a model with the present estimate.

        `state` gives the state of gripper and load at an instant [s], now or later while the arm stands.
        """
        cost = self.settings.settling_cost(model.value("length"), model.rest_angle())
        self._request = _Request(lambda at: self._task(model, cost, state(at)))

    def throw(self, model: PendulumModel, begun: float | None, announce: Callable[[float], None]) -> None:
        """Request the swing into the box, from rest.

        Args:
            model: model with the present estimate.
            begun: time at which the model's time began [s]; now if not given.
            announce: called, when the swing begins, with the time from which the load may touch the box [s].
        """

        def task(at: float) -> _Task:
            elapsed = 0.0 if begun is None else at - begun
            start = SwingState(self._drive.state.s, angle=model.rest_angle(), time=elapsed)
            return self._task(model, self.settings.swing_cost(self._limits), start, finish=True)

        self._request = _Request(task, announce)

    def _task(self, model: PendulumModel, cost: TaskCost, start: SwingState, finish: bool = False) -> _Task:
        values = {name: p.value for name, p in model.parameters.items()}
        return _Task(cost, values, start, self._drive.state, self._measured(), finish)

    def _ask(self, request: _Request, due: float) -> None:
        """Request a plan for a motion that begins at an instant [s]."""
        request.due = due
        self._worker.ask(self.name, request.task(due), lambda planned: self._take(request, planned))

    def _plan(self, task: _Task) -> _Planned:
        """The planned and checked motion; computed outside the loop."""
        model = self._model.with_values(task.values)
        planner = self._planners[self.settings.duration if task.finish else self.settings.settling]
        plan = planner.plan(model, task.cost, task.start)
        try:
            trajectory = self._feasible(plan, task.here)
            if task.finish:
                trajectory = trajectory.then(
                    finish_over_box(trajectory.end, self.settings.finish_x, self._limits, PERIOD)
                )
        except ArmdynError as error:
            return _Planned(plan, problem=str(error))
        return _Planned(plan, trajectory, self._check(trajectory, plan, model, task.at))

    def _take(self, request: _Request, planned: _Planned) -> None:
        """Store a finished plan; where its instant has passed, the next step requests another one."""
        if request.announce is not None:
            self.swing = planned.plan
        self.feasibility = planned.report
        if planned.problem is not None:
            raise TaskFailedError(planned.problem)
        if planned.report is not None:
            planned.report.require_feasible("the plan")
        request.ready = planned

    def _begin(self, request: _Request, planned: _Planned) -> None:
        """Play the finished plan."""
        assert planned.trajectory is not None, "a plan without a problem has one"
        self._request = None
        if request.announce is not None:
            self.started = request.due
            request.announce(request.due + self._approach(planned.plan))
        self._drive.play(planned.trajectory)

    def _approach(self, swing: SwingPlan) -> float:
        """Time in the swing from which the load may touch the box [s]."""
        close = swing.load[:, 0] > self.settings.box.near_wall - TOUCH_DISTANCE
        return float(swing.time[int(close.argmax())]) if close.any() else float(swing.time[-1])

    def _feasible(self, plan: SwingPlan, here: LineState) -> LineTrajectory:
        """The motion within the line's limits that is nearest to the plan, from the last commanded state."""
        if not all(np.isfinite(part).all() for part in (plan.x, plan.v, plan.a, plan.load, plan.tension)):
            raise TaskFailedError("the plan holds a NaN or an infinity: check the model and the target")
        v = np.gradient(plan.x, PERIOD)
        v[-1] = plan.v[-1] + PERIOD / 2 * plan.a[-1]  # the plan's speeds belong to the middle of each step
        motion = smooth_reference(plan.x, v, PERIOD, self._limits, start=here)
        missed = np.abs(motion.s - plan.x)
        if not missed.max() <= PLAN_TOLERANCE:
            k = int(missed.argmax())
            raise TaskFailedError(
                f"the plan is not feasible: at {plan.time[k]:.2f} s it wants the gripper at {plan.x[k]:.3f} m with "
                f"{v[k]:.2f} m/s, and within the line's range, speed and acceleration it comes no nearer than "
                f"{1e3 * missed[k]:.0f} mm: choose a nearer target or more time"
            )
        return LineTrajectory(motion.time[1:], motion.s[1:], motion.v[1:], motion.a[1:])
