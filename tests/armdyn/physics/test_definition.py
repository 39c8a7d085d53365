from dataclasses import dataclass, replace

import numpy as np
import pytest
from derivatives import assert_jacobian
from scipy.integrate import solve_ivp

from armdyn.effects.effect import effect
from armdyn.errors import InputError, UnknownNameError
from armdyn.identify.repair import repair
from armdyn.identify.studies import make_study
from armdyn.parameter import quantity
from armdyn.physics import Equations, Expression, Reading, Stage, constant, physics, state
from armdyn.physics.formulation import formulate
from armdyn.physics.model import physics_model
from armdyn.run import Channel, Run


@dataclass(frozen=True)
class Slider(Stage):
    speed: Expression
    force: Expression = 0

    def with_force(self, force):
        return replace(self, force=self.force + force)


def oscillator(**changed):
    declared = {
        "summary": "", "source": "", "outputs": {"q.mass": "m"}, "inputs": {"gripper_x": "m"}, "period": 2.0,
        "parameters": (constant("stiffness", "N/m", 10.0, lower=0.0), constant("mass", "kg", 1.0, lower=1e-3)),
        "states": (state("stretch", "m", typical=0.1), state("speed", "m/s", typical=0.3)),
    }  # fmt: skip

    @physics("oscillator", **{**declared, **changed})
    def equations(at):
        slider = at.stage("slider", Slider(at["speed"]), "left")
        other = at.stage("slider", Slider(at["speed"]), "right")
        force = slider.force + other.force - at["stiffness"] * at["stretch"]
        rates = {"stretch": at["speed"], "speed": force / at["mass"] - at.input("gripper_x").acceleration}
        return Equations(rates, {"q.mass": at.stage("probe", Reading(at["stretch"]))})

    return equations


@effect("viscous", acts_on="slider", summary="", source="")
def viscous(slider, c=quantity("N s/m", typical=0.1, lower=0)):
    return slider.with_force(-c * slider.speed)


@effect("relaxing_spring", acts_on="slider", summary="a spring behind a dashpot: it remembers", source="Maxwell 1867")
def relaxing_spring(slider, k=quantity("N/m", typical=1.0), rate=quantity("1/s", typical=1.0, null=1.0)):
    slider, stretch = slider.with_state(lambda z: slider.speed - rate * z)
    return slider.with_force(-k * stretch)


@effect("late", acts_on="probe", summary="", source="")
def late(probe, time=quantity("s", typical=0.02)):
    return probe.with_delay(time)


@effect("slow", acts_on="probe", summary="", source="")
def slow(probe, time=quantity("s", typical=0.02, lower=0)):
    return probe.with_lag(time)


@effect("idle", acts_on="slider", summary="", source="")
def idle(slider, size=quantity("N", typical=1.0)):
    return slider.with_force(0 * size)


EFFECTS = (viscous, relaxing_spring, late, slow)


@physics("scale", summary="", source="", parameters=(constant("stiffness", "N/m", 10.0),), states=(),
         inputs={"gripper_x": "m"}, outputs={"load_force": "N"})  # fmt: skip
def scale(at):
    return Equations({}, {"load_force": at.stage("probe", Reading(at["stiffness"] * at.input("gripper_x").value))})


@pytest.fixture
def run():
    t = np.arange(0.0, 3.0, 0.01)
    moved = Channel(t - 0.004, 0.1 * np.sin(4 * t), "m")
    return Run("a.csv", {"gripper_x": moved, "q.mass": Channel(t[7:], 0.2 * np.cos(3 * t[7:]), "m")})


def test_derivatives_are_exact_with_states_of_effects_lag_and_delay(run):
    model = physics_model(oscillator(), EFFECTS)
    sizes = {"viscous.c[left]": 0.3, "relaxing_spring.k[left]": 2.0, "relaxing_spring.rate[left]": 1.5,
             "late.time": 0.0333, "slow.time": 0.02, "initial_stretch": 0.2, "initial_speed": 0.1}  # fmt: skip
    theta = model.with_values(sizes).theta()
    exact = model.predict(run, theta).sensitivities
    assert_jacobian(lambda changed: model.predict(run, changed).values, theta, exact, 1e-4, 1e-5)


def test_absent_effects_change_nothing(run):
    bare, full = physics_model(oscillator()), physics_model(oscillator(), EFFECTS)
    assert np.array_equal(bare.predict(run, bare.theta()).values, full.predict(run, full.theta()).values)


def test_a_spring_in_vacuum_keeps_its_frequency(run):
    model = physics_model(oscillator()).with_values({"initial_stretch": 0.2})
    still = Channel(run.channels["gripper_x"].time, np.zeros(300), "m")
    still = model.prepare_run(replace(run, channels={**run.channels, "gripper_x": still}))
    predicted = model.predict(still, model.theta())
    time = predicted.time - predicted.time[0]
    assert np.allclose(predicted.values, 0.2 * np.cos(np.sqrt(10.0) * time), atol=1e-6)
    assert len(time) == len(run.channels["q.mass"]) - 1  # the last was measured after the input's last


def test_effects_act_joint_by_joint(complains):
    model = physics_model(oscillator()).with_effect(viscous.on("right"))
    assert model.parameters["viscous.c[right]"].joint == "right"
    assert model.with_effect(viscous).names[-2:] == ("viscous.c[right]", "viscous.c[left]")
    with complains(UnknownNameError):
        model.with_effect(viscous.on("middle"))


def test_what_changes_nothing_is_refused(complains):
    model = physics_model(oscillator())
    assert not model.can_add_effect(idle)
    with complains(InputError):
        model.with_effect(idle)


def test_a_measured_state_and_its_rate_are_guessed(run):
    guess = physics_model(oscillator()).guess_start_state(run)
    assert guess["initial_stretch"] == pytest.approx(0.2 * np.cos(0.21), abs=1e-3)
    assert guess["initial_speed"] == pytest.approx(-0.6 * np.sin(0.21), abs=0.01)


@pytest.mark.parametrize(
    "changed",
    [
        {"outputs": {"q.mass": "N"}},
        {"outputs": {"angle": "rad"}},
        {"states": (state("stretch", "m", typical=0.1),)},
        {"outputs": {"q.mass": "m", "q.other": "m"}},
        {"inputs": {}},
        {"states": state("stretch", "m", typical=0.1)},
        {"held": "gripper_x"},
        {"period": "2 s"},
    ],
)  # fmt: skip
def test_a_wrong_declaration_is_refused_in_one_line(changed, complains):
    with complains(InputError):
        list(physics_model(oscillator(**changed)).names)


@pytest.mark.parametrize(("unit", "value"), [(0.2, "1/min"), ("1/min", "0.2 1/min")])
def test_exchanged_arguments_of_a_constant_are_refused_in_one_line(unit, value, complains):
    with complains(InputError):
        constant("loss", unit, value)


def test_a_physics_without_states_is_algebra(run):
    time = run.channels["q.mass"].time
    weighed = replace(run, channels={**run.channels, "load_force": Channel(time, 0 * time, "N")})
    model = physics_model(scale, [late, slow]).with_values({"slow.time": 0.05})
    theta = model.with_values({"late.time": 0.0333}).theta()
    exact = model.predict(weighed, theta).sensitivities
    assert exact.shape == (len(time), 3)
    assert_jacobian(lambda changed: model.predict(weighed, changed).values, theta, exact, 1e-4, 1e-5)


def test_what_a_physics_without_states_lacks_is_named():
    rng = np.random.default_rng(3)
    t = np.arange(0.0, 10.0, 0.01)
    # Of one sine a lag is a delay and a gain.
    moved, then = (0.1 * np.sin(4 * at) + 0.05 * np.sin(11 * at) for at in (t, t - 0.03))
    force = 12.0 * then + 0.01 * rng.normal(size=len(t))
    channels = {"gripper_x": Channel(t, moved, "m"), "load_force": Channel(t, force, "N")}
    study = make_study(physics_model(scale), [Run("a.csv", channels)], [], [late, slow])
    found = repair(study)
    assert [e.name for e in found.model.effects] == ["late"]
    assert found.model.value("late.time") == pytest.approx(0.03, abs=1e-3)
    assert found.model.value("stiffness") == pytest.approx(12.0, rel=1e-3)


def test_a_run_without_what_drives_the_motion_is_refused(run, complains):
    bare = {"q.mass": run.channels["q.mass"]}
    with complains(InputError):
        physics_model(oscillator()).predict(replace(run, channels=bare), physics_model(oscillator()).theta())


def felt_mass(felt):
    """A mass on a spring that carries an accelerometer; `felt` returns rates and outputs."""

    @physics(
        "felt_mass", summary="", source="", outputs={"q.mass": "m", "extra.felt": "m/s^2"}, period=1.0,
        parameters=(constant("square", "1/s^2", 40.0, lower=0.0),),
        states=(state("place", "m", typical=0.1), state("speed", "m/s", typical=0.3)),
    )  # fmt: skip
    def equations(at):
        return felt(at, -at["square"] * at["place"])

    return equations


def told_of_rates(at, given):
    changed = at.rate("speed", given)
    return Equations({"place": at["speed"], "speed": changed}, {"q.mass": at["place"], "extra.felt": changed})


@effect("cubic", acts_on="rate", summary="a drag on the rate", source="a test")
def cubic(rate, k=quantity("s/m^2", typical=0.1)):
    return rate.with_rate(-k * rate["speed"] ** 3)


def test_an_accelerometer_feels_an_effect_on_the_rate_that_it_measures():
    """Truth: x'' = -40 x - 0.5 v^3 by scipy; the accelerometer reads x''."""
    time = np.arange(0.0, 3.0, 0.01)
    found = solve_ivp(
        lambda _, s: [s[1], -40.0 * s[0] - 0.5 * s[1] ** 3], (0.0, 3.0), [0.3, 0.0], t_eval=time, rtol=1e-10, atol=1e-12
    )
    place, speed = found.y
    felt = -40.0 * place - 0.5 * speed**3
    channels = {"q.mass": Channel(time, place, "m"), "extra.felt": Channel(time, felt, "m/s^2")}
    run = Run("felt", channels)
    model = physics_model(felt_mass(told_of_rates)).with_effect(cubic.on("speed"))
    values = {"cubic.k[speed]": 0.5, "initial_place": 0.3, "initial_speed": 0.0}
    model = model.with_values(values)
    run = model.prepare_run(run)
    predicted = model.predict(run, np.array([p.value for p in model.parameters.values()])).values_by_channel
    assert np.abs(predicted["extra.felt"] - felt).max() < 1e-5 * np.abs(felt).max()
    assert np.abs(predicted["q.mass"] - place).max() < 1e-5 * np.abs(place).max()


@pytest.mark.parametrize(
    "felt",
    [
        lambda at, given: Equations(
            {"place": at["speed"], "speed": given}, {"q.mass": at["place"], "extra.felt": at.rate("speed", given) + 0.0}
        ),
        lambda at, given: Equations(
            {"place": at.rate("place", at["speed"]), "speed": given}, {"q.mass": at["place"], "extra.felt": given}
        ),
        lambda at, given: Equations(
            {"place": at["speed"], "speed": at.rate("speed", given)},
            {"q.mass": at["place"], "extra.felt": at.rate("speed", given)},
        ),
        lambda at, given: Equations(
            {"place": at["speed"], "speed": at.rate("sped", given)}, {"q.mass": at["place"], "extra.felt": given}
        ),
    ],
    ids=["another rate", "a state", "twice", "no state"],
)
def test_a_rate_that_is_asked_for_wrongly_is_told(felt, complains):
    with complains(InputError):
        formulate(felt_mass(felt), (cubic.on("speed"),), ("square", "cubic.k[speed]"))
