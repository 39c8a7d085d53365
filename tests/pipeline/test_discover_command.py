"""From a recording to an effect file that repairs the model, in commands."""

import json
import runpy
from dataclasses import replace
from pathlib import Path

import pytest

from armdyn.discovery.result import DiscoveredLaw, Discovery
from armdyn.discovery.term import CandidateTerm, TermLocation, TermParameter
from pipeline.commands.discover import _next_steps
from pipeline.console.inputs import ModelAndRunInputs

RECORDINGS = Path(__file__).parents[2] / "examples/pendulum"


OIL = """import casadi as ca

from armdyn import column, effect, quantity


@effect(summary="Oil that is thinner the warmer it is.", source="Reynolds 1886")
def oil(
    string,
    k=quantity("N m s/rad", typical=1e-3, lower=0),
    width=quantity("K", typical=5.0, null=10.0, lower=1.0, spread=5.0),
    warm=column("extra.temperature", "K", usual=295.15),
):
    return string.with_torque(-k * string.rate * ca.exp((295.15 - warm) / width))
"""


@pytest.mark.slow
def test_a_law_that_reads_a_temperature_is_added_and_swings_and_leaves_without_one(armdyn):
    runpy.run_path(RECORDINGS.parent / "warm_hinge.py", run_name="__main__")
    Path("law.py").write_text(OIL)
    law = ("--effects", "law.py")
    armdyn("new", "pendulum", "m.toml", "--set", "length=0.37 m", "--set", "mass=80 g")
    runs = ("warm_1.csv", "--held-out", "warm_2.csv")
    assert armdyn("add", "m.toml", "oil", *runs, *law, "--output", "r.toml", "--json", "a.json")[0] == 0
    steps = json.loads(Path("a.json").read_text())["steps"]
    assert steps[-1]["held_out_rmse"]["swing_angle"] < 0.05 * steps[0]["held_out_rmse"]["swing_angle"]
    assert armdyn("trial", "--model", "r.toml", *law, "--out", "trial")[0] == 0
    answer = json.loads(armdyn("compare", "r.toml", "trial/trial.csv", *law, "--json", "-")[1])
    assert any("no 'extra.temperature': taken to be 295.15 K" in said for said in answer["left_out"])
    assert "extra.temperature: it is held at 295.15 K" in armdyn("export", "r.toml", *law, "--output", "r.py")[1]


def test_its_file_must_not_replace_an_input(armdyn, refused, complains):
    armdyn("new", "pendulum", "m.toml", "--set", "length=0.37 m")
    complains.line(refused("discover", "m.toml", RECORDINGS / "magnet_1.csv", "--output", "m.toml"))


NOTHING = Discovery(
    (), {}, {}, {}, {}, {}, {}, 0.0, residual_exceeds_noise=True, has_unfitted_run=False, runs=("a.csv",), held_out=()
)
GIVEN = ModelAndRunInputs(Path("m.toml"), [Path("a.csv")])


def test_where_one_motion_shows_no_law_another_one_is_asked_for():
    assert "another motion" in NOTHING.sentence
    (step,) = _next_steps(GIVEN, NOTHING, None)
    assert step.command == "armdyn discover m.toml a.csv --held-out ANOTHER.csv"
    assert not _next_steps(GIVEN, replace(NOTHING, has_unfitted_run=True), None)


def test_a_law_that_an_effect_of_the_catalogue_imitates_comes_with_the_experiment_that_tells_them_apart():
    site, size = TermLocation("string", "N m", "{}", 1.0), TermParameter("1", 0.0, 0.0)
    term = CandidateTerm("flexure", "a spring", site, (), {}, size, name="discovered_flexure")
    law = DiscoveredLaw("discovered_flexure", (), "string", "flexure", "a spring", "k * angle^3", {}, 0.9,
                  "pivot_stiffness", (), term)  # fmt: skip
    steps = _next_steps(GIVEN, replace(NOTHING, laws=(law,), has_unfitted_run=True), Path("law.py"))
    assert steps[-1].command == (
        "armdyn next m.toml a.csv --effects law.py --rivals discovered_flexure,pivot_stiffness --output motion.csv"
    )
