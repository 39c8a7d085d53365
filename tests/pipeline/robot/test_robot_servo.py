"""How the arm follows its commands, and what its joints report."""

import numpy as np
import pinocchio as pin
import pytest
from scipy.interpolate import CubicSpline
from simulated_truth import gripper_truth, load_truth

import urdf
from pipeline.robot.devices import CommandedMotion, SimulatedCell
from pipeline.robot.hidden import resolve_hidden
from pipeline.robot.protocol import RobotInterface
from pipeline.robot.settings import CellSettings, PlantSettings


def sine(time):
    w, a, k = 3.2, 0.08, min(time, 0.5) / 0.5
    return k * a * np.sin(w * time), a * w * np.cos(w * time) * k, -a * w * w * np.sin(w * time) * k


def lag_of(rows):
    """Delay of the true path behind the commanded one [s], and what remains [m rms]."""
    time, commanded = np.array([r[0] for r in rows]), np.array([r[1] for r in rows])
    true = np.array([r[2].s for r in rows])
    path, later = CubicSpline(time, commanded), time > 1.0
    delays = np.arange(0.0, 0.06, 0.0005)
    errors = [np.sqrt(np.mean((true[later] - path(time[later] - d)) ** 2)) for d in delays]
    return delays[np.argmin(errors)], min(errors)


def test_arm_follows_a_sine_on_the_line_with_the_lag_of_its_filter_and_friction_makes_it_longer(plant, follow, baxter):
    exact: RobotInterface = plant()
    lag, rest = lag_of(follow(exact, sine, 4.0))
    assert 0.012 < lag < 0.020  # the filter has 0.015 s
    assert rest < 1e-3
    rows = follow(plant(settings=PlantSettings(), seed=1), sine, 4.0)
    assert lag + 0.002 < lag_of(rows)[0] < 0.040
    off = np.array([gripper.position - baxter.line.position(gripper.s) for _, _, gripper, _ in rows])
    assert np.abs(off).max() < 2e-3


def test_arm_comes_to_rest_when_commands_stop_at_once_when_told_and_moves_again(plant, follow):
    for told, seconds, way in ((False, 1.0, 0.1), (True, 0.5, 0.02)):
        robot = plant()
        follow(robot, sine, 0.9)
        before = gripper_truth(robot)
        assert abs(before.s_velocity) > 0.1
        if told:
            robot.stop()
        robot.advance(seconds)
        at_rest = gripper_truth(robot)
        assert abs(at_rest.s_velocity) < 5e-3
        assert abs(at_rest.s - before.s) < way
        robot.advance(0.5)
        assert gripper_truth(robot).s == pytest.approx(at_rest.s, abs=1e-3)
    follow(robot, lambda _time: (at_rest.s + 0.05, 0.0, 0.0), 1.0)
    assert gripper_truth(robot).s == pytest.approx(at_rest.s + 0.05, abs=1e-3)


def test_readings_are_quantised_and_noisy_as_the_settings_say(plant, q_start):
    robot, states = plant(readings=PlantSettings().readings), []
    for _ in range(400):
        states.append(robot.joint_state())
        assert robot.joint_state() is states[-1]  # asked twice at the same time
        robot.advance(0.001)
    q, step = np.array([s.q for s in states]), 2 * np.pi / 2**14
    np.testing.assert_allclose(q / step, np.round(q / step), atol=1e-6)
    assert np.abs(q - q_start).max() < 2 * step
    assert np.std([s.v for s in states]) == pytest.approx(0.012, rel=0.05)
    assert np.std([s.tau for s in states], axis=0) == pytest.approx([0.08] * 4 + [0.03] * 3, rel=0.15)


def test_efforts_at_rest_are_those_that_hold_arm_and_load(plant, baxter, q_start):
    data = baxter.model.createData()
    gravity = pin.computeGeneralizedGravity(baxter.model, data, q_start)
    at_tool = pin.SE3(np.eye(3), np.array(baxter.tool_offset)).toActionMatrixInverse()
    local = at_tool @ pin.computeFrameJacobian(baxter.model, data, q_start, baxter.tool_frame_id, pin.LOCAL)
    up = baxter.tool_pose(q_start).rotation[2] @ local[:3]
    np.testing.assert_allclose(plant().joint_state().tau, gravity + up * 0.08 * 9.81, atol=1e-9)


LIMITS = urdf.Limits(
    lower=np.full(2, -3.0), upper=np.full(2, 3.0), velocity=np.full(2, 4.0), acceleration=np.array([20.0, 40.0]),
    jerk=np.array([1000.0, 2000.0]), effort=np.full(2, 50.0),
)  # fmt: skip


@pytest.fixture
def moving():
    reference = CommandedMotion(np.zeros(2), LIMITS, 0.1)
    reference.command(1.0, np.array([0.1, 0.2]), np.array([1.0, -2.0]), np.array([3.0, 0.0]))
    return reference


def test_reference_extrapolates_then_brakes_within_the_limits_and_stays(moving):
    q, v, a = moving.at(1.008)
    np.testing.assert_allclose(q, [0.1 + 0.008 + 1.5 * 0.008**2, 0.2 - 0.016])
    np.testing.assert_allclose(v, [1.024, -2.0])
    np.testing.assert_allclose(a, [3.0, 0.0])
    time = 1.0 + np.arange(0.0, 0.4, 1e-4)
    q, v, a = (np.array(x) for x in zip(*(moving.at(t) for t in time), strict=True))
    np.testing.assert_allclose(np.diff(q, axis=0) / 1e-4, (v[1:] + v[:-1]) / 2, atol=1e-5)
    assert (np.abs(a) <= LIMITS.acceleration + 1e-12).all()
    np.testing.assert_allclose(v[-1], 0.0)
    moving.stop(1.02)
    once = moving.at(1.3)
    moving.stop(1.05)  # changes nothing
    np.testing.assert_array_equal(moving.at(1.3), once)
    before = CommandedMotion(np.array([0.3, 0.4]), LIMITS, 0.1).at(100.0)
    np.testing.assert_array_equal(before, [[0.3, 0.4], [0.0, 0.0], [0.0, 0.0]])


QUIET = {"noise": 0.0, "resolution": 0.0}
LAG = 1.0 / (1.0 + 6.0j * 0.05)
"""Response of a first-order filter of 0.05 s at 6 rad/s."""


def wave(time):
    return 0.8 + 0.1 * np.sin(6.0 * time)


def cell(hidden=None, latency=0.0, bias=0.0, seed=1, **settings):
    rng = np.random.default_rng(seed)
    return SimulatedCell(CellSettings(**{**QUIET, **settings}), resolve_hidden(hidden or {}), bias, latency, rng)


def samples(tension, seconds=2.0, angle=0.0, **given):
    """Time of reception and reading of every sample of a cell that feels tension(t) and angle."""
    made = cell(**given)
    for step in range(round(seconds * 1000)):
        made.apply_tension(step, tension(step * 1e-3), angle)
    received = made.new_samples(seconds)
    return np.array([s.time for s in received]), np.array([s.force for s in received])


def test_samples_are_as_even_noisy_coarse_and_limited_as_the_settings_say():
    time, force = samples(lambda _: 0.8, 60.0, noise=5e-3)
    np.testing.assert_allclose(np.diff(time), 0.01, atol=1e-12)
    assert np.std(force) == pytest.approx(5e-3, rel=0.05)
    assert np.mean(force) == pytest.approx(0.8, abs=2e-4)
    _, force = samples(wave, resolution=5e-4)
    np.testing.assert_allclose(force / 5e-4, np.round(force / 5e-4), atol=1e-9)
    _, force = samples(lambda t: 20.0 * np.sin(6.0 * t), full_scale=9.8)
    assert (force.min(), force.max()) == (-9.8, 9.8)


def test_samples_on_the_way_are_not_handed_out_and_none_is_handed_out_twice():
    made = cell(latency=0.025)
    for step in range(51):
        made.apply_tension(step, 1.0, 0.0)
    assert [s.time for s in made.new_samples(0.05)] == pytest.approx([0.025, 0.035, 0.045])
    assert made.new_samples(0.05) == []
    assert [s.time for s in made.new_samples(0.06)] == pytest.approx([0.055])


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ({}, wave),
        ({"latency": 0.0137}, lambda t: wave(t - 0.0137)),
        ({"hidden": {"sensor_bias": 0.03}, "bias": 0.01}, lambda t: wave(t) + 0.04),
        ({"hidden": {"sensor_gain": -0.1}}, lambda t: 0.9 * wave(t)),
        ({"hidden": {"sensor_drift": 2e-3}}, lambda t: wave(t) + 2e-3 * t),
        ({"hidden": {"sensor_delay": 0.04}, "latency": 0.005}, lambda t: wave(t - 0.045)),
        ({"hidden": {"sensor_nonlinearity": 0.05}}, lambda t: wave(t) + 0.05 * wave(t) ** 2),
        ({"hidden": {"vertical_sensing_axis": None}, "angle": 0.4}, lambda t: wave(t) * np.cos(0.4)),
        ({"hidden": {"cross_axis_sensitivity": 0.05}, "angle": -0.4}, lambda t: wave(t) * (1.0 - 0.05 * np.sin(0.4))),
        ({"hidden": {"sensor_lag": 0.05}}, lambda t: 0.8 + 0.1 * np.abs(LAG) * np.sin(6.0 * t + np.angle(LAG))),
    ],
)
def test_reading_is_the_force_with_what_each_effect_makes_of_it(given, expected):
    time, force = samples(wave, 3.0, **given)
    late = time > 1.0
    tolerance = 4e-4 if "sensor_lag" in given.get("hidden", {}) else 1e-12  # the filter goes in steps of 1 ms
    np.testing.assert_allclose(force[late], expected(time[late]), atol=tolerance)


@pytest.mark.parametrize("name", ["vertical_sensing_axis", "cross_axis_sensitivity"])
def test_direction_of_the_swinging_string_reaches_the_cell(still_pendulum, name):
    robot = still_pendulum(0.4, {name: 0.5})
    robot.advance(0.5)
    load = load_truth(robot)
    robot.advance(0.001)
    share = np.cos(load.swing_angle) if name == "vertical_sensing_axis" else 1 + np.sin(load.swing_angle)
    assert robot.load_cell()[-1].force == pytest.approx(load.tension * (1 + share) / 2, abs=1e-6)
