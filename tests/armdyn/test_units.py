import contextlib
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from armdyn.errors import InputError
from armdyn.recording.units import KnownQuantity, parse_quantity, si_factor, si_unit


@pytest.mark.parametrize(
    ("unit", "expected", "factor"),
    [
        ("gram_force", "N", 9.80665e-3), ("ms", "s", 1e-3), ("deg/s", "rad/s", math.pi / 180),
        ("rpm", "rad/s", 2 * math.pi / 60), ("deg/s²", "rad/s^2", math.pi / 180), ("1/s", "rad/s", 1.0),
        ("Nm", "N m", 1.0), ("N·mm", "N m", 1e-3), ("g cm^2", "kg m^2", 1e-7), ("lbf", "N", 4.4482216152605),
    ],
)  # fmt: skip
def test_factor_to_si_is_the_textbook_one(unit, expected, factor):
    assert si_factor(unit, expected) == pytest.approx(factor, rel=1e-14)


@pytest.mark.parametrize(
    ("text", "expected", "value", "std"),
    [
        ("80 g +/- 0.4 g", "kg", 0.080, 0.0004), ("80 g ± 0.5 %", "kg", 0.080, 0.0004),
        ("0.368 m +/- 1 mm", "m", 0.368, 0.001), ("0.368 ± 0.001 m", "m", 0.368, 0.001), ("3 mN", "N", 0.003, None),
        ("-90deg", "rad", -math.pi / 2, None), ("4.5e-4 rad", "rad", 4.5e-4, None), ("1.02", "1", 1.02, None),
    ],
)  # fmt: skip
def test_quantity_is_read_with_its_spread(text, expected, value, std):
    quantity = parse_quantity(text, expected)
    assert quantity.value == pytest.approx(value, rel=1e-14)
    assert quantity.unit == expected
    assert quantity.std is None if std is None else quantity.std == pytest.approx(std, rel=1e-14)


def test_coherent_unit_keeps_its_name_and_others_become_base_units():
    assert parse_quantity("3 N s^2/m^2") == KnownQuantity(3.0, None, "N s^2/m^2")
    assert parse_quantity("2 mm/s") == KnownQuantity(0.002, None, "m/s")
    assert si_unit("g m^2") == "kg m^2"
    assert si_unit("deg") == "rad"


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("80", "kg"), ("80 g +/- 0.4", "kg"), ("80 g +/- 0 g", "kg"), ("80 g +/- -1 g", "kg"),
        ("80 g +/- 1 g +/- 2 g", "kg"), ("80 mm", "kg"), ("80 g +/- 1 mm", "kg"), ("80 grammes", "kg"),
        ("3 Hz", "rad/s"), ("3 %", "rad"), ("20 degC", None), ("0,368 m", "m"), ("heavy", "kg"), ("nan g", "kg"),
        ("3 m^", "m"), ("3 (m", "m"), ("", "m"),
    ],
)  # fmt: skip
def test_bad_quantity_is_refused_in_one_line_that_says_what_to_do(text, expected, complains):
    with complains(InputError):
        parse_quantity(text, expected)


@given(st.text(max_size=20))
def test_any_text_is_a_finite_quantity_or_an_input_error(text):
    with contextlib.suppress(InputError):
        assert math.isfinite(parse_quantity(text, "m").value)


sizes = st.floats(1e-15, 1e15)


@given(
    st.just(0.0) | sizes | sizes.map(lambda size: -size),
    st.none() | sizes,
    st.sampled_from(["kg", "m", "N s^2/m^2", "rad"]),
)
def test_a_known_value_written_as_text_reads_back_to_the_last_digit(value, std, unit):
    assert parse_quantity(str(KnownQuantity(value, std, unit)), unit) == KnownQuantity(value, std, unit)
