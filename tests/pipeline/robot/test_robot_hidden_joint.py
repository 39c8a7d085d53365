"""Hidden physics of the joints, seen in the measured torque of motions for which it can be written down."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from armdyn.errors import InputError
from pipeline.robot.settings import PlantSettings
from pipeline.robot.simulated import SimulatedRobot

LAST, SHOULDER = 6, 1
WRIST_SHARE = 0.3  # effort limit of the wrist, 15 N m, relative to the shoulder's, 50 N m


def _plant(baxter, q_start, hidden=None):
    return SimulatedRobot(baxter, q_start, replace(PlantSettings.exact(), box=None), hidden)


def torque_at_speed(baxter, q_start, joint, speed, hidden=None, seconds=1.0):
    """Torque of one joint [N m] when it has turned at a constant speed for some time, and its position."""
    plant = _plant(baxter, q_start, hidden)
    v = np.zeros(7)
    v[joint] = speed
    for step in range(round(seconds * 100)):
        plant.command(q_start + v * step * 0.01, v, np.zeros(7))
        plant.advance(0.01)
    state = plant.joint_state()
    assert state.v[joint] == pytest.approx(speed, rel=0.02)
    return state.tau[joint], state.q


def excess(baxter, q_start, hidden, speed, seconds=1.0):
    """What an effect adds to the torque of the last joint, whose axis is vertical, at constant speed."""
    with_it, without = (torque_at_speed(baxter, q_start, LAST, speed, h, seconds)[0] for h in (hidden, None))
    return with_it - without


def test_joint_viscous_friction_grows_with_speed(baxter, q_start):
    for speed in (0.5, -1.0):
        added = excess(baxter, q_start, {"joint_viscous_friction": 2.0}, speed)
        assert added == pytest.approx(2.0 * WRIST_SHARE * speed, rel=0.02)


def test_joint_coulomb_friction_has_the_sign_of_the_speed(baxter, q_start):
    for speed in (0.5, -1.0):
        added = excess(baxter, q_start, {"joint_coulomb_friction": 2.0}, speed)
        assert added == pytest.approx(2.0 * WRIST_SHARE * np.sign(speed), rel=0.02)


def test_joint_asymmetric_friction_acts_in_one_direction(baxter, q_start):
    assert excess(baxter, q_start, {"joint_asymmetric_friction": 2.0}, 0.5) == pytest.approx(0.6, rel=0.02)
    assert excess(baxter, q_start, {"joint_asymmetric_friction": 2.0}, -0.5) == pytest.approx(0.0, abs=0.01)


def test_joint_stribeck_friction_fades_with_speed(baxter, q_start):
    for speed in (0.1, 0.15, 0.4):
        # A larger one would stick and slip: its fall with speed would exceed the servo's damping.
        added = excess(baxter, q_start, {"joint_stribeck_friction": 0.5}, speed, seconds=3.0)
        assert added == pytest.approx(0.5 * WRIST_SHARE * np.exp(-((speed / 0.1) ** 2)), abs=4e-3)


def test_joint_load_friction_is_a_share_of_the_gravity_torque(baxter, q_start):
    hidden = {"joint_load_friction": 0.1}
    loaded, q = torque_at_speed(baxter, q_start, SHOULDER, 0.2, hidden)
    plain, q_plain = torque_at_speed(baxter, q_start, SHOULDER, 0.2)
    gravity = pin.computeGeneralizedGravity(baxter.model, baxter.model.createData(), q)[SHOULDER]
    gravity_plain = pin.computeGeneralizedGravity(baxter.model, baxter.model.createData(), q_plain)[SHOULDER]
    assert loaded - gravity - (plain - gravity_plain) == pytest.approx(0.1 * abs(gravity), rel=0.05)


def test_rotor_inertia_adds_torque_in_proportion_to_acceleration(baxter, q_start):
    def apparent_inertia(hidden):
        plant = _plant(baxter, q_start, hidden)
        w, size, time, torque, velocity = 8.0, 0.2, [], [], []
        for _ in range(300):
            t = plant.time
            k = min(t, 1.0)
            reference = np.zeros((3, 7))
            reference[:, LAST] = k * size * np.array([np.sin(w * t), w * np.cos(w * t), -w * w * np.sin(w * t)])
            plant.command(q_start + reference[0], reference[1], reference[2])
            time.append(t)
            torque.append(plant.joint_state().tau[LAST])
            velocity.append(plant.joint_state().v[LAST])
            plant.advance(0.01)
        late = np.array(time) > 1.5
        phase = w * np.array(time)[late]
        basis = np.column_stack([np.cos(phase), np.sin(phase), np.ones_like(phase)])
        amplitudes = np.linalg.lstsq(basis, np.column_stack([torque, velocity])[late], rcond=None)[0]
        torque_amplitude, velocity_amplitude = amplitudes[0] - 1j * amplitudes[1]
        return (torque_amplitude / (1j * w * velocity_amplitude)).real

    added = apparent_inertia({"rotor_inertia": 0.2}) - apparent_inertia(None)
    assert added == pytest.approx(0.2 * WRIST_SHARE, rel=0.03)


def test_payload_adds_its_weight_to_every_joint(baxter, q_start):
    mass = 0.7
    added = _plant(baxter, q_start, {"payload": mass}).joint_state().tau - _plant(baxter, q_start).joint_state().tau
    data = baxter.model.createData()
    jacobian = pin.computeFrameJacobian(baxter.model, data, q_start, baxter.tool_frame_id, pin.LOCAL_WORLD_ALIGNED)
    np.testing.assert_allclose(added, jacobian[2] * mass * 9.81, atol=1e-9)


def test_link_inertia_scales_the_gravity_torque(baxter, q_start):
    added = _plant(baxter, q_start, {"link_inertia": 0.2}).joint_state().tau - _plant(baxter, q_start).joint_state().tau
    gravity = pin.computeGeneralizedGravity(baxter.model, baxter.model.createData(), q_start)
    np.testing.assert_allclose(added, 0.2 * gravity, atol=1e-9)


def test_gravity_spring_relieves_the_shoulder(baxter, q_start):
    plain, relieved = (_plant(baxter, q_start, h).joint_state().tau for h in (None, {"gravity_spring": None}))
    q = q_start[SHOULDER]
    assert relieved[SHOULDER] - plain[SHOULDER] == pytest.approx(8.2 * np.sin(q) + 35.3 * np.cos(q))
    assert abs(relieved[SHOULDER]) < abs(plain[SHOULDER]) / 2
    np.testing.assert_allclose(np.delete(relieved, SHOULDER), np.delete(plain, SHOULDER))


def test_gravity_spring_follows_the_joint(baxter, q_start):
    moved, q = torque_at_speed(baxter, q_start, SHOULDER, 0.3, {"gravity_spring": 0.5}, seconds=2.0)
    plain, q_plain = torque_at_speed(baxter, q_start, SHOULDER, 0.3, seconds=2.0)
    # The start's mismatch is carried along as a constant, so the two motions differ slightly.
    gravity = [
        pin.computeGeneralizedGravity(baxter.model, baxter.model.createData(), x)[SHOULDER] for x in (q, q_plain)
    ]
    angle = q[SHOULDER]
    spring = 0.5 * (8.2 * np.sin(angle) + 35.3 * np.cos(angle))
    assert (moved - gravity[0]) - (plain - gravity[1]) == pytest.approx(spring, rel=0.01)


def test_robot_without_springs_cannot_have_their_effect(baxter, q_start):
    with pytest.raises(InputError, match="gravity_spring"):
        _plant(replace(baxter, springs=()), q_start, {"gravity_spring": None})


def test_torque_offset_and_gain_change_the_measured_effort_only(baxter, q_start):
    plain, wrong = (_plant(baxter, q_start, h) for h in (None, {"torque_offset": 0.4, "torque_gain": 0.1}))
    np.testing.assert_allclose(wrong.joint_state().tau, 1.1 * plain.joint_state().tau + 0.4)
    for plant in (plain, wrong):
        plant.advance(0.5)
    np.testing.assert_array_equal(wrong.history().q, plain.history().q)
