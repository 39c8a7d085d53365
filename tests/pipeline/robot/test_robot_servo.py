import numpy as np
import pytest
from scipy.interpolate import CubicSpline

import urdf
from pipeline.robot.devices import Reference
from pipeline.robot.protocol import RobotInterface
from pipeline.robot.settings import PlantSettings
from pipeline.robot.simulated import SimulatedRobot


def sine(time):
    w, a, k = 3.2, 0.08, min(time, 0.5) / 0.5
    return k * a * np.sin(w * time), a * w * np.cos(w * time) * k, -a * w * w * np.sin(w * time) * k


def _lag(rows):
    """Delay of the true path behind the commanded one [s], and what remains [m rms]."""
    time, commanded = np.array([r[0] for r in rows]), np.array([r[1] for r in rows])
    true = np.array([r[2].s for r in rows])
    path, later = CubicSpline(time, commanded), time > 1.0
    delays = np.arange(0.0, 0.06, 0.0005)
    errors = [np.sqrt(np.mean((true[later] - path(time[later] - d)) ** 2)) for d in delays]
    return delays[np.argmin(errors)], min(errors)


def test_simulated_robot_has_the_interface_of_a_robot(baxter, q_start):
    robot: RobotInterface = SimulatedRobot(baxter, q_start)
    assert robot.joint_names == baxter.joint_names
    assert robot.time == 0.0


def test_arm_follows_a_sine_with_the_lag_of_its_filter(baxter, q_start, line_motion):
    rows = line_motion.follow(SimulatedRobot(baxter, q_start, PlantSettings.exact()), sine, 5.0)
    lag, rest = _lag(rows)
    assert 0.014 < lag < 0.020
    assert rest < 1e-3


def test_friction_and_wrong_inertias_make_the_lag_longer(baxter, q_start, line_motion):
    exact = _lag(line_motion.follow(SimulatedRobot(baxter, q_start, PlantSettings.exact()), sine, 4.0))[0]
    rubbing = _lag(line_motion.follow(SimulatedRobot(baxter, q_start, PlantSettings(), seed=1), sine, 4.0))[0]
    assert exact + 0.002 < rubbing < 0.040


def test_arm_stays_on_the_line_within_two_millimetres(baxter, q_start, line_motion):
    rows = line_motion.follow(SimulatedRobot(baxter, q_start, PlantSettings(), seed=1), sine, 4.0)
    off = np.array([gripper.position - baxter.line.position(gripper.s) for _, _, gripper, _ in rows])
    assert np.abs(off).max() < 2e-3


def test_arm_comes_to_rest_when_commands_stop(baxter, q_start, line_motion):
    plant = SimulatedRobot(baxter, q_start, PlantSettings.exact())
    line_motion.follow(plant, sine, 0.9)
    assert abs(plant.gripper_truth().s_velocity) > 0.1
    plant.advance(1.0)
    at_rest = plant.gripper_truth()
    plant.advance(1.0)
    assert abs(at_rest.s_velocity) < 5e-3
    assert plant.gripper_truth().s == pytest.approx(at_rest.s, abs=1e-3)


def test_stop_brakes_at_once(baxter, q_start, line_motion):
    plant = SimulatedRobot(baxter, q_start, PlantSettings.exact())
    line_motion.follow(plant, sine, 0.9)
    before = plant.gripper_truth().s
    plant.stop()
    plant.advance(0.5)
    assert abs(plant.gripper_truth().s_velocity) < 5e-3
    assert abs(plant.gripper_truth().s - before) < 0.02


def test_command_after_a_stop_moves_again(baxter, q_start, line_motion):
    plant = SimulatedRobot(baxter, q_start, PlantSettings.exact())
    plant.stop()
    plant.advance(0.3)
    for _ in range(100):
        plant.command(*line_motion.joints(0.05, 0.0, 0.0))
        plant.advance(0.01)
    assert plant.gripper_truth().s == pytest.approx(0.05, abs=1e-3)


class TestReference:
    limit = np.array([20.0, 40.0])
    limits = urdf.Limits(
        lower=np.full(2, -3.0), upper=np.full(2, 3.0), velocity=np.full(2, 4.0), acceleration=limit,
        jerk=50.0 * limit, effort=np.full(2, 50.0),
    )  # fmt: skip

    def _moving(self):
        reference = Reference(np.zeros(2), self.limits, 0.1)
        reference.command(1.0, np.array([0.1, 0.2]), np.array([1.0, -2.0]), np.array([3.0, 0.0]))
        return reference

    def test_extrapolates_with_constant_acceleration(self):
        q, v, a = self._moving().at(1.008)
        np.testing.assert_allclose(q, [0.1 + 0.008 + 1.5 * 0.008**2, 0.2 - 0.016])
        np.testing.assert_allclose(v, [1.024, -2.0])
        np.testing.assert_allclose(a, [3.0, 0.0])

    def test_velocity_is_the_derivative_of_position_all_the_way_to_rest(self):
        reference = self._moving()
        time = 1.0 + np.arange(0.0, 0.4, 1e-5)
        q = np.array([reference.at(t)[0] for t in time])
        v = np.array([reference.at(t)[1] for t in time])
        np.testing.assert_allclose(np.diff(q, axis=0) / 1e-5, (v[1:] + v[:-1]) / 2, atol=1e-6)

    def test_brakes_within_the_acceleration_limits(self):
        reference = self._moving()
        time = 1.0 + np.arange(0.0, 0.4, 1e-4)
        a = np.array([reference.at(t)[2] for t in time])
        assert (np.abs(a) <= self.limit + 1e-12).all()
        np.testing.assert_allclose(reference.at(1.4)[1], 0.0)

    def test_holds_the_start_before_the_first_command(self):
        q, v, a = Reference(np.array([0.3, 0.4]), self.limits, 0.1).at(100.0)
        np.testing.assert_array_equal([q, v, a], [[0.3, 0.4], [0.0, 0.0], [0.0, 0.0]])

    def test_a_second_stop_changes_nothing(self):
        reference = self._moving()
        reference.stop(1.02)
        once = reference.at(1.3)
        reference.stop(1.05)
        np.testing.assert_array_equal(reference.at(1.3), once)
