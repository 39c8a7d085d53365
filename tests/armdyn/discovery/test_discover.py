"""What is discovered: nothing where nothing is missing, and what is told and drawn of a law."""

from dataclasses import replace
from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest

from armdyn.arm.model import arm_model
from armdyn.discovery.arm import arm_formula_candidates
from armdyn.discovery.discover import _promising, describe_discovery, discover, predicts_better, steps_that_explain
from armdyn.discovery.source import effects_of_terms
from armdyn.discovery.term import named_terms
from armdyn.effects.effect import effect
from armdyn.effects.user import available_effects
from armdyn.identify.repair import add
from armdyn.identify.residual.missing_force import compare_missing_forces
from armdyn.identify.residual.noise_tests import residual_tests
from armdyn.identify.selection.candidate import group_by_effect
from armdyn.identify.selection.path import SearchStep
from armdyn.identify.selection.search import Search, search
from armdyn.identify.studies import make_study
from armdyn.identify.thresholds import THRESHOLD_RANGE_TYPICAL_SIZES
from armdyn.parameter import quantity
from armdyn.pendulum.model import pendulum_model
from armdyn.run import Channel, Run

from ...worlds.laws import URDF, world


def test_what_stands_still_shows_no_law():
    time, noise = np.arange(0.0, 8.0, 0.02), 1e-3 * np.random.default_rng(1).standard_normal(400)
    run = Run("still", {"swing_angle": Channel(time, noise, "rad")}, {}, {"swing_angle": 1e-3})
    found = discover(make_study(pendulum_model(0.368, 0.08), [run], [], []))
    assert found.nothing_moves
    assert "record a motion" in found.sentence


def test_a_law_is_drawn_over_the_missing_force_without_its_noise():
    """Cubic drag M = -k rate^3 of a pendulum, which no length can make up for."""
    given = world("cubic drag", 3)
    model = pendulum_model(given.length, given.mass)

    @effect("drag", acts_on="string", summary="drag", source="a test")
    def drag(string, k=quantity("N m s^3/rad^3", typical=1e-3, lower=0)):
        return string.with_torque(-k * string.rate**3)

    study = make_study(model, given.runs[:1], [], [drag])
    first, fit = study.first(), add(study, [drag]).steps[-1].fit
    (curve,) = (c for c in compare_missing_forces(first, fit, law=True) if c.against == "speed")
    (k,) = fit.values[study.problem.mask_of_unknowns(("drag.k",))]
    torque = -k * curve.x**3 / (given.mass * given.length**2)
    drawn, measured = (np.sqrt(np.mean((y - torque) ** 2)) for y in (curve.law, curve.as_given))
    assert drawn < 0.3 * measured
    assert drawn < 0.1 * np.sqrt(np.mean(torque**2))


@pytest.mark.parametrize(("left", "better"), [([0.5, 0.5], True), ([2.0, 0.1], False), ([], True)])
def test_what_predicts_runs_that_were_not_fitted_no_better_is_not_told(left, better):
    """A curve through seven values once fitted two recordings, and predicted each from the other 14 times worse."""
    blocks = {"as given": [1.0, 1.0] if left else [], "with it": left}
    study = SimpleNamespace(held_out_blocks=lambda fit: [SimpleNamespace(residual=np.array([r])) for r in blocks[fit]])
    steps = [SimpleNamespace(fit="as given"), SimpleNamespace(fit="with it")]
    assert predicts_better(study, SimpleNamespace(steps=steps, last=steps[-1])) is better


@pytest.mark.parametrize(("left", "kept"), [([100.0, 0.3, 0.1], 3), ([100.0, 0.3, 0.2], 2), ([100.0, 30.0, 28.0], 3)])
def test_last_steps_that_explain_nothing_go_unless_they_remove_much_of_what_was_left(left, kept):
    steps = [SimpleNamespace(fit=SimpleNamespace(left=x, free=np.ones(k))) for k, x in enumerate(left)]
    study = SimpleNamespace(
        explained_share=lambda before, after: 1.0 - after.left / before.left,
        squared_error=lambda fit: fit.left,
    )
    assert len(steps_that_explain(study, steps)) == kept


def test_terms_that_begin_at_a_place_say_on_which_side_they_act(model):
    """A cable that tightens above its place does nothing below it; a spring acts everywhere."""
    run = world("cogging", 0).runs[0]
    terms = list(named_terms(arm_formula_candidates(make_study(model, [run], [], ()).first())).values())
    for term in terms:
        (shape, *_), v = term.shapes.values(), term.variables[0] if term.variables else None
        if not term.acts_beyond:
            assert "place" not in term.parameters or term.kind in ("magnet", f"torque by {v.name_in_sentence}")
            continue
        place = (v.low + v.high) / 2
        known = {"ca": ca, "place": place, "width": 0.1, "speed": 1.0}
        off, on = (eval(shape, {**known, v.name: place + side * 0.4 * v.span})
                   for side in (-term.acts_beyond, term.acts_beyond))  # fmt: skip
        assert abs(off) < 1e-6 < abs(on)
        assert term.share_without(v.low) + term.share_without(v.high) == pytest.approx(1.0, abs=0.01)


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    path = tmp_path_factory.mktemp("arm") / "two.urdf"
    path.write_text(URDF)
    return arm_model(urdf=path)


def test_a_place_is_looked_for_where_its_joint_reaches(model):
    run = world("cogging", 0).runs[0]
    terms = list(named_terms(arm_formula_candidates(make_study(model, [run], [], ()).first())).values())
    for term, law in zip(terms, effects_of_terms(terms), strict=True):
        (joint,) = law.joints
        q = run.channels[f"q.{joint}"].value
        parameters = model.with_effect(law).parameters
        if "place" in term.parameters:
            place = parameters[f"{law.name}.place[{joint}]"]
            assert q.min() <= place.lower < place.upper <= q.max()
            assert (place.value - place.lower, place.prior) == (
                pytest.approx(THRESHOLD_RANGE_TYPICAL_SIZES * place.typical),
                None,
            )
        if "cubic_drag" in law.name:
            typical = parameters[f"{law.name}.k[{joint}]"].typical
            rms = np.sqrt(np.mean(run.channels[f"tau.{joint}"].value ** 2))
            fastest = np.abs(np.gradient(q, run.channels[f"q.{joint}"].time)).max()
            assert typical * fastest**3 == pytest.approx(0.1 * rms, rel=0.2)


def test_terms_of_an_arm_are_compared_at_their_likeliest_places(model):
    """In the middle of a joint's range a magnet may pull to no side."""
    given = world("tightening cable", 0)
    terms = named_terms(arm_formula_candidates(make_study(model, given.runs, [], ()).first()))
    study = make_study(model, given.runs, [], effects_of_terms(list(terms.values())))
    scores = study.scores(study.with_thresholds(study.first()), ())
    drops = {score.candidate.effect: score.chi2_decrease for score in scores}
    there = [drops[n] for n, t in terms.items() if t.kind == "magnet" and t.location.joint == "elbow"]
    assert max(there) > 0.5 * max(drops.values())


def test_a_joint_may_have_a_long_name(tmp_path):
    """A term of a UR10e's shoulder_pan once had a longer name than an effect may have."""
    path, joint = tmp_path / "two.urdf", "elbow_of_the_left_arm_behind_the_second_gearbox"
    path.write_text(URDF.replace('"elbow"', f'"{joint}"'))
    run = world("cogging", 0).runs[0]
    renamed = replace(run, channels={name.replace("elbow", joint): of for name, of in run.channels.items()}, noise={})
    model = arm_model(urdf=path)
    terms = named_terms(arm_formula_candidates(make_study(model, [renamed], [], ()).first()))
    assert {effect.name for effect in effects_of_terms(list(terms.values()))} == set(terms)
    assert any(term.location.joint == joint for term in terms.values())


def test_an_effect_that_came_on_one_joint_after_the_other_is_told_on_both(model):
    """Viscous friction of a shoulder, then of an elbow, was once found and not told."""
    run, viscous = (
        world("cogging", 0).runs[0],
        next(e for e in available_effects(model) if e.name == "joint_viscous_friction"),
    )
    study = make_study(model, [run], [], [viscous])
    (both,) = study.candidates
    steps, effects = [SearchStep((), (), (), study.first(), residual_tests(study.first(), []))], ()
    for one in both.split_by_joint():
        effects = group_by_effect((*effects, one))
        fit = study.fit_base_with_effects(effects, steps[-1].fit)
        steps.append(SearchStep((one,), (), effects, fit, residual_tests(fit, [])))
    found = describe_discovery(study, Search(tuple(steps)), {}, {viscous.name: viscous})
    (law,) = found.laws
    assert law.joints == ("shoulder", "elbow")
    assert law.explained_share == pytest.approx(found.explained_share)


def test_terms_are_ranked_beside_known_effects_that_another_study_found(model):
    """The study with terms has more unknowns than the one that found the known effects; armdyn once stopped here."""
    given = world("cogging", 0)
    known = [e for e in available_effects(model) if e.name in ("joint_viscous_friction", "joint_coulomb_friction")]
    study = make_study(model, given.runs, [given.held_out], known)
    terms = named_terms(arm_formula_candidates(study.first()))
    wider = study.with_other_catalogue([*known, *effects_of_terms(list(terms.values()))])
    names = _promising(wider, terms, search(study).last)
    assert any(terms[name].kind == "cogging" and terms[name].location.joint == "elbow" for name in names)


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "seed"), [("cogging", 0), ("tightening cable", 1)])
def test_a_law_of_a_joint_is_discovered_beside_friction(model, kind, seed):
    """Seen from the model as given, the cable explained 0.3 % of what frictions do."""
    given = world(kind, seed)
    found = discover(make_study(model, given.runs, [given.held_out], available_effects(model)))
    (law,) = found.laws_outside_catalogue
    assert (law.kind, law.joints) == (kind, ("elbow",))
    assert {one.effect for one in found.laws} > {"joint_viscous_friction", "joint_coulomb_friction"}
