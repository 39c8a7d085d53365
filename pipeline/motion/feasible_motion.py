"""Fit a designed motion to the arm: on the line, within the limits, with the load clear of box and arm."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

import urdf
from armdyn.atomic import write_text
from armdyn.experiments.hypothesis import EXPERIMENT_CHANNELS, Hypothesis, PlannedExperiment, PredictedExperiment
from armdyn.experiments.plan import MIN_RIGHT_PROBABILITY, ExperimentPlan, along_other_motion
from armdyn.pendulum.path import GripperPath
from armdyn.recording.channels import Channel
from armdyn.recording.csv_run import csv_text
from ik import LineTable, default_table
from pipeline.box import Box
from pipeline.motion.feasibility import CheckSettings, PlannedSwing, box_and_table, check_line
from pipeline.motion.limits import LineLimits
from pipeline.motion.trajectory import LineTrajectory

AMPLITUDE_FACTORS = tuple(sign * size for size in (1.0, 0.9, 0.8, 0.65, 0.5) for sign in (1.0, -1.0))
"""Of the motion, tried in this order: its mirror image tells as much, and swings to the other side."""
BOX_CLEARANCE = 0.03
"""m that the load keeps from the box beside its own radius."""


@dataclass(frozen=True, eq=False)
class FeasibleMotion:
    """A gripper motion that the arm can make.

    Attributes:
        motion: motion of the gripper.
        trajectory: the motion along the arm's line.
        factor: factor on the designed motion's amplitude.
    """

    motion: GripperPath
    trajectory: LineTrajectory
    factor: float


def fit_to_arm(
    motion: GripperPath,
    hypotheses: Sequence[Hypothesis],
    robot: urdf.Robot,
    table: LineTable,
    load_radius: float,
) -> FeasibleMotion | None:
    """The motion, its mirror image or a smaller copy that the arm can make; None where none is large enough.

    The load stays clear of the box by all models that predict the swing, and clear of the arm by the first, which is
    the most probable. Its radius is in m.
    """
    box, limits = Box(), LineLimits.from_table(table)
    settings = CheckSettings(load_mass=hypotheses[0].model.value("mass"), obstacles=box_and_table(table.line, box))
    for factor in AMPLITUDE_FACTORS:
        scaled = GripperPath(0.0, motion.dt, *factor * motion.motion_along_line)
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
    """The plan with a motion that Baxter can make, or without one; expected results are computed again after a change.

    The radius of the load is in m.
    """
    moving = plan.motion
    if moving is None or moving.experiment.motion is None or moving.expected.probability <= MIN_RIGHT_PROBABILITY:
        return plan, None
    arm = urdf.load("baxter")
    found = fit_to_arm(moving.experiment.motion, plan.rivals.hypotheses, arm, default_table(arm), load_radius)
    rest = tuple(p for p in plan.proposals if p is not moving)
    if found is None:
        return replace(plan, proposals=rest), None
    if found.factor != 1.0:
        moving = along_other_motion(moving, plan.rivals.hypotheses, found.motion, moving.experiment.what)
    return replace(plan, proposals=tuple(sorted((*rest, moving), key=lambda p: p.rank))), found


def write_motion(motion: GripperPath, file: Path) -> None:
    """Write a motion along the line to a file for `armdyn check` and `armdyn trial --motion`."""
    columns = zip(("s", "v", "a"), motion.motion_along_line, ("m", "m/s", "m/s^2"), strict=True)
    write_text(file, csv_text({name: Channel(motion.time, values, unit) for name, values, unit in columns}))


def _swing(hypothesis: Hypothesis, motion: GripperPath, radius: float) -> PlannedSwing:
    predicted = PredictedExperiment(hypothesis, PlannedExperiment("motion", "", motion))
    outputs = predicted.rollout(predicted.start).outputs
    angle, tension = (outputs[:, EXPERIMENT_CHANNELS.index(name)] for name in ("swing_angle", "load_force"))
    return PlannedSwing(motion.time, angle, tension, hypothesis.model.value("length"), radius)


def _clear_of(box: Box, motion: GripperPath, swing: PlannedSwing) -> bool:
    """Whether the load stays away from the box's near wall, or above its rim."""
    x = motion.x - swing.length * np.sin(swing.angle)
    below = swing.length * np.cos(swing.angle)
    room = swing.radius + BOX_CLEARANCE
    return bool(np.all((x < box.near_wall - room) | (below < box.rim - room)))
