"""Servo arms that record positions and commands only: effects are chosen by the simulated motion. Truth is MuJoCo's."""

from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from worlds import hobby_arm

from armdyn.arm.closed_loop import motion_model
from armdyn.arm.closed_loop.motion_model import MotionModel
from armdyn.arm.model import ArmModel, arm_model
from armdyn.checked_study import CheckedStudy
from armdyn.effects.catalogue import find
from armdyn.identify.motion.lost_motion import unless_lost
from armdyn.identify.repair import Repair
from armdyn.identify.sentence import Verdict
from armdyn.model_file import ModelFile, read_model_file, write_model_file
from armdyn.recording.gaps import run_until
from armdyn.run import Run
from pipeline.report.overlay import study_overlays
from pipeline.report.repair import repair_report

SECONDS = 12.0


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> tuple[ArmModel, list[Run]]:
    folder: Path = tmp_path_factory.mktemp("hobby")
    file = folder / "arm.urdf"
    file.write_text(hobby_arm.urdf_text())
    runs = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(hobby_arm, "SECONDS", SECONDS)
        for seed in range(2):
            q, told = hobby_arm.recorded(file, seed)
            columns = {f"q.{j}": q[:, i] for i, j in enumerate(hobby_arm.JOINTS)}
            columns |= {f"q_cmd.{j}": told[:, i] for i, j in enumerate(hobby_arm.JOINTS)}
            time = np.arange(len(q)) / hobby_arm.FPS
            runs.append(Run.from_arrays(time, columns, name=f"motion_{seed}", joints=None))
    drives = {"servo": {"joints": list(hobby_arm.JOINTS), "law": "position", "limit": "3.35 N m"}}
    return arm_model(file).with_drives(drives), runs


@pytest.fixture(scope="module")
def repaired(recorded) -> Repair:
    model, runs = recorded
    return CheckedStudy.of(model, runs[:1], runs[1:]).repair()


def test_names_and_values_are_those_that_mujoco_simulated(repaired):
    assert {effect.name for effect in repaired.model.effects} == {name.partition(".")[0] for name in hobby_arm.HIDDEN}
    for name, true in hobby_arm.HIDDEN.items():
        for joint in hobby_arm.JOINTS:
            assert repaired.model.value(f"{name}[{joint}]") == pytest.approx(true, rel=0.1)
    servo = repaired.model.drives["servo"]
    assert servo.gain.value == pytest.approx(hobby_arm.GAIN, rel=0.02)
    assert servo.delay == pytest.approx(hobby_arm.DELAY, abs=2e-3)


def test_the_report_draws_the_held_out_run_as_the_motion_was_judged(repaired):
    curves = study_overlays(repaired.study, [step.fit for step in repaired.steps])
    assert {curve.run for curve in curves} == {"motion_0", "motion_1"}
    assert repair_report(repaired.study, repaired).sections


def test_the_motion_is_as_far_off_as_the_encoder_reads_and_the_error_falls(repaired):
    encoder = 2.0 * np.pi / 4096
    assert all(e.rms < encoder for e in repaired.after.rollout)
    errors = [np.linalg.norm(list(step.held_out_rmse.values())) for step in repaired.path]
    assert errors == sorted(errors, reverse=True)


@pytest.mark.slow
@pytest.mark.parametrize("heavier", [0, 1])
def test_links_that_are_described_wrongly_get_no_name_and_leave_the_others_their_values(recorded, tmp_path, heavier):
    """Every other link is described 8 % too heavy, the rest 8 % too light, and the other way round."""
    _, runs = recorded
    file = tmp_path / "off.urdf"
    robot = ElementTree.fromstring(hobby_arm.urdf_text())
    for i, body in enumerate(robot.iter("inertial")):
        for one, names in (("mass", ["value"]), ("inertia", ["ixx", "iyy", "izz"])):
            element = body.find(one)
            for name in names:
                element.set(name, str(float(element.get(name)) * (1.08 if i % 2 == heavier else 0.92)))
    file.write_text(ElementTree.tostring(robot, encoding="unicode"))
    drives = {"servo": {"joints": list(hobby_arm.JOINTS), "law": "position", "limit": "3.35 N m"}}
    found = CheckedStudy.of(arm_model(file).with_drives(drives), runs[:1], runs[1:]).repair()
    named = found.model.without_background()
    assert {effect.name for effect in named.effects} == {name.partition(".")[0] for name in hobby_arm.HIDDEN}
    for name, true in hobby_arm.HIDDEN.items():
        for joint in hobby_arm.JOINTS:
            assert abs(named.value(f"{name}[{joint}]") - true) < 3.0 * named.parameters[f"{name}[{joint}]"].std
    assert found.verdict is Verdict.EXPLAINED
    write_model_file(tmp_path / "model.toml", ModelFile(found.model, {}))
    again = read_model_file(tmp_path / "model.toml").model
    assert again.background is not None
    assert set(again.background.named_only) == set(named.parameters)
    assert all(name.startswith("link_inertia.") for name in again.background.names)


def test_a_motion_that_runs_away_or_is_worse_than_its_commands_is_lost(repaired):
    assert repaired.verdict is not Verdict.LOST
    for wrong, word in ((None, "runs away"), (1.0, "at their commands")):
        first, *others = repaired.after.rollout
        lost = unless_lost(
            replace(repaired, after=replace(repaired.after, rollout=(replace(first, rms=wrong), *others)))
        )
        assert lost.verdict is Verdict.LOST
        assert word in lost.sentence
    of_exam = tuple(replace(e, role="exam", rms=None) for e in repaired.after.rollout)
    assert unless_lost(replace(repaired, after=replace(repaired.after, rollout=of_exam))).verdict is repaired.verdict


@pytest.mark.parametrize(("further", "most"), [((), 0.02), (("backlash",), 0.1)], ids=["smooth", "play"])
def test_derivatives_are_those_of_differences(recorded, monkeypatch, further, most):
    """With play, the moments move at which a link goes to its other side; only the play itself is compared there."""
    model, runs = recorded
    monkeypatch.setattr(motion_model, "SLOPE_STEP_SHARE", 1.0)
    adapted = model.adapted_to(runs[:1])
    for effect in ("joint_viscous_friction", "rotor_inertia", "torque_offset", "command_delay", *further):
        adapted = adapted.with_effect(find(effect))
    sizes = {"joint_viscous_friction.coefficient": 0.3, "rotor_inertia.inertia": 0.012, "command_delay.time": 0.01}
    sizes |= dict.fromkeys([f"{name}.play" for name in further], 0.01)
    values = {f"{name}[{joint}]": size for name, size in sizes.items() for joint in hobby_arm.JOINTS}
    moving = replace(MotionModel.of(adapted.with_values(values), model.drives), step=0.002)
    run, theta = moving.prepare_run(run_until(runs[0], 5.0)), moving.theta()
    found = moving.predict(run, theta)
    for i, p in enumerate(moving.parameters.values()):
        if further and p.effect not in further:
            continue
        step = 1e-4 if p.unit == "s" else 1e-3 * p.typical
        there, here = (moving.predict(run, theta + side * step * np.eye(len(theta))[i]).values for side in (1.0, -1.0))
        numeric = (there - here) / (2.0 * step)
        assert np.linalg.norm(found.sensitivities[:, i] - numeric) < most * np.linalg.norm(numeric)
