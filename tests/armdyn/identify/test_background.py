"""Arms of MuJoCo in which a little of everything is wrong: what is named, and small values beside it."""

from functools import cache

import numpy as np
import pytest
from worlds import dominated_arm
from worlds.imperfect_arm import generate

from armdyn.arm.model import arm_model
from armdyn.effects.catalogue import CATALOGUE
from armdyn.identify.linear_study import LinearStudy
from armdyn.identify.repair import Repair, repair
from armdyn.identify.selection import arm_selection
from armdyn.identify.selection.background import background_widths, sure_unnamed_effects
from armdyn.identify.studies import make_study
from armdyn.model_file import ModelFile, read_model, write_model_file

JOINT_EFFECTS = tuple(effect for effect in CATALOGUE.values() if effect.acts_on == "joint" and not effect.needs)


@cache
def story() -> tuple[LinearStudy, frozenset[str]]:
    """An arm on which Coulomb friction on one joint dominates, and the label of this effect."""
    case = generate("ur5", "coulomb", 3, duration=10.0)
    study = make_study(arm_model(robot="ur5"), case.train, case.held_out, JOINT_EFFECTS, exam=case.exam)
    assert isinstance(study, LinearStudy)
    labels = {f"{CATALOGUE[hidden.effect].name}:{hidden.joint}" for hidden in case.truth}
    return study, frozenset(labels)


@cache
def repaired() -> Repair:
    """The repair in which only the dominant effect has a name, so that a background holds the rest."""
    study, labels = story()

    def only_the_truth(scorer, *_):
        return scorer.evaluate([c for c in scorer.candidates if c.label in labels])

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(arm_selection, "search_set", only_the_truth)
        patch.setattr(arm_selection, "sure_unnamed_effects", lambda *_: [])
        return repair(study)


def total(errors: dict[str, float]) -> float:
    return float(np.linalg.norm(list(errors.values())))


def test_an_arm_that_is_wrong_everywhere_gets_small_values_that_predict_an_exam_better() -> None:
    found = repaired()
    *_, told, whole = found.path
    assert whole.added == ("background",)
    assert 20 < whole.values <= len(found.model.background.names)
    assert total(whole.held_out_rmse) < 0.8 * total(told.held_out_rmse)
    assert total(whole.exam_rmse) < 0.8 * total(told.exam_rmse)
    assert "background" in found.sentence
    assert found.model_without_background.background is None
    assert [e.label for e in found.model_without_background.effects] == [e.label for e in found.model.named_effects]


def test_the_written_model_predicts_what_the_last_step_says(tmp_path) -> None:
    found = repaired()
    write_model_file(tmp_path / "m.toml", ModelFile(found.model, {"robot": "ur5"}))
    read = read_model(tmp_path / "m.toml")
    (exam,) = story()[0].exam
    prediction = read.predict(exam, read.theta())
    for channel, rows in prediction.slices.items():
        left = exam.channels[channel].value - prediction.values[rows]
        assert np.sqrt(np.mean(left**2)) == pytest.approx(found.path[-1].exam_rmse[channel], rel=1e-9)


def test_every_link_stays_a_body_that_can_exist() -> None:
    for inertial in repaired().model.link_parameters().values():
        mass, moment, (xx, xy, yy, xz, yz, zz) = inertial[0], inertial[1:4], inertial[4:]
        inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        second = 0.5 * np.trace(inertia) * np.eye(3) - inertia
        pseudo = np.block([[second, moment[:, None]], [moment[None, :], np.array([[mass]])]])
        assert np.linalg.eigvalsh(pseudo).min() > -1e-9


def test_the_named_effects_alone_have_the_error_that_their_step_states(tmp_path) -> None:
    found = repaired()
    write_model_file(tmp_path / "m.toml", ModelFile(found.model, {"robot": "ur5"}))
    alone = read_model(tmp_path / "m.toml").with_named_effects_only()
    (exam,) = story()[0].exam
    prediction = alone.predict(exam, alone.theta())
    for channel, rows in prediction.slices.items():
        left = exam.channels[channel].value - prediction.values[rows]
        assert np.sqrt(np.mean(left**2)) == pytest.approx(found.path[-2].exam_rmse[channel], rel=1e-6)


def test_values_of_which_the_runs_are_sure_need_a_name() -> None:
    study, _ = story()
    scorer = study.scorer(study.first())
    (width, *_) = background_widths(scorer, ())
    assert "joint_coulomb_friction" in {c.effect for c in sure_unnamed_effects(scorer, (), width)}


def test_all_that_is_sure_has_a_name_and_predicts_as_well_as_a_background() -> None:
    study, labels = story()
    found = repair(study)
    named = [step for step in found.path if not step.values][-1]
    assert total(named.exam_rmse) < 1.1 * total(repaired().path[-1].exam_rmse)
    assert labels <= {f"{one.effect}:{joint}" for one in found.named for joint in one.joints}
    assert [one.share for one in found.named] == sorted((one.share for one in found.named), reverse=True)


def test_no_named_value_is_nothing() -> None:
    found = repair(story()[0])
    for p in found.model.without_background().parameters.values():
        if p.effect and p.effect != "link_inertia":  # whose values are sure together
            assert abs(p.value - p.null) > 1.5 * (p.std or 0.0), p.name


def test_predictions_with_small_values_have_bands_as_well() -> None:
    found = repaired()
    after = found.after
    assert {name: c.held_out_rmse for name, c in after.channels.items()} == pytest.approx(found.path[-1].held_out_rmse)
    assert set(after.bands.coverage) == set(after.channels)
    assert np.mean(list(after.bands.coverage.values())) > 0.85
    assert all(curve.with_background is not None for curve in found.missing_force)


SMALL = {"joint_coulomb_friction", "joint_viscous_friction", "rotor_inertia", "link_inertia"}


def test_frictions_and_rotors_of_many_joints_are_named_after_the_payload_that_hides_them() -> None:
    case = dominated_arm.generate("ur5", "payload", 6000, duration=12.0)
    found = repair(make_study(arm_model(robot="ur5"), case.train, [], JOINT_EFFECTS, exam=[case.exam]))
    first, *later = [step for step in found.path[1:] if step.added != ("background",)]
    assert (first.added, first.joints) == (("payload",), ("wrist_3_joint",))
    assert {name for step in later for name in step.added} <= SMALL
    for name in ("joint_coulomb_friction", "joint_viscous_friction", "rotor_inertia"):
        assert len({joint for step in later if name in step.added for joint in step.joints}) >= 4
    alone, all_told = (np.linalg.norm(list(step.exam_rmse.values())) for step in (first, later[-1]))
    assert all_told < 0.5 * alone
