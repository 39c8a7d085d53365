"""Servo arms with a force/torque sensor: the motion and the wrench are explained by one model. Truth is MuJoCo's."""

from dataclasses import replace

import numpy as np
import pytest
from worlds import servo_tools
from worlds.tools import AXES, SENSOR, Tool

from armdyn.arm.closed_loop.motion_model import MotionModel
from armdyn.checked_study import CheckedStudy
from armdyn.effects.catalogue import CATALOGUE
from armdyn.identify.prepare import prepare_runs
from armdyn.identify.repair import Repair
from armdyn.model_file import ModelFile, read_model, write_model_file
from tests.derivatives import assert_jacobian

FAULTS = {
    "wrench_gain": dict(zip(AXES, (0.05, 0.07, -0.02, 0.03, -0.04, 0.06), strict=True)),
    "wrench_offset": dict(zip(AXES, (2.0, -3.0, 1.5, 0.1, -0.2, 0.15), strict=True)),
}
TOOL = Tool(0.9, np.array([0.03, -0.02, 0.1]), np.diag([0.004, 0.003, 0.002]) + 5e-4, FAULTS)
TRIED = (
    "joint_viscous_friction", "joint_coulomb_friction", "joint_load_friction", "rotor_inertia", "payload",
    "payload_inertia", "wrench_rotation", "wrench_offset", "wrench_gain", "cable_pull",
)  # fmt: skip


@pytest.fixture(scope="module")
def arm():
    return servo_tools.generate(3, tool=TOOL, count=4, seconds=(6.0, 6.0))


@pytest.fixture(scope="module")
def model(arm, tmp_path_factory):
    return arm.model(tmp_path_factory.mktemp("arm"))


@pytest.fixture(scope="module")
def repaired(arm, model) -> Repair:
    return CheckedStudy.of(model, arm.runs[:1], arm.runs[1:], effects=[CATALOGUE[n] for n in TRIED]).repair()


def values_of_tool(model):
    second = np.trace(TOOL.inertia) / 2 * np.eye(3) - TOOL.inertia
    places = {"xx": (0, 0), "yy": (1, 1), "zz": (2, 2), "xy": (0, 1), "xz": (0, 2), "yz": (1, 2)}
    found = {"payload.mass": TOOL.mass} | dict(zip(("payload.x", "payload.y", "payload.z"), TOOL.centre, strict=True))
    found |= {f"payload_inertia.{name}": second[place] for name, place in places.items()}
    return {f"{name}[{model.joints[-1]}]": value for name, value in found.items()}


def test_a_wrench_is_predicted_beside_the_motion_with_exact_derivatives(arm, model):
    for name in ("payload", "payload_inertia", *FAULTS):
        model = model.with_effect(CATALOGUE[name])
    values = values_of_tool(model) | {f"{e}.{n}[{SENSOR}]": x for e, own in FAULTS.items() for n, x in own.items()}
    model = model.with_values(values).adapted_to(arm.runs)
    moved = MotionModel.of(model, model.drives)
    run = moved.prepare_run(arm.runs[0])
    found, wrenches = moved.predict(run, moved.theta()), model.sensors[SENSOR].channels
    assert found.channels == (*(f"q.{joint}" for joint in model.joints), *wrenches)
    rows = np.concatenate([np.arange(len(found.time))[found.slices[name]] for name in wrenches])
    measured = np.concatenate([run.channels[name].value for name in wrenches])
    noise = np.concatenate([np.full(len(run.channels[name]), run.noise[name]) for name in wrenches])
    assert np.sqrt(np.mean(((measured - found.values[rows]) / noise) ** 2)) < 1.5

    def wrench(theta):
        predicted = moved.predict_values(run, theta)
        return np.concatenate([predicted[name] for name in wrenches])

    assert_jacobian(wrench, moved.theta(), found.sensitivities[rows], 1e-4)


def test_one_fit_names_what_motion_and_wrench_show(arm, repaired):
    model, joint = repaired.model, arm.joints[-1]
    friction = {"joint_viscous_friction.coefficient": arm.viscous, "joint_coulomb_friction.torque": arm.dry}
    hidden = {name.partition(".")[0] for name in friction} | {"payload", *FAULTS}
    assert {effect.name for effect in model.named_effects} - {"payload_inertia"} == hidden
    for name, values in friction.items():
        found = [model.value(f"{name}[{own}]") for own in arm.joints]
        assert found == pytest.approx(values, rel=0.05, abs=0.05)
    assert model.value(f"payload.mass[{joint}]") == pytest.approx(TOOL.mass, rel=0.01)
    assert [model.value(f"payload.{axis}[{joint}]") for axis in "xyz"] == pytest.approx(TOOL.centre, abs=2e-3)
    for effect, own in FAULTS.items():
        for name, true in own.items():
            p = model.parameters[f"{effect}.{name}[{SENSOR}]"]
            assert abs(p.value - true) < 4.0 * p.std


def test_the_gain_that_all_axes_share_is_no_question_where_the_motion_tells_the_mass(repaired):
    assert not any("all its axes share" in text for text in repaired.after.left_out)


def test_the_answer_reads_as_it_was_fitted(repaired, tmp_path):
    write_model_file(tmp_path / "m.toml", ModelFile(repaired.model, {}))
    saved, run = read_model(tmp_path / "m.toml"), repaired.steps[-1].fit.problem.runs[0]
    predicted = saved.predict_values(run, saved.theta())
    for block in repaired.steps[-1].fit.blocks:
        if block.channel in predicted:
            assert predicted[block.channel] == pytest.approx(block.predicted, abs=1e-3 * block.noise)


def test_effects_that_are_added_keep_what_the_wrench_tells_of_the_tool(arm, model):
    named = ("joint_viscous_friction", "joint_coulomb_friction", "payload", "payload_inertia", *FAULTS)
    wanted = [CATALOGUE[name] for name in named]
    found = CheckedStudy.of(model, arm.runs[:1], effects=wanted).add(wanted)
    run = found.study.runs[0]
    for channel, values in found.model.predict_values(run, found.model.theta()).items():
        if channel in model.sensors[SENSOR].channels:
            assert np.sqrt(np.mean((values - run.channels[channel].value) ** 2)) < 2.0 * run.noise[channel]


def test_a_wrench_that_is_not_used_is_said(arm, model):
    without = replace(model, sensors={})
    assert any("write [wrench.ft]" in text for text in CheckedStudy.of(without, arm.runs[:1]).compare().left_out)
    blind = replace(arm.runs[0], channels={n: c for n, c in arm.runs[0].channels.items() if not n.endswith(SENSOR)})
    said = CheckedStudy.of(model, [blind], arm.runs[1:]).compare().left_out
    assert any("no fitted recording contains it" in text for text in said)
    assert not any("is not used" in text for text in CheckedStudy.of(model, arm.runs[:1]).compare().left_out)


def test_runs_of_which_some_lack_the_wrench_are_prepared(arm, model):
    blind = replace(arm.runs[0], channels={n: c for n, c in arm.runs[0].channels.items() if not n.endswith(SENSOR)})
    moved = MotionModel.of(model.adapted_to(arm.runs), model.drives)
    runs, held_out, _ = prepare_runs(moved, [blind], arm.runs[1:])
    assert not any(name.endswith(SENSOR) for run in (*runs, *held_out) for name in moved.predicted_channels(run))
    assert list(moved.predict_values(held_out[0], moved.theta())) == [f"q.{joint}" for joint in arm.joints]
