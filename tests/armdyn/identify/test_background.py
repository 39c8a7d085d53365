"""Small values beside a story, on arms of MuJoCo in which a little of everything is wrong, and on one that is right."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from worlds.imperfect_arm import generate

from armdyn.arm.model import arm_model
from armdyn.effects.catalogue import CATALOGUE
from armdyn.identify.repair import Repair, add, with_background
from armdyn.identify.selection.background import AllEffectsFit, find_background, fit_all_effects
from armdyn.identify.study import Study
from armdyn.model_file import ModelFile, read_model, write_model_file

JOINT_EFFECTS = tuple(effect for effect in CATALOGUE.values() if effect.acts_on == "joint")


@cache
def repaired() -> tuple[Repair, Study]:
    """The effect that dominates, as a search would name it, and what is found beside it."""
    case = generate("ur5", "coulomb", 3, duration=10.0)
    study = Study.of(arm_model(robot="ur5"), case.train, case.held_out, JOINT_EFFECTS, exam=case.exam)
    named = [CATALOGUE[hidden.effect].on(hidden.joint) for hidden in case.truth]
    told = add(study, named)
    return with_background(told, full_model(study, told)), study


def full_model(study: Study, told: Repair) -> AllEffectsFit:
    last = told.steps[-1]
    return fit_all_effects(study, last.effects, last.fit, lambda _: None)


def total(errors: dict[str, float]) -> float:
    return float(np.linalg.norm(list(errors.values())))


def test_an_arm_that_is_wrong_everywhere_gets_small_values_that_predict_an_exam_better() -> None:
    found, _ = repaired()
    _, story, whole = found.path
    assert whole.added == ("background",)
    assert whole.values == len(found.model.background.names) > 20
    assert total(whole.held_out_rmse) < 0.8 * total(story.held_out_rmse)
    assert total(whole.exam_rmse) < 0.8 * total(story.exam_rmse)
    assert "background" in found.sentence


def test_the_named_model_is_the_story_alone() -> None:
    found, _ = repaired()
    assert found.model_without_background.background is None
    assert [e.label for e in found.model_without_background.effects] == [e.label for e in found.model.named_effects]


def test_the_written_model_predicts_what_the_last_step_says(tmp_path) -> None:
    found, study = repaired()
    write_model_file(tmp_path / "m.toml", ModelFile(found.model, {"robot": "ur5"}))
    read = read_model(tmp_path / "m.toml")
    (exam,) = study.exam
    prediction = read.predict(exam, read.theta())
    for channel, rows in prediction.slices.items():
        left = exam.channels[channel].value - prediction.values[rows]
        assert np.sqrt(np.mean(left**2)) == pytest.approx(found.path[-1].exam_rmse[channel], rel=1e-9)


def test_every_link_stays_a_body_that_can_exist() -> None:
    found, _ = repaired()
    for inertial in found.model.link_parameters().values():
        mass, moment, (xx, xy, yy, xz, yz, zz) = inertial[0], inertial[1:4], inertial[4:]
        inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        second = 0.5 * np.trace(inertia) * np.eye(3) - inertia
        pseudo = np.block([[second, moment[:, None]], [moment[None, :], np.array([[mass]])]])
        assert np.linalg.eigvalsh(pseudo).min() > -1e-9


def test_where_small_values_make_other_runs_worse_there_are_none_and_the_answer_says_so(monkeypatch) -> None:
    case = generate("ur5", "coulomb", 3, duration=10.0)
    study = Study.of(arm_model(robot="ur5"), case.train, case.held_out, JOINT_EFFECTS)
    told = add(study, [CATALOGUE[hidden.effect].on(hidden.joint) for hidden in case.truth])
    full = full_model(study, told)
    small = find_background(full, told.steps[-1])
    assert small is not None
    given = study.first()  # leaves more than the named effects do
    monkeypatch.setattr("armdyn.identify.repair.find_background", lambda *_: replace(small, fit=given))
    found = with_background(told, full)
    assert found.model.background is None
    assert found.path == told.path
    assert found.sentence.endswith("there is no background.")
