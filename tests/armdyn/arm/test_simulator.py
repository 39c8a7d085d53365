from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from armdyn.arm.closed_loop.simulator import DriveInputs, simulate_arm
from armdyn.arm.control_laws import CONTROL_LAWS
from armdyn.arm.model import ArmModel, arm_model

from . import urdfs
from .conftest import with_effects


def drives(count: int, joints: int, **given: np.ndarray | float) -> DriveInputs:
    off = DriveInputs.off(count, [CONTROL_LAWS["position"]] * joints)
    return replace(
        off, signals=replace(off.signals, **{k: np.broadcast_to(v, (count, joints)) for k, v in given.items()})
    )


@pytest.fixture(scope="module")
def ur5() -> ArmModel:
    return arm_model(robot="ur5")


@pytest.fixture(scope="module")
def sled(tmp_path_factory) -> ArmModel:
    sled = urdfs.arm(tmp_path_factory.mktemp("sled"), urdfs.SLIDE)
    return with_effects(sled, joint_coulomb_friction__torque=3.0)


def by_runge_kutta(model: pin.Model, v: np.ndarray, step: float, count: int) -> tuple[np.ndarray, np.ndarray]:
    data, n, none = model.createData(), len(v), np.zeros(len(v))
    x = np.concatenate([none, v])

    def rate(x: np.ndarray) -> np.ndarray:
        return np.concatenate([x[n:], pin.aba(model, data, x[:n], x[n:], none)])

    for _ in range(count):
        k1 = rate(x)
        k2 = rate(x + step / 2 * k1)
        k3 = rate(x + step / 2 * k2)
        x = x + step / 6 * (k1 + 2 * k2 + 2 * k3 + rate(x + step * k3))
    return x[:n], x[n:]


def test_a_free_motion_is_that_of_pinocchios_articulated_bodies_to_second_order_in_the_step(ur5):
    begin, errors = np.linspace(-1.0, 1.0, 6), []
    true, _ = by_runge_kutta(ur5.arm.model, begin, 1e-3, 500)
    for step in (4e-3, 2e-3, 1e-3):
        count = round(0.5 / step)
        q, _ = simulate_arm(ur5, ur5.theta(), (np.zeros(6), begin), drives(count, 6), step)
        errors.append(np.abs(q[-1] - true).max())
    assert errors[-1] < 2e-4
    assert errors[0] / errors[1] > 3.5
    assert errors[1] / errors[2] > 3.5


def test_a_free_arm_keeps_its_energy(ur5):
    model, data = ur5.arm.model, ur5.arm.model.createData()
    q, v = simulate_arm(ur5, ur5.theta(), (np.zeros(6), np.linspace(-1.0, 1.0, 6)), drives(2000, 6), 1e-3)
    kinetic = np.array([pin.computeKineticEnergy(model, data, *state) for state in zip(q, v, strict=True)])
    total = kinetic + [pin.computePotentialEnergy(model, data, at) for at in q]
    assert np.ptp(total) < 1e-3 * np.ptp(kinetic)


def test_what_slides_stops_where_its_friction_has_used_up_its_energy_and_rests_exactly(sled):
    q, v = simulate_arm(sled, sled.theta(), (np.zeros(1), np.array([1.5])), drives(1000, 1), 2e-3)
    assert q[-1, 0] == pytest.approx(0.5 * 2.0 * 1.5**2 / 3.0, abs=1e-5)
    stopped = np.arange(len(v)) * 2e-3 > 2.0 * 1.5 / 3.0 + 2e-3
    assert not v[stopped].any()


def test_a_force_below_the_friction_moves_nothing_and_one_above_moves_by_what_is_left(sled):
    still, _ = simulate_arm(sled, sled.theta(), (np.zeros(1), np.zeros(1)), drives(500, 1, feed=2.99), 2e-3)
    moved, _ = simulate_arm(sled, sled.theta(), (np.zeros(1), np.zeros(1)), drives(500, 1, feed=5.0), 2e-3)
    assert not still.any()
    assert moved[-1, 0] == pytest.approx(0.5 * (5.0 - 3.0) / 2.0, rel=1e-9)


def test_a_servo_that_swings_rests_where_its_gain_no_longer_overcomes_the_friction(sled):
    servo = drives(5000, 1, command=0.5, share=1.0, gain=40.0, damping=4.0)
    q, v = simulate_arm(sled, sled.theta(), (np.zeros(1), np.zeros(1)), servo, 2e-3)
    assert not v[-1].any()
    assert 0.0 < abs(0.5 - q[-1, 0]) <= 3.0 / 40.0 + 1e-9


def test_a_saturated_servo_accelerates_by_its_limit_and_one_that_is_off_by_nothing(sled):
    servo = drives(250, 1, command=5.0, share=1.0, gain=1000.0, limit=7.0)
    q, _ = simulate_arm(sled, sled.theta(), (np.zeros(1), np.zeros(1)), servo, 2e-3)
    off, _ = simulate_arm(
        sled, sled.theta(), (np.zeros(1), np.zeros(1)), drives(250, 1, command=5.0, gain=1000.0), 2e-3
    )
    assert q[-1, 0] == pytest.approx(0.5 * (7.0 - 3.0) / 2.0 * 0.5**2, rel=1e-9)
    assert not off.any()


def test_joints_that_stick_and_slide_together_keep_every_friction_within_its_size(ur5):
    model = with_effects(
        ur5,
        joint_coulomb_friction__torque=6.0,
        joint_viscous_friction__coefficient=2.0,
        rotor_inertia__inertia=0.3,
    )
    step, count = 2e-3, 1500
    time_ = (np.arange(count) + 0.5)[:, None] * step
    servo = drives(count, 6, command=0.3 * np.sin(time_ * np.arange(1.0, 7.0)), share=1.0, gain=600.0, damping=20.0)
    start = np.zeros(6), np.zeros(6)
    q, v = simulate_arm(model, model.theta(), start, servo, step)
    middle, mean, rate = q[:-1] + step / 2 * v[:-1], (v[:-1] + v[1:]) / 2, (v[1:] - v[:-1]) / step
    arm, data = model.arm.model.copy(), model.arm.model.createData()
    arm.armature = np.full(6, 0.3)
    asked = np.array([pin.rnea(arm, data, *row) for row in zip(middle, mean, rate, strict=True)]) + 2.0 * mean
    friction = 600.0 * (servo.signals.command - middle) - 20.0 * mean - asked
    stands, slides = v[1:] == 0.0, np.abs(v[1:]) > 1e-3
    assert 0.02 < stands.mean() < 0.5
    assert np.abs(friction[stands]).max() < 6.0 + 0.3
    assert np.median(np.abs(friction[slides] - 6.0 * np.sign(v[1:][slides]))) < 0.01
