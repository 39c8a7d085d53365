"""A table is what a dataclass declares, or every entry that is not is told."""

import math
import re
from contextlib import suppress
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Annotated

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from urdf import bounds
from urdf.toml_tables import TomlFileError, TomlValueCheck, parse_toml_text, table_to_dataclass


class Colour(Enum):
    RED = "red"
    BLUE = "blue"


@dataclass(frozen=True)
class Wheel:
    radius: Annotated[float, TomlValueCheck(lambda radius: radius > 0.0, "give a positive number")]
    colour: Colour = Colour.RED


@dataclass(frozen=True)
class Cart:
    name: str
    from_: str | None = None
    wheels: tuple[Wheel, ...] = ()
    notes: str | tuple[str, ...] = ()
    sizes: dict[str, float] | None = None


def read(text):
    return table_to_dataclass(Cart, parse_toml_text(text))


def test_a_table_becomes_the_dataclass_that_declares_it():
    text = "name = 'a'\nfrom = 'b'\nnotes = ['c', 'd']\nsizes.x = 1\n[[wheels]]\nradius = 2\ncolour = 'blue'"
    assert read(text) == Cart("a", "b", (Wheel(2.0, Colour.BLUE),), ("c", "d"), {"x": 1.0})
    assert read("name = 'a'\nnotes = 'c'").notes == "c"


def test_everything_that_is_wrong_is_told_with_its_table():
    text = "nmae = 'a'\nsizes.x = true\n[[wheels]]\nradius = 1\n[[wheels]]\nradius = -1.0\ncolour = 'green'"
    with pytest.raises(TomlFileError) as caught:
        read(text)
    assert caught.value.problems == (
        "unknown key 'nmae': did you mean 'name'?",
        "sizes.x = True is not a number",
        "[[wheels]] 2: radius = -1.0: give a positive number",
        "[[wheels]] 2: colour = 'green': choose one of red, blue",
        "entry 'name' is missing",
    )
    assert str(caught.value).startswith("5 problems: (1) unknown key")
    many = str(TomlFileError(*(f"entry 'p{i}' is missing" for i in range(46))))
    assert many.startswith("46 problems: (1) entry 'p0' is missing; (2)")
    assert many.endswith("(12) entry 'p11' is missing; and 34 more")


@pytest.mark.parametrize("text", ["name = 3", *(f"name = 'a'\n{wrong}" for wrong in (
    "wheels = 3", "sizes = 3", "notes = [1]", "[[wheels]]"))])  # fmt: skip
def test_an_entry_of_another_kind_is_refused(text, complains):
    with complains(TomlFileError):
        read(text)


SAFETY = Path(__file__).parents[2] / "docs" / "safety.md"
ROW = re.compile(r"^\| (?P<value>\S+)(?: (?P<unit>MiB|s))? \| .* \| `(?P<name>[A-Z_]+)` \|$", re.MULTILINE)


def test_the_documentation_shows_every_limit_as_it_is():
    shown = {row["name"]: float(row["value"]) * (bounds.MIB if row["unit"] == "MiB" else 1.0)
             for row in ROW.finditer(SAFETY.read_text(encoding="utf-8"))}  # fmt: skip
    limits = {name: float(value) for name, value in vars(bounds).items() if name.isupper() and not name.startswith("_")}
    for name in ("MIB", "TOML_INTEGER_LIMIT"):  # no limits of ours
        del limits[name]
    assert shown == limits


@given(st.floats(allow_nan=False, allow_infinity=False))
@example(5e-324)
@example(-0.0)
def test_every_number_as_python_writes_it_is_read_to_the_last_digit(value):
    assert bounds.parse_number(repr(value)) == value
    assert bounds.parse_number(f" {value:.20g}\t") == float(f"{value:.20g}")


@pytest.mark.parametrize("text", ["1_000", "٣", "nan", "inf", "-inf", "1e999", "1e", "0x10", "", " ", ".", "--1", "1 2",
                                  "1,5", "1.2.3", "１", "1\n", "9" * 1001, "1e5f", "infinity", "\x001"])  # fmt: skip
def test_what_is_no_number_to_a_person_is_refused(text):
    with pytest.raises(ValueError, match="number") as refused:
        bounds.parse_number(text)
    assert len(str(refused.value)) < 120


@given(st.text())
def test_any_text_is_a_finite_number_or_refused(text):
    with suppress(ValueError):
        assert math.isfinite(bounds.parse_number(text))


@pytest.mark.parametrize(
    "text", ["1_000", "1_0.5", "1e1_0", "0x10", "0o17", "0b11", "[1, 1_000]", "{a = 1_000}", "1e999"]
)
def test_numbers_of_a_table_are_decimal_digits_and_finite(text, complains):
    with complains(TomlFileError):
        parse_toml_text(f"mass = {text}\n")
    table = parse_toml_text(f'"link_1_000" = "{text}"\njoint_0_1 = 2.5e3  # 1_000\nrmse = inf\n')
    assert (table["joint_0_1"], table["rmse"]) == (2500.0, float("inf"))
