"""Effects that read a further column of the recording, in a pendulum, in an arm and in a base of the user's own."""

from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from armdyn.arm.model import arm_model
from armdyn.effects.catalogue import CATALOGUE
from armdyn.effects.effect import effect
from armdyn.effects.user import load_effects
from armdyn.errors import InputError
from armdyn.parameter import column, quantity
from armdyn.pendulum.model import pendulum_model
from armdyn.physics.model import physics_model
from armdyn.recording.checks import check_run
from armdyn.run import Channel, Run

from ...derivatives import assert_jacobian
from ...worlds.laws import URDF, world
from ..physics.test_definition import oscillator

USUAL = 290.0
TEMPERATURE = Channel(np.linspace(0.0, 2.0, 41), USUAL + 5.0 * np.linspace(0.0, 2.0, 41), "K")  # rises by 5 K a second


@effect(summary="", source="")
def oil(
    string,
    k=quantity("N m s/rad", typical=1e-3, lower=0),
    width=quantity("K", typical=10.0, null=10.0, lower=1.0),
    temperature=column("extra.temperature", "K", usual=USUAL),
):
    return string.with_torque(-k * string.rate * ca.exp((USUAL - temperature) / width))


@effect(summary="", source="")
def warming(string, k=quantity("N m s/rad", typical=1e-3, lower=0), width=quantity("K", typical=10.0, null=10.0)):
    return string.with_torque(-k * string.rate * ca.exp(-5.0 * string.time / width))


@effect(acts_on="joint", summary="", source="")
def gear_oil(
    joint,
    k=quantity("N m s/rad", typical=1.0, lower=0),
    width=quantity("K", typical=10.0, null=10.0, lower=1.0),
    temperature=column("extra.temperature", "K", usual=295.0),
):
    return joint.with_torque(k * joint.velocity * ca.exp((295.0 - temperature) / width))


@effect(acts_on="slider", summary="", source="")
def wind(slider, k=quantity("N/K", typical=0.1), temperature=column("extra.temperature", "K", usual=USUAL)):
    return slider.with_force(k * (temperature - USUAL))


def swing(extra=None):
    t = np.arange(0.0, 2.0, 0.01)
    channels = {"swing_angle": Channel(t, 0.0 * t, "rad"), "load_force": Channel(t, 0.0 * t, "N")}
    return Run("a.csv", channels, extra=extra or {})


def pendulum(law, **values):
    model = pendulum_model(0.368, 0.08, [law])
    return model.with_values({f"{law.name}.{name}": value for name, value in values.items()} | {"initial_angle": 0.4})


def test_what_a_column_says_acts_as_the_same_function_of_time():
    values = {"k": 4e-3, "width": 8.0}
    by_column, by_time = (pendulum(law, **values) for law in (oil, warming))
    run = swing({"extra.temperature": TEMPERATURE})
    read, known = by_column.predict(run, by_column.theta()), by_time.predict(run, by_time.theta())
    np.testing.assert_allclose(read.values, known.values, atol=1e-9)
    np.testing.assert_allclose(read.sensitivities, known.sensitivities, atol=1e-6)


def test_a_column_is_held_before_its_first_and_after_its_last_sample():
    short = Channel(TEMPERATURE.time[10:30], TEMPERATURE.value[10:30], "K")
    values = column("extra.temperature", "K", usual=0.0).interpolate({"extra.temperature": short}, TEMPERATURE.time)
    np.testing.assert_array_equal(values[:10], short.value[0])
    np.testing.assert_array_equal(values[30:], short.value[-1])


def test_where_nothing_was_recorded_the_usual_value_acts():
    model = pendulum(oil, k=4e-3, width=8.0)
    held = Channel(TEMPERATURE.time, 0.0 * TEMPERATURE.time + USUAL, "K")
    without, usual = (model.predict(run, model.theta()).values for run in (swing(), swing({"extra.temperature": held})))
    np.testing.assert_array_equal(without, usual)
    assert model.dynamics().input_count == 7  # control and plans know of no recording
    assert model.variational().names == model.physics_names


def test_a_column_in_another_unit_is_refused(complains):
    model = pendulum(oil)
    with complains(InputError):
        model.predict(swing({"extra.temperature": replace(TEMPERATURE, unit="m")}), model.theta())


def test_a_recording_that_an_effect_cannot_read_is_named(complains):
    model, early = pendulum(oil), Channel(TEMPERATURE.time + 100.0, TEMPERATURE.value, "K")
    for channel in (replace(TEMPERATURE, unit="m"), early):
        with complains(InputError):
            check_run(model, swing({"extra.temperature": channel}))


def test_a_column_may_change_forces_and_readings_only(complains):
    @effect(summary="", source="")
    def stretch(string, k=quantity("m/K", typical=1e-5), c=column("extra.temperature", "K", usual=USUAL)):
        return string.with_length(string.length + k * (c - USUAL))

    @effect(summary="", source="")
    def drift(sensor, k=quantity("N/K", typical=1e-3), c=column("extra.temperature", "K", usual=USUAL)):
        return sensor.with_force(sensor.force + k * (c - USUAL))

    longer = pendulum(stretch)
    with complains(InputError):
        longer.predict(swing(), longer.theta())
    model, still = pendulum(drift, k=1e-2), pendulum(drift)
    run = swing({"extra.temperature": TEMPERATURE})
    more = model.predict(run, model.theta()).values - still.predict(run, still.theta()).values
    np.testing.assert_allclose(more[np.abs(more) > 0], 0.05 * run.channels["load_force"].time[1:], atol=1e-12)


def test_the_friction_of_a_joint_follows_a_column_with_exact_derivatives(tmp_path):
    (tmp_path / "two.urdf").write_text(URDF)
    given = world("joint friction by temperature", 0).runs[0]
    model = arm_model(urdf=tmp_path / "two.urdf", effects=[gear_oil.on("elbow")])
    run = model.prepare_run(given)
    theta = np.array([0.6, 7.0])
    prediction = model.predict(run, theta)
    elbow = prediction.slices["tau.elbow"]
    assert_jacobian(
        lambda at: model.predict(run, at).values[elbow], theta, prediction.sensitivities[elbow], 1e-3 * theta
    )
    without = model.prepare_run(replace(given, extra={}))
    colder = replace(given.extra["extra.temperature"], value=0.0 * given.extra["extra.temperature"].value + 295.0)
    usual = model.prepare_run(replace(given, extra={"extra.temperature": colder}))
    np.testing.assert_array_equal(model.predict(without, theta).values, model.predict(usual, theta).values)
    assert np.ptp(model.predict(without, theta).values - prediction.values) > 0.1


def test_a_base_of_the_users_own_reads_columns_as_well():
    t = np.arange(0.0, 2.0, 0.01)
    channels = {"q.mass": Channel(t, 0.0 * t, "m"), "gripper_x": Channel(t, 0.0 * t, "m")}
    model = physics_model(oscillator(), [wind.on("left")]).with_values({"wind.k[left]": 1.0})
    warm = Channel(t, np.full(len(t), USUAL + 0.5), "K")
    found = model.predict(Run("a", channels, extra={"extra.temperature": warm}), model.theta()).values
    # A constant force F on an oscillator at rest: F/k (1 - cos(w t)).
    np.testing.assert_allclose(found, 0.5 / 10.0 * (1.0 - np.cos(np.sqrt(10.0) * t)), atol=1e-6)
    assert np.all(model.predict(Run("a", channels), model.theta()).values == 0.0)


@pytest.mark.parametrize(
    "declared",
    [
        'column("temperature", "K", usual=290)',
        'column("extra.temperature", "degC", usual=20)',
        'column("extra.temperature", "warm", usual=20)',
        'column("extra.temperature", "K", usual="cold")',
        'column("extra.temperature", "K", usual=float("nan"))',
        'column("extra.temperature", 3, usual=290)',
        'column("extra.temperature", "K")',
    ],
)
def test_a_wrong_declaration_is_one_line(tmp_path, declared, complains):
    path = Path(tmp_path, "law.py")
    path.write_text(
        "from armdyn import column, effect, quantity\n\n\n@effect(summary='', source='')\n"
        f"def oil(string, k=quantity('N m', typical=1.0), c={declared}):\n    return string.with_torque(k * c)\n"
    )
    with complains(InputError):
        load_effects(path)


def test_an_effect_on_joints_is_made_once():
    spring = CATALOGUE["gravity_spring"]
    elbow = spring.on("elbow")
    assert elbow is spring.on("elbow")
    assert elbow is not spring
    assert elbow.on() is spring.on() is spring
    assert elbow.on("elbow", "wrist") is spring.on("elbow", "wrist")


def test_two_models_alike_share_what_was_derived():
    one, other = (pendulum_model(0.4, 0.08).with_effect(CATALOGUE["linear_drag"]) for _ in range(2))
    assert one.system is other.system


EXAMPLE = Path(__file__).parents[3] / "examples/my_effects.py"


def test_the_documented_example_simulates_and_has_derivatives():
    (magnet,) = load_effects(EXAMPLE)
    model = pendulum_model(0.368, 0.08, [magnet]).with_values({"initial_angle": 0.2})
    t = np.arange(0.0, 1.0, 0.01)
    run = Run("a.csv", {"load_force": Channel(t, 0 * t, "N")})
    prediction = model.predict(run, model.theta())
    column = prediction.sensitivities[:, model.names.index("magnet.strength")]
    assert np.max(np.abs(column)) > 0.1


def test_name_and_stage_are_those_of_the_function_where_they_are_not_given():
    @effect(summary="a spring across the hinge", source="Hooke 1678")
    def hinge_spring(string, stiffness=quantity("N m/rad", typical=0.01)):
        return string.with_torque(-stiffness * string.angle)

    @effect("slow", "sensor", summary="", source="")
    def named_otherwise(it, time=quantity("s", typical=0.01)):
        return it.with_lag(time)

    assert (hinge_spring.name, hinge_spring.acts_on) == ("hinge_spring", "string")
    assert (named_otherwise.name, named_otherwise.acts_on) == ("slow", "sensor")
    names = pendulum_model(0.3, 0.1, [hinge_spring, named_otherwise]).names
    assert names[-2:] == ("hinge_spring.stiffness", "slow.time")
