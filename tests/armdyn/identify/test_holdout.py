"""An exam run is predicted at the end and changes nothing before it."""

import json
import tomllib
from dataclasses import replace

import numpy as np
import pytest
from worlds import pendulum
from worlds.baxter import generate, true_parameters

from armdyn.arm.model import arm_model
from armdyn.effects.catalogue import CATALOGUE, find
from armdyn.errors import InputError
from armdyn.identify.compare import compare
from armdyn.identify.holdout import HoldoutKind
from armdyn.identify.noise import variance_inflation
from armdyn.identify.repair import add
from armdyn.identify.studies import make_study
from armdyn.identify.uncertainty import uncertainty, whitened_covariance
from armdyn.pendulum.model import pendulum_model
from armdyn.run import write_run_csv

HIDDEN = {"quadratic_drag": 0.02}
DRAG = CATALOGUE["quadratic_drag"]


def recordings(seed=7, **settings):
    return pendulum.recordings(seed, duration=8.0, **settings)


def study_of(runs, held_out=(), exam=()):
    return make_study(pendulum_model(0.35, 0.1), runs, held_out, [DRAG], exam)


def test_the_exam_error_falls_with_the_right_effect_and_everything_else_stays():
    runs, exam = recordings(hidden=HIDDEN), recordings(seed=8, hidden=HIDDEN)
    alone, examined = add(study_of(runs), [DRAG]), add(study_of(runs, exam=exam), [DRAG])
    for one, other in zip(alone.path, examined.path, strict=True):
        assert one == replace(other, exam_rmse={})
    given, repaired = (step.exam_rmse["load_force"] for step in examined.path)
    assert repaired < 1.1 * 3e-3 < given
    assert examined.after.channels["load_force"].exam_rmse == repaired


@pytest.mark.slow
def test_an_exam_run_takes_another_name_where_its_own_is_taken():
    runs, (exam, _) = recordings(), recordings(seed=8)
    study = study_of(runs, exam=[exam])
    assert [run.name for run in study.runs] == [run.name for run in runs]
    assert [run.name for run in study.exam] == [f"exam/{exam.name}"]
    assert compare(study).channels["load_force"].exam_rmse == pytest.approx(3e-3, rel=0.1)


def test_the_exams_error_is_in_table_answer_and_model_file(armdyn, tmp_path):
    (tmp_path / "m.toml").write_text('base = "pendulum"\neffects = []\n')
    for run, name in zip(recordings(), ("a.csv", "exam.csv"), strict=True):
        write_run_csv(replace(run, noise={}), tmp_path / name)
    command = "add", "m.toml", "sensor_bias", "a.csv", "--exam", "exam.csv", "--output", "out.toml"
    status, out, err = armdyn(*command, "--json", "a.json")
    assert status == 0, err
    assert "Exam: runs that were neither fitted" in out
    answer = json.loads((tmp_path / "a.json").read_text())
    assert all(step["exam_rmse"]["load_force"] > 0 for step in answer["steps"])
    assert answer["channels"]["load_force"]["exam_rmse"] == answer["steps"][-1]["exam_rmse"]["load_force"]
    (entry,) = tomllib.loads((tmp_path / "out.toml").read_text())["history"]
    assert entry["exam"] == ["exam.csv"]
    assert entry["exam_rmse"]["load_force"] > 0


def test_a_training_run_is_no_exam_and_a_copy_neither(complains):
    runs = recordings()
    with complains(InputError):
        study_of(runs, exam=runs[:1])
    copied = replace(runs[0], channels=dict(runs[0].channels))
    with complains(InputError):
        study_of(runs, exam=[copied])


def test_who_judged_is_said():
    runs = recordings()
    assert study_of(runs).holdout_kinds == (HoldoutKind.LEAVE_ONE_OUT,)
    assert study_of(runs[:1]).holdout_kinds == (HoldoutKind.TRAINING,)
    assert study_of(runs[:1], runs[1:]).holdout_kinds == (HoldoutKind.HELD_OUT,)
    assert study_of(runs, exam=recordings(seed=8)[:1]).holdout_kinds == (HoldoutKind.EXAM, HoldoutKind.LEAVE_ONE_OUT)
    assert np.all([c.exam_rmse is None for c in compare(study_of(runs)).channels.values()])


def test_an_arm_without_unknowns_is_predicted_in_turn():
    model = arm_model(robot="baxter")
    study = make_study(model, [generate((), 1.0, 0, recording=k) for k in range(2)], [], [])
    assert len(study.held_out_blocks(study.first())) == 2 * len(model.predicted_channels(study.runs[0]))


def errors(hidden, extra, seed):
    """Errors of the fitted values over standard deviations: those of least squares in whitened noise, and ours."""
    runs = [generate((hidden, *extra), 1.0, seed, recording=k) for k in range(2)]
    study = make_study(arm_model(robot="baxter").with_effect(find(hidden)), runs, [], [])
    fit = study.first()
    true = true_parameters(hidden, 1.0)
    wrong = np.array([fit.values[i] - true[fit.problem.columns[i].name] for i in np.flatnonzero(fit.free)])
    known = uncertainty(study, fit)
    covariances = whitened_covariance(fit), known.covariance
    return known, *(np.abs(wrong) / np.sqrt(np.diag(c)[fit.free]) for c in covariances)


def test_noise_alone_changes_no_interval():
    known, whitened, ours = errors("rotor_inertia", (), 0)
    assert known.std_inflation == 1.0
    np.testing.assert_array_equal(whitened, ours)


@pytest.mark.parametrize("seed", [0, 1])
def test_a_model_error_that_the_catalogue_lacks_is_counted_in(seed):
    # The measured coverage is in docs/repair.md.
    known, whitened, ours = errors("rotor_inertia", ("backlash_spring",), seed)
    assert known.std_inflation > 10.0
    assert np.mean(whitened < 3.0) < 0.5
    assert np.mean(ours < 3.0) > 0.8


def test_a_mean_of_correlated_errors_is_as_uncertain_as_the_inflation_says():
    rng = np.random.default_rng(0)
    noise = rng.standard_normal((2000, 600))
    for k in range(1, noise.shape[1]):
        noise[:, k] += 0.7 * noise[:, k - 1]
    means = noise.mean(axis=1)
    factors = [variance_inflation([row]) for row in noise[:200]]
    assert np.mean(factors) / 600 == pytest.approx(np.var(means), rel=0.2)
    assert variance_inflation([rng.standard_normal(5000)]) == pytest.approx(1.0, abs=0.2)
    assert variance_inflation([np.zeros(50)]) == 0.0
