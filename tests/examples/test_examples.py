"""Every example runs as it stands, says what it promises, and is short enough to be read."""

import importlib.util
import sys
from pathlib import Path

import pytest

import armdyn
from armdyn.run import read_run

EXAMPLES = Path(__file__).parents[2] / "examples"


@pytest.fixture
def example(monkeypatch, tmp_path):
    """Loads an example by its name, as its user does: from its own folder, with output elsewhere."""
    monkeypatch.syspath_prepend(str(EXAMPLES))
    monkeypatch.chdir(tmp_path)

    def load(name):
        specification = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
        module = importlib.util.module_from_spec(specification)
        monkeypatch.setitem(sys.modules, name, module)
        specification.loader.exec_module(module)
        return module

    return load


@pytest.fixture
def few(monkeypatch):
    """A catalogue of a few effects, so that a search takes seconds; the notebook searches all of it."""
    few = {name: armdyn.CATALOGUE[name] for name in ("quadratic_drag", "pivot_viscous_friction", "sensor_bias")}
    monkeypatch.setattr(armdyn, "CATALOGUE", few)
    monkeypatch.setattr("armdyn.checked_study.available_effects", lambda *_: tuple(few.values()))


BASES = ("double_pendulum", "crane", "tanks")


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*.py")), ids=lambda path: path.stem)
def test_an_example_is_short(path):
    assert len(path.read_text().splitlines()) <= (150 if path.stem in BASES else 60)


@pytest.mark.usefixtures("few")
def test_a_pendulum_from_a_csv(example, capsys):
    found = example("pendulum_from_csv").main()
    assert [effect.name for effect in found.model.effects] == ["quadratic_drag"]
    assert found.model.parameters["quadratic_drag.coefficient"].value == pytest.approx(0.04, rel=0.05)
    assert found.model.parameters["length"].value == pytest.approx(0.368, abs=0.001)
    assert "quadratic_drag is missing" in capsys.readouterr().out


def test_an_arm_from_a_urdf(example, capsys):
    errors = example("arm_from_urdf").main()
    assert errors["with friction and payload"] < 0.02 * errors["as described"]
    payload = float(capsys.readouterr().out.split("\npayload: ")[1].split()[0])
    assert payload == pytest.approx(1.5, abs=0.005)


@pytest.mark.usefixtures("few")
def test_an_effect_of_ones_own(example):
    found = example("effect_of_ones_own").main()
    assert [effect.name for effect in found.model.effects] == ["magnet"]
    assert found.model.parameters["magnet.strength"].value == pytest.approx(0.03, rel=0.05)
    assert found.verdict.key == "explained"


def test_a_repaired_model_in_mujoco(example):
    described, repaired = example("repaired_model_in_mujoco").main()
    assert repaired < 0.2 * described


def test_sac_on_ones_own_model(example):
    std = example("sac_on_ones_own_model").main()
    assert std[True] < 0.1 * std[False]


def test_feasibility_of_a_trajectory(example):
    slow, fast = example("feasible_trajectory").main().values()
    assert slow.feasible
    assert not fast.feasible


def test_a_warm_hinge_is_recorded_with_its_temperature(example, tmp_path):
    example("warm_hinge").main()
    for number, mean in ((1, 295.15), (2, 299.15)):
        temperature = read_run(tmp_path / f"warm_{number}.csv").extra["extra.temperature"]
        assert len(temperature) == 200
        assert temperature.value.mean() == pytest.approx(mean, abs=2.0)
