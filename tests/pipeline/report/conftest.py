import numpy as np
import pytest

from armdyn.document import KeyFigure, Level
from pipeline.box import Box
from pipeline.motion.feasibility import Margin
from pipeline.nodes.scheduler import Timing
from pipeline.report.motion import EstimateTrace, ForceTrace, GripperTrace, JointTrace
from pipeline.report.theme import Span
from pipeline.report.trial import SwingPicture, SwingTrace, TrialReportData
from pipeline.trial.table import TableOne, TableRow

LENGTH = 0.368
JOINTS = tuple(f"right_{name}" for name in ("s0", "s1", "e0", "e1", "w0", "w1", "w2"))


def _swing(time, shift, rng):
    """A pivot that goes 0.45 m across while a load of the true length swings up to the box and drops."""
    gripper = 0.45 / (1 + np.exp(-(time - 2.6) / 0.28)) - 0.09 * np.exp(-(((time - 1.3) / 0.5) ** 2))
    angle = 0.62 * np.exp(-(((time - 2.9) / 1.1) ** 2)) * np.sin(5.16 * (time - 2.35)) + shift
    angle += rng.normal(0.0, 0.001, time.shape)
    return SwingTrace(time + 8.0, gripper, gripper - LENGTH * np.sin(angle), -LENGTH * np.cos(angle))


def make_trial_data():
    rng = np.random.default_rng(3)
    time = np.arange(0.0, 14.0, 0.01)
    updates = np.arange(1.0, 6.6, 0.5)
    std = 0.02 * np.exp(-(updates - 1) * 0.9) + 2.4e-4
    value = LENGTH + std * rng.normal(0.0, 0.8, updates.size) - 0.02 * np.exp(-(updates - 1) * 1.8)
    fade = np.tanh(time) / (1 + np.exp((time - 6.3) / 0.3))
    reference = 0.08 * np.sin(2.1 * time) * fade + 0.45 / (1 + np.exp(-(time - 10.6) / 0.25))
    actual = np.interp(time - 0.018, time, reference) + rng.normal(0, 2e-4, time.size)
    force = 0.785 + 0.11 * np.sin(4.4 * time) * np.minimum(time / 3, 1) ** 2 + 0.02 * np.sin(8.8 * time)
    lower = np.array([-1.70, -2.15, -3.05, -0.05, -3.06, -1.57, -3.06])
    upper = np.array([1.70, 1.05, 3.05, 2.62, 3.06, 2.09, 3.06])
    speed = np.array([2.0, 2.0, 2.0, 2.0, 4.0, 4.0, 4.0])
    slope = np.array([0.8, 0.4, -0.9, 1.1, 1.4, -0.7, 0.9])
    position = (upper + lower) / 2 + slope * (reference[:, None] - 0.1) + 0.1 * slope
    return TrialReportData(
        level=Level.GOOD,
        verdict="The load is in the box: the length was learnt to 0.2 mm and the planned swing was feasible.",
        subtitle="Baxter, right arm · guess 0.328 m · true length 0.368 m · seed 7 · hidden: quadratic_drag=0.004",
        command="armdyn trial --length-guess 0.328 --seed 7",
        phases=(
            Span("kick", 0.0, 0.5),
            Span("estimate", 0.5, 6.5),
            Span("settle", 6.5, 8.0),
            Span("swing", 8.0, 13.0),
            Span("drop", 13.0, 14.0),
        ),
        notes=("load_force: 3 samples were left out (repeated time stamps).",),
        key_figures=(KeyFigure("Planning", "31 ms", "8 iterations, cost 0.515"),),
        estimates=(EstimateTrace("length", "m", updates, value, std, 0.328, LENGTH),),
        force=ForceTrace(time, force + rng.normal(0.0, 0.005, time.size), force, 0.005, True),
        gripper=GripperTrace(time, reference, actual),
        swing=SwingPicture(
            _swing(np.arange(0.0, 3.4, 0.01), 0.0, np.random.default_rng(0)),
            _swing(np.arange(0.0, 3.6, 0.01), 0.02, rng),
            Box(),
        ),
        joints=JointTrace(JOINTS, time, position, np.gradient(position, time, axis=0), lower, upper, speed),
        margins=tuple(
            Margin(limit, name, 10.2 + used, 0.9 * bound * used, bound, unit, (1 - 0.9 * used) * bound, used)
            for limit, unit, bound in (("velocity", "rad/s", 2.0), ("torque", "N m", 50.0))
            for name, used in zip(JOINTS, (0.31, 0.94, 0.42, 0.66, 0.12, 0.5, 0.2), strict=True)
        ),
        nodes=(
            Timing("measurement", 0.01, 1300, 1300 * 2.1e-5, 9e-5),
            Timing("estimator", 0.5, 12, 12 * 6.2e-4, 1.4e-3),
            Timing("SAC", 0.05, 120, 120 * 4.1e-4, 9.8e-4, 2),
            Timing("task", None, 1, 0.031, 0.031),
        ),
    )


def seeds(share):
    return tuple(i < round(20 * share) for i in range(20))


def make_table():
    rng = np.random.default_rng(5)
    without = (0, 0, 0, 0.95, 1.0, 0.05, 0, 0, 0)
    guesses = np.arange(0.308, 0.469, 0.02)
    rows = [
        TableRow(
            float(guess),
            seeds(share),
            seeds(1.0 if i else 0.95),
            tuple(0.36782 + rng.normal(0, 4e-4, 20)),
            (4e-4,) * 20,
        )
        for i, (guess, share) in enumerate(zip(guesses, without, strict=True))
    ]
    return TableOne(20, LENGTH, tuple(rows))


@pytest.fixture
def trial_data():
    return make_trial_data()


@pytest.fixture
def table():
    return make_table()
