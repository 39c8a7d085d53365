"""A table is what a dataclass declares, or every entry that is not is told."""

from dataclasses import dataclass
from enum import Enum
from typing import Annotated

import pytest

from urdf.table_file import Check, TableFileError, parse_table, read_as


class Colour(Enum):
    RED = "red"
    BLUE = "blue"


@dataclass(frozen=True)
class Wheel:
    radius: Annotated[float, Check(lambda radius: radius > 0.0, "give a positive number")]
    colour: Colour = Colour.RED


@dataclass(frozen=True)
class Cart:
    name: str
    from_: str | None = None
    wheels: tuple[Wheel, ...] = ()
    notes: str | tuple[str, ...] = ()
    sizes: dict[str, float] | None = None


def read(text):
    return read_as(Cart, parse_table(text))


def test_a_table_becomes_the_dataclass_that_declares_it():
    text = "name = 'a'\nfrom = 'b'\nnotes = ['c', 'd']\nsizes.x = 1\n[[wheels]]\nradius = 2\ncolour = 'blue'"
    assert read(text) == Cart("a", "b", (Wheel(2.0, Colour.BLUE),), ("c", "d"), {"x": 1.0})
    assert read("name = 'a'\nnotes = 'c'").notes == "c"


def test_everything_that_is_wrong_is_told_with_its_table():
    text = "nmae = 'a'\nsizes.x = true\n[[wheels]]\nradius = 1\n[[wheels]]\nradius = -1.0\ncolour = 'green'"
    with pytest.raises(TableFileError) as caught:
        read(text)
    assert caught.value.problems == (
        "unknown key 'nmae': did you mean 'name'?",
        "sizes.x = True is not a number",
        "[[wheels]] 2: radius = -1.0: give a positive number",
        "[[wheels]] 2: colour = 'green': choose one of red, blue",
        "entry 'name' is missing",
    )
    assert str(caught.value).startswith("5 problems: (1) unknown key")


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("name = 3", "name = 3 is not a text"),
        ("name = 'a'\nwheels = 3", r"write '\[\[wheels\]\]' on a line of its own"),
        ("name = 'a'\nsizes = 3", r"write '\[sizes\]' on a line of its own"),
        ("name = 'a'\nnotes = [1]", "notes = 1 is not a text"),
        ("name = 'a'\n[[wheels]]", r"\[\[wheels\]\] 1: entry 'radius' is missing"),
    ],
)
def test_an_entry_of_another_kind_is_refused(text, says):
    with pytest.raises(TableFileError, match=says):
        read(text)


def test_of_many_problems_the_first_are_told_and_the_others_counted():
    told = str(TableFileError(*(f"entry 'p{i}' is missing" for i in range(46))))
    assert told.startswith("46 problems: (1) entry 'p0' is missing; (2)")
    assert told.endswith("(12) entry 'p11' is missing; and 34 more")
