"""A swing misses for a hidden effect; the recording of that trial says why; the next swing lands."""

from dataclasses import replace

import numpy as np
import pytest

from armdyn.effects.catalogue import CATALOGUE
from armdyn.identify.compare import compare
from armdyn.identify.repair import repair
from armdyn.identify.study import Study
from armdyn.model_file import read_model
from armdyn.pendulum.model import pendulum_model
from armdyn.run import read_run
from pipeline.trial.experiment import run_trial
from pipeline.trial.settings import TrialSettings

PENDULUM = [effect for effect in CATALOGUE.values() if effect.acts_on != "joint"]


def repaired_after(hidden, out, seed=0):
    """The trial that does not know, and the repair of the model that it had."""
    missed = run_trial(TrialSettings(hidden=hidden, seed=seed, out=out))
    found = repair(Study(read_model(out / "model.toml"), [read_run(out / "trial.csv")], [], PENDULUM))
    return missed, found


@pytest.mark.parametrize(
    ("effect", "parameter", "size"), [("quadratic_drag", "coefficient", 0.05), ("wind", "force", 0.15)]
)
def test_what_is_repaired_lands(effect, parameter, size, tmp_path):
    hidden = {effect: size}
    missed, found = repaired_after(hidden, tmp_path)
    assert not missed.success
    known = {"linear_drag", "sensor_bias", "sensor_delay"}
    assert {e.name for e in found.model.effects} - known == {effect}
    assert found.model.value(f"{effect}.{parameter}") == pytest.approx(size, rel=0.05)
    assert found.ladder[-1].chi2_per_sample < 0.4 * found.ladder[0].chi2_per_sample
    guess = found.model.value("length")
    assert run_trial(TrialSettings(hidden=hidden, model=found.model, length_guess=guess)).success


def test_the_model_of_a_trial_is_the_one_that_it_estimated_with(tmp_path):
    result = run_trial(TrialSettings(out=tmp_path))
    kept = read_model(tmp_path / "model.toml")
    assert kept.value("length") == pytest.approx(result.length_estimate, abs=1e-12)
    assert {e.name for e in kept.effects} == {"linear_drag", "sensor_bias", "sensor_delay"}
    prior = kept.parameters["sensor_delay.time"].prior
    assert prior is not None
    assert (prior.mean, prior.std) == (0.01, 0.01)
    assert kept.parameters["initial_angle"].fitted


def test_a_load_in_wind_rests_where_the_wind_holds_it():
    model = pendulum_model(0.4, 0.1, [CATALOGUE["wind"]]).with_values({"wind.force": 0.1})
    assert model.rest_angle() == pytest.approx(-np.arctan(0.1 / (0.1 * 9.81)), rel=1e-9)
    assert pendulum_model(0.4, 0.1).rest_angle() == pytest.approx(0.0, abs=1e-12)


def test_the_printed_tension_fails_and_the_comparison_says_where(tmp_path):
    run_trial(TrialSettings(out=tmp_path))
    model = replace(read_model(tmp_path / "model.toml"), tension="printed")
    found = compare(Study(model, [read_run(tmp_path / "trial.csv")], [], PENDULUM))
    assert found.fit.chi2_per_sample > 100.0
    assert found.correction is not None
    assert found.correction.fit.chi2_per_sample < 2.0
    assert found.correction.parameters["length"].value == pytest.approx(0.368, abs=1e-3)
    assert found.correction.places[0].against == "swing_rate"  # the centripetal force has the wrong sign
    assert "right formula" in found.sentence
