"""From a recording to an effect file that repairs the model, in commands."""

import json
from pathlib import Path

import pytest

from armdyn.run import read_run

RECORDINGS = Path(__file__).parents[2] / "examples/pendulum"


@pytest.mark.slow
def test_a_magnet_is_discovered_and_its_file_repairs_the_model(armdyn):
    first, second = (RECORDINGS / f"magnet_{k}.csv" for k in (1, 2))
    armdyn("new", "pendulum", "m.toml", "--set", "length=0.37 m", "--set", "mass=80 g")
    runs = (first, "--held-out", second)
    assert (
        armdyn("discover", "m.toml", *runs, "--output", "effect.py", "--json", "d.json", "--report", "d.html")[0] == 0
    )
    answer = json.loads(Path("d.json").read_text())
    assert answer["schema"] == "armdyn.discover/1"
    (found,) = answer["found"]
    assert (found["kind"], found["effect"], found["acts_on"]) == ("magnet", "discovered_magnet", "load")
    assert abs(found["values"]["place"]["value"]) < 0.03
    added = (
        "add",
        "m.toml",
        found["effect"],
        *runs,
        "--effects",
        "effect.py",
        "--output",
        "r.toml",
        "--json",
        "a.json",
    )
    assert armdyn(*added)[0] == 0
    steps = json.loads(Path("a.json").read_text())["steps"]
    assert steps[-1]["held_out_rmse"]["load_force"] < 1.2 * read_run(first).noise["load_force"]


def test_its_file_must_not_replace_an_input(armdyn):
    run = RECORDINGS / "magnet_1.csv"
    armdyn("new", "pendulum", "m.toml", "--set", "length=0.37 m")
    status, _, error = armdyn("discover", "m.toml", run, "--output", "m.toml")
    assert status == 2
    assert "is an input" in error
