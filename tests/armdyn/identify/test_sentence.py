"""What a repair says, for steps made by hand."""

from types import SimpleNamespace as Plain

import numpy as np
import pytest

from armdyn.identify.diagnose import decide_verdict
from armdyn.identify.explained_share import ChannelScale, RepairStep, explained_share
from armdyn.identify.holdout import HoldoutKind
from armdyn.identify.problem import ResidualBlock
from armdyn.identify.selection.search import Search
from armdyn.identify.sentence import RepairResidual, Verdict, repair_sentences, total_errors
from armdyn.run import Channel

ARM = ChannelScale({"tau.a": "N m", "tau.b": "N m"}, {"tau.a": 0.3, "tau.b": 0.4})
CELL = ChannelScale({"load_force": "N"}, {"load_force": 0.003})
NOISE = RepairResidual(exceeds_noise=False)


def step(rmse, added=(), joints=(), *, tied=(), held_out=None, exam=None):
    return RepairStep(tuple(added), tuple(joints), tuple(tied), rmse, held_out or rmse, 1.0, 0.0, exam or {})


def said(steps, whose=HoldoutKind.HELD_OUT, scale=ARM, left=NOISE):
    text = repair_sentences(steps, whose, scale, left)
    assert text.endswith(".")
    assert text.count(". ") == 1  # two sentences
    return text


GIVEN = step({"tau.a": 30.0, "tau.b": 40.0})
SPRING = step({"tau.a": 3.0, "tau.b": 4.0}, ["gravity_spring"], ["left_s1"])


def test_the_headline_names_the_effect_and_its_joint_and_the_fall_of_the_error():
    assert said([GIVEN, SPRING], HoldoutKind.LEAVE_ONE_OUT, left=RepairResidual(True, "it depends on v.b")) == (
        "gravity_spring on left_s1 is missing: it explains 99 % of the misfit; the error of runs predicted from the "
        "others falls from 50 to 5 N m. What is left, 10 times the noise, is more than noise (it depends on v.b), and "
        "nothing in the catalogue explains it."
    )


def test_the_catalogue_is_not_said_to_be_at_an_end_where_an_effect_would_still_explain_a_little():
    text = said([GIVEN, SPRING], left=RepairResidual(True, further_effect="rotor_inertia on left_e0"))
    assert text.endswith("rotor_inertia on left_e0 would explain a little of it, too little to be named.")


def test_runs_that_took_part_in_choosing_are_called_so_and_an_exam_goes_before_them():
    assert "on held-out runs, which took part in choosing, falls from 50 to 5 N m" in said([GIVEN, SPRING])
    steps = [
        step({"tau.a": 30.0}, exam={"tau.a": 20.0}),
        step({"tau.a": 3.0}, ["gravity_spring"], ["b"], exam={"tau.a": 10.0}),
    ]
    assert "on the exam, which took part in nothing, falls from 20 to 10 N m" in said(steps, HoldoutKind.EXAM)


def test_add_does_not_speak_for_the_catalogue():
    text = said([GIVEN, SPRING], left=RepairResidual(True, searched=False))
    assert "gravity_spring on left_s1 was added" in text
    assert "nothing in the catalogue" not in text
    assert "armdyn diagnose" in text


def test_what_made_it_worse_is_not_called_missing():
    worse = step({"tau.a": 60.0, "tau.b": 80.0}, ["payload"])
    text = said([GIVEN, worse], left=RepairResidual(True))
    assert "payload was added; the error on held-out runs, which took part in choosing, rises from 50 to 100" in text


def test_several_effects_are_counted_and_the_first_ones_share_is_told():
    last = step({"tau.a": 0.3, "tau.b": 0.4}, ["payload", "torque_delay", "torque_gain"], ["b"])
    text = said([GIVEN, SPRING, last])
    assert "gravity_spring on left_s1, payload, torque_delay and torque_gain are missing" in text
    assert "they explain 100 % of the misfit, gravity_spring alone 99 %" in text
    assert text.endswith("What is left is noise.")
    many = step({"tau.a": 3.0, "tau.b": 4.0}, [f"effect_{i}" for i in range(6)])
    assert "effect_0, effect_1, effect_2 and 3 more effects are missing" in said([GIVEN, many])


def test_the_joint_of_which_least_is_explained_stands_beside_the_total():
    given, last = step({"tau.a": 1.0, "tau.b": 40.0}), step({"tau.a": 0.9, "tau.b": 0.4}, ["payload"])
    assert "it explains 99.9 % of the misfit but only 20 % of that of a;" in said([given, last])
    at_noise = step({"tau.a": 0.5, "tau.b": 40.0})
    assert "but only" not in said([at_noise, last])


def test_ties_and_warnings_are_said():
    steps = [step({"load_force": 0.03}), step({"load_force": 0.006}, ["wind"], tied=["bob"])]
    text = said(steps, scale=CELL, left=RepairResidual(False, warnings=["the link of b weighs 241 kg in the model"]))
    assert "wind is missing (these runs cannot tell bob from it): it explains" in text
    assert "What is left, 2 times the noise, shows no structure that armdyn looks for; but the link of b" in text
    assert text.endswith("weighs 241 kg in the model.")


def test_nothing_added_says_the_error():
    text = said([GIVEN], HoldoutKind.TRAINING)
    assert text.startswith("Nothing was added: the error on the run that it was fitted to is 50 N m.")
    assert text.endswith("What is left, 100 times the noise, shows no structure that armdyn looks for.")


def test_totals_are_over_channels_of_one_unit():
    units = {"tau.a": "N m", "tau.b": "N m", "tau.slide": "N"}
    assert total_errors({"tau.a": 3.0, "tau.b": 4.0, "tau.slide": 2.0}, units) == {"N m": 5.0, "N": 2.0}


def test_explained_is_the_share_of_the_squared_error_above_the_noise():
    assert explained_share(GIVEN, SPRING, ARM) == pytest.approx(1 - (25 - 0.25) / (2500 - 0.25))
    at_noise = step({"tau.a": 0.3, "tau.b": 0.4}, ["payload"])
    assert explained_share(GIVEN, at_noise, ARM) == 1.0
    assert explained_share(at_noise, at_noise, ARM) == 1.0
    assert explained_share(SPRING, GIVEN, ARM) < 0.0


def test_channels_of_different_units_are_weighed_by_their_noise():
    scale = ChannelScale({"load_force": "N", "swing_angle": "rad"}, {"load_force": 1.0, "swing_angle": 0.001})
    before = step({"load_force": 11.0, "swing_angle": 0.011})
    after = step({"load_force": 1.0, "swing_angle": 0.011}, ["sensor_bias"])
    assert explained_share(before, after, scale) == pytest.approx(0.5)


@pytest.mark.parametrize(("level", "verdict"), [(3.0, Verdict.EXPLAINED), (3.5, Verdict.UNKNOWN_EFFECT)])
def test_what_is_left_without_a_shape_is_coloured_noise_unless_it_is_far_above_an_estimated_one(level, verdict):
    time = np.arange(100.0)
    block = ResidualBlock("a", "q.x", Channel(time, time, "rad"), np.full(100, level), np.zeros((100, 0)), 1e-3)
    study = Plain(ignored_chi2=0.0, chi2_of_stated=lambda _blocks: (0.0, 0))
    step = Plain(tests=Plain(fails=True), fit=Plain(blocks=(block,), chi2_per_sample=level**2))
    assert decide_verdict(study, Search((step,)), Plain(significant=False)) is verdict
