import numpy as np
import pytest
from derivatives import assert_jacobian
from scipy.integrate import solve_ivp
from worlds.baxter import generate

from armdyn.arm.model import arm_model
from armdyn.effects.catalogue import find
from armdyn.effects.effect import effect
from armdyn.errors import InputError
from armdyn.parameter import quantity
from armdyn.run import Channel, Run

JOINT = "right_s0"
TIME = np.arange(0.0, 4.0, 0.01)


@effect("bristle_friction", acts_on="joint", summary="dry friction of bristles that bend", source="Dahl 1968")
def bristle_friction(
    joint,
    torque=quantity("N m", typical=1.0, lower=0),
    bend=quantity("rad", typical=0.02, null=0.02, lower=1e-4),
):
    speed = (joint.velocity**2 + 1e-12) ** 0.5
    joint, bent = joint.with_state(lambda z: joint.velocity - speed * z / bend)
    return joint.with_torque(torque * bent / bend)


def moving(q):
    """A run of one joint whose torque is to be predicted."""
    channels = {f"q.{JOINT}": Channel(TIME, q, "rad"), f"tau.{JOINT}": Channel(TIME, 0 * q, "N m")}
    return Run("a.csv", channels, noise={f"q.{JOINT}": 0.0})


@pytest.fixture(scope="module")
def run():
    return moving(0.5 * np.sin(2 * TIME) + 0.05 * np.sin(9 * TIME))


def model(torque, bend):
    made = arm_model(robot="baxter", joints=[JOINT], effects=[bristle_friction])
    return made.with_values({f"bristle_friction.torque[{JOINT}]": torque, f"bristle_friction.bend[{JOINT}]": bend})


def test_a_bristle_bends_along_the_recorded_motion(run):
    def rate(t, z):
        v = 1.0 * np.cos(2 * t) + 0.45 * np.cos(9 * t)
        return v - abs(v) * z / 0.05

    reference = solve_ivp(rate, (0, 4), [0.0], "DOP853", TIME, rtol=1e-9, atol=1e-12, max_step=0.005).y[0] / 0.05
    bristle, without = model(2.0, 0.05), model(0.0, 0.05)
    added = bristle.predict(run, bristle.theta()).values - without.predict(run, without.theta()).values
    assert np.abs(added / 2.0 - reference)[5:-5].max() < 0.02


@pytest.mark.parametrize("bend", [0.05, 1e-3])
def test_its_derivatives_are_exact_also_where_it_is_stiff(run, bend):
    bristle = model(2.0, bend)
    exact = bristle.predict(run, bristle.theta()).sensitivities
    steps = np.array([1e-3, 1e-4 * bend])
    assert_jacobian(lambda theta: bristle.predict(run, theta).values, bristle.theta(), exact, steps, 1e-5)


def test_it_changes_nothing_on_other_joints_and_nothing_at_null():
    recorded = generate(None, 1.0, 0, duration=3.0)
    bare = arm_model(robot="baxter")
    with_it = bare.with_effect(bristle_friction.on("right_w0"))
    prepared = bare.prepare_run(recorded)
    predicted, expected = (m.predict(prepared, m.theta()).values for m in (with_it, bare))
    assert np.array_equal(predicted, expected)


def test_a_state_that_follows_the_load_is_refused(complains):
    @effect("loaded", acts_on="joint", summary="", source="")
    def loaded(joint, size=quantity("1", typical=1.0)):
        joint, z = joint.with_state(lambda z: joint.load - z)
        return joint.with_torque(size * z)

    refused = arm_model(robot="baxter", joints=[JOINT], effects=[loaded])
    with complains(InputError):
        refused.changed_links(refused.theta())


@effect("torque_lag", acts_on="joint", summary="the torque sensor is a first-order lag", source="VIM §4.23")
def torque_lag(joint, time=quantity("s", typical=0.02, lower=0.0, upper=1.0)):
    return joint.with_lag(time)


@pytest.mark.parametrize("prepared", [False, True])
def test_a_torque_sensor_lags_with_exact_derivatives(prepared):
    effects = [find(name) for name in ("torque_gain", "torque_offset", "torque_delay", "link_inertia", "base_tilt")]
    slow = arm_model(robot="baxter", joints=[JOINT, "right_s1"], effects=[torque_lag, *effects])
    rng = np.random.default_rng(2)
    slow = slow.with_values({n: p.value + 0.2 * p.typical * rng.uniform(0.5, 1) for n, p in slow.parameters.items()})
    recorded = generate("joint_viscous_friction", 1.0, 0, duration=3.0)
    recorded = slow.prepare_run(recorded) if prepared else recorded
    steps = np.array([1e-3 * p.typical for p in slow.parameters.values()])
    exact = slow.predict(recorded, slow.theta()).sensitivities
    assert_jacobian(lambda theta: slow.predict(recorded, theta).values, slow.theta(), exact, steps, 1e-4)


def test_a_lagging_torque_trails_by_the_time_constant():
    swing = moving(np.sin(2 * TIME))
    model = arm_model(robot="baxter", joints=[JOINT], effects=[torque_lag])
    on_time = model.predict(swing, model.theta()).values
    late = model.with_values({f"torque_lag.time[{JOINT}]": 0.05})
    trailing = late.predict(swing, late.theta()).values
    settled = slice(100, 390)
    assert 0.05 * np.gradient(trailing, TIME)[settled] == pytest.approx(
        (on_time - trailing)[settled], abs=1e-3 * np.ptp(on_time)
    )
