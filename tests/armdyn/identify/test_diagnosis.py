"""Hidden effects, made by equations of their own, are found; clean runs are left alone."""

import importlib.util
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from armdyn.effects.catalogue import CATALOGUE
from armdyn.errors import InputError
from armdyn.identify.diagnose import diagnose
from armdyn.identify.noise import autoregression, ljung_box, third_difference_std, whitened
from armdyn.identify.repair import repair
from armdyn.identify.study import Study
from armdyn.identify.verdict import Verdict
from armdyn.pendulum.model import pendulum_model
from armdyn.units import Known

PATH = Path(__file__).parents[2] / "hidden_effects/pendulum.py"
SPEC = importlib.util.spec_from_file_location("hidden_pendulum", PATH)
hidden_pendulum = sys.modules.setdefault("hidden_pendulum", importlib.util.module_from_spec(SPEC))
SPEC.loader.exec_module(hidden_pendulum)

EFFECTS = tuple(effect for effect in CATALOGUE.values() if effect.acts_on != "joint")


def recordings(seed=7, **settings):
    rng = np.random.default_rng(seed)
    known = Known(0.0802, 4e-4, "kg"), Known(0.3685, 1e-3, "m")
    setup = hidden_pendulum.Setup(**settings)
    return [hidden_pendulum.weighed(hidden_pendulum.record(f"r{k}.csv", setup, rng), *known) for k in range(2)]


def study_of(runs, held_out=()):
    return Study(pendulum_model(0.35, 0.1), runs, held_out, EFFECTS)


def test_clean_runs_are_explained_and_the_length_is_right():
    found = diagnose(study_of(recordings()))
    assert found.verdict is Verdict.EXPLAINED
    length = found.comparison.parameters["length"]
    assert abs(length.value - 0.368) < 4 * length.std


def test_coloured_noise_is_no_missing_effect():
    assert diagnose(study_of(recordings(correlation=0.8))).verdict is Verdict.EXPLAINED


def test_a_hidden_effect_is_named_and_measured():
    found = diagnose(study_of(recordings(hidden={"quadratic_drag": 0.01})))
    assert found.verdict is Verdict.EFFECT_MISSING
    assert found.suspects[0].effect == "quadratic_drag"
    value = found.suspects[0].parameters["quadratic_drag.coefficient"]
    assert abs(value.value - 0.01) < 4 * value.std


def test_wind_and_tilt_are_an_honest_tie_with_advice():
    found = diagnose(study_of(recordings(hidden={"wind": 0.01})))
    assert found.verdict is Verdict.CANNOT_TELL_APART
    assert {found.suspects[0].effect, *found.suspects[0].tied_with} == {"wind", "path_tilt"}
    assert found.remedies


def test_repair_lets_both_errors_fall_to_the_noise():
    found = repair(study_of(recordings(hidden={"cross_axis_sensitivity": 0.03, "sensor_delay": 0.01})))
    assert {effect.name for effect in found.model.effects} == {"cross_axis_sensitivity", "sensor_delay"}
    assert [rung.chi2_per_sample for rung in found.ladder] == sorted(
        (rung.chi2_per_sample for rung in found.ladder), reverse=True
    )
    assert found.after.channels["load_force"].held_out_rmse < 1.1 * 3e-3


def test_reordering_and_renaming_runs_changes_nothing():
    runs = recordings(hidden={"sensor_bias": 0.02})
    one = study_of(runs).first()
    other = study_of([replace(run, name=f"x{i}.csv") for i, run in enumerate(reversed(runs))]).first()
    assert one.cost == pytest.approx(other.cost, rel=1e-6)


def test_adding_an_effect_never_raises_the_training_error():
    study = study_of(recordings(hidden={"sensor_drift": 1e-3}))
    first = study.first()
    for candidate in study.candidates[:8]:
        assert study.fit_with((candidate,), first).cost <= first.cost * (1 + 1e-9)


def test_a_held_out_run_that_is_also_a_training_run_is_refused():
    runs = recordings()
    with pytest.raises(InputError, match="held-out"):
        study_of(runs, [runs[0]])


def test_third_differences_measure_white_noise_on_a_smooth_signal():
    rng = np.random.default_rng(0)
    t = np.arange(0, 20, 0.01)
    assert third_difference_std(t, np.sin(5 * t) + 0.1 * rng.normal(size=len(t))) == pytest.approx(0.1, rel=0.1)


def test_whitening_makes_an_autoregression_white():
    rng = np.random.default_rng(1)
    e = rng.normal(size=4000)
    for i in range(1, len(e)):
        e[i] += 0.8 * e[i - 1]
    assert ljung_box(e) < 1e-10
    assert ljung_box(whitened(e, autoregression([e]))) > 1e-3
