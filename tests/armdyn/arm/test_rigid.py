import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from worlds.baxter import CENTRE, JOINTS, rigid_torque

from armdyn.arm.rigid import (
    GravityTorques,
    described_parameters,
    inertial_parameters,
    inverse_dynamics,
    is_physical,
    pseudo_inertia,
    pseudo_inertia_factor,
    torque_regressor,
)
from armdyn.effects.catalogue import find

from . import urdfs


def random_motion(n, seed=0):
    rng = np.random.default_rng(seed)
    return CENTRE + 0.7 * rng.standard_normal((n, 7)), rng.standard_normal((n, 7)), 3 * rng.standard_normal((n, 7))


def test_torques_are_those_of_mujoco(baxter):
    motion = random_motion(200)
    ours = inverse_dynamics(baxter.arm.model, *motion)
    theirs = rigid_torque(*motion)
    assert baxter.joints == JOINTS
    assert np.abs(ours - theirs).max() < 1e-10 * np.abs(theirs).max()


def test_torques_are_linear_in_the_inertial_parameters(baxter):
    motion = random_motion(50)
    model = baxter.arm.model
    regressor = torque_regressor(model, *motion)
    torque = np.einsum("njlk,lk->nj", regressor, described_parameters(model))
    assert torque == pytest.approx(inverse_dynamics(model, *motion), abs=1e-10)


@pytest.mark.parametrize("chain", [None, "MIXED", "SLIDE", "DOUBLE"])
def test_torques_are_linear_in_gravity(baxter, tmp_path, chain):
    model = baxter.arm.model
    if chain is not None:
        model = urdfs.arm(tmp_path, getattr(urdfs, chain)).arm.model
    q = np.random.default_rng(0).uniform(-2, 2, (20, model.nv))
    gravity = np.array([3.0, -5.0, 7.0])
    other = model.copy()
    other.gravity.linear = gravity
    still, ours = np.zeros_like(q), GravityTorques(model, q)
    assert pytest.approx(inverse_dynamics(other, q, still, still), abs=1e-10) == (ours.described @ gravity).T
    by_link = torque_regressor(other, q, still, still)[:, 0, :, :4]
    for link in range(model.nv):
        assert gravity @ ours.gravity_torque_of_link(0, link) == pytest.approx(by_link[:, link], abs=1e-10)


def test_torques_under_another_gravity_are_those_of_mujoco(baxter):
    motion = random_motion(50)
    model = baxter.with_effect(find("base_tilt")).with_values({"base_tilt.roll": 0.7, "base_tilt.pitch": -1.1})
    other = baxter.arm.model.copy()
    other.gravity.linear = model.gravity()
    theirs = rigid_torque(*motion, tilt=(0.7, -1.1))
    assert inverse_dynamics(other, *motion) == pytest.approx(theirs, abs=1e-9)


@pytest.mark.parametrize(
    ("joints", "count"),
    [
        (urdfs.SLIDE, 1),  # the mass
        (urdfs.PENDULUM, 3),  # I, m x, m z
        (urdfs.DOUBLE, 6),  # the same of the outer link; I + m2 l^2, m x + m2 l, m z of the inner one
    ],
)
def test_base_parameters_are_as_many_as_by_hand(tmp_path, joints, count):
    model, rng = urdfs.arm(tmp_path, joints).arm.model, np.random.default_rng(0)
    q, v, a = rng.standard_normal((3, 50, model.nv))
    regressor = torque_regressor(model, q, v, a)
    assert np.linalg.matrix_rank(regressor.reshape(-1, 10 * model.nv), tol=1e-9 * np.abs(regressor).max()) == count


def test_pseudo_inertia_gives_back_the_inertial_parameters():
    pin.seed(0)
    inertia = pin.Inertia.Random()
    parameters = np.asarray(inertia.toDynamicParameters())
    J = pseudo_inertia(parameters)
    assert np.asarray(inertial_parameters(ca.DM(J))).ravel() == pytest.approx(parameters)
    assert is_physical(parameters)
    U = pseudo_inertia_factor(parameters, float(inertia.mass))
    assert np.allclose(np.triu(U), U)
    assert pytest.approx(J, abs=1e-4 * np.abs(J).max()) == U @ U.T


@pytest.mark.parametrize("parameters", [np.zeros(10), np.array([2.0, 0.2, 0, 0, 0, 0, 0, 0, 0, 0])])
def test_a_link_without_extent_or_mass_can_be_deformed(parameters):
    U = pseudo_inertia_factor(parameters, 5.0)
    assert np.linalg.eigvalsh(U @ U.T)[0] > 0


def test_a_negative_mass_is_not_physical():
    assert not is_physical(np.array([-1.0, 0, 0, 0, 0.1, 0, 0.1, 0, 0, 0.1]))
