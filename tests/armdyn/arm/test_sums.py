"""Sums over samples foretell what a model predicts; effects are chosen by what they are worth to other runs."""

import numpy as np
import pytest
from worlds.baxter import generate

from armdyn.arm.model import arm_model
from armdyn.effects.catalogue import CATALOGUE
from armdyn.identify.repair import repair
from armdyn.identify.selection.linear_predictor import misfit_per_sample
from armdyn.identify.selection.linear_scorer import LinearScorer
from armdyn.identify.sentence import Verdict
from armdyn.identify.studies import make_study

from .conftest import JOINT_EFFECTS

JOINT = tuple(CATALOGUE[name] for name in JOINT_EFFECTS)


def study_of(hidden, size=1.0, seed=3):
    return make_study(
        arm_model(robot="baxter"), [generate(hidden, size, seed, recording=k) for k in range(2)], [], JOINT
    )


@pytest.fixture(scope="module")
def study():
    return study_of(("payload", "joint_coulomb_friction", "link_inertia"))


@pytest.fixture(scope="module")
def scorer(study):
    return study.scorer(study.first())


def on(scorer, *labels):
    return [c for c in scorer.candidates if c.label in labels]


def errors_by_sums(scorer, one, units):
    """Mean squared errors of some units that the sums foretell for a set."""
    change, equations = np.zeros(len(scorer.sums.values)), scorer.sums.equations
    change[one.columns] = one.change
    return equations.squared_error(change, units) / equations.count[units]


@pytest.mark.parametrize(
    "labels",
    [
        ("joint_viscous_friction:right_s0", "joint_coulomb_friction:right_e1", "gravity_spring:right_s1"),
        ("torque_offset:right_w1", "torque_offset:right_e0"),
    ],
)
def test_errors_by_sums_are_those_of_the_model_at_the_foretold_values(study, scorer, labels):
    one = scorer.evaluate(on(scorer, *labels))
    foretold = errors_by_sums(scorer, one, np.arange(4))
    blocks = study.problem.blocks(study.values_predicted_by_scorer(scorer, one))
    assert foretold == pytest.approx([float(np.mean(b.misfit**2)) for b in blocks[:4]], rel=1e-6)


def test_a_fit_to_samples_finds_no_better_minimum_than_one_on_sums(study, scorer):
    one = scorer.evaluate(on(scorer, "joint_coulomb_friction:right_s0", "joint_coulomb_friction:right_s1"))
    errors = errors_by_sums(scorer, one, np.arange(2))
    fitted = study.fit_base_with_effects([c.on(["right_s0", "right_s1"]) for c in study.candidates
                             if c.effect == "joint_coulomb_friction"], study.first())  # fmt: skip
    assert errors == pytest.approx([float(np.mean(b.misfit**2)) for b in fitted.blocks[:2]], rel=1e-3)


def test_likelihood_goes_over_from_noise_to_model_error_without_a_step():
    ratio = np.array([1.0 - 1e-6, 1.0 + 1e-6])
    below, above = misfit_per_sample(ratio)
    assert above - below == pytest.approx(2e-6, rel=1e-3)
    assert misfit_per_sample(np.array(0.5)) == pytest.approx(-0.5)
    assert misfit_per_sample(np.array(np.e**3)) == pytest.approx(3.0)


def test_what_ends_on_a_bound_explains_nothing():
    study = study_of("torque_gain", size=-9.0)  # 0.72 of the reading is missing: another motor
    scorer = study.scorer(study.first())
    assert scorer.evaluate(on(scorer, "torque_gain:right_s0")).score == -np.inf


def test_the_order_of_questions_changes_no_answer(study):
    one = study.scorer(study.first())
    other = LinearScorer(one.sums, study.problem.fitted & ~study.problem.is_effect, one.candidates)
    labels = ("payload:right_w2", "joint_coulomb_friction:right_s1")
    other.evaluate(on(other, "gravity_spring:right_s1"))
    assert one.evaluate(on(one, *labels)).score == other.evaluate(on(other, *reversed(labels))).score


def test_a_base_on_the_wall_is_no_matter_of_inertias():
    found = repair(study_of("base_tilt", size=18.0))
    assert [effect.name for effect in found.model.effects] == ["base_tilt"]
    assert found.model.value("base_tilt.roll") == pytest.approx(0.9, abs=0.01)
    assert found.verdict is Verdict.EXPLAINED


def test_an_effect_that_the_model_has_on_one_joint_is_found_on_another():
    runs = [generate("joint_coulomb_friction", 1.0, 5, recording=k) for k in range(2)]
    given = arm_model(robot="baxter", effects=[CATALOGUE["joint_coulomb_friction"].on("right_s0")])
    given = given.with_values({"joint_coulomb_friction.torque[right_s0]": 1.0})
    given = given.with_fixed("joint_coulomb_friction.torque[right_s0]")
    found = repair(make_study(given, runs, [], JOINT))
    assert [effect.name for effect in found.model.effects] == ["joint_coulomb_friction"]
    assert found.verdict is Verdict.EXPLAINED
    assert found.model.value("joint_coulomb_friction.torque[right_s1]") == pytest.approx(1.0, abs=0.02)  # N m
    kept = found.model.parameters["joint_coulomb_friction.torque[right_s0]"]
    assert (kept.value, kept.fitted) == (1.0, False)


def test_foretold_sets_are_those_that_are_scored(scorer):
    """Of effects without bounds nearby: the ranking by foretold errors is the ranking by fits."""
    now = scorer.evaluate(on(scorer, "joint_coulomb_friction:right_s1"))
    options = [(c,) for c in on(scorer, "torque_offset:right_e0", "torque_offset:right_s1", "link_inertia:right_e1")]
    scored = [scorer.evaluate((*now.effects, *come)) for come in options]
    evidence = [
        one.likelihood + one.held_out_log_likelihood - one.occam_penalty_nats - scorer.complexity_penalty(one.effects)
        for one in scored
    ]
    assert scorer.approximate_addition_scores(now, options) == pytest.approx(evidence, rel=2e-4)
