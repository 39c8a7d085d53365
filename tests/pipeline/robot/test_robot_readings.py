from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from pipeline.robot.settings import PlantSettings, ReadingSettings
from pipeline.robot.simulated import SimulatedRobot


def _readings(baxter, q_start, readings):
    plant = SimulatedRobot(baxter, q_start, replace(PlantSettings.exact(), readings=readings))
    states = []
    for _ in range(400):
        states.append(plant.joint_state())
        plant.advance(0.001)
    return states


def test_positions_are_multiples_of_the_encoder_step(baxter, q_start):
    step = 2 * np.pi / 2**14
    q = np.array([s.q for s in _readings(baxter, q_start, ReadingSettings())])
    np.testing.assert_allclose(q / step, np.round(q / step), atol=1e-6)
    assert np.abs(q - q_start).max() < 2 * step


def test_velocity_and_effort_noise_are_those_of_the_settings(baxter, q_start):
    states = _readings(baxter, q_start, ReadingSettings())
    assert np.std([s.v for s in states]) == pytest.approx(0.012, rel=0.05)
    assert np.std([s.tau for s in states], axis=0) == pytest.approx([0.08] * 4 + [0.03] * 3, rel=0.15)


def test_asked_twice_at_the_same_time_the_reading_is_the_same(baxter, q_start):
    plant = SimulatedRobot(baxter, q_start)
    first = plant.joint_state()
    assert plant.joint_state() is first
    plant.advance(0.001)
    assert plant.joint_state() is not first


def test_efforts_at_rest_are_those_that_hold_arm_and_load(baxter, q_start):
    data = baxter.model.createData()
    gravity = pin.computeGeneralizedGravity(baxter.model, data, q_start)
    state = SimulatedRobot(baxter, q_start, PlantSettings.exact()).joint_state()
    at_tool = pin.SE3(np.eye(3), np.array(baxter.tool_offset)).toActionMatrixInverse()
    local = at_tool @ pin.computeFrameJacobian(baxter.model, data, q_start, baxter.tool_frame_id, pin.LOCAL)
    up = baxter.tool_pose(q_start).rotation[2] @ local[:3]
    np.testing.assert_allclose(state.tau, gravity + up * 0.08 * 9.81, atol=1e-9)
