"""Stories of arms of MuJoCo in which a little of everything is wrong, and small values beside them."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from worlds import dominated_arm
from worlds.imperfect_arm import generate

from armdyn.arm.model import arm_model
from armdyn.effects.catalogue import CATALOGUE
from armdyn.identify.repair import Repair, add, repair, with_background
from armdyn.identify.selection.background import AllEffectsFit, find_background, fit_all_effects
from armdyn.identify.study import Study
from armdyn.model_file import ModelFile, read_model, write_model_file

JOINT_EFFECTS = tuple(effect for effect in CATALOGUE.values() if effect.acts_on == "joint")


@cache
def story() -> tuple[Study, Repair, AllEffectsFit]:
    """The effect that dominates, as a search would name it, and all effects beside it."""
    case = generate("ur5", "coulomb", 3, duration=10.0)
    study = Study.of(arm_model(robot="ur5"), case.train, case.held_out, JOINT_EFFECTS, exam=case.exam)
    told = add(study, [CATALOGUE[hidden.effect].on(hidden.joint) for hidden in case.truth])
    last = told.steps[-1]
    return study, told, fit_all_effects(study, last.effects, last.fit, lambda _: None)


@cache
def repaired() -> Repair:
    """What is found beside it."""
    return with_background(*story()[1:])


def total(errors: dict[str, float]) -> float:
    return float(np.linalg.norm(list(errors.values())))


def test_an_arm_that_is_wrong_everywhere_gets_small_values_that_predict_an_exam_better() -> None:
    found = repaired()
    _, told, whole = found.path
    assert whole.added == ("background",)
    assert whole.values == len(found.model.background.names) > 20
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


def test_where_small_values_make_other_runs_worse_there_are_none_and_the_answer_says_so(monkeypatch) -> None:
    study, told, full = story()
    small = find_background(full, told.steps[-1])
    assert small is not None
    given = study.first()  # leaves more than the named effects do
    monkeypatch.setattr("armdyn.identify.repair.find_background", lambda *_: replace(small, fit=given))
    found = with_background(told, full)
    assert found.model.background is None
    assert found.path == told.path
    assert found.sentence.endswith("there is no background.")


def test_predictions_with_small_values_have_bands_as_well() -> None:
    found = repaired()
    after = found.after
    assert {name: c.held_out_rmse for name, c in after.channels.items()} == pytest.approx(found.path[-1].held_out_rmse)
    assert set(after.bands.coverage) == set(after.channels)
    assert np.mean(list(after.bands.coverage.values())) > 0.85
    assert all(curve.with_background is not None for curve in found.missing_force)


SMALL = {"joint_coulomb_friction", "joint_viscous_friction", "rotor_inertia", "link_inertia"}


def test_frictions_and_rotors_of_many_joints_are_told_after_the_payload_that_hides_them() -> None:
    case = dominated_arm.generate("ur5", "payload", 6000, duration=12.0)
    found = repair(Study.of(arm_model(robot="ur5"), case.train, [], JOINT_EFFECTS, exam=[case.exam]))
    first, *later = [step for step in found.path[1:] if step.added != ("background",)]
    assert (first.added, first.joints) == (("payload",), ("wrist_3_joint",))
    assert {name for step in later for name in step.added} <= SMALL
    for name in ("joint_coulomb_friction", "joint_viscous_friction", "rotor_inertia"):
        assert len({joint for step in later if name in step.added for joint in step.joints}) >= 4
    alone, all_told = (np.linalg.norm(list(step.exam_rmse.values())) for step in (first, later[-1]))
    assert all_told < 0.5 * alone
