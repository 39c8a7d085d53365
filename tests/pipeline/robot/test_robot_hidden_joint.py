"""Hidden physics of the joints, seen in the measured torque of motions for which it can be written down."""

import numpy as np
import pinocchio as pin
import pytest

LAST, SHOULDER = 6, 1
WRIST_SHARE = 0.3  # effort limit of the wrist, 15 N m, relative to the shoulder's, 50 N m


def gravity(baxter, q):
    return pin.computeGeneralizedGravity(baxter.model, baxter.model.createData(), q)


def torque_at_speed(robot, q_start, joint, speed, seconds=1.0):
    """Torque of one joint [N m] when it has turned at a constant speed for some time, and all positions."""
    v = speed * np.eye(7)[joint]
    for step in range(round(seconds * 100)):
        robot.command(q_start + v * step * 0.01, v, np.zeros(7))
        robot.advance(0.01)
    state = robot.joint_state()
    assert state.v[joint] == pytest.approx(speed, rel=0.02)
    return state.tau[joint], state.q


@pytest.mark.parametrize(
    ("name", "value", "added"),
    [
        ("joint_viscous_friction", 2.0, lambda speed: 2.0 * speed),
        ("joint_coulomb_friction", 2.0, lambda speed: 2.0 * np.sign(speed)),
        ("joint_asymmetric_friction", 2.0, lambda speed: 2.0 * (speed > 0)),
        # A larger one would stick and slip: its fall with speed would exceed the servo's damping.
        ("joint_stribeck_friction", 0.5, lambda speed: 0.5 * np.sign(speed) * np.exp(-((speed / 0.1) ** 2))),
    ],
)
def test_friction_of_a_joint_adds_its_torque_at_constant_speed(plant, q_start, name, value, added):
    """In the last joint, whose axis is vertical."""
    for speed in (0.1, 0.15, 0.4) if name == "joint_stribeck_friction" else (0.5, -1.0):
        seconds = 3.0 if speed < 0.5 else 1.0
        with_it, without = (torque_at_speed(plant(h), q_start, LAST, speed, seconds)[0] for h in ({name: value}, None))
        assert with_it - without == pytest.approx(WRIST_SHARE * added(speed), rel=0.02, abs=4e-3)


@pytest.mark.parametrize(
    ("hidden", "speed", "tolerance"), [({"joint_load_friction": 0.1}, 0.2, 0.05), ({"gravity_spring": 0.5}, 0.3, 0.01)]
)
def test_what_depends_on_the_posture_follows_the_joint(plant, baxter, q_start, hidden, speed, tolerance):
    rest = []
    for h in (hidden, None):
        torque, q = torque_at_speed(plant(h), q_start, SHOULDER, speed, 2.0)
        rest.append(torque - gravity(baxter, q)[SHOULDER])  # the two motions differ slightly
        angle = q[SHOULDER]
    weight = abs(gravity(baxter, q)[SHOULDER])
    spring = 8.2 * np.sin(angle) + 35.3 * np.cos(angle)
    expected = 0.1 * weight if "joint_load_friction" in hidden else 0.5 * spring
    assert rest[0] - rest[1] == pytest.approx(expected, rel=tolerance)


def test_rotor_inertia_adds_torque_in_proportion_to_acceleration(plant, q_start):
    def apparent_inertia(hidden):
        robot, w, rows = plant(hidden), 8.0, []
        for _ in range(300):
            t = robot.time
            shape = min(t, 1.0) * 0.2 * np.array([np.sin(w * t), w * np.cos(w * t), -w * w * np.sin(w * t)])
            q, v, a = np.outer(shape, np.eye(7)[LAST])
            robot.command(q_start + q, v, a)
            state = robot.joint_state()
            rows.append((t, state.tau[LAST], state.v[LAST]))
            robot.advance(0.01)
        time, torque, velocity = np.array([row for row in rows if row[0] > 1.5]).T
        basis = np.column_stack([np.cos(w * time), np.sin(w * time), np.ones_like(time)])
        amplitudes = np.linalg.lstsq(basis, np.column_stack([torque, velocity]), rcond=None)[0]
        torque_amplitude, velocity_amplitude = amplitudes[0] - 1j * amplitudes[1]
        return (torque_amplitude / (1j * w * velocity_amplitude)).real

    added = apparent_inertia({"rotor_inertia": 0.2}) - apparent_inertia(None)
    assert added == pytest.approx(0.2 * WRIST_SHARE, rel=0.03)


def test_at_rest_each_effect_adds_what_statics_say(plant, baxter, q_start):
    plain = plant().joint_state().tau
    jacobian = pin.computeFrameJacobian(
        baxter.model, baxter.model.createData(), q_start, baxter.tool_frame_id, pin.LOCAL_WORLD_ALIGNED
    )
    spring = 8.2 * np.sin(q_start[SHOULDER]) + 35.3 * np.cos(q_start[SHOULDER])
    for hidden, added in (
        ({"payload": 0.7}, jacobian[2] * 0.7 * 9.81),
        ({"link_inertia": 0.2}, 0.2 * gravity(baxter, q_start)),
        ({"gravity_spring": None}, spring * np.eye(7)[SHOULDER]),
        ({"torque_offset": 0.4, "torque_gain": 0.1}, 0.1 * plain + 0.4),
    ):
        np.testing.assert_allclose(plant(hidden).joint_state().tau - plain, added, atol=1e-9)
    assert abs(plain[SHOULDER] + spring) < abs(plain[SHOULDER]) / 2  # the spring relieves the shoulder


def test_torque_offset_and_gain_do_not_change_the_motion(plant):
    plain, wrong = (plant(h) for h in (None, {"torque_offset": 0.4, "torque_gain": 0.1}))
    for robot in (plain, wrong):
        robot.advance(0.3)
    np.testing.assert_array_equal(wrong.history().q, plain.history().q)
