"""Scale a designed motion of the gripper so that the arm can make it and the load touches neither box nor arm."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

import urdf
from armdyn.atomic import write_text
from armdyn.experiments.hypothesis import EXPERIMENT_CHANNELS, Hypothesis, PlannedExperiment, PredictedExperiment
from armdyn.experiments.plan import MIN_RIGHT_VERDICT_PROBABILITY, ExperimentPlan, along_other_motion
from armdyn.pendulum.path import GripperPath
from armdyn.recording.channels import Channel
from armdyn.recording.csv_run import csv_text
from armdyn.run import Run
from ik import LineTable, default_table
from pipeline.box import Box
from pipeline.motion.feasibility import CheckSettings, PlannedSwing, box_and_table_obstacles, check_line
from pipeline.motion.limits import LineLimits
from pipeline.motion.trajectory import LineTrajectory

AMPLITUDE_FACTORS = tuple(sign * size for size in (1.0, 0.9, 0.8, 0.65, 0.5) for sign in (1.0, -1.0))
"""Factors on the motion's amplitude, in the order in which they are tried; a negative one mirrors the motion."""
MIN_LOAD_TO_BOX_CLEARANCE = 0.03
"""Smallest distance between the load's surface and the box [m]."""


@dataclass(frozen=True, eq=False)
class FeasibleMotion:
    """A motion of the gripper that the arm can make.

    Attributes:
        motion: motion of the gripper.
        trajectory: the motion along the arm's line.
        factor: factor on the amplitude of the designed motion; negative for its mirror image.
    """

    motion: GripperPath
    trajectory: LineTrajectory
    factor: float


def fit_motion_to_arm(
    motion: GripperPath,
    hypotheses: Sequence[Hypothesis],
    robot: urdf.Robot,
    table: LineTable,
    load_radius: float,
) -> FeasibleMotion | None:
    """Find a feasible motion: the designed one, its mirror image, or a smaller copy of one of them.

    Args:
        motion: the designed motion of the gripper.
        hypotheses: models that predict the swing, the most probable first; the load must stay away from the box by all
            of them, and away from the arm by the first.
        robot: the arm.
        table: IK table of the line.
        load_radius: radius of the load [m].

    Returns:
        The feasible motion; None if none of sufficient size exists.
    """
    box, limits = Box(), LineLimits.from_table(table)
    settings = CheckSettings(
        load_mass=hypotheses[0].model.value("mass"), obstacles=box_and_table_obstacles(table.line, box)
    )
    for factor in AMPLITUDE_FACTORS:
        scaled = GripperPath(0.0, motion.dt, *factor * motion.motion_along_line).begun_at(float(motion.nodes[0, 0]))
        s, v, a = scaled.motion_along_line
        if np.abs(np.diff(a)).max() > limits.jerk * scaled.dt or not limits.respected_by(s, v, a):
            continue
        swings = [_swing(h, scaled, load_radius) for h in hypotheses]
        if not all(_clear_of(box, scaled, swing) for swing in swings):
            continue
        trajectory = LineTrajectory(scaled.time, s, v, a)
        if check_line(table, robot, trajectory, settings, swings[0]).feasible:
            return FeasibleMotion(scaled, trajectory, factor)
    return None


def with_feasible_motion(plan: ExperimentPlan, load_radius: float) -> tuple[ExperimentPlan, FeasibleMotion | None]:
    """Replace the motion in a plan by one that Baxter can make, or remove it if there is none.

    The expected results of the plan are computed again if the motion was changed.

    Args:
        plan: the planned experiments.
        load_radius: radius of the load [m].

    Returns:
        The plan, and the feasible motion; None without one.
    """
    moving = plan.motion
    if (
        moving is None
        or moving.experiment.motion is None
        or moving.expected.probability <= MIN_RIGHT_VERDICT_PROBABILITY
    ):
        return plan, None
    arm = urdf.load("baxter")
    found = fit_motion_to_arm(moving.experiment.motion, plan.rivals.hypotheses, arm, default_table(arm), load_radius)
    rest = tuple(p for p in plan.proposals if p is not moving)
    if found is None:
        return replace(plan, proposals=rest), None
    if found.factor != 1.0:
        moving = along_other_motion(moving, plan.rivals.hypotheses, found.motion, moving.experiment.what)
    return replace(plan, proposals=tuple(sorted((*rest, moving), key=lambda p: p.rank))), found


def write_designed(designed: GripperPath | Run, file: Path) -> None:
    """Write a motion along the line, for `check` and `trial --motion`, or inputs of a process to a CSV file."""
    if isinstance(designed, Run):
        channels = dict(designed.channels)
    else:
        columns = zip(("s", "v", "a"), designed.motion_along_line, ("m", "m/s", "m/s^2"), strict=True)
        channels = {name: Channel(designed.time, values, unit) for name, values, unit in columns}
    write_text(file, csv_text(channels))


def _swing(hypothesis: Hypothesis, motion: GripperPath, radius: float) -> PlannedSwing:
    predicted = PredictedExperiment(hypothesis, PlannedExperiment("motion", "", motion))
    outputs = predicted.rollout(predicted.start).outputs
    angle, tension = (outputs[:, EXPERIMENT_CHANNELS.index(name)] for name in ("swing_angle", "load_force"))
    return PlannedSwing(motion.time, angle, tension, hypothesis.model.value("length"), radius)


def _clear_of(box: Box, motion: GripperPath, swing: PlannedSwing) -> bool:
    """Whether the load always stays before the near wall of the box, or above its rim."""
    x = motion.x - swing.length * np.sin(swing.angle)
    below = swing.length * np.cos(swing.angle)
    room = swing.radius + MIN_LOAD_TO_BOX_CLEARANCE
    return bool(np.all((x < box.near_wall - room) | (below < box.rim - room)))
