import math
from itertools import pairwise

import numpy as np
import pytest

import ik
import urdf
from pipeline.motion import Gate, LineGate, LineLimits, LineSmoother, LineState, finish_over_box
from pipeline.motion.gate import Refusal, Withheld

DT = 0.01


@pytest.fixture(scope="module")
def gate(robot: urdf.Robot, table: ik.LineTable) -> LineGate:
    return LineGate(LineLimits.from_table(table), table, Gate(robot.joint_names, robot.limits))


def said(refusal: Refusal | None) -> Withheld | None:
    return refusal.why if refusal else None


def test_what_the_smoother_makes_of_noise_passes_every_cycle(gate: LineGate) -> None:
    rng = np.random.default_rng(3)
    smoother = LineSmoother(gate.limits, DT, LineState(0.0))
    for _ in range(300):
        before = smoother.state
        after = smoother.update(LineState(*map(float, rng.normal(0.0, [0.4, 1.0, 5.0]))))
        assert gate.check(after, before) is None


def test_the_finish_passes_every_cycle(gate: LineGate) -> None:
    move = list(finish_over_box(LineState(0.13, 0.2), 0.46, gate.limits, DT))
    refusals = {gate.check(after, before) for before, after in pairwise(move)}
    assert refusals == {None}


@pytest.mark.parametrize(
    ("reference", "why"),
    [
        (LineState(math.nan), Withheld.NOT_A_NUMBER),
        (LineState(0.0, math.inf), Withheld.NOT_A_NUMBER),
        (LineState(0.5501), Withheld.OFF_THE_LINE),
        (LineState(-0.31), Withheld.OFF_THE_LINE),
        (LineState(0.5, 0.6), Withheld.LINE_SPEED),
        (LineState(0.0, 0.0, -16.0), Withheld.LINE_ACCELERATION),
    ],
)
def test_a_reference_beyond_a_limit_is_named(gate: LineGate, reference: LineState, why: Withheld) -> None:
    assert said(gate.check(reference)) is why


def test_a_jump_is_refused(gate: LineGate) -> None:
    assert said(gate.check(LineState(0.01), LineState(0.0))) is Withheld.JUMP
    assert said(gate.check(LineState(0.0, 0.05), LineState(0.0))) is Withheld.JUMP
    assert said(gate.check(LineState(0.0, 0.0, 3.0), LineState(0.0))) is Withheld.JUMP


def test_joint_limits_are_watched_besides_those_of_the_line(robot: urdf.Robot, table: ik.LineTable) -> None:
    generous = LineLimits(np.array([-0.3, 0.55]), np.full(2, 50.0), np.full(2, 500.0))
    gate = LineGate(generous, table, Gate(robot.joint_names, robot.limits))
    assert said(gate.check(LineState(0.0, 2.0))) is Withheld.VELOCITY
    assert said(gate.check(LineState(0.0, 0.0, 100.0))) is Withheld.ACCELERATION


def test_an_arm_that_is_elsewhere_is_noticed(gate: LineGate, table: ik.LineTable) -> None:
    q = table.posture(0.1).q.copy()
    assert gate.check(LineState(0.1), measured=q) is None
    q[3] += 0.3
    assert said(gate.check(LineState(0.1), measured=q)) is Withheld.TRACKING
    q[3] = math.nan
    assert said(gate.check(LineState(0.1), measured=q)) is Withheld.TRACKING
