"""The wrench on a force/torque sensor against MuJoCo's sensors, its derivatives, and its declaration."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

import armdyn
from armdyn.arm.bodies import MotionSamples
from armdyn.arm.motion import Motion
from armdyn.arm.wrench.prediction import CutMotionSamples
from armdyn.arm.wrench.sensor import chosen_sensors, cut_at_sensor
from armdyn.arm.wrench.symbolic import sensor_reading
from armdyn.checked_study import CheckedStudy
from armdyn.effects.catalogue import CATALOGUE, find
from armdyn.errors import InputError
from armdyn.identify.sentence import Verdict
from armdyn.model_file import ModelFile, read_model, write_model_file
from armdyn.run import Run, read_run, write_run_csv
from pipeline.exports.load_commands import load_command
from tests.derivatives import assert_jacobian
from tests.worlds.mujoco_plant import Path
from tests.worlds.tools import (
    AXES,
    LINK,
    SENSOR,
    SLOW,
    Tool,
    description,
    drawn,
    faulty,
    measured,
    recorded,
    robot,
    sensed_model,
)

TOOL = Tool(1.3, np.array([0.02, -0.03, 0.12]), np.diag([0.01, 0.008, 0.004]) + 0.001)
ON_SENSOR = [effect for effect in CATALOGUE.values() if effect.acts_on == "wrench"]
FAULTS = {
    "cable_pull": {"x": 3.0, "y": -2.0, "z": 1.0, "at_x": 0.02, "at_y": 0.1, "at_z": -0.05},
    "wrench_rotation": {"roll": 0.2, "pitch": -0.1, "yaw": 0.3},
    "wrench_crosstalk": {"fx_fz": 0.03, "ty_fz": 0.004},
    "wrench_gain": dict(zip(AXES, (0.02, -0.03, 0.04, -0.05, 0.06, 0.03), strict=True)),
    "wrench_offset": dict(zip(AXES, (1.0, -2.0, 3.0, 0.1, -0.2, 0.3), strict=True)),
    "wrench_drift": dict(zip(AXES, (0.1, -0.2, 0.3, 0.01, -0.02, 0.03), strict=True)),
}


@pytest.fixture(scope="module")
def moved():
    time = np.arange(0.0, 4.0, 0.01)
    return time, Path.drawn(np.random.default_rng(0), robot(), SLOW, 4.0).at(time)


@pytest.fixture(scope="module")
def recording(moved):
    return measured(TOOL, *moved[1])


def as_run(moved, torque, wrench):
    time, (q, v, a) = moved
    values = {"q": q, "v": v, "a": a, "tau": torque} | {f"{axis}.ft": wrench[:, i] for i, axis in enumerate(AXES)}
    return Run.from_arrays(time, values, joints=robot().joint_names)


def with_tool(model):
    """The model with the tool as a payload, which MuJoCo's arm carries."""
    values = {f"payload.{axis}": x for axis, x in zip("xyz", TOOL.centre, strict=True)} | {"payload.mass": TOOL.mass}
    places = {"xx": (0, 0), "yy": (1, 1), "zz": (2, 2), "xy": (0, 1), "xz": (0, 2), "yz": (1, 2)}
    second = np.trace(TOOL.inertia) / 2 * np.eye(3) - TOOL.inertia
    values |= {f"payload_inertia.{name}": second[place] for name, place in places.items()}
    model = model.with_effect(find("payload")).with_effect(find("payload_inertia"))
    return model.with_values({f"{name}[{model.joints[-1]}]": value for name, value in values.items()})


def test_wrench_of_a_described_tool_is_that_of_mujoco(moved, recording, tmp_path):
    (tmp_path / "arm.urdf").write_text(description(TOOL), encoding="utf-8")
    time, (q, v, a) = moved
    model = sensed_model(tmp_path / "arm.urdf")
    motion = MotionSamples(model.arm.model, Motion(time, q, v, a, np.sign(v)), time)
    stretch = CutMotionSamples.of(cut_at_sensor(model.arm, model.sensors[SENSOR]), motion)
    assert stretch.described[:, stretch.cut.axes] == pytest.approx(recording[1], abs=1e-7)
    assert motion.described == pytest.approx(recording[0], abs=1e-7)


def test_one_payload_makes_torques_and_wrench(moved, recording):
    torque, wrench, _ = recording
    model, run = with_tool(sensed_model()), as_run(moved, torque, wrench)
    for name, predicted in model.predict_values(run, model.theta()).items():
        error = (predicted - run.channels[name].value)[20:-20]
        assert np.sqrt(np.mean(error**2)) < 1e-3 * np.ptp(run.channels[name].value), name


def test_a_sensor_may_read_along_the_axes_of_the_base(moved, recording):
    torque, wrench, axes = recording
    turned = np.hstack([np.einsum("nij,nj->ni", axes, part) for part in (wrench[:, :3], wrench[:, 3:])])
    model, run = with_tool(sensed_model(axes="base")), as_run(moved, torque, turned)
    for name, predicted in model.predict_values(run, model.theta()).items():
        error = (predicted - run.channels[name].value)[20:-20]
        assert np.sqrt(np.mean(error**2)) < 1e-3 * np.ptp(run.channels[name].value) + 1e-3, name


def test_a_link_beside_the_sensor_makes_no_wrench(moved, recording):
    model = sensed_model().with_effect(find("link_inertia:wrist_3_joint"))
    sensitivities = model.predict(as_run(moved, *recording[:2]), model.theta())
    assert not sensitivities.sensitivities[sensitivities.slices["fx.ft"]].any()


def test_a_sensor_below_the_arm_carries_all_of_it(moved):
    """Forces on the base are the weight and the inertial forces of all links: its sum is that of Newton's law."""
    time, (q, v, a) = moved
    model = sensed_model(link="base_link", xyz=[0, 0, 0], rpy=[0, 0, 0])
    cut = cut_at_sensor(model.arm, model.sensors[SENSOR])
    still = Motion(time[:1], q[:1], 0 * v[:1], 0 * a[:1], 0 * v[:1])
    stretch = CutMotionSamples.of(cut, MotionSamples(model.arm.model, still, time[:1]))
    weight = sum(inertia.mass for inertia in list(cut.model.inertias)[cut.tool + 1 :]) * 9.81
    assert np.linalg.norm(stretch.described[0, list(cut.axes[:3])]) == pytest.approx(weight)
    assert cut.host == -1


@pytest.mark.parametrize("effect", FAULTS)
def test_an_effect_reads_as_its_equation_says(effect, moved, recording):
    torque, wrench, axes = recording
    time = moved[0]
    model = with_tool(sensed_model()).with_effect(find(effect))
    model = model.with_values({f"{effect}.{name}[{SENSOR}]": value for name, value in FAULTS[effect].items()})
    read = faulty(replace(TOOL, faults={effect: FAULTS[effect]}), time, wrench, axes)
    run = as_run(moved, torque, read)
    for name, predicted in model.predict_values(run, model.theta()).items():
        error = (predicted - run.channels[name].value)[20:-20]
        assert np.sqrt(np.mean(error**2)) < 1e-3 * np.ptp(run.channels[name].value), name


def test_effects_act_in_their_own_order_and_not_in_that_in_which_they_were_added(moved, recording):
    run = as_run(moved, *recording[:2])
    values = {f"{effect}.{name}[{SENSOR}]": x for effect, own in FAULTS.items() for name, x in own.items()}
    read = []
    for names in (list(FAULTS), list(FAULTS)[::-1]):
        model = with_tool(sensed_model())
        for name in names:
            model = model.with_effect(find(name))
        model = model.with_values(values)
        read.append(model.predict_values(run, model.theta()))
    for name, predicted in read[0].items():
        assert read[1][name] == pytest.approx(predicted)


@pytest.mark.parametrize("prepared", [False, True])
def test_derivatives_of_a_wrench_are_exact(prepared, moved, recording):
    torque, wrench, _ = recording
    model = with_tool(sensed_model()).with_effect(find("base_tilt")).with_effect(find("link_inertia:wrist_2_joint"))
    for effect in ON_SENSOR:
        model = model.with_effect(effect)
    values = {f"{e}.{name}[{SENSOR}]": x for e, own in FAULTS.items() for name, x in own.items()}
    model = model.with_values(values | {f"wrench_delay.time[{SENSOR}]": 0.013, "base_tilt.roll": 0.1})
    run = as_run(moved, torque, wrench)
    run = model.prepare_run(run) if prepared else run
    rows = slice(model.predict(run, model.theta()).slices["fx.ft"].start, None)
    found = model.predict(run, model.theta())

    def wrenches(theta):
        return np.concatenate([v for n, v in model.predict_values(run, theta).items() if n.endswith(".ft")])

    assert found.values[rows] == pytest.approx(wrenches(model.theta()))
    assert_jacobian(
        wrenches,
        model.theta(),
        found.sensitivities[rows],
        1e-4 * np.array([p.typical for p in model.parameters.values()]),
        1e-5,
    )


def test_a_model_file_holds_its_sensors(tmp_path):
    (tmp_path / "arm.urdf").write_text(description(TOOL), encoding="utf-8")
    model = sensed_model(tmp_path / "arm.urdf").with_effect(find(f"wrench_offset:{SENSOR}"))
    write_model_file(tmp_path / "m.toml", ModelFile(model, {}))
    again = read_model(tmp_path / "m.toml")
    assert again.sensors == model.sensors
    assert again.names == model.names
    assert str(again.parameters[f"wrench_offset.tx[{SENSOR}]"].unit) == "N m"


@pytest.mark.parametrize(
    "table",
    [
        {"link": "hand"},
        {"link": LINK, "xyz": [1.0]},
        {"link": LINK, "place": 1},
        {"link": LINK, "axes": "tool"},
        {"link": LINK, "gain_std": 2.0},
    ],
    ids=["link", "xyz", "key", "axes", "gain"],
)
def test_a_wrong_sensor_is_refused(table, complains):
    with complains(InputError):
        sensed_model().with_sensors({SENSOR: table})


@pytest.mark.parametrize("text", ["ft", "=tool0", "a b=tool0"])
def test_an_option_of_another_form_is_refused(text, complains):
    with complains(InputError):
        chosen_sensors([text])


def test_an_arm_with_a_wrench_alone_is_compared(moved, recording):
    run = as_run(moved, *recording[:2])
    alone = replace(run, channels={n: c for n, c in run.channels.items() if not n.startswith("tau.")})
    model = sensed_model()
    assert model.predicted_channels(model.prepare_run(alone)) == model.sensors[SENSOR].channels
    assert model.force_channels(alone) == {}


@pytest.mark.parametrize("seed", [9], ids=["offset and drift"])
def test_a_repair_names_the_faults_of_a_sensor_and_finds_the_tool(seed):
    tool, model = drawn(seed), sensed_model()
    runs = [recorded(tool, 10 * seed + k, seconds=10.0, rate=50.0) for k in range(2)]
    found = CheckedStudy.of(model, runs[:1], runs[1:]).repair().model
    assert {effect.name for effect in found.named_effects} - {"payload_inertia"} == {"payload", *tool.faults}
    mass, *centre = (found.value(f"payload.{name}[{model.joints[-1]}]") for name in ("mass", "x", "y", "z"))
    assert mass == pytest.approx(tool.mass, rel=0.01)
    assert centre == pytest.approx(tool.centre, abs=2e-3)


GAINS = dict(zip(AXES, (0.08, 0.04, 0.06, 0.05, 0.07, 0.03), strict=True))


@pytest.mark.parametrize(
    ("gains", "torques", "sensor", "share"),
    [
        (GAINS, False, {}, 0.3),
        (GAINS, False, {"gain_std": 0.05}, 0.05),
        (GAINS, True, {}, 0.0014),
        (dict.fromkeys(AXES, 0.03), False, {"gain_std": 0.02}, 0.02),
    ],
    ids=["as the effect allows", "as its maker states", "told by torques", "seen by nothing"],
)
def test_a_mass_is_as_uncertain_as_the_gain_of_the_sensor(gains, torques, sensor, share):
    tool = replace(TOOL, faults={"wrench_gain": gains})
    runs = [recorded(tool, 70 + k, seconds=10.0, rate=50.0, torques=torques) for k in range(2)]
    model = sensed_model(**sensor)
    found = CheckedStudy.of(model, runs[:1], runs[1:]).repair()
    mass, x = (found.model.parameters[f"payload.{name}[{model.joints[-1]}]"] for name in ("mass", "x"))
    assert abs(mass.value - tool.mass) < 3.0 * mass.std
    assert mass.std / mass.value == pytest.approx(share, rel=0.05)
    assert x.std < 1e-3  # a place does not depend on it
    (link,) = (link for link in found.links if link.joint == model.joints[-1])
    assert link.mass.std == pytest.approx(mass.std)
    if "wrench_gain" in {effect.name for effect in found.model.effects}:
        assert found.model.parameters[f"wrench_gain.fx[{SENSOR}]"].std < 0.003  # that of an axis, beside the others
    for (_, channel), width in found.after.bands.half_width.items():  # and readings are foretold as before
        assert width.max() < 5.0 * found.after.channels[channel].rmse


def test_a_repair_by_measured_torques_is_not_lost_for_a_simulation_under_their_noise():
    """A stiff controller follows its commands, and light wrists fly away under torques with a noise of 0.3 N m."""
    runs = [recorded(TOOL, 80 + k, seconds=10.0, rate=50.0, torques=True) for k in range(2)]
    told = [{f"q_cmd.{name[2:]}": c for name, c in run.channels.items() if name.startswith("q.")} for run in runs]
    kept = [{name: c for name, c in run.channels.items() if not name.endswith(SENSOR)} for run in runs]
    runs = [replace(run, channels={**own, **more}) for run, own, more in zip(runs, kept, told, strict=True)]
    model = replace(sensed_model(), sensors={})
    found = CheckedStudy.of(model, runs[:1], runs[1:]).repair()
    assert found.verdict is not Verdict.LOST
    assert "payload" in {effect.name for effect in found.model.named_effects}
    assert found.model.value(f"payload.mass[{model.joints[-1]}]") == pytest.approx(TOOL.mass, abs=0.1)
    assert any("runs away" in text for text in found.after.left_out)


def test_a_sound_sensor_lacks_nothing(tmp_path):
    tool = replace(drawn(0), faults={})
    (tmp_path / "arm.urdf").write_text(description(tool), encoding="utf-8")
    runs = [recorded(tool, k, seconds=10.0, rate=50.0) for k in range(2)]
    found = CheckedStudy.of(sensed_model(tmp_path / "arm.urdf"), runs[:1], runs[1:]).repair()
    assert found.verdict is Verdict.EXPLAINED
    assert not found.model.named_effects


def test_a_compensated_wrench_is_what_acts_on_the_tool_besides(moved, recording):
    torque, wrench, _ = recording
    pushed = 5.0 * (np.abs(moved[0] - 2.0) < 0.5)
    touched = wrench + np.outer(pushed, np.eye(6)[2])
    left = armdyn.residual(with_tool(sensed_model()), as_run(moved, torque, touched))
    assert left.channels["fz.ft"].value[20:-20] == pytest.approx(pushed[20:-20], abs=0.05)
    assert left.channels["fx.ft"].value[20:-20] == pytest.approx(0.0, abs=0.05)


def test_the_commands_of_a_sensor(moved, recording, armdyn, tmp_path):
    (tmp_path / "arm.urdf").write_text(description(TOOL), encoding="utf-8")
    run = as_run(moved, *recording[:2])
    write_run_csv(run, tmp_path / "run.csv")
    status, *_ = armdyn(
        "new", "arm", "m.toml", "--urdf", "arm.urdf", "--wrench", f"ft={LINK}", "--wrench", "base=base_link"
    )
    assert (status, list(read_model("m.toml").sensors)) == (0, ["ft", "base"])
    sensed = sensed_model(tmp_path / "arm.urdf")
    write_model_file("m.toml", ModelFile(sensed, {}))
    assert armdyn("compare", "m.toml", "run.csv", "--output", "left.csv")[0] == 0
    assert np.abs(read_run("left.csv").channels["fx.ft"].value[20:-20]).max() < 0.01


def test_a_controller_is_told_the_inertia_of_a_tool():
    model = with_tool(sensed_model())
    found = load_command(model.with_parameters({n: replace(p, std=1e-3) for n, p in model.parameters.items()}))
    turn = robot().model.frames[robot().model.getFrameId(LINK)].placement.rotation
    assert found["command"].startswith("set_target_payload(1.300, [")
    assert np.array(found["inertia"]) == pytest.approx(turn.T @ TOOL.inertia @ turn)


@pytest.mark.parametrize("axes", ["sensor", "base"])
def test_a_reading_of_an_instant_is_that_of_a_run(axes):
    model, rng = sensed_model(axes=axes), np.random.default_rng(0)
    ways = ("payload", "payload_inertia", "cable_pull", "wrench_rotation", "wrench_crosstalk", "wrench_gain")
    for name in (*ways, "wrench_offset"):
        model = model.with_effect(CATALOGUE[name])
    model = model.with_values({name: float(rng.uniform(0.02, 0.2)) for name in model.names})
    q, v, a = (ca.SX.sym(name, 6) for name in "qva")
    reading = ca.Function("reading", [q, v, a], [sensor_reading(model, "ft", (q, v, a))])
    time, rate = np.arange(0.0, 4.0, 0.01), 0.7 * np.arange(1, 7)
    angle = rate * time[:, None]
    motion = 0.5 * np.sin(angle), 0.5 * rate * np.cos(angle), -0.5 * rate**2 * np.sin(angle)
    values = {"q": motion[0]} | {f"{axis}.ft": np.zeros(len(time)) for axis in AXES}
    run = Run.from_arrays(time, values, joints=robot().joint_names)
    predicted = model.predict_values(run, model.theta())
    expected = np.column_stack([predicted[f"{axis}.ft"] for axis in AXES])
    found = np.array([np.array(reading(*state))[:, 0] for state in zip(*motion, strict=True)])
    # Velocities and accelerations of a run are those of a spline through its positions.
    np.testing.assert_allclose(found[20:-20], expected[20:-20], atol=5e-4)
    assert np.abs(expected).max() > 2.0
