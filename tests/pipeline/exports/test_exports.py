"""What other tools compute from an exported model is what the model says."""

import ctypes
import importlib.util
import json
import re
import subprocess
from pathlib import Path
from xml.etree import ElementTree as ET

import mujoco
import numpy as np
import pinocchio as pin
import pytest
import robots

from armdyn.arm.model import arm_model
from armdyn.arm.symbolic import inverse_dynamics_function
from armdyn.codegen import find_compiler
from armdyn.effects.catalogue import CATALOGUE
from armdyn.effects.effect import effect
from armdyn.errors import InputError
from armdyn.model_file import ModelFile, read_model_file, write_model_file
from armdyn.parameter import quantity
from armdyn.pendulum.model import pendulum_model
from armdyn.watch.observer import PARTS, SOURCES, Observer
from pipeline.exports.functions import functions_of, python_text
from pipeline.exports.json_file import parameters_answer
from pipeline.exports.mujoco_file import mujoco_text
from pipeline.exports.parts import HELD
from pipeline.exports.urdf_file import urdf_text

from .conftest import by_formulas, states, with_effects

IN_FUNCTIONS = [name for name, e in CATALOGUE.items() if e.acts_on == "joint" and name != "torque_delay"]
DRIVES = {name for name, e in CATALOGUE.items() if e.acts_on == "drive"}
"""Effects of arms that say what their drives are told; see test_drives."""
IN_MUJOCO = sorted(HELD["mujoco"] - {"joint_asymmetric_friction", *DRIVES})


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


def test_one_function_holds_all_that_bodies_and_drives_do(bare_arm):
    model = with_effects(bare_arm, IN_FUNCTIONS)
    function = inverse_dynamics_function(model)
    for state in zip(*states(model, 50), strict=True):
        np.testing.assert_allclose(np.array(function(*state))[:, 0], by_formulas(model, *state), atol=1e-9)


def test_mujocos_inverse_dynamics_is_the_models_on_200_states(bare_arm):
    model = with_effects(bare_arm, IN_MUJOCO)
    q, v, a = states(model)
    ours = np.array([by_formulas(model, *state) for state in zip(q, v, a, strict=True)])
    assert np.abs(mujoco_torques(model, q, v, a) - ours).max() <= 1e-6  # 1e-13


def test_a_urdf_holds_links_payload_mounting_and_friction(bare_arm, tmp_path):
    model = with_effects(bare_arm, sorted(HELD["urdf"]))
    text, _ = urdf_text(model, tmp_path)
    (tmp_path / "a.urdf").write_text(text)
    back = arm_model(tmp_path / "a.urdf", joints=model.joints)
    changed = with_effects(bare_arm, sorted(HELD["urdf"]))
    rigid = inverse_dynamics_function(back)
    for i, joint in enumerate(model.joints):  # Pinocchio reads no friction
        dynamics = next(j for j in ET.fromstring(text).findall("joint") if j.get("name") == joint).find("dynamics")
        assert (
            float(dynamics.get("damping")) == changed.parameters[f"joint_viscous_friction.coefficient[{joint}]"].value
        )
        assert float(dynamics.get("friction")) > 0.0
        assert back.arm.slides[i] == model.arm.slides[i]
    links_alone = model.with_only_effects(["link_inertia", "payload", "base_tilt"])
    for state in zip(*states(model, 50), strict=True):
        np.testing.assert_allclose(np.array(rigid(*state))[:, 0], by_formulas(links_alone, *state), atol=1e-9)
    document = ET.fromstring(text)
    assert {"armdyn_payload", "armdyn_world"} <= {link.get("name") for link in document.findall("link")}


def test_a_link_too_light_for_its_change_takes_over_what_is_fixed_to_it(tmp_path):
    """The moved link weighs nothing itself; all of it is in a link fixed to it, which is now lighter."""
    parts = ('<link name="base"/>', '<link name="arm"/>', robots.link("weight", 2.0))
    joints = (robots.joint("j", "base", "arm"), robots.joint("f", "arm", "weight", kind="fixed", limit=""))
    urdf = robots.robot(*parts, *joints)
    (tmp_path / "a.urdf").write_text(urdf)
    model = arm_model(tmp_path / "a.urdf").with_effect(CATALOGUE["link_inertia"])
    model = model.with_values({"link_inertia.mass[j]": -0.5})
    text, notes = urdf_text(model, tmp_path)
    assert any("link arm has the inertia of all that is fixed to it (weight)" in note for note in notes)
    (tmp_path / "b.urdf").write_text(text)
    np.testing.assert_allclose(
        arm_model(tmp_path / "b.urdf").link_parameters()["j"], model.link_parameters()["j"], atol=1e-12
    )


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
    module = imported_module(python_text(functions_of(model)[0], "an arm"), tmp_path / "drives.py")
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


@pytest.fixture
def in_c(bare_arm, tmp_path, armdyn):
    """An arm with many effects, and the library of its exported C file, which compiles without a warning."""
    if find_compiler() is None:
        pytest.skip("needs a C compiler")
    model = with_effects(bare_arm, IN_FUNCTIONS)
    description = {"robot": model.arm.robot.name, "joints": list(model.joints)}
    write_model_file(tmp_path / "m.toml", ModelFile(model, description))
    assert armdyn("export", "m.toml", "--output", "m.c")[0] == 0
    strict = ["-std=c99", "-Wall", "-Wextra", "-pedantic", "-Werror"]
    subprocess.run([find_compiler(), *strict, "-O2", "-shared", "-fPIC", "m.c", "-o", "m.so", "-lm"], check=True,
                   cwd=tmp_path)  # fmt: skip
    return model, ctypes.CDLL(str(tmp_path / "m.so"))


def numbers(values):
    return (ctypes.c_double * len(values))(*values)


def test_c_code_computes_what_the_model_says(in_c):
    model, library = in_c
    for state in zip(*states(model, 20), strict=True):
        tau = numbers(state[0])
        assert library.armdyn_inverse_dynamics(*map(numbers, state), tau) == 0
        np.testing.assert_allclose(list(tau), by_formulas(model, *state), atol=1e-9)


def test_the_observer_in_c_says_what_the_watch_says(in_c, tmp_path):
    model, library = in_c
    assert "malloc" not in (tmp_path / "m.c").read_text()
    n = len(model.joints)
    observer, state = Observer(model, 40.0), numbers([0.0] * (PARTS * n + 1))
    rng = np.random.default_rng(0)
    for i in range(400):
        time = 0.004 * i + (1.0 if i > 300 else 0.0)
        q, tau = np.sin(0.2 * time * np.arange(1, n + 1)), rng.standard_normal(n)
        step = observer.take(time, q, tau)
        since = 0.0 if i == 0 else 1.004 if i == 301 else 0.004
        given = ([since], [0.0], [40.0], q, tau, [0.0] * n)
        following, predicted, residual, contrast, *others = (
            numbers([0.0] * size) for size in (PARTS * n + 1, n, n, n, SOURCES * n, 3 * n)
        )
        done = library.armdyn_watch(state, *map(numbers, given), following, predicted, residual, contrast, *others)
        assert done == 0
        np.testing.assert_allclose(list(contrast), step.contrast, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(list(predicted), step.predicted, rtol=1e-9, atol=1e-9)
        state = following


def test_python_code_computes_what_the_model_says_for_many_states_at_once(bare_arm, tmp_path):
    model = with_effects(bare_arm, IN_FUNCTIONS)
    functions, notes = functions_of(model)
    assert notes == []
    text = python_text(functions, 'arm "a" \\ """')
    assert re.findall(r"^(?:import|from) .*$", text, re.MULTILINE) == ["import numpy as np"]
    module = imported_module(text, tmp_path / "arm_functions.py")
    q, v, a = states(model, 20)
    tau = module.inverse_dynamics(q, v, a)
    assert tau.shape == q.shape
    for i, state in enumerate(zip(q, v, a, strict=True)):
        np.testing.assert_allclose(tau[i], by_formulas(model, *state), atol=1e-9)
        np.testing.assert_allclose(module.inverse_dynamics(*state), tau[i], atol=1e-12)


def test_a_pendulums_step_is_the_planners(tmp_path):
    effects = [CATALOGUE[name] for name in ("quadratic_drag", "pivot_coulomb_friction", "sensor_bias")]
    model = pendulum_model(0.368, 0.08, effects).with_values({"quadratic_drag.coefficient": 0.02})
    functions, notes = functions_of(model)
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
    answer = json.loads(json.dumps(parameters_answer(ModelFile(model, {}))))
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
    model = with_effects(bare_arm, ["joint_asymmetric_friction", "joint_stribeck_friction", "torque_offset"])
    _, notes = mujoco_text(model)
    told = " ".join(notes)
    assert "their mean is used" in told
    assert "joint_stribeck_friction" in told
    assert "torque_offset" not in told
    assert functions_of(model)[1] == []
    late = with_effects(bare_arm, ["torque_delay"])
    assert all("belongs to the torque sensor" in notes[0] for notes in (functions_of(late)[1], mujoco_text(late)[1]))
    one_joint = model.with_only_effects(["joint_asymmetric_friction"])
    q, v, a = states(one_joint, 5)
    ours = np.array([by_formulas(one_joint, *state) for state in zip(q, v, a, strict=True)])
    unequal = [
        abs(one_joint.parameters[f"joint_asymmetric_friction.positive[{j}]"].value
            - one_joint.parameters[f"joint_asymmetric_friction.negative[{j}]"].value) / 2
        for j in one_joint.joints
    ]  # fmt: skip
    np.testing.assert_allclose(np.abs(mujoco_torques(one_joint, q, v, a) - ours), np.tile(unequal, (5, 1)), atol=1e-9)


@effect("bristle", acts_on="joint", summary="A bristle.", source="Dahl 1968")
def bristle(joint, torque=quantity("N m", typical=1.0)):
    joint, bend = joint.with_state(lambda z: joint.velocity - z)
    return joint.with_torque(torque * bend)


def test_an_effect_with_a_memory_is_refused_with_its_name(bare_arm, complains):
    with complains(InputError):
        functions_of(bare_arm.with_effect(bristle))


def with_background(arm, named, small, own=()):
    """The arm with effects at random sizes, some by name, others as its background; and with all of them by name."""
    whole = with_effects(arm, named)
    for one in (*(CATALOGUE[name] for name in small), *own):
        whole = whole.with_effect(one)
    values = {p.name: 0.02 * p.typical for p in whole.parameters.values() if p.effect not in named}
    bare = whole.with_only_effects(named)
    return bare.with_background(0.1, values, [*CATALOGUE.values(), *own]), whole.with_values(values)


def test_a_background_is_exported_as_named_values_are(bare_arm, tmp_path):
    small, named = with_background(bare_arm, ["joint_spring"], sorted(HELD["mujoco"] - {"joint_spring", *DRIVES}))
    assert mujoco_text(small) == mujoco_text(named)
    assert urdf_text(small, tmp_path)[0] == urdf_text(named, tmp_path)[0]
    q, v, a = states(small, 5)
    ours, theirs = (inverse_dynamics_function(model) for model in (small, named))
    for state in zip(q, v, a, strict=True):
        np.testing.assert_array_equal(ours(*state), theirs(*state))


def test_what_a_format_cannot_hold_of_a_background_is_counted_in_one_sentence(bare_arm, tmp_path):
    small = ["torque_delay", "joint_load_friction"]
    model, _ = with_background(bare_arm, ["joint_viscous_friction"], small, [bristle])
    n = len(model.joints)
    counted = f"{2 * n} of the background of {3 * n} small values"
    functions, notes = functions_of(model)
    assert notes == [f"{counted} (torque_delay, bristle): a function has no place for them"]
    q, v, a = (x[0] for x in states(model, 1))
    rest = model.without_effect("bristle").without_effect("torque_delay")
    np.testing.assert_allclose(functions[0].function(q, v, a).full().ravel(), by_formulas(rest, q, v, a), atol=1e-9)
    assert sum(note.startswith(f"{3 * n} of the background of") for note in urdf_text(model, tmp_path)[1]) == 1
    answer = parameters_answer(ModelFile(model, {}))
    assert answer["effects"] == ["joint_viscous_friction"]
    assert len(answer["parameters"]) == n
    assert len(answer["background"]["values"]) == 3 * n


def test_the_command_leaves_the_background_out_where_only_names_are_asked_for(armdyn, tmp_path):
    model, _ = with_background(arm_model(robot="baxter"), ["joint_viscous_friction"], ["joint_coulomb_friction"])
    write_model_file(tmp_path / "m.toml", ModelFile(model, {"robot": "baxter"}))
    assert armdyn("export", "m.toml", "--output", "both.json")[0] == 0
    assert armdyn("export", "m.toml", "--output", "named.json", "--named-only")[0] == 0
    both, named = (json.loads((tmp_path / name).read_text()) for name in ("both.json", "named.json"))
    assert len(both.pop("background")["values"]) == 7
    assert both == named


def test_the_command_writes_names_the_next_step_and_never_over_silently(armdyn, tmp_path):
    assert armdyn("new", "pendulum", "m.toml")[0] == 0
    status, out, _ = armdyn("export", "m.toml", "--output", "m.py", "--json", "answer.json")
    assert status == 0
    assert "Python functions written to m.py" in out
    assert "next: from m import step" in out
    assert json.loads((tmp_path / "answer.json").read_text())["kind"] == "Python functions"
    assert "--force" in armdyn("export", "m.toml", "--output", "answer.json")[2]
    assert armdyn("export", "m.toml", "--output", "answer.json", "--force")[0] == 0


def test_a_new_model_takes_no_repaired_ones_place(armdyn, tmp_path):
    assert armdyn("new", "pendulum", "m.toml")[0] == 0
    assert armdyn("new", "pendulum", "m.toml")[0] == 0  # nothing was found in it yet
    file = read_model_file("m.toml")
    write_model_file("m.toml", ModelFile(file.model.with_effect(CATALOGUE["linear_drag"]), file.description))
    status, _, err = armdyn("new", "pendulum", "m.toml")
    assert status == 2
    assert "--force" in err
    assert armdyn("new", "pendulum", "m.toml", "--force")[0] == 0
    (tmp_path / "run.toml").write_text('description = "beside a recording"\n')
    assert armdyn("new", "pendulum", "run.toml")[0] == 2


def test_a_model_file_finds_its_urdf_from_its_own_folder(armdyn, tmp_path, bare_arm):
    (tmp_path / "robot").mkdir()
    (tmp_path / "models").mkdir()
    (tmp_path / "robot/a.urdf").write_text(urdf_text(bare_arm, tmp_path / "robot")[0])
    joints = ",".join(bare_arm.joints)
    assert armdyn("new", "arm", "models/m.toml", "--urdf", "robot/a.urdf", "--joints", joints)[0] == 0
    assert 'urdf = "../robot/a.urdf"' in (tmp_path / "models/m.toml").read_text()
    file = read_model_file(tmp_path / "models/m.toml")
    write_model_file(tmp_path / "m2.toml", file)
    assert 'urdf = "robot/a.urdf"' in (tmp_path / "m2.toml").read_text()
    moved = tmp_path / "moved"
    moved.mkdir()
    for name in ("robot", "models"):
        (tmp_path / name).rename(moved / name)
    assert read_model_file(Path("moved/models/m.toml")).model.joints == bare_arm.joints
