"""What an exported model lacks is said in N m, and stops the export where it is much."""

import json

import numpy as np
import pytest
from hidden_effects.arm import generate

from armdyn.arm.model import arm_model
from armdyn.effects.catalogue import CATALOGUE
from armdyn.identify.study import Study
from armdyn.model_file import ModelFile, base_pendulum, read_model_file, write_model_file
from pipeline.exports.left_out import left_out

OFFSET = "torque_offset"


def repaired(file, offset):
    """A model file with an offset and a spring, as a repair leaves it."""
    model = arm_model(robot="ur5").with_effect(CATALOGUE["joint_spring"]).with_effect(CATALOGUE[OFFSET])
    joint = f"tau.{model.joints[1]}"
    history = (
        {"added": "joint_spring", "rmse": {joint: 1.0}, "contribution": {joint: 9.0}, "as_given_rmse": {joint: 10.0}},
        {"added": OFFSET, "rmse": {joint: 0.1}, "contribution": {joint: offset}},
    )
    write_model_file(file, ModelFile(model, {"robot": "ur5", "joints": list(model.joints)}, history))
    return joint


@pytest.mark.parametrize(("offset", "status"), [(0.4, 0), (0.6, 1)])
def test_more_than_a_twentieth_of_what_the_repair_removed_is_not_left_out_without_asking(
    tmp_path, armdyn, offset, status
):
    exported, answer = tmp_path / "m.xml", tmp_path / "a.json"
    joint = repaired(tmp_path / "m.toml", offset)
    asked = ("export", str(tmp_path / "m.toml"), "--output", str(exported))
    assert armdyn(*asked, "--json", str(answer))[0] == status
    assert exported.exists() is (status == 0)
    said = json.loads(answer.read_text())
    assert said["error"] == {joint: offset}
    assert said["share_of_removed_error"] == pytest.approx(offset / 10.0, rel=1e-2)
    again, out, _ = armdyn(*asked, "--force")
    assert again == 0
    assert exported.exists()
    assert f"{offset:g} N m on {joint[4:]}" in out


def test_a_file_that_holds_everything_leaves_nothing_out(tmp_path):
    repaired(tmp_path / "m.toml", 5.0)
    file = read_model_file(tmp_path / "m.toml")
    assert left_out(file, {"joint_spring", OFFSET}) is None
    assert left_out(file, {OFFSET}).total == pytest.approx(9.0)


def test_what_an_offset_does_is_the_offset():
    baxter = arm_model(
        robot="baxter", joints=["right_s0", "right_s1", "right_e0", "right_e1", "right_w0", "right_w1", "right_w2"]
    )
    study = Study(baxter.with_effect(CATALOGUE[OFFSET]), [generate(OFFSET, 1.0, 3)], [], [])
    fit = study.first()
    for channel, value in fit.contribution([OFFSET]).items():
        offset = fit.values[list(fit.problem.of([f"{OFFSET}.torque[{channel[4:]}]"])).index(True)]
        assert value == pytest.approx(abs(offset), rel=1e-6)
        assert np.isfinite(value)


def test_a_pendulums_functions_owe_nothing_to_its_sensors(tmp_path, armdyn):
    model = base_pendulum().with_effect(CATALOGUE["sensor_bias"])
    entry = {
        "added": "sensor_bias",
        "rmse": {},
        "contribution": {"load_force": 1.0},
        "as_given_rmse": {"load_force": 1.0},
    }
    write_model_file(tmp_path / "p.toml", ModelFile(model, {}, (entry,)))
    status, out, _ = armdyn("export", "p.toml", "--output", "p.py")
    assert status == 0
    assert "sensor_bias" in out
