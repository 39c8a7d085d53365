"""Bases from users' files, on data from MuJoCo, through the commands."""

import json
from pathlib import Path

import numpy as np
import pytest
from command import called, refused

from . import plants

EXAMPLES = Path(__file__).parents[3] / "examples"


def armdyn(*arguments):
    """Run a command that must succeed."""
    assert called(*arguments)[0] == 0


def answer(folder, command, model, runs, *more):
    """JSON of a command for two training runs and one that is held out."""
    armdyn(command, model, *runs[:2], "--held-out", runs[2], "--json", folder / f"{command}.json", *more)
    return json.loads((folder / f"{command}.json").read_text())


@pytest.fixture
def swings(tmp_path):
    def make(**hidden):
        starts = [(0.5, -0.3), (0.3, 0.5), (-0.6, 0.2)]
        head = "time [s],q.upper [rad],q.lower [rad]"
        return [
            plants.write(tmp_path / f"swing_{k}.csv", head, plants.double_pendulum(start, **hidden), 5e-4, k)
            for k, start in enumerate(starts)
        ]

    return make


@pytest.fixture
def lifts(tmp_path):
    def make(count=3, **hidden):
        head = "time [s],gripper_x [m],q.hoist [m],swing_angle [rad],load_force [N]"
        noise = np.array([1e-4, 1e-4, 5e-4, 0.1])
        return [
            plants.write(tmp_path / f"lift_{k}.csv", head, plants.crane(plants.carried(k), **hidden), noise, k)
            for k in range(count)
        ]

    return make


@pytest.fixture
def double(tmp_path):
    path = tmp_path / "double.toml"
    armdyn("new", "--base", EXAMPLES / "double_pendulum.py", path, "--set", "upper_mass=0.5 kg +/- 1 g")
    return path


@pytest.fixture
def crane(tmp_path):
    path = tmp_path / "crane.toml"
    armdyn("new", "--base", EXAMPLES / "crane.py", path, "--set", "mass=12 kg +/- 0.05 kg")
    return path


def test_a_model_of_a_double_pendulum_without_friction_is_explained(tmp_path, double, swings):
    found = answer(tmp_path, "compare", double, swings())
    assert found["model"] == {"base": "double_pendulum", "effects": []}
    for name, true in (("upper_length", 0.32), ("lower_length", 0.25), ("lower_mass", 0.3)):
        fitted = found["parameters"][name]
        assert abs(fitted["value"] - true) < 4 * fitted["std"]


@pytest.mark.parametrize(
    ("effect", "hidden", "parameter"),
    [
        ("hinge_viscous_friction", {"damping": (2e-3, 1e-3)}, "coefficient"),
        pytest.param("hinge_coulomb_friction", {"dry": (2e-3, 1e-3)}, "torque", marks=pytest.mark.slow),
    ],
)
def test_hidden_friction_of_a_double_pendulum_is_named_and_added(tmp_path, double, swings, effect, hidden, parameter):
    runs = swings(**hidden)
    repaired = answer(tmp_path, "repair", double, runs, "--output", tmp_path / "elsewhere.toml")
    assert (repaired["verdict"], repaired["effects"]) == ("explained", [effect])
    for joint, true in (("upper", 2e-3), ("lower", 1e-3)):
        assert repaired["parameters"][f"{effect}.{parameter}[{joint}]"]["value"] == pytest.approx(true, rel=0.02)
    again = answer(tmp_path, "compare", tmp_path / "elsewhere.toml", runs)
    assert again["channels"]["q.upper"]["chi2_per_sample"] < 1.2


@pytest.mark.slow
def test_drag_and_a_sheaves_friction_are_found_on_a_crane(tmp_path, crane, lifts):
    runs = lifts(drag=0.8, sheave=0.01)
    before = answer(tmp_path, "compare", crane, runs, "--report", tmp_path / "compare.html")
    assert before["channels"]["load_force"]["chi2_per_sample"] > 20
    assert "swing_angle" in (tmp_path / "compare.html").read_text()
    assert answer(tmp_path, "diagnose", crane, runs)["verdict"] == "effect_missing"
    (tmp_path / "other").mkdir()
    output = tmp_path / "other" / "repaired.toml"
    repaired = answer(tmp_path, "repair", crane, runs, "--output", output)
    assert repaired["verdict"] == "explained"
    assert set(repaired["effects"]) == {"sheave_friction", "quadratic_drag"}
    assert repaired["parameters"]["quadratic_drag.coefficient"]["value"] == pytest.approx(0.8, rel=0.02)
    assert repaired["parameters"]["sheave_friction.share"]["value"] == pytest.approx(0.01, rel=0.02)
    assert answer(tmp_path, "compare", output, runs)["channels"]["load_force"]["chi2_per_sample"] < 1.2


@pytest.mark.slow
def test_a_sway_that_no_sensor_measures_is_found_from_the_rope_s_pull(tmp_path, crane):
    head, noise = "time [s],gripper_x [m],q.hoist [m],load_force [N]", np.array([1e-4, 1e-4, 0.1])
    rows = [plants.crane(plants.carried(k), sway=0.4)[:, [0, 1, 2, 4]] for k in range(3)]
    runs = [plants.write(tmp_path / f"pull_{k}.csv", head, r, noise, k) for k, r in enumerate(rows)]
    found = answer(tmp_path, "compare", crane, runs)
    assert found["channels"]["load_force"]["chi2_per_sample"] < 1.3
    assert found["parameters"]["hook"]["value"] == pytest.approx(0.0, abs=2e-3)


def test_a_model_file_keeps_the_way_to_its_base(tmp_path, crane):
    from armdyn.model_file import read_model_file, write_model_file

    file = read_model_file(crane)
    (tmp_path / "deep" / "er").mkdir(parents=True)
    moved = tmp_path / "deep" / "er" / "crane.toml"
    write_model_file(moved, file)
    assert str(tmp_path) not in moved.read_text()
    assert read_model_file(str(moved)).model.parameters == file.model.parameters


def test_a_file_of_effects_may_act_on_a_stage_of_ones_own_base(tmp_path, crane, lifts):
    mine = tmp_path / "mine.py"
    text = (
        "from armdyn.effects.effect import effect\nfrom armdyn.parameter import quantity\n"
        "@effect('stiff_rope', acts_on='sheave', summary='', source='')\n"
        "def stiff_rope(sheave, drag=quantity('N s/m', typical=1.0)):\n"
        "    return sheave.with_pull(sheave.pull - drag * sheave.speed)\n"
    )
    mine.write_text(text)
    (run,), output = lifts(1), tmp_path / "stiff.toml"
    armdyn("add", crane, "stiff_rope", run, "--effects", mine, "--output", output)
    assert 'effects = ["stiff_rope"]' in output.read_text()
    mine.write_text(text.replace("sheave'", "sheeve'"))
    said = refused("add", crane, "stiff_rope", run, "--effects", mine, "--output", output)
    assert "acts on 'sheeve': choose one of" in said


def test_a_base_without_any_effect_is_diagnosed(tmp_path):
    base, run = tmp_path / "spring.py", tmp_path / "run.csv"
    base.write_text(
        "from armdyn.physics import Equations, Reading, constant, physics, state\n"
        "@physics('bouncing', summary='', source='', parameters=(constant('pace', 'rad/s', 6.0, lower=0.1),),\n"
        "         states=(state('place', 'm', typical=1.0), state('speed', 'm/s', typical=5.0)),\n"
        "         outputs={'q.slide': 'm'}, period=1.0, step=0.01)\n"
        "def bouncing(at):\n"
        "    rates = {'place': at['speed'], 'speed': -at['pace']**2 * at['place']}\n"
        "    return Equations(rates=rates, outputs={'q.slide': Reading(at['place'])})\n"
    )
    time = np.arange(0.0, 8.0, 0.02)
    place = np.exp(-0.3 * time) * np.cos(6.0 * time) + 1e-3 * np.random.default_rng(0).normal(size=len(time))
    np.savetxt(run, np.column_stack([time, place]), delimiter=",", header="time [s],q.slide [m]", comments="")
    armdyn("new", "--base", base, tmp_path / "spring.toml")
    armdyn("diagnose", tmp_path / "spring.toml", run, "--json", tmp_path / "found.json")
    assert json.loads((tmp_path / "found.json").read_text())["verdict"] == "unknown_effect"


@pytest.mark.parametrize(
    "text",
    [
        "x = 1\n",
        "def f(:\n",
        "from armdyn.physics import physics\nphysics('a')\n",
    ],
)  # fmt: skip
def test_a_bad_base_is_refused_in_one_line(tmp_path, text, complains):
    (tmp_path / "mine.py").write_text(text)
    complains.line(refused("new", "--base", tmp_path / "mine.py", tmp_path / "m.toml"))
