"""The task node: it plans the swing with the estimated length, checks the plan, and runs it without feedback.

Planning takes one to three seconds. In a simulation the motion begins at once. On a real robot the arm comes to rest
first; the motion is planned in the background for a later instant, at which it begins.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from math import cos, nan, sin

import numpy as np

from armdyn.control.task import SwingPlan, SwingState, TaskCost, TaskPlanner
from armdyn.errors import ArmdynError, TaskFailedError
from armdyn.pendulum.model import PendulumModel
from pipeline.box import Box
from pipeline.motion import LineLimits, LineState, LineTrajectory, motion_to_finish_over_box
from pipeline.motion.feasibility import FeasibilityReport
from pipeline.motion.gate import CONTROL_PERIOD_SECONDS
from pipeline.motion.reference import smooth_reference
from pipeline.nodes.background import BackgroundWorker
from pipeline.nodes.drive import DriveNode
from pipeline.robot.protocol import Vector

MAX_PLAN_CHANGE_BY_SMOOTHING = 0.004
"""Largest change of the gripper's planned position by smoothing [m]; the load misses its target by about as much."""
BOX_TOUCH_DISTANCE = 0.05
"""Planned distance of the load from the box below which it may touch the box [m]."""
LINE_END_MARGIN = 0.01
"""Distance of planned motions from the ends of the line [m]."""
FIRST_PLAN_LEAD_SECONDS = 2.0
"""Time that the first plan of a motion on a real robot has, from the begin of planning to the begin of the motion [s];
planning takes about 1 s."""
MAX_PLANNING_ATTEMPTS = 3
"""Largest number of plans that are tried if planning is too slow; each has twice the time of the one before."""
MAX_PLANNING_SECONDS = MAX_PLANNING_ATTEMPTS * FIRST_PLAN_LEAD_SECONDS * 2 ** (MAX_PLANNING_ATTEMPTS - 1) + 2.0
"""Longest time until a requested motion begins on a real robot, coming to rest included [s]."""

FeasibilityCheck = Callable[[LineTrajectory, SwingPlan, PendulumModel, Vector], FeasibilityReport]
"""Function that checks a trajectory and its swing, for an arm at the given joint positions (n,) [rad]."""


@dataclass(frozen=True)
class TaskSettings:
    """Settings of the swing into the box, and of the gripper's last motion over the box.

    Attributes:
        target_x: target of the load at the end of the swing, along the line [m].
        target_depth_below_line: target of the load at the end of the swing, below the line [m].
        travel_weight: weight of the gripper's squared distance from the line's middle in the cost [1/(m^2 s)]; it is
            not in the paper, and keeps the motions for long strings on the line.
        duration: duration of the swing [s].
        settling: duration of the motion that brings the load to rest before the swing [s].
        finish_x: position at which the gripper comes to rest over the box, along the line [m].
        box: the box, as far as the robot knows it.
        cautious: whether the plan avoids the box's wall, a slack string and the ends of the line; the paper's plan does
            not.
        clearance: height above the box's rim at which the load's centre should pass [m].
        least_tension: smallest tension of the string, as a share of the load's weight.
    """

    target_x: float = 0.45
    target_depth_below_line: float = 0.08
    travel_weight: float = 1.0
    duration: float = 5.0
    settling: float = 3.0
    finish_x: float = 0.46
    box: Box = field(default_factory=Box)
    cautious: bool = True
    clearance: float = 0.025
    least_tension: float = 0.1

    def swing_cost(self, limits: LineLimits) -> TaskCost:
        """Cost of the swing, at whose end the load should be at rest at the target."""
        cost = TaskCost(target=(self.target_x, -self.target_depth_below_line), travel_weight=self.travel_weight)
        if not self.cautious:
            return cost
        return replace(
            cost,
            wall=(self.box.near_wall, -self.box.rim),
            clearance=self.clearance,
            least_tension=self.least_tension,
            reach=(float(limits.s[0]) + LINE_END_MARGIN, float(limits.s[-1]) - LINE_END_MARGIN),
        )

    def settling_cost(self, length: float, angle: float) -> TaskCost:
        """Cost of the motion that brings the load to rest below the line's middle.

        Args:
            length: length of the string [m].
            angle: angle of the string at rest [rad], which is not 0 in wind.
        """
        return TaskCost(
            target=(-length * sin(angle), -length * cos(angle)),
            position_weights=(1e4, 1e4),
            velocity_weights=(1e4, 1e4),
            gripper_weights=(1e4, 1e4),
            travel_weight=self.travel_weight,
        )


@dataclass(frozen=True)
class _Task:
    """A planning task, which can be pickled.

    The motion minimises `cost` from the state `start` of gripper and load, with these values of the model's parameters.
    `here` is the last commanded state on the line, `at` the measured joint positions (n,) [rad]. With `finish`, the
    last motion over the box follows.
    """

    cost: TaskCost
    values: Mapping[str, float]
    start: SwingState
    here: LineState
    at: Vector
    finish: bool


@dataclass(frozen=True)
class _Planned:
    """Result of a planning task; `problem` says why there is no trajectory, if there is none."""

    plan: SwingPlan
    trajectory: LineTrajectory | None = None
    report: FeasibilityReport | None = None
    problem: str | None = None


@dataclass
class _Request:
    """A requested motion.

    Attributes:
        task: function from the time at which the motion begins [s] to the planning task.
        announce: for a swing, function that is called with the time from which the load may touch the box [s].
        lead: time between the begin of planning and the begin of the motion on a real robot [s].
        tries: number of plans that were begun.
        due: time at which the motion begins [s]; nan before it is chosen.
        ready: the finished plan; None before.
    """

    task: Callable[[float], _Task]
    announce: Callable[[float], None] | None = None
    lead: float = FIRST_PLAN_LEAD_SECONDS
    tries: int = 0
    due: float = nan
    ready: _Planned | None = None


class SwingPlanningNode:
    """Plans requested motions, and starts them.

    Args:
        model: model of the load, whose parameter values a request may replace.
        drive: node that moves the arm.
        limits: limits along the line.
        check: function that checks a planned motion.
        measured: function that returns the measured joint positions, (n,) [rad].
        settings: settings of the swing.
        worker: worker that plans.

    Attributes:
        settings: settings of the swing.
        swing: plan of the last swing; None before.
        swing_start: time at which the swing began [s]; None before.
        feasibility: report on the last planned motion; None before.
    """

    name = "task"
    period = 0.1

    def __init__(
        self,
        model: PendulumModel,
        drive: DriveNode,
        limits: LineLimits,
        check: FeasibilityCheck,
        measured: Callable[[], Vector],
        settings: TaskSettings,
        worker: BackgroundWorker,
    ) -> None:
        self._drive, self._limits, self._check, self.settings = drive, limits, check, settings
        self._model, self._measured, self._worker = model, measured, worker
        self._planners = {
            seconds: TaskPlanner(model, round(seconds / CONTROL_PERIOD_SECONDS), CONTROL_PERIOD_SECONDS)
            for seconds in (settings.duration, settings.settling)
        }
        self._worker.register(self.name, self._plan)
        self._request: _Request | None = None
        self.swing: SwingPlan | None = None
        self.swing_start: float | None = None
        self.feasibility: FeasibilityReport | None = None

    @property
    def idle(self) -> bool:
        """Whether no motion is requested and the arm is at rest."""
        return self._request is None and self._drive.at_rest

    @property
    def max_planning_seconds(self) -> float:
        """Longest measured time from the request of a motion to its start [s]."""
        return 0.0 if self._worker.is_synchronous else MAX_PLANNING_SECONDS

    def step(self, now: float) -> None:
        """Plan the requested motion, or start it if it is planned and its time has come.

        Raises:
            TaskFailedError: no feasible motion was found, or planning takes too long.
        """
        request = self._request
        if request is None:
            return
        if self._worker.is_synchronous:
            self._ask(request, now)
        elif request.ready is None:
            if not self._worker.is_pending(self.name) and self._drive.at_rest:
                request.tries += 1
                if request.tries > MAX_PLANNING_ATTEMPTS:
                    raise TaskFailedError(
                        f"planning took longer than {request.lead / 2:g} s: this computer is too busy"
                    )
                self._ask(request, now + request.lead)
        elif now > request.due + self.period / 2:  # the plan came too late: the next one gets a longer lead
            request.ready, request.lead = None, 2.0 * request.lead
        if request.ready is not None and now > request.due - self.period / 2:
            self._begin(request, request.ready)

    def cancel(self) -> None:
        """Cancel the requested motion, if it has not begun."""
        self._request = None

    def request_settling(self, model: PendulumModel, state: Callable[[float], SwingState]) -> None:
        """Request a motion that brings the load to rest.

        Args:
            model: model with the present estimate.
            state: function from the time at which the motion begins [s] to the state of gripper and load.
        """
        cost = self.settings.settling_cost(model.value("length"), model.rest_angle())
        self._request = _Request(lambda at: self._task(model, cost, state(at)))

    def request_swing(
        self, model: PendulumModel, model_time: Callable[[float], float], announce: Callable[[float], None]
    ) -> None:
        """Request the swing into the box, from rest.

        Args:
            model: model with the present estimate.
            model_time: function from the time at which the swing begins [s] to the model's own time [s].
            announce: function that is called at the begin of the swing with the time from which the load may touch the
                box [s].
        """

        def task(at: float) -> _Task:
            start = SwingState(self._drive.state.s, angle=model.rest_angle(), time=model_time(at))
            return self._task(model, self.settings.swing_cost(self._limits), start, finish=True)

        self._request = _Request(task, announce)

    def _task(self, model: PendulumModel, cost: TaskCost, start: SwingState, finish: bool = False) -> _Task:
        values = {name: p.value for name, p in model.parameters.items()}
        return _Task(cost, values, start, self._drive.state, self._measured(), finish)

    def _ask(self, request: _Request, due: float) -> None:
        """Request a plan for a motion that begins at the time `due` [s]."""
        request.due = due
        self._worker.request(self.name, request.task(due), lambda planned: self._take(request, planned))

    def _plan(self, task: _Task) -> _Planned:
        """Plan and check a motion; called by the worker."""
        model = self._model.with_values(task.values)
        planner = self._planners[self.settings.duration if task.finish else self.settings.settling]
        plan = planner.plan(model, task.cost, task.start)
        try:
            trajectory = self._feasible(plan, task.here)
            if task.finish:
                trajectory = trajectory.followed_by(
                    motion_to_finish_over_box(
                        trajectory.end, self.settings.finish_x, self._limits, CONTROL_PERIOD_SECONDS
                    )
                )
        except ArmdynError as error:
            return _Planned(plan, problem=str(error))
        return _Planned(plan, trajectory, self._check(trajectory, plan, model, task.at))

    def _take(self, request: _Request, planned: _Planned) -> None:
        """Store a finished plan; if its time has passed, the next step requests another one."""
        if request.announce is not None:
            self.swing = planned.plan
        self.feasibility = planned.report
        if planned.problem is not None:
            raise TaskFailedError(planned.problem)
        if planned.report is not None:
            planned.report.require_feasible("the plan")
        request.ready = planned

    def _begin(self, request: _Request, planned: _Planned) -> None:
        """Start the planned motion."""
        assert planned.trajectory is not None, "a plan without a problem has one"
        self._request = None
        if request.announce is not None:
            self.swing_start = request.due
            request.announce(request.due + self._approach(planned.plan))
        self._drive.run_trajectory(planned.trajectory)

    def _approach(self, swing: SwingPlan) -> float:
        """Time in the swing from which the load may touch the box [s]."""
        close = swing.load[:, 0] > self.settings.box.near_wall - BOX_TOUCH_DISTANCE
        return float(swing.time[int(close.argmax())]) if close.any() else float(swing.time[-1])

    def _feasible(self, plan: SwingPlan, here: LineState) -> LineTrajectory:
        """The motion within the limits that is nearest to the plan, from the last commanded state."""
        if not all(np.isfinite(part).all() for part in (plan.x, plan.v, plan.a, plan.load, plan.tension)):
            raise TaskFailedError("the plan holds a NaN or an infinity: check the model and the target")
        v = np.gradient(plan.x, CONTROL_PERIOD_SECONDS)
        v[-1] = (
            plan.v[-1] + CONTROL_PERIOD_SECONDS / 2 * plan.a[-1]
        )  # the plan's speeds belong to the middle of each step
        motion = smooth_reference(plan.x, v, CONTROL_PERIOD_SECONDS, self._limits, start=here)
        missed = np.abs(motion.s - plan.x)
        if not missed.max() <= MAX_PLAN_CHANGE_BY_SMOOTHING:
            k = int(missed.argmax())
            raise TaskFailedError(
                f"the plan is not feasible: at {plan.time[k]:.2f} s it wants the gripper at {plan.x[k]:.3f} m with "
                f"{v[k]:.2f} m/s, and within the line's range, speed and acceleration it comes no nearer than "
                f"{1e3 * missed[k]:.0f} mm: choose a nearer target or more time"
            )
        return LineTrajectory(motion.time[1:], motion.s[1:], motion.v[1:], motion.a[1:])
