import numpy as np
import pytest
from scipy.integrate import solve_ivp

from armdyn.physics.readout import lagged, sampled

DT = 0.01
TIME = np.arange(0.0, 4.0, DT)
SIGNAL = np.sin(6 * TIME) + 0.3 * np.cos(11 * TIME)


@pytest.mark.parametrize("tau", [0.003, 0.02, 0.3])
def test_lag_is_the_solution_of_its_differential_equation(tau):
    exact = solve_ivp(
        lambda t, z: (np.interp(t, TIME, SIGNAL) - z) / tau, (0, TIME[-1]), SIGNAL[:1], "RK45", TIME, max_step=DT / 4,
        rtol=1e-10, atol=1e-12,
    )  # fmt: skip
    assert np.abs(lagged(SIGNAL[:, None], tau, DT)[0][:, 0] - exact.y[0]).max() < 1e-6


def test_no_lag_changes_nothing():
    assert np.array_equal(lagged(SIGNAL[:, None], 0.0, DT)[0][:, 0], SIGNAL)


@pytest.mark.parametrize("tau", [0.0, 1e-3, 0.02, 0.3])
def test_lag_derivative_matches_finite_differences(tau):
    h = 1e-7
    above, below = (lagged(SIGNAL[:, None], max(tau + s, 0.0), DT)[0][:, 0] for s in (h, -h))
    measured = (above - below) / (2 * h if tau > h else h)
    assert np.abs(lagged(SIGNAL[:, None], tau, DT)[1] - measured).max() < 2e-4 * np.abs(measured).max()


def test_delay_is_interpolated_to_fourth_order():
    position = np.arange(5, 390) - 0.37
    values, slope = sampled(SIGNAL[:, None], position)
    at = DT * position
    assert np.abs(values[:, 0] - np.sin(6 * at) - 0.3 * np.cos(11 * at)).max() < 1e-5
    assert np.abs(slope / DT - 6 * np.cos(6 * at) + 3.3 * np.sin(11 * at)).max() < 2e-2


def test_samples_on_the_grid_are_the_grid():
    assert np.array_equal(sampled(SIGNAL[:, None], np.arange(400.0))[0][:, 0], SIGNAL)


def test_before_the_start_the_first_value_holds():
    values, slope = sampled(SIGNAL[:, None], np.array([-3.2, -0.1, 0.5]))
    assert values[0, 0] == values[1, 0] == SIGNAL[0]
    assert slope[0] == slope[1] == 0.0
