import math
from itertools import pairwise

import numpy as np
import pytest

import ik
import urdf
from pipeline.motion import LineLimits, LineSmoother, LineState, finish_over_box
from pipeline.motion.limits import Gate, Refusal

DT = 0.01


@pytest.fixture(scope="module")
def gate(robot: urdf.Robot, table: ik.LineTable) -> Gate:
    return Gate(LineLimits.from_table(table), table, robot.limits, DT)


def test_what_the_smoother_makes_of_noise_passes_every_cycle(gate: Gate) -> None:
    rng = np.random.default_rng(3)
    smoother = LineSmoother(gate.limits, DT, LineState(0.0))
    for _ in range(300):
        before = smoother.state
        after = smoother.update(LineState(*map(float, rng.normal(0.0, [0.4, 1.0, 5.0]))))
        assert gate.check(after, before) is None


def test_the_finish_passes_every_cycle(gate: Gate) -> None:
    move = list(finish_over_box(LineState(0.13, 0.2), 0.46, gate.limits, DT))
    refusals = {gate.check(after, before) for before, after in pairwise(move)}
    assert refusals == {None}


@pytest.mark.parametrize(
    ("reference", "refusal"),
    [
        (LineState(math.nan), Refusal.NOT_A_NUMBER),
        (LineState(0.0, math.inf), Refusal.NOT_A_NUMBER),
        (LineState(0.5501), Refusal.OFF_THE_LINE),
        (LineState(-0.31), Refusal.OFF_THE_LINE),
        (LineState(0.5, 0.6), Refusal.TOO_FAST),
        (LineState(0.0, 0.0, -16.0), Refusal.TOO_STRONG),
    ],
)
def test_a_reference_beyond_a_limit_is_named(gate: Gate, reference: LineState, refusal: Refusal) -> None:
    assert gate.check(reference) is refusal


def test_a_jump_is_refused(gate: Gate) -> None:
    assert gate.check(LineState(0.01), LineState(0.0)) is Refusal.JUMP
    assert gate.check(LineState(0.0, 0.05), LineState(0.0)) is Refusal.JUMP
    assert gate.check(LineState(0.0, 0.0, 3.0), LineState(0.0)) is Refusal.JUMP


def test_joint_limits_are_watched_besides_those_of_the_line(robot: urdf.Robot, table: ik.LineTable) -> None:
    generous = LineLimits(np.array([-0.3, 0.55]), np.full(2, 50.0), np.full(2, 500.0))
    gate = Gate(generous, table, robot.limits, DT)
    assert gate.check(LineState(0.0, 2.0)) is Refusal.JOINT_VELOCITY
    assert gate.check(LineState(0.0, 0.0, 100.0)) is Refusal.JOINT_ACCELERATION


def test_an_arm_that_is_elsewhere_is_noticed(gate: Gate, table: ik.LineTable) -> None:
    q = table.posture(0.1).q.copy()
    assert gate.check(LineState(0.1), measured=q) is None
    q[3] += 0.3
    assert gate.check(LineState(0.1), measured=q) is Refusal.ARM_ELSEWHERE
    q[3] = math.nan
    assert gate.check(LineState(0.1), measured=q) is Refusal.ARM_ELSEWHERE
