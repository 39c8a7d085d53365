"""Hidden effects, made by equations of their own, are found; clean runs are left alone."""

from dataclasses import replace
from types import SimpleNamespace as Plain

import numpy as np
import pytest
from scipy.signal import lombscargle
from worlds import pendulum

from armdyn.effects.catalogue import CATALOGUE
from armdyn.errors import InputError
from armdyn.estimation.descent import Outcome
from armdyn.identify.diagnose import diagnose
from armdyn.identify.fit import Fit
from armdyn.identify.noise import (
    WhiteningFilter,
    autoregression,
    likeliest_autoregression,
    ljung_box,
    whiten,
)
from armdyn.identify.repair import repair
from armdyn.identify.residual.block import ResidualBlock
from armdyn.identify.residual.character import ResidualTerm, _library, periodogram, spectral_peaks
from armdyn.identify.sentence import Verdict
from armdyn.identify.settings import DEFAULT_SETTINGS
from armdyn.identify.state_space.scorer import StateSpaceScorer
from armdyn.identify.studies import make_study
from armdyn.pendulum.model import pendulum_model
from armdyn.run import Channel

EFFECTS = tuple(effect for effect in CATALOGUE.values() if effect.acts_on not in ("joint", "drive"))


def recordings(**settings):
    return pendulum.recordings(duration=8.0, **settings)


def study_of(runs, held_out=(), effects=EFFECTS):
    return make_study(pendulum_model(0.35, 0.1), runs, held_out, effects)


def test_runs_without_an_effect_are_explained_whatever_the_colour_of_their_noise_and_the_length_is_right():
    found = diagnose(study_of(recordings(correlation=0.8)))
    assert found.verdict is Verdict.EXPLAINED
    length = found.comparison.parameters["length"]
    assert abs(length.value - 0.368) < 4 * length.std


def test_wind_and_tilt_are_an_honest_tie_with_advice():
    found = diagnose(study_of(recordings(hidden={"wind": 0.01})))
    assert found.verdict is Verdict.CANNOT_TELL_APART
    assert {found.ranked_effects[0].effect, *found.ranked_effects[0].tied_with} == {"wind", "path_tilt"}
    assert found.remedies == ("'armdyn next' on the same files computes which experiment does, and designs the motion",)
    assert found.remedies[0] in found.sentence


def test_repair_lets_both_errors_fall_to_the_noise():
    hidden = {"cross_axis_sensitivity": 0.03, "sensor_delay": 0.01}
    rivals = "sensor_lag sensor_gain sensor_bias sensor_drift quadratic_drag wind path_tilt gripper_lag"
    effects = [CATALOGUE[name] for name in (*hidden, *rivals.split())]
    found = repair(study_of(recordings(hidden=hidden), effects=effects))
    assert {effect.name for effect in found.model.effects} == set(hidden)
    assert [step.chi2_per_sample for step in found.path] == sorted(
        (step.chi2_per_sample for step in found.path), reverse=True
    )
    assert found.after.channels["load_force"].held_out_rmse < 1.1 * 3e-3


def test_reordering_and_renaming_runs_changes_nothing():
    runs = recordings(hidden={"sensor_bias": 0.02})
    one = study_of(runs, effects=()).first()
    other = study_of([replace(run, name=f"x{i}.csv") for i, run in enumerate(reversed(runs))], effects=()).first()
    assert one.cost == pytest.approx(other.cost, rel=1e-6)


def test_adding_an_effect_never_raises_the_training_error():
    study = study_of(recordings(hidden={"sensor_drift": 1e-3}), effects=EFFECTS[:4])
    first = study.first()
    for candidate in study.candidates:
        assert study.fit_base_with_effects((candidate,), first).cost <= first.cost * (1 + 1e-9)


def test_a_held_out_run_that_is_also_a_training_run_is_refused(complains):
    runs = recordings()
    with complains(InputError):
        study_of(runs, [runs[0]])


def test_whitening_makes_an_autoregression_white():
    rng = np.random.default_rng(1)
    e = rng.normal(size=4000)
    for i in range(1, len(e)):
        e[i] += 0.8 * e[i - 1]
    assert ljung_box(e) < 1e-10
    assert ljung_box(whiten(e, autoregression([e]))) > 1e-3


def test_a_set_of_which_one_effect_is_wrong_is_promised_the_right_exchange():
    study = study_of(recordings(hidden={"sensor_bias": 0.02, "sensor_drift": 1e-3}))
    by_name = {c.effect: c for c in study.candidates}
    scorer = StateSpaceScorer(study)
    wrong = scorer.optimise([by_name["sensor_bias"], by_name["string_creep"]])
    exchanged = [(by_name["sensor_bias"], c) for c in scorer.candidates if c not in wrong.effects]
    found = max((scorer.evaluate(one) for one in exchanged), key=lambda one: one.score)
    assert set(found.effects) == {by_name["sensor_bias"], by_name["sensor_drift"]}
    assert scorer.optimise(found.effects).score > wrong.score


def test_effects_at_null_are_left_out_without_a_trace():
    study = study_of(recordings())
    problem, first = study.problem, study.first()
    base = problem.mask_of_unknowns(["length", "mass", "initial_angle", "initial_rate"])
    lean, whole = problem.blocks(first.values, base), study_of(study.runs).problem.blocks(first.values)
    for block, other in zip(lean, whole, strict=True):
        assert block.residual == pytest.approx(other.residual, abs=1e-6)
        assert block.sensitivities[:, base] == pytest.approx(other.sensitivities[:, base], rel=1e-6, abs=1e-6)


def test_periodogram_of_uneven_samples_is_that_of_scipy():
    rng = np.random.default_rng(2)
    time, value = np.sort(rng.uniform(0, 15, 300)), rng.normal(size=300)
    frequencies = np.linspace(0.2, 20.0, 450)
    assert periodogram(time, value, frequencies) == pytest.approx(
        lombscargle(time, value, 2 * np.pi * frequencies), rel=1e-8
    )


def test_white_noise_is_not_whitened_and_coloured_noise_is():
    rng = np.random.default_rng(0)
    white = [rng.standard_normal(200) for _ in range(200)]
    assert np.mean([len(likeliest_autoregression([e])) == 0 for e in white]) > 0.9
    e = rng.standard_normal(3000)
    for k in range(1, len(e)):
        e[k] += 0.8 * e[k - 1]
    assert likeliest_autoregression([e]) == pytest.approx([0.8], abs=0.05)


def test_a_joint_that_moved_for_a_handful_of_samples_does_not_hide_the_frequency_of_another_run() -> None:
    rng = np.random.default_rng(0)
    time = np.arange(400) * 0.05

    def block(run: str, samples: int) -> ResidualBlock:
        residual = np.sin(2.0 * np.pi * 1.3 * time[:samples]) * 5.0 + rng.standard_normal(samples)
        return ResidualBlock(
            run,
            "tau.j",
            Channel(time[:samples], residual, "N m"),
            residual,
            np.zeros((samples, 0)),
            1.0,
            np.zeros(0, bool),
        )

    blocks = (block("long", 400), block("short", 3))
    problem = Plain(settings=DEFAULT_SETTINGS)
    fit = Fit(problem, np.zeros(0, dtype=bool), np.zeros(0), blocks, Outcome.CONVERGED)
    (peak,) = spectral_peaks(fit, {"tau.j": WhiteningFilter(np.zeros(3), 1.0)})
    assert peak.frequency == pytest.approx(1.3, rel=0.02)


def test_functions_on_which_a_residual_depends_are_said_in_words():
    rng = np.random.default_rng(0)
    signals = {name: [rng.standard_normal(20)] for name in ("q.joint-1", "v.joint-1", "a.joint-1", "swing_rate")}
    words = {label: ResidualTerm("tau.joint-1", label, 0.5, 0.0).in_words for label in _library(signals)}
    assert words["sign(v.joint-1)"] == "the sign of the velocity of joint-1"
    assert words["[q.joint-1 > 0] sign(v.joint-1)"] == (
        "the sign of the velocity of joint-1 where the position of joint-1 is positive"
    )
    assert words["|swing_rate| swing_rate"] == "the square of the swing rate, with its sign"
    assert not [said for said in words.values() if set("[]^|()._") & set(said)]
