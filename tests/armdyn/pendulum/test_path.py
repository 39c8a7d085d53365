import pickle
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline
from scipy.signal import TransferFunction, lsim

from armdyn.errors import InputError
from armdyn.pendulum.path import GripperPath, OnlinePathSmoother, RunInProgress, fixed_pivot_path, gripper_path
from armdyn.readout import InterpolatingSampler, SensorReadout, first_order_lag
from armdyn.recording.spikes import thin_out
from armdyn.run import Channel, Run
from armdyn.smoothing.even import first_and_second_derivatives, smoothed_motion

DT = 0.01
TIME = np.arange(0.0, 10.0, DT)
X = 0.05 * np.sin(2 * np.pi * 0.6 * TIME) + 0.02 * np.sin(2 * np.pi * 1.3 * TIME)
V = 0.05 * 3.7699111843 * np.cos(2 * np.pi * 0.6 * TIME) + 0.02 * 8.1681408993 * np.cos(2 * np.pi * 1.3 * TIME)
A = -0.05 * 3.7699111843**2 * np.sin(2 * np.pi * 0.6 * TIME) - 0.02 * 8.1681408993**2 * np.sin(2 * np.pi * 1.3 * TIME)


def rms(error):
    return float(np.sqrt(np.mean(error**2)))


def test_derivatives_of_exact_samples_are_of_fourth_order():
    coarse, fine = (first_and_second_derivatives(X[::k], k * DT)[1] - A[::k] for k in (4, 2))
    assert np.abs(coarse[3:-3]).max() / np.abs(fine[6:-6]).max() == pytest.approx(16, rel=0.2)


def test_smoothing_finds_acceleration_in_encoder_noise():
    noise = np.random.default_rng(0).normal(0, 2e-4, len(X))
    x, v, a = smoothed_motion(TIME, X + noise, DT)
    assert rms(x - X) < 0.4 * 2e-4
    assert rms(v - V) < 2e-3
    assert rms((a - A)[20:-20]) < 0.03 * np.abs(A).max()


def test_positions_that_were_averaged_in_groups_are_those_of_the_gripper():
    """Averages lie inside every bend: 6e-5 of this motion, which would be told as a gripper that moves farther."""
    time = np.arange(0.0, 20.0, 2e-3)
    path = Channel(time, np.sin(5.0 * time), "m")
    run = thin_out(Run("fast.csv", {"gripper_x": path}, {}, {"gripper_x": 0.0}))
    found = gripper_path(replace(run, channels={**run.channels, "swing_angle": run.channels["gripper_x"]}))
    inner = slice(20, -20)
    for row, exact in enumerate((np.sin(5.0 * found.time), 5.0 * np.cos(5.0 * found.time))):
        assert np.abs(found.nodes[1 + row] - exact)[inner].max() < 2e-6 * 5.0**row


def test_exact_positions_are_left_alone():
    assert np.array_equal(smoothed_motion(TIME, X, DT, exact=True)[0], X)


@pytest.mark.parametrize("noise", [0.0, 2e-4])
def test_slow_and_uneven_stamps_give_the_acceleration(noise):
    rng = np.random.default_rng(3)
    time = np.arange(0.0, TIME[-1], 0.04) + rng.uniform(-4e-3, 4e-3, len(np.arange(0.0, TIME[-1], 0.04)))
    x = np.interp(time, TIME, X) if noise else CubicSpline(TIME, X)(time)
    _, _, a = smoothed_motion(time, x + noise * rng.normal(size=len(x)), DT, exact=noise == 0.0)
    at = time[0] + DT * np.arange(len(a))
    inside = (at > 0.5) & (at < TIME[-1] - 0.5)
    assert rms((a - np.interp(at, TIME, A))[inside]) < (0.15 if noise else 0.01) * np.abs(A).max()


def test_a_growing_path_ends_like_the_whole_one():
    noisy = X + np.random.default_rng(2).normal(0, 2e-4, len(X))
    growing = OnlinePathSmoother(DT)
    for first in range(0, len(noisy), 5):
        motion = growing.extend(noisy[first : first + 5])
    _, v, _ = smoothed_motion(TIME, noisy, DT)
    assert rms((motion[1] - v)[:-60]) < 2e-3
    assert rms((motion[2] - A)[20:-60]) < 0.05 * np.abs(A).max()


def test_halfway_inputs_are_exact_for_a_quintic():
    t = np.arange(0.0, 1.0, 0.1)
    p = np.polynomial.Polynomial([0.1, -0.3, 0.5, 1.0, -2.0, 0.7])
    path = GripperPath(0.0, 0.1, p(t), p.deriv()(t), p.deriv(2)(t))
    between = t[:-1] + 0.05
    assert np.allclose(path.nodes[1], p(t))
    for row, derivative in zip(path.midpoints[1:4], (p, p.deriv(), p.deriv(2)), strict=True):
        assert np.allclose(row, derivative(between), atol=1e-3 if derivative is not p else 1e-12)


def test_a_part_of_a_path_has_its_nodes_and_times():
    t = np.arange(0.0, 1.0, 0.1)
    path = GripperPath(0.0, 0.1, np.sin(t), np.cos(t), -np.sin(t))
    part = path.segment(3, 7)
    assert np.array_equal(part.nodes, path.nodes[:, 3:8])
    assert np.array_equal(part.midpoints, path.midpoints[:, 3:7])
    assert part.time == pytest.approx(t[3:8])


def test_too_few_samples_are_refused_in_one_line(complains):
    with complains(InputError):
        smoothed_motion(TIME[:3], X[:3], DT)


def test_a_growing_run_goes_to_another_process_with_its_path():
    path = fixed_pivot_path(0.0, 1.0, DT)
    run = RunInProgress("trial", {"load_force": Channel(np.arange(5.0), np.zeros(5), "N")}, noise={}, path=path)
    copy = pickle.loads(pickle.dumps(run))
    assert isinstance(copy, RunInProgress)
    np.testing.assert_array_equal(gripper_path(copy).x, path.x)


GRID = np.arange(0.0, 4.0, DT)
SIGNAL = np.sin(6 * GRID) + 0.3 * np.cos(11 * GRID)


@pytest.mark.parametrize("tau", [0.003, 0.02, 0.3])
def test_lag_is_the_solution_of_its_differential_equation(tau):
    exact = solve_ivp(
        lambda t, z: (np.interp(t, GRID, SIGNAL) - z) / tau, (0, GRID[-1]), SIGNAL[:1], "RK45", GRID, max_step=DT / 4,
        rtol=1e-10, atol=1e-12,
    )  # fmt: skip
    assert np.abs(first_order_lag(SIGNAL[:, None], tau, DT)[0][:, 0] - exact.y[0]).max() < 1e-6


def test_no_lag_changes_nothing():
    assert np.array_equal(first_order_lag(SIGNAL[:, None], 0.0, DT)[0][:, 0], SIGNAL)


@pytest.mark.parametrize("tau", [0.0, 1e-3, 0.02, 0.3])
def test_lag_derivative_matches_finite_differences(tau):
    h = 1e-7
    above, below = (first_order_lag(SIGNAL[:, None], max(tau + s, 0.0), DT)[0][:, 0] for s in (h, -h))
    measured = (above - below) / (2 * h if tau > h else h)
    assert np.abs(first_order_lag(SIGNAL[:, None], tau, DT)[1] - measured).max() < 2e-4 * np.abs(measured).max()


@pytest.mark.parametrize("uneven", [0.0, 0.3])
def test_lag_of_uneven_samples_is_that_of_the_same_polygon(uneven):
    stamps = GRID + uneven * DT * np.sin(37 * GRID)
    fine = np.unique(np.concatenate([stamps, 0.5 * (stamps[1:] + stamps[:-1])]))
    polygon = np.interp(fine, stamps, SIGNAL)
    finer = first_order_lag(polygon[:, None], 0.04, np.diff(fine))[0][:, 0]
    coarse = first_order_lag(SIGNAL[:, None], 0.04, np.diff(stamps))[0][:, 0]
    assert np.abs(coarse - finer[np.searchsorted(fine, stamps)]).max() < 1e-12


def read(stamps, delay=0.0, derivative=0):
    """The signal at other times."""
    return InterpolatingSampler(GRID, stamps).matrix(delay, derivative) @ SIGNAL


def test_delay_is_interpolated_to_fourth_order():
    stamps = GRID[5:390]
    at = stamps - 0.37 * DT
    assert np.abs(read(stamps, 0.37 * DT) - np.sin(6 * at) - 0.3 * np.cos(11 * at)).max() < 1e-5
    assert np.abs(read(stamps, 0.37 * DT, 1) - 6 * np.cos(6 * at) + 3.3 * np.sin(11 * at)).max() < 2e-2


def test_samples_on_the_grid_are_the_grid():
    assert np.array_equal(read(GRID), SIGNAL)


def test_before_the_start_the_first_value_holds():
    stamps = DT * np.array([-3.2, -0.1, 0.5])
    assert np.array_equal(read(stamps)[:2], SIGNAL[[0, 0]])


LATE, SLOW = 0.37 * DT, 4 * DT


def test_what_a_late_or_slow_sensor_shows_first_was_there_before_the_start():
    theta = ca.SX.sym("theta", 2)
    sampler, signal = InterpolatingSampler(GRID, GRID), SIGNAL[:, None]
    late = SensorReadout(theta[:0], delay=LATE).read(signal, sampler, np.zeros(0))[:, 0]
    assert np.abs(late - np.sin(6 * (GRID - LATE)) - 0.3 * np.cos(11 * (GRID - LATE))).max() < 3e-3
    slow = SensorReadout(theta[:0], lag=SLOW).read(signal, sampler, np.zeros(0))[:, 0]
    steady = sum(part / (1 + 1j * w * SLOW) * np.exp(1j * w * GRID) for w, part in ((6, -1j), (11, 0.3))).real
    assert np.abs(slow - steady).max() < 0.3 * np.abs(SIGNAL[0] - steady[0])


def test_the_adjoint_of_a_sensor_gives_the_same_sum():
    sensor, sampler = SensorReadout(ca.SX(0, 1), lag=SLOW, delay=LATE), InterpolatingSampler(GRID, GRID)
    weights, signal = np.random.default_rng(0).normal(size=(2, len(GRID)))
    seen = sensor.read(signal[:, None], sampler, np.zeros(0))[:, 0]
    assert sensor.adjoint(weights, sampler, np.zeros(0)) @ signal == pytest.approx(weights @ seen, rel=1e-12)


def test_noise_in_a_smoothed_acceleration_does_not_make_the_response_to_it_look_smaller():
    """An arm's drives follow steps of the acceleration as a damped vibration; its encoders have a coarse step."""
    w, damping, step = 2.0 * np.pi * 8.0, 0.3, 1e-3
    fine = step * np.arange(10000)
    drive = TransferFunction([w**2], [1.0, 2.0 * damping * w, w**2])
    slopes = []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        wanted = rng.uniform(-1.0, 1.0, 51)[(fine / 0.2).astype(int)]
        a = lsim(drive, wanted - wanted.mean(), fine)[1]
        x = np.cumsum(np.cumsum(a)) * step**2
        measured = x[::10] + 3e-4 * rng.standard_normal(1000)
        inner = slice(10, -10)
        found = smoothed_motion(fine[::10], measured, 0.01)[2][inner]
        slopes.append(float(found @ a[::10][inner] / (found @ found)))
    assert np.mean(slopes) > 1.0
