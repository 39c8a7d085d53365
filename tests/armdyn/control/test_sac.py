import numpy as np
import pytest

from armdyn.control.sac import SacSettings, SacState, SequentialActionControl, needle
from armdyn.effects.catalogue import CATALOGUE
from armdyn.errors import InputError
from armdyn.pendulum.model import pendulum_model

MODEL = pendulum_model(0.368, 0.08, [CATALOGUE["linear_drag"]]).with_values({"linear_drag.coefficient": 0.005})


@pytest.fixture(scope="module")
def control():
    return SequentialActionControl(MODEL)


def test_from_exact_rest_nothing_moves(control):
    still = SacState(0.0, 0.0, 0.0, np.zeros(2), np.zeros(2))
    assert np.all(control.act(still, MODEL).schedule == 0.0)


def test_saturation_and_speed_guard_hold(control):
    fast = SacState(0.0, 0.0, 0.89, np.array([0.5, 0.01]), np.array([2.0, 0.05]))
    schedule = control.act(fast, MODEL).schedule
    assert np.abs(schedule).max() <= control.settings.largest_acceleration + 1e-12
    speed = 0.89 + np.cumsum(schedule) * control.settings.dt
    assert np.abs(speed).max() <= control.settings.largest_speed + 1e-12


def test_the_barrier_turns_the_gripper_round(control):
    outside = SacState(0.0, 0.25, 0.1, np.zeros(2), np.array([0.1, 0.0]))
    assert control.act(outside, MODEL).acceleration < 0.0


def test_a_needle_keeps_its_impulse_whatever_the_grid():
    schedule = needle(1.5, 0.0234, 0.1178, 80, 0.01)
    assert schedule.sum() * 0.01 == pytest.approx(1.5 * (0.1178 - 0.0234))
    assert np.all(schedule[12:] == 0.0)


def test_settings_that_cannot_work_are_refused():
    with pytest.raises(InputError, match="desired_change"):
        SacSettings(desired_change=1.0)
    with pytest.raises(InputError, match="horizon"):
        SacSettings(horizon=0.0)
