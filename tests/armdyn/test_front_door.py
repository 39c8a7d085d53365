import pickle
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

import armdyn
from armdyn.errors import InputError, UnknownNameError
from armdyn.model_file import read_model_file
from armdyn.recording.channels import SampleError
from armdyn.run import write_run_csv
from ik.errors import UnreachableError


@pytest.mark.parametrize(
    ("module", "later"),
    [
        ("armdyn", "numpy scipy casadi pinocchio plotly pandas"),
        ("armdyn.run", "pint mcap plotly casadi"),
        ("pipeline.commands.trial", "numpy casadi pinocchio"),  # as `armdyn --help` loads every command
    ],
)
def test_an_import_alone_loads_no_library(module, later):
    code = f"import sys, {module}; print(set('{later}'.split()) & set(sys.modules))"
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert said.strip() == "set()"


def test_dir_shows_what_a_user_calls_and_nothing_else():
    shown = set(dir(armdyn))
    assert shown == set(armdyn.__all__)
    assert {"InputError", "compare", "diagnose", "repair", "excite", "export", "next_experiment", "read_run"} <= shown
    assert not {"Any", "TYPE_CHECKING", "import_module"} & shown


def test_a_model_and_a_run_are_printed_in_one_line():
    pendulum = armdyn.pendulum.pendulum_model(length=0.35, mass=0.1, effects=[armdyn.CATALOGUE["linear_drag"]])
    assert str(pendulum) == repr(pendulum) == "pendulum, length 0.35 m, mass 0.1 kg; linear_drag"
    assert "gravity 9.78 m/s^2" in str(pendulum.with_prior("gravity", 9.78, 0.001))
    arm = armdyn.arm.arm_model(robot="ur5")
    assert str(arm) == "arm ur5, 6 joints from shoulder_pan_joint to wrist_3_joint; no effects"
    run = armdyn.Run.from_arrays(np.arange(0.0, 2.0, 0.1), {"q": np.ones((20, 2))}, joints=["a", "b"], name="x")
    assert str(run) == repr(run) == "Run x: q of 2 joints, 1.9 s"


def test_a_model_is_saved_loaded_and_predicts(swing, tmp_path, complains):
    """A swing that begins as the recording does, and does not decay."""
    model = armdyn.pendulum.pendulum_model(length=9.81 / 25, mass=0.1)
    armdyn.save(model, tmp_path / "m.toml")
    with complains(InputError):
        armdyn.save(model, tmp_path / "m.toml")
    run = swing("a", 0)
    found = armdyn.predict(tmp_path / "m.toml", run).channels["swing_angle"]
    measured = run.channels["swing_angle"]
    decay = np.exp(-0.1 * found.time)
    np.testing.assert_allclose(decay * found.value, measured.value, atol=0.02)
    again = armdyn.simulate(armdyn.load(tmp_path / "m.toml"), run).channels["swing_angle"]
    np.testing.assert_array_equal(again.value, found.value)


@pytest.mark.parametrize("chosen", [{}, {"joints": ["wrist_2_joint", "wrist_3_joint"]}])
def test_a_saved_arm_is_the_same_arm(chosen, tmp_path):
    model = armdyn.arm.arm_model(robot="ur5", effects=[armdyn.CATALOGUE["joint_viscous_friction"]], **chosen)
    armdyn.save(model, tmp_path / "a.toml")
    armdyn.save(armdyn.load(tmp_path / "a.toml"), tmp_path / "b.toml")
    assert armdyn.load(tmp_path / "b.toml").joints == model.joints
    assert (tmp_path / "a.toml").read_text() == (tmp_path / "b.toml").read_text()


def test_an_arm_without_its_torques_predicts_them_and_simulated_by_them_repeats_its_motion():
    """Torques of a motion by Pinocchio's own algorithm; the arm that is moved by them follows the motion."""
    model = armdyn.arm.arm_model(robot="ur5")
    t = np.arange(0.0, 1.0, 0.002)
    w = np.arange(1, 7)
    q, v, a = 0.3 * np.sin(np.outer(t, w)), 0.3 * w * np.cos(np.outer(t, w)), -0.3 * w**2 * np.sin(np.outer(t, w))
    data = model.arm.model.createData()
    tau = np.array([pin.rnea(model.arm.model, data, *row) for row in zip(q, v, a, strict=True)])
    run = armdyn.Run.from_arrays(t, {"q": q, "v": v, "a": a, "tau": tau}, joints=model.arm.joints)
    predicted, moved = armdyn.predict(model, run), armdyn.simulate(model, run)
    for j, joint in enumerate(model.arm.joints):
        torque, place = predicted.channels[f"tau.{joint}"], moved.channels[f"q.{joint}"]
        inside = (torque.time > 0.1) & (torque.time < 0.9)
        np.testing.assert_allclose(
            torque.value[inside], np.interp(torque.time, t, tau[:, j])[inside], atol=0.02 * np.ptp(tau[:, j])
        )
        np.testing.assert_allclose(place.value, np.interp(place.time, t, q[:, j]), atol=1e-4)


def test_repair_tells_the_error_on_an_exam(swing):
    model = armdyn.pendulum.pendulum_model(length=0.36, mass=0.1).with_fixed("mass")
    found = armdyn.repair(model, [swing("a", 0)], effects=[armdyn.CATALOGUE["linear_drag"]], exam=[swing("b", 1)])
    assert found.path[-1].exam_rmse["swing_angle"] < found.path[0].exam_rmse["swing_angle"]


def test_a_saved_repair_keeps_its_errors_for_the_check_of_motions(swing, tmp_path):
    """Without them a check's margin is too small."""
    model = armdyn.pendulum.pendulum_model(length=0.36, mass=0.1).with_fixed("mass")
    found = armdyn.repair(model, [swing("a", 0)], effects=[armdyn.CATALOGUE["linear_drag"]])
    armdyn.save(found, tmp_path / "repaired.toml")
    (step,) = read_model_file(tmp_path / "repaired.toml").history
    assert step["added"] == "linear_drag"
    assert step["rmse"] == found.path[-1].rmse


def test_a_repair_whose_exam_diverged_is_saved_and_read(swing, tmp_path):
    """No model file holds an infinite number."""
    model = armdyn.pendulum.pendulum_model(length=0.36, mass=0.1).with_fixed("mass")
    found = armdyn.repair(model, [swing("a", 0)], effects=[armdyn.CATALOGUE["linear_drag"]])
    first, last = found.path
    diverged = replace(found, path=(first, replace(last, exam_rmse={"swing_angle": np.inf})))
    armdyn.save(diverged, tmp_path / "repaired.toml")
    (step,) = read_model_file(tmp_path / "repaired.toml").history
    assert "exam_rmse" not in step


def test_a_model_goes_elsewhere_and_nothing_is_written_over(tmp_path, complains):
    target = tmp_path / "pendulum.py"
    armdyn.export(armdyn.pendulum.pendulum_model(length=0.35, mass=0.1), target)
    assert "def step(" in target.read_text()
    with complains(armdyn.InputError):
        armdyn.export(armdyn.pendulum.pendulum_model(length=0.35, mass=0.1), target)
    notes = armdyn.export(
        armdyn.arm.arm_model(robot="ur5", effects=[armdyn.CATALOGUE["torque_delay"]]), tmp_path / "a.xml"
    )
    assert any("torque_delay" in note for note in notes)


def test_a_motion_to_record_is_a_run():
    found = armdyn.excite(
        armdyn.arm.arm_model(robot="ur5", joints=["wrist_3_joint"]), ["rotor_inertia"], seconds=2, random=2
    )
    assert set(found.motion.channels) == {"q.wrist_3_joint", "v.wrist_3_joint", "a.wrist_3_joint"}
    assert abs(found.motion.channels["v.wrist_3_joint"].value[0]) < 1e-6


def test_an_effect_of_ones_own_that_is_missing_names_the_option(tmp_path, complains):
    (tmp_path / "m.toml").write_text('base = "pendulum"\neffects = ["my_drag"]\n')
    with complains(armdyn.InputError):
        armdyn.read_model(tmp_path / "m.toml")


@pytest.fixture
def swing():
    """Makes decaying swings."""

    def make(name, seed):
        t, rng = np.arange(0.0, 8.0, 0.02), np.random.default_rng(seed)
        angle = 0.2 * np.exp(-0.1 * t) * np.cos(5.0 * t + seed) + 1e-3 * rng.normal(size=len(t))
        return armdyn.Run.from_arrays(t, {"swing_angle": angle}, name=name)

    return make


def test_a_model_is_fitted_from_paths_given_as_text(tmp_path):
    t = np.arange(0.0, 3.0, 0.01)
    angle = 0.1 * np.cos(5.0 * t) + 1e-4 * np.random.default_rng(0).normal(size=len(t))
    rows = "\n".join(f"{s:.2f},{a:.6f}" for s, a in zip(t, angle, strict=True))
    path = str(tmp_path / "swing.csv")
    (tmp_path / "swing.csv").write_text(f"time [s],swing_angle [rad]\n{rows}\n")
    model = armdyn.pendulum.pendulum_model(0.35, 0.1).with_fixed("mass")
    fitted = armdyn.fit(model, [path])
    assert abs(fitted.value("length") - 9.81 / 25.0) < 2e-3
    assert armdyn.compare(fitted, [armdyn.read_run(path)]).channels["swing_angle"].noise_std < 2e-4


@pytest.mark.parametrize(
    "error",
    [
        InputError("a sentence"),
        UnknownNameError("effect", "linear_drog", ["linear_drag", "quadratic_drag"]),
        SampleError(3, "1e+09 rad is beyond 10000 rad"),
        UnreachableError("no way"),
    ],
    ids=lambda error: type(error).__name__,
)
def test_an_error_comes_whole_out_of_another_process(error):
    again = pickle.loads(pickle.dumps(error))
    assert type(again) is type(error)
    assert str(again) == str(error)
    assert vars(again) == vars(error)


def test_one_path_is_one_recording_and_effects_are_added_by_name(swing, tmp_path, complains):
    model = armdyn.pendulum.pendulum_model(length=0.36, mass=0.1).with_fixed("mass")
    write_run_csv(swing("a", 0), tmp_path / "a.csv")
    for path in (tmp_path / "a.csv", str(tmp_path / "a.csv")):
        assert [run.name for run in armdyn.compare(model, path).fit.problem.runs] == ["a.csv"]
    found = armdyn.add(model, "linear_drag+quadratic_drag", tmp_path / "a.csv")
    assert [effect.name for effect in found.model.effects] == ["linear_drag", "quadratic_drag"]
    assert armdyn.add(model, armdyn.CATALOGUE["linear_drag"], swing("a", 0)).model.effects[0].name == "linear_drag"
    with complains(UnknownNameError):
        armdyn.add(model, "linear_drog", swing("a", 0))


def test_results_are_printed_in_a_line(swing):
    model = armdyn.pendulum.pendulum_model(length=0.36, mass=0.1).with_fixed("mass")
    run = swing("a", 0)
    for found in (armdyn.compare(model, run), armdyn.inspect(run), armdyn.add(model, "linear_drag", run)):
        assert repr(found).startswith(type(found).__name__)
        assert len(repr(found)) < 500


def test_what_is_given_in_the_wrong_place_is_told_where_it_belongs(tmp_path):
    with pytest.raises(InputError, match="give the recordings first"):
        armdyn.inspect(armdyn.pendulum.pendulum_model(length=0.35, mass=0.1), [])
    robot = tmp_path / "arm.urdf"
    robot.write_text("<robot/>")
    with pytest.raises(InputError, match=f"armdyn new arm M.toml --urdf {robot}"):
        armdyn.read_model(robot)
