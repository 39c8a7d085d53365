"""Hidden physics in Baxter's right arm is named, on the joints that have it; clean runs are left alone."""

import pytest
from worlds.baxter import generate, true_parameters

from armdyn.arm.model import arm_model
from armdyn.effects.catalogue import CATALOGUE
from armdyn.identify.diagnose import diagnose
from armdyn.identify.repair import repair
from armdyn.identify.sentence import Verdict
from armdyn.identify.studies import make_study

from .conftest import JOINT_EFFECTS

JOINT = tuple(CATALOGUE[name] for name in JOINT_EFFECTS)


def study_of(hidden, seed, **settings):
    runs = [generate(hidden, 1.0, seed, recording=k, **settings) for k in range(2)]
    return make_study(arm_model(robot="baxter"), runs, [], JOINT)


def test_a_spring_is_no_offset_and_no_gain_though_either_takes_most_of_it_away():
    found = diagnose(study_of("gravity_spring", 1))
    assert found.verdict is Verdict.EFFECT_MISSING
    assert (found.ranked_effects[0].effect, found.ranked_effects[0].joints) == ("gravity_spring", ("right_s1",))
    for name, true in true_parameters("gravity_spring", 1.0).items():
        value = found.ranked_effects[0].parameters[name]
        assert abs(value.value - true) < 4 * value.std


def test_friction_stays_symmetric_beside_what_it_could_have_stood_for():
    # Friction of another size in each direction holds an offset, which stands in for a payload not yet found.
    found = repair(study_of(("payload", "joint_coulomb_friction"), 1))
    assert {effect.name for effect in found.model.effects} == {"payload", "joint_coulomb_friction"}


@pytest.mark.parametrize("colour", [0.0, 0.8])
def test_noise_of_any_colour_is_no_missing_effect(colour):
    assert diagnose(study_of(None, 0, colour=colour)).verdict is Verdict.EXPLAINED


def test_cogging_is_no_effect_of_the_catalogue():
    assert diagnose(study_of("cogging", 0)).verdict is Verdict.UNKNOWN_EFFECT
