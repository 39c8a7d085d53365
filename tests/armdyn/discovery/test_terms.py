"""Candidate terms: their units, and that each is an effect which a user's file could hold."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from armdyn.discovery import shapes
from armdyn.discovery.families import family_terms
from armdyn.discovery.source import effects_file_text, effects_of_terms
from armdyn.discovery.term import TermLocation, TermVariable, check_same_units, named_terms, recorded_variables
from armdyn.discovery.units import divide_units
from armdyn.effects.user import load_effects
from armdyn.errors import InputError
from armdyn.parameter import RecordedColumn
from armdyn.physics.definition import RATE_STAGE
from armdyn.run import Channel, Run

DRY = TermLocation("string", "N m", "string.with_dry_torque({})", 0.005)
STRING = TermLocation("string", "N m", "string.with_torque({})", 0.005, dry_friction_site=DRY)
ANGLE = TermVariable("angle", "string.angle", "rad", np.linspace(-0.5, 0.6, 200))
SPEED = TermVariable("speed", "string.rate", "rad/s", np.linspace(-2.0, 2.0, 200))
CHANGES = np.linspace(0.0, 1.0, 200)


def recorded(name, unit, samples):
    return TermVariable(
        f"extra_{name}", "", unit, samples, RecordedColumn(f"extra.{name}", unit, float(samples.mean()))
    )


TEMPERATURE, OPENING = recorded("temperature", "K", 290.0 + 10.0 * CHANGES), recorded("opening", "1", CHANGES)


@pytest.mark.parametrize(
    ("unit", "others", "expected"),
    [
        ("N m", [("rad", 2)], "N m/rad^2"),
        ("N m", [("rad/s", 3)], "N m s^3/rad^3"),
        ("N", [("m", 1), ("m/s", 1)], "N s/m^2"),
        ("m", [("m", 1)], "1"),
        ("N m", [], "N m"),
        ("N m", [("rad/s", 1), ("K", 1)], "N m s/(rad K)"),
        ("N", [("kg/m/s^2", 2)], "N m^2 s^4/kg^2"),
        ("N m", [("1", 1)], "N m"),
        ("mm", [("s", 1)], "mm/s"),
        ("degC", [("s", 1), ("degC", 1)], "1/s"),
        ("l/min", [("mm^0.5", 1)], "l/(min mm^0.5)"),
        ("%", [("degF", 2)], "%/delta_degF^2"),
    ],
)
def test_the_unit_of_a_size_is_that_of_the_force_over_its_variables(unit, others, expected):
    assert divide_units(unit, *others) == expected


def test_every_shape_is_an_effect_that_vanishes_at_null():
    terms = [
        shapes.power_term(STRING, SPEED, 3, "cubic drag", "drag"),
        *shapes.stop_terms(STRING, ANGLE),
        *shapes.one_sided_friction_terms(STRING, ANGLE, SPEED),
        *shapes.magnet_terms(STRING, ANGLE),
        *shapes.cable_terms(STRING, ANGLE),
        *shapes.cogging_terms(STRING, ANGLE, [0.1]),
        shapes.curve_term(STRING, ANGLE),
        *shapes.recorded_friction_terms(STRING, TEMPERATURE, SPEED),
        *shapes.recorded_friction_terms(STRING, OPENING, SPEED),
        *shapes.recorded_torque_terms(STRING, TEMPERATURE),
        *shapes.recorded_torque_terms(STRING, OPENING),
        shapes.curve_term(STRING, TEMPERATURE),
        shapes.curve_term(STRING, OPENING, SPEED),
    ]
    named = named_terms(terms)
    assert [e.name for e in effects_of_terms(list(named.values()))] == list(named)


def test_every_law_of_a_family_is_an_effect():
    rate = TermLocation(RATE_STAGE, "K/s", "rate.with_rate({})", 0.01, "-", joint="block")
    block, power = TermVariable("block", 'rate["block"]', "degC", np.linspace(20.0, 180.0)), OPENING
    named = named_terms(family_terms(rate, [block, TermVariable("bead", 'rate["bead"]', "degC", block.samples), power]))
    assert [e.name for e in effects_of_terms(list(named.values()))] == list(named)


def test_powers_of_a_temperature_count_from_the_absolute_zero():
    rate = TermLocation(RATE_STAGE, "K/s", "rate.with_rate({})", 0.01, "-", joint="block")
    block = TermVariable("block", 'rate["block"]', "degC", np.linspace(20.0, 180.0))
    radiation = next(t for t in shapes.rate_terms(rate, block) if t.kind == "fourth power")
    assert radiation.formula == "k * (block + 273.15)^4"
    law = next(t for t in family_terms(rate, [block]) if t.kind == "power")
    assert "((block + 273.15) / 500)" in law.formula


def test_a_formula_is_read_as_it_is_computed(tmp_path):
    stop = replace(next(shapes.stop_terms(STRING, ANGLE)), name="my_stop")
    assert stop.formula == "-stiffness * max(0, angle - place)"
    path = tmp_path / "effect.py"
    path.write_text(effects_file_text("A stop.", [stop], {"my_stop": "    As seen."}))
    (effect,) = load_effects(path)
    assert effect.name == "my_stop"
    assert effect.quantities["place"].null == pytest.approx(stop.parameters["place"].start_value)


def test_a_recorded_quantity_is_declared_as_it_was_recorded():
    friction = replace(next(shapes.recorded_friction_terms(STRING, TEMPERATURE, SPEED)), name="oil")
    assert friction.formula == "-coefficient * speed * exp(-(extra_temperature - 295.0) / width)"
    assert (list(friction.shapes), friction.size_parameter.unit) == (["coefficient"], "N m s/rad")
    (effect,) = effects_of_terms([friction])
    assert effect.columns == {"extra_temperature": RecordedColumn("extra.temperature", "K", 295.0)}
    stop = replace(next(shapes.stop_terms(STRING, ANGLE)), name="stop")
    assert "import effect, quantity" in effects_file_text("No column.", [stop])


def test_in_proportion_to_a_quantity_far_from_zero_is_no_law():
    opening, temperature = (list(shapes.recorded_torque_terms(STRING, v)) for v in (OPENING, TEMPERATURE))
    assert [term.formula for term in opening] == ["k * extra_opening", "k * extra_opening^2"]
    assert [term.formula for term in temperature] == ["k * (extra_temperature - place)"]
    assert [term.size_parameter.unit for term in (*opening, *temperature)] == ["N m", "N m", "N m/K"]


def test_a_law_may_depend_on_what_every_run_recorded_and_what_changed(complains):
    time = np.arange(20.0)

    def run(**columns):
        channels = {f"extra.{name}": Channel(time, value + 0.0 * time, unit) for name, (value, unit) in columns.items()}
        return Run("a", {"swing_angle": Channel(time, time, "rad"), **channels})

    both = {"oil": (290.0 + time, "K"), "still": (1.0, "1")}
    first, second = run(**both, alone=(time, "1")), run(**both)
    assert [v.quantity for v in recorded_variables([first, second])] == ["extra.oil"]
    with complains(InputError):
        check_same_units([first, run(oil=(time, "m"))])
    assert recorded_variables([first])[0].column == RecordedColumn("extra.oil", "K", 299.5)


def test_a_curve_follows_any_smooth_function():
    curve = shapes.curve_term(STRING, ANGLE)
    x = np.linspace(ANGLE.low, ANGLE.high, 100)
    names = {"ca": ca, "angle": ca.DM(x)}
    exec("\n".join(curve.preceding_code), names)
    columns = np.column_stack([eval(shape, names).full()[:, 0] for shape in curve.shapes.values()])
    target = np.exp(-(((x - 0.1) / 0.25) ** 2))
    left = target - columns @ np.linalg.lstsq(columns, target, rcond=None)[0]
    assert np.sqrt(np.mean(left**2)) < 0.03
