from types import SimpleNamespace

import numpy as np
import pytest

from armdyn.document import Document, KeyFigure, ResultLevel
from pipeline.box import Box
from pipeline.motion.feasibility import LimitMargin
from pipeline.nodes.learning import LengthEstimate, Outcome
from pipeline.nodes.scheduler import NodeTiming
from pipeline.report.feasibility import joint_motion_sections, limit_margin_section
from pipeline.report.trial import (
    SwingTrace,
    estimate_section,
    force_section,
    gripper_section,
    swing_section,
    timing_section,
)
from pipeline.trial.table import TableOne
from urdf.robot import Limits

LENGTH = 0.368
JOINTS = tuple(f"right_{name}" for name in ("s0", "s1", "e0", "e1", "w0", "w1", "w2"))


def _swing(time, shift, rng):
    """A pivot that goes 0.45 m across while a load of the true length swings up to the box and drops."""
    gripper = 0.45 / (1 + np.exp(-(time - 2.6) / 0.28)) - 0.09 * np.exp(-(((time - 1.3) / 0.5) ** 2))
    angle = 0.62 * np.exp(-(((time - 2.9) / 1.1) ** 2)) * np.sin(5.16 * (time - 2.35)) + shift
    angle += rng.normal(0.0, 0.001, time.shape)
    return SwingTrace(time + 8.0, gripper, gripper - LENGTH * np.sin(angle), -LENGTH * np.cos(angle))


@pytest.fixture
def trial():
    """What the sections of a trial's report are made of."""
    rng = np.random.default_rng(3)
    time, updates = np.arange(0.0, 14.0, 0.01), np.arange(1.0, 6.6, 0.5)
    std = 0.02 * np.exp(-(updates - 1) * 0.9) + 2.4e-4
    value = LENGTH + std * rng.normal(0.0, 0.8, updates.size) - 0.02 * np.exp(-(updates - 1) * 1.8)
    reference = 0.08 * np.sin(2.1 * time) * np.tanh(time) + 0.45 / (1 + np.exp(-(time - 10.6) / 0.25))
    force = 0.785 + 0.11 * np.sin(4.4 * time) * np.minimum(time / 3, 1) ** 2
    lower, upper = np.array(
        [[-1.7, -2.15, -3.05, -0.05, -3.06, -1.57, -3.06], [1.7, 1.05, 3.05, 2.62, 3.06, 2.09, 3.06]]
    )
    slope = np.array([0.8, 0.4, -0.9, 1.1, 1.4, -0.7, 0.9])
    q = (upper + lower) / 2 + slope * (reference[:, None] - 0.1) + 0.1 * slope
    limits = Limits(lower, upper, np.array([2.0, 2.0, 2.0, 2.0, 4.0, 4.0, 4.0]), *[np.full(7, 50.0)] * 3)
    margins = tuple(
        LimitMargin(limit, name, 10.2 + used, 0.9 * bound * used, bound, unit, (1 - 0.9 * used) * bound, used)
        for limit, unit, bound in (("velocity", "rad/s", 2.0), ("torque", "N m", 50.0))
        for name, used in zip(JOINTS, (0.31, 0.94, 0.42, 0.66, 0.12, 0.5, 0.2), strict=True)
    )
    return SimpleNamespace(
        time=time,
        estimates=[LengthEstimate(*row, Outcome.CONVERGED, 1e-3) for row in zip(updates, value, std, strict=True)],
        force=force,
        measured=force + rng.normal(0.0, 0.005, time.size),
        reference=reference,
        actual=np.interp(time - 0.018, time, reference) + rng.normal(0, 2e-4, time.size),
        planned=_swing(np.arange(0.0, 3.4, 0.01), 0.0, rng),
        executed=_swing(np.arange(0.0, 3.6, 0.01), 0.02, rng),
        q=q,
        v=np.gradient(q, time, axis=0),
        limits=limits,
        margins=margins,
    )


@pytest.fixture
def trial_report(trial):
    t, phases = trial, [("kick", 0.0, 0.5), ("estimate", 0.5, 6.5), ("settle", 6.5, 8.0), ("swing", 8.0, 14.0)]
    nodes = [
        NodeTiming("estimator", 0.5, 12, 12 * 6.2e-4, 1.4e-3),
        NodeTiming("SAC", 0.05, 120, 120 * 4.1e-4, 9.8e-4, 2),
    ]
    return Document(
        "Trial: learn the string, swing the load",
        "The load is in the box.",
        [
            swing_section(t.planned, t.executed, Box(), 0.014),
            estimate_section(t.estimates, 0.328, LENGTH, phases),
            force_section(t.time, t.measured, t.force, 0.005, phases),
            gripper_section(t.time, t.reference, t.actual, phases),
            *joint_motion_sections(JOINTS, t.time, t.q, t.v, t.limits),
            limit_margin_section(t.margins),
            timing_section(nodes),
        ],
        ResultLevel.GOOD,
        key_figures=[KeyFigure("Planning", "31 ms", "8 iterations")],
        notes=["load_force: 3 samples were left out (repeated time stamps)."],
    )


@pytest.fixture
def table():
    rng = np.random.default_rng(5)
    of_20 = [(0, 19), *[(0, 20)] * 2, (19, 20), (20, 20), (1, 20), *[(0, 20)] * 3]  # without and with estimation
    succeeded = np.arange(20) < np.array(of_20)[:, :, None]
    return TableOne(LENGTH, succeeded, 0.36782 + rng.normal(0, 4e-4, (9, 20)), np.full((9, 20), 4e-4))
