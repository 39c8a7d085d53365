"""What other tools compute from an exported model is what the model says."""

import ctypes
import importlib.util
import json
import re
import subprocess
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree as ET

import mujoco
import numpy as np
import pinocchio as pin
import pytest
import robots
from command import called

from armdyn.arm.model import arm_model
from armdyn.arm.symbolic import gravity_compensation_function, inverse_dynamics_function
from armdyn.codegen import find_compiler
from armdyn.effects.catalogue import CATALOGUE
from armdyn.effects.effect import effect
from armdyn.errors import InputError
from armdyn.model_file import ModelFile, read_model_file, write_model_file
from armdyn.parameter import quantity
from armdyn.pendulum.model import pendulum_model
from armdyn.watch.observer import STATES_PER_JOINT, VARIANCE_SOURCE_COUNT, Observer
from pipeline.exports.functions import exported_functions, python_text
from pipeline.exports.json_file import parameters_json
from pipeline.exports.load_commands import load_command, load_sentence
from pipeline.exports.mujoco_file import mujoco_text
from pipeline.exports.parts import MUJOCO_SLOTS, URDF_SLOTS, held_effects
from pipeline.exports.urdf_file import urdf_text
from urdf.find import distribution_file

from .conftest import by_formulas, states, with_effects

PANDA = "panda_description/urdf/panda.urdf"
IN_FUNCTIONS = [name for name, e in CATALOGUE.items() if e.acts_on == "joint" and name != "torque_delay"]
DRIVES = {name for name, e in CATALOGUE.items() if e.acts_on == "drive"}
"""Effects of arms that say what their drives are told; see test_drives."""
HELD_BY_MUJOCO = held_effects(CATALOGUE.values(), MUJOCO_SLOTS)
IN_MUJOCO = sorted(HELD_BY_MUJOCO - {"joint_asymmetric_friction", "joint_stribeck_friction", "backlash", *DRIVES})


def mujoco_torques(model, q, v, a):
    """(m, n) inverse dynamics of MuJoCo."""
    compiled = mujoco.MjModel.from_xml_string(mujoco_text(model)[0])
    data, found = mujoco.MjData(compiled), []
    for state in zip(q, v, a, strict=True):
        data.qpos[:], data.qvel[:], data.qacc[:] = state
        mujoco.mj_inverse(compiled, data)
        found.append(data.qfrc_inverse.copy())
    return np.array(found)


def imported_module(text, path):
    path.write_text(text)
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_mujocos_inverse_dynamics_is_the_models_on_200_states(bare_arm):
    model = with_effects(bare_arm, IN_MUJOCO)
    given = states(model)
    assert np.abs(mujoco_torques(model, *given) - by_formulas(model, *given)).max() <= 1e-6  # 1e-13


def test_a_urdf_holds_links_payload_mounting_and_friction(bare_arm, tmp_path):
    model = with_effects(bare_arm, sorted(held_effects(CATALOGUE.values(), URDF_SLOTS) - DRIVES))
    text, _ = urdf_text(model, tmp_path)
    (tmp_path / "a.urdf").write_text(text)
    document = ET.fromstring(text)
    back = arm_model(tmp_path / "a.urdf", joints=model.joints)
    for i, joint in enumerate(model.joints):  # Pinocchio reads no friction
        dynamics = document.find(f"joint[@name='{joint}']/dynamics")
        assert float(dynamics.get("damping")) == model.value(f"joint_viscous_friction.coefficient[{joint}]")
        assert float(dynamics.get("friction")) > 0.0
        assert back.arm.slides[i] == model.arm.slides[i]
    rigid = inverse_dynamics_function(back)
    links_alone = model.with_only_effects(["link_inertia", "payload", "payload_inertia", "base_tilt"])
    given = states(model, 50)
    found = [np.array(rigid(*state))[:, 0] for state in zip(*given, strict=True)]
    np.testing.assert_allclose(found, by_formulas(links_alone, *given), atol=1e-9)
    assert {"armdyn_payload", "armdyn_world"} <= {link.get("name") for link in document.findall("link")}


def test_a_link_too_light_for_its_change_takes_over_what_is_fixed_to_it(tmp_path):
    """The moved link weighs nothing itself; all of it is in a link fixed to it, which is now lighter."""
    parts = ('<link name="base"/>', '<link name="arm"/>', robots.link("weight", 2.0))
    joints = (robots.joint("j", "base", "arm"), robots.joint("f", "arm", "weight", kind="fixed", limit=""))
    (tmp_path / "a.urdf").write_text(robots.robot(*parts, *joints))
    model = arm_model(tmp_path / "a.urdf").with_effect(CATALOGUE["link_inertia"])
    model = model.with_values({"link_inertia.mass[j]": -0.5})
    text, notes = urdf_text(model, tmp_path)
    assert any("link arm has the inertia of all that is fixed to it (weight)" in note for note in notes)
    (tmp_path / "b.urdf").write_text(text)
    back = arm_model(tmp_path / "b.urdf").link_parameters()["j"]
    np.testing.assert_allclose(back, model.link_parameters()["j"], atol=1e-12)


def test_meshes_are_found_from_the_new_files_folder(tmp_path):
    shape = '<visual><geometry><mesh filename="meshes/arm.stl"/></geometry></visual>'
    urdf = robots.robot('<link name="base"/>', robots.link("arm", shape=shape), robots.joint("j", "base", "arm"))
    (tmp_path / "robot/meshes").mkdir(parents=True)
    corners = "vertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0"
    mesh = f"solid a\nfacet normal 0 0 1\nouter loop\n{corners}\nendloop\nendfacet\nendsolid a"
    (tmp_path / "robot/meshes/arm.stl").write_text(mesh)
    (tmp_path / "robot/a.urdf").write_text(urdf)
    text, _ = urdf_text(arm_model(tmp_path / "robot/a.urdf"), tmp_path / "out")
    assert 'filename="../robot/meshes/arm.stl"' in text


def test_gain_and_offset_of_a_drive_go_with_its_command(bare_arm, tmp_path):
    """Told what the function says, MuJoCo's drive gives the torque that the motion takes."""
    model = with_effects(bare_arm, ["link_inertia", "torque_gain", "torque_offset"])
    module = imported_module(python_text(exported_functions(model)[0], "an arm"), tmp_path / "drives.py")
    q, v, a = states(model, 20)
    torques, commands = module.inverse_dynamics(q, v, a), module.drive_command(q, v, a)
    gains, offsets = (
        np.array([model.parameters[f"{name}[{joint}]"].value for joint in model.joints])
        for name in ("torque_gain.error", "torque_offset.torque")
    )
    np.testing.assert_allclose(commands, (1.0 + gains) * torques + offsets, atol=1e-12)
    compiled = mujoco.MjModel.from_xml_string(mujoco_text(model)[0])
    compiled.actuator_ctrllimited[:] = 0
    data = mujoco.MjData(compiled)
    for state, torque, command in zip(q, torques, commands, strict=True):
        data.qpos[:], data.ctrl[:] = state, command
        mujoco.mj_forward(compiled, data)
        np.testing.assert_allclose(data.qfrc_actuator, torque, atol=1e-9)


@pytest.fixture(scope="module")
def in_c(bare_arm, tmp_path_factory):
    """An arm with many effects, and the library of its exported C file, which compiles without a warning."""
    if find_compiler() is None:
        pytest.skip("needs a C compiler")
    folder = tmp_path_factory.mktemp("c")
    model = with_effects(bare_arm, IN_FUNCTIONS)
    description = {"robot": model.arm.robot.name, "joints": list(model.joints)}
    write_model_file(folder / "m.toml", ModelFile(model, description))
    assert called("export", folder / "m.toml", "--output", folder / "m.c")[0] == 0
    assert "malloc" not in (folder / "m.c").read_text()
    strict = ["-std=c99", "-Wall", "-Wextra", "-pedantic", "-Werror"]
    subprocess.run([find_compiler(), *strict, "-shared", "-fPIC", "m.c", "-o", "m.so", "-lm"], check=True, cwd=folder)
    return model, ctypes.CDLL(str(folder / "m.so"))


def numbers(values):
    return (ctypes.c_double * len(values))(*values)


def test_c_code_computes_what_the_model_says(in_c):
    model, library = in_c
    for state in zip(*states(model, 20), strict=True):
        tau = numbers(state[0])
        assert library.armdyn_inverse_dynamics(*map(numbers, state), tau) == 0
        np.testing.assert_allclose([list(tau)], by_formulas(model, *state), atol=1e-9)


def test_gravity_and_friction_are_those_at_rest_and_at_a_speed(bare_arm):
    model = with_effects(bare_arm, IN_FUNCTIONS)
    function, own = gravity_compensation_function(model), model.rigid_body_model_at(model.theta())
    own.gravity, data = pin.Motion(np.concatenate([model.gravity(), np.zeros(3)])), own.createData()
    names = ("joint_load_friction.coefficient", *(f"joint_asymmetric_friction.{n}" for n in ("positive", "negative")))
    per_load, forth, back = (np.array([model.value(f"{name}[{joint}]") for joint in model.joints]) for name in names)
    between = (forth - back) / 2.0  # of a friction that differs by direction
    for q, v, _ in zip(*states(model, 20), strict=True):
        none = np.zeros_like(q)
        gravity, friction = (np.array(part)[:, 0] for part in function(q, v))
        at_rest = by_formulas(model, q, none, none)[0] + between
        np.testing.assert_allclose(gravity, at_rest, atol=1e-9)
        moving, still = pin.rnea(own, data, q, v, none).copy(), pin.rnea(own, data, q, none, none).copy()
        whole = by_formulas(model, q, v, none)[0] - moving - per_load * (np.abs(moving) - np.abs(still)) * np.sign(v)
        np.testing.assert_allclose(friction, whole - at_rest + still, atol=1e-9)


def test_gravity_compensation_in_c_and_python_is_the_functions(in_c, tmp_path):
    model, library = in_c
    function = gravity_compensation_function(model)
    module = imported_module(python_text(exported_functions(model)[0], ["arm"]), tmp_path / "gravity.py")
    for q, v, _ in zip(*states(model, 20), strict=True):
        gravity, friction = numbers(q), numbers(q)
        assert library.armdyn_gravity_compensation(numbers(q), numbers(v), gravity, friction) == 0
        expected = np.array([np.array(part)[:, 0] for part in function(q, v)])
        np.testing.assert_allclose([list(gravity), list(friction)], expected, atol=1e-9)
        np.testing.assert_allclose(module.gravity_compensation(q, v), expected, atol=1e-9)


@pytest.mark.parametrize(("robot", "text"), [("ur5", "set_payload(0.500, ["), ("panda", "robot.setLoad(0.500, {")])
def test_a_load_is_printed_as_the_controllers_are_told_it(robot, text):
    source = robot if robot == "ur5" else str(distribution_file("example-robot-data", PANDA))
    model = arm_model(urdf=None if robot == "ur5" else source, robot=robot if robot == "ur5" else None)
    model = model.with_effect(CATALOGUE["payload"])
    joint = model.joints[-1]
    values = {
        f"payload.{short}[{joint}]": x for short, x in zip(("mass", "x", "y", "z"), (0.5, 0.1, -0.02, 0.2), strict=True)
    }
    model = model.with_values(values)
    assert load_command(model) is None  # nobody said how sure it is
    model = model.with_parameters({name: replace(model.parameters[name], std=0.01) for name in values})
    found = load_command(model)
    assert found["command"].startswith(text)
    rigid = model.arm.model
    flange = rigid.frames[rigid.getFrameId("tool0" if robot == "ur5" else "panda_link8")]
    q = np.linspace(0.1, 0.5, len(model.joints))
    data = rigid.createData()
    pin.framesForwardKinematics(rigid, data, q)
    there = data.oMi[rigid.njoints - 1].act(np.array([0.1, -0.02, 0.2]))
    assert data.oMf[rigid.getFrameId(flange.name)].act(np.array(found["centre"])) == pytest.approx(there)
    assert found["mass_std"] == 0.01
    assert load_sentence(found).startswith("load beyond the description: ")


def test_the_observer_in_c_says_what_the_watch_says(in_c):
    model, library = in_c
    n = len(model.joints)
    observer, state = Observer(model, 40.0), numbers([0.0] * (STATES_PER_JOINT * n + 1))
    rng = np.random.default_rng(0)
    for i in range(400):
        time = 0.004 * i + (1.0 if i > 300 else 0.0)
        q, tau = np.sin(0.2 * time * np.arange(1, n + 1)), rng.standard_normal(n)
        step = observer.process_sample(time, q, tau)
        since = 0.0 if i == 0 else 1.004 if i == 301 else 0.004
        given = ([since], [0.0], [40.0], q, tau, [0.0] * n)
        following, predicted, residual, contrast, *others = (
            numbers([0.0] * size)
            for size in (STATES_PER_JOINT * n + 1, n, n, n, VARIANCE_SOURCE_COUNT * n, n, 2 * n, 3 * n)
        )
        done = library.armdyn_watch(state, *map(numbers, given), following, predicted, residual, contrast, *others)
        assert done == 0
        np.testing.assert_allclose(list(contrast), step.contrast, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(list(predicted), step.predicted, rtol=1e-9, atol=1e-9)
        state = following


def test_python_code_computes_what_the_model_says_for_many_states_at_once(bare_arm, tmp_path):
    model = with_effects(bare_arm, IN_FUNCTIONS)
    functions, notes = exported_functions(model)
    assert notes == []
    text = python_text(functions, 'arm "a" \\ """')
    assert re.findall(r"^(?:import|from) .*$", text, re.MULTILINE) == ["import numpy as np"]
    module = imported_module(text, tmp_path / "arm_functions.py")
    given = states(model, 20)
    tau = module.inverse_dynamics(*given)
    np.testing.assert_allclose(tau, by_formulas(model, *given), atol=1e-9)
    for state, alone in zip(zip(*given, strict=True), tau, strict=True):
        np.testing.assert_allclose(module.inverse_dynamics(*state), alone, atol=1e-12)


def test_a_pendulums_step_is_the_planners(tmp_path):
    effects = [CATALOGUE[name] for name in ("quadratic_drag", "pivot_coulomb_friction", "sensor_bias")]
    model = pendulum_model(0.368, 0.08, effects).with_values({"quadratic_drag.coefficient": 0.02})
    functions, notes = exported_functions(model)
    assert notes == ["sensor_bias: belongs to the sensor, not to the pendulum"]
    module = imported_module(python_text(functions, "a pendulum"), tmp_path / "pendulum_functions.py")
    variational = model.variational()
    theta = [model.value(name) for name in variational.names]
    state = np.array([0.1, 0.2, 0.3, -1.0])
    expected = np.array(variational.step(state, 0.5, 0.0, 0.01, theta))[:, 0]
    after, tension = module.step(state, 0.5, 0.0, 0.01)
    np.testing.assert_allclose(after, expected, atol=1e-12)
    assert tension == pytest.approx(float(variational.tension(state, 0.5, 0.0, 0.01, theta, expected)), abs=1e-9)
    assert 0.5 < tension < 1.2  # about its weight of 0.78 N
    # A second apart the energy has not grown: drag and friction take it away.
    s = np.array([0.0, 0.0, 0.5, 0.0])
    for _ in range(1000):
        s = module.step(s, 0.0, 0.0, 0.01)[0]
    assert abs(s[2]) < 0.4


def test_json_tells_values_deviations_and_links_in_units(bare_arm):
    model = with_effects(bare_arm, ["link_inertia", "joint_viscous_friction"])
    name = f"joint_viscous_friction.coefficient[{model.joints[0]}]"
    model = model.with_parameters({name: model.parameters[name].with_value(2.0, 0.1)})
    answer = json.loads(json.dumps(parameters_json(ModelFile(model, {}))))
    assert answer["schema"] == "armdyn.parameters/1"
    entry = answer["parameters"][name]
    assert (entry["value"], entry["std"], entry["unit"], entry["joint"]) == (2.0, 0.1, "N m s/rad", model.joints[0])
    assert entry["meaning"] == "torque per speed"
    link = answer["links"][1]
    inertia = pin.Inertia.FromDynamicParameters(model.link_parameters()[link["joint"]])
    assert link["model"]["mass"] == {"value": pytest.approx(inertia.mass), "unit": "kg"}
    assert list(link["model"]["centre"]["value"].values()) == pytest.approx(list(inertia.lever))
    assert link["model"]["inertia"]["value"]["xy"] == pytest.approx(inertia.inertia[0, 1])


def test_what_a_format_cannot_hold_is_named(bare_arm):
    model = with_effects(bare_arm, ["joint_asymmetric_friction", "joint_load_friction", "torque_offset"])
    told = " ".join(mujoco_text(model)[1])
    assert "their mean is used" in told
    assert "joint_load_friction" in told
    assert "torque_offset" not in told
    late = with_effects(bare_arm, ["torque_delay"])
    assert all(
        "belongs to the torque sensor" in notes[0] for notes in (exported_functions(late)[1], mujoco_text(late)[1])
    )
    alone = model.with_only_effects(["joint_asymmetric_friction"])
    given = states(alone, 5)
    both = [
        [alone.value(f"joint_asymmetric_friction.{s}[{j}]") for j in alone.joints] for s in ("positive", "negative")
    ]
    unequal = np.abs(np.subtract(*both)) / 2
    off = np.abs(mujoco_torques(alone, *given) - by_formulas(alone, *given))
    np.testing.assert_allclose(off, np.tile(unequal, (5, 1)), atol=1e-9)


@effect("bristle", acts_on="joint", summary="A bristle.", source="Dahl 1968")
def bristle(joint, torque=quantity("N m", typical=1.0)):
    joint, bend = joint.with_state(lambda z: joint.velocity - z)
    return joint.with_torque(torque * bend)


def test_an_effect_with_a_memory_is_refused_with_its_name(bare_arm, complains):
    with complains(InputError):
        exported_functions(bare_arm.with_effect(bristle))


def with_background(arm, named, small, own=()):
    """The arm with effects at random sizes, some by name, others as its background; and with all of them by name."""
    whole = with_effects(arm, named)
    for one in (*(CATALOGUE[name] for name in small), *own):
        whole = whole.with_effect(one)
    values = {p.name: 0.02 * p.typical for p in whole.parameters.values() if p.effect not in named}
    bare = whole.with_only_effects(named)
    return bare.with_background(0.1, values, [*CATALOGUE.values(), *own]), whole.with_values(values)


def test_a_background_is_exported_as_named_values_are(bare_arm, tmp_path):
    others = HELD_BY_MUJOCO - {"joint_spring", "joint_stribeck_friction", *DRIVES}
    small, named = with_background(bare_arm, ["joint_spring"], sorted(others))
    assert mujoco_text(small) == mujoco_text(named)
    assert urdf_text(small, tmp_path)[0] == urdf_text(named, tmp_path)[0]
    ours, theirs = (inverse_dynamics_function(model) for model in (small, named))
    for state in zip(*states(small, 5), strict=True):
        np.testing.assert_array_equal(ours(*state), theirs(*state))


def test_what_a_format_cannot_hold_of_a_background_is_counted_in_one_sentence(bare_arm, tmp_path):
    small = ["torque_delay", "joint_load_friction"]
    model, _ = with_background(bare_arm, ["joint_viscous_friction"], small, [bristle])
    n = len(model.joints)
    counted = f"{2 * n} of the background of {3 * n} small values"
    functions, notes = exported_functions(model)
    assert notes == [f"{counted} (torque_delay, bristle): a function has no place for them"]
    state = [x[0] for x in states(model, 1)]
    rest = model.without_effect("bristle").without_effect("torque_delay")
    np.testing.assert_allclose(functions[0].function(*state).full().T, by_formulas(rest, *state), atol=1e-9)
    assert sum(note.startswith(f"{3 * n} of the background of") for note in urdf_text(model, tmp_path)[1]) == 1
    answer = parameters_json(ModelFile(model, {}))
    assert answer["effects"] == ["joint_viscous_friction"]
    assert len(answer["parameters"]) == n
    assert len(answer["background"]["values"]) == 3 * n


def test_the_command_leaves_the_background_out_where_only_names_are_asked_for(armdyn, tmp_path):
    model, _ = with_background(arm_model(robot="baxter"), ["joint_viscous_friction"], ["joint_coulomb_friction"])
    write_model_file(tmp_path / "m.toml", ModelFile(model, {"robot": "baxter"}))
    for name, option in (("both", ()), ("named", ("--named-only",))):
        assert armdyn("export", "m.toml", "--output", f"{name}.json", *option)[0] == 0
    both, named = (json.loads((tmp_path / f"{name}.json").read_text()) for name in ("both", "named"))
    assert len(both.pop("background")["values"]) == 7
    assert both == named


def test_nothing_that_somebody_made_is_written_over_silently(armdyn, tmp_path):
    new = ("new", "pendulum", "m.toml")
    assert [armdyn(*new)[0] for _ in range(2)] == [0, 0]  # nothing was found in it yet
    file = read_model_file("m.toml")
    write_model_file("m.toml", ModelFile(file.model.with_effect(CATALOGUE["linear_drag"]), file.description))
    for command, before in ((new, "linear_drag"), (("export", "m.toml", "--output", "m.json"), "mine")):
        (tmp_path / "m.json").write_text("mine")
        status, _, err = armdyn(*command)
        assert status == 2
        assert "--force" in err
        assert before in (tmp_path / command[-1]).read_text()
    assert armdyn("export", "m.toml", "--output", "m.json", "--force")[0] == 0
    assert armdyn(*new, "--force")[0] == 0
    (tmp_path / "run.toml").write_text('description = "beside a recording"\n')
    assert armdyn("new", "pendulum", "run.toml")[0] == 2


def test_a_model_file_finds_its_urdf_from_its_own_folder(armdyn, tmp_path, bare_arm):
    for name in ("robot", "models", "moved"):
        (tmp_path / name).mkdir()
    (tmp_path / "robot/a.urdf").write_text(urdf_text(bare_arm, tmp_path / "robot")[0])
    joints = ",".join(bare_arm.joints)
    assert armdyn("new", "arm", "models/m.toml", "--urdf", "robot/a.urdf", "--joints", joints)[0] == 0
    assert 'urdf = "../robot/a.urdf"' in (tmp_path / "models/m.toml").read_text()
    write_model_file(tmp_path / "m2.toml", read_model_file(tmp_path / "models/m.toml"))
    assert 'urdf = "robot/a.urdf"' in (tmp_path / "m2.toml").read_text()
    for name in ("robot", "models"):
        (tmp_path / name).rename(tmp_path / "moved" / name)
    assert read_model_file(Path("moved/models/m.toml")).model.joints == bare_arm.joints
