"""A user's effect that cannot be used is told when it is read: one sentence with the file and its line."""

from pathlib import Path

import pytest

from armdyn.effects import user
from armdyn.effects.catalogue import CATALOGUE
from armdyn.effects.tried import STAGES, check_declared, check_tried
from armdyn.effects.user import load_effects
from armdyn.errors import InputError
from pipeline.cli import main

HEAD = """import math, sys
import casadi as ca
from armdyn.effects.effect import effect
from armdyn.parameter import quantity

"""


def effect_text(body, declared='"N", typical=0.02', name="own", acts_on="load"):
    return (
        f'@effect("{name}", acts_on="{acts_on}", summary="s", source="s")\n'
        f"def own(load, c=quantity({declared})):\n    {body}\n"
    )


GOOD = "return load.with_force(-c * load.velocity)"
BAD = {
    "if on a symbol": (effect_text("return load if load.rate > 0 else load.with_force(load.velocity * c)"), "if_else"),
    "max of a symbol": (effect_text("return load.with_force(max(c, 0) * load.velocity)"), "if_else"),
    "math.sin": (effect_text("return load.with_force(c * math.sin(load.angle) * load.velocity)"), "ca.sin"),
    "nan": (effect_text("return load.with_force(c * float('nan') * load.velocity)"), "not finite"),
    "division by null": (
        effect_text("return load.with_force(load.velocity * ca.sin(c) / c)"),
        "not finite at its null values",
    ),
    "root at null": (effect_text("return load.with_force(load.velocity * ca.sqrt(c))"), "no finite derivative"),
    "not absent at null": (effect_text("return load.with_force((1 + c) * load.velocity)"), "at its null values"),
    "unknown unit": (effect_text(GOOD, '"blorb", typical=0.02'), "unknown unit 'blorb'"),
    "no SI unit": (effect_text(GOOD, '"mm", typical=0.02'), "write 'm'"),
    "endless unit": (effect_text(GOOD, '"N**9**9**9**9", typical=0.02'), "unknown unit"),
    "typical of 0": (effect_text(GOOD, '"N", typical=0'), "more than 0"),
    "typical below 0": (effect_text(GOOD, '"N", typical=-1.0'), "more than 0"),
    "typical as text": (effect_text(GOOD, '"N", typical="0.02"'), "write a number"),
    "typical nan": (effect_text(GOOD, '"N", typical=float("nan")'), "write a number"),
    "null out of range": (effect_text(GOOD, '"N", typical=1.0, null=-1.0, lower=0.0'), "widen the range"),
    "bad scope": (effect_text(GOOD, '"N", typical=1.0, scope="run"'), "'per_run'"),
    "name with a path": (effect_text(GOOD, name="../evil"), "rename it"),
    "empty name": (effect_text(GOOD, name=""), "rename it"),
    "two of one name": (effect_text(GOOD) + effect_text(GOOD).replace("def own", "def two"), "the same name"),
    "returns nothing": (effect_text("pass"), "returns a NoneType"),
    "wrong shape": (effect_text("return load.with_force(c * ca.vertcat(1, 2))"), "own"),
    "own symbol": (effect_text("return load.with_force(c * ca.SX.sym('k') * load.velocity)"), "symbols of its own"),
    "unknown attribute": (effect_text("return load.with_force(c * load.sped)"), "no attribute 'sped'"),
    "exit in the function": (effect_text("sys.exit(0)"), "sys.exit"),
    "exit in the file": ("sys.exit(0)\n", "ends the program"),
    "exit without status": ("raise SystemExit\n", "ends the program"),
    "no quantity": (
        "@effect('own', acts_on='load', summary='', source='')\ndef own(load, c=1): ...\n",
        "needs a default",
    ),
}


@pytest.mark.parametrize(("text", "said"), BAD.values(), ids=BAD)
def test_a_bad_effect_is_one_line_with_its_place_and_status_two(tmp_path, monkeypatch, capfd, text, said):
    path = tmp_path / "mine.py"
    path.write_text(HEAD + text)
    monkeypatch.setattr("sys.argv", ["armdyn", "effects", "--effects", str(path)])
    with pytest.raises(SystemExit) as end:
        main()
    err = capfd.readouterr().err
    assert end.value.code == 2
    assert len([line for line in err.splitlines() if line.startswith("armdyn:")]) == 1
    assert said in err
    assert "mine.py, line " in err


@pytest.mark.parametrize("name", [name for name, item in CATALOGUE.items() if item.acts_on in STAGES])
def test_the_catalogue_passes(name):
    check_declared([CATALOGUE[name]], Path("catalogue"))
    check_tried(CATALOGUE[name], Path("catalogue"))


def test_every_stage_of_the_catalogue_is_tried():
    assert {item.acts_on for item in CATALOGUE.values()} <= set(STAGES)


def test_a_good_effect_under_two_names_is_one(tmp_path):
    path = tmp_path / "mine.py"
    path.write_text(HEAD + effect_text(GOOD) + "same = own\n")
    assert [item.name for item in load_effects(path)] == ["own"]


def test_a_file_that_never_ends_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(user, "READING", 0.2)
    path = tmp_path / "mine.py"
    path.write_text("while True:\n    try:\n        pass\n    except Exception:\n        pass\n")
    with pytest.raises(InputError, match="takes longer than"):
        load_effects(path)
