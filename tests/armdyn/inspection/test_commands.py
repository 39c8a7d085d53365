"""A command in another unit, or with the wrong sign, is found by the joint that follows it; MuJoCo moves the joint."""

import numpy as np
import pytest
from worlds.hobby_arm import FPS, JOINTS, recorded, urdf_text

from armdyn.arm.model import arm_model
from armdyn.errors import InputError
from armdyn.inspection.commands import command_checks
from armdyn.inspection.inspect import inspect_runs
from armdyn.run import Run

NAMES = list(JOINTS)
ELBOW = NAMES.index("elbow_flex")
DRIVE = {"joints": NAMES, "gain": "8.3 N m/rad", "limit": "3.35 N m", "delay": "18 ms"}


@pytest.fixture(scope="module")
def motion(tmp_path_factory):
    urdf = tmp_path_factory.mktemp("arm") / "arm.urdf"
    urdf.write_text(urdf_text())
    return urdf, *recorded(urdf, 1)


def run_of(q, told, command="q_cmd"):
    return Run.from_arrays(np.arange(len(q)) / FPS, {"q": q, command: told}, joints=NAMES, name="a")


def changed(values, factor, offset=0.0):
    values = values.copy()
    values[:, ELBOW] = factor * values[:, ELBOW] + offset
    return values


@pytest.mark.parametrize("command", ["q_cmd", "v_cmd"])
def test_a_command_that_is_followed_is_right(motion, command):
    _, q, told = motion
    told = told if command == "q_cmd" else np.gradient(told, 1.0 / FPS, axis=0)
    assert list(command_checks(run_of(q, told, command))) == []


@pytest.mark.parametrize("command", ["q_cmd", "v_cmd"])
@pytest.mark.parametrize(
    ("factor", "offset", "kind", "said"),
    [
        (180.0 / np.pi, 0.0, "angle_unit", "is in deg"), (-1.0, 0.0, "position_sign", "counts the other way"),
        (-1.0, np.pi, "position_sign", "counts the other way"),
        (-180.0 / np.pi, 0.0, "angle_unit", "and counts the other way"),
    ],
)  # fmt: skip
def test_one_command_in_degrees_or_negated_is_found(motion, command, factor, offset, kind, said):
    _, q, told = motion
    told = told if command == "q_cmd" else np.gradient(told, 1.0 / FPS, axis=0)
    (check,) = command_checks(run_of(q, changed(told, factor, offset if command == "q_cmd" else 0.0), command))
    assert (check.kind, check.channels[0]) == (kind, f"{command}.elbow_flex")
    assert said in check.sentence


def test_a_command_in_degrees_is_corrected(motion):
    _, q, told = motion
    run = run_of(q, changed(told, 180.0 / np.pi))
    (check,) = command_checks(run)
    mended = check.correction.applied_to(run)
    np.testing.assert_allclose(mended.channels["q_cmd.elbow_flex"].value, told[:, ELBOW], atol=1e-12)


def test_a_position_in_degrees_is_found_by_its_command(motion):
    urdf, q, told = motion
    model = arm_model(urdf).with_drives({"servo": {"joints": NAMES, "law": "position"}})
    found = inspect_runs([run_of(changed(q, 180.0 / np.pi), told)], model)  # no gain can be told from it: no matter
    assert "q.elbow_flex is in deg" in found.sentence


def test_positions_and_commands_in_degrees_are_beyond_what_joints_reach(motion):
    urdf, q, told = motion
    found = inspect_runs([run_of(np.rad2deg(q), np.rad2deg(told))], arm_model(urdf).with_drives({"servo": DRIVE}))
    assert "in degrees and called rad" in found.sentence
    assert not found.usable
    mended = next(iter(found.corrected().values())).applied_to(found.runs[0])
    np.testing.assert_allclose(mended.channels["q.elbow_flex"].value, q[:, ELBOW], atol=1e-12)
    assert inspect_runs([run_of(q, told)], arm_model(urdf).with_drives({"servo": DRIVE})).usable


def test_a_command_that_holds_is_no_sensor_that_is_stuck(motion):
    _, q, told = motion
    told = told.copy()
    told[300:420] = told[300]
    assert not any(check.kind == "frozen" for check in inspect_runs([run_of(q, told)]).checks)


def test_a_velocity_drive_without_a_commanded_velocity_is_one_line(motion, complains):
    urdf, q, told = motion
    for gain in ({}, {"gain": "3 N m s/rad"}):
        model = arm_model(urdf).with_drives({"servo": {"joints": NAMES, "law": "velocity", **gain}})
        for task in (inspect_runs, lambda runs, model: model.adapted_to(runs)):
            with complains(InputError) as caught:
                task([run_of(q, told)], model)
            assert "[drives.servo]" in str(caught.value)
            assert "v_cmd" in str(caught.value)


@pytest.mark.parametrize("gain", ["1e14 N m/rad", "1e-14 N m/rad"])
def test_a_gain_that_no_drive_has_is_refused(motion, gain, complains):
    with complains(InputError) as caught:
        arm_model(motion[0]).with_drives({"servo": DRIVE | {"gain": gain}})
    assert "[drives.servo]" in str(caught.value)


def test_a_gain_that_gives_impossible_torques_is_named_with_its_recording(motion, complains):
    urdf, q, told = motion
    model = arm_model(urdf).with_drives({"servo": {"joints": NAMES, "gain": "1e8 N m/rad"}})
    with complains(InputError) as caught:
        model.with_estimated_channels(run_of(q, told))
    assert str(caught.value).startswith("a: with the drive's gain of 1e+08 N m/rad")


@pytest.mark.parametrize(("size", "severity"), [(1e-12, "WRONG"), (0.0, "WRONG"), (1.0, None)])
def test_torques_that_are_rounding_errors_are_no_torques(motion, size, severity):
    urdf, q, _ = motion
    tau = size * np.random.default_rng(0).standard_normal(q.shape)
    found = inspect_runs([run_of(q, tau, "tau")], arm_model(urdf))
    nothing = [check.severity.name for check in found.checks if "is nothing" in check.sentence.replace("are", "is")]
    assert nothing == ([severity] if severity else [])


def test_one_torque_that_is_nothing_among_others_is_suspect(motion):
    tau = np.random.default_rng(0).standard_normal(motion[1].shape)
    found = inspect_runs([run_of(motion[1], changed(tau, 1e-13), "tau")])
    assert any(check.severity.name == "SUSPECT" and check.channels == ("tau.elbow_flex",) for check in found.checks)
