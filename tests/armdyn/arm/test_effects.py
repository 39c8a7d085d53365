"""Every effect on an arm: absent at null, exact derivatives, and the physics of a generator that shares no code."""

from dataclasses import replace

import numpy as np
import pytest
from derivatives import assert_jacobian
from worlds.baxter import generate, true_parameters

from armdyn.arm.model import arm_model
from armdyn.arm.rigid import is_physical
from armdyn.effects.catalogue import find
from armdyn.errors import InputError
from armdyn.run import Channel, Run

from .conftest import JOINT_EFFECTS, chi2_per_sample, fitted, residuals


@pytest.fixture(scope="module")
def short(baxter):
    """A short run, as recorded and prepared."""
    run = generate(None, 1.0, 0, duration=4.0)
    return {"as recorded": run, "prepared": baxter.prepare_run(run)}


def moved(model, seed=0):
    """Parameters away from their null values and inside their bounds."""
    rng = np.random.default_rng(seed)
    parameters = list(model.parameters.values())
    return np.array([p.value + rng.uniform(0.2, 0.8) * p.typical for p in parameters])


def test_all_effects_together_at_null_change_nothing_to_the_last_digit(baxter, short):
    everything = baxter.with_fixed_null_effects([find(name) for name in JOINT_EFFECTS])
    assert len(everything.names) > 150
    before, after = (m.predict(short["prepared"], m.theta()).values for m in (baxter, everything))
    assert np.array_equal(before, after)


def assert_sensitivities(model, run, theta, columns, share, tolerance):
    """Of some parameters, by steps that are a share of their typical sizes."""

    def predicted(part):
        whole = theta.copy()
        whole[columns] = part
        return model.predict(run, whole).values

    steps = share * np.array([model.parameters[model.names[i]].typical for i in columns])
    exact = model.predict(run, theta).sensitivities[:, columns]
    assert_jacobian(predicted, theta[columns], exact, steps, tolerance)


@pytest.mark.parametrize("kind", ["as recorded", "prepared"])
@pytest.mark.parametrize("name", JOINT_EFFECTS)
def test_an_effect_changes_nothing_at_null_to_the_last_digit_and_has_exact_derivatives(baxter, short, name, kind):
    friction = baxter.with_effect(find("joint_viscous_friction:right_s0"))
    friction = friction.with_values({"joint_viscous_friction.coefficient[right_s0]": 1.7})
    for bare in (baxter, friction):
        before, after = (m.predict(short[kind], m.theta()).values for m in (bare, bare.with_effect(find(name))))
        assert np.array_equal(before, after)
    model = baxter.with_effect(find(name))
    theta = moved(model)
    columns = np.arange(len(theta)) if len(theta) < 30 else np.random.default_rng(0).choice(len(theta), 20, False)
    assert_sensitivities(model, short[kind], theta, columns, 1e-4, 2e-5)


def test_sensitivities_of_effects_that_act_on_each_other_match_finite_differences(baxter, short):
    names = "joint_load_friction link_inertia payload torque_gain torque_delay joint_coupling base_tilt"
    model = baxter.with_fixed_null_effects([find(name) for name in names.split()])
    theta = moved(model, seed=1)
    columns = np.append(np.random.default_rng(2).choice(len(theta) - 2, 25, False), [len(theta) - 2, len(theta) - 1])
    columns = np.array([i for i in columns if not model.names[i].startswith("torque_delay")])  # see below
    # Small, for a friction that grows with the load has a kink where that changes its sign.
    assert_sensitivities(model, short["prepared"], theta, columns, 1e-5, 1e-4)


def test_sensitivities_by_a_delay_match_finite_differences(baxter, short):
    """Exactly of what bodies ask for; as a secant of dry friction, whose sign changes at one sample after another."""

    def secant(model, name, step):
        at = {sign: model.with_values({name: model.value(name) + sign * step}) for sign in (-1, 1)}
        ends = {sign: one.predict(short["prepared"], one.theta()).values for sign, one in at.items()}
        exact = model.predict(short["prepared"], model.theta()).sensitivities[:, model.names.index(name)]
        return exact, (ends[1] - ends[-1]) / (2.0 * step)

    model = baxter.with_effect(find("torque_delay")).with_effect(find("joint_coulomb_friction"))
    model = model.with_values({f"torque_delay.time[{joint}]": 0.013 for joint in model.joints})
    exact, measured = secant(model, "torque_delay.time[right_s1]", 1e-6)
    assert measured == pytest.approx(exact, abs=1e-4 * np.abs(exact).max())
    model = model.with_values({"joint_coulomb_friction.torque[right_s1]": 5.0})
    exact, measured = secant(model, "torque_delay.time[right_s1]", 1e-2)
    assert np.corrcoef(exact, measured)[0, 1] > 0.97
    assert exact @ measured / (exact @ exact) == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize("name", JOINT_EFFECTS)
def test_torques_are_those_of_the_generator(baxter, name):
    run = generate(name, 1.0, 3, duration=8.0, noise=0.0)
    model = baxter.with_effect(find(name)).with_values(true_parameters(name, 1.0))
    time = run.channels["tau.right_s0"].time
    inside = (time > 0.5) & (time < 7.5)
    for channel, residual in residuals(model, run).items():
        largest = np.abs(run.channels[channel].value).max()
        # A sharp sign differs from a smooth one within a few samples of a turning point.
        assert np.quantile(np.abs(residual[inside]), 0.97) < 1e-3 * largest, channel


def test_friction_is_never_negative(baxter):
    run = generate("joint_viscous_friction", -1.0, 0)  # a drive that pushes
    model, estimate = fitted(baxter.with_effect(find("joint_viscous_friction")), [baxter.prepare_run(run)])
    assert all(model.value(name) >= 0.0 for name in model.names)
    assert set(estimate.at_bound) == set(model.names)


@pytest.mark.parametrize(("robot", "sizes"), [("baxter", (0.3, 3.0, 30.0)), ("panda", (0.3, 1.0))])
def test_links_stay_bodies_whatever_the_parameters(robot, sizes):
    """A Panda's second link is 1 mm thin as its URDF has it, and stays a body all the same."""
    model = arm_model(robot=robot).with_effect(find("link_inertia"))
    rng = np.random.default_rng(0)
    for size in sizes:
        theta = np.clip(size * rng.standard_normal(len(model.names)), -6.9, 6.9)
        changed = model.with_values(dict(zip(model.names, theta, strict=True)))
        assert all(is_physical(p) for p in changed.link_parameters().values())


def test_the_mass_parameter_is_the_logarithm_of_the_mass_ratio(baxter):
    model = baxter.with_effect(find("link_inertia:right_e0"))
    heavier = model.with_values({"link_inertia.mass[right_e0]": np.log(2.0)})
    before, after = (m.link_parameters()["right_e0"] for m in (model, heavier))
    assert after == pytest.approx(2.0 * before, rel=1e-3)


def test_a_payload_adds_its_mass_where_it_is(baxter):
    model = baxter.with_effect(find("payload"))
    names = [f"payload.{q}[right_w2]" for q in ("mass", "x", "y", "z")]
    loaded = model.with_values(dict(zip(names, (2.0, 0.1, 0.0, 0.3), strict=True)))
    gained = loaded.link_parameters()["right_w2"] - baxter.link_parameters()["right_w2"]
    assert gained == pytest.approx([2.0, 0.2, 0.0, 0.6, 0.18, 0.0, 0.2, -0.06, 0.0, 0.02])


WALLS = {"wall": (0.0, np.pi / 2), "other wall": (-np.pi / 2, 0.0), "ceiling": (np.pi, 0.0), "leaning": (0.6, -1.2)}


@pytest.mark.parametrize("mounted", WALLS)
@pytest.mark.parametrize("robot", ["baxter", "ur5", "panda"])
def test_an_arm_on_a_wall_or_a_ceiling_is_found_from_the_upright(robot, mounted):
    upright = arm_model(robot=robot).with_effect(find("base_tilt"))
    roll, pitch = WALLS[mounted]
    true = upright.with_values({"base_tilt.roll": roll, "base_tilt.pitch": pitch})
    run = waving(upright)
    prediction = true.predict(run, true.theta())
    measured = {n: Channel(prediction.time[s], prediction.values[s], "N m") for n, s in prediction.slices.items()}
    run = replace(run, channels={**run.channels, **measured})
    noise = dict.fromkeys(prediction.channels, 0.1)
    found, _ = fitted(upright, [run], noise, tolerance=1e-12)
    # At a pitch of 90 degrees a roll turns the base about the vertical, and only gravity's direction can be known.
    assert found.gravity() == pytest.approx(true.gravity(), abs=1e-6)
    if mounted == "leaning":
        assert [found.value("base_tilt.roll"), found.value("base_tilt.pitch")] == pytest.approx([roll, pitch], abs=1e-6)


def waving(model, seed=1):
    """A run of smooth random paths with torques to be replaced."""
    rng = np.random.default_rng(seed)
    time, omega = np.arange(800) / 100, 2 * np.pi * np.array([0.1, 0.25, 0.6])
    phase = rng.uniform(0, 2 * np.pi, (len(model.joints), 3, 1))
    amplitude = 0.5 * rng.standard_normal((len(model.joints), 3, 1))
    limits = model.arm.robot.limits
    middle = (np.clip(limits.lower, -3, 3) + np.clip(limits.upper, -3, 3)) / 2
    q = middle[:, None] + np.sum(amplitude * np.sin(omega[:, None] * time + phase), axis=1)
    channels = {f"q.{j}": Channel(time, q[i], "rad") for i, j in enumerate(model.joints)}
    return Run("a.csv", channels | {f"tau.{j}": Channel(time, q[0], "N m") for j in model.joints})


def test_turning_an_upright_base_about_the_vertical_is_none_of_its_angles(baxter):
    model = baxter.with_effect(find("base_tilt"))
    assert model.names == ("base_tilt.roll", "base_tilt.pitch")
    assert model.gravity() == pytest.approx([0.0, 0.0, -9.81])
    rolled = model.with_values({"base_tilt.roll": np.pi / 2})
    assert rolled.gravity() == pytest.approx([0.0, -9.81, 0.0])  # the base's y axis points up
    pitched = model.with_values({"base_tilt.pitch": np.pi / 2})
    assert pitched.gravity() == pytest.approx([9.81, 0.0, 0.0])  # the base's x axis points down


def test_the_base_is_no_joint(baxter, complains):
    model = baxter.with_effect(find("base_tilt"))
    assert dict(model.parameter_names_by_joint("base_tilt")) == {"": model.names}
    assert not model.can_add_effect(find("base_tilt"))
    assert model.without_effect("base_tilt").names == ()
    with complains(InputError):
        baxter.with_effect(find("base_tilt:right_s0"))
    with complains(InputError):
        model.with_effect(find("base_tilt"))


@pytest.mark.parametrize(("hidden", "other"), [("gravity_spring", "link_inertia"), ("link_inertia", "gravity_spring")])
def test_springs_and_links_cannot_swallow_each_other(baxter, hidden, other):
    runs = [baxter.prepare_run(generate(hidden, 1.0, 5, recording=k)) for k in range(2)]
    samples = sum(len(runs[1].channels[name]) for name in baxter.predicted_channels(runs[1]))

    def left(name):
        """Above the noise, in standard deviations of chi2."""
        model, _ = fitted(baxter.with_effect(find(name)), runs, most_steps=60)
        return (chi2_per_sample(model, runs[1]) - 1.0) * np.sqrt(samples / 2)

    assert left(other) > 40
    if hidden == "gravity_spring":
        assert left(hidden) < 4
