import numpy as np
import pytest
from scipy.integrate import solve_ivp

from armdyn.readout import Interpolated, lagged

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


@pytest.mark.parametrize("uneven", [0.0, 0.3])
def test_lag_of_uneven_samples_is_that_of_the_same_polygon(uneven):
    stamps = TIME + uneven * DT * np.sin(37 * TIME)
    fine = np.unique(np.concatenate([stamps, 0.5 * (stamps[1:] + stamps[:-1])]))
    polygon = np.interp(fine, stamps, SIGNAL)
    finer = lagged(polygon[:, None], 0.04, np.diff(fine))[0][:, 0]
    coarse = lagged(SIGNAL[:, None], 0.04, np.diff(stamps))[0][:, 0]
    assert np.abs(coarse - finer[np.searchsorted(fine, stamps)]).max() < 1e-12


def read(stamps, delay=0.0, derivative=0):
    """The signal at other times."""
    return Interpolated(TIME, stamps).matrix(delay, derivative) @ SIGNAL


def test_delay_is_interpolated_to_fourth_order():
    stamps = TIME[5:390]
    at = stamps - 0.37 * DT
    assert np.abs(read(stamps, 0.37 * DT) - np.sin(6 * at) - 0.3 * np.cos(11 * at)).max() < 1e-5
    assert np.abs(read(stamps, 0.37 * DT, 1) - 6 * np.cos(6 * at) + 3.3 * np.sin(11 * at)).max() < 2e-2


def test_samples_on_the_grid_are_the_grid():
    assert np.array_equal(read(TIME), SIGNAL)


def test_before_the_start_the_first_value_holds():
    stamps = DT * np.array([-3.2, -0.1, 0.5])
    assert np.array_equal(read(stamps)[:2], SIGNAL[[0, 0]])
    assert np.array_equal(read(stamps, derivative=1)[:2], [0.0, 0.0])
