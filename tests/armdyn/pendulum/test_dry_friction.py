"""Dry friction at the pivot against the discontinuous equation of a world."""

import numpy as np
import pytest
from derivatives import assert_jacobian
from worlds import dry_swing

from armdyn.effects.catalogue import CATALOGUE
from armdyn.effects.effect import effect
from armdyn.parameter import quantity
from armdyn.pendulum.model import pendulum_model
from armdyn.pendulum.path import GripperPath

LENGTH, MASS, G, DT = 0.368, 0.08, 9.81, 0.01
INERTIA, WEIGHT = MASS * LENGTH**2, MASS * G * LENGTH  # kg m^2, and N m per radian
AMPLITUDE, OMEGA = 0.02, 3.0
"""m and rad/s of a gripper below which the load sticks and slips, with a friction of 0.3 rad/s^2."""


def nodes(duration):
    return DT * np.arange(round(duration / DT) + 1)


def still(duration):
    rest = 0.0 * nodes(duration)
    return GripperPath(0.0, DT, rest, rest, rest)


def moving(t):
    """Position, velocity and acceleration of a gripper below which the load sticks and slips."""
    x = AMPLITUDE * np.sin(OMEGA * t)
    return np.array([x, AMPLITUDE * OMEGA * np.cos(OMEGA * t), -(OMEGA**2) * x])


def driven(duration):
    return GripperPath(0.0, DT, *moving(nodes(duration)))


def rubbing(effects=("pivot_coulomb_friction",), **values):
    model = pendulum_model(LENGTH, MASS, [CATALOGUE[name] for name in effects])
    return model.with_values({name.replace("__", "."): value for name, value in values.items()})


def rollout(model, path, channels=None):
    return model.rollout(path, model.theta(), channels)


def angles_of_the_discontinuous_equation(start, gripper=None, **effects):
    """Angles of a load that starts at rest at `start`, slides, stops and sticks."""
    load = dry_swing.Pendulum(LENGTH, MASS, effects)
    return dry_swing.swing(load, (start, 0.0), dry_swing.Push(gripper), nodes(30.0)).angle


@pytest.mark.parametrize("effects", [(), ("gripper_compliance",), ("out_of_plane_swing",), ("gripper_lag",)])
def test_a_load_that_the_friction_can_hold_stays_where_it_is(effects):
    model = rubbing((*effects, "pivot_coulomb_friction"), pivot_coulomb_friction__torque=0.3 * WEIGHT)
    released = rollout(model.with_values({"initial_angle": 0.29}), still(60.0), ("swing_angle", "swing_rate"))
    assert np.ptp(released.outputs[:, 0]) == 0.0
    assert np.abs(released.outputs[:, 1]).max() < 1e-15
    slipped = rollout(model.with_values({"initial_angle": 0.32}), still(60.0), ("swing_angle",))
    assert np.ptp(slipped.outputs[:, 0]) > 0.02


def test_a_small_swing_loses_four_times_the_friction_over_the_weight_in_every_period():
    model = rubbing(pivot_coulomb_friction__torque=2e-4 * WEIGHT, initial_angle=0.02)
    angle = rollout(model, still(8.0), ("swing_angle",)).outputs[:, 0]
    tops = angle[1:-1][(angle[1:-1] >= angle[:-2]) & (angle[1:-1] > angle[2:])]
    assert np.diff(tops) == pytest.approx(-8e-4, rel=0.02)


@pytest.mark.parametrize(
    ("kind", "size"),
    [
        ("torque", 0.05 * INERTIA), ("torque", 0.15 * INERTIA), ("torque", 0.6 * INERTIA),  # which stops within the run
        ("radius", 2e-3),  # of a friction that grows with the pull
    ],
)  # fmt: skip
def test_a_long_decay_is_that_of_the_discontinuous_equation(kind, size):
    effect = "pivot_coulomb_friction" if kind == "torque" else "pivot_load_friction"
    model = rubbing((effect,), **{f"{effect}__{kind}": size}, initial_angle=1.3)
    expected = angles_of_the_discontinuous_equation(1.3, **{effect: size})
    assert np.abs(rollout(model, still(30.0), ("swing_angle",)).outputs[:, 0] - expected).max() < 2e-5


def test_a_load_below_a_moving_gripper_sticks_and_slips_as_in_the_discontinuous_equation():
    model = rubbing(
        pivot_coulomb_friction__torque=0.3 * INERTIA, initial_angle=0.1,
        initial_rate=-AMPLITUDE * OMEGA / LENGTH * np.cos(0.1),
    )  # fmt: skip
    expected = angles_of_the_discontinuous_equation(0.1, moving, pivot_coulomb_friction=0.3 * INERTIA)
    found = rollout(model, driven(30.0), ("swing_angle",)).outputs[:, 0]
    assert np.abs(found - expected).max() < 1e-5
    assert np.mean(np.diff(expected) == 0.0) == pytest.approx(np.mean(np.diff(found) == 0.0), abs=0.01)
    assert np.mean(np.diff(found) == 0.0) > 0.05


def test_no_friction_changes_nothing_to_the_last_digit():
    at = {"initial_angle": 0.1}
    bare, none = (rollout(rubbing(effects).with_values(at), driven(10.0)) for effects in ((), ("pivot_load_friction",)))
    assert np.array_equal(bare.outputs, none.outputs)
    assert np.array_equal(bare.states, none.states)


# Decays that stop and stick; what yields, trails, remembers or swings across as well; and a friction that is not there.
@pytest.mark.parametrize(
    ("effects", "share"),
    [
        (("pivot_coulomb_friction",), 5.0),
        (("pivot_coulomb_friction",), 0.0),
        (("pivot_coulomb_friction", "pivot_load_friction", "quadratic_drag"), 3.0),
        (("gripper_compliance", "pivot_coulomb_friction"), 5.0),
        (("gripper_lag", "pivot_load_friction"), 3.0),
        (("out_of_plane_swing", "pivot_coulomb_friction"), 5.0),
    ],
)
@pytest.mark.parametrize("path", [still, driven])
def test_derivatives_are_exact_through_stops_and_sticking(effects, share, path):
    model, path = rubbing(effects, initial_angle=0.11, initial_rate=0.05), path(6.0)
    own = [p for p in model.parameters.values() if p.effect]
    model = model.with_values({p.name: p.typical * (share if "friction" in p.name else 1.0) for p in own})
    theta, channels = model.theta(), ("load_force", "swing_angle")
    ours = {name: i for i, name in enumerate((*model.physics_names, *model.start_names))}
    exact = model.rollout(path, theta, channels).sensitivities[::20][..., [ours[name] for name in model.names]]

    def outputs(point):
        return model.rollout(path, point, channels).outputs[::20].ravel()

    steps = 1e-6 * np.array([p.typical for p in model.parameters.values()])
    assert_jacobian(outputs, theta, exact.reshape(-1, len(theta)), steps, 1e-5)


def test_what_an_effect_remembers_stands_still_with_the_load():
    @effect("winding", acts_on="string", summary="", source="")
    def winding(string, torque=quantity("N m", typical=1e-3)):
        rate = string.rate
        string, turned = string.with_state(lambda z: rate + 0 * z)
        return string.with_torque(torque * turned)

    model = pendulum_model(LENGTH, MASS, [CATALOGUE["pivot_coulomb_friction"], winding])
    model = model.with_values({"pivot_coulomb_friction.torque": 0.3 * WEIGHT, "initial_angle": 0.25})
    assert np.abs(rollout(model, still(5.0)).states[:, 2]).max() < 1e-15


def test_control_and_planning_take_the_same_friction_with_a_smooth_sign():
    friction, at = {"pivot_coulomb_friction.torque": 1e-3}, np.zeros(7)
    rough, bare = rubbing().with_values(friction), rubbing(())
    state = np.array([0.2, -INERTIA * 1.5])
    lost = bare.dynamics().derivative(state, at, bare.physics_theta()) - rough.dynamics().derivative(
        state, at, rough.physics_theta()
    )
    assert np.array(lost).ravel() == pytest.approx([0.0, -1e-3], abs=1e-12)
    step = [
        np.array(model.variational().step([0, 0, 0.2, -1.5], 0.0, 0.0, DT, model.physics_theta()))[3, 0]
        for model in (rough, bare)
    ]
    assert step[0] - step[1] == pytest.approx(1e-3 * DT / INERTIA, rel=1e-3)
    assert rough.rest_angle() == pytest.approx(0.0, abs=1e-9)
