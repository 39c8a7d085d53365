"""A user's effect that cannot be used is told when it is read: one sentence with the file and its line."""

from pathlib import Path

import pytest

from armdyn.effects.catalogue import CATALOGUE
from armdyn.effects.effect_checks import TRIAL_STAGES, check_applied, check_declared
from armdyn.effects.user import load_effects
from armdyn.errors import InputError
from armdyn.physics.user import load_base

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
    "if on a symbol": effect_text("return load if load.rate > 0 else load.with_force(load.velocity * c)"),
    "max of a symbol": effect_text("return load.with_force(max(c, 0) * load.velocity)"),
    "math.sin": effect_text("return load.with_force(c * math.sin(load.angle) * load.velocity)"),
    "nan": effect_text("return load.with_force(c * float('nan') * load.velocity)"),
    "division by null": effect_text("return load.with_force(load.velocity * ca.sin(c) / c)"),
    "root at null": effect_text("return load.with_force(load.velocity * ca.sqrt(c))"),
    "not absent at null": effect_text("return load.with_force((1 + c) * load.velocity)"),
    "unknown unit": effect_text(GOOD, '"blorb", typical=0.02'),
    "no SI unit": effect_text(GOOD, '"mm", typical=0.02'),
    "endless unit": effect_text(GOOD, '"N**9**9**9**9", typical=0.02'),
    "typical of 0": effect_text(GOOD, '"N", typical=0'),
    "typical below 0": effect_text(GOOD, '"N", typical=-1.0'),
    "typical as text": effect_text(GOOD, '"N", typical="0.02"'),
    "typical nan": effect_text(GOOD, '"N", typical=float("nan")'),
    "null out of range": effect_text(GOOD, '"N", typical=1.0, null=-1.0, lower=0.0'),
    "bad scope": effect_text(GOOD, '"N", typical=1.0, scope="run"'),
    "name with a path": effect_text(GOOD, name="../evil"),
    "empty name": effect_text(GOOD, name=""),
    "two of one name": effect_text(GOOD) + effect_text(GOOD).replace("def own", "def two"),
    "returns nothing": effect_text("pass"),
    "wrong shape": effect_text("return load.with_force(c * ca.vertcat(1, 2))"),
    "own symbol": effect_text("return load.with_force(c * ca.SX.sym('k') * load.velocity)"),
    "unknown attribute": effect_text("return load.with_force(c * load.sped)"),
    "exit in the function": effect_text("sys.exit(0)"),
    "exit in the file": "sys.exit(0)\n",
    "exit without status": "raise SystemExit\n",
    "unknown import": "import nothing_of_this_name\n",
    "no Python": "def f(:\n",
    "no quantity": "@effect('own', acts_on='load', summary='', source='')\ndef own(load, c=1): ...\n",
}


@pytest.mark.parametrize("text", BAD.values(), ids=BAD)
def test_a_bad_effect_is_one_line_with_its_place_and_status_two(tmp_path, armdyn, text, complains):
    path = tmp_path / "mine.py"
    path.write_text(HEAD + text)
    status, _, err = armdyn("effects", "--effects", path)
    assert status == 2
    (line,) = [line for line in err.splitlines() if line.startswith("armdyn:")]
    complains.line(line)


@pytest.mark.parametrize(
    "text",
    ["x = 1\n", effect_text(GOOD, acts_on="lod")],
)
def test_a_file_without_an_effect_of_any_stage_is_refused(tmp_path, text, complains):
    (tmp_path / "mine.py").write_text(HEAD + text)
    with complains(InputError):
        load_effects(tmp_path / "mine.py")


@pytest.mark.parametrize("name", [name for name, item in CATALOGUE.items() if item.acts_on in TRIAL_STAGES])
def test_the_catalogue_passes(name):
    check_declared([CATALOGUE[name]], Path("catalogue"))
    check_applied(CATALOGUE[name], Path("catalogue"))


def test_every_stage_of_the_catalogue_is_tried():
    assert {item.acts_on for item in CATALOGUE.values()} <= set(TRIAL_STAGES)


def test_a_good_effect_under_two_names_is_one(tmp_path):
    path = tmp_path / "mine.py"
    path.write_text(HEAD + effect_text(GOOD) + "same = own\n")
    assert [item.name for item in load_effects(path)] == ["own"]


ENDS = {"memory": "[0] * 10**13", "sys.exit": "sys.exit()",
        "of its own": "(_ for _ in ()).throw(type('Own', (BaseException,), {}))"}  # fmt: skip
BASE = """import sys
from armdyn.physics import Equations, constant, physics, state
@physics("own", summary="s", source="s", parameters=(constant("mass", "kg", 1.0),),
         states=(state("angle", "rad", typical=0.1),), outputs={{"swing_angle": "rad"}}, period={period})
def own(at):
    {body}
    return Equations(rates={{"angle": -at["mass"] * at["angle"]}}, outputs={{"swing_angle": at["angle"]}})
"""


@pytest.mark.parametrize("where", ["file", "effect", "base"])
@pytest.mark.parametrize("body", ENDS.values(), ids=ENDS)
def test_code_that_takes_all_memory_or_ends_the_program_is_refused_with_its_file(tmp_path, where, body, complains):
    path = tmp_path / "mine.py"
    text = {
        "file": f"{HEAD}if True:\n    {body}\n",
        "effect": HEAD + effect_text(f"{body}\n    {GOOD}"),
        "base": BASE.format(body=body, period=1.0),
    }[where]
    path.write_text(text)
    with complains(InputError):
        (load_base if where == "base" else load_effects)(path)


@pytest.mark.parametrize("period", ["float('nan')", "1e-9", "1e300", "-1.0", "0.0", "'x'"])
def test_a_base_needs_a_period_that_something_has(tmp_path, period, complains):
    path = tmp_path / "mine.py"
    path.write_text(BASE.format(body="pass", period=period))
    with complains(InputError):
        load_base(path)


def test_what_a_file_prints_is_printed_once_and_good_code_does_its_work(tmp_path, capfd):
    path = tmp_path / "mine.py"
    path.write_text("print('hello')\n" + HEAD + effect_text(GOOD))
    assert [item.name for item in load_effects(path)] == ["own"]
    assert capfd.readouterr().out == "hello\n"
    path.write_text(BASE.format(body="pass", period=1.0))
    assert load_base(path).base == "own"
