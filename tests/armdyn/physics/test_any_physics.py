"""Bases of one's own of any physics: names and units, places of thresholds, what is not told apart, laws of a rate."""

from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from worlds.own_bases import HEAD, Family, case
from worlds.own_bases.fast import FILTER, GEARED
from worlds.own_bases.laboratory import ROD
from worlds.own_bases.slow import BATTERY, OVEN, TANKS, VESSEL

from armdyn.checked_study import CheckedStudy
from armdyn.effects.effect import effect
from armdyn.effects.user import available_effects, load_effects
from armdyn.errors import InputError
from armdyn.front import compare, discover, fit
from armdyn.identify.prepare import noise_std_by_run_and_channel
from armdyn.identify.repair import add
from armdyn.identify.studies import make_study
from armdyn.parameter import quantity
from armdyn.physics import Equations, Expression, Stage, constant, physics, state
from armdyn.physics.model import physics_model
from armdyn.physics.user import load_base
from armdyn.run import Channel, Run, read_run, write_run_csv


@physics(
    "kettle", summary="A kettle.", source="Newton 1701",
    parameters=(constant("loss", "1/s", 0.004, lower=1e-5), constant("power", "degC/(W s)", 3e-4, lower=1e-6)),
    states=(state("water", "degC", typical=30.0, start=20.0),),
    inputs={"extra.heating": "W"}, outputs={"extra.water": "degC"}, held=("extra.heating",), period=300.0,
)  # fmt: skip
def kettle(at):
    rate = at["power"] * at.input("extra.heating").value - at["loss"] * (at["water"] - 20.0)
    return Equations({"water": rate}, {"extra.water": at["water"]})


def boiled(interval: float, pulse: float = 1500.0) -> Run:
    """Heated by pulses of one sample each, 20 s and what is left of the interval apart."""
    time = np.arange(0.0, 1200.0, interval)
    given = np.where(np.arange(len(time)) % round(20.0 / interval) == 0, pulse, 0.0)
    water, found = 20.0, []
    for watt in given:
        found.append(water)
        end = 20.0 + 2.5e-4 / 0.003 * watt
        water = end + (water - end) * np.exp(-0.003 * interval)
    noise = 0.02 * np.random.default_rng(0).normal(size=len(time))
    channels = {"extra.heating": Channel(time, given, "W"), "extra.water": Channel(time, found + noise, "degC")}
    return Run("kettle.csv", channels)


def study_of(family: Family, seed: int, folder, hidden: str | None = None) -> CheckedStudy:
    """A drawn case with two runs to fit, one to choose by, one that takes part in nothing."""
    drawn = case(family, seed, hidden)
    runs = drawn.runs()
    return CheckedStudy.of(drawn.model(folder), runs[:2], runs[2:3], runs[3:])


@pytest.mark.parametrize("interval", [5.0, 0.1])
def test_pulses_of_a_held_command_drive_the_motion_however_fast_they_were_written(interval):
    found = fit(physics_model(kettle), boiled(interval))
    for name, true in {"loss": 0.003, "power": 2.5e-4}.items():
        assert found.value(name) == pytest.approx(true, abs=4.0 * found.parameters[name].std)
        assert found.parameters[name].std < 0.02 * true


def test_a_recording_of_further_quantities_alone_is_compared_in_the_units_of_the_base(tmp_path):
    write_run_csv(boiled(5.0), tmp_path / "kettle.csv")
    (tmp_path / "kettle.toml").write_text('[noise]\n"extra.water" = "20 mK"\n')
    run = read_run(tmp_path / "kettle.csv")
    assert run.extra["extra.water"].unit == "K"
    found = compare(physics_model(kettle), run)
    assert found.channels["extra.water"].unit == "degC"
    assert found.fit.chi2_per_sample == pytest.approx(1.0, abs=0.2)


def test_a_quantity_of_another_kind_is_refused(complains):
    run = boiled(5.0)
    with complains(InputError):
        compare(physics_model(kettle), replace(run, extra={**run.extra, "extra.water": Channel(*_of(run), "m")}))


def _of(run: Run):
    water = run.extra["extra.water"]
    return water.time, water.value


def test_a_slow_recording_is_refused_with_what_to_write(complains):
    fast = replace(kettle, period=1.0, step=0.01)
    with complains(InputError):
        compare(physics_model(fast), replace(boiled(5.0)))


def test_noise_is_not_told_across_the_steps_of_a_held_command(tmp_path):
    drawn = case(BATTERY, 3)
    model = drawn.model(tmp_path)
    prepared = [model.prepare_run(run) for run in drawn.runs()]
    for told in noise_std_by_run_and_channel(model, prepared).values():
        assert told == pytest.approx(BATTERY.noise["extra.voltage"], rel=0.1)


def test_what_a_base_calls_a_load_is_none_of_the_catalogue(tmp_path):
    model = case(GEARED, 0).model(tmp_path)
    names = {item.name for item in available_effects(model) if model.can_add_effect(item)}
    assert names == {"gear_backlash", "load_drag", "load_friction"}


def test_the_place_of_a_threshold_is_found_with_its_size(tmp_path):
    drawn = case(VESSEL, 1)
    found = study_of(VESSEL, 1, tmp_path).repair()
    assert [item.name for item in found.model.effects] == ["relief_valve"]
    for name in ("relief_valve.slope", "relief_valve.opens"):
        p = found.model.parameters[name]
        assert abs(p.value - drawn[name]) < 3.0 * p.std
    assert found.model.parameters["relief_valve.opens"].std < 0.01 * drawn["relief_valve.opens"]


def test_a_limit_that_is_an_effect_by_itself_is_found_where_no_run_would_show_the_declared_one(tmp_path):
    drawn = case(ROD, 1, "heater_limit")
    model, runs = drawn.model(tmp_path), drawn.runs()
    tried = [item for item in model.own_effects if item.name == "heater_limit"]
    found = CheckedStudy.of(model, runs[:2], runs[2:3], effects=tried).repair()
    assert [item.name for item in found.model.effects] == ["heater_limit"]
    limit = found.model.parameters["heater_limit.limit"]
    assert abs(limit.value - drawn["heater_limit.limit"]) < 3.0 * limit.std
    assert limit.std < 0.01 * limit.value


@pytest.mark.parametrize("family", [VESSEL, TANKS])
def test_no_threshold_is_named_where_there_is_none(tmp_path, family):
    assert study_of(family, 1, tmp_path, "").repair().model.effects == ()


def test_values_that_move_together_have_no_standard_deviation_and_a_sentence(tmp_path):
    found = study_of(FILTER, 10, tmp_path, "").compare()
    (one,) = found.unidentified_combinations
    changes = [one.changes[name] for name in ("inductance", "capacity", "resistance")]
    assert changes == pytest.approx([1.0, -1.0, 1.0], rel=0.02)
    assert one.identifying_states == ("current [A]",)
    assert f"{one.sentence}." in found.remarks
    assert all(found.parameters[name].std is None for name in ("inductance", "capacity", "resistance"))


def test_a_prior_settles_what_moves_together(tmp_path):
    drawn = case(FILTER, 10, "")
    true = drawn["inductance"]
    model = drawn.model(tmp_path).with_prior("inductance", true, 0.01 * true)
    found = CheckedStudy.of(model, drawn.runs()[:2], effects=()).compare()
    assert found.unidentified_combinations == ()
    for name in ("inductance", "capacity", "resistance"):
        p = found.parameters[name]
        assert 0.001 * drawn[name] < p.std < 0.02 * drawn[name]
        assert abs(p.value - drawn[name]) < 3.0 * p.std


@effect(acts_on="rate", summary="Heat that somebody else brings.", source="of its own")
def visitor(rate, heat=quantity("K/s", typical=0.01)):
    """An effect on the rate of a state needs no stage of the base."""
    return rate.with_rate(heat)


def test_an_effect_may_act_on_the_rate_of_any_state():
    model = physics_model(kettle, own_effects=[visitor])
    assert model.joints_effect_can_act_on(visitor) == ("water",)
    run = boiled(5.0)
    given = model.with_effect(visitor).with_values({"visitor.heat[water]": 0.02, "loss": 0.003, "power": 2.5e-4})
    told = given.predict(given.prepare_run(run), given.theta()).values[-1]
    plain = model.with_values({"loss": 0.003, "power": 2.5e-4})
    told -= plain.predict(plain.prepare_run(run), plain.theta()).values[-1]
    assert told == pytest.approx(0.02 / 0.003 * (1.0 - np.exp(-0.003 * 1195.0)), rel=1e-4)


def test_a_law_of_a_rate_is_discovered_written_and_read(tmp_path):
    drawn = case(VESSEL, 1)
    runs = drawn.runs()
    (tmp_path / "bare.py").write_text(HEAD + VESSEL.text.split("@effect")[0])
    bare = load_base(tmp_path / "bare.py")
    found = discover(bare, runs[:2], runs[2:3])
    (one,) = found.laws
    assert abs(one.values["place"].value - drawn["relief_valve.opens"]) < 3.0 * one.values["place"].std
    found.write(tmp_path / "law.py")
    (law,) = load_effects(tmp_path / "law.py", bare.stages)
    assert law.name == "discovered_threshold_above"
    told = add(make_study(bare, runs[:2], runs[2:3], [law]), [law.on("pressure")]).model
    assert "discovered_threshold_above.place[pressure]" in told.names


def test_an_oven_is_as_its_file_says(tmp_path):
    drawn = case(OVEN, 4, "")
    found = study_of(OVEN, 4, tmp_path, "").compare()
    for name in OVEN.values:
        assert abs(found.parameters[name].value - drawn[name]) < 4.0 * found.parameters[name].std


@dataclass(frozen=True)
class Rail(Stage):
    speed: Expression
    force: Expression = 0


@effect(summary="Dry friction that turns round over 1 mm/s.", source="Coulomb 1785")
def rubbing(rail: Rail, force=quantity("N", typical=1.0, lower=0.0)):
    return replace(rail, force=rail.force - force * ca.tanh(rail.speed / 1e-3))


@physics(
    "slide", summary="A mass on a spring that is pushed.", source="Coulomb 1785",
    parameters=(constant("mass", "kg", 1.0, lower=0.1), constant("spring", "N/m", 20.0, lower=0.1)),
    states=(state("place", "m", typical=0.1), state("speed", "m/s", typical=0.3)),
    inputs={"tau.push": "N"}, outputs={"q.mass": "m"},
)  # fmt: skip
def slide(at):
    rail = at.stage("rail", Rail(at["speed"]))
    force = at.input("tau.push").value - at["spring"] * at["place"] + rail.force
    return Equations({"place": at["speed"], "speed": force / at["mass"]}, {"q.mass": at["place"]})


def test_steps_are_short_enough_for_friction_that_turns_round_abruptly():
    time = np.arange(0.0, 6.0, 0.01)
    push = 3.0 * np.sin(2.0 * time) + 1.5 * np.sin(5.1 * time)

    def rates(t, s):
        return [s[1], 3.0 * np.sin(2.0 * t) + 1.5 * np.sin(5.1 * t) - 20.0 * s[0] - 1.2 * np.tanh(s[1] / 1e-3)]

    place = solve_ivp(rates, (0.0, 6.0), (0.0, 0.0), "LSODA", time, rtol=1e-9, atol=1e-11, max_step=1e-3).y[0]
    run = Run("slide.csv", {"tau.push": Channel(time, push, "N"), "q.mass": Channel(time, place, "m")})
    model = physics_model(slide, own_effects=[rubbing])
    assert len(model.input_path(run).time) <= len(time)
    stiff = model.with_effect(rubbing).with_values({"rubbing.force": 1.2})
    assert stiff.predict(stiff.prepare_run(run), stiff.theta()).values == pytest.approx(place, abs=1e-4)


@effect(summary="A film of oil.", source="Newton 1687")
def oil(rail: Rail, drag=quantity("N s/m", typical=30.0, lower=0.0)):
    return replace(rail, force=rail.force - drag * rail.speed)


def test_steps_follow_a_value_that_a_fit_makes_many_times_its_typical_size():
    time = np.arange(0.0, 6.0, 0.01)

    def push(t):
        return 30.0 * np.sin(2.0 * t) + 15.0 * np.sin(5.1 * t)

    def rates(t, s):
        return [s[1], push(t) - 20.0 * s[0] - 600.0 * s[1]]

    place = solve_ivp(rates, (0.0, 6.0), (0.0, 0.0), "LSODA", time, rtol=1e-9, atol=1e-11).y[0]
    read = place + 1e-5 * np.random.default_rng(0).normal(size=len(time))
    run = Run("slide.csv", {"tau.push": Channel(time, push(time), "N"), "q.mass": Channel(time, read, "m")})
    found = add(make_study(physics_model(slide, own_effects=[oil]), [run], [], [oil]), [oil]).model
    drag = found.parameters["oil.drag"]
    assert abs(drag.value - 600.0) < 3.0 * drag.std
    exact = found.with_values({"mass": 1.0, "spring": 20.0, "oil.drag": 600.0})
    assert exact.input_path(run).dt == pytest.approx(0.01)
    assert exact.predict(exact.prepare_run(run), exact.theta()).values == pytest.approx(place, abs=1e-7)
