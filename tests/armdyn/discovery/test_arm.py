"""Terms of an arm: on one joint each, in the range of that joint, whatever its strength; and a law that is found."""

from dataclasses import replace

import numpy as np
import pytest

from armdyn.arm.model import arm_model
from armdyn.discovery.arm import arm_terms
from armdyn.discovery.discover import concluded, discover
from armdyn.discovery.source import effects_of_terms
from armdyn.discovery.term import named_terms
from armdyn.effects.user import available
from armdyn.identify.candidate import merged
from armdyn.identify.score import residual_tests
from armdyn.identify.search import Search
from armdyn.identify.study import Study
from armdyn.identify.way import Step

from ...hidden_effects.laws import URDF, world


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    path = tmp_path_factory.mktemp("arm") / "two.urdf"
    path.write_text(URDF)
    return arm_model(urdf=path)


def test_a_place_is_one_that_its_joint_reaches(model):
    run = world("cogging", 0).runs[0]
    terms = list(named_terms(arm_terms(Study(model, [run], [], ()).first())).values())
    for term, effect in zip(terms, effects_of_terms(terms), strict=True):
        (joint,) = effect.joints
        q = run.channels[f"q.{joint}"].value
        parameters = model.with_effect(effect).parameters
        if "place" in term.constants:
            assert q.min() <= parameters[f"{effect.name}.place[{joint}]"].value <= q.max()
        if "cubic_drag" in effect.name:
            typical = parameters[f"{effect.name}.k[{joint}]"].typical
            rms = np.sqrt(np.mean(run.channels[f"tau.{joint}"].value ** 2))
            fastest = np.abs(np.gradient(q, run.channels[f"q.{joint}"].time)).max()
            assert typical * fastest**3 == pytest.approx(0.1 * rms, rel=0.2)


def test_a_joint_may_have_a_long_name(tmp_path):
    """A term of a UR10e's shoulder_pan once had a longer name than an effect may have."""
    path, joint = tmp_path / "two.urdf", "elbow_of_the_left_arm_behind_the_second_gearbox"
    path.write_text(URDF.replace('"elbow"', f'"{joint}"'))
    run = world("cogging", 0).runs[0]
    renamed = replace(run, channels={name.replace("elbow", joint): of for name, of in run.channels.items()}, noise={})
    model = arm_model(urdf=path)
    terms = named_terms(arm_terms(Study(model, [renamed], [], ()).first()))
    assert {effect.name for effect in effects_of_terms(list(terms.values()))} == set(terms)
    assert any(term.site.joint == joint for term in terms.values())


def test_nothing_is_discovered_in_a_clean_arm(model):
    given = world("clean arm", 1)
    assert not discover(model, given.runs, [given.held_out], available(model)).findings


def test_an_effect_that_came_on_one_joint_after_the_other_is_told_on_both(model):
    """Viscous friction of a shoulder, then of an elbow, was once found and not told."""
    run, viscous = world("cogging", 0).runs[0], next(e for e in available(model) if e.name == "joint_viscous_friction")
    study = Study(model, [run], [], [viscous])
    (both,) = study.candidates
    steps, effects = [Step((), (), (), study.first(), residual_tests(study.first(), []))], ()
    for one in both.apart():
        effects = merged((*effects, one))
        fit = study.fit_with(effects, steps[-1].fit)
        steps.append(Step((one,), (), effects, fit, residual_tests(fit, [])))
    found = concluded(study, Search(tuple(steps)), {}, {viscous.name: viscous})
    (law,) = found.findings
    assert law.joints == ("shoulder", "elbow")
    assert law.explains == pytest.approx(found.explains)


@pytest.mark.slow
def test_cogging_is_discovered_beside_friction(model):
    given = world("cogging", 0)
    found = discover(model, given.runs, [given.held_out], available(model))
    (law,) = found.new
    assert (law.kind, law.joints) == ("cogging", ("elbow",))
    assert {one.effect for one in found.findings} > {"joint_viscous_friction", "joint_coulomb_friction"}
