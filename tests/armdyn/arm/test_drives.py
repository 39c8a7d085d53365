"""Arms that record what they were told and where they went; the truth is simulated by MuJoCo, not by the product."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from worlds.servo_arm import generate

from armdyn.arm.closed_loop.rollout import encoder_step, simulated_positions, simulation_windows
from armdyn.arm.drive_gain.drive_scale import drives_with_identified_gains
from armdyn.arm.drives import chosen_drives, read_drives
from armdyn.arm.known_drives import KNOWN_DRIVES
from armdyn.arm.model import ArmModel
from armdyn.checked_study import CheckedStudy, effects_zero_in_simulation
from armdyn.effects.catalogue import find
from armdyn.errors import InputError
from armdyn.experiments.rivals import require_plannable
from armdyn.parameter import Parameter
from armdyn.recording.channels import Channel
from armdyn.run import Run
from pipeline.answers import repair_json
from pipeline.exports.functions import exported_functions, python_text
from pipeline.exports.mujoco_file import mujoco_text

from . import urdfs
from .conftest import with_effects

mujoco = pytest.importorskip("mujoco")
JOINTS = ("swing", "elbow")
GAIN, DAMPING, FRICTION, ARMATURE, DELAY, STEP = 25.0, 0.9, 0.35, 0.04, 0.02, 0.02


def joined(**entries):
    return {"servo": {"joints": list(JOINTS), **entries}}


def test_drives_of_any_kind_are_chosen_by_their_law():
    assert chosen_drives(["sts3215=all"], JOINTS)["sts3215"]["gain"] == KNOWN_DRIVES["sts3215"]["gain"]
    assert chosen_drives(["leg:velocity=elbow"], JOINTS) == {"leg": {"joints": ["elbow"], "law": "velocity"}}
    # The gain of a known kind has the unit of its own law.
    assert chosen_drives(["sts3215:velocity=elbow"], JOINTS)["sts3215"] == {"joints": ["elbow"], "law": "velocity"}


@pytest.mark.parametrize("kind", KNOWN_DRIVES)
def test_a_known_kind_has_settings_that_a_model_file_takes(kind):
    (servo,) = read_drives(chosen_drives([f"{kind}=all"], JOINTS), dict.fromkeys(JOINTS, False)).values()
    assert servo.joints == JOINTS
    # A known gain saturates before the joint has turned once: else its unit, or P, is wrong.
    assert servo.gain is None or 0.05 < servo.saturating < 2 * np.pi


def test_the_known_gains_are_those_that_were_measured():
    """P e V k_t/R of Rhoban's BAM, and stall torques of Robotis' manuals, which differ by a quarter at most."""
    measured = {
        "mx106": (32 * 0.158, 12.0 * 2.1914 / 2.9650, 8.4),
        "mx64": (32 * 0.158, 12.0 * 1.6225 / 3.9494, 6.0),
        "xl330-m288": (400 * 4096 / (2 * np.pi * 256 * 885), 5.0 * 0.38670 / 4.0171, 0.52),
    }
    for kind, (share, torque, stall) in measured.items():
        servo = read_drives(chosen_drives([f"{kind}=elbow"], JOINTS), dict.fromkeys(JOINTS, False))[kind]
        assert servo.gain.value == pytest.approx(share * torque, rel=0.02)
        assert servo.limit == stall
        assert servo.limit == pytest.approx(torque, rel=0.25)


@pytest.mark.parametrize("text", ["leg=all", "leg:speed=all", "sts3215", "=all", "sts3215="])
def test_drives_that_cannot_be_chosen_are_one_line(complains, text):
    with complains(InputError):
        chosen_drives([text], JOINTS)


@pytest.fixture(scope="module")
def arm(tmp_path_factory) -> ArmModel:
    return urdfs.arm(tmp_path_factory.mktemp("arm"), urdfs.DOUBLE)


def commanded(seed: int, seconds: float = 25.0) -> tuple[np.ndarray, np.ndarray]:
    """Stamps and commands of both joints: sines and rests, 50 a second."""
    random, time = np.random.default_rng(seed), np.arange(0.0, seconds, STEP)
    sizes, rates, phases = (random.uniform(*r, (2, 4)) for r in ((0.1, 0.35), (0.1, 0.9), (0.0, 6.3)))
    waves = sizes[..., None] * np.sin(2 * np.pi * rates[..., None] * time + phases[..., None])
    return time, np.add(waves.sum(axis=1).T, [0.6, -0.4])


def simulated(text: str, seed: int, delay: float) -> Run:
    """The run of a servo arm that MuJoCo simulates at 5 kHz, its encoder in steps of 1.5 mrad."""
    spec = mujoco.MjSpec.from_string(text)
    spec.option.timestep = 2e-4
    model = spec.compile()
    data, (time, told) = mujoco.MjData(model), commanded(seed)
    data.qpos[:] = told[0]
    positions, every = [], round(STEP / 2e-4)
    for k in range(len(time) * every):
        if k % every == 0:
            positions.append(data.qpos.copy())
        late = max(0, int(np.floor((k * 2e-4 - delay) / STEP + 1e-6)))
        data.ctrl[:] = told[late]
        mujoco.mj_step(model, data)
    q = np.round(np.array(positions) / 1.5e-3) * 1.5e-3
    columns = {f"q.{j}": q[:, i] for i, j in enumerate(JOINTS)} | {
        f"q_cmd.{j}": told[:, i] for i, j in enumerate(JOINTS)
    }
    return Run.from_arrays(time, columns, name=f"seed {seed}", joints=None)


def true_model(arm: ArmModel) -> ArmModel:
    frictions = {"joint_viscous_friction__coefficient": DAMPING, "joint_coulomb_friction__torque": FRICTION}
    return with_effects(arm.with_drives(joined(gain=f"{GAIN} N m/rad")), **frictions, rotor_inertia__inertia=ARMATURE)


@pytest.fixture(scope="module")
def runs(arm) -> list[Run]:
    text, _ = mujoco_text(true_model(arm))
    return [simulated(text, seed, DELAY) for seed in (1, 2, 3)]


def test_a_servo_of_unknown_gain_is_told_with_its_delay_and_its_frictions_from_commands_and_positions(arm, runs):
    model = arm.with_drives(joined())
    wanted = [find(name) for name in ("joint_viscous_friction", "joint_coulomb_friction", "rotor_inertia")]
    found = CheckedStudy.of(model, runs[:2], runs[2:]).add(wanted)
    servo = found.model.drives["servo"]
    assert servo.gain.value == pytest.approx(GAIN, rel=0.03)
    assert servo.delay == pytest.approx(DELAY, abs=0.004)
    for joint in JOINTS:
        assert found.model.value(f"joint_viscous_friction.coefficient[{joint}]") == pytest.approx(DAMPING, rel=0.15)
        assert found.model.value(f"joint_coulomb_friction.torque[{joint}]") == pytest.approx(FRICTION, rel=0.1)
    held_out = [r for r in found.after.rollout if r.role == "held_out"]
    assert {r.kind for r in held_out} == {"closed_loop"}
    assert all(r.rms < 1.5e-3 for r in held_out)
    assert all(r.rms < 0.1 * r.position_is_command[0] for r in held_out)


def test_the_exported_servo_moves_in_mujoco_as_in_the_model(arm):
    model = true_model(arm).with_effect(find("back_emf")).with_effect(find("torque_offset"))
    model = model.with_values(
        {f"{n}[{j}]": 0.3 for j in JOINTS for n in ("back_emf.coefficient", "torque_offset.torque")}
    )
    run = simulated(mujoco_text(model)[0], 7, 0.0)
    (window,) = simulation_windows(run, model.arm.joints, np.inf)
    assert np.sqrt(np.mean((simulated_positions(model, model.theta(), window) - window.q) ** 2)) < 1.2e-3


def test_the_exported_python_function_holds_the_servos_law(arm):
    drives = {
        "lift": {"joints": ["swing"], "gain": "20 N m/rad", "damping": "0.5 N m s/rad", "limit": "4 N m"},
        "turn": {"joints": ["elbow"], "law": "velocity", "gain": "3 N m s/rad"},
    }
    model = arm.with_drives(drives).with_effect(find("torque_offset:swing"))
    model = model.with_values({"torque_offset.torque[swing]": 0.7})
    scope: dict = {}
    exec(python_text(exported_functions(model)[0], ["test"]), scope)
    q, v, q_cmd, v_cmd = (
        np.array([[0.1, 0.2], [0.0, 1.0]]),
        np.array([[0.3, -0.2], [0.0, 0.5]]),
        np.zeros(2),
        np.ones(2),
    )
    found = scope["servo_torque"](q, v, q_cmd, v_cmd)
    assert found[:, 0] == pytest.approx([20 * -0.1 + 0.5 * 0.7 - 0.7, 0.5 - 0.7])
    assert found[:, 1] == pytest.approx([3 * 1.2, 3 * 0.5])
    assert scope["servo_torque"](q[0], v[0], [9.0, 0.0], v_cmd)[0] == pytest.approx(4.0 - 0.7)


def test_a_gain_that_nothing_tells_leaves_ratios_to_it_and_says_what_to_record(tmp_path, runs, complains):
    upright = [(name, kind, "0 0 1", place) for name, kind, _, place in urdfs.DOUBLE]  # no gravity about these axes
    flat = urdfs.arm(tmp_path, upright).with_drives(joined())
    study = CheckedStudy.of(flat, runs[:2], runs[2:], trusted=True)
    found = study.add([find("joint_viscous_friction")])
    servo = found.model.drives["servo"]
    assert not servo.determined
    (said,) = [text for text in found.after.left_out if "ratios to k_p" in text]
    assert "a known load" in said
    assert "--for torque_gain:swing,elbow" in said
    ratios = next(table.values for table in found.document().tables if table.name == "ratios")
    value = found.model.value("joint_viscous_friction.coefficient[elbow]")
    assert ratios["value"][1] == pytest.approx(value / servo.gain.value)
    assert ratios["unit"][1] == "N m s/rad per N m/rad"
    answer = repair_json(found)["drives"]["servo"]
    assert answer["gain"]["unit"] == "N m/rad"
    assert answer["determined"] is False
    with complains(InputError):
        require_plannable(study.study)


def test_a_load_that_nobody_wrote_down_is_counted_in_what_is_told_of_a_gain(arm):
    """It passes for a gain: of a chain of two joints no motion tells one from the other."""
    carrying = true_model(arm).with_effect(find("payload"))
    carrying = carrying.with_values({"payload.mass[elbow]": 0.5, "payload.x[elbow]": 0.2})
    loaded = [simulated(mujoco_text(carrying)[0], seed, DELAY) for seed in (1, 2)]
    servo = drives_with_identified_gains(arm.with_drives(joined()).drives, arm.arm, loaded)["servo"]
    assert GAIN - servo.gain.value > 10.0 * servo.unloaded
    assert abs(GAIN - servo.gain.value) < 2.0 * servo.gain.std
    assert servo.determined


@pytest.mark.parametrize("seed", [7, 13])
def test_gains_of_generated_arms_are_within_what_is_told_of_them_also_where_something_is_carried(seed):
    made = generate(seed)
    for name, servo in drives_with_identified_gains(made.known.drives, made.known.arm, made.runs[:-1]).items():
        true = made.truth.drives[name].gain.value
        assert abs(servo.gain.value - true) < 2.5 * servo.gain.std
        assert servo.gain.std < (0.08 if servo.determined else 0.6) * true
        assert servo.determined or (seed, name) == (13, "shoulder")


def test_a_command_holds_until_the_next_stamp():
    told = Channel(np.array([0.0, 1.0, 2.0]), np.array([1.0, 5.0, 2.0]), "rad")
    assert told.zero_order_hold_values(np.array([-1.0, 0.0, 0.99, 1.0, 1.99, 9.0])).tolist() == [
        1.0,
        1.0,
        1.0,
        5.0,
        5.0,
        2.0,
    ]
    assert told.mean_zero_order_hold_values(np.array([-1.0, 0.5, 1.5, 3.0])).tolist() == pytest.approx([1.0, 3.0, 3.0])


@pytest.mark.parametrize(
    "entries",
    [
        {"joints": ["nose"]}, {"law": "wishes"}, {"gain": "8.9 N"}, {"gain": "-1 N m/rad"}, {"limit": "0 N m"},
    ],
)  # fmt: skip
def test_a_drive_that_cannot_be_is_refused_by_its_table_and_entry(arm, entries, complains):
    with complains(InputError):
        arm.with_drives(joined(**entries))


def test_the_step_of_an_encoder_shows_also_where_its_values_were_rounded_in_degrees():
    step, time = 2.0 * np.pi / 4096, np.linspace(0.0, 20.0, 2001)
    q = np.round(np.sin(time) / step) * step
    assert encoder_step(q) == pytest.approx(step)
    assert encoder_step(np.deg2rad(np.rad2deg(q).round(4))) == pytest.approx(step, rel=2e-3)
    assert encoder_step(np.sin(time)) == 0.0
    assert encoder_step(np.zeros(100)) == 0.0


@pytest.mark.parametrize(("value", "std", "absent"), [(0.0017, 0.0008, True), (0.12, 0.003, False), (0.0, None, True)])
def test_an_effect_must_be_as_sure_by_the_motion_as_by_evidence(value, std, absent):
    name = "dead_band.torque[pan]"
    parameter = Parameter(name, "N m", value, 0.1, std=std, null=0.0, effect="dead_band", joint="pan")
    other = replace(parameter, name="given.torque[pan]", effect="given", value=0.0, std=1.0)
    model = SimpleNamespace(parameters={p.name: p for p in (parameter, other)})
    found = SimpleNamespace(path=[SimpleNamespace(added=()), SimpleNamespace(added=("dead_band",))], model=model)
    assert effects_zero_in_simulation(found) == (frozenset({"dead_band"}) if absent else frozenset())
