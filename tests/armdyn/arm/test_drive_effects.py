"""Effects of drives: absent at null, exact derivatives, found in arms that MuJoCo moves by laws written here."""

import ctypes
import subprocess
from collections.abc import Callable
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from derivatives import assert_jacobian

from armdyn.arm.closed_loop.rollout import simulated_position_errors
from armdyn.arm.model import ArmModel, arm_model
from armdyn.checked_study import CheckedStudy
from armdyn.codegen import find_compiler
from armdyn.effects.catalogue import CATALOGUE, find
from armdyn.run import Run
from pipeline.exports.functions import c_text, exported_functions, python_text
from pipeline.exports.mujoco_file import mujoco_text

from . import urdfs
from .conftest import total_rmse, with_effects
from .test_drives import JOINTS, commanded

mujoco = pytest.importorskip("mujoco")
GAIN, DELAY, STEP, FINE, EFFORT = 25.0, 0.02, 0.02, 5e-4, 6.0
DRIVE = [effect.name for effect in CATALOGUE.values() if effect.acts_on == "drive"]
Law = Callable[..., np.ndarray]  # ``(R, v, v_cmd, total, share of voltage, on) -> tau``, (2,) each
LAWS: dict[str, tuple[dict[str, float], Law]] = {
    "servo_gain": ({"error": 0.2}, lambda R, **_: R / 1.2),
    "servo_damping": ({"coefficient": 0.8}, lambda R, v, v_cmd, **_: R + 0.8 * (v_cmd - v)),
    "servo_integral": ({"rate": 0.7}, lambda R, total, **_: R + 0.7 * total),
    "back_emf": ({"coefficient": 0.5}, lambda R, v, on, **_: R - 0.5 * v * on),
    "supply_voltage": ({"share": 1.0}, lambda R, volts, **_: R * volts),
    "torque_limit": ({"lost": 1.0, "torque": 5.0}, lambda R, **_: np.clip(R, -5.0, 5.0)),
    "dead_band": ({"torque": 0.5}, lambda R, **_: R - np.clip(R, -0.5, 0.5)),
    "starting_duty": ({"torque": 0.4}, lambda R, **_: R + 0.4 * np.sign(R)),
}


@pytest.fixture(scope="module")
def arm(tmp_path_factory) -> ArmModel:
    file = tmp_path_factory.mktemp("arm") / "arm.urdf"
    file.write_text(urdfs.chain(urdfs.DOUBLE).replace('effort="100"', f'effort="{EFFORT}"'))
    return arm_model(file)


def with_friction(model: ArmModel) -> ArmModel:
    return with_effects(model, joint_viscous_friction__coefficient=0.6, joint_coulomb_friction__torque=0.2)


def driven(model: ArmModel, **entries: str) -> ArmModel:
    table = {"joints": list(JOINTS), "gain": f"{GAIN} N m/rad", "delay": f"{DELAY} s", **entries}
    return model.with_drives({"servo": table})


def moved(arm: ArmModel, law: Law, seed: int, late: float = DELAY, seconds: float = 20.0, rate: float = np.inf) -> Run:
    """What an arm of MuJoCo records whose motors give what a law makes of their errors.

    With a finite rate, rad/s, at which they follow what they are told, they are told steps.
    """
    model = mujoco.MjModel.from_xml_string(mujoco_text(with_friction(arm))[0])
    model.opt.timestep = FINE
    data, (time, told) = mujoco.MjData(model), commanded(seed, seconds)
    told = told if rate == np.inf else np.round(told / 0.4) * 0.4
    v_told, volts = np.gradient(told, time, axis=0), 1.0 + 0.25 * np.sin(0.9 * time)
    enabled = (np.sin(0.7 * time + seed) > -0.6).astype(float)
    data.qpos[:] = told[0]
    total, every, q, at = np.zeros(2), round(STEP / FINE), [], told[0]
    for k in range(len(time) * every):
        if k % every == 0:
            q.append(data.qpos.copy())
        i, now = max(0, int(np.floor((k * FINE - late) / STEP + 1e-6))), k // every
        v, on = data.qvel.copy(), enabled[now] if law is LAWS["back_emf"][1] else 1.0
        at = at + np.clip(told[i] - at, -rate * FINE, rate * FINE)
        R = on * GAIN * (at - data.qpos)
        data.qfrc_applied[:] = law(R, v=v, v_cmd=v_told[i], total=total, volts=volts[now], on=on)
        total = total + FINE * R
        mujoco.mj_step(model, data)
    columns = {f"q.{j}": np.round(np.array(q)[:, n] / 1e-4) * 1e-4 for n, j in enumerate(JOINTS)}
    for n, joint in enumerate(JOINTS):
        columns |= {f"q_cmd.{joint}": told[:, n], f"v_cmd.{joint}": v_told[:, n], f"voltage.{joint}": 12.0 * volts}
        columns |= {f"enabled.{joint}": enabled} if law is LAWS["back_emf"][1] else {}
    return Run.from_arrays(time, columns, name=f"seed {seed}", joints=None)


@pytest.fixture(scope="module")
def recorded(arm) -> Callable[..., Run]:
    """What this arm records, once for each law and seed."""
    return cache(partial(moved, arm))


@pytest.fixture(scope="module")
def plain(recorded) -> Run:
    return recorded(lambda R, **_: R, 3, seconds=8.0)


@pytest.mark.parametrize("name", DRIVE)
def test_an_effect_of_a_drive_is_absent_at_null_and_has_exact_derivatives(arm, plain, name):
    model = with_friction(driven(arm)).adapted_to([plain])
    more = model.with_effect(find(name))
    run = model.prepare_run(model.with_estimated_channels(plain))
    assert np.array_equal(model.predict(run, model.theta()).values, more.predict(run, more.theta()).values)
    theta = np.array(
        [p.value + 0.3 * (p.typical if p.null != p.typical else -p.typical) for p in more.parameters.values()]
    )
    columns = [more.names.index(f"{name}.{short}[{joint}]") for short in find(name).quantities for joint in JOINTS]

    def predicted(part: np.ndarray) -> np.ndarray:
        whole = theta.copy()
        whole[columns] = part
        return more.predict(run, whole).values

    steps = 1e-4 * np.array([more.parameters[more.names[i]].typical for i in columns])
    assert_jacobian(predicted, theta[columns], more.predict(run, theta).sensitivities[:, columns], steps, 2e-3)


@pytest.mark.parametrize("name", [name for name in LAWS if name != "torque_limit"])
def test_what_a_drive_does_is_found_in_recordings_and_moves_the_model_as_it_moved_the_arm(arm, recorded, name):
    truth, law = LAWS[name]
    *training, held_out = (recorded(law, seed) for seed in (1, 2, 3))
    model = driven(arm).with_effect(find("joint_viscous_friction")).with_effect(find("joint_coulomb_friction"))
    study = CheckedStudy.of(model, training, [held_out], adding=name)
    before = np.mean([r.rms for r in study.compare().rollout if r.role == "held_out"])
    found = study.add([find(name)])
    for joint in JOINTS:
        for short, value in truth.items():
            p = found.model.parameters[f"{name}.{short}[{joint}]"]
            assert abs(p.value - value) < max(0.1 * value, 3.0 * p.std), joint
            assert p.std < 0.2 * value
    after = [r.rms for r in found.after.rollout if r.role == "held_out"]
    assert np.mean(after) < 0.5 * before
    assert max(after) < (1.5e-3 if name != "back_emf" else 0.01)  # an arm falls freely while its drives are off


def test_what_is_made_of_the_reading_itself_is_named_by_repair_on_its_joints_with_its_size(arm, recorded):
    truth, law = LAWS["dead_band"]
    found = CheckedStudy.of(driven(arm), [recorded(law, seed) for seed in (1, 2)], [recorded(law, 3)]).repair()
    assert found.model_without_background.value("dead_band.torque[swing]") == pytest.approx(truth["torque"], rel=0.05)


def test_where_drives_saturate_is_found_and_only_where_they_do(arm, recorded, plain):
    limited = [recorded(LAWS["torque_limit"][1], seed) for seed in (1, 2, 3)]
    assert driven(arm).adapted_to([plain]).drives["servo"].full_at == np.inf
    found = CheckedStudy.of(driven(arm), limited[:2], limited[2:]).repair()
    assert found.model.drives["servo"].full_at == pytest.approx(LAWS["torque_limit"][0]["torque"] / GAIN, rel=0.01)
    assert max(r.rms for r in found.after.rollout if r.role == "held_out") < 1.5e-3


@pytest.mark.parametrize("name", ["dead_band", "starting_duty", "torque_limit", "servo_gain", "servo_damping"])
def test_an_exported_function_holds_what_a_drive_does(arm, name):
    truth, law = LAWS[name]
    model = driven(arm).with_effect(find(name))
    model = model.with_values({f"{name}.{short}[{joint}]": v for short, v in truth.items() for joint in JOINTS})
    scope: dict = {}
    exec(python_text(exported_functions(model)[0], ["test"]), scope)
    q, v, v_cmd = np.array([[0.01, -0.5], [-0.3, 0.0]]), np.array([[0.4, -0.2], [0.0, 1.0]]), np.array([0.1, 0.3])
    expected = law(GAIN * (0.0 - q), v=v, v_cmd=v_cmd, on=1.0)
    assert scope["servo_torque"](q, v, np.zeros(2), v_cmd) == pytest.approx(expected)


@pytest.mark.skipif(find_compiler() is None, reason="needs a C compiler")
def test_the_c_function_gives_the_torque_of_the_python_one_with_all_that_its_drives_do(arm, tmp_path):
    named = ("dead_band", "starting_duty", "torque_limit", "servo_gain", "servo_damping")
    model = driven(arm, limit="6 N m")
    for name in named:
        model = model.with_effect(find(name)).with_values(
            {f"{name}.{short}[{joint}]": v for short, v in LAWS[name][0].items() for joint in JOINTS}
        )
    functions, scope = exported_functions(model)[0], dict[str, Any]()
    exec(python_text(functions, ["test"]), scope)
    (tmp_path / "m.c").write_text(c_text(functions, ["test"]))
    subprocess.run([find_compiler(), "-O2", "-shared", "-fPIC", "m.c", "-o", "m.so", "-lm"], check=True, cwd=tmp_path)
    servo_torque, double = ctypes.CDLL(str(tmp_path / "m.so")).armdyn_servo_torque, ctypes.c_double * 2
    random = np.random.default_rng(1)
    for state in random.uniform(-1.0, 1.0, (200, 4, 2)) * [[[0.4], [2.0], [0.4], [2.0]]]:
        tau = double()
        assert servo_torque(*(double(*part) for part in state), tau) == 0
        assert [*tau] == pytest.approx(scope["servo_torque"](*state), abs=1e-12)


def test_a_command_that_is_followed_no_faster_than_the_drives_rate_is_read_and_moved_as_it_was(arm):
    run = moved(arm, lambda R, **_: R, 4, rate=1.5)
    slow, fast = (with_friction(driven(arm, **entry)) for entry in ({"rate": "1.5 rad/s"}, {}))
    assert slow.file_entries(Path())["drives"]["servo"]["rate"] == "1.5 rad/s"
    moving = [np.mean([r.rms for r in simulated_position_errors(model, [(run, "exam")])]) for model in (slow, fast)]
    assert moving[0] < 2e-3
    assert moving[1] > 10.0 * moving[0]
    left = [total_rmse(model, model.prepare_run(model.with_estimated_channels(run))) for model in (slow, fast)]
    assert left[0] < 0.1 * left[1]


def test_a_command_that_acts_later_on_one_joint_is_found_to_first_order_and_ends_whole_in_its_motion(arm):
    runs = [moved(arm, lambda R, **_: R, seed, late=DELAY + 0.006) for seed in (1, 2)]
    model = driven(arm).with_effect(find("joint_viscous_friction")).with_effect(find("joint_coulomb_friction"))
    found = CheckedStudy.of(model, runs[:1], runs[1:]).add([find("command_delay")])
    for joint in JOINTS:
        assert found.model.value(f"command_delay.time[{joint}]") == pytest.approx(0.006, abs=5e-4)
    assert max(r.rms for r in found.after.rollout) < 1.5e-3  # the encoder's step


def test_what_is_looked_for_of_a_kind_of_drives_is_no_joints_own_unless_it_is_asked_for(arm, plain):
    told, looked_for = driven(arm), arm.with_drives({"servo": {"joints": list(JOINTS), "supply": "12 V"}})
    assert looked_for.excluded_effects - told.excluded_effects == {"servo_gain", "command_delay", "supply_voltage"}
    candidates = {c.effect for c in CheckedStudy.of(looked_for, [plain]).study.candidates}
    assert "joint_coulomb_friction" in candidates
    assert not candidates & looked_for.excluded_effects
    by_hand = CheckedStudy.of(looked_for, [plain], adding="servo_gain").study.candidates
    assert "servo_gain" in {c.effect for c in by_hand}
