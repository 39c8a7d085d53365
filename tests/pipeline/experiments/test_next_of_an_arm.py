"""`armdyn next` for an arm with a force/torque sensor; MuJoCo's sensors say whether what it promises is kept."""

import json
from dataclasses import replace

import numpy as np
import pytest
from worlds import tools
from worlds.mujoco_plant import Path

from armdyn.checked_study import CheckedStudy
from armdyn.estimation.posterior import posterior_covariance
from armdyn.experiments.recorded import question_of_study
from armdyn.identify.diagnose import diagnose
from armdyn.model_file import ModelFile, write_model_file
from armdyn.run import Run, read_run, write_run_csv

OFFSETS = dict(zip(tools.AXES, (2.0, -3.0, 4.0, 0.1, -0.2, 0.3), strict=True))
TOOL = tools.Tool(1.3, np.array([0.02, -0.03, 0.12]), np.diag([0.01, 0.008, 0.004]) + 0.001, {"wrench_offset": OFFSETS})
BEGIN, MOVING = np.array([0.0, -1.2, 1.0, -1.0, -1.3, 0.3]), np.array([0.3, 0.3, 0.0, 0.0, 0.1, 0.0])


def recorded(tool, seed, time, q, v, a):
    """A wrench as MuJoCo's sensors read it, with noise, and positions."""
    rng = np.random.default_rng([seed, 60])
    _, wrench, axes = tools.measured(tool, q, v, a)
    noise = np.repeat([tools.FORCE_NOISE, tools.TORQUE_NOISE], 3) * rng.standard_normal(wrench.shape)
    read = tools.faulty(tool, time, wrench, axes) + noise
    values = {"q": q + tools.POSITION_NOISE * rng.standard_normal(q.shape)}
    values |= {f"{axis}.{tools.SENSOR}": read[:, i] for i, axis in enumerate(tools.AXES)}
    return Run.from_arrays(time, values, joints=tools.robot().joint_names, name=f"run {seed}")


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """A model and a recording in which the wrist hardly turns."""
    folder, time = tmp_path_factory.mktemp("arm"), np.arange(0.0, 20.0, 0.02)
    q, v, a = Path.drawn(np.random.default_rng(41), tools.robot(), tools.SLOW, 20.0).at(time)
    run = recorded(TOOL, 0, time, BEGIN + MOVING * (q - q[0]), MOVING * v, MOVING * a)
    write_run_csv(run, folder / "run.csv")
    write_model_file(folder / "arm.toml", ModelFile(tools.sensed_model(), {}))
    return folder


def answer(armdyn, *words):
    status, out, err = armdyn("next", *words, "--seconds", 8, "--output", "next.csv", "--json", "-")
    assert status in (0, None), err
    return json.loads(out), read_run("next.csv")


def along(tool, motion, seed):
    names = tools.robot().joint_names
    q, v, a = (np.column_stack([motion.channels[f"{kind}.{name}"].value for name in names]) for kind in "qva")
    return recorded(tool, seed, motion.channels[f"q.{names[0]}"].time, q, v, a)


def test_recordings_so_far_count_as_in_a_fit_to_their_noise_and_joints_without_torques_do_not(files):
    study = CheckedStudy.of(tools.sensed_model(), [read_run(files / "run.csv")]).study
    asked = question_of_study(study)
    columns, wanted = asked.goal.columns, asked.goal.wanted
    assert {columns.unknowns[i].effect for i in wanted} == {"payload_inertia", "wrench_offset"}
    assert not np.isfinite(columns.noise[:6]).any()
    assert np.isfinite(columns.noise[6:]).all()
    std = np.sqrt(np.diag(posterior_covariance(columns.information_of_earlier_runs, columns.prior))) * columns.typical
    fit = replace(diagnose(study).search.last.fit, weighted=None)
    fitted = dict(zip([c.name for c in fit.problem.columns], np.sqrt(np.diag(fit.posterior_covariance)), strict=True))
    for one, p in zip(std, columns.unknowns, strict=True):
        assert one == pytest.approx(fitted[p.name], rel=0.2), p.name


@pytest.mark.slow
def test_a_motion_tells_the_tool_as_well_as_it_promises(armdyn, files, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    found, motion = answer(armdyn, files / "arm.toml", files / "run.csv")
    assert found["verdict"] == "effect_missing"
    (experiment,) = found["experiments"]
    promised = {one["name"]: one["std"] for one in experiment["determines"]}
    assert any(name.startswith("payload_inertia") for name in promised)
    runs = [read_run(files / "run.csv"), along(TOOL, motion, 1)]
    values = CheckedStudy.of(tools.sensed_model(), runs).repair().model.parameters
    second = np.trace(TOOL.inertia) / 2 * np.eye(3) - TOOL.inertia
    places = {"xx": (0, 0), "yy": (1, 1), "zz": (2, 2), "xy": (0, 1), "xz": (0, 2), "yz": (1, 2)}
    joint = tools.robot().joint_names[-1]
    truth = {f"payload_inertia.{name}[{joint}]": second[place] for name, place in places.items()}
    truth |= {f"wrench_offset.{axis}[{tools.SENSOR}]": value for axis, value in OFFSETS.items()}
    assert promised.keys() == truth.keys()
    for name, true in truth.items():
        assert values[name].std == pytest.approx(promised[name], rel=0.3)
        assert abs(values[name].value - true) < 4.0 * values[name].std


@pytest.mark.slow
def test_rivals_of_a_sensor_are_told_apart_by_the_motion_as_promised(armdyn, files, tmp_path, monkeypatch):
    """If the offsets drift instead, a refit of constant ones leaves at least what is promised of typical drifts."""
    monkeypatch.chdir(tmp_path)
    found, motion = answer(armdyn, files / "arm.toml", files / "run.csv", "--rivals", "wrench_drift,wrench_rotation")
    assert found["rivals"] == ["wrench_drift", "wrench_rotation"]
    (experiment,) = found["experiments"]
    assert experiment["probability"] > 0.9
    turned = replace(TOOL, faults={"wrench_rotation": {"roll": 0.05, "pitch": 0.0, "yaw": 0.0}, **TOOL.faults})
    time = np.arange(0.0, 20.0, 0.02)
    q, v, a = Path.drawn(np.random.default_rng(41), tools.robot(), tools.SLOW, 20.0).at(time)
    runs = [recorded(turned, 0, time, BEGIN + MOVING * (q - q[0]), MOVING * v, MOVING * a), along(turned, motion, 1)]
    names = {effect.name for effect in CheckedStudy.of(tools.sensed_model(), runs).repair().model.named_effects}
    assert "wrench_rotation" in names
    assert "wrench_drift" not in names


def test_what_a_gripper_is_limited_by_is_refused_for_an_arm(armdyn, files):
    status, _, err = armdyn("next", files / "arm.toml", files / "run.csv", "--travel", 0.3, "--speed", 0.5,
                            "--acceleration", 1.0)  # fmt: skip
    assert status == 2
    assert "gripper" in err
